"""Clients of the nova API, their habits retold in own words, against a real service on a real port."""

from __future__ import annotations

import asyncio
import json
import re
from urllib.parse import urlencode

import httpx
import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.conftest import OBSERVATORY
from tests.api.nova.nova_service import (
    HEIGHT_PX,
    HINT,
    SCALE_ARCSEC_PX,
    TRUTH,
    WIDTH_PX,
    Standing,
    as_fits,
    drawn,
    escaped_login,
    noise,
    pixels,
    raw_form,
    standing,
    stars,
    unescaped_login,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")
FORM = {"content-type": "application/x-www-form-urlencoded"}
HEADED = {
    "OBJCTRA": "05 40 10",
    "OBJCTDEC": "+29 58 00",
    "FOCALLEN": 206.265,
    "XPIXSZ": 4.0,
    "YPIXSZ": 4.0,
}
"""What N.I.N.A. writes into the headers of its files; the form itself gives no hint."""


@pytest.mark.long
async def test_nina(nova: Standing) -> None:
    """Logs in with a slash at the end, uploads FITS without a hint, asks at once and each second."""
    client, url = nova.client, nova.url
    login = (await client.post(f"{url}/api/login/", content=escaped_login("key"), headers=FORM)).json()
    assert login["status"] == "success"
    asked = {
        "publicly_visible": "n",
        "allow_modifications": "d",
        "session": login["session"],
        "allow_commercial_use": "d",
    }
    sent = await client.post(
        f"{url}/api/upload",
        data={"request-json": json.dumps(asked)},
        files={"file": ("random.fits", as_fits(pixels(), **HEADED), "application/octet-stream")},
    )
    told = sent.json()
    assert (told["status"], sent.headers["content-type"].split(";")[0]) == ("success", "text/plain")
    polls = 0
    while not (jobs := (await client.get(f"{url}/api/submissions/{told['subid']}")).json()["jobs"]):
        polls += 1
        await asyncio.sleep(1)
    assert str(jobs[0])
    while (status := (await client.get(f"{url}/api/jobs/{jobs[0]}")).json()["status"]) != "success":
        assert status in ("processing", "solving")
        await asyncio.sleep(1)
    found = (await client.get(f"{url}/api/jobs/{jobs[0]}/calibration/")).json()
    assert all(type(found[name]) is float for name in ("parity", "orientation", "pixscale", "radius"))
    assert separation_arcsec(Icrs(found["ra"], found["dec"]), TRUTH) < 0.1 * SCALE_ARCSEC_PX
    assert found["pixscale"] == pytest.approx(SCALE_ARCSEC_PX, rel=1e-3)
    # the sky as seen, north up: this protocol's parity is the sign of the determinant
    assert found["parity"] == -1.0
    assert abs((found["orientation"] + 180) % 360 - 180) < 0.1


async def test_nina_is_told_what_failed(nova: Standing) -> None:
    """It reads `subid` of an upload before the status; and takes what is no success for a failure."""
    refused = (await nova.upload(drawn(), session="nobody's")).json()
    assert str(refused["subid"]) == "None"
    assert refused["errormessage"] == 'no session with key "nobody\'s"'
    wrong = (await nova.post("/api/login/", {})).json()
    assert (wrong["status"], wrong["errormessage"]) == ("error", 'need "apikey"')


async def test_stellarsolver(nova: Standing) -> None:
    """Waits for `processing_finished`, then a job, then its end; reads all of the calibration."""
    client, url = nova.client, nova.url
    login = (await client.post(f"{url}/api/login", content=unescaped_login("key"), headers=FORM)).json()
    asked = {
        "publicly_visible": "n",
        "allow_modifications": "n",
        "session": login["session"],
        "allow_commercial_use": "n",
        "scale_type": "ul",
        "scale_units": "arcminwidth",
        "scale_lower": 50,
        "scale_upper": 57,
        "center_ra": 85.1,
        "center_dec": 29.95,
        "radius": 5,
        "crpix_center": True,
        "downsample_factor": 2,
        "parity": 2,
    }
    body = raw_form(
        [
            (
                "Content-Type: application/text/plain\r\n",
                'form-data; name="request-json"',
                json.dumps(asked).encode(),
            ),
            (
                "Content-Type: application/octet-stream\r\n",
                'form-data; name="file"; filename="/tmp/autofocus.fits"',
                drawn(),
            ),
        ],
        "boundary_.oOo._MTIz",
        "\r\n",
    )
    kind = {"content-type": 'multipart/form-data; boundary="boundary_.oOo._MTIz"'}
    told = (await client.post(f"{url}/api/upload", content=body, headers=kind)).json()
    assert 0 < told["subid"] < 2**31
    submission = f"{url}/api/submissions/{told['subid']}"
    while (await client.get(submission)).json()["processing_finished"] in ("None", ""):
        await asyncio.sleep(0.05)
    job = (await client.get(submission)).json()["jobs"][0]
    assert 0 < job < 2**31
    while (status := (await client.get(f"{url}/api/jobs/{job}")).json()["status"]) in (
        "solving",
        "processing",
    ):
        await asyncio.sleep(0.05)
    assert status == "success"
    found = (await client.get(f"{url}/api/jobs/{job}/calibration")).json()
    wanted = {
        "ra",
        "dec",
        "orientation",
        "pixscale",
        "parity",
        "width_arcsec",
        "height_arcsec",
        "radius",
    }
    assert set(found) == wanted
    assert found["width_arcsec"] == pytest.approx(WIDTH_PX * SCALE_ARCSEC_PX, rel=1e-3)
    assert found["height_arcsec"] == pytest.approx(HEIGHT_PX * SCALE_ARCSEC_PX, rel=1e-3)
    log = await client.get(f"{url}/joblog/{job}")
    assert "Field center: (RA,Dec) = (" in log.text
    # 3200 arcsec wide: 50 to 57 arcmin over 800 pixels
    assert "scale 3.75 to 4.275 arcsec/pix" in log.text
    cards = fits.Header.fromstring((await client.get(f"{url}/wcs_file/{job}")).text)
    assert (cards["IMAGEW"], cards["IMAGEH"]) == (WIDTH_PX, HEIGHT_PX)


async def test_stellarsolver_sends_its_table_of_stars(nova: Standing) -> None:
    """X and Y of FITS, with the size of the image."""
    x, y = stars()
    flux = np.linspace(5000.0, 100.0, len(x))
    table = fits.BinTableHDU.from_columns(
        [
            fits.Column(name=name, format="E", array=values)
            for name, values in (("X", x), ("Y", y), ("FLUX", flux))
        ]
    )
    from io import BytesIO

    file = BytesIO()
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(file)
    job = await nova.solved(
        file.getvalue(), "a.xyls", image_width=WIDTH_PX, image_height=HEIGHT_PX, parity=2, **HINT
    )
    found = (await nova.get(f"/api/jobs/{job}/calibration")).json()
    assert separation_arcsec(Icrs(found["ra"], found["dec"]), TRUTH) < SCALE_ARCSEC_PX
    assert "list of stars" in (await nova.get(f"/joblog/{job}")).text
    # there is no image to write the solution into, and the picture shows stars on black
    missing = await nova.get(f"/new_fits_file/{job}")
    assert (missing.status_code, missing.json()["status"]) == (404, "error")
    assert (await nova.get(f"/annotated_display/{job}")).content.startswith(b"\x89PNG")


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::astropy.wcs.FITSFixedWarning")  # NAXIS = 0, as in such files
async def test_astroimagej(nova: Standing) -> None:
    """Sends a text of x and y; waits while jobs are [] or [null]; reads the WCS as cards."""
    client, url = nova.client, nova.url
    login = (await client.post(f"{url}/api/login", content=escaped_login(" "), headers=FORM)).json()
    assert login["status"] == "success"
    x, y = stars()
    # its own y runs from the top; it sends the height less that, which is FITS's
    text = "".join(f"{one} \t {other}\r\n" for one, other in zip(x, y, strict=True)) + "\r\n"
    asked = {
        "allow_commercial_use": "d",
        "allow_modifications": "d",
        "publicly_visible": "n",
        "image_width": WIDTH_PX,
        "image_height": HEIGHT_PX,
        **HINT,
        "downsample_factor": 1,
        "crpix_center": True,
        "tweak_order": 2,
        "session": login["session"],
    }
    boundary = "================9876543210=="
    head = "MIME-Version: 1.0\r\n"
    body = raw_form(
        [
            (
                f"Content-Type: text/plain\r\n{head}",
                'form-data;name="request-json"',
                json.dumps(asked).encode(),
            ),
            (
                f"Content-Type: application/octet-stream\r\n{head}",
                'form-data;name="file";filename="maxima.tbl"',
                text.encode(),
            ),
        ],
        boundary,
        "\r\n",
    )
    sent = await client.post(
        f"{url}/api/upload",
        content=body,
        headers={"content-type": f"multipart/form-data;boundary={boundary}"},
    )
    told = sent.json()
    assert told["status"] == "success"
    jobs = "[]"
    while jobs in ("[]", "[null]"):
        jobs = json.dumps((await client.get(f"{url}/api/submissions/{told['subid']}")).json()["jobs"])
    job = jobs.strip("[]")
    while (status := (await client.get(f"{url}/api/jobs/{job}")).json()["status"]) not in (
        "success",
        "failure",
        "error",
    ):
        await asyncio.sleep(0.05)
    assert status == "success"
    header = (await client.post(f"{url}/wcs_file/{job}", content=b"", headers=FORM)).text
    assert "\n" not in header
    assert len(header) % 80 == 0
    cards = [header[at : at + 80] for at in range(0, len(header), 80)]
    assert any(card.startswith("CRPIX1") for card in cards)
    center = WCS(fits.Header.fromstring(header)).pixel_to_world((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2)
    assert separation_arcsec(Icrs(center.ra.deg, center.dec.deg), TRUTH) < SCALE_ARCSEC_PX
    found = (await client.get(f"{url}/api/jobs/{job}/annotations")).json()["annotations"]
    assert found
    for one in found:
        assert one["names"]
        assert {"type", "pixelx", "pixely", "radius"} <= set(one)


async def test_client_py(nova: Standing) -> None:
    """Posts everything with its session, and ends the lines of boundaries by bare line feeds."""
    client, url = nova.client, nova.url
    api = f"{url}/api/"

    async def post(service: str, asked: dict[str, object]) -> dict[str, object]:
        sent = await client.post(
            api + service, content=urlencode({"request-json": json.dumps(asked)}), headers=FORM
        )
        told = sent.json()
        assert told.get("status") != "error", told
        return dict(told)

    session = {"session": (await post("login", {"apikey": "key"}))["session"]}
    asked = {"allow_commercial_use": "d", "allow_modifications": "d", "publicly_visible": "y", **HINT}
    head = "MIME-Version: 1.0\r\n"
    boundary = "===============1234567890=="
    body = b"".join(
        (
            b"--" + boundary.encode() + b"\n",
            f"Content-Type: text/plain\r\n{head}".encode(),
            b'Content-disposition: form-data; name="request-json"\r\n\r\n',
            json.dumps(asked | session).encode(),
            b"\n--" + boundary.encode() + b"\n",
            f"Content-Type: application/octet-stream\r\n{head}".encode(),
            b'Content-disposition: form-data; name="file"; filename="a.fits"\r\n\r\n',
            drawn(),
            b"\n--" + boundary.encode() + b"--\n",
        )
    )
    kind = {"content-type": f'multipart/form-data; boundary="{boundary}"'}
    told = (await client.post(api + "upload", content=body, headers=kind)).json()
    assert (told["status"], re.fullmatch("[0-9a-f]{64}", told["hash"]) is not None) == ("success", True)
    jobs: object = []
    while not jobs:
        jobs = (await post(f"submissions/{told['subid']}", dict(session)))["jobs"]
    assert isinstance(jobs, list)
    job = jobs[0]
    while (status := (await post(f"jobs/{job}", dict(session)))["status"]) not in ("success", "failure"):
        await asyncio.sleep(0.05)
    assert status == "success"
    for what in ("calibration", "tags", "machine_tags", "objects_in_field", "annotations", "info"):
        assert await post(f"jobs/{job}/{what}", dict(session))
    assert job in (await post("myjobs/", dict(session)))["jobs"]  # type: ignore[operator]
    images = await post("submission_images", session | {"subid": told["subid"]})
    assert len(images["image_ids"]) == 1  # type: ignore[arg-type]
    assert (await post("jobs_by_tag?query=M31&exact=yes", dict(session))) == {"job_ids": []}
    for file in ("wcs_file", "new_fits_file", "rdls_file", "axy_file", "corr_file"):
        got = await client.get(f"{url}/{file}/{job}")
        assert (got.status_code, got.content[:6]) == (200, b"SIMPLE"), file


async def test_clients_of_ansvr(nova: Standing) -> None:
    """They send an estimate with an error in percent, and know no more of a login than its session."""
    session = (await nova.post("/api/login", {"apikey": "abc"})).json()["session"]
    job = await nova.solved(
        drawn(),
        session=session,
        scale_units="arcsecperpix",
        scale_type="ev",
        scale_est=4.05,
        scale_err=5,
        center_ra=85.1,
        center_dec=29.95,
    )
    log = (await nova.get(f"/joblog/{job}")).text
    assert "within 5 deg" in log
    assert "scale 3.8475 to 4.2525" in log


@pytest.mark.long
async def test_x_and_y_as_lists(nova: Standing) -> None:
    """By client.py's `--upload-xy`; astroquery sends the same to `url_upload`."""
    x, y = stars()
    session = await nova.login()
    asked = {"session": session, "x": x, "y": y, "image_width": WIDTH_PX, "image_height": HEIGHT_PX, **HINT}
    for path in ("/api/upload", "/api/url_upload/"):
        job, status = await nova.ended((await nova.post(path, asked)).json())
        assert status == "success", (await nova.get(f"/joblog/{job}")).text
        found = (await nova.get(f"/api/jobs/{job}/calibration")).json()
        assert separation_arcsec(Icrs(found["ra"], found["dec"]), TRUTH) < SCALE_ARCSEC_PX
        assert found["parity"] == -1.0
    fetched = (await nova.post("/api/url_upload", {"session": session, "url": "http://localhost/a"})).json()
    assert fetched["status"] == "error"
    assert "fetches nothing" in fetched["errormessage"]


@pytest.mark.long
async def test_each_route_has_two_forms_and_two_methods(nova: Standing) -> None:
    job = await nova.solved(drawn(), **HINT)
    session = await nova.login()
    submission = next(one.id for one in nova.app.submissions if one.job_id == job)
    paths = [f"/api/submissions/{submission}", f"/api/jobs/{job}", f"/wcs_file/{job}", f"/joblog/{job}"]
    paths += [f"/api/jobs/{job}/{what}" for what in ("calibration", "info", "tags", "machine_tags")]
    paths += [f"/api/jobs/{job}/objects_in_field", f"/api/jobs/{job}/annotations"]
    for path in paths:
        for form in (path, f"{path}/"):
            got, posted = await nova.get(form), await nova.post(form, {"session": session})
            assert (form, got.status_code, posted.status_code) == (form, 200, 200)
            assert got.content == posted.content
    for path in ("/api/myjobs", "/api/submission_images"):
        answer = (await nova.get(path)).json()
        assert (answer["status"], answer["errormessage"]) == ("error", "no json")
    put = await nova.client.put(f"{nova.url}/api/jobs/{job}")
    assert (put.status_code, put.json()["status"]) == (405, "error")
    assert (await nova.client.head(f"{nova.url}/api/jobs/{job}")).status_code == 200


@pytest.mark.long
async def test_a_refusal_is_no_success_anywhere(nova: Standing) -> None:
    """Noise, and a wrong hint: the reason stands in the log and beside the status."""
    for content, asked in ((noise(), HINT), (drawn(), HINT | {"center_ra": 200.0})):
        job, status = await nova.ended((await nova.upload(content, **asked)).json())
        assert status == "failure"
        told = (await nova.get(f"/api/jobs/{job}")).json()
        assert told["errormessage"]
        assert told["errormessage"] in (await nova.get(f"/joblog/{job}")).text
        calibration = (await nova.get(f"/api/jobs/{job}/calibration/")).json()
        assert calibration == {"error": f"no calibration data available for job {job}"}
        assert "calibration" not in (await nova.get(f"/api/jobs/{job}/info")).json()
        for file in ("wcs_file", "new_fits_file", "corr_file", "annotated_display"):
            assert (await nova.get(f"/{file}/{job}")).status_code == 404


@pytest.mark.long
async def test_a_negative_is_solved_when_it_is_said_so(nova: Standing) -> None:
    plane = pixels().astype(np.float32)
    negative = as_fits(plane.max() - plane)
    _, status = await nova.ended((await nova.upload(negative, **HINT)).json())
    assert status == "failure"
    job = await nova.solved(negative, **HINT, invert=True)
    found = (await nova.get(f"/api/jobs/{job}/calibration")).json()
    assert separation_arcsec(Icrs(found["ra"], found["dec"]), TRUTH) < 0.5 * SCALE_ARCSEC_PX


@pytest.mark.long
async def test_nina_blind_in_its_own_process(
    tmp_path_factory: pytest.TempPathFactory, sky_index: object
) -> None:
    """No hint anywhere, solved by the process for uploads: done at the first poll, without a wait."""
    toml = OBSERVATORY.replace('blind = "never"', 'blind = "after"').replace(
        "worker = false", "worker = true"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MOUNTNAV_JOURNAL", str(tmp_path_factory.mktemp("blind") / "journal.sqlite"))
        async with standing(observatory=toml) as nova:
            # warm the process once; the first to come waits for it
            await nova.solved(drawn())
            told = (await nova.upload(drawn())).json()
            submission: httpx.Response = await nova.get(f"/api/submissions/{told['subid']}")
            job = submission.json()["jobs"][0]
            assert (await nova.get(f"/api/jobs/{job}")).json()["status"] == "success"
            log = (await nova.get(f"/joblog/{job}")).text
            assert "hint: none given" in log
            assert "blind/" in log
            assert nova.service.solver.uploads is not None
            assert nova.service.solver.uploads.state == "ready"
