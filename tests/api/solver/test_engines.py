"""The pool and the cluster: the same answers as one process gives, whatever dies or hangs meanwhile."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from api.solver.link import Work
from api.solver.messages import Done, written
from api.solver.pool import Pool
from api.solver.solver import Solver
from mountnav.catalog.catalog_set import open_catalogs
from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame, Hint
from mountnav.settings.solver import SolverSettings
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Times, Verdict
from mountnav.solving.solve import SolveSettings, solve
from tests.api.solver.moody_catalog import HANGS, MoodyCatalog

TRUTH = Icrs(85.0, 30.0)
SETTINGS = SolveSettings(blind="never")
NEAR = Hint(center=TRUTH, scale_low_arcsec_px=3.8, scale_high_arcsec_px=4.2)


@pytest.fixture(scope="module")
def frame() -> Frame:
    instant = datetime(2026, 11, 21, tzinfo=UTC)
    optics = SimulatedOptics(800, 600, 4.0)
    return draw_frame(
        TRUTH, optics, embedded_catalog(), exposure_s=2.0, mid_exposure_utc=instant, seed=(1, 2)
    )


def _bytes(verdict: Verdict) -> bytes:
    """All of an answer but how long it took."""
    return written(Done(verdict=replace(verdict, times=Times())))


async def _until(what: Callable[[], bool]) -> None:
    """No event tells it: the other end is a process."""
    async with asyncio.timeout(120):
        while not what():
            await asyncio.sleep(0.02)


@pytest.mark.long
async def test_a_storm_that_hangs_keeps_no_other_telescope_waiting_and_a_killed_process_no_look(
    frame: Frame, tmp_path: Path
) -> None:
    told: list[dict[str, object]] = []
    pool = Pool(MoodyCatalog(tmp_path), lambda kind, data: told.append(data), size=2)
    pool.open(None)
    hangs = Work(frame, replace(NEAR, center=HANGS), SETTINGS)
    near = Work(frame, NEAR, SETTINGS)
    try:
        storm = [asyncio.create_task(pool.solve(hangs, first=True, owner="east")) for _ in range(4)]
        await _until(lambda: pool.state == "solving")
        # one of two processes is with the storm, whose others wait; west has the other at once
        verdict = await pool.solve(near, first=True, owner="west")
        assert verdict.solved
        assert not any(one.done() for one in storm)
        for one in storm:
            one.cancel()
        await asyncio.gather(*storm, return_exceptions=True)
        # one dies in the middle: the look is solved all the same, by the next one
        asking = asyncio.create_task(pool.solve(near, first=True, owner="west"))
        await _until(lambda: pool.state == "solving")
        for pid in pool.pids:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        killed = await asking
        assert _bytes(killed) == _bytes(verdict)
        assert {one.get("process") for one in told} >= {"pool 1", "pool 2"}
    finally:
        await pool.close()


class _Site:
    """A scheduler and a worker of Dask, and a solver that asks them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.told: list[str] = []
        self._processes: list[subprocess.Popen[bytes]] = []

    def scheduler(self) -> subprocess.Popen[bytes]:
        file = self._folder / "scheduler.json"
        return self._begun("distributed.cli.dask_scheduler", "--port", "0", "--scheduler-file", str(file))

    async def address(self) -> str:
        file = self._folder / "scheduler.json"
        await _until(file.exists)
        return str(json.loads(file.read_text())["address"])

    def worker(self, address: str) -> subprocess.Popen[bytes]:
        return self._begun("distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny")

    def _begun(self, module: str, *arguments: str) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments, "--no-dashboard"],
            cwd=self._folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._processes.append(process)
        return process

    def end(self) -> None:
        for process in self._processes:
            process.kill()
            process.wait()

    @asynccontextmanager
    async def solver(self, address: str, *, deadline_s: float = 60.0) -> AsyncIterator[Solver]:
        solver = Solver(
            open_catalogs(),
            worker=True,
            tell=lambda kind, data: self.told.append(str(data["state"])),
            engine=SolverSettings(engine="dask", scheduler=address, deadline_s=deadline_s),
        )
        try:
            yield solver
        finally:
            await solver.close()


@pytest.mark.long
async def test_the_cluster_answers_as_the_service_does_and_whatever_dies_there_the_look_is_answered(
    frame: Frame, tmp_path: Path
) -> None:
    pytest.importorskip("distributed")
    site = _Site(tmp_path)
    try:
        scheduler = site.scheduler()
        address = await site.address()
        own = _bytes(solve(frame, open_catalogs(), hint=NEAR, settings=SETTINGS))
        async with site.solver(address) as solver:
            look = solver.of("east")
            cluster = solver.cluster
            assert cluster is not None
            # no worker yet: the service's own pool, at once
            assert _bytes(await look(frame, NEAR, SETTINGS)) == own
            assert "away" in solver.engine
            assert solver.concern is not None
            worker = site.worker(address)
            await _until(lambda: cluster.state == "1 worker")
            assert solver.concern is None
            assert _bytes(await look(frame, NEAR, SETTINGS)) == own
            assert not [one for one in site.told if "solved here" in one]
            # killed in the middle, and with it the only copy of the frame there
            worker.send_signal(signal.SIGSTOP)
            asking = asyncio.create_task(look(frame, NEAR, SETTINGS))
            await _until(lambda: bool(cluster._answers))
            worker.kill()
            assert _bytes(await asking) == own
            assert [one for one in site.told if "solved here" in one]
            await _until(lambda: cluster.state.startswith("away"))
            # the process that speaks with it
            assert cluster.pid is not None
            os.kill(cluster.pid, signal.SIGKILL)
            assert _bytes(await look(frame, NEAR, SETTINGS)) == own
            scheduler.kill()
            assert _bytes(await look(frame, NEAR, SETTINGS)) == own
            await _until(lambda: "scheduler doesn't answer" in cluster.state)
    finally:
        site.end()


@pytest.mark.long
async def test_a_cluster_that_is_slow_costs_one_look_its_deadline_and_the_next_ones_nothing(
    frame: Frame, tmp_path: Path
) -> None:
    pytest.importorskip("distributed")
    site = _Site(tmp_path)
    try:
        site.scheduler()
        address = await site.address()
        worker = site.worker(address)
        async with site.solver(address, deadline_s=0.1) as solver:
            solver.open()
            cluster = solver.cluster
            assert cluster is not None
            await _until(lambda: cluster.state == "1 worker")
            worker.send_signal(signal.SIGSTOP)
            assert (await solver.of("east")(frame, NEAR, SETTINGS)).solved
            assert "a look is solved here: no answer within 0.1 s" in site.told
            assert cluster.state == "away: no answer within 0.1 s"
            asked = next(cluster._numbers)
            assert (await solver.of("east")(frame, NEAR, SETTINGS)).solved
            assert next(cluster._numbers) == asked + 1, "it was asked though it had been slow"
    finally:
        site.end()


def test_settings_tell_what_is_missing() -> None:
    with pytest.raises(ValueError, match="needs the address of a scheduler"):
        SolverSettings(engine="dask")
    for wrong in ("10.0.0.5:8786", "http://a:1", "tcp://a", "tcp://a:1/x"):
        with pytest.raises(ValueError, match="not the address of a scheduler"):
            SolverSettings(engine="dask", scheduler=wrong)
