"""The page in a real browser: keys that move an axis while they are held, and targets that move."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import httpx
import pytest

from api.demo.moving import satellite_lines
from mountnav.settings.observatory import Settings
from tests.browser.conftest import Visit, choose, expect_text
from tests.browser.watched_service import Served, Wire

pytestmark = pytest.mark.long


def state(observatory: Served) -> dict[str, object]:
    found: dict[str, object] = httpx.get(f"{observatory.url}/v1/telescopes/east", timeout=60).json()
    return found


def moving(observatory: Served) -> bool:
    return observatory.telescope("east").navigator.mount.axis_moving


def until(true: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + 60.0
    while not true():
        assert time.monotonic() < end_s, f"not {what}"
        time.sleep(0.02)


@pytest.fixture(autouse=True)
def _aside(observatory: Served) -> None:
    """Away from the zenith, where an axis turns in vain, and at rest."""
    place = observatory.place_at(50.0, 200.0)
    body = {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg}
    httpx.post(f"{observatory.url}/v1/telescopes/east/slew?wait=60&supersede=true", json=body, timeout=90)


def hold(visit: Visit, key: str = "north") -> None:
    page = visit.page
    page.locator(f"[data-pad={key}]").scroll_into_view_if_needed()
    box = page.locator(f"[data-pad={key}]").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 5, box["y"] + 5)
    page.mouse.down()


def opened(visit: Visit, url: str) -> None:
    page = visit.open(url)
    choose(page, "east")
    page.wait_for_function("() => !document.querySelector('[data-pad=north]').disabled")


def test_a_key_moves_while_it_is_held_and_no_longer(visit: Visit, observatory: Served) -> None:
    opened(visit, observatory.url)
    before = observatory.truly("east")
    hold(visit)
    until(lambda: moving(observatory), "moving")
    # longer than one order lasts: it is repeated
    time.sleep(2.0)
    assert moving(observatory)
    expect_text(visit.page, "#state-word", "By hand")
    expect_text(visit.page, "#following-lines", "by hand at")
    visit.page.mouse.up()
    until(lambda: not moving(observatory), "at rest")
    assert observatory.truly("east").dec_deg > before.dec_deg
    expect_text(visit.page, "#pad-told", "North: ended")


@pytest.mark.parametrize("how", ["blur", "hidden", "stop", "key"])
def test_whatever_takes_the_finger_away_ends_it(visit: Visit, observatory: Served, how: str) -> None:
    opened(visit, observatory.url)
    page = visit.page
    if how == "key":
        page.focus("[data-pad=south]")
        page.keyboard.down("Space")
    else:
        hold(visit)
    until(lambda: moving(observatory), "moving")
    if how == "blur":
        page.evaluate("window.dispatchEvent(new Event('blur'))")
    elif how == "hidden":
        page.evaluate(
            "Object.defineProperty(document, 'hidden', { value: true, configurable: true });"
            "document.dispatchEvent(new Event('visibilitychange'))"
        )
    elif how == "stop":
        page.keyboard.press("Escape")
        page.keyboard.press("Escape")
    else:
        page.keyboard.up("Space")
    until(lambda: not moving(observatory), "at rest")
    time.sleep(1.0)
    # though the button is still down
    assert not moving(observatory)
    page.mouse.up()


def test_a_line_that_breaks_leaves_nothing_moving(visit: Visit, observatory: Served, wire: Wire) -> None:
    visit.forgiven = ("Failed to load resource", "net::")
    opened(visit, wire.url)
    hold(visit)
    until(lambda: moving(observatory), "moving")
    wire.cut()
    until(lambda: not moving(observatory), "at rest")
    wire.lay()
    time.sleep(2.0)
    # held still, and begins no more
    assert not moving(observatory)
    visit.page.mouse.up()


def test_a_motion_that_is_refused_says_why_and_doesnt_try_on(visit: Visit, observatory: Served) -> None:
    visit.forgiven = ("Failed to load resource",)
    opened(visit, observatory.url)
    rates = {"ra_arcsec_s": 0.0, "dec_arcsec_s": 1.0, "for_s": 600.0}
    path = f"{observatory.url}/v1/telescopes/east"
    told = httpx.post(f"{path}/offset-rates?wait=30", json=rates, timeout=60).json()
    assert told["state"] == "succeeded", told
    expect_text(visit.page, "#following-lines", "until")
    hold(visit)
    expect_text(visit.page, "#pad-told", "it follows a moving target")
    time.sleep(1.0)
    jobs = [
        one for one in httpx.get(f"{path}/jobs?count=25", timeout=60).json() if one["kind"] == "move-axis"
    ]
    time.sleep(1.5)
    again = [
        one for one in httpx.get(f"{path}/jobs?count=25", timeout=60).json() if one["kind"] == "move-axis"
    ]
    assert [one["id"] for one in jobs] == [one["id"] for one in again]
    visit.page.mouse.up()
    httpx.post(f"{path}/stop", timeout=60)


def test_what_comes_next_is_told_before_anything_is_ordered(visit: Visit, observatory: Served) -> None:
    visit.forgiven = ("Failed to load resource",)
    opened(visit, observatory.url)
    page = visit.page
    page.fill("#target", "Moon")
    expect_text(page, "#target-moves", "Moon moves by")
    # within twelve hours the Moon rises or sets, or crosses the meridian, whatever the hour of the tests
    told = "document.querySelector('#target-next').textContent"
    page.wait_for_function(f"() => /rises|sets|meridian/.test({told})")
    assert page.is_visible("#follow")
    page.fill("#target", "Vega")
    expect_text(page, "#target-moves", "Vega stands still")
    assert page.is_hidden("#follow")
    # pasted elements go before what was typed
    settings: Settings = observatory.app.state.settings
    page.click("#elements-box summary")
    page.fill("#elements", satellite_lines(datetime.now(UTC), settings.site.site))
    expect_text(page, "#target-moves", "DEMOSAT moves by")
    page.fill("#elements", "no elements at all")
    page.wait_for_function("() => document.querySelector('#target-moves').className === 'bad-text'")
    page.click("#elements-clear")
    expect_text(page, "#target-moves", "Vega stands still")


def test_a_target_is_followed_and_the_sky_has_a_word(visit: Visit, observatory: Served) -> None:
    opened(visit, observatory.url)
    page = visit.page
    now = datetime.now(UTC)
    place = observatory.place_at(55.0, 190.0)
    body = {
        "kind": "follow",
        "duration_s": 300.0,
        "look_every_s": 5.0,
        "target": {
            "kind": "rates",
            "name": "a rock",
            "begins_utc": now.isoformat(),
            "ends_utc": (now + timedelta(hours=1)).isoformat(),
            "ra_deg": place.ra_deg,
            "dec_deg": place.dec_deg,
            "ra_arcsec_s": 0.3,
            "dec_arcsec_s": 0.4,
        },
    }
    told = httpx.post(f"{observatory.url}/v1/telescopes/east/jobs", json=body, timeout=60)
    assert told.status_code == 202, told.text
    expect_text(page, "#following-lines", "a rock")
    expect_text(page, "#state-word", "Following")
    expect_text(page, "#following-lines", "off")
    expect_text(page, "#following-lines", "Rates")
    following = state(observatory)["following"]
    assert isinstance(following, dict)
    assert following["name"] == "a rock"
    page.click("#stop")
    expect_text(page, "#stop-told", "told the mount")
    page.wait_for_function("() => document.querySelector('#following').hidden")
    assert state(observatory)["rates"] is None
