"""The page in a real browser: what people look at, what they do, and what happens when the line breaks."""

from __future__ import annotations

import base64
import io
import re
import time
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlsplit

import httpx
import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from mountnav.catalog.embedded import embedded_catalog
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.browser.conftest import KEY, Visit, choose, expect_text, orders_asked, typed
from tests.browser.watched_service import Served, Wire

pytestmark = pytest.mark.long

FIRST_PAINT_BYTES = 500_000


def job(observatory: Served, job_id: str) -> dict[str, Any]:
    found: dict[str, Any] = httpx.get(f"{observatory.url}/v1/jobs/{job_id}", timeout=60).json()
    return found


def newest_job(observatory: Served) -> dict[str, Any]:
    found: list[dict[str, Any]] = httpx.get(f"{observatory.url}/v1/jobs", timeout=60).json()
    return found[0]


def rest(observatory: Served, telescope: str) -> None:
    httpx.post(f"{observatory.url}/v1/telescopes/{telescope}/stop", timeout=60)


def test_the_first_paint_is_light_and_all_of_it_from_here(visit: Visit, observatory: Served) -> None:
    moved: dict[str, int] = {}

    def count(request: Any) -> None:
        sizes = request.sizes()
        moved[request.url] = sizes["responseBodySize"] + sizes["responseHeadersSize"]

    visit.page.on("requestfinished", count)
    page = visit.open(observatory.url)
    page.wait_for_function("() => document.querySelector('#journal-lines').childElementCount > 0")
    page.wait_for_timeout(300)
    assert {urlsplit(one).netloc for one in moved} == {urlsplit(observatory.url).netloc}
    assert any(one.endswith("uplot.js") for one in moved)
    # of a long night the newest jobs alone, and of this telescope
    assert any(re.search(r"/telescopes/\w+/jobs\?count=\d\d$", one) for one in moved)
    assert not any("/v1/jobs?" in one for one in moved)
    assert 50_000 < sum(moved.values()) < FIRST_PAINT_BYTES, moved


def test_a_centering_is_watched_to_its_end(visit: Visit, observatory: Served) -> None:
    page = visit.open(observatory.url)
    choose(page, "east")
    target = observatory.near("east")
    page.fill("#target", typed(target))
    expect_text(page, "#target-read", "RA read as degrees")
    expect_text(page, "#target-read", "Now at altitude")
    page.press("#target", "Enter")
    expect_text(page, "#state-word", "Centering")
    expect_text(page, "#job-body", "Cancel")
    expect_text(page, "#job-body", "succeeded")
    expect_text(page, "#job-body", "centered: from")
    found = newest_job(observatory)
    assert (found["kind"], found["state"]) == ("center", "succeeded")
    assert separation_arcsec(observatory.truly("east"), target) < 45.0
    # the table, the bullseye and the frame tell the same as the job
    attempts = found["attempts"]
    expect_text(page, "#attempt-rows", f"center {len(attempts)}")
    error = f"{attempts[-1]['error_arcsec']:.1f}″"
    assert page.locator("#attempt-rows .good-text").first.text_content() == error
    assert error in (page.get_attribute("#bullseye-map", "aria-label") or "")
    page.wait_for_function(
        "() => document.querySelector('#frame-map').getAttribute('aria-label').includes('stars identified')"
    )
    expect_text(page, "#frame-note", "1200×900")
    assert "telescope at altitude" in (page.get_attribute("#sky-map", "aria-label") or "")
    expect_text(page, "#state-word", "Tracking")
    page.wait_for_selector("#drift-plot .u-over")
    page.wait_for_selector("#residual-plot .u-over")
    expect_text(page, "#journal-lines", "seen at ")
    # what is read is what the service says
    state = httpx.get(f"{observatory.url}/v1/telescopes/east", timeout=60).json()
    shown = page.locator("#place-list dd").nth(1).text_content() or ""
    signed = -1 if state["icrs"]["dec_deg"] < 0 else 1
    d, m, s = (float(one) for one in re.findall(r"[\d.]+", shown))
    assert signed * (d + m / 60 + s / 3600) == pytest.approx(state["icrs"]["dec_deg"], abs=0.01)


def test_the_picture_is_the_frame_with_its_stars(visit: Visit, observatory: Served) -> None:
    page = visit.open(observatory.url)
    choose(page, "east")
    page.get_by_role("button", name="Look", exact=True).click()
    expect_text(page, "#order-told", "Look: taken")
    page.wait_for_function(
        "() => document.querySelector('#frame-map').getAttribute('aria-label').includes('identified')"
    )
    told = httpx.get(f"{observatory.url}/v1/telescopes/east/last-frame", timeout=60).json()
    picture = Image.open(io.BytesIO(httpx.get(observatory.url + told["picture"], timeout=60).content))
    assert picture.size == (1200, 900)
    shown = np.asarray(picture.convert("L"), dtype=float)
    # rows run down: a star measured at y is drawn at height - 1 - y
    peaks = [shown[899 - round(y), round(x)] for x, y in told["measured_px"][:10]]
    assert min(peaks) > np.median(shown) + 40
    assert {one["used"] for one in told["stars"]} >= {True}
    away = np.hypot(told["believed"]["x_px"] - 599.5, told["believed"]["y_px"] - 449.5)
    assert away * told["scale_arcsec_px"] == pytest.approx(told["believed"]["distance_arcsec"], rel=0.02)


@pytest.mark.parametrize("how", ["button", "keys"])
def test_stop_during_a_slew(visit: Visit, observatory: Served, how: str) -> None:
    page = visit.open(observatory.url)
    choose(page, "slow")
    page.fill("#target", typed(observatory.place_at(40.0, 250.0 if how == "button" else 110.0)))
    page.get_by_role("button", name="Slew only").click()
    expect_text(page, "#state-word", "Slewing")
    expect_text(page, "#order-told", "taken")
    if how == "button":
        page.locator("#stop").click()
    else:
        # a question that waits for its answer keeps nobody from stopping
        page.get_by_role("button", name="Park", exact=True).click()
        page.wait_for_selector("#ask:not([hidden])")
        page.keyboard.press("Escape")
        page.keyboard.press("Escape")
    expect_text(page, "#stop-told", "told the mount")
    expect_text(page, "#job-body", "cancelled")
    page.wait_for_function("() => document.querySelector('#state-word').textContent !== 'Slewing'")
    found = newest_job(observatory)
    assert (found["kind"], found["state"]) == ("slew", "cancelled")
    first = observatory.truly("slow")
    page.wait_for_timeout(400)
    assert separation_arcsec(first, observatory.truly("slow")) < 60.0
    page.get_by_role("button", name="Seen").click()
    assert page.locator("#stop-told").is_hidden()


WATCH_STREAM = """
const fetched = window.fetch;
window.fetch = async (...asked) => {
  const answer = await fetched(...asked);
  if (!String(asked[0]).includes("/v1/events") || !answer.ok) return answer;
  const [ours, its] = answer.body.tee();
  (async () => {
    const reader = ours.pipeThrough(new TextDecoderStream()).getReader();
    for (let told = await reader.read(); !told.done; told = await reader.read()) {
      if (/^id: /m.test(told.value)) window.streamTold = true;
    }
  })().catch(() => {});
  return new Response(its, answer);
};
"""
"""Sets `streamTold` when the page's stream of events has brought one."""


def test_a_cut_line_is_told_and_nothing_old_looks_fresh(
    visit: Visit, observatory: Served, wire: Wire
) -> None:
    visit.forgiven = ("Failed to load resource",)
    resumed: list[str] = []
    visit.page.on(
        "request",
        lambda one: resumed.append(one.headers.get("last-event-id", "")) if "/v1/events" in one.url else None,
    )
    visit.page.add_init_script(WATCH_STREAM)
    page = visit.open(wire.url)
    choose(page, "east")
    before = page.evaluate("document.querySelector('#job-body').dataset.job ?? ''")
    page.get_by_role("button", name="Look", exact=True).click()
    # this look, and not one of an earlier test: its end is what the stream has told last
    page.wait_for_function(
        "before => { const job = document.querySelector('#job-body').dataset;"
        "return job.job && job.job !== before && job.state === 'succeeded'; }",
        arg=before,
    )
    # its end may have been read before the stream told of it: without one it has no place to go on from
    page.wait_for_function("() => window.streamTold")
    wire.cut()
    page.wait_for_selector("#lost:not([hidden])")
    expect_text(page, "#lost", "Connection lost since")
    assert page.evaluate("document.body.classList.contains('lost')")
    style = page.evaluate(
        "(() => { const one = getComputedStyle(document.querySelector('#place dd'));"
        "return [one.textDecorationLine, Number(one.opacity)]; })()"
    )
    assert style[0] == "line-through"
    assert style[1] < 0.6
    assert page.get_by_role("button", name="Look", exact=True).is_disabled()
    # a stop that can't be sent says so, and goes on trying
    page.keyboard.press("Escape")
    page.keyboard.press("Escape")
    expect_text(page, "#stop-told", "NOT SENT")
    missed = httpx.post(f"{observatory.url}/v1/telescopes/east/look", json={}, timeout=60).json()["id"]
    assert job(observatory, missed + "?wait=60")["state"] == "succeeded"
    wire.lay()
    page.wait_for_selector("#lost", state="hidden")
    expect_text(page, "#stop-told", "told the mount")
    assert not page.evaluate("document.body.classList.contains('lost')")
    page.wait_for_function("() => document.querySelectorAll('#attempt-rows tr').length >= 2")
    page.wait_for_function("() => !document.querySelector('[data-order=look]').disabled")
    # the stream went on where it was cut
    page.wait_for_timeout(100)
    assert any(resumed[1:]), resumed


def test_a_file_dropped_on_the_page_is_solved(visit: Visit, observatory: Served) -> None:
    truth = Icrs(85.0, 30.0)
    instant = datetime(2026, 11, 21, tzinfo=UTC)
    frame = draw_frame(
        truth,
        SimulatedOptics(800, 600, 4.0),
        embedded_catalog(),
        exposure_s=2.0,
        mid_exposure_utc=instant,
        seed=(1, 2),
    )
    content = io.BytesIO()
    hdu = fits.PrimaryHDU(frame.pixels)
    hdu.header.update({"RA": 85.1, "DEC": 30.05, "SECPIX": 4.0})
    hdu.writeto(content)
    page = visit.open(observatory.url)
    dropped = page.evaluate_handle(
        """content => {
            const bytes = Uint8Array.from(atob(content), (one) => one.charCodeAt(0));
            const carried = new DataTransfer();
            carried.items.add(new File([bytes], "taurus.fits"));
            return carried;
        }""",
        base64.b64encode(content.getvalue()).decode(),
    )
    page.dispatch_event("body", "dragenter", {"dataTransfer": dropped})
    assert page.locator("#dropping").is_visible()
    page.dispatch_event("body", "drop", {"dataTransfer": dropped})
    assert page.locator("#dropping").is_hidden()
    expect_text(page, "#solve-told", "taurus.fits: solved")
    assert "05h40m0" in (page.text_content("#solve-told") or "") or "05h39m5" in (
        page.text_content("#solve-told") or ""
    )
    page.get_by_role("button", name="Take as target").click()
    read = [float(one) for one in page.input_value("#target").split()]
    assert separation_arcsec(Icrs(read[0], read[1]), truth) < 4.0


def test_a_phone_shows_it_all_and_never_scrolls_sideways(phone: Visit, observatory: Served) -> None:
    page = phone.open(observatory.url)
    page.wait_for_function("() => document.querySelector('#journal-lines').childElementCount > 0")
    for width in (360, 412, 820):
        page.set_viewport_size({"width": width, "height": 740})
        page.wait_for_timeout(100)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        for share in (0.0, 0.5, 1.0):
            page.evaluate(f"scrollTo(0, {share} * document.documentElement.scrollHeight)")
            box = page.locator("#stop").bounding_box()
            assert box is not None
            assert box["y"] >= 0
            assert box["y"] + box["height"] <= 740
            assert box["height"] >= 44
            # nothing lies over it
            assert page.evaluate(
                "([x, y]) => document.elementFromPoint(x, y).closest('#stop') !== null",
                [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2],
            )


def test_night_mode_is_red_on_black_and_remembered(visit: Visit, observatory: Served) -> None:
    page = visit.open(observatory.url)
    choose(page, "east")
    page.get_by_role("button", name="Look", exact=True).click()
    page.wait_for_function(
        "() => document.querySelector('#frame-map').getAttribute('aria-label').includes('identified')"
    )
    page.get_by_role("button", name="Night mode").click()
    page.fill("#target", "24 61 00 95")
    page.get_by_role("button", name="Park", exact=True).click()
    page.get_by_role("button", name="Key").click()
    page.wait_for_timeout(400)

    def colors() -> tuple[int, int, int]:
        shot = Image.open(io.BytesIO(page.screenshot(full_page=True))).convert("RGB")
        pixels = np.asarray(shot)
        return tuple(int(pixels[..., one].max()) for one in range(3))  # type: ignore[return-value]

    red, green, blue = colors()
    assert (green, blue) == (0, 0)
    assert red > 120
    page.reload()
    page.wait_for_function("() => document.querySelector('#place-list dd').textContent !== '–'")
    assert page.get_by_role("button", name="Night mode").get_attribute("aria-pressed") == "true"
    page.wait_for_timeout(300)
    assert colors()[1:] == (0, 0)
    page.get_by_role("button", name="Night mode").click()
    assert colors()[1] > 100


def test_a_lost_connection_is_told_by_the_services_clock(visit: Visit, wire: Wire) -> None:
    """Not by that of the computer that shows the page, which may be wrong, or live in another night."""
    visit.forgiven = ("Failed to load resource",)
    visit.page.add_init_script("{ const real = Date.now; Date.now = () => real() + 7_200_000; }")
    page = visit.open(wire.url)
    page.wait_for_function("() => document.querySelector('#clock-time').textContent !== '--:--:--'")
    wire.cut()
    page.wait_for_selector("#lost:not([hidden])")
    told = re.search(r"since (\d\d):(\d\d):(\d\d) UTC", page.text_content("#lost") or "")
    assert told is not None
    hours, minutes, seconds = map(int, told.groups())
    now = datetime.now(UTC)
    ago_s = 3600 * (now.hour - hours) + 60 * (now.minute - minutes) + now.second - seconds
    assert ago_s % 86_400 < 3600
    wire.lay()
    page.wait_for_selector("#lost", state="hidden")


def test_all_is_done_by_keys_alone(visit: Visit, observatory: Served) -> None:
    page = visit.open(observatory.url)
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.id") == "stop"
    width = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
    assert width == "solid"
    page.keyboard.press("/")
    assert page.evaluate("document.activeElement.id") == "target"
    page.keyboard.type(typed(observatory.near("east")))
    page.wait_for_function("() => !document.querySelector('#center').disabled")
    page.keyboard.press("Enter")
    expect_text(page, "#job-body", "center")
    rest(observatory, "east")
    for _ in range(30):
        if page.evaluate("document.activeElement.textContent") == "slow":
            break
        page.keyboard.press("Shift+Tab")
    page.keyboard.press("Enter")
    page.wait_for_function("() => document.title.endsWith('· slow')")
    orders = orders_asked(page)
    for _ in range(40):
        if page.evaluate("document.activeElement.dataset.order") == "park":
            break
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "ask-yes"
    expect_text(page, "#ask-words", "slow: Move the telescope to its park position?")
    page.keyboard.press("Escape")
    assert page.evaluate("document.activeElement.dataset.order") == "park"
    assert page.locator("#ask").is_hidden()
    assert orders == []
    page.wait_for_function("() => !document.querySelector('#stop').classList.contains('armed')")
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")
    expect_text(page, "#order-told", "Park: taken")
    expect_text(page, "#state-word", "Parking")
    page.keyboard.press("Escape")
    page.keyboard.press("Escape")
    expect_text(page, "#stop-told", "told the mount")
    expect_text(page, "#job-body", "cancelled")
    # a stop of which a busy machine doesn't know in time whether it was told is asked for again
    assert orders == ["park", *["stop"] * max(1, len(orders) - 1)]


def test_a_night_is_begun_and_ended(visit: Visit, observatory: Served) -> None:
    page = visit.open(observatory.url)
    choose(page, "east")
    page.wait_for_function("() => !document.querySelector('[data-order=\"night/start\"]').disabled")
    for button, phase in (("End night", "stopped"), ("Start night", "calibrating")):
        page.get_by_role("button", name=button).click()
        page.get_by_role("button", name="Yes").click()
        expect_text(page, "#order-told", f"{button}: done")
        expect_text(page, "#night-list", phase)


def test_a_key_is_asked_for_and_kept_in_the_tab_alone(visit: Visit, locked: Served) -> None:
    visit.forgiven = ("Failed to load resource",)
    asked: list[str] = []
    visit.page.on("request", lambda one: asked.append(one.url))
    page = visit.page
    page.goto(locked.url)
    page.wait_for_selector("#key-row:not([hidden])")
    expect_text(page, "#notice", "no key came")
    page.fill("#key", "wrong")
    page.keyboard.press("Enter")
    expect_text(page, "#notice", "not known")
    page.wait_for_selector("#key-row:not([hidden])")
    page.fill("#key", KEY)
    page.keyboard.press("Enter")
    page.wait_for_function("() => document.querySelector('#place-list dd').textContent !== '–'")
    assert page.locator("#key-row").is_hidden()
    page.get_by_role("button", name="Look", exact=True).click()
    expect_text(page, "#job-body", "succeeded")
    assert not [one for one in asked if "key" in urlsplit(one).query or "a%20key" in one]
    assert KEY in page.evaluate("() => Object.values(sessionStorage).join()")
    assert KEY not in page.evaluate(
        "() => Object.values(localStorage).join() + document.cookie + location.href"
    )
    page.get_by_role("button", name="Key").click()
    page.get_by_role("button", name="Forget it").click()
    page.wait_for_function("() => document.querySelector('#place-list dd').textContent === '–'")


def test_the_last_refusal_of_a_wrong_key_takes_nothing_from_the_right_one(
    visit: Visit, locked: Served
) -> None:
    # a question that was asked with the wrong key, and is answered when the right one has been taken long ago
    visit.forgiven = ("Failed to load resource",)
    page = visit.page
    held: list[Any] = []

    def hold(route: Any) -> None:
        if route.request.headers.get("x-api-key") == "wrong" and "events" not in route.request.url:
            held.append(route)
        else:
            route.continue_()

    page.route("**/v1/**", hold)
    page.goto(locked.url)
    page.wait_for_selector("#key-row:not([hidden])")
    page.fill("#key", "wrong")
    page.keyboard.press("Enter")
    page.wait_for_selector("#key-row", state="hidden")
    deadline = time.monotonic() + 30.0
    while not held and time.monotonic() < deadline:
        page.wait_for_timeout(20)
    page.get_by_role("button", name="Key").click()
    page.fill("#key", KEY)
    page.keyboard.press("Enter")
    page.wait_for_function("() => document.querySelector('#place-list dd').textContent !== '–'")
    # whatever the late answers would do is done when the page has heard them and gone on
    page.evaluate(
        """() => {
          window.emptied = 0;
          const list = document.querySelector('#place-list');
          const look = () => { if (list.querySelector('dd').textContent === '–') window.emptied++; };
          new MutationObserver(look).observe(list, { subtree: true, childList: true, characterData: true });
        }"""
    )
    assert held
    for route in held:
        with page.expect_response(route.request.url):
            route.continue_()
    with page.expect_response("**/sky*"):
        pass
    with page.expect_response("**/sky*"):
        pass
    assert page.locator("#key-row").is_hidden()
    assert page.locator("#notice").is_hidden()
    assert page.evaluate("window.emptied") == 0


def test_a_key_in_letters_that_no_header_carries_takes_no_stop_away(
    visit: Visit, observatory: Served
) -> None:
    page = visit.open(observatory.url)
    choose(page, "east")
    page.click("#key-open")
    page.fill("#key", "ключ")
    page.press("#key", "Enter")
    expect_text(page, "#notice", "That is no key")
    assert page.evaluate("sessionStorage.getItem('mountnav-key')") is None
    # one that an older page kept is not sent either
    page.evaluate("sessionStorage.setItem('mountnav-key', 'ключ')")
    page = visit.open(observatory.url)
    choose(page, "east")
    page.locator("#stop").click()
    expect_text(page, "#stop-told", "told the mount")
    assert page.locator("#lost").is_hidden()
    page.evaluate("sessionStorage.removeItem('mountnav-key')")


def test_every_control_has_a_name(visit: Visit, observatory: Served) -> None:
    page = visit.open(observatory.url)
    page.get_by_role("button", name="Key").click()
    page.fill("#target", "Vega")
    page.wait_for_timeout(600)
    tree = visit.context.new_cdp_session(page).send("Accessibility.getFullAXTree")["nodes"]
    roles = {
        "button",
        "textbox",
        "searchbox",
        "combobox",
        "radio",
        "checkbox",
        "link",
        "image",
        "region",
        "table",
    }
    seen = [one for one in tree if not one.get("ignored") and one["role"]["value"] in roles]
    assert len(seen) > 30
    nameless = [one for one in seen if not one.get("name", {}).get("value", "").strip()]
    assert nameless == []


def test_a_name_is_found_and_its_place_is_told(visit: Visit, observatory: Served) -> None:
    page = visit.open(observatory.url)
    page.fill("#target", "Polaris")
    expect_text(page, "#target-read", "+89°")
    page.wait_for_function("() => !document.querySelector('#center').disabled")
    page.fill("#target", "Nosuchstar")
    expect_text(page, "#target-read", "No object of that name")
    assert page.locator("#center").is_disabled()
    page.fill("#target", "25 00 00 +10 00 00")
    expect_text(page, "#target-read", "goes up to 24 h")
    assert page.get_attribute("#target", "aria-invalid") == "true"


def test_what_the_service_refuses_is_told_in_its_words(visit: Visit, observatory: Served) -> None:
    visit.forgiven = ("Failed to load resource",)
    page = visit.open(observatory.url)
    choose(page, "east")
    page.fill("#target", typed(observatory.place_at(-30.0, 200.0)))
    expect_text(page, "#target-read", "Not now:")
    page.get_by_role("button", name="Slew only").click()
    page.wait_for_function(
        "() => /refused|failed/.test(document.querySelector('#order-told').textContent"
        " + document.querySelector('#job-body').textContent)"
    )
    page.locator("#journal-filter span", has_text="trouble").click()
    page.wait_for_function(
        "() => document.querySelectorAll('#journal-lines li.trouble').length === "
        "document.querySelectorAll('#journal-lines li:not(.day)').length"
    )
