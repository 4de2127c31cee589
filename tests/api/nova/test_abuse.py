"""What strangers send: floods, bombs, nonsense; refused in words, in bounds, and a stop gets through."""

from __future__ import annotations

import asyncio
import bz2
import contextlib
import gzip
import json
import os
import resource
import time
from collections.abc import AsyncIterator
from typing import Any

import httpx
import numpy as np
import pytest

from api.listeners.admission import nova_shares, shares
from api.solver.limits import own_memory_mb
from tests.api.conftest import OBSERVATORY
from tests.api.http.stop_answers import stopped
from tests.api.nova.nova_service import (
    HINT,
    Standing,
    as_fits,
    drawn,
    noise,
    pixels,
    raw_form,
    standing,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")


def refused(answer: httpx.Response, status: int = 200) -> str:
    """The words of a clean refusal."""
    told = answer.json()
    assert (answer.status_code, told["status"]) == (status, "error"), answer.text
    assert answer.headers["content-type"].startswith("text/plain")
    assert 0 < len(told["errormessage"]) <= 300
    return str(told["errormessage"])


@pytest.mark.long
async def test_nonsense_is_refused_in_words(nova: Standing) -> None:
    client, url = nova.client, nova.url
    session = await nova.login()
    for text in ("", "{", "[]", "NaN", '{"session": NaN}', "[" * 50_000, "\x00", '"' * 999):
        refused(await nova.post("/api/login", text))
        refused(await nova.post("/api/upload", text))
    many = json.dumps({f"k{number}": number for number in range(10**6)})
    assert "bytes" in refused(await nova.post("/api/login", many[:2_500_000]), 413)
    refused(await nova.post("/api/upload", many[:5_000_000]), 413)
    for asked in (
        {"center_ra": "NaN", "center_dec": 1},
        {"scale_lower": float("1e308"), "scale_units": "degwidth", "image_width": 1},
        {"image_width": -1},
        {"x": [1, 2], "y": [1]},
        {"x": [1e999], "y": [1]} | {"x": ["a"], "y": ["b"]},
        {"x": {"a": 1}, "y": {"a": 1}},
        {},
    ):
        refused(await nova.post("/api/upload", {"session": session} | asked))
    for kind, body in (
        ("multipart/form-data", b"x"),
        ("multipart/form-data; boundary=x", b""),
        ("multipart/form-data; boundary=x", b"--x--"),
        ("multipart/form-data; boundary=x", b"--x\r\n\r\n" * 100_000),
        ("multipart/form-data; boundary=x", b"\r\n--x" * 100_000),
        ("multipart/form-data; boundary=x", os.urandom(300_000)),
        ("text/html", b"<p>"),
        ("", b"\xff" * 100),
    ):
        refused(await client.post(f"{url}/api/upload", content=body, headers={"content-type": kind}))
    for path in (
        "/api/jobs/x",
        "/api/jobs/-1",
        f"/api/jobs/{10**40}",
        "/api/jobs/1/x",
        "/api",
        "/api/jobs/1%2f2",
    ):
        refused(await nova.get(path), 404)
    refused(await nova.get("/api/submissions/12345"), 404)
    empty = await nova.upload(b"", session=session)
    assert "empty" in refused(empty)
    assert (await nova.get("/")).status_code == 200


@pytest.mark.long
async def test_files_that_are_no_images_fail_and_are_told(nova: Standing) -> None:
    session = await nova.login()
    whole = drawn()
    hostile = {
        "text": b"this is not an image\n" * 100,
        "random": os.urandom(100_000),
        "truncated": whole[: len(whole) // 2],
        "header alone": whole[:2880],
        "gzip cut": gzip.compress(whole)[:50_000],
        "gzip bomb": gzip.compress(b"SIMPLE  =                    T" + b" " * 120_000_000),
        "bz2 bomb": bz2.compress(b"\0" * 120_000_000),
        "NaN": as_fits(np.full((300, 300), np.nan, np.float32)),
        "zeros": as_fits(np.zeros((300, 300), np.uint16)),
        "absurd": whole.replace(b"NAXIS1  =                  800", b"NAXIS1  =          99999999999"),
        "list of NaN": b"nan nan\n" * 1000,
        "one star": b"1 1\n",
        "list far off": b"1e9 1e9\n" * 100,
        "png": b"\x89PNG\r\n\x1a\n" + b"\0" * 1000,
    }
    before_mb = own_memory_mb()
    for name, content in hostile.items():
        told = (await nova.upload(content, name, session=session, **HINT)).json()
        job, status = await nova.ended(told)
        assert (name, status) == (name, "failure")
        assert (await nova.get(f"/api/jobs/{job}")).json()["errormessage"]
    assert own_memory_mb() - before_mb < 500


@pytest.mark.long
async def test_noise_and_random_lists_never_succeed() -> None:
    rng = np.random.default_rng(17)
    async with standing("budget_s = 0.5") as nova:
        session = await nova.login()
        for seed in range(3):
            job, status = await nova.ended((await nova.upload(noise(seed), session=session, **HINT)).json())
            assert status == "failure"
            assert "ra" not in (await nova.get(f"/api/jobs/{job}/calibration")).json()
        for _ in range(20):
            text = "".join(f"{x:.2f} {y:.2f}\n" for x, y in rng.uniform(1, 800, (40, 2))).encode()
            asked = HINT | {"image_width": 800, "image_height": 800}
            _, status = await nova.ended((await nova.upload(text, session=session, **asked)).json())
            assert status == "failure"


async def test_what_is_too_large_is_refused_before_it_is_read() -> None:
    async with standing("max_upload_mb = 0.1") as nova:
        session = await nova.login()
        large = b"x" * 200_000
        assert "0.1 MB" in refused(await nova.upload(large, session=session), 413)

        async def in_pieces() -> AsyncIterator[bytes]:
            whole = raw_form(
                [
                    ("", 'form-data; name="request-json"', json.dumps({"session": session}).encode()),
                    ("", 'form-data; name="file"; filename="a"', large),
                ],
                "x",
                "\r\n",
            )
            for at in range(0, len(whole), 10_000):
                yield whole[at : at + 10_000]

        # a body that doesn't tell its length
        kind = {"content-type": "multipart/form-data; boundary=x"}
        answer = await nova.client.post(f"{nova.url}/api/upload", content=in_pieces(), headers=kind)
        refused(answer, 413)
        # one that tells a length beyond all bounds is answered before anything of it came
        reader, writer = await asyncio.open_connection("127.0.0.1", int(nova.url.rpartition(":")[2]))
        writer.write(
            b"POST /api/upload HTTP/1.1\r\nHost: 127.0.0.1\r\n"
            b"Content-Type: multipart/form-data; boundary=x\r\n"
            b"Content-Length: 99999999999\r\nExpect: 100-continue\r\n\r\n"
        )
        async with asyncio.timeout(60):
            assert b" 413 " in await reader.readuntil(b"\r\n\r\n")
        writer.close()


async def test_nobody_without_a_session_has_a_file_kept(nova: Standing) -> None:
    """The session is looked at as soon as it is there, and a file before it is not taken."""
    body = raw_form(
        [
            ("", 'form-data; name="request-json"', b'{"session": "nobody"}'),
            ("", 'form-data; name="file"; filename="a"', b"x" * 5_000_000),
        ],
        "x",
        "\r\n",
    )
    kind = {"content-type": "multipart/form-data; boundary=x"}
    answer = await nova.client.post(f"{nova.url}/api/upload", content=body, headers=kind)
    assert refused(answer) == 'no session with key "nobody"'
    first = raw_form([("", 'form-data; name="file"; filename="a"', b"x" * 5_000_000)], "x", "\r\n")
    answer = await nova.client.post(f"{nova.url}/api/upload", content=first, headers=kind)
    assert "before the file" in refused(answer)
    assert nova.app._jobs._under_way == 0


@pytest.mark.long
async def test_a_flood_is_held_back_and_a_stop_gets_through() -> None:
    """Forty clients upload without end: some are refused by 429, and each stop is answered in its time."""
    observatory = OBSERVATORY.replace("[service]", "[service]\nrate_limit_per_s = 0")
    async with standing("queue = 4", observatory) as nova:
        session, content, codes = await nova.login(), noise(), list[int]()
        going = True

        async def flood() -> None:
            while going:
                with contextlib.suppress(httpx.TransportError):
                    codes.append((await nova.upload(content, session=session, **HINT)).status_code)

        limits = httpx.Limits(max_connections=100)
        async with httpx.AsyncClient(timeout=120, trust_env=False, limits=limits) as many:
            nova.client, quiet = many, nova.client
            clients = [asyncio.create_task(flood()) for _ in range(40)]
            while 429 not in codes or 200 not in codes:
                await asyncio.sleep(0.05)
            took_s = []
            for _ in range(10):
                began = time.monotonic()
                answer = await quiet.post(f"{nova.rest_url}/v1/stop")
                took_s.append(time.monotonic() - began)
                assert answer.status_code in (200, 202), answer.text
            going = False
            await asyncio.gather(*clients)
        assert set(codes) == {200, 429}
        print(f"stops took {sorted(took_s)[5]:.3f} s, at most {max(took_s):.3f} s")
        assert (await stopped(quiet, f"{nova.rest_url}/v1/stop")).status_code == 200


async def test_silent_clients_make_room_and_a_stop_is_no_stop_here(nova: Standing) -> None:
    port = int(nova.url.rpartition(":")[2])
    most = nova_shares(resource.getrlimit(resource.RLIMIT_NOFILE)[0]).clients
    silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(3 * most)]
    try:
        async with httpx.AsyncClient(timeout=60, trust_env=False) as client:
            session = await client.post(f"{nova.url}/api/login", data={"request-json": '{"apikey": "x"}'})
            assert session.json()["status"] == "success"
            stop = await client.post(f"{nova.url}/v1/stop")
            assert stop.status_code == 404
    finally:
        for _, writer in silent:
            writer.close()


@pytest.mark.parametrize("descriptors", [256, 1024, 65536])
async def test_descriptors_are_left_for_devices_and_stops(descriptors: int) -> None:
    nova = nova_shares(descriptors)
    shared = shares(descriptors, 2, nova.descriptors(16))
    assert nova.clients >= 4
    assert shared.http >= 24
    assert shared.stops >= 4
    if descriptors > 256:
        listeners = 3 * (shared.listener + 2 * max(1, shared.listener // 8))
        held = shared.http + shared.stops + shared.fresh + shared.burst + listeners + nova.descriptors(16)
        assert held + 96 + 16 <= min(descriptors, 1024)


@pytest.mark.long
async def test_too_many_requests_of_one_address() -> None:
    observatory = OBSERVATORY.replace("[service]", "[service]\nrate_limit_per_s = 5\nrate_burst = 5")
    async with standing("", observatory) as nova:
        answers = await asyncio.gather(*(nova.get("/api/jobs/1") for _ in range(30)))
        assert {one.status_code for one in answers} == {404, 429}
        assert (await nova.client.post(f"{nova.rest_url}/v1/stop")).status_code in (200, 202)


async def test_a_client_that_leaves_leaves_nothing_behind(nova: Standing) -> None:
    session = await nova.login()
    whole = raw_form(
        [
            ("", 'form-data; name="request-json"', json.dumps({"session": session}).encode()),
            ("", 'form-data; name="file"; filename="a"', b"x" * 1_000_000),
        ],
        "x",
        "\r\n",
    )
    port, before = int(nova.url.rpartition(":")[2]), len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        head = (
            "POST /api/upload HTTP/1.1\r\nHost: 127.0.0.1\r\n"
            "Content-Type: multipart/form-data; boundary=x\r\n"
            f"Content-Length: {len(whole)}\r\n\r\n"
        )
        writer.write(head.encode() + whole[:500_000])
        await writer.drain()
        writer.transport.abort()
    async with asyncio.timeout(60):
        while nova.app._jobs._under_way or len(os.listdir("/proc/self/fd")) > before:
            await asyncio.sleep(0.02)


@pytest.mark.long
async def test_all_is_forgotten_after_a_while() -> None:
    async with standing("keep_minutes = 0.01") as nova:
        job = await nova.solved(drawn(), **HINT)
        async with asyncio.timeout(60):
            while len(nova.app.submissions) or len(nova.app.sessions):
                await asyncio.sleep(0.05)
        refused(await nova.get(f"/api/jobs/{job}"), 404)


@pytest.mark.long
async def test_going_down_ends_what_is_under_way() -> None:
    async with standing() as nova:
        told: list[dict[str, Any]] = []
        session = await nova.login()
        for seed in range(3):
            told.append((await nova.upload(noise(seed), session=session, **HINT)).json())
        app = nova.app
    assert [one["status"] for one in told] == ["success"] * 3
    assert len(app.submissions) == 0
    assert app._jobs._under_way == 0
    assert pixels().any()


@pytest.mark.long
async def test_a_stranger_who_dribbles_takes_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """One who never shows a session is let go in the end; the queue is free meanwhile."""
    monkeypatch.setattr("api.nova.app._UNKNOWN_S", 1.0)
    async with standing("queue = 1") as nova:
        reader, writer = await asyncio.open_connection("127.0.0.1", int(nova.url.rpartition(":")[2]))
        writer.write(
            b"POST /api/upload HTTP/1.1\r\nHost: 127.0.0.1\r\n"
            b"Content-Type: multipart/form-data; boundary=x\r\nContent-Length: 1000000\r\n\r\n--x\r\n"
        )
        assert await nova.solved(drawn(), **HINT)
        async with asyncio.timeout(60):
            assert b" 408 " in await reader.readuntil(b"\r\n\r\n")
        writer.close()


@pytest.mark.long
async def test_a_full_queue_is_told_before_the_file_is_read() -> None:
    async with standing("queue = 1") as nova:
        session = await nova.login()
        with nova.app._jobs.place():
            words = refused(await nova.upload(b"x" * 1_000_000, session=session), 429)
        assert "no more are taken" in words
        assert await nova.solved(drawn(), session=session, **HINT)
