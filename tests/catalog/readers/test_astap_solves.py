"""ASTAP's own solver reads area files as we understand them; our reader gives the stars it solved with."""

from __future__ import annotations

import shutil
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.readers import open_reader
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.units import julian_year
from tests.catalog.readers.astap_files import Star, label, raw_place, write_areas

TAKEN = datetime(2026, 3, 1, 3, tzinfo=UTC)
OPTICS = SimulatedOptics(
    width_px=1000, height_px=1000, scale_arcsec_px=6.0, rotation_deg=20.0, fwhm_px=3.0, pixel_um=9.0,
    distortion_px2=0.0, zero_point_mag=20.0,
)  # fmt: skip
# in the middle of an area, and where four areas of the .1476 meet
CENTERS = {"in one area": Icrs(99.0, 33.0), "where areas meet": Icrs(114.0, 30.857)}

pytestmark = pytest.mark.skipif(shutil.which("astap_cli") is None, reason="astap_cli is not installed")


@pytest.mark.long
@pytest.mark.parametrize(("areas", "size"), [(290, 5), (290, 6), (1476, 5), (1476, 6)])
@pytest.mark.parametrize("where", CENTERS)
def test_astap_solves_with_area_files_that_our_reader_reads(
    tmp_path: Path, areas: int, size: int, where: str
) -> None:
    center, epoch = CENTERS[where], julian_year(TAKEN)
    near = embedded_catalog().cone(center, 6.0, epoch_yr=epoch)
    stars = [
        Star(ra, dec, round(10 * mag))
        for ra, dec, mag in zip(near.ra_deg, near.dec_deg, near.mag, strict=True)
    ]
    # ASTAP takes a database to be there when its first area is; Debian's edition knows none named d50 yet
    database = "h18" if areas == 1476 else "g17"
    write_areas(tmp_path, [*stars, Star(0.0, -89.0, 90)], database=database, areas=areas, size=size)
    assert (tmp_path / f"{database}_0101.{areas}").is_file()
    if where == "where areas meet" and areas == 1476:
        assert len({label(star.ra_deg, star.dec_deg, areas) for star in stars[:400]}) >= 4

    solved = _solved_center(tmp_path, center)
    truth = SkyCoord(center.ra_deg, center.dec_deg, unit="deg")
    assert solved.separation(truth).arcsec < 3.0  # half a pixel

    reader = open_reader("astap", tmp_path)
    chunks = [chunk for part in reader.parts() for chunk in reader.read(part)]
    ra = np.concatenate([chunk.ra_deg for chunk in chunks])
    dec = np.concatenate([chunk.dec_deg for chunk in chunks])
    read = sorted(zip(np.rint(ra / 360 * 0xFFFFFF), np.rint(dec / 90 * 0x7FFFFF), strict=True))
    assert read == sorted(raw_place(star) for star in [*stars, Star(0.0, -89.0, 90)])


def _solved_center(folder: Path, center: Icrs) -> SkyCoord:
    """Draw a frame, let ASTAP find it from 1 degree beside, and tell its center."""
    frame = draw_frame(center, OPTICS, embedded_catalog(), exposure_s=10.0, mid_exposure_utc=TAKEN, seed=4)
    path = folder / "frame.fits"
    fits.PrimaryHDU(frame.pixels).writeto(path)
    field = OPTICS.height_px * OPTICS.scale_arcsec_px / 3600
    command = [
        "astap_cli",
        "-f",
        str(path),
        "-d",
        str(folder),
        "-o",
        str(folder / "found"),
        "-fov",
        f"{field:.4f}",
    ]
    command += ["-ra", f"{(center.ra_deg + 0.7) / 15:.6f}", "-spd", f"{90 + center.dec_deg + 0.5:.6f}"]
    subprocess.run([*command, "-r", "4", "-s", "80"], check=False, capture_output=True, timeout=120)
    lines = (line.partition("=") for line in (folder / "found.ini").read_text("latin-1").splitlines())
    said = {key.strip(): value.strip() for key, _, value in lines}
    assert said["PLTSOLVD"] == "T", said
    # ASTAP's reference pixel is the middle of the frame
    assert float(said["CRPIX1"]) == pytest.approx(500.5)
    return SkyCoord(float(said["CRVAL1"]), float(said["CRVAL2"]), unit="deg")
