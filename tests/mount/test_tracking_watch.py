"""Tracking into a limit stops in time, judged by the truth; so does a slew that goes another way."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

import pytest

from drivers.simulated.behavior import MountBehavior
from drivers.simulated.mount import SimulatedMount
from mountnav.devices import PierSide, Skill, SlewOutcome
from mountnav.errors import DeviceRefused, DeviceSilent, LimitKind, OutsideLimits
from mountnav.journal.records import EntryKind, Outcome
from mountnav.mount import WentAnotherWay
from mountnav.pointing.limits import Horizon, Limits
from mountnav.simulation.mechanics import Machine
from mountnav.sky.chain import icrs_to_apparent, icrs_to_observed
from mountnav.sky.coordinates import Apparent
from mountnav.sky.planets import position_of_body
from mountnav.sky.sphere import separation_arcsec
from tests.mount.mount_rig import AIR, SITE, Rig, run


def altitude_deg(rig: Rig) -> float:
    """Where the tube truly looks."""
    return icrs_to_observed(rig.mechanics.truth(), rig.clock.utc(), SITE, AIR).alt_deg


def faults(rig: Rig) -> list[dict[str, object]]:
    """Facts of all faults."""
    return [dict(one.facts) for one in rig.journal.entries if one.kind is EntryKind.FAULT]


@pytest.mark.long
def test_tracking_stops_before_the_horizon_and_not_much_before() -> None:
    seen: list[float] = []

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(60.0, 20.0))
        for _ in range(6 * 360):
            await rig.clock.sleep(10.0)
            seen.append(altitude_deg(rig))
            assert seen[-1] >= 20.0
        assert not rig.mechanics.tracking

    # the margin is for the refraction (0.05°) of which this mount knows nothing
    rig = run(work, limits=Limits(20.0, margin_deg=0.06))
    assert min(seen) < 20.2
    near = [facts for what, facts in rig.told if what == "limit-near"]
    left = [float(str(facts["seconds_left"])) for facts in near]
    assert left == sorted(left, reverse=True)
    assert left[0] > 900.0
    assert left[-1] < 60.0
    assert [what for what, _ in rig.told if what.startswith("limit-stop")] == ["limit-stop"]
    (fault,) = faults(rig)
    assert fault["limit"] == "altitude"
    track = rig.journal.commands[-1]
    assert track.order == "track"
    assert track.cause.why.startswith("limits: tracking has come to altitude 20.")
    assert rig.journal.ends[track.command_id].outcome is Outcome.DONE


def test_after_such_a_stop_tracking_is_not_begun_again_there_but_a_slew_inside_is() -> None:
    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(78.0, 20.0))
        while rig.mechanics.tracking:
            await rig.clock.sleep(30.0)
        with pytest.raises(OutsideLimits, match="leads in"):
            await rig.mount.set_tracking(True)
        await rig.mount.slew(rig.place(0.0, 20.0))

    run(work, limits=Limits(20.0))


@pytest.mark.long
def test_a_wall_that_comes_up_is_seen_in_time() -> None:
    wall = Horizon(((0.0, 5.0), (230.0, 5.0), (230.0, 60.0), (250.0, 60.0), (250.0, 5.0), (359.0, 5.0)))

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(10.0, 20.0))
        for _ in range(360):
            await rig.clock.sleep(30.0)
            place = icrs_to_observed(rig.mechanics.truth(), rig.clock.utc(), SITE, AIR)
            assert place.az_deg < 230.0 or place.alt_deg > 60.0
        assert not rig.mechanics.tracking

    assert faults(run(work, limits=Limits(5.0, horizon=wall, margin_deg=0.06)))[0]["limit"] == "horizon"


@pytest.mark.long
@pytest.mark.parametrize("tells_side", [True, False])
def test_a_german_mount_stops_so_far_past_the_meridian_as_it_may(tells_side: bool) -> None:
    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-3.0, 20.0))
        for _ in range(12 * 60):
            await rig.clock.sleep(10.0)
            assert rig.mechanics.axis_angle("ha") <= 180.0 + 5.0
        assert not rig.mechanics.tracking
        assert rig.mechanics.axis_angle("ha") > 180.0 + 4.8

    rig = run(
        work,
        limits=Limits(15.0, past_meridian_deg=(5.0, 5.0)),
        machine=Machine(mounting="german"),
        behavior=MountBehavior(tells_side=tells_side),
        mounting="german",
    )
    assert faults(rig)[0]["limit"] == "meridian"


@pytest.mark.long
@pytest.mark.parametrize(("ha_deg", "parks"), [(-130.0, True), (-158.0, False)])
def test_the_sun_that_rises_near_a_tracked_place_ends_tracking(ha_deg: float, parks: bool) -> None:
    dawn = datetime(2026, 6, 21, 1, 0, tzinfo=UTC)

    async def work(rig: Rig) -> None:
        # some 20° from the Sun, which is still 10° deep: west of it, and east of it, where it leaves
        await rig.mount.slew(rig.place(ha_deg, 46.0))
        for _ in range(200):
            await rig.clock.sleep(30.0)
        assert not rig.mechanics.tracking
        assert rig.mechanics.parked == parks

    rig = run(work, limits=Limits(2.0, sun_cone_deg=35.0), utc=dawn)
    assert faults(rig)[0]["limit"] == "sun"


@pytest.mark.long
def test_a_park_out_of_the_suns_way_that_stalls_is_told_and_not_forced() -> None:
    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-130.0, 46.0))
        while not rig.mechanics.parking:
            await rig.clock.sleep(1.0)
        rig.mechanics.stick("ha")
        await rig.clock.sleep(1200.0)
        assert not rig.mechanics.parked
        assert not rig.mechanics.tracking

    dawn = datetime(2026, 6, 21, 1, 0, tzinfo=UTC)
    machine = Machine(slew_rate_deg_s=1.0)
    rig = run(work, limits=Limits(2.0, sun_cone_deg=35.0), utc=dawn, machine=machine)
    (failed,) = [facts for what, facts in rig.told if what == "limit-stop-failed"]
    assert "stopped on its way to its park position" in str(failed["error"])
    assert not [what for what, _ in rig.told if what == "limit-stop"]
    assert rig.outcomes() == [("slew", Outcome.DONE), ("park", Outcome.STALLED)]


def sends_elsewhere(send: Callable[[Apparent], object], elsewhere: Apparent) -> Callable[[Apparent], Any]:
    return lambda target: send(elsewhere)


def test_a_mount_that_goes_another_way_than_predicted_is_stopped() -> None:
    deepest: list[float] = []

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-50.0, 20.0))
        send = rig.mechanics.slew
        elsewhere = rig.place(-110.0, 0.0)
        rig.mechanics.slew = sends_elsewhere(send, elsewhere)  # type: ignore[method-assign,assignment]
        slewing = asyncio.create_task(rig.mount.slew(rig.place(-20.0, 50.0)))
        while not slewing.done():
            await rig.clock.sleep(0.1)
            deepest.append(altitude_deg(rig))
        with pytest.raises(OutsideLimits, match="it was stopped") as left:
            await slewing
        assert left.value.limit is LimitKind.ALTITUDE

    rig = run(work, limits=Limits(15.0), machine=Machine(slew_rate_deg_s=3.0))
    # one look a second, the stop, and braking
    assert min(deepest) > 15.0 - 8.0
    ends = [rig.journal.ends[one.command_id] for one in rig.journal.commands if one.order == "slew"]
    assert ends[-1].outcome is Outcome.STOPPED
    assert "stopped by the limits" in ends[-1].detail
    assert len(faults(rig)) == 1


def test_a_hand_that_moves_it_outside_is_stopped_once_and_may_bring_it_back() -> None:
    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-55.0, 10.0))
        rig.mechanics.move("s", 1.0)
        for _ in range(40):
            await rig.clock.sleep(1.0)
        assert not rig.mechanics.slewing()
        lowest = altitude_deg(rig)
        assert lowest < 15.0
        rig.mechanics.move("n", 1.0)
        for _ in range(30):
            await rig.clock.sleep(1.0)
        assert rig.mechanics.slewing()
        assert altitude_deg(rig) > lowest + 10.0

    run(work, limits=Limits(15.0))


def test_a_mount_that_can_not_be_trusted_does_not_track_on_for_ever() -> None:
    async def work(rig: Rig) -> None:
        await rig.clock.sleep(500.0)
        assert rig.mechanics.tracking
        await rig.clock.sleep(300.0)
        assert not rig.mechanics.tracking

    rig = run(work, limits=Limits(15.0, untrusted_tracking_s=600.0), trusted=False)
    assert "can't be trusted" in str(faults(rig)[0]["why"])


@pytest.mark.long
def test_where_it_can_t_park_it_is_not_left_standing_in_the_suns_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SimulatedMount, "skills", frozenset({Skill.TRACK}))
    apart_deg: list[float] = []

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-130.0, 46.0))
        while not faults(rig):
            await rig.clock.sleep(30.0)
        for _ in range(10):
            await rig.clock.sleep(120.0)
            sun = position_of_body("sun", rig.clock.utc(), SITE)
            apart_deg.append(separation_arcsec(rig.mechanics.truth(), sun) / 3600.0)
        # standing still the Sun would come nearer: it tracks on, and that is told
        assert rig.mechanics.tracking

    dawn = datetime(2026, 6, 21, 1, 0, tzinfo=UTC)
    rig = run(work, limits=Limits(2.0, sun_cone_deg=35.0), utc=dawn)
    assert min(apart_deg) > apart_deg[0] - 0.1
    failed = [facts for what, facts in rig.told if what == "limit-stop-failed"]
    assert "can't park" in str(failed[0]["error"])


@pytest.mark.long
def test_where_tracking_is_not_switched_off_it_is_stopped_and_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    switch, deaf = SimulatedMount.set_tracking, [2]

    async def set_tracking(mount: SimulatedMount, on: bool, *rate: Any) -> None:
        if not on and deaf[0] > 0:
            deaf[0] -= 1
            raise DeviceSilent("no answer")
        await switch(mount, on, *rate)

    monkeypatch.setattr(SimulatedMount, "set_tracking", set_tracking)

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(78.0, 20.0))
        while rig.mechanics.tracking:
            await rig.clock.sleep(5.0)
            assert altitude_deg(rig) >= 14.5

    rig = run(work)
    assert deaf == [0]
    assert "stop" in [order for order, _ in rig.outcomes()]


def test_a_quiet_night_is_not_disturbed() -> None:
    readings: list[float] = []

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-60.0, 60.0))
        rig.mount.on_reading(lambda reading: readings.append(rig.clock.monotonic_s()))
        await rig.clock.sleep(3600.0)

    rig = run(work)
    assert faults(rig) == []
    assert 100 < len(readings) < 400
    assert min(b - a for a, b in pairwise(readings)) > 2.0


@pytest.mark.long
def test_a_link_that_is_lost_does_not_end_the_watch() -> None:
    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(60.0, 20.0))
        rig.driver.cut(300.0)
        await rig.clock.sleep(4.0 * 3600.0)
        assert not rig.mechanics.tracking

    assert faults(run(work, limits=Limits(20.0)))


@pytest.mark.long
@pytest.mark.parametrize("tells", [True, False])
def test_a_mount_that_has_no_word_for_rest_is_parked(tells: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    # as classic hand controls: a stop ends slews, and tracking goes on
    skills = frozenset({Skill.PARK, Skill.UNPARK})
    monkeypatch.setattr(SimulatedMount, "skills", skills)

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(60.0, 20.0))
        for _ in range(4 * 360):
            await rig.clock.sleep(10.0)
            if rig.mechanics.parked:
                break
            assert altitude_deg(rig) >= 20.0 or rig.mechanics.parking
        assert rig.mechanics.parked

    rig = run(work, limits=Limits(20.0, margin_deg=0.06), behavior=MountBehavior(tells_motion=tells))
    assert [one.order for one in rig.journal.commands] == ["slew", "stop", "park"]


@pytest.mark.long
def test_a_mount_that_can_not_be_stopped_is_told_of_once_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SimulatedMount, "skills", frozenset[Skill]())

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(78.0, 20.0))
        await rig.clock.sleep(1800.0)

    rig = run(work, limits=Limits(20.0))
    failed = [facts for what, facts in rig.told if what == "limit-stop-failed"]
    assert 1 <= len(failed) <= 31
    assert "can neither stand still nor park" in str(failed[0]["error"])


@pytest.mark.long
@pytest.mark.parametrize("start_deg", [-40.0, -14.0, -3.0])
@pytest.mark.parametrize("tells_side", [True, False])
def test_a_mount_that_stays_where_it_should_have_changed_sides_is_stopped_in_time(
    start_deg: float, tells_side: bool
) -> None:
    highest: list[float] = []

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(start_deg, 40.0))
        assert rig.mechanics.pier_side() is PierSide.WEST
        slewing = asyncio.create_task(rig.mount.slew(rig.place(35.0, 40.0)))
        while not slewing.done():
            await rig.clock.sleep(0.1)
            highest.append(rig.mechanics.axis_angle("ha"))
        with pytest.raises(OutsideLimits, match="took another path than expected"):
            await slewing

    machine = Machine(
        mounting="german", side_rule="stay", meridian_limits_deg=(60.0, 60.0), slew_rate_deg_s=6.0,
        home_axes_deg=(100.0, 130.0), starts_at="home",
    )  # fmt: skip
    rig = run(
        work,
        limits=Limits(15.0, past_meridian_deg=(10.0, 10.0), margin_deg=0.2),
        machine=machine,
        behavior=MountBehavior(tells_side=tells_side, tells_destination=False),
        mounting="german",
    )
    assert max(highest) <= 190.0
    assert faults(rig)[0]["limit"] == "meridian"


def test_trying_again_and_again_does_not_make_a_lost_mount_track_on() -> None:
    async def work(rig: Rig) -> None:
        for _ in range(20):
            try:
                await rig.mount.set_tracking(True)
            except DeviceRefused:
                break
            await rig.clock.sleep(120.0)
            await rig.mount.set_tracking(False)
        with pytest.raises(DeviceRefused, match=r"has tracked for .* can't be trusted") as refused:
            await rig.mount.set_tracking(True)
        assert "then order trust" in str(refused.value)
        # an axis must not have turned farther than 600 s of tracking, and a look
        assert rig.mechanics.axis_angle("ha") < 640.0 * 15.05 / 3600.0 + 0.6
        rig.mount.trust()
        await rig.mount.set_tracking(True)

    run(work, limits=Limits(15.0, untrusted_tracking_s=600.0), trusted=False)


def deaf_to_stops(rig: Rig, times: int) -> list[float]:
    """Let so many stops from now on not be heard; when each was sent."""
    obeyed, sent_s = rig.driver.stop, []

    async def stop() -> None:
        sent_s.append(rig.clock.monotonic_s())
        if len(sent_s) <= times:
            raise DeviceSilent("no answer to the stop", device=rig.driver.name)
        await obeyed()

    rig.driver.stop = stop  # type: ignore[method-assign]
    return sent_s


def test_a_stop_on_the_way_that_was_not_heard_is_sent_again_and_told_once() -> None:
    deepest: list[float] = []

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-50.0, 20.0))
        send, elsewhere = rig.mechanics.slew, rig.place(-110.0, 0.0)
        rig.mechanics.slew = sends_elsewhere(send, elsewhere)  # type: ignore[method-assign,assignment]
        deaf_to_stops(rig, 3)
        slewing = asyncio.create_task(rig.mount.slew(rig.place(-20.0, 50.0)))
        while not slewing.done():
            await rig.clock.sleep(0.1)
            deepest.append(altitude_deg(rig))
        with pytest.raises(OutsideLimits, match="it was stopped"):
            await slewing

    rig = run(work, limits=Limits(15.0), machine=Machine(slew_rate_deg_s=3.0))
    # four looks of a second instead of one
    assert min(deepest) > 15.0 - 8.0 - 3 * 3.0
    assert [what for what, _ in rig.told if what.startswith("limit-stop")] == [
        "limit-stop-failed",
        "limit-stop",
    ]


def test_a_stop_of_a_hand_that_was_not_heard_is_sent_again() -> None:
    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-55.0, 10.0))
        deaf_to_stops(rig, 2)
        rig.mechanics.move("s", 1.0)
        await rig.clock.sleep(60.0)
        assert not rig.mechanics.slewing()
        assert altitude_deg(rig) > 0.0

    run(work, limits=Limits(15.0))


def test_a_hand_is_stopped_each_time_and_may_not_go_on_deeper() -> None:
    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-55.0, 10.0))
        for _ in range(3):
            rig.mechanics.move("s", 1.0)
            await rig.clock.sleep(60.0)
            assert not rig.mechanics.slewing()
        # outside it may only come nearer: each new try ends after a look or two
        assert altitude_deg(rig) > 15.0 - 3 * 6.0
        rig.mechanics.move("n", 1.0)
        await rig.clock.sleep(40.0)
        await rig.driver.stop()
        await rig.clock.sleep(60.0)
        inside = altitude_deg(rig)
        assert inside > 17.0
        rig.mechanics.move("s", 1.0)
        await rig.clock.sleep(90.0)
        assert not rig.mechanics.slewing()
        assert altitude_deg(rig) > 0.0

    run(work, limits=Limits(15.0))


@pytest.mark.long
@pytest.mark.parametrize(
    ("utc", "cone_deg"),
    [
        (datetime(2026, 6, 21, 4, 30, tzinfo=UTC), 30.0),
        # the Sun is lower than the altitude that is allowed, and does a park no harm: the Sun's cone counts
        (datetime(2026, 6, 21, 2, 55, tzinfo=UTC), 15.0),
    ],
)
def test_a_park_that_the_watch_orders_is_watched_itself(
    utc: datetime, cone_deg: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    # as classic hand controls: no word for rest, so at a limit it is parked
    monkeypatch.setattr(SimulatedMount, "skills", frozenset({Skill.PARK, Skill.UNPARK}))
    apart_deg: list[float] = []

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(78.0, 20.0))
        sun = position_of_body("sun", rig.clock.utc(), SITE)
        # a park position at the far end of a way through the Sun
        rig.mechanics.park = lambda: rig.mechanics.slew(icrs_to_apparent(sun, rig.clock.utc()))  # type: ignore[method-assign,assignment]
        for _ in range(1200):
            if len(rig.journal.ends) == 4:
                break
            await rig.clock.sleep(1.0)
            apart_deg.append(separation_arcsec(rig.mechanics.truth(), sun) / 3600.0)

    limits = Limits(20.0, sun_cone_deg=cone_deg)
    machine, behavior = Machine(slew_rate_deg_s=2.0), MountBehavior(tells_motion=True)
    rig = run(work, limits=limits, utc=utc, machine=machine, behavior=behavior)
    assert rig.outcomes()[1:4] == [("stop", Outcome.DONE), ("park", Outcome.STOPPED), ("stop", Outcome.DONE)]
    assert min(apart_deg) > cone_deg - 6.0


def repeats_its_stops(rig: Rig) -> None:
    """Let each stop be sent again after the mount rests, as drivers do that haven't seen it yet."""
    obeyed = rig.driver.stop

    async def stop() -> None:
        await obeyed()
        await rig.clock.sleep(2.0)
        rig.mechanics.stop()

    rig.driver.stop = stop  # type: ignore[method-assign]


def test_an_order_waits_for_a_stop_that_is_under_way() -> None:
    async def work(rig: Rig) -> None:
        repeats_its_stops(rig)
        slewing = asyncio.create_task(rig.mount.slew(rig.place(60.0, 40.0)))
        await rig.clock.sleep(4.0)
        stopping = asyncio.create_task(rig.mount.stop())
        assert await slewing is SlewOutcome.STOPPED
        assert not stopping.done()
        assert await rig.mount.slew(rig.place(-10.0, 20.0)) is SlewOutcome.ARRIVED

    run(work)


def test_a_stop_overtakes_an_order_that_waits_for_another_stop() -> None:
    async def work(rig: Rig) -> None:
        repeats_its_stops(rig)
        slewing = asyncio.create_task(rig.mount.slew(rig.place(60.0, 40.0)))
        await rig.clock.sleep(4.0)
        stopping = asyncio.create_task(rig.mount.stop())
        await slewing
        waiting = asyncio.create_task(rig.mount.slew(rig.place(-10.0, 20.0)))
        await rig.clock.sleep(0.5)
        assert not stopping.done()
        await rig.mount.stop()
        assert await waiting is SlewOutcome.STOPPED
        assert rig.driver.received.count("slew") == 1

    run(work)


def test_a_way_that_is_planned_anew_is_not_ended_by_the_stop_of_the_first_one() -> None:
    # it stays on its side instead of changing, is stopped, and sent again at once, as a centering does
    async def work(rig: Rig) -> None:
        repeats_its_stops(rig)
        await rig.mount.slew(rig.place(-14.0, 40.0))
        with pytest.raises(WentAnotherWay):
            await rig.mount.slew(rig.place(35.0, 40.0))
        assert await rig.mount.slew(rig.place(-50.0, 40.0)) is SlewOutcome.ARRIVED

    run(
        work,
        limits=Limits(15.0, past_meridian_deg=(10.0, 10.0), margin_deg=0.2),
        machine=Machine(
            mounting="german",
            side_rule="stay",
            meridian_limits_deg=(60.0, 60.0),
            home_axes_deg=(100.0, 130.0),
            starts_at="home",
        ),
        behavior=MountBehavior(tells_destination=False),
        mounting="german",
    )


@pytest.mark.long
@pytest.mark.parametrize("dec_deg", [89.5, 89.9, 89.97])
def test_by_the_pole_the_meridian_limit_counts_by_the_axes(dec_deg: float) -> None:
    # refraction turns the hour angle of a place there by degrees, and no axis
    past_deg: list[float] = []

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-2.0, dec_deg))
        for _ in range(180):
            await rig.clock.sleep(20.0)
            past_deg.append(abs(rig.mechanics.true_axes()[0] - 90.0) - 90.0)
        assert not rig.mechanics.tracking

    run(
        work,
        limits=Limits(15.0, past_meridian_deg=(5.0, 5.0)),
        machine=Machine(
            mounting="german", meridian_limits_deg=(60.0, 60.0), home_axes_deg=(90.0, 90.0), starts_at="home"
        ),
        mounting="german",
    )
    assert max(past_deg) <= 5.0


@pytest.mark.long
@pytest.mark.parametrize("tells_side", [True, pytest.param(False, marks=pytest.mark.long)])
def test_at_home_on_the_pole_tracking_begins(tells_side: bool) -> None:
    # there a place tells nothing of the axes: by it alone they may be anywhere beyond
    async def work(rig: Rig) -> None:
        for _ in range(4):
            await rig.mount.set_tracking(False)
            await rig.clock.sleep(3.0 * 3600.0)
            await rig.mount.set_tracking(True)
            await rig.clock.sleep(60.0)
            assert rig.mechanics.tracking

    run(
        work,
        limits=Limits(15.0, past_meridian_deg=(9.0, 14.0)),
        machine=Machine(mounting="german", home_axes_deg=(90.0, 90.0), starts_at="home"),
        behavior=MountBehavior("icrs", ra_step_arcsec=15.0, dec_step_arcsec=20.0, tells_side=tells_side),
        mounting="german",
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("times", "lowest_deg", "first", "then"),
    [(3.0, 27.5, (-70.0, 70.0), (20.0, 0.0)), (1.0 / 6.0, 18.0, (-30.0, -15.0), (75.0, 60.0))],
)
def test_axes_of_unlike_rates_are_seen_on_the_way_and_reckoned_with(
    times: float, lowest_deg: float, first: tuple[float, float], then: tuple[float, float]
) -> None:
    lowest: list[float] = []
    anew: list[str] = []

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(*first))
        for _ in range(3):
            slewing = asyncio.create_task(rig.mount.slew(rig.place(*then)))
            while not slewing.done():
                await rig.clock.sleep(0.1)
                lowest.append(altitude_deg(rig))
            try:
                assert await slewing is SlewOutcome.ARRIVED
            except WentAnotherWay as stopped:
                anew.append(stopped.what)
            else:
                break
        else:
            pytest.fail(f"not in three slews: {anew}")

    machine = Machine(slew_rate_deg_s=2.0, dec_slew_rate_deg_s=2.0 * times)
    run(work, limits=Limits(lowest_deg, margin_deg=0.25), machine=machine, mounting="fork")
    assert min(lowest) >= lowest_deg
