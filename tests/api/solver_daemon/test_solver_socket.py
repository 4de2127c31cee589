"""Stubs as real processes against a real socket: files, terminal, exit codes, and who may call."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from api.solver_commands import registry
from api.solver_commands.host import Host
from api.solver_daemon import installing, stub
from api.solver_daemon.connection import OwnWord, serve_call
from api.solver_daemon.listener import SolverOnLoop, SolverSocket
from mountnav.errors import BadSettings
from mountnav.solving.settings import SolveSettings

TOY = "astap"
"""The name under which the toy is called."""


def toy(arguments: list[str], host: Host, solver: Any) -> int:
    """Does with the host what its arguments say."""
    word, *rest = arguments
    if word == "read":
        with host.open(rest[0]) as file:
            content = file.read()
        host.out(f"{len(content)} bytes: {content[:10]!r}\n")
        return 7
    if word == "folder":
        host.make_folder(rest[0])
        host.write(f"{rest[0]}/file", b"here")
        return 0
    if word == "write":
        host.write(rest[0], rest[1].encode() * int(rest[2]))
        host.out(str(host.exists(rest[0])))
        host.remove(rest[0] + ".gone")
        return 0
    if word == "input":
        host.out(host.read_input().decode()[::-1])
        host.err("to stderr")
        return 1
    if word == "fault":
        raise ZeroDivisionError("a mistake of ours")
    if word == "echo":
        host.out("|".join(rest))
        return 0
    if word == "wait":
        host.out("waiting\n")
        GOING.set()
        assert AGAIN.wait(30)
        WAITED.append(getattr(host, "gone", None))
        OVER.set()
        host.out("done\n")
        return 0
    raise AssertionError(word)


GOING, AGAIN, OVER = threading.Event(), threading.Event(), threading.Event()
WAITED: list[bool | None] = []


@dataclass
class Running:
    """A socket in a loop of its own, and how stubs are called."""

    server: SolverSocket
    program: Path
    folder: Path
    environment: dict[str, str] = field(default_factory=dict)

    def begun(self, *arguments: str, **more: Any) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [str(self.program), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            cwd=self.folder,
            env={**os.environ, **self.environment},
            **more,
        )

    def called(self, *arguments: str, given: bytes = b"") -> tuple[int, bytes, bytes]:
        process = self.begun(*arguments, stdin=subprocess.PIPE)
        out, err = process.communicate(given)
        return process.returncode, out, err


def _served(folder: Path, **more: Any) -> Iterator[Running]:
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    solver = SolverOnLoop(SimpleNamespace(), SolveSettings, loop)  # type: ignore[arg-type]  # the toy solves nothing
    server = SolverSocket(solver, path=folder / "run" / "solver.sock", **more)
    asyncio.run_coroutine_threadsafe(server.start(), loop).result()
    installing.install(folder / "bin", [TOY])
    host, port = server.address
    where = host if not port else f"tcp:{host}:{port}:{server.token}"
    try:
        yield Running(server, folder / "bin" / TOY, folder, {"MOUNTNAV_SOLVER": where})
    finally:
        asyncio.run_coroutine_threadsafe(server.stop(), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


@pytest.fixture(autouse=True)
def _toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("api.solver_daemon.connection.command", lambda name: toy)
    for event in (GOING, AGAIN, OVER):
        event.clear()
    WAITED.clear()


@pytest.fixture(params=["unix", "tcp"])
def running(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Running]:
    """A socket of either kind."""
    yield from _served(tmp_path, tcp_port=0 if request.param == "tcp" else None)


@pytest.fixture
def private(tmp_path: Path) -> Iterator[Running]:
    """A socket of this user."""
    yield from _served(tmp_path)


def test_files_are_read_and_written_in_the_callers_folder(running: Running) -> None:
    (running.folder / "frame ä.fits").write_bytes(b"0123456789" * 100_000)
    assert running.called("read", "frame ä.fits") == (7, b"1000000 bytes: b'0123456789'\n", b"")
    (running.folder / "out.txt.gone").write_text("x")
    assert running.called("write", "out.txt", "abc", "100000") == (0, b"True", b"")
    assert (running.folder / "out.txt").read_bytes() == b"abc" * 100_000
    assert not (running.folder / "out.txt.gone").exists()
    assert [path.name for path in running.folder.iterdir() if "part" in path.name] == []


def test_folders_are_made_there_too(running: Running) -> None:
    for _ in range(2):
        assert running.called("folder", "one/two") == (0, b"", b"")
    assert (running.folder / "one" / "two" / "file").read_bytes() == b"here"
    code, _, err = running.called("folder", "one/two/file/three")
    assert (code, err.count(b"\n")) == (255, 1)


def test_a_file_that_is_replaced_keeps_its_mode_and_its_link(running: Running) -> None:
    real = running.folder / "real.fits"
    real.write_text("old")
    real.chmod(0o640)
    (running.folder / "link.fits").symlink_to(real)
    assert running.called("write", "link.fits", "new", "1")[0] == 0
    assert (running.folder / "link.fits").is_symlink()
    assert real.read_text() == "new"
    assert stat.S_IMODE(real.stat().st_mode) == 0o640


def test_a_new_file_has_the_callers_mode(running: Running) -> None:
    process = running.begun("write", "fresh.txt", "x", "1", umask=0o027)
    process.communicate()
    assert stat.S_IMODE((running.folder / "fresh.txt").stat().st_mode) == 0o640


def test_input_and_both_outputs_go_through(running: Running) -> None:
    assert running.called("input", given=b"olleh") == (1, b"hello", b"to stderr")


@pytest.mark.parametrize("odd", ["", "-x", "a b", "ä€", "x=1", "'\"$(true)"])
def test_arguments_come_as_they_were_typed(private: Running, odd: str) -> None:
    assert private.called("echo", odd, "end")[1].decode() == f"{odd}|end"


def test_what_is_no_file_is_refused_in_one_line(running: Running) -> None:
    os.mkfifo(running.folder / "pipe")
    for path in ("pipe", ".", "/dev/zero", "missing", "/dev/null"):
        code, out, err = running.called("read", path)
        assert (code, out) == (255, b""), path
        assert err.count(b"\n") == 1, err
    code, _, err = running.called("write", "no/folder/x", "a", "1")
    assert code == 255
    assert err.count(b"\n") == 1


def test_a_fault_of_ours_ends_one_call_only(running: Running) -> None:
    code, out, err = running.called("fault")
    assert code == 255
    assert out == b""
    assert b"ZeroDivisionError" in err
    assert running.called("echo", "a")[0] == 0


def test_a_stub_that_is_killed_is_noticed(private: Running) -> None:
    process = private.begun("wait")
    assert process.stdout is not None
    assert process.stdout.readline() == b"waiting\n"
    process.send_signal(signal.SIGKILL)
    process.communicate()
    AGAIN.set()
    assert OVER.wait(30)
    assert WAITED == [True]
    assert private.called("echo", "alive")[1] == b"alive"


def test_calls_are_carried_out_side_by_side(private: Running) -> None:
    process = private.begun("wait")
    assert process.stdout is not None
    assert process.stdout.readline() == b"waiting\n"
    assert private.called("echo", "meanwhile")[1] == b"meanwhile"
    AGAIN.set()
    assert process.communicate()[0] == b"done\n"
    assert WAITED == [False]


def test_a_solver_that_ends_in_the_middle_is_told(private: Running) -> None:
    process = private.begun("wait")
    assert process.stdout is not None
    assert process.stdout.readline() == b"waiting\n"
    with private.server._lock:
        links = list(private.server._links)
    for link in links:
        link.shutdown(2)
    _, err = process.communicate()
    AGAIN.set()
    assert process.returncode == 255
    assert b"call it again" in err


def test_without_a_thread_left_a_call_is_let_go_and_the_next_is_answered(
    private: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = threading.Thread.start
    refused: list[threading.Thread] = []

    def no_more(thread: threading.Thread) -> None:
        if thread.name == "solver call" and not refused:
            refused.append(thread)
            raise RuntimeError("can't start new thread")
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", no_more)
    link, _ = stub.connected(private.server.address[0])
    assert link is not None
    with pytest.raises(stub.Gone):
        stub.Talk(link).exactly(1)
    link.close()
    assert refused
    assert private.called("echo", "again")[1] == b"again"


def test_more_calls_than_may_be_wait_for_their_turn(tmp_path: Path) -> None:
    for running in _served(tmp_path, most_calls=1):
        first = running.begun("wait")
        assert first.stdout is not None
        assert first.stdout.readline() == b"waiting\n"
        second = running.begun("echo", "later")
        AGAIN.set()
        assert first.communicate()[0] == b"done\n"
        assert second.communicate()[0] == b"later"


def test_only_this_user_can_reach_the_socket(private: Running) -> None:
    path = Path(private.server.address[0])
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_a_port_wants_its_token(tmp_path: Path) -> None:
    for running in _served(tmp_path, tcp_port=0):
        host, port = running.server.address
        for shown in ("", "0" * 64, running.server.token):
            link, _ = stub.connected(f"tcp:{host}:{port}:{running.server.token}")
            assert link is not None
            talk = stub.Talk(link)
            talk.send(b"N", b"n" * stub.NONCE_BYTES)
            assert talk.exactly(5)[:1] == b"P"
            talk.exactly(32 + stub.NONCE_BYTES)
            talk.send(b"H", "\0".join([stub.VERSION, shown, "/", TOY, "echo", "x"]).encode())
            with pytest.raises(stub.Gone):
                talk.exactly(1)
            link.close()
        # and a hello without the other end's proof
        link, _ = stub.connected(f"tcp:{host}:{port}:{running.server.token}")
        assert link is not None
        talk = stub.Talk(link)
        talk.send(b"H", "\0".join([stub.VERSION, running.server.token, "/", TOY, "echo"]).encode())
        with pytest.raises(stub.Gone):
            talk.exactly(1)
        link.close()


def test_whoever_listens_on_a_solvers_old_port_is_not_obeyed(tmp_path: Path) -> None:
    import socket

    installing.install(tmp_path / "bin", [TOY])
    listening = socket.create_server(("127.0.0.1", 0))
    victim = tmp_path / "victim"

    def impostor() -> None:
        link, _ = listening.accept()
        # it hangs up on an impostor, at whichever of these
        with link, suppress(OSError):
            link.recv(100)
            text = b"P" + (48).to_bytes(4, "little") + bytes(48)
            link.sendall(
                text + b"W" + (len(bytes(victim)) + 2).to_bytes(4, "little") + bytes(victim) + b"\0x"
            )
            link.recv(100)

    thread = threading.Thread(target=impostor)
    thread.start()
    where = f"tcp:127.0.0.1:{listening.getsockname()[1]}:{'5' * 32}"
    subprocess.run(
        [tmp_path / "bin" / TOY, "-h"],
        env={**os.environ, "MOUNTNAV_SOLVER": where},
        capture_output=True,
        cwd=tmp_path,
        timeout=120,
    )
    thread.join(60)
    listening.close()
    assert not victim.exists()


def test_a_socket_of_somebody_else_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for running in _served(tmp_path):
        path = running.server.address[0]
        link, _ = stub.connected(path)
        assert link is not None
        link.close()
        there = os.stat(path)
        monkeypatch.setattr(os, "stat", lambda _, uid=there.st_uid: SimpleNamespace(st_uid=uid + 4242))
        assert stub.connected(path) == (None, "")


def test_a_path_longer_than_sockets_have_is_reached(tmp_path: Path) -> None:
    deep = tmp_path / ("long" * 40)
    deep.mkdir()
    for running in _served(deep):
        assert len(running.server.address[0]) > 107
        assert running.called("echo", "far")[1] == b"far"


def test_garbage_harms_nobody(private: Running) -> None:
    for junk in (b"", b"H", b"H\xff\xff\xff\xff", b"Z\0\0\0\0", b"H\1\0\0\0x", os.urandom(2000)):
        link, _ = stub.connected(private.server.address[0])
        assert link is not None
        link.sendall(junk)
        link.close()
    assert private.called("echo", "fine")[1] == b"fine"


def test_a_second_solver_of_the_same_user_is_refused_and_the_first_goes_on(private: Running) -> None:
    path = Path(private.server.address[0])
    second = SolverSocket(private.server._solver, path=path)
    with pytest.raises(BadSettings, match="another solver"):
        asyncio.run(second.start())
    third = SolverSocket(private.server._solver, path=path, takes_over=True)
    asyncio.run(third.start())
    asyncio.run(third.stop())
    assert private.called("echo", "first")[1] == b"first"


def test_what_a_killed_solver_has_left_is_no_hindrance(tmp_path: Path) -> None:
    import socket

    folder = tmp_path / "run"
    folder.mkdir()
    left = socket.socket(socket.AF_UNIX)
    left.bind(str(folder / "solver.sock"))
    left.close()
    for running in _served(tmp_path):
        assert running.called("echo", "again")[1] == b"again"


def test_stopped_it_leaves_nothing_behind(tmp_path: Path) -> None:
    for running in _served(tmp_path):
        path = Path(running.server.address[0])
    assert not path.exists()
    assert running.server.idle_s >= 0


def test_a_stub_of_another_version_sees_to_itself(private: Running, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("api.solver_daemon.stub.VERSION", "0")
    link, _ = stub.connected(private.server.address[0])
    assert link is not None
    talk = stub.Talk(link)
    talk.send(b"H", "\0".join(["another", "", "/", TOY, "echo", "x"]).encode())
    assert talk.carried_out() is None
    link.close()


def test_the_stub_imports_nothing_that_takes_time(tmp_path: Path) -> None:
    source = Path(stub.__file__).read_text()
    told = f"{source.split('if __name__')[0]}\nprint(sorted(sys.modules))"
    modules = subprocess.run([sys.executable, "-IS", "-c", told], capture_output=True, text=True, check=True)
    loaded = eval(modules.stdout)
    assert "socket" not in loaded
    assert "json" not in loaded
    assert "re" not in loaded
    assert len(loaded) < 60


def test_names_are_known_in_any_case() -> None:
    for name in registry.NAMES:
        assert registry.known_name(name.upper()) == name
    assert registry.known_name("rm") is None


def test_a_stop_is_answered_before_the_solver_ends() -> None:
    """Else who asked for it would be told that none was running."""
    ours, theirs = socket.socketpair()
    on_the_way: list[bytes] = []
    own = {"stop": OwnWord(lambda: "bye\n", then=lambda: on_the_way.append(theirs.recv(4096)))}
    with theirs:
        stub.Talk(theirs).send(b"H", "\0".join([stub.VERSION, "", "/", "stop"]).encode())
        serve_call(ours, None, own=own)  # type: ignore[arg-type]
    assert b"bye\n" in on_the_way[0]
    assert b"Q" in on_the_way[0]


def test_a_solver_that_was_told_to_stop_ends_though_nobody_waits_for_the_answer() -> None:
    ours, theirs = socket.socketpair()
    ended = threading.Event()
    with theirs:
        stub.Talk(theirs).send(b"H", "\0".join([stub.VERSION, "", "/", "stop"]).encode())
    serve_call(ours, None, own={"stop": OwnWord(lambda: "bye\n" * 1000, then=ended.set)})  # type: ignore[arg-type]
    assert ended.is_set()
