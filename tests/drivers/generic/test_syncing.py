"""What the readings after a sync mean, for real and simulated mounts alike."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from drivers.generic.syncing import SyncReadBack
from mountnav.devices import (
    MountReading,
    SyncOutcome,
)
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent
from tests.drivers.generic.plain_rig import QUICK, rigged

SENT = datetime(2026, 3, 1, 22, tzinfo=UTC)
PLACE = Apparent(120.0, 10.0, SENT)


def _reading(
    ra_off_arcsec: float = 0.0, dec_off_arcsec: float = 0.0, *, after_s: float = 0.0
) -> MountReading:
    place = Apparent(PLACE.ra_deg + ra_off_arcsec / 3600.0, PLACE.dec_deg + dec_off_arcsec / 3600.0, SENT)
    return MountReading(place, SENT + timedelta(seconds=after_s))


def _read_back(before: MountReading, *, resolution_arcsec: float = 1.0) -> SyncReadBack:
    read_back = SyncReadBack(PLACE, before, resolution_arcsec=resolution_arcsec, most_arcsec=30.0)
    read_back.sent(SENT)
    return read_back


def test_a_sync_is_seen_when_three_quarters_of_its_way_are_gone() -> None:
    read_back = _read_back(_reading(dec_off_arcsec=80.0, after_s=-1.0))
    assert read_back.near_arcsec == pytest.approx(20.0)
    assert read_back.shows(_reading(dec_off_arcsec=19.0))
    assert not read_back.shows(_reading(dec_off_arcsec=21.0))


def test_a_long_sync_has_to_end_within_the_bound_of_the_mount() -> None:
    assert _read_back(_reading(dec_off_arcsec=7200.0, after_s=-1.0)).near_arcsec == 30.0


def test_a_coarse_step_is_always_left_to_the_mount() -> None:
    assert _read_back(_reading(dec_off_arcsec=20.0), resolution_arcsec=60.0).near_arcsec == 65.0


@pytest.mark.parametrize(("late", "outcome"), [(False, SyncOutcome.SEEN), (True, SyncOutcome.LATE)])
def test_one_that_shows_is_seen_or_late(late: bool, outcome: SyncOutcome) -> None:
    result = _read_back(_reading(dec_off_arcsec=600.0, after_s=-1.0)).result(
        _reading(dec_off_arcsec=2.0), after_s=1.5, late=late
    )
    assert (result.outcome, result.after_s) == (outcome, 1.5)
    assert result.miss_arcsec == pytest.approx(2.0, abs=1e-6)


def test_one_that_changed_nothing_was_ignored() -> None:
    read_back = _read_back(_reading(dec_off_arcsec=600.0, after_s=-1.0))
    assert (
        read_back.result(_reading(dec_off_arcsec=600.0), after_s=3.0, late=True).outcome
        is SyncOutcome.IGNORED
    )


def test_half_of_one_is_another_place() -> None:
    read_back = _read_back(_reading(600.0, 600.0, after_s=-1.0))
    assert read_back.result(_reading(600.0, 0.0), after_s=3.0, late=True).outcome is SyncOutcome.ELSEWHERE


def test_a_mount_that_rests_is_seen_though_the_sky_has_turned_since() -> None:
    read_back = _read_back(_reading(dec_off_arcsec=600.0, after_s=-1.0))
    turned_arcsec = SIDEREAL_DEG_S * 10.0 * 3600.0
    assert read_back.shows(_reading(turned_arcsec, after_s=10.0))


async def test_syncs_are_classified_by_their_read_back() -> None:
    async with rigged(timing=replace(QUICK, sync_wait_s=1.5)) as rig:
        seen = await rig.mount.sync(await rig.beside(0.2, 0.1))
        assert seen.outcome is SyncOutcome.SEEN
        assert seen.miss_arcsec < 5.0
        rig.language.sync_late_s = 1.0
        late = await rig.mount.sync(await rig.beside(0.2, 0.1))
        assert late.outcome is SyncOutcome.LATE
        # counted from its answer: the order itself went out before that
        assert QUICK.late_s < late.after_s
        rig.language.sync_late_s, rig.language.sync_ignored = 0.0, True
        ignored = await rig.mount.sync(await rig.beside(0.2, 0.1))
        assert ignored.outcome is SyncOutcome.IGNORED
        assert ignored.miss_arcsec > 300.0
        assert rig.language.orders.count("sync") == 3


async def test_a_sync_that_shows_when_it_was_given_up_is_recognized() -> None:
    async with rigged() as rig:
        rig.language.sync_late_s = 1.2
        result = await rig.mount.sync(await rig.beside(30.0, -20.0))
        assert result.outcome is SyncOutcome.IGNORED
        await rig.until(lambda: rig.heard("sync-late"))
        assert rig.mount.trusted


async def test_a_small_sync_that_shows_late_is_recognized() -> None:
    async with rigged() as rig:
        rig.language.sync_late_s = 1.2
        result = await rig.mount.sync(await rig.beside(0.2, -0.1))
        assert result.outcome is SyncOutcome.IGNORED
        await rig.until(lambda: rig.heard("sync-late"))
        assert rig.mount.trusted
