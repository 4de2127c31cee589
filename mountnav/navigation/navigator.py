"""The navigator of one telescope: look, sync, slew, center, recover, stop; one at a time, named ends."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace

from mountnav.catalog.stars import Catalog
from mountnav.errors import (
    Busy,
    Cancelled,
    DeviceError,
    DeviceGarbled,
    DeviceMissing,
    DeviceSilent,
    MountMoved,
    SyncIgnored,
    TargetNotReached,
)
from mountnav.navigation.devices import Camera, Mount, SlewOutcome
from mountnav.navigation.kinds import for_mount, from_mount
from mountnav.navigation.looking import Instruments, Listener, Solve, in_thread
from mountnav.navigation.looking import look as take_look
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.recovering import agreement_arcsec, everywhere, require_above_ground
from mountnav.navigation.reports import (
    CenterOutcome,
    CenterReport,
    Look,
    RecoverReport,
    SlewReport,
    SyncOutcome,
    SyncReport,
    TelescopeState,
    Try,
)
from mountnav.pointing.limits import Limits
from mountnav.pointing.plausible import check_offset
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air, Icrs, Site, utc_now
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec
from mountnav.solve_settings import SolveSettings


class Navigator:
    """Moves one telescope by what its camera sees.

    Parameters
    ----------
    name : str
    mount : Mount
    camera : Camera
    catalog : Catalog
    site : Site
    air : Air
    policy : CenteringPolicy
    listen : callable
        Told of each step; it never steers.
    solving : SolveSettings, optional
        How frames are calibrated, measured and identified.
    solve : Solve, optional
        Who solves them; a thread of this process with the catalog if left out.
    """

    def __init__(
        self,
        *,
        name: str,
        mount: Mount,
        camera: Camera,
        catalog: Catalog,
        site: Site,
        air: Air,
        policy: CenteringPolicy,
        listen: Listener,
        solving: SolveSettings | None = None,
        solve: Solve | None = None,
    ) -> None:
        self.name = name
        self.policy = policy
        self.mount = mount
        self.camera = camera
        self._instruments = Instruments(
            mount, camera, solve or in_thread(catalog), solving or SolveSettings()
        )
        self._site = site
        self._air = air
        self._limits = Limits(min_altitude_deg=policy.min_altitude_deg)
        self._listen = listen
        self._activity = "idle"
        self._connected = False
        self._problem: str | None = None

    @property
    def solving(self) -> SolveSettings:
        """How frames are calibrated, measured and identified."""
        return self._instruments.solving

    async def open(self) -> None:
        """Open camera and mount. Nothing moves. Raises `DeviceError`."""
        try:
            await self.camera.open()
            await self.mount.open()
        except DeviceError as error:
            self._connected, self._problem = False, str(error)
            raise
        self._connected, self._problem = True, None

    async def close(self) -> None:
        """Release both devices."""
        self._connected = False
        try:
            await self.mount.close()
        finally:
            await self.camera.close()

    async def look(self, exposure_s: float | None = None) -> Look:
        """Expose and solve; compare with the mount's belief. Moves nothing. Errors: see `looking.look`."""
        async with self._motion("looking"):
            return await self._look(exposure_s)

    async def slew(self, target: Icrs) -> SlewReport:
        """Go to `target` as the mount believes it.

        Raises
        ------
        OutsideLimits
            Below the altitude limit; nothing moved.
        DeviceRefused
            The mount said no.
        """
        async with self._motion("slewing"):
            return await self._slew(target, target)

    async def sync(self) -> SyncReport:
        """Look, and tell the mount where it truly points; read back whether it believed it.

        Raises
        ------
        OffsetImplausible
            The offset is beyond `policy.max_sync_arcsec`; nothing was sent.
        """
        async with self._motion("syncing"):
            found = await self._look(None)
            return await self._sync(found)

    async def recover(self, exposure_s: float | None = None) -> RecoverReport:
        """Find out where a mount points that doesn't know, and tell it. Never moves it.

        A look, solved anywhere in the sky; its place must stand within the limits at this hour; a second
        look, taken afterwards, must agree with it. Then the mount is synced on the second one, however far
        that is from what it believed, and read back.

        Parameters
        ----------
        exposure_s : float, optional
            Instead of the policy's.

        Returns
        -------
        RecoverReport

        Raises
        ------
        NotSolved, BadFrame, MountMoved
            As a look does.
        OutsideLimits
            The solved place is below the limit: clock, site or frame are wrong; nothing was synced.
        OffsetImplausible
            The two frames disagree; nothing was synced.
        SyncIgnored, DeviceError
        """
        async with self._motion("recovering"):
            began = time.monotonic()
            self._listen("recovering", {})
            first = await self._look(exposure_s, anywhere=True)
            altitude_deg = require_above_ground(first, self._limits, self._site, self._air)
            second = await self._look(exposure_s, anywhere=True)
            apart = agreement_arcsec(first, second, self.policy, self.mount.resolution_arcsec)
            believed_altitude_deg = icrs_to_observed(
                second.believed, second.mid_exposure_utc, self._site, self._air
            ).alt_deg
            self._listen(
                "confirmed",
                {
                    "look_id": second.look_id,
                    "ra_deg": second.seen.ra_deg,
                    "dec_deg": second.seen.dec_deg,
                    "apart_arcsec": apart,
                    "offset_arcsec": second.offset.total_arcsec,
                    "altitude_deg": altitude_deg,
                    "believed_altitude_deg": believed_altitude_deg,
                },
            )
            done = await self._sync(second, confirmed=True)
            return RecoverReport(
                outcome=done.outcome,
                first=first,
                second=second,
                apart_arcsec=apart,
                altitude_deg=altitude_deg,
                believed_altitude_deg=believed_altitude_deg,
                read_back=done.read_back,
                read_back_miss_arcsec=done.read_back_miss_arcsec,
                elapsed_s=time.monotonic() - began,
            )

    async def center(
        self,
        target: Icrs,
        *,
        tolerance_arcsec: float | None = None,
        max_tries: int | None = None,
        timeout_s: float | None = None,
    ) -> CenterReport:
        """Slew, look, sync, slew again, verify, until `target` is at the frame's center.

        A mount that accepts syncs and ignores them is centered by an offset target instead
        [POINTING §3.7].

        Parameters
        ----------
        target : Icrs
        tolerance_arcsec, max_tries, timeout_s : optional
            Instead of the policy's.

        Returns
        -------
        CenterReport
            Always a success; every other end is an error.

        Raises
        ------
        OutsideLimits, NotSolved, OffsetImplausible, MountMoved, TargetNotReached, DeviceError
        """
        policy = replace(
            self.policy,
            tolerance_arcsec=self.policy.tolerance_arcsec if tolerance_arcsec is None else tolerance_arcsec,
            max_tries=self.policy.max_tries if max_tries is None else max_tries,
            timeout_s=self.policy.timeout_s if timeout_s is None else timeout_s,
        )
        async with self._motion("centering"):
            tries: list[Try] = []
            try:
                async with asyncio.timeout(policy.timeout_s):
                    return await self._center(target, policy, tries)
            except TimeoutError:
                await self._halt()
                raise TargetNotReached(
                    f"not centered within {policy.timeout_s:.0f} s ({_last_error(tries)}); "
                    "the mount was stopped",
                    device=self.name,
                    advice="allow more time, or see what took it in the job's attempts",
                ) from None

    async def stop(self) -> None:
        """Stop the mount now, whatever else is going on; then end a running exposure."""
        self._listen("stopping", {})
        try:
            await self.mount.stop()
        finally:
            await self.camera.abort()
        self._listen("stopped", {})

    async def state(self) -> TelescopeState:
        """Where the telescope believes it points, and what it does. Never raises for device trouble."""
        if not self._connected:
            return TelescopeState(self.name, False, self._activity, None, None, None, None, self._problem)
        try:
            reading = await self.mount.reading()
        except DeviceError as error:
            return TelescopeState(self.name, False, self._activity, None, None, None, None, str(error))
        icrs = from_mount(reading.place)
        observed = icrs_to_observed(icrs, reading.utc, self._site, self._air)
        return TelescopeState(
            self.name, True, self._activity, reading, icrs, observed.alt_deg, observed.az_deg, self._problem
        )

    async def _center(self, target: Icrs, policy: CenteringPolicy, tries: list[Try]) -> CenterReport:
        started = time.monotonic()
        aim = target
        await self._slew(target, aim)
        while True:
            began = time.monotonic()
            found = await self._look(None)
            error = offset_arcsec(found.seen, target)
            centered = error.total_arcsec <= policy.tolerance_arcsec
            last = len(tries) + 1 >= policy.max_tries
            outcome: SyncOutcome | None = None
            if not centered and not last:
                try:
                    outcome = (await self._sync(found)).outcome
                except SyncIgnored:
                    # The belief stays wrong, so aim beside the target by the error seen, on the sphere.
                    outcome = SyncOutcome.IGNORED
                    aim = displaced(aim, -error.east_arcsec, -error.north_arcsec)
                else:
                    aim = target
                await self._slew(target, aim)
            tries.append(
                Try(
                    number=len(tries) + 1,
                    seen=found.seen,
                    error_arcsec=error.total_arcsec,
                    east_arcsec=error.east_arcsec,
                    north_arcsec=error.north_arcsec,
                    pairs=found.solution.pairs,
                    rms_arcsec=found.solution.rms_arcsec,
                    false_probability=found.solution.false_probability,
                    synced=outcome is SyncOutcome.SEEN,
                    sync_outcome=outcome,
                    slewed=outcome is not None,
                    elapsed_s=time.monotonic() - began,
                )
            )
            self._listen("attempt", _facts(tries[-1]))
            if centered:
                return CenterReport(
                    outcome=CenterOutcome.CENTERED,
                    target=target,
                    tries=tuple(tries),
                    error_before_arcsec=tries[0].error_arcsec,
                    error_after_arcsec=tries[-1].error_arcsec,
                    error_sigma_arcsec=found.solution.center_sigma_arcsec,
                    tolerance_arcsec=policy.tolerance_arcsec,
                    elapsed_s=time.monotonic() - started,
                )
            if last:
                raise TargetNotReached(
                    f"still {error.total_arcsec:.0f}″ off after {len(tries)} looks "
                    f"(tolerance {policy.tolerance_arcsec:.0f}″)",
                    device=self.name,
                    advice="does the mount's resolution allow this tolerance? is there backlash or slip?",
                )

    async def _look(self, exposure_s: float | None, *, anywhere: bool = False) -> Look:
        if self.policy.settle_s > 0:
            await asyncio.sleep(self.policy.settle_s)
        instruments = self._instruments
        if anywhere:
            instruments = replace(instruments, solving=everywhere(instruments.solving))
        return await take_look(instruments, self.policy, self._listen, exposure_s=exposure_s)

    async def _slew(self, target: Icrs, aim: Icrs) -> SlewReport:
        """Slew to `aim`; both the target and the aim are checked before anything is sent."""
        now = utc_now()
        for place in (target, aim):
            self._limits.check(place, now, self._site, self._air)
        self._listen("slewing", {"ra_deg": aim.ra_deg, "dec_deg": aim.dec_deg})
        began = time.monotonic()
        outcome = await self.mount.slew(for_mount(aim, self.mount.epoch, now))
        reported = from_mount((await self.mount.reading()).place)
        miss = separation_arcsec(reported, aim)
        report = SlewReport(outcome, aim, reported, miss, time.monotonic() - began)
        self._listen("slewed", {"outcome": str(outcome), "miss_arcsec": miss, "elapsed_s": report.elapsed_s})
        if outcome is SlewOutcome.STOPPED:
            raise Cancelled(
                "the slew was stopped", device=self.mount.name, advice="send it again when it is safe"
            )
        if outcome is SlewOutcome.STALLED:
            raise TargetNotReached(
                f"the mount came to rest {miss:.0f}″ from where it was sent",
                device=self.mount.name,
                advice="look at the mount before the next slew: is an axis blocked or a clutch open?",
            )
        return report

    async def _sync(self, found: Look, *, confirmed: bool = False) -> SyncReport:
        """Send the solved place, unless the mount moved since its frame, and read back.

        The offset must be one that an honest mount can have, unless a second frame confirmed it.
        """
        if not confirmed:
            check_offset(found.offset, self.policy.max_sync_arcsec)
        since = separation_arcsec(from_mount((await self.mount.reading()).place), found.believed)
        if since > self.policy.max_motion_arcsec + self.mount.resolution_arcsec:
            raise MountMoved(
                f"the mount moved {since:.0f}″ between the frame and the sync",
                device=self.mount.name,
                advice="nothing was synced; look again",
            )
        self._listen(
            "syncing",
            {"look_id": found.look_id, "ra_deg": found.seen.ra_deg, "dec_deg": found.seen.dec_deg},
        )
        await self.mount.sync(for_mount(found.seen, self.mount.epoch, utc_now()))
        read_back, miss = await self._read_back(found)
        outcome = SyncOutcome.SEEN if self._followed(found, miss) else SyncOutcome.IGNORED
        self._listen("synced", {"outcome": str(outcome), "read_back_miss_arcsec": miss})
        if outcome is SyncOutcome.IGNORED:
            raise SyncIgnored(
                f"the sync was accepted, but the reading is {miss:.0f}″ from what was synced",
                device=self.mount.name,
                advice="is syncing allowed in the mount's present state?",
            )
        return SyncReport(outcome, found, read_back, miss)

    async def _read_back(self, found: Look) -> tuple[Icrs, float]:
        """Read until the sync shows, since some mounts apply it late; then the place and its distance."""
        deadline = time.monotonic() + self.policy.sync_read_back_s
        while True:
            place = from_mount((await self.mount.reading()).place)
            miss = separation_arcsec(place, found.seen)
            if self._followed(found, miss) or time.monotonic() >= deadline:
                return place, miss
            await asyncio.sleep(0.2)

    def _followed(self, found: Look, miss_arcsec: float) -> bool:
        """Whether a reading `miss_arcsec` from the synced place shows the sync.

        A quarter of the offset is left to the mount, but no more than the policy's bound; its own
        resolution always. So a small sync that was ignored is still recognised.
        """
        share = min(0.25 * found.offset.total_arcsec, self.policy.sync_read_back_arcsec)
        return miss_arcsec <= max(share, self.mount.resolution_arcsec + 5.0)

    @asynccontextmanager
    async def _motion(self, activity: str) -> AsyncIterator[None]:
        """Hold the telescope for one piece of work; a second one is refused, not queued.

        Work that is cancelled, or whose mount can't be trusted any more, leaves the mount stopped.
        """
        if self._activity != "idle":
            raise Busy(f"busy {self._activity}", device=self.name, advice="wait for it, or stop it")
        self._activity = activity
        try:
            yield
        except asyncio.CancelledError:
            await asyncio.shield(self._halt())
            raise
        except (DeviceSilent, DeviceGarbled, DeviceMissing):
            await self._halt()
            raise
        finally:
            self._activity = "idle"

    async def _halt(self) -> None:
        """Stop on the way out of trouble; the trouble itself is what the caller hears of."""
        try:
            await self.stop()
        except DeviceError as error:
            self._problem = f"could not be stopped: {error}"
            self._listen("stop-failed", {"problem": str(error)})


def _last_error(tries: list[Try]) -> str:
    return f"last seen {tries[-1].error_arcsec:.0f}″ off" if tries else "no look was finished"


def _facts(attempt: Try) -> dict[str, object]:
    return {
        "number": attempt.number,
        "ra_deg": attempt.seen.ra_deg,
        "dec_deg": attempt.seen.dec_deg,
        "error_arcsec": attempt.error_arcsec,
        "east_arcsec": attempt.east_arcsec,
        "north_arcsec": attempt.north_arcsec,
        "pairs": attempt.pairs,
        "rms_arcsec": attempt.rms_arcsec,
        "false_probability": attempt.false_probability,
        "synced": attempt.synced,
        "sync_outcome": None if attempt.sync_outcome is None else str(attempt.sync_outcome),
        "slewed": attempt.slewed,
        "elapsed_s": attempt.elapsed_s,
    }
