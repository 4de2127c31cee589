"""The site as it is built: strictly, for a place without network, and searched in a real browser."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
from pathlib import Path
from threading import Thread

import pytest
import uvicorn
from fastapi import FastAPI

from api.help import site
from api.http.headers import SafeHeaders
from api.http.routes import help as help_route
from tests.browser.conftest import chromium

ROOT = Path(__file__).resolve().parents[3]
pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def built_site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mkdocs", reason="mkdocs is not installed: the group docs of pyproject.toml")
    out = tmp_path_factory.mktemp("help") / "site"
    ran = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(out)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    return out


def test_every_page_of_docs_is_in_the_site(built_site: Path) -> None:
    for page in ROOT.glob("docs/**/*.md"):
        path = page.relative_to(ROOT / "docs").with_suffix(".html")
        assert (built_site / path).is_file(), path


def test_no_page_loads_anything_from_elsewhere(built_site: Path) -> None:
    loads = re.compile(
        r"""<(?:script|img|iframe|source|embed)[^>]*\ssrc=["']?(?:https?:)?//[^"'\s>]+"""
        r"""|<link[^>]*rel=["']?(?:stylesheet|preconnect|icon)[^>]*href=["']?(?:https?:)?//[^"'\s>]+"""
    )
    for page in built_site.rglob("*.html"):
        assert not loads.findall(page.read_text(encoding="utf-8")), page
    for sheet in built_site.rglob("*.css"):
        assert not re.findall(r"url\(['\"]?https?://", sheet.read_text(encoding="utf-8")), sheet


def test_topics_lead_where_an_operator_would_look(built_site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(site, "FOLDER", built_site)
    site.site_files.cache_clear()
    site.pages.cache_clear()
    try:
        wanted = {
            "onstep": "reference/mounts/onstep",
            "install": "how-to/install",
            "nova": "how-to/nova",
            "keys and roles": "how-to/security",
            "guarded sync": "explanation/syncing",
            "offset-too-large": "reference/problems",
            "uninstall": "how-to/install",
            "logs": "how-to/install",
            "emergency stop": "how-to/page",
            "meridian flip": "explanation/centering",
            "contribute": "tutorials/first-change",
        }
        for topic, name in wanted.items():
            assert name in [one.name for one in site.find_page(topic)[:3]], topic
    finally:
        site.site_files.cache_clear()
        site.pages.cache_clear()


def test_a_browser_without_network_finds_a_page_by_a_word(
    built_site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = chromium()
    monkeypatch.setattr(site, "FOLDER", built_site)
    site.site_files.cache_clear()
    app = FastAPI()
    app.include_router(help_route.router)
    bound = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(SafeHeaders(app), log_level="error"))
    serving = Thread(target=server.run, kwargs={"sockets": [bound]}, daemon=True)
    serving.start()
    served = f"http://127.0.0.1:{bound.getsockname()[1]}/help/index.html"
    try:
        with api.sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=program, args=["--no-sandbox", "--disable-dev-shm-usage"]
            )
            for start in (served, (built_site / "index.html").as_uri()):
                page = browser.new_page()
                asked: list[str] = []
                troubles: list[str] = []
                page.on("request", lambda request, asked=asked: asked.append(request.url))
                page.on("console", lambda line, troubles=troubles: troubles.append(line.text))
                page.on("pageerror", lambda error, troubles=troubles: troubles.append(str(error)))
                page.goto(start)
                page.fill("input[name=query]", "guide pulses")
                page.wait_for_selector(".md-search-result__link", timeout=60_000)
                assert "guiding" in page.inner_html(".md-search-result__list")
                base = start.removesuffix("index.html")
                assert [one for one in asked if not one.startswith((base, "data:", "blob:"))] == []
                assert troubles == []
                page.close()
            browser.close()
    finally:
        server.should_exit = True
        serving.join()
        bound.close()
        site.site_files.cache_clear()
