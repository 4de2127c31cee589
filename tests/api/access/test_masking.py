"""A key that was sent where it doesn't belong stands nowhere in clear: access log, logs, problems, audit."""

from __future__ import annotations

import asyncio
import io
import logging
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from api.http.app import create_app
from api.http.serving import bind, make_server
from mountnav.journal.database import database_url
from mountnav.journal.sql_journal import open_journal
from mountnav.masking import mask_logs, masked
from mountnav.settings.observatory import Settings

KEY = "mnk_1sDhQ0V-abc_DEF"


@pytest.mark.parametrize(
    ("text", "clean"),
    [
        (f"GET /v1/telescopes?key={KEY} HTTP/1.1", "GET /v1/telescopes?key=*** HTTP/1.1"),
        (f"/{KEY}/x", "/mnk_***/x"),
        ("?x=mnk%5F1sDh%51 y", "?x=mnk_*** y"),
        ("?api_key=s3cret&limit=3", "?api_key=***&limit=3"),
        (f"{KEY}, {KEY}.", "mnk_***, mnk_***."),
        ("a monkey = 5", "a monkey = 5"),
    ],
)
def test_what_is_masked(text: str, clean: str) -> None:
    assert masked(text) == clean


@pytest.fixture
def logged() -> Iterator[io.StringIO]:
    before = logging.getLogRecordFactory()
    mask_logs()
    text = io.StringIO()
    handler = logging.StreamHandler(text)
    root = logging.getLogger()
    root.addHandler(handler)
    yield text
    root.removeHandler(handler)
    logging.setLogRecordFactory(before)


def test_every_way_to_log_is_masked(logged: io.StringIO) -> None:
    class Odd:
        def __str__(self) -> str:
            return f"odd {KEY}"

    log = logging.getLogger("somebody.else")
    log.warning("plain %s", KEY)
    log.warning(f"in the message {KEY}")
    log.warning("named %(key)s", {"key": KEY})
    log.warning("an object %s", Odd())
    log.warning("%s", ValueError(KEY))
    try:
        raise ValueError(f"no such key: {KEY}")
    except ValueError:
        log.exception("a fault")
    told = logged.getvalue()
    assert KEY not in told
    assert told.count("mnk_***") >= 6
    assert "Traceback" in told


async def test_a_key_in_an_address_stands_nowhere(
    observatory_toml: str, logged: io.StringIO, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    server = make_server(create_app(Settings.parse(observatory_toml)), log_level="info")
    with bind("127.0.0.1", 0) as listener:
        task = asyncio.create_task(server._serve([listener]))
        while not server.started:
            await asyncio.sleep(0.02)
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"
        answers = []
        async with httpx.AsyncClient(base_url=url, trust_env=False, timeout=60) as client:
            for method, path in (
                ("GET", f"/v1/telescopes?key={KEY}"),
                ("GET", f"/v1/telescopes/{KEY}"),
                ("POST", f"/v1/telescopes/east/slew?key={KEY}"),
                ("POST", f"/v1/telescopes/east/slew?{KEY}=1"),
                ("POST", f"/v1/{KEY}"),
                ("GET", f"/api/v1/telescope/0/connected?ClientID={KEY}"),
            ):
                answers.append((await client.request(method, path)).text)
        server.should_exit = True
        await task
    told = capfd.readouterr()
    assert "GET /v1/telescopes?key=***" in told.out + told.err
    for text in (told.out, told.err, logged.getvalue(), *answers):
        assert KEY not in text
    journal = tmp_path / "journal.sqlite"
    open_journal(journal).close()  # what was in the write-ahead log is in the file
    assert database_url(journal).database == str(journal)
    assert KEY.encode() not in journal.read_bytes()
