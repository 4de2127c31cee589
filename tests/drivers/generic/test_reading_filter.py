"""Which readings are believed, on a language without a wire."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

import pytest

from drivers.generic.language import Readout
from drivers.generic.mount import GenericMount
from drivers.generic.reading_filter import Believed
from mountnav.clock import in_virtual_time, utc_now
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.generic.plain_rig import HERE, QUICK, plain, rigged


@pytest.mark.parametrize(("speed", "counts"), [(1.0, False), (20.0, True)])
def test_a_pause_of_the_machine_is_no_silence_under_a_fast_sky(speed: float, counts: bool) -> None:
    """What lasts seconds of the sky is a blink to us there: nobody was silent."""
    with in_virtual_time(FastClock(speed, ticks=lambda: 0.0)):
        mount = GenericMount(plain(), timing=replace(QUICK, heartbeat_s=1.0, silence_s=1.2), site=HERE)
        session = mount._session
        before = Readout(Apparent(10.0, 20.0, utc_now()), utc_now(), slewing=False)
        later = before.utc + timedelta(seconds=4.0)
        after = replace(before, place=Apparent(10.0, 20.05, later), utc=later)
        session.trust("for the test")
        session._watch_for_jumps(before, Believed(after))
        assert mount.trusted is counts


async def test_an_odd_reading_is_never_published() -> None:
    async with rigged() as rig:
        before = (await rig.mount.reading()).place
        rig.language.odd = [Apparent(1.0, 2.0, utc_now())]
        for _ in range(5):
            after = (await rig.mount.reading()).place
            assert (
                separation_arcsec(Icrs(before.ra_deg, before.dec_deg), Icrs(after.ra_deg, after.dec_deg)) < 5
            )
        assert rig.mount.trusted


async def test_a_hand_control_moves_it_without_losing_trust() -> None:
    async with rigged() as rig:
        mechanics = rig.language.mechanics
        rig.language.mechanics.move("s", 2.0)
        for _ in range(5):
            place = (await rig.mount.reading()).place
            assert isinstance(place, Apparent)
            assert separation_arcsec(place, replace(mechanics.reported(), utc=place.utc)) < 7200.0
        mechanics.stop()
        assert rig.mount.trusted
