"""The process that solves: everything opened and imported once, then one frame after the other.

It is started by `api.solver.link`, never by hand: ``python -m api.solver.process DESCRIPTOR``. It ends when
the other end of its socket is closed, also in the middle of a solve, so that no service leaves one behind.
It reads strangers' files: what it may take of the computer is bounded (`api.solver.limits`), and what it
answers is data (`api.solver.messages`). Before its first task it solves a drawn frame each way there is, so
that no real one pays for imports.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import mmap
import os
import select
import time
import traceback
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from api.solver.attached import attached
from api.solver.limits import allow_cpu_s, own_memory_mb
from api.solver.messages import Done, Fault, Read, Ready, Setup, SharedPixels, Task, receive, send
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame, BadSettings, MountnavError
from mountnav.frames import Frame, Hint
from mountnav.reading import ListFormat, read_frame
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Verdict
from mountnav.solving.solve import SolveSettings, solve, solve_file, solve_source

if TYPE_CHECKING:
    from mountnav.identification.blind.index import BlindIndex
    from mountnav.measuring.calibration import Calibration


_PLACE = Icrs(85.0, 30.0)
"""Center of the drawn frame, in Auriga near the galactic plane; chosen by hand. Any field with enough
catalog stars does."""
_SCALE_ARCSEC_PX = 6.0
"""Scale of the drawn frame, arcsec/px: 1.3° by 1° for the small one. Halved, it has a quarter of the
stars."""
_INSTANT = datetime(2026, 1, 1, tzinfo=UTC)
"""Instant of the drawn frame; fixed, so that each start computes the same."""
_SMALL, _LARGE = (800, 600), (3000, 2200)
"""Width and height, pixels. A large frame's buffers are got from the system once, by the drawn one."""
_BLOCK_BYTES = 2880
"""Bytes of a FITS block [FITS standard 4.0 §3.1]."""


def warmed_up(catalog: Catalog, index: BlindIndex | None) -> tuple[str, ...]:
    """Solve a drawn frame at a glance, in full, blind, and from a file.

    Returns
    -------
    tuple of str
        What went wrong, for the log: a process that fails here may still solve real frames.
    """
    for mapped in (getattr(catalog, "path", None), None if index is None else index.path):
        if isinstance(mapped, Path):
            _read_ahead(mapped)
    frame, large = (
        draw_frame(
            _PLACE,
            SimulatedOptics(width_px, height_px, _SCALE_ARCSEC_PX),
            catalog,
            exposure_s=2.0,
            mid_exposure_utc=_INSTANT,
            seed=(0, 1),
        )
        for width_px, height_px in (_SMALL, _LARGE)
    )
    hint = Hint(
        center=_PLACE,
        radius_deg=1.0,
        scale_low_arcsec_px=0.95 * _SCALE_ARCSEC_PX,
        scale_high_arcsec_px=1.05 * _SCALE_ARCSEC_PX,
    )
    settings = SolveSettings(budget_s=10.0)
    troubles: list[str] = []

    def tried(way: str, found: Verdict) -> None:
        if not found.solved:
            troubles.append(f"the drawn frame was not solved {way}: {found.reason} ({found.detail})")

    # a file without a name: it leaves nothing behind when the service is ended at this moment
    with os.fdopen(os.memfd_create("mountnav-drawn"), "wb") as file:
        file.write(as_fits(large))
        file.flush()
        found = solve_file(Path(f"/proc/self/fd/{file.fileno()}"), catalog, hint, settings=settings)
        tried("from a file", found)
    tried("in full", solve(frame, catalog, hint=hint, settings=replace(settings, glance=False)))
    if index is not None:
        everywhere = replace(settings, index=index, blind="only")
        tried("blind", solve(frame, catalog, hint=None, settings=everywhere))
    return tuple(troubles)


def _read_ahead(path: Path) -> None:
    """Ask the system to have a mapped file at hand; that costs this process no memory of its own."""
    file = os.open(path, os.O_RDONLY)
    try:
        os.posix_fadvise(file, 0, 0, os.POSIX_FADV_WILLNEED)
    finally:
        os.close(file)


def as_fits(frame: Frame) -> bytes:
    """The frame as cameras write it: unsigned 16 bits by BZERO."""
    height, width = frame.pixels.shape
    cards = [
        ("SIMPLE", "T"),
        ("BITPIX", "16"),
        ("NAXIS", "2"),
        ("NAXIS1", str(width)),
        ("NAXIS2", str(height)),
        ("BZERO", "32768"),
        ("BSCALE", "1"),
    ]
    header = "".join(f"{key:<8}= {value:>20}".ljust(80) for key, value in cards) + "END".ljust(80)
    header += " " * (-len(header) % _BLOCK_BYTES)
    pixels = (np.clip(frame.pixels, 0, 65535).astype(np.int32) - 32768).astype(">i2").tobytes()
    return b"".join((header.encode("ascii"), pixels, bytes(-len(pixels) % _BLOCK_BYTES)))


FRAMES_TO_WARM = 8
"""Frames after which a process that was not warmed holds what it goes on to hold; chosen by hand: one of each
kind of an archive."""

_IDLE_S = 0.5
"""After so long without a task freed memory is given back to the system, s; chosen by hand. Halved, it is
done between looks of a running series, too."""

_WORTH_TELLING_MB = 64.0
"""Memory that was not given back, from which on the process looks closer: the collector and the C library
may hold some of it. Frames leave up to 30 MB behind; doubled, twice as much stays unnoticed."""


class Bench:
    """What the process keeps between two frames."""

    def __init__(self, setup: Setup) -> None:
        self._catalog = setup.catalog
        self._calibrations: dict[int, Calibration] = {}
        self._index: BlindIndex | None = None
        self._trouble = ""
        self._damaged: tuple[Path, int] | None = None
        self._open(setup.index)

    def warmed_up(self) -> tuple[str, ...]:
        """Solve a drawn frame each way there is; return what went wrong."""
        try:
            return warmed_up(self._catalog, self._index)
        except BadSettings as error:
            if self._index is None:
                raise
            self._give_up_index(error)
            return (self._trouble,)

    def verdict(self, task: Task, file: int) -> Verdict:
        """Solve one frame, whose pixels or bytes lie in `file`; without the index if that is damaged."""
        try:
            return self._verdict(task, file)
        except BadSettings as error:
            if self._index is None or task.index is None:
                raise
            self._give_up_index(error)
            return self._verdict(replace(task, calibration=None), file)

    def _verdict(self, task: Task, file: int) -> Verdict:
        if task.calibration is not None and task.calibration_number is not None:
            self._calibrations[task.calibration_number] = task.calibration
        self._open(task.index)
        settings = replace(
            task.settings,
            calibration=None
            if task.calibration_number is None
            else self._calibrations[task.calibration_number],
            index=self._index if task.index is not None else None,
        )
        if isinstance(task.source, SharedPixels):
            frame = _frame(task.source, file)
            verdict = solve(frame, self._catalog, hint=task.hint, settings=settings)
        else:
            source = task.source
            verdict = solved_upload(
                file,
                source.name,
                self._catalog,
                task.hint,
                settings,
                stars=source.stars,
                hdu=source.hdu,
            )
        if self._trouble and task.index is not None:
            verdict = replace(verdict, notes=(*verdict.notes, self._trouble))
        return verdict

    def rest(self) -> None:
        """Release the index' pages, now that nobody waits; the system keeps them while it has room."""
        if self._index is not None:
            self._index.rest()

    def _open(self, index: Path | None) -> None:
        if index is None or (self._index is not None and self._index.path == index):
            return
        if self._damaged is not None and self._damaged == (index, _written(index)):
            return
        from mountnav.identification.blind.index import BlindIndex

        try:
            self._index, self._trouble = BlindIndex.open(index), ""
        except MountnavError as error:
            self._index, self._trouble = None, f"no blind search: {error}"

    def _give_up_index(self, error: BadSettings) -> None:
        """Damage that shows in use costs the blind search, not what a hint finds; a new file is tried."""
        assert self._index is not None
        self._damaged = self._index.path, _written(self._index.path)
        self._index, self._trouble = None, f"no blind search: {error}"


def _written(path: Path) -> int:
    """When the file there was written, ns; 0 if there is none."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def solved_upload(
    file: int,
    name: str,
    catalog: Catalog,
    hint: Hint | None,
    settings: SolveSettings,
    *,
    stars: ListFormat | None = None,
    hdu: int | str | None = None,
) -> Verdict:
    """Read and solve an upload, an image or a list of stars, that lies in an open file.

    Raises
    ------
    BadFrame
        It is neither.
    """
    # by the name of an open file: anyone who reads it may map it, and nothing is copied for it
    path = Path(f"/proc/self/fd/{file}")
    return solve_source(path, catalog, hint, name=name, hdu=hdu, settings=settings, stars=stars)


def _frame(source: SharedPixels, file: int) -> Frame:
    """The frame on pixels that are mapped, not copied; they live as long as the frame."""
    length = os.fstat(file).st_size
    mapped = mmap.mmap(file, length, flags=mmap.MAP_SHARED | mmap.MAP_POPULATE, prot=mmap.PROT_READ)
    return replace(source.frame, pixels=np.frombuffer(mapped, dtype=source.dtype).reshape(source.shape))


def sendable(error: Exception) -> Fault:
    """The error as it can be sent: with its way through the code as a note."""
    told = "".join(traceback.format_exception(error))
    error.add_note(f"in the solving process:\n{told}")
    return Fault.of(error)


def read_into(file: int, pixels: int, name: str) -> Done:
    """Read a frame from one open file, and write its pixels into the other.

    Raises
    ------
    BadFrame
    """
    frame = read_frame(Path(f"/proc/self/fd/{file}"), name=name, raw=True)
    plain = np.ascontiguousarray(frame.pixels)
    left = plain.reshape(-1).view(np.uint8).data
    while left:
        left = left[os.write(pixels, left) :]
    bare = replace(frame, pixels=np.empty((0, 0), plain.dtype))
    return Done(frame=bare, dtype=plain.dtype.str, shape=plain.shape)


def _carried_out(bench: Bench, task: Task | Read, files: list[int], more_cpu_s: float) -> Done:
    """The task's outcome, an error included."""
    try:
        if isinstance(task, Read):
            allow_cpu_s(more_cpu_s)
            return read_into(files[0], files[1], task.name)
        allow_cpu_s(task.settings.budget_s + more_cpu_s)
        return Done(verdict=bench.verdict(task, files[0]))
    except MemoryError:
        fault = BadFrame(
            "it needs more memory than the solver may use",
            device=task.name,
            advice="send a smaller image, or raise solving.memory_mb",
        )
        return Done(fault=Fault.of(fault))
    except Exception as error:  # it belongs to the one who asked
        return Done(fault=sendable(error))


def _give_back() -> None:
    """Return the memory of the last frames to the system, now that nobody waits: 20 to 60 MB."""
    with contextlib.suppress(OSError, AttributeError):  # the C library may have no such function
        ctypes.CDLL(None).malloc_trim(0)


def _grown_mb(at_first_mb: float) -> float:
    """Memory that the last tasks left behind, after all of it was given back that can be."""
    if own_memory_mb() - at_first_mb > _WORTH_TELLING_MB:
        gc.collect()
        _give_back()
    return max(0.0, own_memory_mb() - at_first_mb)


def main() -> None:
    """Set up, warm up, then solve until the service is gone."""
    began = time.monotonic()
    link = attached()
    try:
        setup, _ = receive(link)
        assert isinstance(setup, Setup)
        setup.limits.impose()
        bench = Bench(setup)
        troubles = bench.warmed_up() if setup.warm else ()
        # where cores are scarce, a stop and a state go before a solve
        os.nice(setup.niceness)
        # what is here by now stays: the collector needn't go through it again during a solve
        gc.collect()
        gc.freeze()
        send(link, Ready(time.monotonic() - began, troubles))
        # what the first frames load belongs to the process: one that isn't warm is weighed after some
        at_first_mb, unweighed = own_memory_mb(), 0 if setup.warm else FRAMES_TO_WARM
        while True:
            if not select.select([link], [], [], _IDLE_S)[0]:
                _give_back()
                bench.rest()
            task, files = receive(link)
            assert isinstance(task, (Task, Read))
            try:
                done = _carried_out(bench, task, files, setup.limits.more_cpu_s)
            finally:
                for file in files:
                    os.close(file)
            del task
            if unweighed:
                unweighed -= 1
                at_first_mb = max(at_first_mb, own_memory_mb())
            send(link, replace(done, grown_mb=_grown_mb(at_first_mb)))
    except (EOFError, OSError):
        return


if __name__ == "__main__":
    main()
