"""A mount that says no and does it, or takes a sync for another place: journal, trust, and the way out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from mountnav.devices import SyncOutcome, SyncResult
from mountnav.errors import DeviceRefused, Refusal, RefusedButDone, SyncIgnored
from mountnav.journal.records import EntryKind, Outcome
from mountnav.pointing.limits import Limits
from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import displaced
from tests.mount.mount_rig import Rig, run
from tests.navigation.virtual_rig import ERRORS, VirtualRig, in_virtual_time


@pytest.mark.parametrize("took", ["half", "dec-only", "elsewhere"])
def test_a_sync_taken_for_another_place_is_written_as_that_and_ends_the_trust(took: Any) -> None:
    async def work(rig: Rig) -> None:
        rig.mechanics.sync_behavior = took
        segment = rig.mount.segment_id
        place = (await rig.mount.reading()).place
        assert isinstance(place, Apparent)
        result = await rig.mount.sync(displaced(place, 900.0, 700.0))
        assert result.outcome is SyncOutcome.ELSEWHERE
        assert not rig.mount.trusted
        assert rig.mount.segment_id != segment
        assert rig.mount.side_of_last_sync is None
        with pytest.raises(DeviceRefused) as refused:
            await rig.mount.slew(rig.place(-20.0, 30.0))
        assert refused.value.reason is Refusal.UNTRUSTED
        said = [what for what, _ in rig.told]
        assert said.count("sync-elsewhere") == said.count("untrusted") == 1

    assert run(work).outcomes()[0] == ("sync", Outcome.ELSEWHERE)


def test_the_driver_of_somebody_else_that_calls_it_ignored_is_not_believed() -> None:
    async def work(rig: Rig) -> None:
        own = rig.driver.sync

        async def sync(place: Any) -> SyncResult:
            result = await own(place)
            rig.driver.trust()
            return SyncResult(SyncOutcome.IGNORED, result.read_back, result.miss_arcsec, result.after_s)

        rig.driver.sync = sync  # type: ignore[method-assign]
        place = (await rig.mount.reading()).place
        assert isinstance(place, Apparent)
        rig.mechanics.sync_behavior = "ignore"
        assert (await rig.mount.sync(displaced(place, 900.0, 700.0))).outcome is SyncOutcome.IGNORED
        assert rig.mount.trusted
        rig.mechanics.sync_behavior = "dec-only"
        assert (await rig.mount.sync(displaced(place, 900.0, 700.0))).outcome is SyncOutcome.ELSEWHERE
        assert not rig.mount.trusted

    assert [outcome for _, outcome in run(work).outcomes()] == [Outcome.IGNORED, Outcome.ELSEWHERE]


@pytest.mark.parametrize("order", ["slew", "park", "home"])
def test_an_order_that_was_refused_and_done_is_written_as_that(order: str) -> None:
    async def work(rig: Rig) -> None:
        rig.driver.denies = {order}
        with pytest.raises(RefusedButDone, match="said refused, but moved; stopped"):
            await (rig.mount.slew(rig.place(-40.0, 20.0)) if order == "slew" else getattr(rig.mount, order)())
        assert not rig.mechanics.slewing()
        assert not rig.mount.trusted
        assert "refused-but-done" in [what for what, _ in rig.told]

    rig = run(work)
    assert rig.outcomes() == [(order, Outcome.REFUSED_BUT_DONE)]
    assert "said refused, but moved; stopped" in rig.journal.ends[rig.journal.commands[0].command_id].detail


def test_a_sync_that_was_refused_and_done_begins_a_segment() -> None:
    async def work(rig: Rig) -> None:
        rig.driver.denies = {"sync"}
        segment = rig.mount.segment_id
        place = (await rig.mount.reading()).place
        assert isinstance(place, Apparent)
        with pytest.raises(RefusedButDone):
            await rig.mount.sync(displaced(place, 900.0, 700.0))
        assert rig.mount.segment_id != segment
        assert not rig.mount.trusted

    assert run(work).outcomes() == [("sync", Outcome.REFUSED_BUT_DONE)]


@pytest.mark.long
@pytest.mark.parametrize("took", ["half", "double", "reverse", "dec-only"])
def test_a_mount_that_takes_syncs_wrongly_is_centered_by_what_is_seen(took: Any) -> None:
    async def work(rig: VirtualRig) -> tuple[float, float]:
        rig.mechanics.sync_behavior = took
        first = rig.up(-20.0, 30.0)
        report = await rig.navigator.center(first)
        off = rig.off_arcsec(first)
        assert any("by offset from here on" in note for note in report.notes)
        assert rig.navigator.mount.trusted
        second = rig.up(-50.0, 50.0)
        await rig.navigator.center(second)
        # one sync, and then no more: each would only make it worse
        outcomes = [one.facts["outcome"] for one in rig.entries(EntryKind.SYNC)]
        assert outcomes == ["taken for another place", "not taken, counts by sight"]
        return off, rig.off_arcsec(second)

    assert max(in_virtual_time(work)) < 31.0


def test_as_far_as_it_is_off_the_limits_are_kept_away_from() -> None:
    async def work(rig: VirtualRig) -> None:
        usual = rig.navigator.limits.margin_deg
        rig.mechanics.sync_behavior = "reverse"
        await rig.navigator.center(rig.up(-20.0, 30.0))
        look = await rig.navigator.look()
        off_deg = look.offset.total_arcsec / 3600.0
        # an axis that is off shows as less than that away from the equator
        assert usual < off_deg < rig.navigator.limits.margin_deg < 1.3 * off_deg
        rig.mechanics.sync_behavior = "normal"
        await rig.navigator.sync()
        assert rig.navigator.limits.margin_deg == usual

    in_virtual_time(work, limits=Limits(min_altitude_deg=15.0, margin_deg=0.05))


def test_one_that_is_further_off_than_a_sync_may_be_counts_no_more() -> None:
    async def work(rig: VirtualRig) -> float:
        rig.mechanics.sync_behavior = "elsewhere"
        target = rig.up(-20.0, 30.0)
        # it began again with a recovery, whose sync led to the same place
        with pytest.raises(SyncIgnored, match="the reading is 18310″ from what was synced"):
            await rig.navigator.center(target)
        assert not rig.navigator.mount.trusted
        rig.mechanics.sync_behavior = "normal"
        await rig.navigator.center(target)
        assert rig.navigator.mount.trusted
        return rig.off_arcsec(target)

    assert in_virtual_time(work) < 31.0


@pytest.mark.long
@pytest.mark.parametrize("takes", ["ignore", "refuse", "half"])
@pytest.mark.parametrize("known", [False, True])
def test_a_lost_mount_that_takes_no_syncs_has_a_way_out(takes: Any, known: bool) -> None:
    """Before, its syncs failed, and only an operator's word helped."""

    async def work(rig: VirtualRig) -> float:
        target = rig.up(-20.0, 30.0)
        rig.mechanics.sync_behavior = takes
        if known:
            await rig.navigator.center(target)
        rig.navigator.mount.distrust("its link was lost")
        report = await rig.navigator.recover()
        assert not report.outcome.seen
        assert report.read_back_miss_arcsec == pytest.approx(report.second.offset.total_arcsec)
        assert rig.navigator.mount.trusted
        await rig.navigator.center(target)
        return rig.off_arcsec(target)

    assert in_virtual_time(work) < 31.0


def test_a_lost_mount_that_is_far_off_and_takes_no_syncs_stays_lost() -> None:
    async def work(rig: VirtualRig) -> None:
        rig.mechanics.sync_behavior = "ignore"
        rig.navigator.mount.distrust("its link was lost")
        with pytest.raises(SyncIgnored, match=r"2\.3° from .* turn the tube by hand .* say trust"):
            await rig.navigator.recover()
        assert not rig.navigator.mount.trusted

    in_virtual_time(work, errors=replace(ERRORS, ih_arcsec=12_000.0))
