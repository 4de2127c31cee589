"""Frames of the drawn sky as files: FITS, or PNG of the same 16-bit pixels with the top row first."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import numpy as np
from astropy.io import fits
from PIL import Image

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs

TAKEN = datetime(2026, 3, 1, 3, tzinfo=UTC)
CENTER = Icrs(99.0, 33.0)
WIDTH_PX, HEIGHT_PX, SCALE_ARCSEC = 640, 480, 12.0
HEIGHT_DEG = HEIGHT_PX * SCALE_ARCSEC / 3600.0
ANGLES_DEG = tuple(7.0 + 45.0 * step for step in range(8))
PARITIES = (1, -1)
IN_TURNS = tuple(
    (angle_deg, parity, "png" if (step + (parity > 0)) % 2 else "fits")
    for step, angle_deg in enumerate(ANGLES_DEG)
    for parity in PARITIES
)
"""Each orientation in both parities, every other one as a picture."""


@cache
def drawn(angle_deg: float = 7.0, parity: int = 1, distortion_px2: float = 0.0) -> Frame:
    """A frame at `CENTER`; `angle_deg` is the position angle of its last row's side."""
    optics = SimulatedOptics(
        width_px=WIDTH_PX,
        height_px=HEIGHT_PX,
        scale_arcsec_px=SCALE_ARCSEC,
        rotation_deg=angle_deg,
        parity=parity,
        fwhm_px=2.6,
        distortion_px2=distortion_px2,
    )
    return draw_frame(CENTER, optics, embedded_catalog(), exposure_s=10.0, mid_exposure_utc=TAKEN, seed=4)


def as_fits(path: Path, frame: Frame | None = None, **cards: object) -> Path:
    """Write a FITS file."""
    header = fits.Header()
    header["DATE-OBS"] = "2026-03-01T03:00:00"
    for name, value in cards.items():
        header[name] = value
    fits.PrimaryHDU((frame or drawn()).pixels, header).writeto(path, overwrite=True)
    return path


def as_png(path: Path, frame: Frame | None = None) -> Path:
    """Write a PNG: its first row is the top one, which is the last of FITS."""
    pixels = np.asarray((frame or drawn()).pixels, dtype=np.uint16)
    Image.fromarray(np.ascontiguousarray(pixels[::-1])).save(path)
    return path
