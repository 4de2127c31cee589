"""astroquery's own client, with its address set to ours."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from astropy.io import fits

from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.nova.nova_service import (
    HEIGHT_PX,
    HINT,
    SCALE_ARCSEC_PX,
    TRUTH,
    WIDTH_PX,
    Standing,
    drawn,
    noise,
    stars,
)

pytestmark = [
    pytest.mark.asyncio(loop_scope="module"),
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore"),  # its own and those of its libraries
]


def client_of(nova: Standing) -> Any:
    core = pytest.importorskip("astroquery.astrometry_net", reason="astroquery is not installed")
    client = core.AstrometryNetClass()
    client.URL, client.API_URL, client.api_key = nova.url, f"{nova.url}/api", "any"
    return client


def center(header: fits.Header) -> Icrs:
    from astropy.wcs import WCS

    middle = WCS(header).pixel_to_world((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2)
    return Icrs(float(middle.ra.deg), float(middle.dec.deg))


async def test_an_image(nova: Standing, tmp_path: Path) -> None:
    path = tmp_path / "a.fits"
    path.write_bytes(drawn())
    client = client_of(nova)
    header, submission = await asyncio.to_thread(
        lambda: client.solve_from_image(
            str(path), force_image_upload=True, verbose=False, return_submission_id=True, **HINT
        )
    )
    assert separation_arcsec(center(header), TRUTH) < 0.1 * SCALE_ARCSEC_PX
    assert nova.app.submissions.of(submission, None, "127.0.0.1").name == "a.fits"


async def test_lists_of_stars(nova: Standing) -> None:
    x, y = stars()
    client = client_of(nova)
    header = await asyncio.to_thread(
        lambda: client.solve_from_source_list(x, y, WIDTH_PX, HEIGHT_PX, verbose=False, **HINT)
    )
    assert separation_arcsec(center(header), TRUTH) < SCALE_ARCSEC_PX


async def test_what_is_not_solved(nova: Standing, tmp_path: Path) -> None:
    path = tmp_path / "noise.fits"
    path.write_bytes(noise())
    client = client_of(nova)
    header = await asyncio.to_thread(
        lambda: client.solve_from_image(str(path), force_image_upload=True, verbose=False, **HINT)
    )
    assert header == {}
