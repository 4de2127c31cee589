"""Small drawn frames, and how they are solved without an index of the sky."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from api.solver.process import as_fits
from mountnav.catalog.embedded import embedded_catalog
from mountnav.reading.fits_update import updated_fits
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs

PLACE = Icrs(85.0, 30.0)
SCALE_ARCSEC_PX = 6.0
INSTANT = datetime(2026, 1, 1, tzinfo=UTC)
HINT = ("--ra", "85", "--dec", "+30:00:00", "--radius", "1", "--scale", "6", "--no-blind")
"""Of a place near that of the frames."""


@pytest.fixture(scope="session")
def drawn() -> list[bytes]:
    """Three frames of one place, as FITS."""
    optics = SimulatedOptics(640, 480, SCALE_ARCSEC_PX)
    frames = [
        draw_frame(
            PLACE, optics, embedded_catalog(), exposure_s=2.0, mid_exposure_utc=INSTANT, seed=(number, 1)
        )
        for number in range(3)
    ]
    return [updated_fits(as_fits(frame), {"DATE-OBS": f"{INSTANT:%Y-%m-%dT%H:%M:%S}"}) for frame in frames]


@pytest.fixture
def folder(tmp_path: Path, drawn: list[bytes]) -> Path:
    """The frames in a folder, and one that is none."""
    frames = tmp_path / "frames"
    (frames / "below").mkdir(parents=True)
    (frames / "a.fits").write_bytes(drawn[0])
    (frames / "below" / "b.fits").write_bytes(drawn[1])
    (frames / "c.fit").write_bytes(drawn[2])
    (frames / "broken.fits").write_text("these are my notes")
    (frames / "readme.txt").write_text("not a frame by its name")
    return frames
