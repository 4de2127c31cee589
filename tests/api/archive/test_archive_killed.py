"""A run that is killed, again and again, ends with the very bytes of one that nobody disturbed."""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mountnav.archive.folder import Folder, RunFolder
from tests.api.archive.conftest import POISON, SOLVING
from tests.api.command_here import run_here
from tests.archive.test_store import tree

pytestmark = pytest.mark.long
MOUNTNAV = [sys.executable, "-m", "api.main", "archive"]


@pytest.fixture(scope="module")
def undisturbed(poisoned: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive of six chunks, solved in peace."""
    path = _made(poisoned, tmp_path_factory.mktemp("undisturbed"))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sys, "path", [str(POISON), *sys.path])
        assert run_here("archive", "work", path).returncode == 0
    return path


def _made(table: Path, where: Path) -> Path:
    path = where / "archive"
    made = run_here(
        "archive", "init", path, "--frames", table, "--chunk-frames", "2", "--deadline", "10", *SOLVING
    )
    assert made.returncode == 0, made.stderr
    return path


def _run(path: Path) -> RunFolder:
    return Folder.open(path).run(None)


def _started(path: Path, *more: str, limit_bytes: int | None = None) -> subprocess.Popen[bytes]:
    def limited() -> None:
        if limit_bytes is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, limit_bytes))

    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(POISON), *filter(None, sys.path)])}
    return subprocess.Popen(
        [*MOUNTNAV, "run", str(path), *more], env=environment, stderr=subprocess.PIPE, preexec_fn=limited
    )


def _solvers(client: int) -> list[int]:
    """The solving processes of a client."""
    try:
        return list(map(int, Path(f"/proc/{client}/task/{client}/children").read_text().split()))
    except OSError:
        return []


def _until_solving(run: RunFolder, client: subprocess.Popen[bytes]) -> None:
    while client.poll() is None and not (any(run.making.glob("*-*")) and _solvers(client.pid)):
        time.sleep(0.02)


def test_kills_of_clients_and_workers_at_any_instant_change_nothing(
    poisoned: Path, undisturbed: Path, tmp_path: Path
) -> None:
    path, chance = _made(poisoned, tmp_path), random.Random(7)
    run, killed = _run(path), 0
    while killed < 6:
        client = _started(path, "--jobs", "2")
        _until_solving(run, client)
        time.sleep(chance.uniform(0.0, 3.0))
        victims = [client.pid] if killed % 2 else _solvers(client.pid) or [client.pid]
        victim = chance.choice(victims)
        if client.poll() is None:
            os.kill(victim, signal.SIGKILL)
            killed += 1
        if victim != client.pid:  # the client goes on with another one; it is killed a little later
            time.sleep(chance.uniform(0.5, 2.0))
            client.kill()
        client.communicate()
        if len(run.done()) == 6:  # all done in between: the rest of the kills has a chunk to hit again
            shutil.rmtree(run.chunk(chance.randrange(6)))
    last = _started(path, "--jobs", "2")
    said = last.communicate()[1].decode()
    assert last.returncode == 0, said
    assert tree(run.chunks) == tree(_run(undisturbed).chunks)
    assert not any(run.making.iterdir())
    verified = run_here("archive", "verify", path)
    assert verified.returncode == 0, verified.stdout


def test_a_full_disk_stops_it_and_nothing_half_is_left(
    poisoned: Path, undisturbed: Path, tmp_path: Path
) -> None:
    path = _made(poisoned, tmp_path)
    run = _run(path)
    client = _started(path, limit_bytes=3000)  # no file may grow longer, as on a disk that is full
    said = client.communicate()[1].decode()
    assert client.returncode == 1
    assert "the store can't be written" in said
    assert "Traceback" not in said
    assert not run.done()
    assert [one.suffix for one in run.making.iterdir()] in ([], [".lock"], [".lock", ".lock"])
    client = _started(path)
    assert client.communicate()[1] is not None
    assert client.returncode == 0
    assert tree(run.chunks) == tree(_run(undisturbed).chunks)


def test_dask_gives_the_same_bytes(poisoned: Path, undisturbed: Path, tmp_path: Path) -> None:
    path = _made(poisoned, tmp_path)
    client = _started(path, "--engine", "dask", "--jobs", "1")
    said = client.communicate()[1].decode()
    assert client.returncode == 0, said
    assert tree(_run(path).chunks) == tree(_run(undisturbed).chunks)
