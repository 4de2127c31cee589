"""The warm worker: a real process, real frames, and everything that can go wrong with it."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from api.problems import Refused
from api.solver.link import ProcessLink, Upload, Work
from api.solver.messages import Task
from api.solver.worker import Worker
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame, DeviceError
from mountnav.frames import Frame, Hint
from mountnav.measuring.calibration import Calibration
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Reason
from mountnav.solving.solve import SolveSettings
from tests.api.solver.moody_catalog import DIES, DIES_ONCE, FAILS, HANGS, MoodyCatalog

TRUTH = Icrs(85.0, 30.0)
SCALE_ARCSEC_PX = 4.0
SETTINGS = SolveSettings(blind="never")


@pytest.fixture(scope="module")
def frame() -> Frame:
    instant = datetime(2026, 11, 21, tzinfo=UTC)
    optics = SimulatedOptics(800, 600, SCALE_ARCSEC_PX)
    return draw_frame(
        TRUTH, optics, embedded_catalog(), exposure_s=2.0, mid_exposure_utc=instant, seed=(1, 2)
    )


@asynccontextmanager
async def opened(
    catalog: Catalog, *, margin_s: float = 30.0, told: list[object] | None = None
) -> AsyncIterator[Worker]:
    worker = Worker(
        catalog,
        lambda kind, data: None if told is None else told.append(data["state"]),
        margin_s=margin_s,
        grace_s=0.2,
    )
    worker.open(None)
    try:
        async with asyncio.timeout(90):
            yield worker
    finally:
        await worker.close()


def _near(place: Icrs) -> Hint:
    return Hint(center=place, scale_low_arcsec_px=3.8, scale_high_arcsec_px=4.2)


def _gone(pid: int) -> bool:
    """Whether a process has ended, waited for by its parent or not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return True
    return state == "Z"


@pytest.mark.long
async def test_frames_and_uploads_come_back_solved_and_masters_go_over_once(
    frame: Frame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[Task] = []
    ask = ProcessLink.ask

    async def overheard(self: ProcessLink, message: object, *files: int) -> object:
        sent.extend([message] if isinstance(message, Task) else [])
        return await ask(self, message, *files)

    monkeypatch.setattr(ProcessLink, "ask", overheard)
    settings = replace(SETTINGS, calibration=Calibration(tmp_path, ()))
    # pixels in the other byte order and not in one piece, as a driver may hand them over
    odd = np.repeat(frame.pixels, 2, axis=1)[:, ::2].astype(
        ">u2" if frame.pixels.dtype.kind == "u" else ">f4"
    )
    async with opened(embedded_catalog()) as worker:
        for one in (frame, replace(frame, pixels=odd)):
            verdict = await worker.solve(Work(one, _near(TRUTH), settings), first=True)
            assert verdict.solution is not None, verdict
            assert separation_arcsec(verdict.solution.center, TRUTH) < SCALE_ARCSEC_PX
            assert verdict.notes, "the masters were asked"
        assert [task.calibration is None for task in sent] == [False, True]
        assert all(task.settings.calibration is None for task in sent)
        # what lies in the file is what is read, wherever its position is
        with tempfile.TemporaryFile() as file:
            file.write(b"this is not an image" * 100)
            file.flush()
            with pytest.raises(BadFrame) as told:
                await worker.solve(Work(Upload("x.fits", file.fileno()), None, SETTINGS), first=False)
        assert told.value.device == "x.fits"
        assert told.value.advice
        assert worker.state == "ready"


@pytest.mark.long
async def test_looks_go_before_uploads_and_each_in_turn(frame: Frame) -> None:
    order: list[str] = []

    async def asked(worker: Worker, name: str, *, first: bool) -> None:
        await worker.solve(Work(frame, _near(TRUTH), SETTINGS), first=first)
        order.append(name)

    async with opened(embedded_catalog()) as worker:
        await worker.solve(Work(frame, _near(TRUTH), SETTINGS), first=True)
        waiting = []
        for name in ("upload 1", "upload 2", "upload 3", "look 1", "look 2"):
            waiting.append(asyncio.create_task(asked(worker, name, first=name.startswith("look"))))
            await asyncio.sleep(0)
        await asyncio.gather(*waiting)
    # the queue is emptied in the order of worth, whether or not the first upload was under way already
    assert order.index("look 1") < order.index("look 2") < order.index("upload 2")
    assert [name for name in order if name.startswith("upload")] == ["upload 1", "upload 2", "upload 3"]


@pytest.mark.long
async def test_a_cancelled_caller_is_free_at_once_and_the_next_is_served(
    frame: Frame, tmp_path: Path
) -> None:
    told: list[object] = []
    async with opened(MoodyCatalog(tmp_path), told=told) as worker:
        hanging = asyncio.create_task(worker.solve(Work(frame, _near(HANGS), SETTINGS), first=True))
        while worker.state != "solving":
            await asyncio.sleep(0.01)
        before = worker.pid
        hanging.cancel()
        done, _ = await asyncio.wait({hanging}, timeout=0.15)  # less than the grace
        assert done
        verdict = await worker.solve(Work(frame, _near(TRUTH), SETTINGS), first=False)
        assert verdict.solved
        assert worker.pid != before
        assert before is not None
        assert _gone(before)
    assert "ended: nobody waits for its frame any more" in told


@pytest.mark.long
async def test_a_solve_without_end_is_ended(frame: Frame, tmp_path: Path) -> None:
    async with opened(MoodyCatalog(tmp_path), margin_s=0.3) as worker:
        settings = replace(SETTINGS, budget_s=0.2)
        verdict = await worker.solve(Work(frame, _near(HANGS), settings), first=True)
        assert verdict.reason is Reason.TIMED_OUT
        assert (await worker.solve(Work(frame, _near(TRUTH), SETTINGS), first=True)).solved


@pytest.mark.long
async def test_a_death_is_made_good_once_and_then_told(frame: Frame, tmp_path: Path) -> None:
    async with opened(MoodyCatalog(tmp_path)) as worker:
        short = replace(SETTINGS, budget_s=0.5)
        again = await worker.solve(Work(frame, _near(DIES_ONCE), short), first=True)
        assert (tmp_path / "died").exists()
        assert not again.solved
        with pytest.raises(DeviceError, match="died twice"):
            await worker.solve(Work(frame, _near(DIES), SETTINGS), first=True)
        with pytest.raises(ZeroDivisionError, match="a bug") as fault:
            await worker.solve(Work(frame, _near(FAILS), SETTINGS), first=True)
        assert "moody_catalog.py" in "".join(fault.value.__notes__)
        assert (await worker.solve(Work(frame, _near(TRUTH), SETTINGS), first=True)).solved


async def test_a_fault_over_a_frame_whose_caller_left_is_logged(
    frame: Frame, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    begun, left, over = asyncio.Event(), asyncio.Event(), asyncio.Event()

    async def started(_: Worker) -> None:
        if left.is_set():
            over.set()

    async def faulty(*_: object) -> None:
        begun.set()
        await left.wait()
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(Worker, "_start", started)
    monkeypatch.setattr(Worker, "_carried_out", faulty)
    async with opened(embedded_catalog()) as worker:
        asking = asyncio.create_task(worker.solve(Work(frame, None, SETTINGS), first=True))
        await begun.wait()
        asking.cancel()
        await asyncio.wait({asking})
        left.set()
        await over.wait()
    assert [one.exc_info[0] for one in caplog.records if one.exc_info] == [ZeroDivisionError]


@pytest.mark.long
async def test_closing_ends_the_process_and_refuses_who_waits(frame: Frame, tmp_path: Path) -> None:
    async with opened(MoodyCatalog(tmp_path)) as worker:
        waiting = [
            asyncio.create_task(worker.solve(Work(frame, _near(HANGS), SETTINGS), first=True))
            for _ in range(2)
        ]
        while worker.state != "solving":
            await asyncio.sleep(0.01)
        pid = worker.pid
        await worker.close()
        for one in waiting:
            with pytest.raises(Refused):
                await one
    assert pid is not None
    assert _gone(pid)


_PARENT = """
import asyncio, sys
from pathlib import Path
from tests.api.solver.moody_catalog import HANGS, MoodyCatalog
from api.solver.link import Work
from api.solver.worker import Worker
from mountnav.frames import Frame, Hint
from mountnav.solving.solve import SolveSettings
import numpy as np

async def main():
    worker = Worker(MoodyCatalog(Path(sys.argv[1])), lambda kind, data: None)
    frame = Frame(np.random.default_rng(1).normal(500, 10, (400, 400)).astype(np.float32))
    frame.pixels[50:350:60, 50:350:60] += 5000
    hint = Hint(center=HANGS, scale_low_arcsec_px=3.8, scale_high_arcsec_px=4.2)
    solving = asyncio.create_task(worker.solve(Work(frame, hint, SolveSettings(blind="never")), first=True))
    while worker.state != "solving":
        await asyncio.sleep(0.01)
    print(worker.pid, flush=True)
    await solving

asyncio.run(main())
"""


@pytest.mark.long
def test_a_killed_service_leaves_no_process_behind(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    parent = subprocess.Popen(
        [sys.executable, "-c", _PARENT, str(tmp_path)], stdout=subprocess.PIPE, env=environment, text=True
    )
    assert parent.stdout is not None
    with parent.stdout as said:
        pid = int(said.readline())
        signal.sigtimedwait([], 0.5)  # deep in its solve
        assert not _gone(pid)
        parent.kill()
        parent.wait()
        # the process holds nothing that would end with its parent but the line to it
        for _ in range(500):
            if _gone(pid):
                return
            signal.sigtimedwait([], 0.02)
    os.kill(pid, signal.SIGKILL)
    pytest.fail("the solver lives on")
