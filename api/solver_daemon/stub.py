"""What runs when a program calls `astap` or `solve-field`: hands the call to the solver that is warm.

`mountnav solver install` writes this file, as it is, under the names of the commands; its name tells which it
is. It runs in an isolated interpreter (``python -I -S``) and imports nothing but the modules that such an
interpreter has loaded already, `_socket`, and by TCP `_blake2`: it has to cost less than what it calls.

It connects to the solver's socket and does what comes from there: opens files and passes them on, writes
files, prints. So all files are read and written by the caller, with the caller's rights. Where nobody listens
the command is carried out by a new process of its own, and a solver daemon is started for the next one.

By TCP both ends prove first that they know the token: who listens on the port of a solver that has ended
would else be obeyed with the caller's rights.

A message is a letter, the length of what follows (4 bytes, little-endian), and that.
"""

import _socket
import os
import sys

TYPE_CHECKING = False  # as of `typing`, which would have to be imported
if TYPE_CHECKING:
    from typing import NoReturn

VERSION = "1"
"""Of what stub and solver say to each other. A solver of another version is not used."""
LONGEST_SOCKET_PATH = 100
"""Bytes; the system takes 107. A longer path is reached through its open folder."""
AT_ONCE_BYTES = 1 << 20
"""Bytes that are read and sent at a time."""
FAULT_CODE = 255
"""Exit code of a command that hit a fault of ours: none of the originals uses it for anything else."""
NONCE_BYTES = 16
"""Of what each end draws by chance for the other to prove the token with: nobody draws the same twice."""


def folder() -> str:
    """The folder of the socket: private, one a user. $MOUNTNAV_RUN, else that of the session."""
    own = os.environ.get("MOUNTNAV_RUN")
    if own:
        return own
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and os.path.isdir(runtime):
        return os.path.join(runtime, "mountnav")
    cache = os.environ.get("MOUNTNAV_CACHE")
    if not cache:
        home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
        cache = os.path.join(home, "mountnav")
    return os.path.join(cache, "run")


def connected(wanted: str) -> tuple[_socket.socket | None, str]:
    """A connection to the solver, or None: `wanted` is a path, or tcp:HOST:PORT:TOKEN."""
    try:
        if wanted.startswith("tcp:"):
            _, host, port, token = wanted.split(":", 3)
            link = _socket.socket(_socket.AF_INET, _socket.SOCK_STREAM)
            link.connect((host, int(port)))
            return link, token
        # anyone who may make a socket under this name may answer for the solver
        if os.stat(wanted).st_uid not in (os.geteuid(), 0):
            return None, ""
        link = _socket.socket(_socket.AF_UNIX, _socket.SOCK_STREAM)
        if len(os.fsencode(wanted)) <= LONGEST_SOCKET_PATH:
            link.connect(wanted)
        else:
            at = os.open(os.path.dirname(wanted), os.O_RDONLY | os.O_DIRECTORY)
            try:
                link.connect(f"/proc/self/fd/{at}/{os.path.basename(wanted)}")
            finally:
                os.close(at)
        return link, ""
    except (OSError, ValueError):
        return None, ""


def proof(token: str, who: bytes, nonce: bytes) -> bytes:
    """That somebody knows the token, without telling it."""
    import _blake2

    return _blake2.blake2s(who + nonce, key=token.encode()).digest()


def proven(link: _socket.socket, token: str) -> str:
    """Have a solver behind TCP prove that it knows the token; what it wants of us. Raises `Gone`."""
    talk, nonce = Talk(link), os.urandom(NONCE_BYTES)
    talk.send(b"N", nonce)
    head = talk.exactly(5)
    told = talk.exactly(int.from_bytes(head[1:], "little")) if head[:1] == b"P" else b""
    shown, its_nonce = told[:-NONCE_BYTES], told[-NONCE_BYTES:]
    if shown != proof(token, b"solver", nonce):
        raise Gone
    return proof(token, b"stub", its_nonce).hex()


class Gone(Exception):
    """The solver has ended in the middle."""


class Talk:
    """One call: what the solver asks is done until it tells the exit code."""

    def __init__(self, link: _socket.socket) -> None:
        self.link = link
        self.local = link.family == _socket.AF_UNIX
        self.done_anything = False

    def send(self, kind: bytes, content: bytes = b"", file: int | None = None) -> None:
        """Send a message, and an open file with it. Raises `Gone`."""
        head = kind + len(content).to_bytes(4, "little")
        try:
            if file is None:
                self.link.sendall(head)
            else:
                ancillary = (_socket.SOL_SOCKET, _socket.SCM_RIGHTS, file.to_bytes(4, sys.byteorder))
                self.link.sendmsg([head], [ancillary])
            if content:
                self.link.sendall(content)
        except OSError as fault:
            raise Gone from fault

    def exactly(self, length: int) -> bytes:
        """Receive so many bytes. Raises `Gone`."""
        content = bytearray()
        while len(content) < length:
            try:
                piece = self.link.recv(min(length - len(content), AT_ONCE_BYTES))
            except OSError as fault:
                raise Gone from fault
            if not piece:
                raise Gone
            content += piece
        return bytes(content)

    def carried_out(self) -> int | None:
        """Do what comes; return the exit code, or None where the solver is of another version."""
        while True:
            head = self.exactly(5)
            kind, content = head[:1], self.exactly(int.from_bytes(head[1:], "little"))
            if kind == b"Q":
                return int(content)
            if kind == b"V":
                return None
            if kind in b"12":
                self.done_anything = True
                printed(int(kind), content)
                continue
            try:
                self.answer(kind, content)
            except OSError as fault:
                told = f"{fault.errno or 5}\0{fault.strerror or fault}"
                self.send(b"E", told.encode("utf-8", "surrogateescape"))

    def answer(self, kind: bytes, content: bytes) -> None:
        """Do one thing with a file, and tell what came of it. Raises OSError."""
        if kind == b"O":
            # without waiting: opening a pipe would wait for a writer into it
            number = os.open(content, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            try:
                if os.fstat(number).st_mode & 0o170000 != 0o100000:
                    raise OSError(22, "it is not a regular file")
                if self.local:
                    self.send(b"F", file=number)
                else:
                    self.send(b"F", everything(number))
            finally:
                os.close(number)
        elif kind == b"W":
            path, _, text = content.partition(b"\0")
            self.done_anything = True
            written(path, text)
            self.send(b"K")
        elif kind == b"X":
            there = os.path.exists(content) and os.path.realpath(content) != b"/dev/null"
            self.send(b"K", b"1" if there else b"0")
        elif kind == b"R":
            self.done_anything = True
            removed(content)
            self.send(b"K")
        elif kind == b"D":
            self.done_anything = True
            os.makedirs(content, exist_ok=True)
            self.send(b"K")
        elif kind == b"I":
            self.send(b"K", everything(0))
        else:
            raise Gone


def asked(wanted: str, word: str) -> bytes:
    """What the solver answers to a word that is for itself; nothing if none knows that word."""
    link, token = connected(wanted)
    if link is None:
        return b""
    talk, heard = Talk(link), b""
    try:
        shown = proven(link, token) if token else ""
        talk.send(b"H", "\0".join([VERSION, shown, "/", word]).encode())
        while True:
            head = talk.exactly(5)
            kind, content = head[:1], talk.exactly(int.from_bytes(head[1:], "little"))
            if kind == b"Q":
                return heard
            if kind == b"1":
                heard += content
    except Gone:
        return b""
    finally:
        link.close()


def everything(number: int) -> bytes:
    """What is left to read of a descriptor."""
    parts: list[bytes] = []
    while True:
        part = os.read(number, AT_ONCE_BYTES)
        if not part:
            return b"".join(parts)
        parts.append(part)


def printed(number: int, content: bytes) -> None:
    """Print to a descriptor."""
    while content:
        try:
            content = content[os.write(number, content) :]
        except OSError:
            return  # nobody reads it


def written(path: bytes, content: bytes) -> None:
    """Write a file at once or not at all; one that is there keeps its mode, and links are followed.

    The null device takes all. Anything else that is no plain file, or may not be written, is refused: in its
    place would stand a plain file afterwards.
    """
    path = os.path.realpath(path)
    if path == b"/dev/null":
        return
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        mode = None
    if mode is not None and mode & 0o170000 != 0o100000:
        raise OSError(22, "it is not a regular file")
    if mode is not None and not os.access(path, os.W_OK):
        raise PermissionError(13, "Permission denied")
    # short, as the name itself may be as long as names can be; and never one that a killed call left behind
    between = os.path.join(os.path.dirname(path), b".mountnav-" + os.urandom(8).hex().encode())
    number = os.open(between, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    try:
        try:
            left = memoryview(content)
            while left:
                left = left[os.write(number, left) :]
            if mode is not None:
                os.chmod(number, mode & 0o7777)
        finally:
            os.close(number)
        os.replace(between, path)
    except BaseException:
        os.unlink(between)
        raise


def removed(path: bytes) -> None:
    """Remove a plain file or a link; one that isn't there is no error, and the null device stays."""
    if os.path.realpath(path) == b"/dev/null":
        return
    try:
        mode = os.lstat(path).st_mode & 0o170000
        if mode not in (0o100000, 0o120000):
            raise OSError(22, "it is not a regular file")
        os.unlink(path)
    except FileNotFoundError:
        pass


def started_daemon() -> None:
    """Start the solver for the next call; this one doesn't wait for it."""
    if os.fork():
        return
    try:
        os.setsid()
        null = os.open(os.devnull, os.O_RDWR)
        for number in (0, 1, 2):
            os.dup2(null, number)
        os.chdir("/")
        os.execv(sys.executable, [sys.executable, "-P", "-m", "api.solver_daemon.daemon"])
    finally:
        os._exit(127)


def alone(name: str, arguments: list[str]) -> "NoReturn":
    """Carry the command out in a new process of its own, in place of this one."""
    os.execv(sys.executable, [sys.executable, "-P", "-m", "api.solver_daemon.alone", name, *arguments])


def current_folder() -> str:
    """The current folder; nothing where somebody has removed it: whole paths work all the same."""
    try:
        return os.getcwd()
    except OSError:
        return ""


def run(name: str, arguments: list[str]) -> int:
    """Run a command by its name; the exit code."""
    wanted = os.environ.get("MOUNTNAV_SOLVER", "")
    if wanted == "off":
        alone(name, arguments)
    own = not wanted
    link, token = connected(wanted or os.path.join(folder(), "solver.sock"))
    if link is None:
        if own:
            started_daemon()
        alone(name, arguments)
    talk = Talk(link)
    try:
        shown = proven(link, token) if token else ""
        hello = [VERSION, shown, current_folder(), name, *arguments]
        talk.send(b"H", "\0".join(hello).encode("utf-8", "surrogateescape"))
        code = talk.carried_out()
    except Gone:
        if talk.done_anything:
            os.write(2, b"mountnav: the solver ended in the middle of this call; call it again\n")
            return FAULT_CODE
        code = None
    if code is None:
        alone(name, arguments)
    return code


def main() -> None:
    """Run the command that this file is called like, and end."""
    name = os.path.basename(sys.argv[0])
    for ending in (".py", ".exe"):
        name = name.removesuffix(ending)
    try:
        code = run(name, sys.argv[1:])
    except KeyboardInterrupt:
        code = 130
    # nothing of ours waits to be written, and the interpreter's own farewell takes milliseconds
    os._exit(code)


if __name__ == "__main__":
    main()
