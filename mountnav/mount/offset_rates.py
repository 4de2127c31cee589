"""Rates beside the sidereal one: never without an end, never without somebody who ends them.

::

    refused? -> guard armed -> written -> sent, read back -> in force -> ended, and seen to have ended
                                                              |
                 their end, a stop, slew, park, home, tracking ordered, link lost, close

What can't be ended is tried on and reported, and the mount is stopped at last (`ending`). Ending them waits
for no disk.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final

from mountnav.devices import (
    STARS_RATES,
    MountReading,
    OffsetRates,
    Skill,
    TakesOffsetRates,
    offset_speed_arcsec_s,
    skills_of,
)
from mountnav.errors import (
    BadRequest,
    Busy,
    Cancelled,
    DeviceError,
    DeviceRefused,
    MountnavError,
    OutsideLimits,
    Refusal,
)
from mountnav.journal.records import EntryKind, Outcome
from mountnav.mount.order_rooms import OrderRooms
from mountnav.mount.path_ahead import PathAhead
from mountnav.mount.self_acting import SelfActingOrders
from mountnav.mount.sending import OrderResult, OvertakenError
from mountnav.mount.tracking_watch import LEAD_S
from mountnav.pointing.limits.along import Path
from mountnav.pointing.limits.refusing import why as in_words
from mountnav.sky.coordinates import Observed
from mountnav.tasks import begun

__all__ = ["RateOrders", "RatesInForce"]

_ZERO_ARCSEC_S = 5e-4
"""Rates that are read back as less than this, or than a step of the protocol, are none, ″/s: 1.8″ in an hour.
Doubled, a slow comet's that are forgotten to end are taken for ended; halved, float32 fails."""
_GRACE_S = 5.0
"""The guard waits so much longer than the end of the rates for news, s: the service ends them itself, and
needs some seconds over a slow line. Doubled, rates of a service that hangs go on for so much longer."""
_NAME: Final = "offset-rates"


@dataclass(frozen=True, slots=True)
class RatesInForce:
    """Rates that a mount tracks at beside the sidereal one.

    Attributes
    ----------
    since_utc : datetime
        When these were taken.
    ends_utc : datetime
        When they end, at the latest.
    """

    rates: OffsetRates
    since_utc: datetime
    ends_utc: datetime

    def facts(self) -> dict[str, object]:
        """For the journal."""
        return {
            "ra_arcsec_s": self.rates.ra_arcsec_s,
            "dec_arcsec_s": self.rates.dec_arcsec_s,
            "ends_utc": self.ends_utc.isoformat(),
        }


class RateOrders(SelfActingOrders):
    """Orders one mount's rates, and ends them.

    Parameters
    ----------
    stop : callable
        ``stop(why)``: stops the mount, and what it follows with it if the policy says so.
    rest : callable
        Ends its tracking.
    axes_move : callable
        Whether an axis is moved by hand.
    """

    def __init__(
        self,
        rooms: OrderRooms,
        *,
        stop: Callable[[str], Awaitable[None]],
        rest: Callable[[], Awaitable[None]],
        axes_move: Callable[[], bool],
    ) -> None:
        super().__init__(rooms, _NAME, "the offset rates", stop=stop)
        self._rest, self._axes_move = rest, axes_move
        self._owed = False
        self._moves = 0
        self.rests = False
        """Whether it was told to stand still: the end of its rates must not have it track."""
        self.in_force: RatesInForce | None = None

    @property
    def owed(self) -> bool:
        """Whether the mount may have rates that have to be ended."""
        return self._owed

    # -- ordering ----------------------------------------------------------------------------------

    async def set(self, rates: OffsetRates, *, ends_utc: datetime, path: Path | None) -> None:
        """Track at these rates until then. See `CheckedMount.set_offset_rates`."""
        self._require_sense(rates, ends_utc)
        if rates.none:
            await self.end("none were ordered")
            return
        stops, moves = self._sender.stops, self._moves
        mount = await self._skilled()
        await self._admission.require_free(_NAME)
        before = await self._admission.ready(_NAME)
        try:
            self._require_able(mount, rates, before)
            ahead = await self._require_within(rates, ends_utc, path, before)
        except MountnavError as refusal:
            await self._sender.refused(_NAME, refusal, before)
            raise
        async with self._wire:
            await self._admission.require_free(_NAME)
            if self._moves != moves:
                moved = Busy("it was moved meanwhile", device=self._mount.name, advice="order them again")
                await self._sender.refused(_NAME, moved, before)
                raise moved
            await self._sent(mount, ahead, before, stops)
        if self._sender.stops != stops:
            # the mount took them after the stop
            await self._ended_quietly("a stop came while they were ordered")
            raise self._stopped()

    async def _sent(
        self, mount: TakesOffsetRates, ahead: PathAhead, before: MountReading, stops: int
    ) -> None:
        wanted, ends_utc = ahead.rates, ahead.ends_utc
        first, sent = not self._owed, False

        async def send() -> OffsetRates | None:
            nonlocal sent
            self._armed.need(_NAME, ends_utc + timedelta(seconds=_GRACE_S))
            # from here on the mount may have them
            self._owed = sent = True
            await mount.set_offset_rates(wanted)
            return await mount.offset_rates()

        def came(said: OffsetRates | None) -> OrderResult:
            told = (
                None if said is None else {"ra_arcsec_s": said.ra_arcsec_s, "dec_arcsec_s": said.dec_arcsec_s}
            )
            return OrderResult(Outcome.DONE, facts={"read_back": told})

        facts: dict[str, object] = {
            "ra_arcsec_s": wanted.ra_arcsec_s,
            "dec_arcsec_s": wanted.dec_arcsec_s,
            "ends_utc": ends_utc.isoformat(),
            "along_a_path": ahead.path is not None,
            "on_loss": self._policy.on_loss,
        }
        try:
            await self._sender.send(_NAME, send, came, stops=stops, moves=first, facts=facts, before=before)
        except OvertakenError:
            raise self._stopped() from None
        except DeviceRefused:
            if self._sender.stops != stops:
                self.ending.begin("a stop came while they were ordered")
            # it tracks as before
            elif first:
                self._settled()
            elif self.in_force is not None:
                self._armed.need(_NAME, self.in_force.ends_utc + timedelta(seconds=_GRACE_S))
            raise
        except (MountnavError, asyncio.CancelledError):
            if sent:
                self.ending.begin("whether the mount took them isn't known")
            raise
        self.rests = False
        self.in_force = RatesInForce(wanted, self._clock.utc(), ends_utc)
        self._guard.following = ahead
        self._count_down()
        self._watch.wake()

    def _require_sense(self, rates: OffsetRates, ends_utc: datetime) -> None:
        if not (math.isfinite(rates.ra_arcsec_s) and math.isfinite(rates.dec_arcsec_s)):
            raise BadRequest(f"{rates.ra_arcsec_s} and {rates.dec_arcsec_s} ″/s are not rates")
        if rates.none:
            return
        if ends_utc.tzinfo is None:
            raise BadRequest("the end of the rates has no time zone", advice="give it in UTC")
        left_s = (ends_utc - self._clock.utc()).total_seconds()
        if left_s <= 0.0:
            raise BadRequest(f"the rates would end {-left_s:.0f} s ago", advice="give an end that is to come")
        if left_s > self._policy.most_s:
            raise BadRequest(
                f"rates for {left_s:.0f} s: at most {self._policy.most_s:g} s may be ordered at once",
                advice="order them for less, and again before they end; or set following.most_s",
            )

    def _require_able(self, mount: TakesOffsetRates, rates: OffsetRates, before: MountReading) -> None:
        if self._axes_move():
            raise Busy("an axis is moved by hand", device=self._mount.name, advice="end that motion first")
        speed = offset_speed_arcsec_s(rates, before.place.dec_deg)
        if speed > self._policy.most_arcsec_s:
            raise BadRequest(
                f"offset rates of {speed:.0f} ″/s: at most {self._policy.most_arcsec_s:g} ″/s are allowed",
                advice="look at the units; or set following.most_arcsec_s",
            )
        most = mount.most_offset_arcsec_s
        if most is not None and (
            abs(rates.ra_arcsec_s) > most.ra_arcsec_s or abs(rates.dec_arcsec_s) > most.dec_arcsec_s
        ):
            raise DeviceRefused(
                f"rates of {rates.ra_arcsec_s:.4g} and {rates.dec_arcsec_s:.4g} ″/s: it takes at most "
                f"{most.ra_arcsec_s:.4g} in right ascension and {most.dec_arcsec_s:.4g} in declination",
                device=self._mount.name,
                advice="the target is too fast for it",
                reason=Refusal.LIMIT,
            )
        if before.slewing:
            raise Busy("it slews", device=self._mount.name, advice="wait for it")
        if before.tracking is False:
            raise DeviceRefused(
                "offset rates refused: it doesn't track",
                device=self._mount.name,
                advice="order tracking first",
                reason=Refusal.NOT_TRACKING,
            )

    async def _require_within(
        self, rates: OffsetRates, ends_utc: datetime, path: Path | None, before: MountReading
    ) -> PathAhead:
        guard, utc = self._guard, self._clock.utc()
        ahead = PathAhead(guard.site, guard.air, guard.mounting, rates, ends_utc, path, guard.following)
        sides = guard.sides(before)
        found = await ahead.look_ahead(guard.limits, before, sides, utc)
        if found is None:
            # whatever its path says: as it is told to go now
            soon = [
                one
                for side in sides
                if (one := ahead.reached(guard.limits, before, side, LEAD_S)) is not None
            ]
            if not soon:
                return ahead
            reached = min(soon, key=lambda one: one.after_s)
            found = reached, before.utc + timedelta(seconds=reached.after_s)
        reached, at = found
        place = Observed(reached.az_deg, reached.alt_deg, at)
        raise OutsideLimits(
            f"the rates lead at {at:%H:%M:%S} UTC, {(at - utc).total_seconds():.0f} s from now, to altitude "
            f"{reached.alt_deg:.1f}°, azimuth {reached.az_deg:.0f}°, "
            f"{in_words(guard.limits, reached.limit, 0.0, place)}",
            advice="let them end earlier",
            limit=reached.limit,
        )

    async def _skilled(self) -> TakesOffsetRates:
        if Skill.OFFSET_RATES not in skills_of(self._mount) or not isinstance(self._mount, TakesOffsetRates):
            raise await self._admission.unsupported(_NAME)
        return self._mount

    def _stopped(self) -> Cancelled:
        return Cancelled("stopped before the rates were in force", device=self._mount.name)

    # -- ending ------------------------------------------------------------------------------------

    async def end(self, why: str) -> None:
        """End them, and return when they are seen to have ended. Raises as `SelfActingOrders.end`."""
        if self._owed:
            await self.ending.now(why)

    async def before(self, order: str) -> None:
        """End them before an order; rates that are judged just now count as judged before it."""
        self._moves += 1
        self.rests = False
        await super().before(order)

    async def stopped(self) -> None:
        """A stop was sent: end them too. Never raises a `MountnavError`: what fails is tried on."""
        if not self._owed:
            return
        self.rests = self.rests or await self._tracks() is False
        await self._ended_quietly("a stop")

    async def _tracks(self) -> bool | None:
        try:
            return (await self._state.reading()).tracking
        except DeviceError:
            return None

    async def close(self, within_s: float) -> None:
        """The mount is let go: end them, by the policy; what can't be ended is left to the guard."""
        if self._owed and self._policy.on_loss == "stop":
            with contextlib.suppress(MountnavError):
                await self._stop("the mount is let go")
        await self._let_go(within_s)

    def driver_closed(self) -> None:
        """The driver has let the mount go, and may have ended the rates by itself: no work for the guard."""
        known: OffsetRates | None = getattr(self._mount, "rates_known", None)
        if not self._owed or known is None or not known.none:
            return
        with self._written_end({"ra_arcsec_s": 0.0, "dec_arcsec_s": 0.0, "why": "its driver was closed"}):
            self._settled()

    async def take_up(self, why: str) -> None:
        """An earlier run of the service has left rates in force: end them. Raises as `end`."""
        if Skill.OFFSET_RATES in skills_of(self._mount) and isinstance(self._mount, TakesOffsetRates):
            self._owed = True
            await self._end_left(why)

    async def _end_once(self, why: str) -> None:
        if not self._owed:
            return
        await self._told_to_end(why)
        if self.rests and await self._tracks():
            # it takes their end for an order to track
            await self._rest()

    async def _told_to_end(self, why: str) -> None:
        async with self._wire:
            if not self._owed:
                return
            mount = self._mount
            if not isinstance(mount, TakesOffsetRates):
                self._settled()
                return
            was = self.in_force
            facts: dict[str, object] = {"ra_arcsec_s": 0.0, "dec_arcsec_s": 0.0, "why": why}
            if was is not None:
                facts["ended"] = was.facts()
            with self._written_end(facts):
                await mount.set_offset_rates(STARS_RATES)
                said = await mount.offset_rates()
                zero = max(_ZERO_ARCSEC_S, float(getattr(mount, "offset_step_arcsec_s", 0.0)))
                if said is not None and max(abs(said.ra_arcsec_s), abs(said.dec_arcsec_s)) > zero:
                    raise DeviceRefused(
                        f"after it was told to end its rates, it still has {said.ra_arcsec_s:.3f} and "
                        f"{said.dec_arcsec_s:.3f} ″/s",
                        device=mount.name,
                    )
            self._settled()

    def _settled(self) -> None:
        """None are in the mount."""
        was, self.in_force = self.in_force, None
        self._owed = False
        self._guard.following = None
        self._no_countdown()
        self._armed.free(_NAME)
        if was is not None:
            self._watch.wake()

    # -- their end ---------------------------------------------------------------------------------

    def _count_down(self) -> None:
        self._no_countdown()
        in_force = self.in_force
        assert in_force is not None
        # a clock that is set back must not prolong them
        deadline_s = self._clock.monotonic_s() + (in_force.ends_utc - self._clock.utc()).total_seconds()
        self._timer = begun(self._until_the_end(in_force, deadline_s), "rates-end", died=self._timer_died)

    async def _until_the_end(self, in_force: RatesInForce, deadline_s: float) -> None:
        while True:
            left_s = min(
                deadline_s - self._clock.monotonic_s(),
                (in_force.ends_utc - self._clock.utc()).total_seconds(),
            )
            if left_s <= 0.0:
                break
            await self._clock.sleep(min(left_s, 60.0))
        if self.in_force is not in_force:
            return
        why = f"their end, {in_force.ends_utc:%H:%M:%S} UTC, has come"
        facts: Mapping[str, object] = {"why": why, "left": self._policy.on_loss} | in_force.facts()
        await self._book.note(EntryKind.DECISION, f"the offset rates end: {why}", facts)
        self._state.tell("offset-rates-over", facts)
        if self._policy.on_loss == "stop":
            with contextlib.suppress(MountnavError):
                await self._stop(why)
                return
        self.ending.begin(why)
