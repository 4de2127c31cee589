"""The page that stays open all night: what it says at a glance, that nothing jumps, who can read it.

Each panel is photographed empty, loading, stale and with an error; into $MOUNTNAV_PICTURES if that is set.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from tests.browser.conftest import Visit, choose, expect_text, typed, visiting
from tests.browser.watched_service import TOML, Served, Wire, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route, ViewportSize

pytestmark = pytest.mark.long

STATE_LINE = Path(__file__).resolve().parents[2] / "api" / "web" / "js" / "state_line.js"
DESK = {"viewport": {"width": 1440, "height": 900}}
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
ON_ITS_SIDE: ViewportSize = {"width": 844, "height": 390}
PARTS = ("orders", "move", "see", "log")
GONE = """
[[telescope]]
id = "gone"
mount = { url = "lx200+serial:///dev/there-is-no-such-port" }
camera = { kind = "folder", path = "/" }
"""
WATCH_SHIFTS = """() => {
  window.shifts = [];
  new PerformanceObserver((list) => {
    for (const one of list.getEntries()) {
      const name = (node) => node?.id || node?.parentElement?.id || node?.nodeName;
      const moved = one.sources.map((source) => name(source.node));
      if (!one.hadRecentInput) window.shifts.push([one.value, one.startTime, ...moved]);
    }
  }).observe({ type: "layout-shift", buffered: true });
}"""
CENTERED = "() => /^(succeeded)$/.test(document.querySelector('#job-body').dataset.state)"


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A telescope that works, one that is slow, one that isn't there."""
    folder = tmp_path_factory.mktemp("night")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MOUNTNAV_JOURNAL", str(folder / "journal.sqlite"))
        with served(TOML + GONE) as one:
            yield one


@pytest.fixture(scope="module")
def axe() -> str:
    """The rules of axe-core, as a script."""
    found = pytest.importorskip("axe_playwright_python", reason="axe-playwright-python is not installed")
    return (Path(str(found.__file__)).parent / "axe.min.js").read_text(encoding="utf-8")


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    folder = Path(os.environ.get("MOUNTNAV_PICTURES") or tmp_path)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def order(served_by: Served, telescope: str, kind: str, **more: object) -> dict[str, Any]:
    answer = httpx.post(
        f"{served_by.url}/v1/telescopes/{telescope}/jobs", json={"kind": kind, **more}, timeout=60
    )
    assert answer.status_code == 202, answer.text
    found: dict[str, Any] = answer.json()
    return found


def state(served_by: Served, telescope: str) -> dict[str, Any]:
    found: dict[str, Any] = httpx.get(f"{served_by.url}/v1/telescopes/{telescope}", timeout=60).json()
    return found


def at_night(page: Page, yes: bool) -> None:
    if page.evaluate("document.documentElement.dataset.night !== undefined") is not yes:
        page.click("#night-mode")


def serious(page: Page, axe: str) -> list[str]:
    page.evaluate(axe)
    found = page.evaluate("axe.run()")
    return [
        f"{one['id']}: {[node['html'][:120] for node in one['nodes'][:3]]}"
        for one in found["violations"]
        if one["impact"] in ("serious", "critical")
    ]


def jumps(page: Page) -> list[Any]:
    found: list[Any] = page.evaluate("window.shifts")
    return found


def outside(page: Page, width: int) -> list[str]:
    """What is shown and reaches over the edge, but within boxes that scroll."""
    found: list[str] = page.evaluate(
        """width => [...document.querySelectorAll('#head *, .panel, #panels button, #panels input, #stop')]
          .concat([...document.querySelectorAll('#tabs *')])
          .filter((one) => !one.closest('.unseen, #telescopes, .scroll') && one.getClientRects().length)
          .filter((one) => {
            const box = one.getBoundingClientRect();
            return box.width > 1 && (box.left < -0.5 || box.right > width + 0.5);
          })
          .map((one) => one.id || one.outerHTML.slice(0, 60))""",
        width,
    )
    return found


def test_a_centering_is_seen_at_a_glance_and_nothing_jumps(
    browser: Browser, night: Served, axe: str, pictures: Path
) -> None:
    with visiting(browser, **DESK) as first, visiting(browser, **PHONE) as second:
        desk, phone = first.open(night.url), second.open(night.url)
        for page in (desk, phone):
            choose(page, "east")
            page.evaluate(WATCH_SHIFTS)
        place = night.near("east")
        target = {"kind": "icrs", "ra_deg": place.ra_deg, "dec_deg": place.dec_deg}
        job = order(night, "east", "center", target=target)
        for page in (desk, phone):
            page.wait_for_function(CENTERED)
            expect_text(page, "#headline-figures", "off")
        desk.wait_for_selector("#drift-plot .uplot", state="attached")
        desk.wait_for_selector("#residual-plot .uplot", state="attached")
        done = httpx.get(f"{night.url}/v1/jobs/{job['id']}", timeout=60).json()["result"]
        told = desk.text_content("#headline-figures") or ""
        assert f"{done['error_after_arcsec']:.1f}″ off" in told
        assert re.search(r"FWHM \d+\.\d″", told)
        assert re.search(r"(to|past) meridian|on the meridian", told)
        assert re.search(r"(sunset|dark|dawn|sunrise) \d\d:\d\d", told)
        # the night strip tells the same looks as the service
        desk.wait_for_function(
            "count => document.querySelector('#strip-map').ariaLabel.includes(`${count} looks solved`)",
            arg=f"{len(tonight(night))} of {len(tonight(night))}",
        )
        # drift and residuals have something to show from the first looks on
        for plot in ("#drift-plot", "#residual-plot"):
            assert desk.locator(f"{plot} canvas").count() == 1
        labels = desk.evaluate("import('/web/js/bullseye.js').then((one) => one.labels)")
        assert len(labels) >= 3
        boxes = [one["box"] for one in labels]
        assert not [
            (a, b)
            for number, a in enumerate(boxes)
            for b in boxes[:number]
            if a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
        ]
        # a message comes, and goes: what is below stays where it is
        httpx.post(f"{night.url}/v1/telescopes/east/stop", timeout=60)
        desk.wait_for_timeout(1500)
        for page, name in ((desk, "desk"), (phone, "phone")):
            assert jumps(page) == [], name
        for dark in (False, True):
            word = "night" if dark else "day"
            at_night(desk, dark)
            at_night(phone, dark)
            desk.screenshot(path=str(pictures / f"desk-{word}.png"))
            assert outside(desk, 1440) == []
            assert serious(desk, axe) == [], f"desk, {word}"
            for part in PARTS:
                phone.click(f"[data-part={part}]")
                phone.screenshot(path=str(pictures / f"phone-{part}-{word}.png"))
                assert outside(phone, 390) == [], part
                assert serious(phone, axe) == [], f"phone, {part}, {word}"


def tonight(night: Served) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = httpx.get(f"{night.url}/v1/telescopes/east/tonight", timeout=60).json()[
        "looks"
    ]
    return found


def test_orders_are_within_reach_of_a_thumb(browser: Browser, night: Served, pictures: Path) -> None:
    with visiting(browser, **PHONE) as visit:
        page = visit.open(night.url)
        choose(page, "east")
        page.wait_for_function("() => !document.querySelector('[data-order=look]').disabled")
        small = page.evaluate(
            """() => [...document.querySelectorAll('button, select, .choice span')]
              .filter((one) => one.getClientRects().length)
              .filter((one) => {
                const box = one.getBoundingClientRect();
                return Math.min(box.height, box.width) < 43.5;
              })
              .map((one) => one.id || one.outerHTML.slice(0, 70))"""
        )
        assert small == []
        assert page.locator("#stop-keys").is_hidden()  # glass has no Esc
        bar = page.locator("#tabs").bounding_box()
        assert bar is not None
        for name in ("look", "sync", "park", "home"):
            box = page.locator(f"[data-order={name}]").bounding_box()
            assert box is not None
            # in the lower half, above the bar: no scrolling before one can press it
            assert 844 / 2 < box["y"] < box["y"] + box["height"] <= bar["y"], name
        # a question stands where the thumb is
        page.click("[data-order=park]")
        box = page.locator("#ask-yes").bounding_box()
        assert box is not None
        assert 844 / 2 < box["y"] < box["y"] + box["height"] <= bar["y"]
        page.click("#ask-no")
        page.click("[data-part=move]")
        assert page.locator("[data-pad=north]").is_visible()
        assert page.locator("[data-nudge=north]").is_visible()
        # on its side: STOP at the right, the orders beside the target
        page.set_viewport_size(ON_ITS_SIDE)
        page.click("[data-part=orders]")
        page.screenshot(path=str(pictures / "on-its-side.png"))
        for name in ("#stop", "#target", "#center", "[data-order=look]", "[data-order=park]"):
            box = page.locator(name).bounding_box()
            assert box is not None
            assert 0 <= box["y"] < box["y"] + box["height"] <= 390, name
        assert outside(page, 844) == []


def test_going_there_instead_and_coming_to_rest(visit: Visit, night: Served) -> None:
    visit.forgiven = ("Failed to load resource",)
    page = visit.open(night.url)
    choose(page, "slow")
    far, other = night.place_at(40.0, 250.0), night.place_at(60.0, 110.0)
    first = order(
        night, "slow", "slew", target={"kind": "icrs", "ra_deg": far.ra_deg, "dec_deg": far.dec_deg}
    )
    expect_text(page, "#state-word", "Slewing")
    page.fill("#target", typed(other))
    page.wait_for_function("() => !document.querySelector('#slew').disabled")
    page.click("#slew")
    expect_text(page, "#ask-words", "slow is busy: slew")
    # on a busy computer the page may lose sight of the service for a moment, and takes the question back
    if page.locator("#ask").is_hidden():
        page.click("#slew")
        page.wait_for_selector("#ask:not([hidden])")
    # no machine's words
    told = (page.text_content("#ask") or "") + (page.text_content("#order-told") or "")
    assert first["id"] not in told
    assert "DELETE" not in told
    page.get_by_role("button", name="Go there instead", exact=True).click()
    page.wait_for_function("id => document.querySelector('#job-body').dataset.job !== id", arg=first["id"])
    expect_text(page, "#order-told", "slew: taken")
    ended = httpx.get(f"{night.url}/v1/jobs/{first['id']}?wait=30", timeout=60).json()
    assert ended["state"] == "cancelled"
    assert state(night, "slow")["job_id"] not in (None, first["id"])
    # all that is said of the stop, one after the other
    page.evaluate(
        """() => {
          window.said = [];
          const box = document.querySelector('#stop-told');
          const all = { subtree: true, childList: true, characterData: true };
          new MutationObserver(() => window.said.push(box.textContent)).observe(box, all);
        }"""
    )
    page.locator("#stop").click()
    page.wait_for_function(
        "() => /(alone|rest|seen) since \\d\\d:\\d\\d:\\d\\d UTC/"
        ".test(document.querySelector('#stop-told').textContent)"
    )
    said = page.evaluate("window.said")
    assert any("sending" in one or "stopping" in one for one in said)
    now = state(night, "slow")
    assert now["slewing"] is False
    # by the clock of the service
    assert now["still_since_utc"][11:19] in (page.text_content("#stop-told") or "")
    page.get_by_role("button", name="Seen").click()
    # a mount that doesn't track stands: at rest
    page.get_by_role("button", name="Track off", exact=True).click()
    expect_text(page, "#state-word", "At rest")
    expect_text(page, "#state-detail", "at rest since")
    # the state may show it before the order has ended, and until then the next one is refused as busy
    expect_text(page, "#order-told", "Track off: taken")
    off = page.evaluate("document.querySelector('#job-body').dataset.job")
    assert httpx.get(f"{night.url}/v1/jobs/{off}?wait=30", timeout=60).json()["state"] == "succeeded"
    page.get_by_role("button", name="Track on", exact=True).click()
    expect_text(page, "#state-word", "Tracking")
    # a nudge goes so far on the sky, and no farther
    before = state(night, "slow")["icrs"]
    page.select_option("#nudge-by", "600")
    page.get_by_role("button", name="Nudge north").click()
    page.wait_for_function("() => document.querySelector('#job-body').textContent.includes('offset')")
    page.wait_for_function(CENTERED)
    after = state(night, "slow")["icrs"]
    assert (after["dec_deg"] - before["dec_deg"]) * 3600 == pytest.approx(600.0, abs=60.0)


def test_the_wall_shows_all_and_trouble_is_told_if_wanted(
    visit: Visit, night: Served, pictures: Path
) -> None:
    page = visit.open(night.url)
    page.click("#wall-open")
    page.wait_for_selector(".tile")
    assert page.locator(".tile").count() == 3
    expect_text(page, ".tile[data-id=gone] .word", "Disconnected")
    assert page.get_attribute(".tile[data-id=gone]", "data-tone") == "bad"
    east = state(night, "east")
    d, m, s = (
        float(one)
        for one in re.findall(r"[\d.]+", (page.text_content(".tile[data-id=east] .place") or "").split()[1])
    )
    assert d + m / 60 + s / 3600 == pytest.approx(abs(east["icrs"]["dec_deg"]), abs=0.02)
    # what each is on, in the words of the headline
    on = east["on"]
    if on is None:
        expect_text(page, ".tile[data-id=east] .on", "no target")
    else:
        expect_text(page, ".tile[data-id=east] .on", on["name"])
    expect_text(page, ".tile[data-id=gone] .on", "no target")
    told = page.evaluate(
        """async () => {
          const { onWords } = await import('/web/js/fleet.js');
          const on = { name: 'M 31', arrived: true, error_arcsec: 2.04, error_utc: '2026-11-26T20:00:00Z' };
          const going = { ...on, arrived: false, error_arcsec: null };
          return [onWords(on, 3), onWords(on, 300), onWords(going, null)];
        }"""
    )
    assert told == ["M 31 · 2.0″ off", "M 31 · 2.0″ off, 5 min 00 s ago", "to M 31"]
    page.screenshot(path=str(pictures / "wall.png"))
    # neither a sound nor a notification before somebody wants them
    page.click("#alerts-open")
    for one in ("#alert-sound", "#alert-notify"):
        assert page.get_attribute(one, "aria-pressed") == "false"
    page.evaluate(
        """() => {
          window.rung = 0;
          const make = AudioContext.prototype.createOscillator;
          AudioContext.prototype.createOscillator = function () { window.rung++; return make.call(this); };
        }"""
    )
    page.wait_for_timeout(3500)
    assert page.evaluate("window.rung") == 0
    page.click("#alert-sound")
    page.wait_for_function("() => window.rung > 0")
    assert page.get_attribute("#alert-sound", "aria-pressed") == "true"
    expect_text(page, "#alerts-open", "Alerts on")
    told = page.evaluate(
        """async () => {
          const { troublesOf } = await import('/web/js/alerts.js');
          const gone = { id: 'gone', connected: false, problem: 'no such port' };
          const fine = { id: 'east', connected: true, tracking: true };
          return [troublesOf({ lostSince: null, fleet: [gone, fine], state: null }),
            troublesOf({ lostSince: new Date(), fleet: [], state: null })];
        }"""
    )
    assert list(told[0]) == ["gone"]
    assert list(told[1]) == [""]
    page.click("#alert-sound")
    page.click(".tile[data-id=gone]")
    page.wait_for_function("() => document.title.endsWith('· gone')")
    expect_text(page, "#headline-target", "no telescope connected")
    assert page.text_content("#headline-figures") == ""
    expect_text(page, "#place .state", "No telescope connected")


PANELS = ("bullseye", "frame", "strip", "attempts", "drift", "residuals")
READ_FROM = {
    "bullseye": "jobs",
    "frame": "last-frame",
    "strip": "tonight",
    "attempts": "jobs",
    "drift": "offsets",
    "residuals": "offsets",
}


def photograph(page: Page, pictures: Path, named: str) -> None:
    for panel in (*PANELS, "place", "sky", "journal", "doctors", "control"):
        page.locator(f"#{panel}").screenshot(path=str(pictures / f"{panel}-{named}.png"))


def expect_states(page: Page, wanted: str, panels: tuple[str, ...] = PANELS) -> None:
    page.wait_for_function(
        "([panels, wanted]) => panels.every((one) => document.getElementById(one).dataset.state === wanted)",
        arg=[list(panels), wanted],
    )
    for panel in panels:
        assert page.locator(f"#{panel} > .state").is_visible(), panel


def test_each_panel_says_what_it_has_not(browser: Browser, night: Served, pictures: Path) -> None:
    wire = Wire(night.port)
    try:
        with visiting(browser, **DESK) as visit:
            visit.forgiven = ("Failed to load resource",)
            page = visit.page
            held: list[Any] = []
            failing: list[Any] = []

            def between(route: Route) -> None:
                if not re.search(
                    r"/(jobs\?|last-frame$|tonight|offsets|lease$)|/v1/(journal|health)", route.request.url
                ):
                    route.continue_()
                elif failing:
                    problem = {
                        "type": "urn:mountnav:problem:journal-failed",
                        "title": "no",
                        "detail": "the disk is full",
                    }
                    route.fulfill(
                        status=503, content_type="application/problem+json", body=json.dumps(problem)
                    )
                else:
                    held.append(route)

            page.route("**/v1/**", between)
            page.add_init_script("localStorage.setItem('mountnav-telescope', 'gone')")
            page.goto(wire.url)
            page.wait_for_function(
                "() => document.querySelector('#state-word').textContent === 'Disconnected'"
            )
            expect_states(page, "loading")
            photograph(page, pictures, "loading")
            failing.append(True)
            for route in held:
                between(route)
            expect_states(page, "error")
            expect_text(page, "#strip > .state", "the disk is full")
            photograph(page, pictures, "error")
            page.unroute("**/v1/**")
            # it asks again by itself, and there is nothing of this telescope
            page.reload()
            expect_states(page, "empty", ("bullseye", "frame", "drift", "residuals"))
            photograph(page, pictures, "empty")
            wire.cut()
            expect_states(page, "stale")
            expect_text(page, "#frame > .state", "no connection")
            photograph(page, pictures, "stale")
            wire.lay()
            expect_states(page, "empty", ("bullseye", "frame", "drift", "residuals"))
    finally:
        wire.close()


def test_the_description_of_the_api_follows_the_night(visit: Visit, night: Served) -> None:
    page = visit.open(night.url)
    at_night(page, True)
    page.goto(f"{night.url}/docs")
    page.wait_for_selector(".swagger-ui .opblock", timeout=60_000)
    brightest = brightness(page)
    # red on black: green and blue are dark everywhere
    assert brightest[0] > 150
    assert max(brightest[1:]) < 40
    page.goto(night.url)
    at_night(page, False)
    page.goto(f"{night.url}/docs")
    page.wait_for_selector(".swagger-ui .opblock", timeout=60_000)
    assert min(brightness(page)) > 240


def test_the_description_of_the_api_is_dark_where_the_system_is(visit: Visit, night: Served) -> None:
    page = visit.page
    page.emulate_media(color_scheme="dark")
    page.goto(f"{night.url}/docs")
    page.wait_for_selector(".swagger-ui .opblock", timeout=60_000)
    assert most_of(page) < 60
    # a morning comes, and an evening, while it is open
    page.emulate_media(color_scheme="light")
    page.wait_for_function("() => !document.documentElement.classList.contains('dark-mode')")
    assert most_of(page) > 200
    # the night of the page, chosen in another tab
    other = visit.context.new_page()
    other.goto(night.url)
    other.evaluate("localStorage.setItem('mountnav-night', '1')")
    page.wait_for_function("() => 'night' in document.documentElement.dataset")
    assert max(brightness(page)[1:]) < 40
    other.evaluate("localStorage.removeItem('mountnav-night')")
    page.wait_for_function("() => !('night' in document.documentElement.dataset)")
    # whoever asks for a key far down the page finds its dialog in sight, at night too
    other.evaluate("localStorage.setItem('mountnav-night', '1')")
    page.reload()
    page.wait_for_selector(".swagger-ui .opblock", timeout=60_000)
    page.mouse.wheel(0, 5000)
    page.evaluate("document.querySelector('.swagger-ui .authorize').click()")
    box = page.locator(".modal-ux").bounding_box()
    assert box is not None
    assert 0 <= box["y"] < page.viewport_size["height"] - 100  # type: ignore[index]


@pytest.mark.parametrize(("width", "height"), [(390, 844), (844, 390), (1440, 900)])
def test_a_long_name_hides_no_other_telescope(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, width: int, height: int
) -> None:
    monkeypatch.setenv("MOUNTNAV_JOURNAL", str(tmp_path / "journal.sqlite"))
    name = "a-telescope-with-a-name-of-forty-letters"
    on_glass = width < 1000
    with (
        served(TOML.replace('id = "east"', f'id = "{name}"')) as one,
        visiting(
            browser,
            viewport={"width": width, "height": height},
            has_touch=on_glass,
            is_mobile=on_glass,
        ) as visit,
    ):
        page = visit.open(one.url)
        row = page.locator("#telescopes").bounding_box()
        other = page.locator("#telescopes button", has_text="slow").bounding_box()
        assert row is not None
        assert other is not None
        assert other["x"] + 20 < row["x"] + row["width"]
        cut = page.evaluate(
            "getComputedStyle(document.querySelector('#telescopes button span')).textOverflow"
        )
        assert cut == "ellipsis"
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        # the word of the state is never cut, least of all the one for a lost connection
        source = STATE_LINE.read_text(encoding="utf-8")
        words = re.findall(r'(?::|say\() ?"([A-Z][A-Za-z ]+)"', source)
        assert {"No connection", "Disconnected", "Not trusted", "First light"} <= set(words)
        cut_words = page.evaluate(
            "words => { const one = document.querySelector('#state-word').cloneNode();"
            "document.querySelector('#state-word').replaceWith(one);"
            "const isCut = word => { one.textContent = word; return one.scrollWidth > one.clientWidth; };"
            "return words.filter(isCut); }",
            words,
        )
        assert cut_words == []
        # what a finger presses is as large as a finger
        if on_glass:
            small = page.evaluate(
                "() => [...document.querySelectorAll('button, a[href], summary, select, textarea')]"
                ".filter(one => one.checkVisibility({ visibilityProperty: true }))"
                ".map(one => [one.textContent.trim(), one.getBoundingClientRect()])"
                ".filter(([, box]) => box.width && (box.width < 43.5 || box.height < 43.5))"
                ".map(([words, box]) => `${words}: ${box.width} x ${box.height}`)"
            )
            assert small == []


def most_of(page: Page) -> int:
    """How bright the greater part of what is seen is, 0 to 255."""
    import io

    import numpy as np
    from PIL import Image

    return int(np.median(np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("L"))))


def brightness(page: Page) -> list[int]:
    import io

    import numpy as np
    from PIL import Image

    seen = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
    return [int(one) for one in np.percentile(seen.reshape(-1, 3), 99.5, axis=0)]


def test_words_of_the_headline_are_true_or_not_there(visit: Visit, night: Served) -> None:
    page = visit.open(night.url)
    told = page.evaluate((Path(__file__).parent / "headline_words.js").read_text(encoding="utf-8"))
    assert told["known"] == [
        "Vega",
        "2.0″ off | FWHM 3.1″, 30 min ago | 61.3° high | 2 h 48 to meridian | dawn 04:46",
    ]
    assert told["unknown"] == "not seen since it came"
    assert "1 h 12 past meridian" in told["past"]
    assert told["away"] == {"target": None, "parts": []}
    assert told["rest"] == ["at rest since 21:32:10 UTC", None, None]
    assert told["places"] == "seen at 16h02m38.9s +51°54′35″: 37 stars, then 00h00m00.0s −05°30′00″"
    assert told["angles"] == ["0.0°", "−12.3°", "–", "2 h 48", "48 min", "1 min"]
