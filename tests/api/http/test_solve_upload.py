"""POST /v1/solve: a frame in, its place out; and every wrong upload told plainly."""

from __future__ import annotations

import io
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from datetime import UTC, datetime

import httpx
import numpy as np
import pytest
from astropy.io import fits

from mountnav.catalog.embedded import embedded_catalog
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

Serve = Callable[[str], AbstractAsyncContextManager[httpx.AsyncClient]]

TRUTH = Icrs(85.0, 30.0)
SCALE_ARCSEC_PX = 4.0
HINT: dict[str, float] = {
    "ra_deg": 85.2,
    "dec_deg": 29.9,
    "radius_deg": 1.0,
    "scale_low_arcsec_px": 3.8,
    "scale_high_arcsec_px": 4.2,
}


def _fits(pixels: np.ndarray) -> bytes:
    file = io.BytesIO()
    fits.PrimaryHDU(pixels).writeto(file)
    return file.getvalue()


@pytest.fixture(scope="module")
def drawn() -> bytes:
    """A drawn frame as a FITS file without any hint in its header."""
    optics = SimulatedOptics(800, 600, SCALE_ARCSEC_PX)
    instant = datetime(2026, 11, 21, tzinfo=UTC)
    frame = draw_frame(
        TRUTH, optics, embedded_catalog(), exposure_s=2.0, mid_exposure_utc=instant, seed=(1, 2)
    )
    return _fits(frame.pixels)


@pytest.mark.long
async def test_a_form_and_a_bare_body_give_the_same_place(client: httpx.AsyncClient, drawn: bytes) -> None:
    as_form = await client.post("/v1/solve", params=HINT, files={"file": ("taurus.fits", drawn)})
    as_body = await client.post("/v1/solve", params=HINT, content=drawn)
    for answer, name in ((as_form, "taurus.fits"), (as_body, "upload")):
        record = answer.json()
        assert answer.status_code == 200, record
        assert (record["solved"], record["file"], record["reason"]) == (True, name, None)
        assert separation_arcsec(Icrs(record["ra_deg"], record["dec_deg"]), TRUTH) < SCALE_ARCSEC_PX
        assert record["scale_arcsec_px"] == pytest.approx(SCALE_ARCSEC_PX, rel=0.01)
        assert set(record["time_s"]) == {"read", "measure", "identify", "total"}
        assert record["wcs"]["CTYPE1"].startswith("RA---TAN")


@pytest.mark.long
async def test_not_solved_is_an_answer(client: httpx.AsyncClient, drawn: bytes) -> None:
    elsewhere = await client.post("/v1/solve", params={**HINT, "ra_deg": 200.0}, content=drawn)
    assert (elsewhere.status_code, elsewhere.json()["solved"]) == (200, False)
    assert elsewhere.json()["reason"]
    unhinted = await client.post("/v1/solve", content=drawn)
    assert "no position hint" in unhinted.json()["reason"]


async def test_unusable_uploads_are_bad_frames(client: httpx.AsyncClient, drawn: bytes) -> None:
    uploads = {
        "truncated": drawn[: len(drawn) // 2],
        "header alone": drawn[:2880],
        "cut header": drawn[:100],
        "no image": b"this is not an image" * 100,
        "empty": b"",
        "all zero": _fits(np.zeros((300, 300), np.uint16)),
        "saturated": _fits(np.full((300, 300), 65535, np.uint16)),
    }
    for kind, content in uploads.items():
        answer = await client.post("/v1/solve", params=HINT, content=content)
        assert answer.status_code == 422, kind
        assert answer.json()["type"] == "urn:mountnav:problem:bad-frame", kind


@pytest.mark.long
@pytest.mark.parametrize(
    "wrong",
    [
        {"ra_deg": "nan"},
        {"dec_deg": None},
        {"ra_deg": None, "dec_deg": None},
        {"scale_low_arcsec_px": 5.0},
        {"radius_deg": 0},
        {"dec_deg": 91},
    ],
)
async def test_bad_hints_are_told(client: httpx.AsyncClient, wrong: dict[str, float | str | None]) -> None:
    params = {key: value for key, value in {**HINT, **wrong}.items() if value is not None}
    answer = await client.post("/v1/solve", params=params, content=b"x")
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:mountnav:problem:bad-request")


async def test_bad_forms_are_told(client: httpx.AsyncClient) -> None:
    wrong_part = await client.post("/v1/solve", files={"image": ("a.fits", b"x")})
    no_boundary = await client.post(
        "/v1/solve", content=b"x", headers={"content-type": "multipart/form-data"}
    )
    garbled = await client.post(
        "/v1/solve", content=b"garbage", headers={"content-type": "multipart/form-data; boundary=x"}
    )
    as_text = await client.post(
        "/v1/solve",
        content=b'--x\r\nContent-Disposition: form-data; name="file"\r\n\r\ntext\r\n--x--\r\n',
        headers={"content-type": "multipart/form-data; boundary=x"},
    )
    for answer in (wrong_part, no_boundary, garbled, as_text):
        assert (answer.status_code, answer.json()["type"]) == (422, "urn:mountnav:problem:bad-request")


async def test_too_large_uploads_are_refused(serving: Serve, observatory_toml: str) -> None:
    toml = observatory_toml.replace("[service]", "[service]\nmax_upload_mb = 0.01")

    async def in_pieces() -> AsyncIterator[bytes]:
        for _ in range(20):
            yield b"x" * 1000

    async with serving(toml) as client:
        for answer in (
            await client.post("/v1/solve", content=b"x" * 20_000),
            await client.post("/v1/solve", content=in_pieces()),
            await client.post("/v1/solve", files={"file": ("a.fits", b"x" * 20_000)}),
        ):
            assert (answer.status_code, answer.json()["type"]) == (413, "urn:mountnav:problem:too-large")
