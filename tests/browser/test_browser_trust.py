"""The page in a real browser: who holds the telescope, what follows a STOP, nothing old told as new."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import httpx
import numpy as np
import pytest
from PIL import Image

from tests.browser.conftest import KEY, Visit, choose, expect_text, orders_asked, typed
from tests.browser.watched_service import TOML, Served, Wire, served

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.long


def lease_of(observatory: Served) -> dict[str, Any]:
    found: dict[str, Any] = httpx.get(f"{observatory.url}/v1/telescopes/east/lease", timeout=60).json()
    return found


def press(page: Page, name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()


def test_control_is_taken_kept_given_back_and_never_lost_unnoticed(visit: Visit, observatory: Served) -> None:
    visit.forgiven = ("Failed to load resource",)
    page, path = visit.open(observatory.url), f"{observatory.url}/v1/telescopes/east"
    choose(page, "east")
    expect_text(page, "#control-words", "Nobody holds")
    press(page, "Take control …")
    page.fill("#control-note", "Ada, field 17")
    page.get_by_text("stop and park", exact=True).click()
    with page.expect_request(lambda one: one.method == "PUT" and one.url.endswith("/lease")):
        press(page, "Take it")
    expect_text(page, "#control-words", "This page holds the telescope")
    told = lease_of(observatory)
    assert (told["held"], told["note"], told["on_expiry"]) == (True, "Ada, field 17", "park")
    assert httpx.post(f"{path}/look", json={}, timeout=60).json()["type"].endswith("leased")
    press(page, "Look")
    expect_text(page, "#order-told", "Look: taken")
    # it outlives a reload, with a sign of life at once
    with page.expect_request(lambda one: one.method == "PUT" and one.url.endswith("/lease")):
        page.reload()
    expect_text(page, "#control-words", "This page holds the telescope")
    press(page, "Release control")
    expect_text(page, "#control-words", "Nobody holds")
    assert lease_of(observatory)["held"] is False
    # another's is shown, broken only when that was asked for, and broken by another it is told
    other = {"ttl_s": 600, "on_expiry": "keep-tracking", "note": "survey"}
    assert httpx.post(f"{path}/lease", json=other, timeout=60).status_code == 201
    expect_text(page, "#control-words", "(survey) holds the telescope")
    press(page, "Look")
    expect_text(page, "#order-told", "Look: refused.")
    press(page, "Break it …")
    expect_text(page, "#control-ask", "breaks the hold of")
    press(page, "Take it")
    expect_text(page, "#control-words", "This page holds the telescope")
    theirs = httpx.post(f"{path}/lease", json={**other, "force": True}, timeout=60).json()["lease"]
    expect_text(page, "#control-lost", "This page holds east no more")
    expect_text(page, "#control-words", "(survey) holds the telescope")
    assert httpx.delete(f"{path}/lease", headers={"Mountnav-Lease": theirs}, timeout=60).is_success


def test_no_order_comes_behind_a_stop_nor_twice(visit: Visit, observatory: Served) -> None:
    visit.forgiven = ("Failed to load resource",)
    page = visit.open(observatory.url)
    choose(page, "slow")
    sent = orders_asked(page)
    # the order's answer is missing, it would be asked again: the stop comes before
    page.route("**/slow/slew", lambda route: route.abort())
    page.fill("#target", typed(observatory.place_at(50.0, 240.0)))
    press(page, "Slew only")
    expect_text(page, "#order-told", "asking again")
    page.locator("#stop").click()
    expect_text(page, "#stop-told", "told the mount")
    expect_text(page, "#order-told", "STOP came before its answer")
    page.unroute("**/slow/slew")
    assert sent[-1] == "stop"
    sent.clear()
    page.get_by_role("button", name="Look", exact=True).dblclick()
    expect_text(page, "#order-told", "Look: taken")
    assert sent == ["look"]
    # a name that could not be looked up is not "unknown"
    page.route("**/v1/objects*", lambda route: route.abort())
    page.fill("#target", "Polaris")
    expect_text(page, "#target-read", "Not looked up")


def test_a_stop_of_one_telescope_takes_no_other_ones_away(visit: Visit, observatory: Served) -> None:
    visit.forgiven = ("Failed to load resource",)
    page = visit.open(observatory.url)
    page.route("**/east/stop", lambda route: route.abort())
    choose(page, "east")
    page.locator("#stop").click()
    expect_text(page, "#stop-told", "STOP east: NOT SENT")
    choose(page, "slow")
    page.locator("#stop").click()
    expect_text(page, "#stop-told", "STOP slow: told the mount")
    # the other one was never heard: it is tried on, and stands there in the color of what is wrong
    with page.expect_request("**/east/stop"):
        pass
    expect_text(page, "#stop-told", "STOP east: NOT SENT")
    assert "bad" in (page.get_attribute("#stop-told", "class") or "")
    page.unroute("**/east/stop")
    expect_text(page, "#stop-told", "STOP east: told the mount")
    expect_text(page, "#stop-told", "STOP slow: told the mount")
    # green only when it is seen at rest
    page.wait_for_function("() => document.querySelector('#stop-told').classList.contains('good')")
    # one for all is one for each
    page.route("**/east/stop", lambda route: route.abort())
    choose(page, "east")
    page.locator("#stop").click()
    expect_text(page, "#stop-told", "STOP east: NOT SENT")
    press(page, "STOP ALL")
    expect_text(page, "#stop-told", "STOP all: told the mount")
    assert "STOP east" not in (page.text_content("#stop-told") or "")


def test_stop_all_says_whom_it_did_not_reach(visit: Visit, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("far")
    mount = '[[telescope]]\nid = "{}"\n[telescope.mount]\nurl = "lx200+tcp://127.0.0.1:1"\n'
    camera = f'[telescope.camera]\nkind = "folder"\npath = "{folder}"\n'
    settings = TOML.partition("[[telescope]]")[0] + "".join(
        mount.format(one) + camera for one in ("far", "west")
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MOUNTNAV_JOURNAL", str(folder / "journal.sqlite"))
        with served(settings) as one:
            page = visit.page
            page.goto(one.url)
            press(page, "STOP ALL")
            expect_text(page, "#stop-told", "STOP all: NOT ALL were told. far:")


def test_a_service_begun_anew_with_a_key_is_met_without_old_words(
    visit: Visit, observatory: Served, locked: Served, wire: Wire
) -> None:
    visit.forgiven = ("Failed to load resource",)
    page = visit.open(wire.url)
    choose(page, "slow")
    page.fill("#target", typed(observatory.place_at(45.0, 130.0)))
    press(page, "Slew only")
    expect_text(page, "#state-word", "Slewing")
    press(page, "Park")
    wire.cut()
    expect_text(page, "#state-word", "No connection")
    assert page.title().startswith("No connection")
    assert page.locator("#ask").is_hidden()
    wire.lead_to(locked.port)
    wire.lay()
    page.wait_for_selector("#key-row:not([hidden])")
    page.wait_for_selector("#lost", state="hidden")
    with page.expect_response(lambda one: "/v1/events" in one.url and one.ok):
        page.fill("#key", KEY)
        page.keyboard.press("Enter")
    expect_text(page, "#job-body", "does not know this job any more")
    assert page.locator("#job-body button").count() == 0
    assert page.locator("#notice").is_hidden()
    page.wait_for_function("() => document.querySelector('#state-word').textContent === 'Tracking'")
    httpx.post(f"{observatory.url}/v1/telescopes/slow/stop", timeout=60)


def test_a_page_left_red_is_red_from_its_first_paint(visit: Visit, observatory: Served) -> None:
    visit.forgiven = ("Failed to load resource",)
    page = visit.open(observatory.url)
    page.get_by_role("button", name="Night mode").click()
    page.route("**/main.js", lambda route: route.abort())  # a line so slow that it never comes
    page.reload()
    pixels = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
    assert pixels[..., 0].max() > 120
    assert pixels[..., 1:].max() == 0


def test_stop_and_what_became_of_it_stay_in_sight(phone: Visit, observatory: Served) -> None:
    page = phone.open(observatory.url)
    choose(page, "east")
    page.evaluate("scrollTo(0, document.documentElement.scrollHeight)")
    page.locator("#stop").click()
    expect_text(page, "#stop-told", "told the mount")
    box = page.locator("#stop-told").bounding_box()
    assert box is not None
    assert 0 <= box["y"] < box["y"] + box["height"] <= 740
    # what is seen becomes smaller, as under a keyboard on the glass
    phone.context.new_cdp_session(page).send("Emulation.setPageScaleFactor", {"pageScaleFactor": 1.8})
    page.wait_for_function(
        "() => { const seen = visualViewport;"
        " const stop = document.querySelector('#stop').getBoundingClientRect();"
        " return seen.scale > 1.7 && stop.bottom <= seen.offsetTop + seen.height"
        " && stop.top >= seen.offsetTop"
        " && stop.left >= seen.offsetLeft && stop.right <= seen.offsetLeft + seen.width; }"
    )


def test_a_tab_that_nobody_sees_holds_no_connection(visit: Visit, observatory: Served) -> None:
    page = visit.page
    followed: list[str] = []
    page.on(
        "request",
        lambda one: (
            followed.append(one.headers.get("last-event-id", "")) if "/v1/events" in one.url else None
        ),
    )
    with page.expect_response(lambda one: "/v1/events" in one.url):
        visit.open(observatory.url)
    choose(page, "east")
    with page.expect_response(lambda one: one.url.endswith("/look")) as ordered:
        press(page, "Look")
    # its end is told by events alone: now there is one to go on from
    page.wait_for_function(
        "id => { const told = document.querySelector('#job-body').dataset;"
        " return told.job === id && told.state === 'succeeded'; }",
        arg=ordered.value.json()["id"],
    )
    hide = (
        "yes => { Object.defineProperty(document, 'hidden', { value: yes, configurable: true });"
        " document.dispatchEvent(new Event('visibilitychange')); }"
    )
    with page.expect_event("requestfailed", lambda one: "/v1/events" in one.url):
        page.evaluate(hide, True)
    before = len(followed)
    with page.expect_response(lambda one: "/v1/events" in one.url):
        page.evaluate(hide, False)
    assert len(followed) == before + 1
    assert followed[-1]


def test_who_reads_old_lines_of_the_journal_is_left_there(visit: Visit, observatory: Served) -> None:
    page = visit.page
    # short pages, so that a few lines are a long journal
    page.route("**/v1/journal?*", lambda route: route.continue_(url=route.request.url.replace("=40", "=3")))
    with httpx.Client(base_url=f"{observatory.url}/v1/telescopes/east", timeout=60) as client:
        for _ in range(4):
            client.post("/stop")
        visit.open(observatory.url)
        choose(page, "east")
        lines = "document.querySelectorAll('#journal-lines li:not(.day)').length"
        page.wait_for_function(f"() => {lines} === 3")
        page.evaluate("document.querySelector('#journal .scroll').style.flex = '0 0 60px'")
        page.evaluate("document.querySelector('#journal .scroll').style.minHeight = '60px'")
        press(page, "Older")
        page.wait_for_function(f"() => {lines} > 3")
        page.evaluate("document.querySelector('#journal .scroll').scrollTop = 1e6")
        count = page.evaluate(lines)
        newest = page.locator("#journal-lines time").first.get_attribute("datetime")
        client.post("/stop")
        page.wait_for_function(
            "newest => document.querySelector('#journal-lines time').dateTime !== newest", arg=newest
        )
        assert page.evaluate(lines) > count
        assert page.evaluate("document.querySelector('#journal .scroll').scrollTop") > 0
