"""STOP by every face, during every kind of job: it is next on the wire, and nothing moves after it."""

from __future__ import annotations

from datetime import timedelta

import httpx
import pytest

from api.access.callers import Caller, Face, Role
from api.orders.job import JobState
from api.orders.targets import ApparentTarget, RatesTarget
from api.orders.vocabulary import (
    KINDS,
    AcceptSiteTimeOrder,
    CenterOrder,
    DitherOrder,
    FirstLightOrder,
    FlipOrder,
    FollowOrder,
    ForgetRatesOrder,
    GuideOrder,
    HoldOrder,
    HomeOrder,
    LookOrder,
    ModelRunOrder,
    MosaicOrder,
    MoveAxisOrder,
    OffsetOrder,
    OffsetRatesOrder,
    Order,
    ParkOrder,
    RecoverOrder,
    RotateOrder,
    SeriesOrder,
    SetParkOrder,
    SetSiteTimeOrder,
    SlewOrder,
    SolveOrder,
    SpiralSearchOrder,
    SyncOrder,
    SyncToOrder,
    TrackingOrder,
    TrustOrder,
    UnparkOrder,
)
from drivers.fakes.faults import Fault
from drivers.wire.wire_log import WireLog
from mountnav.clock import utc_now
from mountnav.sky.coordinates import Apparent
from tests.api.all_faces.attacked_service import STOP, Standing, standing, up_now
from tests.api.all_faces.programs import EAST, hands
from tests.waiting import until

BOSS = Caller("tests", Role.CONFIGURE, Face.REST)
STOPS = ("rest", "rest-all", "rest-cancel", "alpaca", "indi", "lx200")
LATE_S = 1.5


def there(place: Apparent) -> ApparentTarget:
    return ApparentTarget(ra_deg=place.ra_deg, dec_deg=place.dec_deg)


def mover(place: Apparent) -> RatesTarget:
    now = utc_now()
    return RatesTarget(
        ra_deg=place.ra_deg,
        dec_deg=place.dec_deg,
        ra_arcsec_s=0.2,
        dec_arcsec_s=0.1,
        begins_utc=(now - timedelta(hours=1)).isoformat(),
        ends_utc=(now + timedelta(hours=1)).isoformat(),
    )


def order_of(kind: str, stand: Standing) -> Order:
    """An order of that kind that takes its time on a mount that moves at 1°/s and answers some words late."""
    far = there(up_now(-20.0, 20.0))
    made: dict[str, Order] = {
        "slew": SlewOrder(target=far),
        "center": CenterOrder(target=far),
        "look": LookOrder(exposure_s=60.0),
        "sync": SyncOrder(),
        "sync-to": SyncToOrder(target=there(stand.mechanics.reported())),
        "offset": OffsetOrder(east_arcsec=30_000.0, north_arcsec=-30_000.0),
        "flip": FlipOrder(target=far),
        "follow": FollowOrder(target=mover(up_now(-20.0, 20.0)), duration_s=600.0),
        "forget-rates": ForgetRatesOrder(),
        "hold": HoldOrder(exposure_s=60.0),
        "dither": DitherOrder(),
        "rotate": RotateOrder(position_angle_deg=30.0),
        "mosaic": MosaicOrder(target=far, across=2, down=1, width_deg=0.5, height_deg=0.5),
        "spiral-search": SpiralSearchOrder(target=far, field_deg=0.5),
        "offset-rates": OffsetRatesOrder(ra_arcsec_s=0.2, dec_arcsec_s=0.1),
        "move-axis": MoveAxisOrder(axis="secondary", rate_deg_s=0.1, for_s=10.0),
        "park": ParkOrder(),
        "unpark": UnparkOrder(),
        "home": HomeOrder(),
        "set-park": SetParkOrder(),
        "tracking": TrackingOrder(on=True),
        "guide": GuideOrder(direction="n", duration_s=10.0),
        "trust": TrustOrder(),
        "set-site-time": SetSiteTimeOrder(),
        "accept-site-time": AcceptSiteTimeOrder(),
        "first-light": FirstLightOrder(),
        "recover": RecoverOrder(exposure_s=60.0),
        "solve": SolveOrder(exposure_s=60.0),
        "series": SeriesOrder(looks=10, exposure_s=60.0),
        "model-run": ModelRunOrder(points=20, exposure_s=60.0),
    }
    return made[kind]


ON_THE_WIRE = {
    "slew": b":MS#",
    "center": b":MS#",
    "follow": b":MS#",
    "sync-to": b":CM",
    "offset": b":MS#",
    "park": b":hP#",
    "home": b":hC#",
    "set-park": b":hQ#",
    "tracking": b":Te#",
    "guide": b":Mg",
    "model-run": b":MS#",
    "mosaic": b":MS#",
    "spiral-search": b":MS#",
}
"""What these kinds send first: the stop comes after that. The others expose a frame, or ask first."""
AT_ONCE = frozenset(
    {
        "trust",
        "set-site-time",
        "accept-site-time",
        "unpark",
        "flip",
        "forget-rates",
        "offset-rates",
        "move-axis",
        "rotate",
    }
)
"""Over in no time, or refused here: nothing to stop, but a stop all the same."""


def require_stop_answered(what: str, answer: httpx.Response) -> None:
    """Stopped; or sent, where a mount that owes an answer for seconds lets nobody know in time."""
    assert answer.status_code in (200, 202), (what, answer.text)
    assert answer.json()["stopped"] is (True if answer.status_code == 200 else None), (what, answer.text)


async def stop_it(stand: Standing, by: dict, face: str, kind: str) -> None:  # type: ignore[type-arg]
    what = f"{kind} stopped by {face}"
    stand.mechanics.slew_rate_deg_s = 1.0
    begin = stand.mark()
    word = ON_THE_WIRE.get(kind)
    if word is not None and kind in ("sync-to", "set-park", "tracking"):
        stand.fake.add_fault(Fault("late", on=word, delay_s=LATE_S))
    job = await stand.service.dispatcher.order(BOSS, "east", order_of(kind, stand))
    if word is not None:
        await until(lambda: any(one.startswith(word) for one in stand.fake.heard[begin:]), f"{what}: begun")
    elif kind not in AT_ONCE:
        await until(lambda: job.state is JobState.RUNNING or job.is_over, f"{what}: begun")
    mark = stand.mark()
    match face:
        case "rest-all":
            answer = await by["rest"].http.post("/v1/stop")
            require_stop_answered(what, answer)
        case "rest-cancel":
            answer = await by["rest"].http.delete(f"/v1/jobs/{job.id}")
            assert answer.status_code == 200, (what, answer.text)
        case _:
            told = await by[face].stop()
            assert told.taken is not False, (what, told)
    if face == "rest-cancel" and job.kind in AT_ONCE:
        return
    await until(lambda: STOP in stand.fake.heard[mark:], f"{what}: on the wire")
    await job.ended.wait()
    await until(lambda: not stand.mechanics.slewing(), f"{what}: at rest")
    words = stand.moving_words(mark)
    # an order that is over at once may still go out while the stop is on its way to us: never after it
    after = words[words.index(STOP) :] if kind in AT_ONCE else words
    assert [one for one in after if one != STOP] == [], (what, words)
    if kind not in AT_ONCE:
        assert job.state is JobState.CANCELLED, (what, job.state, job.problem)
    assert not stand.service.dispatcher.watch("east").latest.slewing or stand.mechanics.slewing(), what


async def test_a_slew_is_stopped_by_every_face() -> None:
    async with standing() as stand, hands(stand) as by:
        for face in STOPS:
            await stop_it(stand, by, face, "slew")
            await stand.idle()


def test_every_kind_of_order_is_tried() -> None:
    assert set(KINDS) == {*AT_ONCE, *ON_THE_WIRE} | {
        "dither",
        "first-light",
        "hold",
        "look",
        "sync",
        "recover",
        "solve",
        "series",
    }


@pytest.mark.long
@pytest.mark.parametrize("kind", sorted(KINDS))
async def test_every_face_stops_every_kind_of_job(kind: str) -> None:
    async with standing() as stand, hands(stand) as by:
        for face in STOPS:
            await stop_it(stand, by, face, kind)
            if stand.mechanics.parked or stand.mechanics.at_home or not stand.mechanics.tracking:
                stand.mechanics.unpark()
                stand.mechanics.tracking = True
            # a slow answer to a word of before must not be taken for the next one's
            await stand.idle()


@pytest.mark.long
async def test_a_stop_is_next_though_an_answer_is_awaited() -> None:
    """The mount owes an answer for seconds; the stop doesn't wait for it."""
    async with standing() as stand, hands(stand) as by:
        stand.mechanics.slew_rate_deg_s = 1.0
        wire = stand.service.observatory.telescope("east").navigator.mount.wire_log
        assert isinstance(wire, WireLog)
        stand.fake.add_fault(Fault("late", on=b":MS#", delay_s=LATE_S))
        mark = stand.mark()
        told = await by["rest"].goto(up_now(-20.0, 20.0))
        assert told.taken
        await until(lambda: b":MS#" in stand.fake.heard[mark:], "the goto on the wire")
        after = stand.mark()
        stopping = await by["rest"].http.post(f"{EAST}/stop")
        require_stop_answered("a stop behind an answer", stopping)
        await until(lambda: STOP in stand.fake.heard[after:], "the stop on the wire")
        words = [(one.way, one.data) for one in wire.entries(0)]
        goto = max(n for n, one in enumerate(words) if one == ("driver->mount", b":MS#"))
        assert words[goto + 1] == ("driver->mount", STOP), words[goto:]
        await stand.idle()
        await until(lambda: not stand.mechanics.slewing(), "at rest")
        assert stand.gotos(after) == 0
