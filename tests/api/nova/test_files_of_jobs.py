"""The files of a solved job, read by astropy and PIL: one center in all of them."""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS
from PIL import Image

from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.nova.nova_service import (
    HEIGHT_PX,
    HINT,
    SCALE_ARCSEC_PX,
    TRUTH,
    WIDTH_PX,
    Standing,
    as_fits,
    as_png,
    drawn,
    pixels,
)

pytestmark = [
    pytest.mark.asyncio(loop_scope="module"),
    pytest.mark.filterwarnings("ignore::astropy.wcs.FITSFixedWarning"),  # NAXIS = 0, as in such files
]


async def calibrated(nova: Standing, content: bytes, **asked: Any) -> tuple[int, dict[str, float]]:
    job = await nova.solved(content, **{**HINT, **asked})
    return job, (await nova.get(f"/api/jobs/{job}/calibration")).json()


def center_of(header: fits.Header) -> Icrs:
    middle = WCS(header).pixel_to_world((header["IMAGEW"] - 1) / 2, (header["IMAGEH"] - 1) / 2)
    return Icrs(float(middle.ra.deg), float(middle.dec.deg))


@pytest.mark.long
async def test_the_tables_of_stars(nova: Standing) -> None:
    job, _ = await calibrated(nova, drawn())
    got = {
        name: fits.open(io.BytesIO((await nova.get(f"/{name}_file/{job}")).content))
        for name in ("rdls", "axy", "corr")
    }
    corr, rdls, axy = (got[name][1].data for name in ("corr", "rdls", "axy"))
    assert len(corr) == len(rdls) > 20
    assert got["axy"][1].header["IMAGEW"] == WIDTH_PX
    # measured and computed places agree, in both systems, and lie in the frame
    header = fits.Header.fromstring((await nova.get(f"/wcs_file/{job}")).text)
    x, y = WCS(header).all_world2pix(rdls["RA"], rdls["DEC"], 1)
    assert np.allclose(x, corr["index_x"], atol=0.01)
    assert np.allclose(y, corr["index_y"], atol=0.01)
    assert np.hypot(corr["field_x"] - corr["index_x"], corr["field_y"] - corr["index_y"]).max() < 0.5
    assert np.hypot(corr["field_dec"] - corr["index_dec"], 0.0).max() < SCALE_ARCSEC_PX / 3600
    assert ((corr["field_x"] >= 0.5) & (corr["field_x"] <= WIDTH_PX + 0.5)).all()
    # each identified star is one of the measured places
    nearest = np.hypot(
        corr["field_x"][:, None] - axy["X"][None, :], corr["field_y"][:, None] - axy["Y"][None, :]
    ).min(axis=1)
    assert np.median(nearest) < 0.5
    for opened in got.values():
        opened.close()


async def test_the_new_file_has_the_same_pixels_and_the_cards(nova: Standing) -> None:
    content = as_fits(pixels(), OBJECT="a field", CRVAL1=1.0, CTYPE1="RA---TAN")
    job, found = await calibrated(nova, content)
    new = (await nova.get(f"/new_fits_file/{job}")).content
    with fits.open(io.BytesIO(new)) as opened:
        assert np.array_equal(opened[0].data, pixels())
        assert opened[0].header["OBJECT"] == "a field"
        opened[0].verify("exception")
        middle = WCS(opened[0].header).pixel_to_world((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2)
    assert separation_arcsec(Icrs(middle.ra.deg, middle.dec.deg), Icrs(found["ra"], found["dec"])) < 1e-3


@pytest.mark.long
async def test_packed_files_and_pictures_become_fits(nova: Standing) -> None:
    import gzip

    for content, plane in (
        (gzip.compress(drawn()), pixels()),
        (as_png(pixels()), None),
    ):
        job, found = await calibrated(nova, content)
        new = (await nova.get(f"/new_fits_file/{job}")).content
        with fits.open(io.BytesIO(new)) as opened:
            assert opened[0].data.shape == (HEIGHT_PX, WIDTH_PX)
            assert plane is None or np.array_equal(opened[0].data, plane)
            middle = WCS(opened[0].header).pixel_to_world((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2)
        assert separation_arcsec(Icrs(middle.ra.deg, middle.dec.deg), Icrs(found["ra"], found["dec"])) < 1e-3


async def test_a_png_has_its_own_orientation_and_parity(nova: Standing) -> None:
    """The same sky: rows from the top, so the determinant's sign turns, and 180 less the angle is told."""
    job, in_fits = await calibrated(nova, drawn())
    _, in_png = await calibrated(
        nova, as_png(pixels()), scale_units="arcminwidth", scale_lower=51, scale_upper=56
    )
    assert (in_fits["parity"], in_png["parity"]) == (-1.0, 1.0)
    assert separation_arcsec(Icrs(in_png["ra"], in_png["dec"]), TRUTH) < 0.3 * SCALE_ARCSEC_PX
    assert in_png["pixscale"] == pytest.approx(in_fits["pixscale"], rel=1e-3)
    # up in the picture is north: by wcsinfo's formula 180 in rows from the top
    assert math.remainder(in_png["orientation"] - in_fits["orientation"], 360.0) == pytest.approx(
        0.0, abs=0.2
    )
    log = (await nova.get(f"/joblog/{job}")).text
    assert "parity -1" in log


@pytest.mark.long
@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("mirrored", [False, True])
async def test_all_files_tell_one_center_in_eight_orientations(
    nova: Standing, turns: int, mirrored: bool
) -> None:
    plane = np.rot90(pixels(), turns)
    plane = np.ascontiguousarray(plane[:, ::-1] if mirrored else plane)
    job, found = await calibrated(nova, as_fits(plane))
    assert found["parity"] == (1.0 if mirrored else -1.0)
    header = fits.Header.fromstring((await nova.get(f"/wcs_file/{job}")).text)
    center = center_of(header)
    told = Icrs(found["ra"], found["dec"])
    assert separation_arcsec(center, told) < 0.01 * SCALE_ARCSEC_PX
    assert separation_arcsec(told, TRUTH) < 0.1 * SCALE_ARCSEC_PX
    cd = WCS(header).pixel_scale_matrix
    sign = 1.0 if np.linalg.det(cd) >= 0 else -1.0
    angle = -math.degrees(math.atan2(sign * cd[1, 0] - cd[0, 1], sign * cd[0, 0] + cd[1, 1]))
    assert math.remainder(found["orientation"] - angle, 360.0) == pytest.approx(0.0, abs=1e-3)
    assert math.sqrt(abs(np.linalg.det(cd))) * 3600 == pytest.approx(found["pixscale"], rel=1e-6)


async def test_without_distortion_terms_where_none_are_wanted(nova: Standing) -> None:
    job, _ = await calibrated(nova, drawn(), tweak_order=0)
    header = fits.Header.fromstring((await nova.get(f"/wcs_file/{job}")).text)
    assert header["CTYPE1"] == "RA---TAN"
    assert "A_ORDER" not in header


async def test_the_picture_shows_circled_stars(nova: Standing) -> None:
    job, _ = await calibrated(nova, drawn())
    with Image.open(io.BytesIO((await nova.get(f"/annotated_display/{job}")).content)) as shown:
        assert (shown.format, shown.size) == ("PNG", (WIDTH_PX, HEIGHT_PX))
        colors = np.asarray(shown.convert("RGB")).reshape(-1, 3)
    assert (colors == (0, 190, 0)).all(axis=1).sum() > 200


async def test_named_objects_are_told_where_they_are(nova: Standing) -> None:
    """The Crab nebula lies 8.4 degrees from the frame: told for a frame around it."""
    from api.nova.products import named_in
    from api.nova.submissions import Result

    nothing = np.zeros(0)
    cards: dict[str, Any] = {
        "CTYPE1": "RA---TAN",
        "CTYPE2": "DEC--TAN",
        "CRPIX1": 500.5,
        "CRPIX2": 400.5,
        "CRVAL1": 83.633,
        "CRVAL2": 22.014,
        "CD1_1": -1e-3,
        "CD1_2": 0.0,
        "CD2_1": 0.0,
        "CD2_2": 1e-3,
        "IMAGEW": 1000,
        "IMAGEH": 800,
    }
    nothings: list[Any] = [*([nothing] * 6), np.zeros((0, 2), np.float32)]
    result = Result(cards, *nothings)
    crab = next(one for one in named_in(result) if one.names[0] == "M1")
    assert (crab.x_px, crab.y_px) == pytest.approx((499.5, 399.5), abs=0.01)
    away = Result(cards | {"CRVAL1": 263.6, "CRVAL2": -22.0}, *nothings)
    assert all(one.names[0] != "M1" for one in named_in(away))
