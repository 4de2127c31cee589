"""One call of a stub: its files and its terminal through the socket, and the command that it wants."""

from __future__ import annotations

import hmac
import logging
import os
import select
import socket
import stat
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from io import FileIO
from typing import BinaryIO, cast

from api.solver_commands.host import Solver
from api.solver_commands.registry import command, known_name
from api.solver_daemon import stub
from mountnav.errors import Cancelled, MountnavError
from mountnav.tasks import fault_words

_log = logging.getLogger(__name__)

LONGEST_ANSWER_S = 60.0
"""How long a stub may take over one file, s: a slow disk needs a few. Doubled, one that was stopped by Ctrl-Z
holds its thread twice as long."""
LONGEST_HELLO_BYTES = 1 << 20
"""A call's arguments; the system allows 2 MB, nobody uses 10 kB."""
MOST_FILE_BYTES = 2_500_000_000
"""Longest file that is taken through TCP, bytes: as the solver's process may write."""


@dataclass(frozen=True, slots=True)
class OwnWord:
    """What the solver does on a word that is for itself.

    Attributes
    ----------
    answer : callable
        Gives the answer.
    then : callable, optional
        Done when the answer is sent, or its reader has gone: an end before it would take the answer away.
    """

    answer: Callable[[], str]
    then: Callable[[], object] = lambda: None


class StubGone(Exception):
    """The stub was ended: nobody waits for the command."""


@dataclass(frozen=True, slots=True)
class Call:
    """What a stub wants.

    Attributes
    ----------
    folder : str
        The caller's.
    name : str
        As the command was called.
    """

    version: str
    token: str
    folder: str
    name: str
    arguments: list[str]


class StubHost:
    """The files and the terminal of a stub. Implements `api.solver_commands.host.Host`.

    Parameters
    ----------
    link : socket.socket
        Blocking, with a timeout.
    """

    def __init__(self, link: socket.socket) -> None:
        self._link = link
        self._local = link.family == socket.AF_UNIX

    def open(self, path: str) -> BinaryIO:
        """As `Host.open`."""
        self._send(b"O", _bytes(path))
        kind, content, file = self._receive()
        if kind != b"F":
            raise _fault(content, path)
        if file is None:
            file = os.memfd_create("mountnav-file")
            with FileIO(file, "wb", closefd=False) as writing:
                writing.write(content)
            os.lseek(file, 0, os.SEEK_SET)
        opened = cast(BinaryIO, os.fdopen(file, "rb"))
        if not stat.S_ISREG(os.fstat(file).st_mode):
            opened.close()
            raise OSError(22, "it is not a regular file", path)
        return opened

    def write(self, path: str, content: bytes) -> None:
        """As `Host.write`."""
        self._asked(b"W", _bytes(path) + b"\0" + content, path)

    def exists(self, path: str) -> bool:
        """As `Host.exists`."""
        return self._asked(b"X", _bytes(path), path) == b"1"

    def remove(self, path: str) -> None:
        """As `Host.remove`."""
        self._asked(b"R", _bytes(path), path)

    def make_folder(self, path: str) -> None:
        """As `Host.make_folder`."""
        self._asked(b"D", _bytes(path), path)

    def read_input(self) -> bytes:
        """All of the caller's standard input."""
        return self._asked(b"I", b"", "standard input")

    def out(self, text: str) -> None:
        """As `Host.out`."""
        self._send(b"1", _bytes(text))

    def err(self, text: str) -> None:
        """As `Host.err`."""
        self._send(b"2", _bytes(text))

    def end(self, code: int) -> None:
        """Tell the exit code; the stub ends."""
        self._send(b"Q", str(code).encode())

    def refuse_version(self) -> None:
        """Tell a stub of another version that it has to see to its command itself."""
        self._send(b"V", b"")

    @property
    def gone(self) -> bool:
        """Whether the stub was ended."""
        ready = select.poll()
        ready.register(self._link, select.POLLRDHUP)
        return bool(ready.poll(0))

    def prove(self, token: str) -> str:
        """Prove to the stub that this is its solver; what it must show in turn. Raises `StubGone`."""
        kind, nonce, _ = self._receive(LONGEST_HELLO_BYTES)
        if kind != b"N" or len(nonce) != stub.NONCE_BYTES:
            raise StubGone("it asked for no proof")
        own = os.urandom(stub.NONCE_BYTES)
        self._send(b"P", stub.proof(token, b"solver", nonce) + own)
        return stub.proof(token, b"stub", own).hex()

    def call(self) -> Call:
        """Receive what the stub wants. Raises `StubGone`."""
        kind, content, _ = self._receive(LONGEST_HELLO_BYTES)
        parts = content.decode("utf-8", "surrogateescape").split("\0")
        if kind != b"H" or len(parts) < 4:
            raise StubGone("no call came")
        version, token, folder, name, *arguments = parts
        return Call(version, token, folder, name, arguments)

    def _asked(self, kind: bytes, content: bytes, path: str) -> bytes:
        self._send(kind, content)
        answered, told, _ = self._receive()
        if answered != b"K":
            raise _fault(told, path)
        return told

    def _send(self, kind: bytes, content: bytes) -> None:
        try:
            self._link.sendall(kind + len(content).to_bytes(4, "little"))
            self._link.sendall(content)
        except OSError as fault:
            raise StubGone(str(fault)) from fault

    def _receive(self, most_bytes: int = MOST_FILE_BYTES) -> tuple[bytes, bytes, int | None]:
        """An answer: its letter, its content, and the file that came along."""
        file: int | None = None
        try:
            if self._local:
                head, files, _, _ = socket.recv_fds(self._link, 5, 1)
                file = files[0] if files else None
            else:
                head = self._link.recv(5)
            head += self._exactly(5 - len(head)) if head else b""
            length = int.from_bytes(head[1:], "little")
            if not head or length > most_bytes:
                raise StubGone("the stub was ended" if not head else f"{length} bytes came")
            return head[:1], self._exactly(length), file
        except BaseException as fault:
            if file is not None:
                os.close(file)
            if isinstance(fault, OSError):
                raise StubGone(str(fault)) from fault
            raise

    def _exactly(self, length: int) -> bytes:
        content = bytearray()
        while len(content) < length:
            piece = self._link.recv(min(length - len(content), stub.AT_ONCE_BYTES))
            if not piece:
                raise StubGone("the stub was ended")
            content += piece
        return bytes(content)


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


def _fault(content: bytes, path: str) -> OSError:
    """The trouble that the stub had with a file."""
    number, _, words = content.decode("utf-8", "replace").partition("\0")
    return OSError(int(number) if number.isdecimal() else 5, words or "it can't be used", path)


def serve_call(
    link: socket.socket, solver: Solver, *, token: str = "", own: Mapping[str, OwnWord] | None = None
) -> None:
    """Carry out what one stub wants, to its end; nothing is raised.

    Parameters
    ----------
    link : socket.socket
        Its connection; closed then.
    token : str
        What a stub must know; empty where the socket itself is private.
    own : mapping, optional
        Words for the solver itself ("status", "stop").
    """
    then: Callable[[], object] | None = None
    with closing(link):
        link.settimeout(LONGEST_ANSWER_S)
        host = StubHost(link)
        with suppress(StubGone):
            wanted = host.prove(token) if token else ""
            call = host.call()
            if not hmac.compare_digest(call.token.encode("utf-8", "replace"), wanted.encode()):
                _log.warning("a call without the token was refused")
                return
            if call.version != stub.VERSION:
                host.refuse_version()
                return
            then = None if own is None or call.name not in own else own[call.name].then
            host.end(_carried_out(call, host, solver, own or {}))
    if then is not None:
        then()


def _carried_out(call: Call, host: StubHost, solver: Solver, own: Mapping[str, OwnWord]) -> int:
    """Run the command; its exit code. A fault of ours is told, and ends only this call."""
    if call.name in own:
        host.out(own[call.name].answer())
        return 0
    name = known_name(call.name)
    if name is None:
        host.err(f"mountnav: there is no command {call.name!r}\n")
        return stub.FAULT_CODE
    try:
        return command(name)(call.arguments, host, solver)
    except StubGone:
        raise
    except Cancelled:
        return stub.FAULT_CODE
    except (MountnavError, OSError) as fault:
        host.err(f"{name}: {fault}\n")
        return stub.FAULT_CODE
    except Exception as fault:
        _log.exception("%s hit a fault", name)
        host.err(f"{name}: {fault_words(fault)}\n")
        return stub.FAULT_CODE
