"""A run that is killed, again and again, ends with the very bytes of one that nobody disturbed."""

from __future__ import annotations

import json
import multiprocessing
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
from mountnav.archive.tables import read_rows
from tests.api.archive.conftest import POISON, SOLVING
from tests.api.command_here import run_here
from tests.archive.test_store import tree

pytestmark = pytest.mark.long
KILLS = 6


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


class _Client:
    """`mountnav archive run` in a process of its own, forked from one that has imported all it needs."""

    def __init__(self, path: Path, *more: str, limit_bytes: int | None = None) -> None:
        self._said = path.parent / "said.txt"
        words = ["mountnav", "archive", "run", str(path), *more]
        self._process = FORKED.Process(target=_as_client, args=(words, str(self._said), limit_bytes))
        self._process.start()

    @property
    def pid(self) -> int:
        assert self._process.pid is not None
        return self._process.pid

    @property
    def running(self) -> bool:
        return self._process.is_alive()

    def kill(self) -> None:
        self._process.kill()

    def ended(self) -> tuple[int | None, str]:
        """Exit code, and what it said on stderr."""
        self._process.join()
        return self._process.exitcode, self._said.read_text()


FORKED = multiprocessing.get_context("forkserver")
FORKED.set_forkserver_preload(
    [
        "api.main",
        "api.cli.app",
        "api.archive.solving",
        "api.cli.archive_showing",
        "pyarrow.parquet",
        "asyncio",
    ]
)


def _as_client(words: list[str], said: str, limit_bytes: int | None) -> None:
    from api.main import main

    with open(said, "w") as file:
        os.dup2(file.fileno(), 2)
    if limit_bytes is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, limit_bytes))
    sys.path.insert(0, str(POISON))
    sys.argv = words
    main()


def _solvers(client: int) -> list[int]:
    """The solving processes of a client."""
    try:
        return list(map(int, Path(f"/proc/{client}/task/{client}/children").read_text().split()))
    except OSError:
        return []


def test_poison_is_set_aside_after_two_tries(undisturbed: Path) -> None:
    run = _run(undisturbed)
    rows = [row for number in sorted(run.done()) for row in read_rows(run.chunk(number) / "refusals.parquet")]
    codes = {row["number"]: row["reason_code"] for row in rows}
    assert codes == {2: "HUNG", 4: "BAD_FRAME", 7: "DIED", 11: "UNREAD"}
    told = {row["number"]: row["reason"] for row in rows if row["set_aside"]}
    assert told == {
        2: "no answer within 10 s, in each of 2 tries",
        7: "the process that solved it died of it, in each of 2 tries",
    }


def test_kills_of_clients_and_workers_at_any_instant_change_nothing(
    poisoned: Path, undisturbed: Path, tmp_path: Path
) -> None:
    path, chance = _made(poisoned, tmp_path), random.Random(7)
    run = _run(path)
    for number in range(KILLS):
        client, before = _Client(path, "--jobs", "2"), run.done()
        # each third one as its processes begin, the others in the middle of the work
        while client.running and not (_solvers(client.pid) if number % 3 == 0 else run.done() - before):
            time.sleep(0.02)
        time.sleep(chance.uniform(0.0, 0.5))
        if number % 2:
            for solver in _solvers(client.pid):
                os.kill(solver, signal.SIGKILL)
            time.sleep(chance.uniform(0.0, 3.0))  # the client goes on with others, until it is killed, too
        client.kill()
        client.ended()
        if len(run.done()) > 3:  # so that the next one has something to do
            for done in chance.sample(sorted(run.done()), 2):
                shutil.rmtree(run.chunk(done))
    code, said = _Client(path, "--jobs", "2").ended()
    assert code == 0, said
    assert tree(run.chunks) == tree(_run(undisturbed).chunks)
    assert not any(run.making.iterdir())
    verified = run_here("archive", "verify", path)
    assert verified.returncode == 0, verified.stdout


def test_a_full_disk_stops_it_and_nothing_half_is_left(
    poisoned: Path, undisturbed: Path, tmp_path: Path
) -> None:
    path = _made(poisoned, tmp_path)
    run = _run(path)
    # no file may grow longer, as on a disk that is full
    code, said = _Client(path, limit_bytes=3000).ended()
    assert code == 1
    assert "the store can't be written" in said
    assert "Traceback" not in said
    assert not run.done()
    assert {one.suffix for one in run.making.iterdir()} <= {".lock"}
    code, said = _Client(path).ended()
    assert code == 0, said
    assert tree(run.chunks) == tree(_run(undisturbed).chunks)


class _Cluster:
    """A scheduler and two workers, each a process of its own, as `dask scheduler` and `dask worker` are."""

    def __init__(self, where: Path) -> None:
        path = os.pathsep.join([str(POISON), *filter(None, sys.path)])
        self._where, self._environment = where, os.environ | {"PYTHONPATH": path}
        told = where / "scheduler.json"
        self.scheduler = self._started("dask_scheduler", "--port", "0", "--scheduler-file", str(told))
        while not (address := self._address(told)):
            assert self.scheduler.poll() is None
            time.sleep(0.05)
        self.address = address
        self._workers = [
            self._started("dask_worker", address, "--no-nanny", "--nthreads", "1") for _ in range(2)
        ]

    def _started(self, name: str, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{name}", "--no-dashboard", "--host", "127.0.0.1"]
        return subprocess.Popen(
            [*command, *words],
            cwd=self._where,
            env=self._environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    @staticmethod
    def _address(told: Path) -> str:
        try:
            return str(json.loads(told.read_text())["address"])
        except (OSError, ValueError):
            return ""  # not there yet, or half written

    def end(self) -> None:
        """End all that is left of it."""
        for process in (*self._workers, self.scheduler):
            process.kill()
            process.wait()


def test_a_scheduler_that_is_killed_is_told_and_another_one_ends_the_work(
    poisoned: Path, undisturbed: Path, tmp_path: Path
) -> None:
    path = _made(poisoned, tmp_path)
    run = _run(path)
    (tmp_path / "first").mkdir()
    cluster = _Cluster(tmp_path / "first")
    try:
        client = _Client(path, "--scheduler", cluster.address)
        while client.running and not run.done():
            time.sleep(0.02)
        cluster.scheduler.kill()
        code, said = client.ended()
    finally:
        cluster.end()
    assert code == 1, said
    assert "the scheduler went away" in said
    assert "Traceback" not in said
    assert 0 < len(run.done()) < 6
    (tmp_path / "second").mkdir()
    cluster = _Cluster(tmp_path / "second")
    try:
        code, said = _Client(path, "--scheduler", cluster.address).ended()
    finally:
        cluster.end()
    assert code == 0, said
    assert tree(run.chunks) == tree(_run(undisturbed).chunks)
    assert not any(run.making.iterdir())


def test_dask_gives_the_same_bytes(poisoned: Path, undisturbed: Path, tmp_path: Path) -> None:
    path = _made(poisoned, tmp_path)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(POISON), *filter(None, sys.path)])}
    done = subprocess.run(
        [sys.executable, "-m", "api.main", "archive", "run", str(path), "--engine", "dask", "--jobs", "1"],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert tree(_run(path).chunks) == tree(_run(undisturbed).chunks)
