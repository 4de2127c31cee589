"""When frames don't solve: what was wrong chooses what is tried; bounded, announced, kept, cancellable."""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.devices import Mount, MountReading
from mountnav.errors import (
    MountMoved,
    NotReached,
    OffsetTooLarge,
    OutsideLimits,
    SolveFailed,
    SyncRefused,
    TargetNotReached,
)
from mountnav.frames import Frame, Hint
from mountnav.journal.records import EntryKind
from mountnav.measuring.measurements import SkyQuality, StarImages
from mountnav.navigation.policy import (
    CHEAP,
    TACTICS,
    Persistence,
    Tactic,
    Trouble,
    next_tactic,
    trouble_of,
    wait_s,
)
from mountnav.settings.centering import CenteringSettings, UnsolvedSettings
from mountnav.simulation.sky_script import Cloud, SkyScript
from mountnav.solution import Reason, Times, Verdict
from mountnav.solving.settings import SolveSettings
from tests.navigation.virtual_rig import POLICY, VirtualRig, in_virtual_time


def unsolved(reason: Reason, images: StarImages = StarImages.WELL_SAMPLED) -> Verdict:
    quality = SkyQuality(10, images, 3.0, 0.1, 0.0, 400.0, 8.0, 0.5, 100.0, 0.0)
    return Verdict(None, reason, "so it is", 10, Times(total_s=0.5), quality=quality)


class Answers:
    """A solver that says what it is told to, and then what it sees."""

    def __init__(self, rig: VirtualRig, *verdicts: Verdict) -> None:
        self._rig = rig
        self._left = list(verdicts)
        self.asked: list[tuple[Hint, SolveSettings, float]] = []
        rig.navigator._equipment.solve = self

    async def __call__(self, frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
        self.asked.append((hint, settings, frame.exposure_s or 0.0))
        if self._left:
            return self._left.pop(0)
        return await self._rig.sky(frame, hint, settings)


def tactics(rig: VirtualRig) -> list[object]:
    return [facts["tactic"] for facts in rig.told("tactic")]


def test_every_reason_has_its_tactics_and_all_are_bounded() -> None:
    for reason in Reason:
        trouble = trouble_of(unsolved(reason))
        assert TACTICS[trouble]
    for images, trouble in [(StarImages.TRAILED, Trouble.TRAILED), (StarImages.DEFOCUSED, Trouble.DEFOCUS)]:
        assert trouble_of(unsolved(Reason.CLOUD_OR_DEFOCUS, images)) is trouble
    # waiting makes no focus, and blind makes no stars
    assert Tactic.WAIT not in TACTICS[Trouble.DEFOCUS]
    assert Tactic.BLIND not in TACTICS[Trouble.FEW_STARS]


@given(st.lists(st.sampled_from(list(Trouble)), max_size=200), st.frozensets(st.sampled_from(list(Tactic))))
def test_whatever_goes_wrong_in_whatever_order_it_ends(
    troubles: list[Trouble], allowed: frozenset[Tactic]
) -> None:
    used = Counter[Tactic]()
    for trouble in troubles:
        tactic = next_tactic(trouble, used, allowed)
        if tactic is None:
            continue
        assert tactic in allowed
        used[tactic] += 1
        assert used[tactic] <= TACTICS[trouble].count(tactic)
    most = sum(max(row.count(tactic) for row in TACTICS.values()) for tactic in Tactic)
    assert used.total() <= most


def test_waits_grow_up_to_a_bound() -> None:
    persistence = Persistence(first_wait_s=20.0, longest_wait_s=100.0)
    assert [wait_s(persistence, waited) for waited in range(5)] == [20.0, 40.0, 80.0, 100.0, 100.0]


def test_a_cloud_is_waited_for_and_the_target_centered() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-20.0, 30.0)
        report = await rig.navigator.center(target)
        assert rig.off_arcsec(target) < 31.0
        assert report.elapsed_s > 180.0
        assert tactics(rig)[:2] == ["another-frame", "longer-exposure"]
        # the last one is asked for since no frame before it proves the first solved one new
        assert set(tactics(rig)[2:-1]) == {"wait"}
        assert tactics(rig)[-1] == "another-frame"
        # each frame in the cloud is in the journal, with why
        dark = [one for one in rig.journal.looks if not one.solved]
        assert len(dark) == len(tactics(rig)) - 1
        assert {one.reason for one in dark} == {str(Reason.CLOUD_OR_DEFOCUS)}
        assert len(rig.entries(EntryKind.DECISION)) >= len(dark)

    in_virtual_time(work, script=SkyScript(clouds=(Cloud(0.0, 4.0),)))


def test_a_cloud_that_stays_ends_in_time_with_its_reason() -> None:
    async def work(rig: VirtualRig) -> None:
        began = rig.clock.monotonic_s()
        with pytest.raises(SolveFailed) as end:
            await rig.navigator.center(rig.up(-20.0, 30.0))
        assert end.value.reason == str(Reason.CLOUD_OR_DEFOCUS)
        assert "wait ×" in str(end.value)
        assert 590.0 < rig.clock.monotonic_s() - began < 800.0
        assert "sync" not in rig.mount.received
        assert rig.entries(EntryKind.CENTERING)[0].facts["reason"] == end.value.reason

    in_virtual_time(work, script=SkyScript(clouds=(Cloud(0.0, 600.0),)))


def test_the_centerings_own_time_bounds_the_waiting() -> None:
    async def work(rig: VirtualRig) -> None:
        with pytest.raises(TargetNotReached) as end:
            await rig.navigator.center(rig.up(-20.0, 30.0), timeout_s=100.0)
        assert end.value.reason is NotReached.TIME

    in_virtual_time(work, script=SkyScript(clouds=(Cloud(0.0, 600.0),)))


def test_waiting_can_be_cancelled() -> None:
    async def work(rig: VirtualRig) -> None:
        running = asyncio.ensure_future(rig.navigator.center(rig.up(-20.0, 30.0)))
        while "wait" not in tactics(rig):
            await rig.clock.sleep(1.0)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        assert rig.navigator.activity == "idle"
        assert not rig.mechanics.slewing()

    in_virtual_time(work, script=SkyScript(clouds=(Cloud(0.0, 600.0),)))


def test_a_poor_field_is_left_for_its_neighbor_and_come_back_to() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-20.0, 30.0)
        poor = unsolved(Reason.CATALOG_TOO_SHALLOW)
        solver = Answers(rig, poor, poor, poor)
        report = await rig.navigator.center(target)
        # the last one: no frame before it proves the first solved one new
        assert tactics(rig) == ["longer-exposure", "longer-exposure", "neighbor-field", "another-frame"]
        assert [exposure for _, _, exposure in solver.asked[:4]] == [5.0, 15.0, 45.0, 45.0]
        # the first solved look was a neighbor's, some fields away; what it said was right for the target
        assert 3000.0 * 2.0 * 1.4 < report.tries[0].error_arcsec < 3000.0 * 2.0 * 1.6 + 1200.0
        assert rig.off_arcsec(target) < 31.0
        assert any("neighbor" in note for note in report.notes)

    in_virtual_time(work)


def test_an_unsolved_neighbor_is_left_again() -> None:
    async def work(rig: VirtualRig) -> None:
        poor = unsolved(Reason.CATALOG_TOO_SHALLOW)
        Answers(rig, *[poor] * 40)
        with pytest.raises(SolveFailed, match="neighbor-field × 2"):
            await rig.navigator.center(rig.up(-20.0, 30.0))
        aims = rig.told("slewing")
        # there, to one side, to another, and back
        assert len(aims) == 4
        assert aims[0]["ra_deg"] == pytest.approx(aims[3]["ra_deg"], abs=0.01)
        assert aims[0]["dec_deg"] == pytest.approx(aims[3]["dec_deg"], abs=0.01)

    in_virtual_time(work)


def test_a_wrong_place_is_sought_wider_and_then_everywhere() -> None:
    async def work(rig: VirtualRig) -> None:
        lost = unsolved(Reason.NO_MATCH)
        solver = Answers(rig, lost, lost, lost, lost)
        rig.navigator._equipment.solving = SolveSettings(blind="never")
        await rig.navigator.look(persistent=True)
        assert tactics(rig) == ["another-frame", "wider-search", "longer-exposure", "blind"]
        radii = [hint.radius_deg for hint, _, _ in solver.asked]
        assert radii == [2.0, 2.0, 6.0, 6.0, 6.0]
        assert [settings.blind for _, settings, _ in solver.asked] == ["never"] * 4 + ["after"]
        assert solver.asked[-1][0].scale_low_arcsec_px is None
        assert "slew" not in rig.mount.received

    in_virtual_time(work)


def test_trailed_stars_are_exposed_shorter() -> None:
    async def work(rig: VirtualRig) -> None:
        trailed = unsolved(Reason.NO_MATCH, StarImages.TRAILED)
        solver = Answers(rig, trailed, trailed)
        await rig.navigator.look(persistent=True)
        assert tactics(rig) == ["another-frame", "shorter-exposure"]
        assert solver.asked[-1][2] == pytest.approx(5.0 / 3.0)

    in_virtual_time(work)


def test_a_plain_look_does_only_what_is_cheap() -> None:
    async def work(rig: VirtualRig) -> None:
        began = rig.clock.monotonic_s()
        with pytest.raises(SolveFailed):
            await rig.navigator.look()
        assert rig.clock.monotonic_s() - began < 60.0
        assert rig.camera.frames == POLICY.solve_retries
        assert set(tactics(rig)) <= {str(one) for one in CHEAP}
        assert "slew" not in rig.mount.received

    in_virtual_time(work, script=SkyScript(clouds=(Cloud(0.0, 600.0),)))


def test_the_operator_chooses_the_tactics() -> None:
    settings = CenteringSettings(
        when_unsolved=UnsolvedSettings(tactics=(Tactic.LONGER,), longest_exposure_s=12.0, max_frames=3)
    )
    policy = settings.policy(exposure_s=5.0, scale_arcsec_px=2.0, scale_tolerance=0.05)

    async def work(rig: VirtualRig) -> None:
        poor = unsolved(Reason.TOO_FEW_MEASUREMENTS)
        solver = Answers(rig, *[poor] * 10)
        with pytest.raises(SolveFailed, match="3 frame"):
            await rig.navigator.sync()
        assert [exposure for _, _, exposure in solver.asked] == [5.0, 12.0, 12.0]

    in_virtual_time(work, policy=policy)


class Restless:
    """A mount that says for some readings more that it slews."""

    def __init__(self, mount: Mount, readings: int) -> None:
        self._mount = mount
        self.left = readings

    def __getattr__(self, name: str) -> object:
        return getattr(self._mount, name)

    async def reading(self) -> MountReading:
        self.left -= 1
        return replace(await self._mount.reading(), slewing=self.left >= 0)


@pytest.mark.parametrize("readings", [2, 1000])
def test_a_mount_that_still_settles_costs_a_frame_and_one_that_never_does_is_told(readings: int) -> None:
    restless: list[Restless] = []

    def wrap(mount: Mount) -> Mount:
        restless.append(Restless(mount, 0))
        return restless[0]  # type: ignore[return-value]

    async def work(rig: VirtualRig) -> None:
        restless[0].left = readings
        if readings > 100:
            with pytest.raises(MountMoved):
                await rig.navigator.look()
            assert rig.camera.frames == 1 + POLICY.moved_retries
        else:
            await rig.navigator.look()
            assert rig.camera.frames in (2, 3)
        moved = [one for one in rig.journal.looks if not one.solved]
        assert [one.reason for one in moved] == ["mount-moved"] * (rig.camera.frames - (readings < 100))

    in_virtual_time(work, wrap=wrap)


@pytest.mark.long
def test_a_recovery_takes_a_third_frame_and_lets_the_mount_track() -> None:
    script = SkyScript(seed=4, false_share=0.25)

    async def work(rig: VirtualRig) -> int:
        await rig.navigator.slew(rig.up(-15.0, 35.0))
        await rig.navigator.set_tracking(False)
        try:
            await rig.navigator.recover()
        except (OffsetTooLarge, SyncRefused, OutsideLimits):
            return 0
        assert (await rig.navigator.read_mount()).tracking is True
        used = [one for one in rig.journal.looks if one.used == "recovery"]
        assert rig.off_arcsec((await rig.navigator.look()).believed) < 30.0
        return len(used)

    frames = [in_virtual_time(work, script=replace(script, seed=seed)) for seed in range(8)]
    assert max(frames) >= 3
    assert sum(count > 0 for count in frames) >= 4


def test_near_the_pole_nothing_is_synced() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.slew(rig.up(20.0, 88.0))
        for order in (rig.navigator.sync, rig.navigator.recover):
            with pytest.raises(SyncRefused, match="pole"):
                await order()
        assert "sync" not in rig.mount.received

    in_virtual_time(work)
