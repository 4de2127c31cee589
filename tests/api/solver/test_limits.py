"""The solver's process is bound: memory, CPU time, files; what goes beyond is told, the next is solved."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from api.solver import worker as solver_worker
from api.solver.limits import Limits, own_memory_mb
from api.solver.link import Upload, Work
from api.solver.worker import GROWN_MB, Worker
from mountnav.catalog.embedded import embedded_catalog
from mountnav.errors import BadFrame
from mountnav.frames import Frame, Hint
from mountnav.solution import Reason
from mountnav.solving.solve import SolveSettings
from tests.api.solver.moody_catalog import COMPUTES, MoodyCatalog

NOTHING = SolveSettings(blind="never", budget_s=1.0)
HERE = Hint(scale_low_arcsec_px=3.8, scale_high_arcsec_px=4.2)

_EPS = b"""%!PS-Adobe-3.0 EPSF-3.0
%%BoundingBox: 0 0 100 100
%%EndComments
100 100 lineto
%%EOF
"""
_READ_IT = """
import sys
from mountnav.errors import BadFrame
from mountnav.reading import read_frame
try:
    read_frame(open(sys.argv[1], "rb").read())
except BadFrame as told:
    print(told)
"""


def _plain_fits(width_px: int, height_px: int, bits: int = 8) -> bytes:
    cards: tuple[str, ...] = (
        "SIMPLE  =                    T",
        f"BITPIX  = {bits:20d}",
        "NAXIS   =                    2",
    )
    cards += (f"NAXIS1  = {width_px:20d}", f"NAXIS2  = {height_px:20d}", "END")
    return "".join(card.ljust(80) for card in cards).ljust(2880).encode()


def test_an_eps_starts_no_other_program(tmp_path: Path) -> None:
    started = tmp_path / "started"
    for name in ("gs", "gswin32c"):
        program = tmp_path / name
        program.write_text(f"#!/bin/sh\ntouch {started}\necho 10.0\n")
        program.chmod(0o755)
    picture = tmp_path / "picture.png"
    picture.write_bytes(_EPS)
    environment = {
        **os.environ,
        "PATH": f"{tmp_path}:{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    said = subprocess.run(
        [sys.executable, "-c", _READ_IT, str(picture)], env=environment, capture_output=True, text=True
    )
    assert "not an image of a kind that can be read" in said.stdout, said
    assert not started.exists()


@pytest.mark.long
def test_the_limits_bind_their_process_for_good() -> None:
    told = subprocess.run(
        [
            sys.executable,
            "-c",
            "import numpy, resource\n"
            "from api.solver.limits import Limits\n"
            "Limits(memory_mb=600).impose()\n"
            "names = 'RLIMIT_DATA', 'RLIMIT_NOFILE', 'RLIMIT_FSIZE', 'RLIMIT_CORE'\n"
            "print([resource.getrlimit(getattr(resource, name)) for name in names])\n"
            "numpy.ones(60_000_000)\n"
            "try: numpy.ones(90_000_000)\n"
            "except MemoryError: print('bound')\n",
        ],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    limits, bound = told.stdout.splitlines()
    assert limits.startswith("[(600000000, 600000000), (256, 256), (2500000000, 2500000000), (0, 0)]")
    assert bound == "bound"


def test_the_default_leaves_half_of_the_computer() -> None:
    whole = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    assert 0 < Limits().memory_bytes <= min(4_000_000_000, whole / 2)
    assert 1.0 < own_memory_mb() < 10_000.0


@pytest.mark.long
async def test_a_frame_that_needs_too_much_is_told_and_the_next_is_read(tmp_path: Path) -> None:
    worker = Worker(embedded_catalog(), lambda *_: None, limits=Limits(memory_mb=600), idle_s=60.0)
    before = resource.getrlimit(resource.RLIMIT_DATA)
    try:
        with tempfile.TemporaryFile() as file:
            file.write(_plain_fits(16000, 17000, 16))
            file.truncate(2880 * 200_000)  # nothing but holes
            with pytest.raises(BadFrame, match=r"more memory than the solver may use.*solving\.memory_mb"):
                await worker.solve(Work(Upload("big.fits", file.fileno()), HERE, NOTHING), first=False)
            with pytest.raises(BadFrame, match="more memory than the solver may use"):
                await worker.read(Upload("big.fits", file.fileno()))
        pid = worker.pid
        pixels = np.arange(40 * 50, dtype=np.uint8).reshape(40, 50)
        with tempfile.TemporaryFile() as file:
            file.write(_plain_fits(50, 40) + pixels.tobytes().ljust(2880, b"\0"))
            file.flush()
            frame = await worker.read(Upload("small.fits", file.fileno()))
        assert np.array_equal(frame.pixels, pixels)
        assert frame.source == "small.fits"
        assert worker.pid == pid
    finally:
        await worker.close()
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


@pytest.mark.long
async def test_what_computes_without_end_is_ended_by_the_kernel(tmp_path: Path) -> None:
    pixels = np.random.default_rng(1).normal(500, 10, (400, 400)).astype(np.float32)
    pixels[50:350:60, 50:350:60] += 5000
    frame = Frame(pixels)
    worker = Worker(MoodyCatalog(tmp_path), lambda *_: None, limits=Limits(more_cpu_s=0.0))
    try:
        near = Hint(center=COMPUTES, scale_low_arcsec_px=3.8, scale_high_arcsec_px=4.2)
        verdict = await worker.solve(
            Work(frame, near, SolveSettings(blind="never", budget_s=0.2)), first=True
        )
        assert verdict.reason is Reason.TIMED_OUT
        assert "CPU time" in verdict.detail
    finally:
        await worker.close()


@pytest.mark.long
def test_memory_that_is_held_is_told_and_what_was_given_back_is_not() -> None:
    """In a process of its own: one that has run other tests has room inside for what is to be held."""
    program = (
        "import numpy as np; from api.solver.limits import own_memory_mb\n"
        "from api.solver.process import _grown_mb\n"
        "at_first_mb = own_memory_mb(); held = np.ones(300_000_000 // 8); print(_grown_mb(at_first_mb))\n"
        "del held; print(_grown_mb(at_first_mb))"
    )
    told = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    while_held_mb, after_mb = map(float, told.split())
    assert 280.0 < while_held_mb < 400.0
    assert after_mb < 100.0


@pytest.mark.long
async def test_a_process_that_grew_is_replaced_after_its_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[object] = []
    pixels = np.arange(40 * 50, dtype=np.uint8).reshape(40, 50)
    worker = Worker(embedded_catalog(), lambda kind, data: told.append(data["state"]), idle_s=60.0)
    try:
        with tempfile.TemporaryFile() as file:
            file.write(_plain_fits(50, 40) + pixels.tobytes().ljust(2880, b"\0"))
            file.flush()
            pids = []
            # below nothing at all: any process is too big
            for most_mb in (GROWN_MB, GROWN_MB, -1.0, GROWN_MB):
                monkeypatch.setattr(solver_worker, "GROWN_MB", most_mb)
                frame = await worker.read(Upload("small.fits", file.fileno()))
                assert np.array_equal(frame.pixels, pixels)
                pids.append(worker.pid)
        assert pids[0] == pids[1] != pids[3], pids
        assert pids[3] is not None
        assert any("replaced" in str(state) for state in told)
    finally:
        await worker.close()
