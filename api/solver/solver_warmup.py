"""The first frame of the night is a drawn one, solved each way there is: no real one pays for imports."""

from __future__ import annotations

import os
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mountnav.catalog.stars import Catalog
from mountnav.frames import Frame, Hint
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Verdict
from mountnav.solving.solve import SolveSettings, solve, solve_file

if TYPE_CHECKING:
    from mountnav.identification.blind.index import BlindIndex

_PLACE = Icrs(85.0, 30.0)
_SCALE_ARCSEC_PX = 6.0
_INSTANT = datetime(2026, 1, 1, tzinfo=UTC)
_SMALL, _LARGE = (800, 600), (3000, 2200)
"""Width and height, pixels. A large frame's buffers are got from the system once, by the drawn one."""
_BLOCK_BYTES = 2880


def warmed_up(catalog: Catalog, index: BlindIndex | None) -> tuple[str, ...]:
    """Solve a drawn frame at a glance, in full, blind, and from a file.

    Parameters
    ----------
    catalog : Catalog
    index : BlindIndex or None

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
