"""The documented job script under a real Slurm: a cluster of one node, made for the test and ended with it.

Where Slurm and munge aren't installed (on Debian: apt-get install slurm-wlm), or this isn't root, it is
skipped: their daemons start programs in other users' names.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from benchmarks.archive.drawn import draw
from mountnav.archive.folder import Folder
from tests.api.archive.conftest import SOLVING
from tests.api.command_here import run_here
from tests.archive.test_store import tree

_PROGRAMS = ("slurmctld", "slurmd", "sbatch", "munged")
_MISSING = [name for name in _PROGRAMS if shutil.which(name, path=f"{os.environ['PATH']}:/usr/sbin") is None]
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(bool(_MISSING), reason=f"Slurm isn't installed here: no {', '.join(_MISSING)}"),
    pytest.mark.skipif(os.geteuid() != 0, reason="Slurm's daemons need root"),
]

PAGE = Path(__file__).parents[3] / "docs/how-to/solve-a-million-frames.md"
PARTS = 4


class _Cluster:
    """One node, two cores, with its own key and its own ports."""

    def __init__(self, where: Path) -> None:
        self.where = where
        self._host = socket.gethostname().split(".")[0]
        self.environment = os.environ | {
            "SLURM_CONF": str(where / "slurm.conf"),
            "PATH": f"{where}/bin:{os.environ['PATH']}:/usr/sbin",
        }
        self._daemons: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        munge = self.where / "munge"
        munge.mkdir(mode=0o700)
        key = munge / "key"
        key.write_bytes(os.urandom(128))
        key.chmod(0o400)
        for name in ("state", "spool"):
            (self.where / name).mkdir()
        one, other = _free_ports()
        (self.where / "slurm.conf").write_text(
            f"ClusterName=test\nSlurmctldHost={self._host}(127.0.0.1)\nSlurmUser=root\n"
            f"AuthType=auth/munge\nAuthInfo=socket={munge}/socket\n"
            "ProctrackType=proctrack/linuxproc\nTaskPlugin=task/none\nSwitchType=switch/none\nMpiDefault=none\n"
            "JobAcctGatherType=jobacct_gather/none\nAccountingStorageType=accounting_storage/none\n"
            "SelectType=select/cons_tres\nSelectTypeParameters=CR_Core\nReturnToService=2\nKillWait=2\n"
            f"SlurmctldPort={one}\nSlurmdPort={other}\n"
            f"StateSaveLocation={self.where}/state\nSlurmdSpoolDir={self.where}/spool\n"
            f"SlurmctldPidFile={self.where}/ctld.pid\nSlurmdPidFile={self.where}/d.pid\n"
            f"NodeName={self._host} NodeAddr=127.0.0.1 CPUs=2 RealMemory=4000\n"
            "PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP\n"
        )
        (self.where / "bin").mkdir()
        command = self.where / "bin/mountnav"
        command.write_text(f'#!/bin/sh\nexec {sys.executable} -m api.main "$@"\n')
        command.chmod(0o755)
        self._begin(
            *("munged", "--foreground", "--force", f"--key-file={key}", f"--socket={munge}/socket"),
            *(f"--pid-file={munge}/pid", f"--log-file={munge}/log", f"--seed-file={munge}/seed"),
        )
        self.until(lambda: (munge / "socket").exists())
        self._begin("slurmctld", "-D")
        self._begin("slurmd", "-D")
        self.until(lambda: "idle" in self.said("sinfo", "-h", "-o", "%T"))

    def _begin(self, *command: str) -> None:
        with open(self.where / f"{command[0]}.out", "wb") as out:
            self._daemons.append(
                subprocess.Popen(command, env=self.environment, cwd=self.where, stdout=out, stderr=out)
            )

    def said(self, *command: str, check: bool = False) -> str:
        return subprocess.run(
            command, env=self.environment, cwd=self.where, capture_output=True, text=True, check=check
        ).stdout

    def submit(self, script: Path) -> str:
        """The number of the array."""
        return self.said("sbatch", "--parsable", str(script), check=True).strip()

    def running(self) -> list[str]:
        return self.said("squeue", "-h", "-r", "-t", "R", "-o", "%i").split()

    def until_idle(self) -> None:
        # a job that was requeued waits for two minutes, unless it is told not to
        for job in self.said("squeue", "-h", "-r", "-t", "PD", "-o", "%i").split():
            self.said("scontrol", "update", f"jobid={job}", "StartTime=now")
        self.until(lambda: not self.said("squeue", "-h").strip())

    def until(self, true: Callable[[], bool]) -> None:
        """Wait, as long as the daemons run."""
        while not true():
            for daemon in self._daemons:
                assert daemon.poll() is None, f"{daemon.args!r} ended: see {self.where}"
            time.sleep(0.1)

    def stop(self) -> None:
        self.said("scancel", "--user=root")
        if all(daemon.poll() is None for daemon in self._daemons):
            self.until(lambda: not self.running())
        for daemon in reversed(self._daemons):
            daemon.terminate()
            daemon.wait()


def _free_ports() -> tuple[int, int]:
    with socket.socket() as one, socket.socket() as other:
        one.bind(("127.0.0.1", 0))
        other.bind(("127.0.0.1", 0))
        return one.getsockname()[1], other.getsockname()[1]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[_Cluster]:
    """A Slurm that runs."""
    made = _Cluster(tmp_path)
    try:
        made.start()
        yield made
    finally:
        made.stop()


def _script(archive: Path) -> str:
    """The page's own script, for this archive and fewer parts."""
    (block,) = re.findall(r"^Slurm:\n\n((?:    .*\n)+)", PAGE.read_text(), re.MULTILINE)
    text = re.sub(r"^    ", "", block, flags=re.MULTILINE)
    return text.replace("1-1000", f"1-{PARTS}").replace("/1000", f"/{PARTS}").replace(" A ", f" {archive} ")


def _worker(archive: Path, part: str) -> int | None:
    """The process that does this part."""
    words = f"archive\0work\0{archive}\0--chunk\0{part}\0".encode()
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if words in path.read_bytes() and b"slurm_script" not in path.read_bytes():
                return int(path.parent.name)
        except OSError:
            continue
    return None


def test_the_documented_script_cancelled_requeued_and_killed_gives_the_same_bytes(
    cluster: _Cluster, tmp_path: Path
) -> None:
    table = draw(tmp_path / "drawn", 64, seed=8)
    peace, archive = tmp_path / "peace", tmp_path / "archive"
    for path in (peace, archive):
        run_here("archive", "init", path, "--frames", table, "--chunk-frames", "4", *SOLVING)
    assert run_here("archive", "work", peace).returncode == 0
    script = tmp_path / "job.sh"
    script.write_text(_script(archive))
    job = cluster.submit(script)
    hurt = set()

    def hurts() -> bool:
        """One is requeued, one cancelled, of one the process is killed, each in the middle of its work."""
        for name in cluster.running():
            part = name.partition("_")[2]
            worker = _worker(archive, f"{part}/{PARTS}")
            if part in hurt or worker is None or not any(Folder.open(archive).run(None).making.iterdir()):
                continue
            if part == "1":
                cluster.said("scontrol", "requeue", name, check=True)
            elif part == "2":
                cluster.said("scancel", name, check=True)
            elif part == "3":
                os.kill(worker, signal.SIGKILL)
            hurt.add(part)
        return len(hurt) == PARTS

    cluster.until(hurts)
    cluster.until_idle()
    told = cluster.said("scontrol", "show", "job", job)
    # the one that was requeued has run to its end since
    assert len(re.findall(r"JobState=COMPLETED", told)) == 2, told
    assert len(re.findall(r"JobState=CANCELLED", told)) == 1, told
    assert len(re.findall(r"JobState=FAILED", told)) == 1, told
    run = Folder.open(archive).run(None)
    assert len(run.done()) < 16
    cluster.submit(script)
    cluster.until_idle()
    assert tree(run.chunks) == tree(Folder.open(peace).run(None).chunks)
    assert not any(run.making.iterdir())
    assert run_here("archive", "verify", archive).returncode == 0
