"""Orders that few mounts know, and drivers of others that leave work to us."""

from __future__ import annotations

import pytest

from drivers.simulated.mount import SimulatedMount
from mountnav.devices import Skill, SlewOutcome, SyncOutcome, SyncResult
from mountnav.errors import DeviceRefused, OutsideLimits, Refusal
from mountnav.journal.records import Outcome
from mountnav.pointing.limits import Limits
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


@pytest.mark.parametrize("backwards", [1, 5])
def test_a_way_round_is_planned_again_from_where_the_mount_has_come_to(
    monkeypatch: pytest.MonkeyPatch, backwards: int
) -> None:
    start: list[Apparent] = []
    driven = SimulatedMount.slew

    async def slew(self: SimulatedMount, place: Apparent | Icrs) -> SlewOutcome:
        outcome = await driven(self, place)
        if start and len(moved) < backwards:
            # somebody takes it back with its hand control before the next leg begins
            moved.append(place)
            await driven(self, start[0])
        return outcome

    moved: list[Apparent | Icrs] = []
    monkeypatch.setattr(SimulatedMount, "slew", slew)

    async def work(rig: Rig) -> None:
        here = rig.place(-75.0, 30.0)
        await rig.mount.slew(here)
        start.append(here)
        # along the north, where the direct way dips below
        target = rig.place(100.0, 45.0)
        if backwards == 1:
            assert await rig.mount.slew(target) is SlewOutcome.ARRIVED
            return
        with pytest.raises(OutsideLimits):
            await rig.mount.slew(target)
        assert rig.refusals()

    rig = run(work, limits=Limits(25.0, rate_ratio=None), mounting="fork")
    planned = [one for one in rig.journal.entries if "via" in one.facts]
    assert len(planned) == (2 if backwards == 1 else 3)
    assert len(moved) == min(backwards, 3)
