"""A mount whose position can't be trusted: it doesn't move before somebody has looked at the sky."""

from __future__ import annotations

import asyncio

import pytest

from mountnav.clock import utc_now
from mountnav.devices import MountReading, Trusts
from mountnav.errors import DeviceRefused, DeviceSilent, Refusal
from mountnav.navigation.reports import CenterOutcome
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.sphere import separation_arcsec
from tests.navigation.conftest import MakeRig, Rig, up_now
from tests.navigation.test_recovering import FindsAnywhere


async def made_untrusted(rig: Rig) -> None:
    """Let its belief jump, as a reboot makes it, and wait until that was noticed."""
    rig.mechanics.sync(icrs_to_apparent(up_now(30.0, 5.0), utc_now()))
    mount = rig.navigator.mount
    assert isinstance(mount, Trusts)
    async with asyncio.timeout(30.0):
        while mount.trusted:
            await asyncio.sleep(0.02)


async def test_it_refuses_to_slew_and_says_why(make_rig: MakeRig) -> None:
    rig = await make_rig()
    await made_untrusted(rig)
    before = rig.mechanics.axes()
    with pytest.raises(DeviceRefused, match="can't be trusted") as refusal:
        await rig.navigator.slew(up_now())
    assert refusal.value.reason is Refusal.UNTRUSTED
    assert abs(rig.mechanics.axes().dec_axis_deg - before.dec_axis_deg) < 1e-6
    state = await rig.navigator.state()
    assert state.trusted is False
    assert state.problem is not None
    assert "jumped" in state.problem
    assert "mount-untrusted" in rig.kinds()


@pytest.mark.long
async def test_a_centering_looks_at_the_sky_before_it_moves(make_rig: MakeRig) -> None:
    rig = await make_rig(solve=FindsAnywhere)
    await rig.navigator.slew(up_now(-15.0, 35.0))
    await made_untrusted(rig)
    target = up_now(-10.0, 30.0)
    report = await rig.navigator.center(target, tolerance_arcsec=30.0)
    assert report.outcome is CenterOutcome.CENTERED
    assert separation_arcsec(rig.mechanics.truth(), target) < 30.0
    kinds = rig.kinds()
    assert kinds.index("confirmed") < kinds.index("slewing", kinds.index("mount-untrusted"))
    state = await rig.navigator.state()
    assert state.trusted is True
    assert state.link == "up"
    assert state.slew_state == "arrived"
    assert state.problem is None


async def test_a_state_never_says_trusted_beside_the_reason_why_it_is_not(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = await make_rig()
    mount = rig.navigator.mount
    read = mount.reading

    async def distrusted_meanwhile() -> MountReading:
        reading = await read()
        mount.distrust("what an earlier run left of it can't be taken up")
        return reading

    monkeypatch.setattr(mount, "reading", distrusted_meanwhile)
    state = await rig.navigator.state()
    assert state.trusted is False


async def test_a_state_is_not_trusted_if_the_reading_failed_by_what_has_ended_the_trust(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = await make_rig()
    mount = rig.navigator.mount

    async def lost_meanwhile() -> MountReading:
        mount.distrust("its link was lost in a slew")
        raise DeviceSilent("no answer", device=mount.name)

    monkeypatch.setattr(mount, "reading", lost_meanwhile)
    assert (await rig.navigator.state()).trusted is False
