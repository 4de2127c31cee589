"""`/help`: the site's own files and nothing else, with a policy that knows the scripts of each page."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from api.http.headers import SafeHeaders
from api.http.routes import help as help_route
from api.problems import install
from tests.api.help.conftest import HTML


@pytest.fixture
async def client() -> AsyncIterator[httpx.AsyncClient]:
    app = FastAPI()
    install(app)
    app.include_router(help_route.router)
    transport = httpx.ASGITransport(app=SafeHeaders(app))
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as opened:
        yield opened


async def test_the_front_page_and_a_page_below_are_served(client: httpx.AsyncClient, built: Path) -> None:
    for path in ("/help", "/help/"):
        answer = await client.get(path)
        assert (answer.status_code, answer.headers["location"]) == (307, "/help/index.html"), path
    page = await client.get("/help/how-to/night.html")
    assert (page.status_code, page.text) == (200, HTML)
    assert page.headers["content-type"] == "text/html; charset=utf-8"
    assert page.headers["x-content-type-options"] == "nosniff"
    head = await client.head("/help/how-to/night.html")
    assert (head.status_code, head.content) == (200, b"")


async def test_a_page_may_run_its_own_scripts_alone(client: httpx.AsyncClient, built: Path) -> None:
    policy = (await client.get("/help/index.html")).headers["content-security-policy"]
    digest = base64.b64encode(hashlib.sha256(b"var base='..'").digest()).decode()
    assert f"script-src 'self' 'sha256-{digest}';" in policy
    assert "frame-ancestors 'none'" in policy
    assert "http" not in policy


@pytest.mark.parametrize(
    "path",
    [
        "none.html",
        "../site.py",
        "..%2fsite.py",
        "%2e%2e/site.py",
        "/etc/passwd",
        "how-to",
        "secret.bin",
        "a" * 9000,
    ],
)
async def test_nothing_else_is_served(client: httpx.AsyncClient, built: Path, path: str) -> None:
    answer = await client.get(f"/help/{path}")
    assert answer.status_code == 404
    assert b"FOLDER" not in answer.content


async def test_a_site_that_is_not_built_is_said_plainly(client: httpx.AsyncClient, folder: Path) -> None:
    for path in ("/help", "/help/", "/help/index.html"):
        answer = await client.get(path)
        assert answer.status_code == 404, path
        assert "no documentation" in answer.text
        assert "make docs" in answer.text
