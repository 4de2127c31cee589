"""Syncs on told coordinates: believed within bounds, and read back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.devices import Mount, MountReading, from_mount
from mountnav.errors import DeviceRefused, OutsideLimits, Refusal, SyncDoubt, SyncRefused
from mountnav.journal.memory import MemoryJournal
from mountnav.journal.records import EntryKind
from mountnav.mount.mount_state import SEEN_LATE
from mountnav.navigation.sync import SyncTrigger
from mountnav.navigation.sync_to_coordinates import CoordinateSyncTotals
from mountnav.navigation.vetoes import Claim
from mountnav.pointing.model.in_force import Expected
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import HourAngle, Icrs
from mountnav.sky.sphere import Offset, displaced, separation_arcsec
from tests.navigation.conftest import MakeRig, Rig, up_now
from tests.navigation.sync_rig import AIR, SITE, SureModel, SyncRig, rigged


async def reading(rig: Rig) -> Icrs:
    return from_mount((await rig.navigator.mount.reading()).place)


def syncs(rig: Rig) -> int:
    return sum(command.startswith(b":CM") for command in rig.fake.obeyed)


async def test_a_told_place_near_by_is_taken_and_read_back(make_rig: MakeRig) -> None:
    rig = await make_rig()
    await rig.navigator.slew(up_now())
    segment = rig.navigator.mount.segment_id
    place = displaced(await reading(rig), 90.0, -60.0)
    report = await rig.navigator.sync_to(place)
    assert report.read_back_miss_arcsec < 20.0
    assert separation_arcsec(await reading(rig), place) < 20.0
    assert report.offset.total_arcsec == pytest.approx(108.2, abs=5.0)
    assert rig.navigator.mount.segment_id != segment
    assert syncs(rig) == 1


async def test_words_move_a_mount_no_further_than_they_may(make_rig: MakeRig) -> None:
    rig = await make_rig()
    await rig.navigator.slew(up_now())
    with pytest.raises(SyncRefused) as refused:
        await rig.navigator.sync_to(displaced(await reading(rig), 0.0, 7300.0))
    assert refused.value.doubts == (SyncDoubt.TOO_FAR,)
    assert syncs(rig) == 0
    guard = rig.navigator.guard
    guard.policy = replace(guard.policy, told_max_arcsec=0.0)
    with pytest.raises(SyncRefused):
        await rig.navigator.sync_to(displaced(await reading(rig), 0.0, 30.0))
    assert syncs(rig) == 0


async def test_no_words_are_believed_near_the_pole_or_the_ground(make_rig: MakeRig) -> None:
    rig = await make_rig()
    rig.navigator.guard.policy = replace(rig.navigator.guard.policy, told_max_arcsec=180 * 3600.0)
    await rig.navigator.slew(up_now())
    with pytest.raises(SyncRefused) as polar:
        await rig.navigator.sync_to(Icrs(10.0, 88.0))
    assert polar.value.doubts == (SyncDoubt.NEAR_POLE,)
    with pytest.raises((SyncRefused, OutsideLimits)):
        await rig.navigator.sync_to(Icrs(up_now().ra_deg, -70.0))
    assert syncs(rig) == 0


async def test_what_a_slew_would_be_refused_for_is_told_without_moving(make_rig: MakeRig) -> None:
    rig = await make_rig()
    await rig.navigator.would_slew(up_now())
    with pytest.raises(OutsideLimits):
        await rig.navigator.would_slew(Icrs(up_now().ra_deg, -60.0))
    assert not any(command.startswith(b":MS") for command in rig.fake.heard)


async def test_words_do_not_make_a_lost_position_count_again(make_rig: MakeRig) -> None:
    rig = await make_rig()
    await rig.navigator.slew(up_now())
    rig.navigator.mount.distrust("its clock has jumped")
    with pytest.raises(DeviceRefused) as refused:
        # within what words may move it, of a belief that means nothing
        await rig.navigator.sync_to(displaced(await reading(rig), 90.0, -60.0))
    assert refused.value.reason is Refusal.UNTRUSTED
    assert not rig.navigator.mount.trusted
    assert syncs(rig) == 0


async def test_a_place_that_is_no_number_is_never_told(make_rig: MakeRig) -> None:
    rig = await make_rig()
    await rig.navigator.slew(up_now())
    with pytest.raises(SyncRefused):
        await rig.navigator.sync_to(Icrs(up_now().ra_deg, float("nan")))
    assert syncs(rig) == 0


class Parked:
    """A mount that says that it is parked; all else is the real one's."""

    def __init__(self, mount: Mount) -> None:
        self._mount = mount

    def __getattr__(self, name: str) -> object:
        return getattr(self._mount, name)

    async def reading(self) -> MountReading:
        return replace(await self._mount.reading(), parked=True)


async def test_a_parked_mount_is_neither_looked_through_nor_synced(make_rig: MakeRig) -> None:
    rig = await make_rig(wrap=cast("Callable[[Mount], Mount]", Parked))
    for order in (rig.navigator.sync(), rig.navigator.sync_to(up_now())):
        with pytest.raises(DeviceRefused) as refused:
            await order
        assert refused.value.reason is Refusal.PARKED
    assert "exposing" not in rig.kinds()
    assert syncs(rig) == 0


# -- the same bounds as a look's -----------------------------------------------------------------------


async def believed(rig: SyncRig) -> Icrs:
    return from_mount((await rig.mount.reading()).place)


async def told(rig: SyncRig, east_arcsec: float, north_arcsec: float) -> tuple[SyncDoubt, ...]:
    """Tell it that it points so far from where it believes; what was said against it."""
    try:
        await rig.guard.coordinate_syncs.sync_to(displaced(await believed(rig), east_arcsec, north_arcsec))
    except SyncRefused as refused:
        return refused.doubts
    return ()


async def taken(rig: SyncRig, east_arcsec: float, north_arcsec: float) -> int:
    """How many of twelve such steps are believed."""
    doubts = [await told(rig, east_arcsec, north_arcsec) for _ in range(12)]
    return doubts.count(())


def test_words_turn_the_sky_no_further_than_a_look_may() -> None:
    async def night(rig: SyncRig) -> None:
        await rig.slew(rig.up(dec_deg=84.0))
        before = await believed(rig)
        # 1.9° on the sky, and 18° for all that stands at the equator
        assert await told(rig, 1.9 * 3600.0, 0.0) == (SyncDoubt.NEAR_POLE,)
        assert separation_arcsec(await believed(rig), before) < 60.0
        assert rig.syncs == 0
        # small ones turn it as far when they are many
        assert await taken(rig, 180.0, 0.0) == 1
        assert rig.syncs == 1
        with pytest.raises(SyncRefused, match="nothing was synced; let it look"):
            await rig.guard.coordinate_syncs.sync_to(displaced(await believed(rig), 180.0, 0.0))
        refusals = [entry for entry in rig.notes(EntryKind.REFUSAL) if entry.facts.get("told")]
        assert refusals[-1].facts["doubts"] == [SyncDoubt.TOLD_TOO_MUCH]

    rigged(night)


def test_words_add_up_over_the_night() -> None:
    async def night(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        first = await believed(rig)
        assert [await told(rig, 0.0, 5400.0) for _ in range(2)] == [(), (SyncDoubt.TOLD_TOO_MUCH,)]
        assert separation_arcsec(await believed(rig), first) <= 7200.0
        # elsewhere it is the same belief
        await rig.slew(rig.up(-40.0, 10.0))
        assert await told(rig, 0.0, 5400.0) == (SyncDoubt.TOLD_TOO_MUCH,)
        # back to where it was is no further than it was
        assert await told(rig, 0.0, -5400.0) == ()
        assert rig.guard.coordinate_syncs.totals.count == 2
        # at noon another night begins
        await taken(rig, 0.0, 3000.0)
        assert await told(rig, 0.0, 3000.0) == (SyncDoubt.TOLD_TOO_MUCH,)
        rig.guard.coordinate_syncs.totals = replace(rig.guard.coordinate_syncs.totals, night="2026-11-20")
        assert await told(rig, 0.0, 3000.0) == ()

    rigged(night)


def test_words_that_contradict_what_was_seen_are_refused() -> None:
    async def night(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        await rig.guard.commit(await rig.look(), SyncTrigger.ORDERED)
        sent = rig.syncs
        assert await told(rig, 0.0, 1800.0) == (SyncDoubt.NOT_EXPECTED,)
        # and neither step by step
        assert await taken(rig, 0.0, 300.0) == 2
        assert rig.syncs == sent + 2

    rigged(night)


def test_words_that_say_what_a_look_showed_are_believed() -> None:
    async def night(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        found = await rig.look()
        await rig.guard.learn(found)
        east, north = found.offset.east_arcsec, found.offset.north_arcsec
        assert found.offset.total_arcsec > 700.0
        assert await told(rig, -east, -north) == (SyncDoubt.NOT_EXPECTED,)
        assert await told(rig, east, north) == ()
        # once; the second time it would be past it
        assert await told(rig, east, north) == (SyncDoubt.NOT_EXPECTED,)
        assert await rig.off_arcsec() < 60.0

    rigged(night)


def test_a_pointing_model_is_asked() -> None:
    async def night(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        assert await told(rig, 0.0, 900.0) == (SyncDoubt.NOT_EXPECTED,)
        assert await told(rig, 0.0, 400.0) == ()

    rigged(night, pointing=SureModel(Expected(Offset(0.0, 380.0), 20.0)))


def test_another_segment_and_an_operators_word_let_words_count_anew() -> None:
    async def night(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        assert await taken(rig, 0.0, 3000.0) == 2
        rig.mount.new_segment("its home was found")
        assert await taken(rig, 0.0, 3000.0) == 2
        rig.guard.coordinate_syncs.proven()
        assert await taken(rig, 0.0, 3000.0) == 2

    rigged(night)


async def test_trust_is_such_a_word(make_rig: MakeRig) -> None:
    rig = await make_rig()
    rig.navigator.guard.coordinate_syncs.totals = CoordinateSyncTotals(count=3, raised_deg=1.9)
    rig.navigator.trust()
    assert rig.navigator.guard.coordinate_syncs.totals.count == 0


def test_a_restart_forgets_no_words() -> None:
    journal = MemoryJournal()

    async def before(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        await rig.guard.commit(await rig.look(), SyncTrigger.ORDERED)
        assert await told(rig, 0.0, 500.0) == ()

    async def after(rig: SyncRig) -> None:
        rig.guard.restore(list(journal.entries))
        await rig.slew(rig.up())
        assert await told(rig, 0.0, 500.0) == (SyncDoubt.NOT_EXPECTED,)
        assert await told(rig, 0.0, -500.0) == ()

    rigged(before, journal=journal)
    rigged(after, journal=journal)


def test_a_sync_that_shows_late_is_counted_and_one_that_never_shows_is_not() -> None:
    async def night(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        syncs, place = rig.guard.coordinate_syncs, await believed(rig)
        syncs._late = Claim(displaced(place, 0.0, 3600.0), place, rig.clock.utc(), told=True)
        rig.mount.new_segment(SEEN_LATE)
        assert (syncs.totals.count, round(syncs.totals.raised_deg, 3)) == (1, 1.0)
        rig.mount.new_segment(SEEN_LATE)
        assert syncs.totals.count == 0

    rigged(night)


STEP = st.tuples(st.floats(-7200, 7200), st.floats(-7200, 7200))


@given(steps=st.lists(STEP, max_size=12), dec=st.floats(-20, 84))
@settings(max_examples=40, deadline=None)
def test_no_words_of_a_night_move_the_belief_further_than_one_may(
    steps: list[tuple[float, float]], dec: float
) -> None:
    """Truth from outside the guard: the zeros of the axes, as the mount would take them."""

    async def night(rig: SyncRig) -> None:
        syncs, utc = rig.guard.coordinate_syncs, rig.clock.utc()
        turned = raised = 0.0
        for east, north in steps:
            believed = HourAngle(30.0 + turned, dec + raised, utc)
            seen = displaced(believed, east, north)
            claim = Claim(
                hour_angle_to_icrs(seen, SITE, AIR), hour_angle_to_icrs(believed, SITE, AIR), utc, told=True
            )
            now = MountReading(claim.believed, utc, slewing=False, tracking=True)
            if not syncs.vetoes(now, claim):
                syncs.taken(claim)
                turned += seen.ha_deg - believed.ha_deg
                raised += seen.dec_deg - believed.dec_deg
        assert abs(raised) <= 2.01
        assert abs(turned) <= 2.6

    rigged(night)
