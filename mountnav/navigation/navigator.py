"""The navigator of one telescope: look, sync, slew, center, recover, stop; one at a time, named ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

from mountnav.devices import for_mount, from_mount
from mountnav.ephemeris import Ephemeris
from mountnav.errors import BadRequest, DeviceError, DeviceRefused, NotReached, TargetNotReached
from mountnav.frames import Frame
from mountnav.journal.records import EntryKind
from mountnav.mount import CheckedMount
from mountnav.navigation.aim_points import AimPoint, by_name
from mountnav.navigation.aiming import Aiming, point_seen
from mountnav.navigation.centering import center_in_time
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.first_light import first_light
from mountnav.navigation.follow import Following
from mountnav.navigation.follow_report import FollowProgress, FollowReport
from mountnav.navigation.holding import (
    DitherReport,
    DitherWish,
    Holding,
    HoldPlan,
    HoldProgress,
    HoldReport,
)
from mountnav.navigation.learned import Learned
from mountnav.navigation.look import at_instant
from mountnav.navigation.look_retries import PersistentLook, cheap
from mountnav.navigation.mosaicking import Mosaicking, MosaicReport, MosaicWait, PanelReport
from mountnav.navigation.mount_orders import MountOrders
from mountnav.navigation.moving import MovingTarget, Target
from mountnav.navigation.outside_frames import WITHIN, By, Judged, compare_frame, correct
from mountnav.navigation.policy import CenteringPolicy, CorrectBy
from mountnav.navigation.rates_kept import RATES_KEPT, RatesKept
from mountnav.navigation.recovering import recover, require_away_from_pole
from mountnav.navigation.reports import (
    CenterReport,
    CoordinateSyncReport,
    Corrected,
    FirstLightReport,
    FrameLook,
    Look,
    RecoverReport,
    Rotation,
    SlewReport,
    SyncReport,
    TelescopeState,
)
from mountnav.navigation.rotating import FieldAngle, Rotating, Shown, require_angle
from mountnav.navigation.searching import SearchBounds, SearchReport, field_deg, search
from mountnav.navigation.slewing import Slewing
from mountnav.navigation.sync import GuardedSync, SyncTrigger
from mountnav.pointing.limits import Limits
from mountnav.pointing.model.in_force import Pointing
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Icrs
from mountnav.sky.patterns import Panel
from mountnav.sky.sphere import displaced
from mountnav.solution import Verdict
from mountnav.solving.settings import SolveSettings

__all__ = ["state_of"]

DITHER_EVERY_S = 5.0
"""From look to look of a dither without a hold, s: one after the other, for most cameras."""
DITHER_GRACE_S = 60.0
"""Such a dither ends by itself so much after its own time, s: a look may be under way."""


async def state_of(
    equipment: Equipment, *, activity: str, connected: bool, problem: str | None
) -> TelescopeState:
    """Where the telescope believes it points, and what it does. Never raises for device trouble.

    Parameters
    ----------
    connected : bool
        Whether its devices are open.
    problem : str or None
        What is known to be wrong.
    """
    mount = equipment.mount
    known = TelescopeState(
        equipment.name,
        connected=False,
        activity=activity,
        reading=None,
        icrs=None,
        altitude_deg=None,
        azimuth_deg=None,
        problem=problem,
        trusted=_trusted(mount) if connected else None,
        link=mount.link,
        slew_state=mount.slew_state,
    )
    if not connected:
        return known
    try:
        reading = await mount.reading()
    except DeviceError as error:
        return replace(known, problem=str(error), trusted=_trusted(mount), slew_state=mount.slew_state)
    icrs = from_mount(reading.place)
    observed = icrs_to_observed(icrs, reading.utc, equipment.site, equipment.air)
    # what may have changed while the mount was read is told as it is now: "trusted" of a moment before, next
    # to the problem that has ended it, is a state that never was
    return replace(
        known,
        connected=True,
        reading=reading,
        icrs=icrs,
        altitude_deg=observed.alt_deg,
        azimuth_deg=observed.az_deg,
        trusted=_trusted(mount),
        link=mount.link,
        slew_state=mount.slew_state,
    )


def _shown(report: CenterReport) -> Shown:
    """The position angle that a centering's last look showed: of its point, or of the image."""
    assert report.last is not None
    assert report.rotation_deg is not None
    angle_deg = report.rotation_deg if report.at is None else report.at.position_angle_deg
    return angle_deg, report.last


def _trusted(mount: CheckedMount) -> bool | None:
    """Whether its position counts; None of one that doesn't know, as long as nothing speaks against it."""
    return mount.trusted if mount.tells_trust or not mount.trusted else None


class Navigator(MountOrders):
    """Moves one telescope by what its camera sees.

    Parameters
    ----------
    equipment : Equipment
        As `equip` puts it together.
    """

    def __init__(self, equipment: Equipment) -> None:
        super().__init__(
            equipment.name, equipment.mount, equipment.camera, equipment.listen, equipment.rotator
        )
        self._equipment = equipment
        self._slewing = Slewing(equipment)
        self._holding: Holding | None = None
        self._field: FieldAngle | None = None
        self._mosaicking: Mosaicking | None = None
        self._following: Following | None = None

    # -- what is known -------------------------------------------------------------------------------

    @property
    def policy(self) -> CenteringPolicy:
        """What it is allowed: tolerances, tries, caps."""
        return self._equipment.policy

    @property
    def solving(self) -> SolveSettings:
        """How frames are calibrated, measured and identified."""
        return self._equipment.solving

    @property
    def limits(self) -> Limits:
        """Where it may point."""
        return self.mount.limits

    @property
    def guard(self) -> GuardedSync:
        """Its guarded sync, with what was learned of the camera and the pointing model in force."""
        return self._equipment.guard

    @property
    def pointing(self) -> Pointing:
        """The pointing model in force; may be replaced between two pieces of work."""
        return self._equipment.guard.pointing

    @pointing.setter
    def pointing(self, pointing: Pointing) -> None:
        self._equipment.guard.pointing = pointing

    @property
    def learned(self) -> Learned:
        """What solves have taught of the camera."""
        return self._equipment.guard.learned

    async def state(self) -> TelescopeState:
        """Where the telescope believes it points, and what it does. Never raises for device trouble."""
        return await state_of(
            self._equipment,
            activity=self.activity,
            connected=self.connected,
            problem=self.problem,
        )

    @property
    def points(self) -> tuple[AimPoint, ...]:
        """Named points to which targets may be brought besides the frame's middle."""
        return self._equipment.points

    def point(self, at: AimPoint | str | None) -> AimPoint | None:
        """A point, or the one of that name. Raises `BadRequest`."""
        return by_name(self.points, at, device=self.name) if isinstance(at, str) else at

    def believed(self, utc: datetime) -> Icrs | None:
        """Where the mount believed to point at `utc`; None when it wasn't read round that time."""
        around = self._equipment.readings.around(utc, utc, WITHIN)
        return None if around is None else at_instant(around.before, around.after, utc)

    # -- looks and syncs -----------------------------------------------------------------------------

    async def look(
        self,
        exposure_s: float | None = None,
        *,
        persistent: bool = False,
        at: AimPoint | str | None = None,
    ) -> Look:
        """Expose and solve; compare with the mount's belief. Moves nothing.

        Parameters
        ----------
        exposure_s : float, optional
            Instead of the policy's.
        persistent : bool
            Try all that the policy allows and nothing moves for; else another frame and longer exposures.
        at : AimPoint or str, optional
            Tell where this point looks, too (`Look.at`).

        Raises
        ------
        BadRequest
            There is no such point, or it isn't within the frame.
        SolveFailed, MountMoved, BadFrame, DeviceError, JournalFailed
        """
        policy, point = self.policy, self.point(at)
        persistence = policy.persistence if persistent else cheap(policy.persistence, policy.solve_retries)
        async with self.work("looking"):
            looking = PersistentLook(self._equipment, policy, persistence, used="look")
            found = (await looking.look(exposure_s)).look
        return found if point is None else replace(found, at=point_seen(point, found))

    async def frame(self, frame: Frame, verdict: Verdict, *, used: str = "night") -> FrameLook:
        """Compare a frame of another program with the mount's readings round it. See `compare_frame`."""
        compared = await compare_frame(self._equipment, self.policy, frame, verdict, used=used)
        if self._holding is not None and compared.look is not None and not compared.doubts:
            self._holding.outside(compared.look)
        return compared

    async def sync(self) -> SyncReport:
        """Look, and sync the mount to where it truly points; read back whether it took it.

        Raises
        ------
        SyncRefused
            What stands against it; nothing was sent.
        DeviceRefused
            It is parked: no frame is exposed for that.
        SyncIgnored, SolveFailed, MountMoved, BadFrame, DeviceError, JournalFailed
        """
        async with self.work("syncing"):
            await self.mount.require_unparked("sync")

            async def look() -> Look:
                looking = PersistentLook(self._equipment, self.policy, self.policy.persistence, used="sync")
                return (await looking.look()).look

            found = await look()
            require_away_from_pole(found, self.policy, device=self.name)
            return await self.guard.commit(found, SyncTrigger.ORDERED, look_again=look)

    async def sync_to(self, place: Icrs) -> CoordinateSyncReport:
        """Sync the mount to given coordinates, which nobody has seen: allowed within bounds."""
        async with self.work("syncing"):
            return await self.guard.coordinate_syncs.sync_to(place)

    def trust(self) -> None:
        """An operator's word that the position is right; earlier syncs on given coordinates count no more."""
        super().trust()
        self.guard.coordinate_syncs.proven()

    async def recover(self, exposure_s: float | None = None) -> RecoverReport:
        """Find out where a mount points that doesn't know, and sync it. Never moves it. See `recover`."""
        async with self.work("recovering"):
            return await recover(self._equipment, self.policy, exposure_s)

    async def first_light(self, exposure_s: float | None = None) -> FirstLightReport:
        """Tell a telescope set up by eye where it points, and learn its camera. See `first_light`."""
        async with self.work("first light"):
            return await first_light(self._equipment, self.policy, self._slewing, exposure_s)

    # -- motion --------------------------------------------------------------------------------------

    async def slew(self, target: Target, *, at: AimPoint | str | None = None) -> SlewReport:
        """Go to `target` as the mount, and the pointing model where one is in force, believe it.

        To where it will be on arrival, if it moves.

        Parameters
        ----------
        at : AimPoint or str, optional
            Bring it to this point, as far as solves have taught where that looks; else to the frame's middle.

        Raises
        ------
        BadRequest
            There is no such point, or nobody knows yet where it looks.
        OutsideLimits
            Target or way are not allowed; nothing moved.
        DeviceRefused
            The mount said no.
        Cancelled, TargetNotReached, DeviceError, JournalFailed
        """
        aiming = Aiming(self._equipment, self.point(at))
        async with self.work("slewing"):
            self._field = None
            place = await self._on_arrival(target)
            side = await self._slewing.side_at(place)
            axis = aiming.require_known(place, side)
            return await self._slewing.slew(axis, self._slewing.aimed(axis, side))

    async def _on_arrival(self, target: Target) -> Icrs:
        """Where a target is, or will be at the end of a slew that begins now. Raises `BadRequest`."""
        if isinstance(target, Icrs):
            return target
        equipment = self._equipment
        moving = MovingTarget(
            target,
            site=equipment.site,
            clock=equipment.clock,
            pace=self._slewing.pace,
            exposure_s=self.policy.exposure_s,
            settle_s=self.policy.settle_s,
        )
        return moving.ahead(from_mount((await self.mount.reading()).place), exposed=False)

    async def would_slew(self, target: Target, *, after_stop: bool = False) -> None:
        """Tell what a slew to `target` would be refused for now; nothing moves, nothing is written down.

        Parameters
        ----------
        after_stop : bool
            As if what runs now had been stopped: it is no reason then.

        Raises
        ------
        OutsideLimits, DeviceRefused, Busy, BadRequest, DeviceError
        """
        equipment = self._equipment
        utc = equipment.clock.utc()
        await self.mount.require_agreement()
        place = await self._on_arrival(target)
        self.limits.check(place, utc, equipment.site, equipment.air)
        aim = self._slewing.aimed(place, await self._slewing.side_at(place))
        await self.mount.would_slew(for_mount(aim, self.mount.epoch, utc), after_stop=after_stop)

    async def offset(
        self, east_arcsec: float, north_arcsec: float, target: Target | None = None
    ) -> SlewReport:
        """Nudge: slew by so much on the sky, east and north positive; or to so far beside a target.

        Errors: see `slew`.
        """
        async with self.work("nudging"):
            if target is not None:
                beside = displaced(await self._on_arrival(target), east_arcsec, north_arcsec)
                aim = self._slewing.aimed(beside, await self._slewing.side_at(beside))
                return await self._slewing.slew(beside, aim)
            here = from_mount((await self.mount.reading()).place)
            return await self._slewing.slew(displaced(here, east_arcsec, north_arcsec))

    async def center(
        self,
        target: Target,
        *,
        tolerance_arcsec: float | None = None,
        max_tries: int | None = None,
        timeout_s: float | None = None,
        correct_by: CorrectBy | str | None = None,
        planned_s: float | None = None,
        key: str | None = None,
        at: AimPoint | str | None = None,
        angle: FieldAngle | None = None,
    ) -> CenterReport:
        """Slew, look, correct, slew again, verify, until `target` is at the frame's center, or at a point.

        Parameters
        ----------
        tolerance_arcsec, max_tries, timeout_s, correct_by : optional
            Instead of the policy's.
        planned_s : float, optional
            How long it is to be followed: the answer says which limit comes before that.
        key : str, optional
            Its name, for the policy of syncs.
        at : AimPoint or str, optional
            To which point it is brought, and where its error is judged, by the solved plate.
        angle : FieldAngle, optional
            How the image is to stand then; of a point, its own direction. After each turn of the rotator it
            is centered again, and looked at.

        Returns
        -------
        CenterReport
            Always a success; every other end is an error.

        Raises
        ------
        TargetNotReached
            With the reason: tries, time, a tube that doesn't follow, ...
        BadRequest
            There is no such point, or it isn't within the frame.
        OutsideLimits, SolveFailed, OffsetTooLarge, SyncRefused, MountMoved, DeviceError, JournalFailed
        """
        given: dict[str, Any] = {
            "tolerance_arcsec": tolerance_arcsec,
            "max_tries": max_tries,
            "timeout_s": timeout_s,
            "correct_by": None if correct_by is None else CorrectBy(correct_by),
        }
        point = self.point(at)
        if angle is not None:
            require_angle(angle)
        policy = replace(self.policy, **{name: value for name, value in given.items() if value is not None})
        async with self.work("centering"):
            self._field = None
            report = await self._centered(target, policy, point, angle, planned_s, key)
            self._field = angle
            return report

    async def _centered(
        self,
        target: Target,
        policy: CenteringPolicy,
        point: AimPoint | None,
        angle: FieldAngle | None,
        planned_s: float | None,
        key: str | None,
        begun: CenterReport | None = None,
    ) -> CenterReport:
        """Center, unless that is done, and turn the field, until both are right."""

        async def center() -> CenterReport:
            return await center_in_time(
                self._equipment,
                self._slewing,
                target,
                policy,
                halt=self.halt,
                planned_s=planned_s,
                key=key,
                point=point,
            )

        latest = begun or await center()
        if angle is None:
            return latest

        async def again() -> Shown:
            nonlocal latest
            latest = await center()
            return _shown(latest)

        rotating = Rotating(self._equipment, self.rotator)
        rotation = await rotating.bring(angle, _shown(latest), again)
        return replace(latest, rotation=rotation, notes=(*latest.notes, *rotation.notes))

    async def rotate(
        self, angle: FieldAngle, *, exposure_s: float | None = None, trust_count: bool = False
    ) -> Rotation:
        """Turn the field to a position angle where the telescope stands; nothing is slewed.

        Parameters
        ----------
        trust_count : bool
            An operator's word that the rotator's cables lie as its count says.

        Raises
        ------
        DeviceRefused
            There is no rotator, or its cable limits don't allow it; its count was disproved by a solve.
        TargetNotReached
            The rotator, or the image on it, didn't turn as ordered.
        BadRequest, SolveFailed, MountMoved, BadFrame, Cancelled, DeviceError, JournalFailed
        """
        require_angle(angle)
        async with self.work("rotating"):
            if trust_count and self.rotator is not None:
                self.rotator.trust()
            persistence = cheap(self.policy.persistence, self.policy.solve_retries)

            async def look() -> Shown:
                looking = PersistentLook(self._equipment, self.policy, persistence, used="rotating")
                found = (await looking.look(exposure_s)).look
                return found.solution.rotation_deg, found

            return await Rotating(self._equipment, self.rotator).bring(angle, await look(), look)

    async def mosaic(
        self,
        panels: Sequence[Panel],
        *,
        wait: MosaicWait,
        from_panel: int = 1,
        turned: bool = False,
        angle_tolerance_deg: float | None = None,
        tolerance_arcsec: float | None = None,
        at: AimPoint | str | None = None,
        heard: Callable[[PanelReport], None] | None = None,
    ) -> MosaicReport:
        """Go through the panels of a mosaic, or of a pattern; each is centered, and left to the camera.

        Parameters
        ----------
        panels : sequence of Panel
            As `mountnav.sky.patterns` lays them out.
        wait : MosaicWait
            What each is left for.
        from_panel : int
            Number of the first one: what an earlier order has done needn't be done again.
        turned : bool
            Whether each image is to stand at its panel's position angle.
        heard : callable, optional
            Told of each panel when it is centered, and when it ends.

        Raises
        ------
        OutsideLimits
            No panel is allowed now; it tells when. Nothing moved.
        TargetNotReached
            The camera program said nothing for too long, or some panels in a row couldn't be centered; it
            tells with which panel to begin again.
        BadRequest, Cancelled, DeviceError, JournalFailed
        """
        point, policy = self.point(at), self.policy
        if tolerance_arcsec is not None:
            policy = replace(policy, tolerance_arcsec=tolerance_arcsec)

        async def center(panel: Panel) -> CenterReport:
            angle = FieldAngle(panel.position_angle_deg, angle_tolerance_deg) if turned else None
            return await self._centered(panel.place, policy, point, angle, None, None)

        async with self.work("mosaic"):
            self._field = None
            run = Mosaicking(self._equipment, panels, wait, center, heard or (lambda report: None))
            self._mosaicking = run
            try:
                return await run.run(from_panel)
            finally:
                self._mosaicking = None

    @property
    def panel_waits(self) -> bool:
        """Whether a mosaic's panel is centered, and waits for the camera program."""
        return self._mosaicking is not None and self._mosaicking.waiting

    def next_panel(self) -> int:
        """Say that the camera is through with a frame of a mosaic's panel; how many are wanted yet of it.

        Raises
        ------
        BadRequest
            No mosaic runs, or its panel isn't centered yet.
        """
        if self._mosaicking is None:
            raise BadRequest("no mosaic is under way", device=self.name)
        return self._mosaicking.signal()

    @property
    def field_deg(self) -> tuple[float, float] | None:
        """Width and height of the look camera's field, by what was learned; None if that isn't enough."""
        return field_deg(self._equipment, self.policy)

    async def spiral_search(
        self, target: Target, bounds: SearchBounds, *, exposure_s: float | None = None
    ) -> SearchReport:
        """Look round the target, step by step, until a frame is solved; then center it. See `search`."""
        async with self.work("searching"):
            self._field = None
            place = await self._on_arrival(target)

            async def center() -> CenterReport:
                return await self._centered(target, self.policy, None, None, None, None)

            return await search(
                self._equipment, self._slewing, self.policy, place, bounds, center, exposure_s
            )

    async def flip(
        self,
        target: Target,
        *,
        planned_s: float | None = None,
        key: str | None = None,
        at: AimPoint | str | None = None,
    ) -> CenterReport:
        """Let a German mount change sides, and center `target` again, whatever was synced before.

        Raises
        ------
        TargetNotReached
            Centered, and still on the same side (`NotReached.SIDE`); or as `center`.
        """
        point = self.point(at)
        async with self.work("flipping"):
            before = (await self.mount.reading()).pier_side
            angle = self._field
            report = await self._centered(target, self.policy, point, None, planned_s, key)
            if before is not None and report.side is before and not report.flipped:
                raise TargetNotReached(
                    f"centered, but the tube is still {before} of the pier",
                    device=self.name,
                    advice="the target must have crossed the meridian, by as much as the mount asks for",
                    reason=NotReached.SIDE,
                )
            if angle is None:
                return report
            return await self._turned_with_it(report, target, point, angle, planned_s, key)

    async def _turned_with_it(
        self,
        report: CenterReport,
        target: Target,
        point: AimPoint | None,
        angle: FieldAngle,
        planned_s: float | None,
        key: str | None,
    ) -> CenterReport:
        """The field as it stood before the flip; or why it stands on its head now."""
        try:
            return await self._centered(target, self.policy, point, angle, planned_s, key, report)
        except DeviceRefused as error:
            words = f"the field didn't turn with the flip, it stands on its head: {error.what}"
            await self._equipment.note(EntryKind.DECISION, words, {"wanted_deg": angle.position_angle_deg})
            return replace(report, notes=(*report.notes, words))

    async def follow(
        self,
        target: Ephemeris,
        *,
        until_utc: datetime,
        tolerance_arcsec: float | None = None,
        exposure_s: float | None = None,
        look_every_s: float | None = None,
        heard: Callable[[FollowProgress], None] | None = None,
        key: str | None = None,
        at: AimPoint | str | None = None,
    ) -> FollowReport:
        """Center a target that moves, and track it until an end: by rates, guide pulses or small slews.

        A fast one is waited for ahead on its path. However it ends, the mount has no rates afterwards.

        Parameters
        ----------
        until_utc : datetime
            Aware; earlier where its ephemeris ends, or a limit is ahead.
        tolerance_arcsec, exposure_s : float, optional
            Instead of the policy's.
        look_every_s : float, optional
            Between two looks while all is well.
        heard : callable, optional
            Told how it goes, after each look.
        key : str, optional
            Its name, for the policy of syncs.
        at : AimPoint or str, optional
            To which point it is brought, and kept at, by what solves have taught of the camera.

        Returns
        -------
        FollowReport
            Followed to the end; every other end is an error.

        Raises
        ------
        DeviceRefused
            It is too fast for this mount, with the numbers; nothing moved.
        OutsideLimits, BadRequest
            It is outside the limits or its span now; nothing moved.
        TargetNotReached
            It could not be centered, or the mount doesn't keep its rates and has no other means.
        Cancelled
            It was stopped, or the rates were ended by something else.
        SolveFailed, OffsetTooLarge, SyncRefused, MountMoved, DeviceError, JournalFailed
        """
        policy = replace(
            self.policy,
            tolerance_arcsec=self.policy.tolerance_arcsec if tolerance_arcsec is None else tolerance_arcsec,
            exposure_s=self.policy.exposure_s if exposure_s is None else exposure_s,
        )
        aiming = Aiming(self._equipment, self.point(at))
        async with self.work("following"):
            self._field = None
            if aiming.point is not None:
                side = await self._slewing.side_at(target.icrs(self._equipment.clock.utc(), self.mount.site))
                target = aiming.path(target, side)
            run = Following(
                self._equipment,
                self._slewing,
                target,
                until_utc,
                policy,
                look_every_s=look_every_s,
                heard=heard,
                key=key,
                halt=self.halt,
            )
            self._following = run
            try:
                return await run.run()
            finally:
                self._following = None

    async def stop(self) -> None:
        """Stop the mount now, whatever else is going on; then end a running exposure."""
        if self._following is not None:
            self._following.stopped()
        await super().stop()

    @property
    def rates(self) -> RatesKept:
        """How the mount keeps rates beside the sidereal one, as looks have shown."""
        return self._equipment.rates

    async def forget_rates(self) -> None:
        """An operator's word that what was learned of the mount's rates counts no more. `JournalFailed`."""
        rates = self._equipment.rates
        rates.withdraw("forgotten by an operator's word")
        await self._equipment.note(EntryKind.LEARNED, rates.words, {RATES_KEPT: rates.as_dict()})

    async def correct(
        self,
        found: Look,
        *,
        by: By,
        target: Icrs | None,
        key: str | None = None,
        heard: Callable[[Judged], None] | None = None,
    ) -> Corrected:
        """Bring the telescope back by a look, between two frames. See `outside_frames.correct`."""
        async with self.work("correcting"):
            return await correct(
                self._equipment, self._slewing, found, by=by, target=target, key=key, heard=heard
            )

    # -- holding still -------------------------------------------------------------------------------

    @property
    def holds(self) -> bool:
        """Whether it is holding a place by looks: a dither is taken then."""
        return self._holding is not None

    async def hold(self, plan: HoldPlan, heard: Callable[[HoldProgress], None] | None = None) -> HoldReport:
        """Hold still by looks until the plan's time is over; see `Holding.run`.

        However it ends, the mount tracks on as for a star: a cancelled one isn't stopped.
        """
        async with self.work("holding", halts=False):
            self._holding = Holding(self._equipment, plan, heard)
            try:
                report = await self._holding.run()
            finally:
                self._holding = None
            assert isinstance(report, HoldReport)
            return report

    async def dither(
        self, wish: DitherWish, heard: Callable[[HoldProgress], None] | None = None
    ) -> DitherReport:
        """Look elsewhere by a pattern's step, and return when looks show that it has settled.

        While it holds, the hold goes on from there; else it moves once, by looks, and lets go.

        Raises
        ------
        Busy, Cancelled, TargetNotReached
        OutsideLimits, SolveFailed, DeviceError, JournalFailed
        """
        if self._holding is not None:
            return await self._holding.dither(wish)
        async with self.work("dithering", halts=False):
            plan = HoldPlan(every_s=DITHER_EVERY_S, for_s=wish.timeout_s + DITHER_GRACE_S)
            report = await Holding(self._equipment, plan, heard).run(only=wish)
            assert isinstance(report, DitherReport)
            return report
