"""A flip is not stopped by a reading whose place is of before and whose side of the pier is of after."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.simulated.behavior import MountBehavior
from mountnav.devices import MountReading, PierSide, SlewOutcome
from mountnav.pointing.limits import Limits
from mountnav.simulation.mechanics import Machine
from tests.mount.mount_rig import Rig, run

_OTHER = {PierSide.EAST: PierSide.WEST, PierSide.WEST: PierSide.EAST}


def test_one_reading_in_the_middle_of_a_flip_may_have_the_wrong_side(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong: list[MountReading] = []

    async def work(rig: Rig) -> None:
        assert await rig.mount.slew(rig.place(-45.0, 20.0)) is SlewOutcome.ARRIVED
        true = rig.driver.reading
        count = 0

        async def reading() -> MountReading:
            # two questions, and the tube changes sides between them: each third reading, never two in a row
            nonlocal count
            found = await true()
            count += 1
            if rig.mechanics.slewing() and count % 3 == 0 and found.pier_side in _OTHER:
                wrong.append(found)
                return replace(found, pier_side=_OTHER[found.pier_side])
            return found

        monkeypatch.setattr(rig.driver, "reading", reading)
        assert await rig.mount.slew(rig.place(45.0, 20.0)) is SlewOutcome.ARRIVED
        assert rig.mechanics.pier_side() is PierSide.EAST

    run(
        work,
        limits=Limits(15.0, past_meridian_deg=(10.0, 10.0)),
        machine=Machine(mounting="german", slew_rate_deg_s=4.0),
        behavior=MountBehavior(tells_side=True),
        mounting="german",
    )
    assert wrong
