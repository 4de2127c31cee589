"""The navigator of one telescope: look, sync, slew, center, recover, stop; one at a time, named ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime

from mountnav.devices import for_mount, from_mount
from mountnav.ephemeris import Ephemeris
from mountnav.errors import DeviceError, NotReached, TargetNotReached
from mountnav.frames import Frame
from mountnav.journal.records import EntryKind
from mountnav.mount import CheckedMount
from mountnav.navigation.centering import center_in_time
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.first_light import first_light
from mountnav.navigation.follow import Following, FollowProgress, FollowReport
from mountnav.navigation.learned import Learned
from mountnav.navigation.look import at_instant
from mountnav.navigation.look_retries import PersistentLook, cheap
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
    SlewReport,
    SyncReport,
    TelescopeState,
)
from mountnav.navigation.slewing import Slewing
from mountnav.navigation.sync import GuardedSync, SyncTrigger
from mountnav.pointing.limits import Limits
from mountnav.pointing.model.in_force import Pointing
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced
from mountnav.solution import Verdict
from mountnav.solving.settings import SolveSettings

__all__ = ["state_of"]


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
        super().__init__(equipment.name, equipment.mount, equipment.camera, equipment.listen)
        self._equipment = equipment
        self._slewing = Slewing(equipment)
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

    def believed(self, utc: datetime) -> Icrs | None:
        """Where the mount believed to point at `utc`; None when it wasn't read round that time."""
        around = self._equipment.readings.around(utc, utc, WITHIN)
        return None if around is None else at_instant(around.before, around.after, utc)

    # -- looks and syncs -----------------------------------------------------------------------------

    async def look(self, exposure_s: float | None = None, *, persistent: bool = False) -> Look:
        """Expose and solve; compare with the mount's belief. Moves nothing.

        Parameters
        ----------
        exposure_s : float, optional
            Instead of the policy's.
        persistent : bool
            Try all that the policy allows and nothing moves for; else another frame and longer exposures.

        Raises
        ------
        SolveFailed, MountMoved, BadFrame, DeviceError, JournalFailed
        """
        policy = self.policy
        persistence = policy.persistence if persistent else cheap(policy.persistence, policy.solve_retries)
        async with self.work("looking"):
            looking = PersistentLook(self._equipment, policy, persistence, used="look")
            return (await looking.look(exposure_s)).look

    async def frame(self, frame: Frame, verdict: Verdict, *, used: str = "night") -> FrameLook:
        """Compare a frame of another program with the mount's readings round it. See `compare_frame`."""
        return await compare_frame(self._equipment, self.policy, frame, verdict, used=used)

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

    async def slew(self, target: Target) -> SlewReport:
        """Go to `target` as the mount, and the pointing model where one is in force, believe it.

        To where it will be on arrival, if it moves.

        Raises
        ------
        OutsideLimits
            Target or way are not allowed; nothing moved.
        DeviceRefused
            The mount said no.
        Cancelled, TargetNotReached, DeviceError, JournalFailed
        """
        async with self.work("slewing"):
            place = await self._on_arrival(target)
            aim = self._slewing.aimed(place, await self._slewing.side_at(place))
            return await self._slewing.slew(place, aim)

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
    ) -> CenterReport:
        """Slew, look, correct, slew again, verify, until `target` is at the frame's center.

        Parameters
        ----------
        tolerance_arcsec, max_tries, timeout_s, correct_by : optional
            Instead of the policy's.
        planned_s : float, optional
            How long it is to be followed: the answer says which limit comes before that.
        key : str, optional
            Its name, for the policy of syncs.

        Returns
        -------
        CenterReport
            Always a success; every other end is an error.

        Raises
        ------
        TargetNotReached
            With the reason: tries, time, a tube that doesn't follow, ...
        OutsideLimits, SolveFailed, OffsetTooLarge, SyncRefused, MountMoved, DeviceError, JournalFailed
        """
        given = {
            "tolerance_arcsec": tolerance_arcsec,
            "max_tries": max_tries,
            "timeout_s": timeout_s,
            "correct_by": None if correct_by is None else CorrectBy(correct_by),
        }
        policy = replace(self.policy, **{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type]
        async with self.work("centering"):
            return await center_in_time(
                self._equipment,
                self._slewing,
                target,
                policy,
                halt=self.halt,
                planned_s=planned_s,
                key=key,
            )

    async def flip(
        self, target: Target, *, planned_s: float | None = None, key: str | None = None
    ) -> CenterReport:
        """Let a German mount change sides, and center `target` again, whatever was synced before.

        Raises
        ------
        TargetNotReached
            Centered, and still on the same side (`NotReached.SIDE`); or as `center`.
        """
        async with self.work("flipping"):
            before = (await self.mount.reading()).pier_side
            report = await center_in_time(
                self._equipment,
                self._slewing,
                target,
                self.policy,
                halt=self.halt,
                planned_s=planned_s,
                key=key,
            )
            if before is not None and report.side is before and not report.flipped:
                raise TargetNotReached(
                    f"centered, but the tube still hangs {before} of the pier",
                    device=self.name,
                    advice="the target must have crossed the meridian, by as much as the mount asks for",
                    reason=NotReached.SIDE,
                )
            return report

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
        async with self.work("following"):
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
