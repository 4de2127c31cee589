"""Syncs on told coordinates: believed within bounds, and read back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import pytest

from mountnav.errors import DeviceRefused, OutsideLimits, Refusal, SyncDoubt, SyncRefused
from mountnav.navigation.devices import Mount, MountReading
from mountnav.navigation.kinds import from_mount
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec
from tests.navigation.conftest import MakeRig, Rig, up_now


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
