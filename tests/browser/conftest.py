"""A real browser on a real service; skipped with a reason where there is no chromium."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from mountnav.sky.coordinates import Icrs
from tests.browser.watched_service import TOML, Served, Wire, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page, Request

WAIT_MS = 60_000
KEY = "a key of the tests"


def chromium() -> str:
    """Where the browser is, or a skip with a plain reason."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("no chromium on this machine: apt-get install chromium")
    return found


@pytest.fixture(scope="module")
def observatory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A service of its own for the tests of a module, with a journal of its own."""
    folder = tmp_path_factory.mktemp("page")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MOUNTNAV_JOURNAL", str(folder / "journal.sqlite"))
        with served() as one:
            yield one


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium without a window."""
    program = chromium()
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(
            executable_path=program, args=["--no-sandbox", "--disable-dev-shm-usage"]
        )
        try:
            yield opened
        finally:
            opened.close()


class Visit:
    """A visit to the page: a context of its own, and what the browser complained of."""

    def __init__(self, context: BrowserContext) -> None:
        self.context = context
        self.page: Page = context.new_page()
        self.page.set_default_timeout(WAIT_MS)
        self.complaints: list[str] = []
        self.forgiven: tuple[str, ...] = ()
        self.page.on("console", lambda one: self._heard(one.type, one.text))
        self.page.on("pageerror", lambda one: self.complaints.append(str(one)))

    def open(self, url: str) -> Page:
        """Go there and wait until the state is known."""
        self.page.goto(url)
        self.page.wait_for_function("() => document.querySelector('#place-list dd').textContent !== '–'")
        return self.page

    def _heard(self, kind: str, text: str) -> None:
        if kind in ("error", "warning") and not any(one in text for one in self.forgiven):
            self.complaints.append(f"{kind}: {text}")


@contextmanager
def visiting(browser: Browser, **options: Any) -> Iterator[Visit]:
    """Visit with options of the context; the browser must have had nothing to complain of."""
    context = browser.new_context(**{"viewport": {"width": 1500, "height": 1100}, **options})
    try:
        visit = Visit(context)
        yield visit
        assert visit.complaints == []
    finally:
        context.close()


@pytest.fixture
def visit(browser: Browser) -> Iterator[Visit]:
    """Visit at the size of a screen."""
    with visiting(browser) as one:
        yield one


@pytest.fixture
def phone(browser: Browser) -> Iterator[Visit]:
    """Visit with a phone."""
    with visiting(
        browser, viewport={"width": 360, "height": 740}, has_touch=True, is_mobile=True, device_scale_factor=2
    ) as one:
        yield one


@pytest.fixture
def wire(observatory: Served) -> Iterator[Wire]:
    laid = Wire(observatory.port)
    yield laid
    laid.close()


@pytest.fixture
def locked(observatory: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    """A service that asks for a key."""
    monkeypatch.setenv("MOUNTNAV_JOURNAL", str(tmp_path / "journal.sqlite"))
    digest = hashlib.sha256(KEY.encode()).hexdigest()
    with served(TOML.replace("port = 0", f'port = 0\napi_token_sha256 = "{digest}"')) as one:
        yield one


def orders_asked(page: Page) -> list[str]:
    """The orders that this page asks for from now on, by name, as they come."""
    asked: list[str] = []

    def heard(request: Request) -> None:
        name = request.url.rsplit("/", 1)[1]
        # what a place is going to do is asked by POST too, and orders nothing
        if request.method == "POST" and name != "forecast":
            asked.append(name)

    page.on("request", heard)
    return asked


def typed(place: Icrs) -> str:
    return f"{place.ra_deg:.5f} {place.dec_deg:+.5f}"


def expect_text(page: Page, selector: str, words: str) -> None:
    page.wait_for_function(
        "([selector, words]) => document.querySelector(selector)?.textContent.includes(words)",
        arg=[selector, words],
    )


def choose(page: Page, telescope: str) -> None:
    page.get_by_role("button", name=telescope, exact=True).click()
    page.wait_for_function(f"document.title.endsWith('· {telescope}')")
    page.wait_for_function("() => document.querySelector('#place-list dd').textContent !== '–'")
