"""German mounts that keep their side of the pier where they should change it, and don't foretell it.

Judged by the true axes: the tube is never beyond a limit, and comes to where it was sent.
"""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from benchmarks.keeping_sides import SLACK_DEG, Sent
from drivers.simulated.behavior import MountBehavior
from mountnav.devices import PierSide, SlewOutcome
from mountnav.errors import OutsideLimits
from mountnav.mount import WentAnotherWay
from mountnav.mount.pier_side import SideFollowed
from mountnav.navigation.slewing import PLANNED_ANEW
from mountnav.pointing.limits import Limits
from mountnav.pointing.limits.postures import Standing
from mountnav.simulation.machine import Machine
from mountnav.simulation.virtual_time import run_virtually
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.sphere import half_turn_deg
from tests.mount.mount_rig import AIR, SITE, Rig, run

STAYS = Machine(
    mounting="german",
    side_rule="stay",
    meridian_limits_deg=(60.0, 60.0),
    home_axes_deg=(90.0, 90.0),
    starts_at="home",
)
FREE = Limits(15.0, margin_deg=0.5, rate_ratio=(0.8, 1.25))
LIMITED = replace(FREE, past_meridian_deg=(10.0, 10.0))
MUTE = MountBehavior(tells_side=False, tells_destination=False)
TELLS = MountBehavior(tells_side=True, tells_destination=False)


class Judge:
    """Follows the true axes: how far the tube was ever outside, degrees."""

    def __init__(self, rig: Rig, limits: Limits) -> None:
        self.rig, self.limits = rig, limits
        self.deepest_deg = -90.0

    async def follow(self) -> None:
        mechanics, clock = self.rig.mechanics, self.rig.clock
        while True:
            await clock.sleep(0.5)
            seen = icrs_to_observed(mechanics.truth(), clock.utc(), SITE, AIR)
            self.deepest_deg = max(self.deepest_deg, self.limits.min_altitude_deg - seen.alt_deg)
            if self.limits.past_meridian_deg is not None:
                ha_deg, dec_deg = mechanics.true_axes()
                free = self.limits.past_meridian_deg[1 if abs(half_turn_deg(dec_deg)) > 90.0 else 0]
                raised_deg = abs(half_turn_deg(ha_deg - 90.0)) - 90.0
                self.deepest_deg = max(self.deepest_deg, raised_deg - free)


async def sent(rig: Rig, ha_deg: float, dec_deg: float) -> list[str]:
    """Send it there as a navigator does, planned again when it went another way; what was said meanwhile."""
    place, said = rig.place(ha_deg, dec_deg), list[str]()
    for _ in range(1 + PLANNED_ANEW):
        try:
            assert await rig.mount.slew(place) is SlewOutcome.ARRIVED
        except WentAnotherWay as stopped:
            said.append(stopped.what)
        else:
            return said
    pytest.fail(f"not in {1 + PLANNED_ANEW} slews: {said}")


def lived(
    ways: list[tuple[float, float]], limits: Limits, behavior: MountBehavior, machine: Machine
) -> Judge:
    """Send a mount from place to place."""
    judges = list[Judge]()

    async def work(rig: Rig) -> None:
        rig.mount.restore_side_proof({"mount": rig.mount.name})
        judges.append(Judge(rig, limits))
        following = asyncio.ensure_future(judges[0].follow())
        try:
            for way in ways:
                await sent(rig, *way)
        finally:
            following.cancel()

    run(work, limits=limits, behavior=behavior, machine=machine, mounting="german")
    return judges[0]


@pytest.mark.long
@pytest.mark.parametrize("behavior", [MUTE, TELLS], ids=["mute", "tells"])
@pytest.mark.parametrize(
    ("ways", "limits"),
    [
        # down to the south on the side that it keeps it would pass the west too low
        ([(115.0, 80.0), (-15.4, -22.1)], FREE),
        # on its side the target would be far past the meridian: it is sent farther, where it has to change
        ([(22.0, 37.0), (-29.0, 13.2), (-14.6, -13.0), (46.3, 57.1)], LIMITED),
        # a leg that is allowed on either side leads to the one from which the next leg isn't
        ([(38.9, -9.3), (13.1, 34.1), (-8.8, -2.8), (-29.2, 0.1)], FREE),
    ],
    ids=["low", "past-the-meridian", "by-legs"],
)
def test_one_that_keeps_its_side_comes_to_where_it_is_sent(
    ways: list[tuple[float, float]], limits: Limits, behavior: MountBehavior
) -> None:
    assert lived(ways, limits, behavior, STAYS).deepest_deg <= 0.1


@pytest.mark.long
@pytest.mark.parametrize(
    ("ways", "limits"),
    [
        # 2.6° below the lowest altitude before: nothing had shown its side, and it changed on the last way
        ([(61.3, 21.9), (-39.3, 45.9), (-61.7, 16.8)], FREE),
        # given up before, stopped three times: from home it goes to the side that it would keep
        ([(-25.8, -16.0)], LIMITED),
    ],
    ids=["low", "from-home"],
)
def test_a_mute_one_shows_its_side_when_it_leaves_its_home(
    ways: list[tuple[float, float]], limits: Limits
) -> None:
    assert lived(ways, limits, MUTE, STAYS).deepest_deg <= 0.1


@pytest.mark.long
@pytest.mark.parametrize("seed", [109, 142, 860015])
def test_a_mute_one_is_not_taken_to_hang_where_nothing_has_shown_it(seed: int) -> None:
    # given up before: thrice planned from the side on which it didn't hang, or taken for one of other rates
    sent_by_seed = Sent(seed)
    run_virtually(sent_by_seed.lived(), sent_by_seed.clock)
    assert [result for result, _ in sent_by_seed.results if result == "GIVEN UP"] == []
    assert sent_by_seed.deepest_deg <= SLACK_DEG


def test_a_side_that_was_only_supposed_is_given_up_when_the_way_contradicts_it() -> None:
    # switched on in the east of the meridian on the side that looks west, which nobody can see
    machine = replace(STAYS, home_axes_deg=(-18.4, 20.2))
    ways = [(-18.4, -21.8), (19.0, -21.8), (104.9, 69.5)]
    assert lived(ways, FREE, MUTE, machine).deepest_deg <= 0.1


@pytest.mark.long
@pytest.mark.parametrize("behavior", [MUTE, TELLS], ids=["mute", "tells"])
def test_near_the_meridian_a_short_slew_does_not_lose_sight_of_its_side(behavior: MountBehavior) -> None:
    # 27° beyond the limit before: after a short one its side was taken to be the usual one
    judges = list[Judge]()

    async def work(rig: Rig) -> None:
        rig.mount.restore_side_proof({"mount": rig.mount.name})
        judges.append(Judge(rig, LIMITED))
        following = asyncio.ensure_future(judges[0].follow())
        try:
            for way in ((54.9, 6.3), (-3.6, 8.4), (-3.6, -3.4)):
                await sent(rig, *way)
            assert rig.mechanics.pier_side() is PierSide.EAST
            # by way of a place so far past the meridian that it has to change
            assert await sent(rig, -37.6, -3.4)
            assert rig.mechanics.pier_side() is PierSide.WEST
        finally:
            following.cancel()

    run(work, limits=LIMITED, behavior=behavior, machine=STAYS, mounting="german")
    assert judges[0].deepest_deg <= 0.1


@pytest.mark.long
def test_a_mount_that_changes_is_held_up_by_nothing() -> None:
    machine = replace(STAYS, side_rule="meridian", meridian_limits_deg=(8.0, 8.0))
    ways = [(50.0, 40.0), (-50.0, 40.0), (30.0, 10.0), (-30.0, 60.0)]
    stops = list[str]()

    async def work(rig: Rig) -> None:
        for way in ways:
            stops.extend(await sent(rig, *way))

    run(work, limits=LIMITED, behavior=MUTE, machine=machine, mounting="german")
    assert stops == []


@pytest.mark.long
@pytest.mark.parametrize("order", ["home", "park"])
def test_from_home_it_may_take_either_side_and_the_refusal_says_so(order: str) -> None:
    async def work(rig: Rig) -> None:
        rig.mount.restore_side_proof({"mount": rig.mount.name})
        await sent(rig, 15.0, 40.0)
        with pytest.raises(WentAnotherWay):
            await rig.mount.slew(rig.place(-58.0, 5.0))
        for _ in range(3):  # it is sent farther and farther past the meridian, until no place is left
            with contextlib.suppress(OutsideLimits):
                await rig.mount.slew(rig.place(-58.0, 5.0))
        with pytest.raises(OutsideLimits, match="was seen to stay on its side of the pier") as refusal:
            await rig.mount.slew(rig.place(-58.0, 5.0))
        assert "order home or park" in str(refusal.value)
        if order == "home":
            await rig.mount.home()
        else:
            await rig.mount.park()
            await rig.mount.unpark()
        # somebody has set its own limit right meanwhile
        rig.mechanics.machine = replace(rig.mechanics.machine, side_rule="meridian")
        assert await sent(rig, -58.0, 5.0) == []

    machine = replace(STAYS, meridian_limits_deg=(85.0, 85.0))
    run(work, limits=LIMITED, behavior=TELLS, machine=machine, mounting="german")


def test_where_nothing_has_shown_its_side_home_is_a_way_out_and_named() -> None:
    # switched on by the zenith, it stays on its side to where it should look from the other one
    machine = Machine(mounting="german", side_rule="stay", meridian_limits_deg=(14.0, 14.0))

    async def work(rig: Rig) -> None:
        await sent(rig, -2.5, 29.6)
        with pytest.raises(OutsideLimits, match="it shows it when it leaves"):
            await rig.mount.slew(rig.place(-71.9, 29.0))
        await rig.mount.home()
        await sent(rig, -71.9, 29.0)
        assert rig.mechanics.pier_side() is PierSide.WEST

    limits = replace(FREE, past_meridian_deg=(16.0, 5.0), margin_deg=0.3)
    run(work, limits=limits, behavior=MUTE, machine=machine, mounting="german")


# -- following -----------------------------------------------------------------------------------

BEGAN = datetime(2026, 11, 23, 22, tzinfo=UTC)


def stands(ha_deg: float, dec_deg: float) -> dict[PierSide, Standing]:
    """Both ways to look at a place."""
    return {
        PierSide.EAST: Standing("german", PierSide.EAST, ha_deg, dec_deg),
        PierSide.WEST: Standing("german", PierSide.WEST, half_turn_deg(ha_deg + 180.0), 180.0 - dec_deg),
    }


def followed(*places: tuple[float, float, float], side: PierSide = PierSide.EAST) -> SideFollowed:
    """One that hung on a side at first; then hour angle, declination and seconds of each reading."""
    one, at = SideFollowed(), BEGAN
    for number, (ha_deg, dec_deg, seconds) in enumerate(places):
        at += timedelta(seconds=seconds)
        one.seen(at, stands(ha_deg, dec_deg))
        if not number:
            one.arrived((side,))
    return one


def test_it_is_followed_over_the_meridian_and_through_the_pole() -> None:
    assert followed((20.0, 40.0, 0.0), (8.0, 40.0, 1.0), (-4.0, 40.0, 1.0)).side is PierSide.EAST
    # the declination axis passes the pole: the tube comes out on the other side
    assert followed((20.0, 80.0, 0.0), (20.0, 87.0, 1.0), (-160.0, 86.0, 1.0)).side is PierSide.WEST
    assert followed((20.0, 80.0, 0.0), (20.1, 80.0, 24.0)).side is PierSide.EAST


def test_a_reading_at_the_pole_itself_does_not_hide_a_change_of_sides() -> None:
    # refraction turns the hour angle at 0.1° from the pole
    places = (
        (48.0, 82.0, 0.0),
        (46.0, 88.0, 1.0),
        (24.0, 89.9, 0.5),
        (-120.0, 88.0, 0.5),
        (-120.0, 84.0, 1.0),
    )
    assert followed(*places).side is PierSide.WEST


def test_what_nobody_has_seen_is_not_known() -> None:
    assert followed((20.0, 40.0, 0.0), (-60.0, 40.0, 10.0)).side is None
    assert followed((20.0, 40.0, 0.0), (20.0, 40.0, 61.0)).side is None
    lost = followed((20.0, 40.0, 0.0))
    lost.lost()
    assert lost.side is None


HOME = Standing("german", PierSide.EAST, 90.0, 90.0)


@pytest.mark.parametrize(
    ("ha_deg", "side"), [(96.0, PierSide.EAST), (-88.0, PierSide.WEST), (15.0, None), (-150.0, None)]
)
def test_from_home_it_leaves_by_another_hour_circle_for_each_side(
    ha_deg: float, side: PierSide | None
) -> None:
    one = SideFollowed()
    one.at_home(BEGAN, HOME)
    one.seen(BEGAN + timedelta(seconds=1), stands(ha_deg, 86.0))
    # a third kind stood there otherwise, its counterweight not down
    assert one.side is side


def test_one_that_was_seen_to_change_hangs_on_the_side_that_faces_the_place() -> None:
    places = [(40.0, 80.0), (40.0, 87.0), (-140.0, 86.0), (-140.0, 75.0), (-120.0, 70.0)]
    one = SideFollowed()
    for number, (ha_deg, dec_deg) in enumerate(places):
        one.seen(BEGAN + timedelta(seconds=number), stands(ha_deg, dec_deg))
    assert one.side is None
    one.arrived((PierSide.EAST, PierSide.WEST), PierSide.WEST)
    assert one.side is PierSide.WEST


@pytest.mark.parametrize(
    ("ways", "either"),
    [
        ((40.0, 30.0, 20.0), False),
        # on the side on which it was supposed to hang it looks the other way now
        ((20.0, 10.0, 0.0, -10.0, -20.0), True),
    ],
)
def test_one_that_was_not_seen_to_change_hangs_where_it_was_supposed_to(
    ways: tuple[float, ...], either: bool
) -> None:
    one = SideFollowed()
    for number, ha_deg in enumerate(ways):
        one.seen(BEGAN + timedelta(seconds=number), stands(ha_deg, 20.0))
    one.arrived((PierSide.EAST, PierSide.WEST), PierSide.EAST if ways[-1] > 0.0 else PierSide.WEST)
    assert one.side is None
    assert one.either is either


def test_a_sync_turns_no_axis() -> None:
    one = followed((20.0, 89.0, 0.0))
    one.seen(BEGAN + timedelta(seconds=1), stands(-160.0, 89.5), told_anew=True)
    assert one.side is PierSide.EAST
