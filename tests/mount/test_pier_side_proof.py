"""A German mount that tells its side is not believed before something has shown it; and what shows it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.simulated.behavior import MountBehavior
from mountnav.devices import PierSide, SlewOutcome
from mountnav.errors import LimitKind, OutsideLimits
from mountnav.mount import CheckedMount
from mountnav.mount.pier_side import SIDE_PROVEN, SideUnproven
from mountnav.pointing.limits import Horizon, Limits
from mountnav.simulation.machine import Machine
from mountnav.sky.sphere import half_turn_deg
from tests.mount.mount_rig import AIR, SITE, Rig, run

# one that would go far past the meridian rather than change sides
GERMAN = Machine(mounting="german", starts_at="zenith", side_rule="stay", meridian_limits_deg=(60.0, 60.0))
LIMITS = Limits(15.0, past_meridian_deg=(10.0, 10.0), rate_ratio=(0.8, 1.25))
SILENT = MountBehavior(tells_destination=False)


def raised_deg(rig: Rig) -> float:
    """How far the counterweight truly stands above the horizontal."""
    return abs(half_turn_deg(rig.mechanics.axis_angle("ha") - 90.0)) - 90.0


def told_side(rig: Rig) -> PierSide:
    swapped = rig.driver.behavior.side_swapped
    side = rig.mechanics.pier_side()
    return side.other if swapped else side


@pytest.mark.parametrize("swapped", [True, False])
def test_from_the_meridian_no_slew_hangs_on_a_side_that_nothing_has_shown(swapped: bool) -> None:
    worst: list[float] = []

    async def work(rig: Rig) -> None:
        # to the side on which it says to be able to stay
        ha_deg = -50.0 if told_side(rig) is PierSide.WEST else 50.0
        with pytest.raises(OutsideLimits, match="nothing has confirmed yet") as refusal:
            await rig.mount.slew(rig.place(ha_deg, 48.0))
        assert refusal.value.limit is LimitKind.MERIDIAN
        assert "set swap_sides of the mount: false" in str(refusal.value)
        worst.append(raised_deg(rig))

    rig = run(
        work, limits=LIMITS, machine=GERMAN, mounting="german",
        behavior=MountBehavior(tells_destination=False, side_swapped=swapped),
    )  # fmt: skip
    assert rig.driver.received == []
    assert max(worst) < 1.0


def test_the_word_of_one_who_looked_is_enough() -> None:
    async def work(rig: Rig) -> None:
        rig.driver.sides_stated = True
        mount = CheckedMount(
            rig.driver, telescope="t", limits=LIMITS, site=SITE, air=AIR, clock=rig.clock, mounting="german"
        )
        ha_deg = -50.0 if told_side(rig) is PierSide.WEST else 50.0
        assert await mount.slew(rig.place(ha_deg, 48.0)) is SlewOutcome.ARRIVED
        assert raised_deg(rig) < -45.0

    run(work, limits=LIMITS, machine=GERMAN, behavior=SILENT, mounting="german")


def test_a_tube_that_could_not_stand_so_on_the_other_side_is_enough() -> None:
    async def work(rig: Rig) -> None:
        side = rig.mechanics.pier_side()
        ha_deg = -20.0 if side is PierSide.WEST else 20.0
        rig.mechanics.slew(rig.place(ha_deg, 48.0))  # by hand
        await rig.clock.sleep(60.0)
        assert await rig.mount.slew(rig.place(2.5 * ha_deg, 48.0)) is SlewOutcome.ARRIVED

    run(work, limits=LIMITS, machine=GERMAN, behavior=SILENT, mounting="german")


def test_what_was_proven_once_is_taken_over_from_the_journal() -> None:
    async def proves(rig: Rig) -> None:
        ha_deg = -40.0 if rig.mechanics.pier_side() is PierSide.WEST else 40.0
        rig.mechanics.slew(rig.place(ha_deg, 48.0))  # by hand
        await rig.clock.sleep(60.0)
        await rig.mount.would_slew(rig.place(ha_deg, 50.0))

    facts = [
        one.facts
        for one in run(
            proves, limits=LIMITS, machine=GERMAN, behavior=SILENT, mounting="german"
        ).journal.entries
        if one.facts.get("about") == SIDE_PROVEN
    ]
    assert len(facts) == 1

    async def takes_over(rig: Rig) -> None:
        ha_deg = -50.0 if told_side(rig) is PierSide.WEST else 50.0
        rig.mount.restore_side_proof({**facts[0], "mount": "another one"})
        with pytest.raises(OutsideLimits, match="nothing has confirmed yet"):
            await rig.mount.slew(rig.place(ha_deg, 48.0))
        rig.mount.restore_side_proof(facts[0])
        assert await rig.mount.slew(rig.place(ha_deg, 48.0)) is SlewOutcome.ARRIVED

    run(takes_over, limits=LIMITS, machine=GERMAN, behavior=SILENT, mounting="german")


def test_from_home_the_way_itself_shows_it() -> None:
    async def work(rig: Rig) -> None:
        for ha_deg in (50.0, -50.0):
            assert await rig.mount.slew(rig.place(ha_deg, 48.0)) is SlewOutcome.ARRIVED

    home = Machine(mounting="german", starts_at="home")
    rig = run(work, limits=LIMITS, machine=home, behavior=SILENT, mounting="german")
    assert "stop" not in rig.driver.received


@pytest.mark.parametrize("order", ["home", "park"])
def test_the_way_out_that_the_refusal_names_works(order: str) -> None:
    # switched on at the meridian; home, or parked by an order, it is as if it had been switched on there
    async def work(rig: Rig) -> None:
        with pytest.raises(OutsideLimits, match="order home, or park and unpark"):
            await rig.mount.slew(rig.place(50.0, 48.0))
        if order == "home":
            await rig.mount.home()
        else:
            await rig.mount.park()
            await rig.mount.unpark()
        for ha_deg in (50.0, -50.0):
            assert await rig.mount.slew(rig.place(ha_deg, 48.0)) is SlewOutcome.ARRIVED

    machine = Machine(mounting="german", starts_at="zenith", meridian_limits_deg=(8.0, 8.0))
    run(work, limits=LIMITS, machine=machine, behavior=SILENT, mounting="german")


@pytest.mark.parametrize("swapped", [True, False])
def test_one_that_foretells_its_side_is_asked(swapped: bool) -> None:
    async def work(rig: Rig) -> None:
        ha_deg = -50.0 if rig.mechanics.pier_side() is PierSide.WEST else 50.0
        place = rig.place(ha_deg, 48.0)
        if swapped:
            with pytest.raises(OutsideLimits, match="set swap_sides = true"):
                await rig.mount.slew(place)
            assert rig.driver.received == []
        else:
            assert await rig.mount.slew(place) is SlewOutcome.ARRIVED

    behavior = MountBehavior(tells_destination=True, side_swapped=swapped)
    run(work, limits=LIMITS, machine=GERMAN, behavior=behavior, mounting="german")


@pytest.mark.long
@pytest.mark.parametrize("swapped", [True, False])
def test_tracking_stops_by_the_limit_of_either_side(swapped: bool) -> None:
    async def work(rig: Rig) -> None:
        for _ in range(90):
            await rig.clock.sleep(60.0)
            assert raised_deg(rig) < 10.3
        if rig.mechanics.pier_side() is PierSide.WEST:
            assert not rig.mechanics.tracking

    behavior = MountBehavior(tells_destination=False, side_swapped=swapped)
    run(work, limits=LIMITS, machine=GERMAN, behavior=behavior, mounting="german")


def test_a_place_where_tracking_would_be_ended_at_once_is_refused_until_the_side_is_shown() -> None:
    # by the pole the axis may turn far within little sky: there the limit counted for both sides only while
    # it tracked, and the tracking was ended as soon as it had come there
    machine = replace(GERMAN, starts_at="home")
    places = [(-112.0, 89.7), (-135.5, 89.75), (-147.0, 89.8)]

    async def work(rig: Rig) -> None:
        for ha_deg, dec_deg in places:
            await rig.mount.slew(rig.place(ha_deg, dec_deg))
        with pytest.raises(SideUnproven, match="tracking there leads too far past the meridian"):
            await rig.mount.slew(rig.place(-168.0, 89.8))
        await rig.clock.sleep(120.0)
        assert rig.mechanics.tracking
        assert [what for what, _ in rig.told if what == "limit-stop"] == []

    behavior = MountBehavior(tells_destination=False)
    run(work, limits=LIMITS, machine=machine, behavior=behavior, mounting="german")


@pytest.mark.parametrize(
    ("wall", "ha_deg", "dec_deg", "refused"),
    [
        # its later legs would end far past the meridian if the tube hung on the other side
        ((287.0, 297.0, 73.5), 74.0, 37.0, True),
        # all of this way stays near the meridian, where either side is within the limits
        ((81.874331, 120.337928, 63.641049), -15.816264, -1.19607, False),
    ],
    ids=["far", "near"],
)
def test_a_way_round_is_not_begun_if_a_later_leg_hangs_on_an_unproven_side(
    wall: tuple[float, float, float], ha_deg: float, dec_deg: float, refused: bool
) -> None:
    begins, ends, top = wall
    points = ((0.0, 15.0), (begins, 15.0), (begins + 1.0, top), (ends, top), (ends + 1.0, 15.0))
    limits = Limits(15.0, horizon=Horizon(points), past_meridian_deg=(20.0, 20.0), rate_ratio=None)

    async def work(rig: Rig) -> None:
        place = rig.place(ha_deg, dec_deg)
        if refused:
            with pytest.raises(SideUnproven):
                await rig.mount.slew(place)
            assert rig.driver.received == []
        else:
            await rig.mount.would_slew(place)

    run(work, limits=limits, machine=GERMAN, mounting="german", behavior=SILENT)
