"""Orders that few mounts know, and drivers of others that leave work to us."""

from __future__ import annotations

import pytest

from drivers.simulated.mount import SimulatedMount
from mountnav.devices import Skill, SyncOutcome, SyncResult
from mountnav.errors import DeviceRefused, Refusal
from mountnav.journal.records import Outcome
from mountnav.sky.coordinates import Apparent, Icrs
from tests.mount.mount_rig import Rig, run


def test_a_mount_that_keeps_no_park_position_is_not_asked_to() -> None:
    async def work(rig: Rig) -> None:
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.set_park()
        assert refusal.value.reason is Refusal.UNSUPPORTED
        assert [row["order"] for row in rig.refusals()] == ["set-park"]
        assert not rig.outcomes()

    run(work)


def test_one_that_keeps_it_takes_the_present_place(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    async def set_park(self: SimulatedMount) -> None:
        asked.append(self.name)

    monkeypatch.setattr(SimulatedMount, "set_park", set_park, raising=False)
    monkeypatch.setattr(SimulatedMount, "skills", property(lambda _: frozenset(Skill)))

    async def work(rig: Rig) -> None:
        await rig.mount.set_park()
        assert rig.outcomes() == [("set-park", Outcome.DONE)]

    run(work)
    assert len(asked) == 1


@pytest.mark.parametrize(("heeds", "outcome"), [(True, SyncOutcome.SEEN), (False, SyncOutcome.IGNORED)])
def test_a_sync_whose_driver_does_not_read_back_is_judged_by_our_own_reading(
    monkeypatch: pytest.MonkeyPatch, heeds: bool, outcome: SyncOutcome
) -> None:
    told = SimulatedMount.sync

    async def sync(self: SimulatedMount, place: Apparent | Icrs) -> SyncResult | None:
        if heeds:
            await told(self, place)
        return None

    monkeypatch.setattr(SimulatedMount, "sync", sync)

    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-20.0, 30.0))
        before = rig.mount.segment_id
        result = await rig.mount.sync(rig.place(-20.2, 30.1))
        assert result.outcome is outcome
        assert (rig.mount.segment_id != before) is heeds

    run(work)
