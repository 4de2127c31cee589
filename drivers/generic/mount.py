"""A whole mount made of a language: the interface that navigation sees, the same for every family.

- A position is published when the filter believes it (`reading_filter`).
- An order that moves or syncs is sent once.
- A slew has arrived when the mount rests *and* is where it was sent (`motions`).
- A sync has happened when the readings show it (`syncing`).
- A refusal counts unless the readings contradict it (`refusals`).
- Offset rates are those that it says it has, and end before anything else moves (`rates`, `drift`).
- An axis that is moved by hand is ended by whatever is not certain (`axes`).
- The link is watched and made again (`link_supervisor`).
- A position that may be wrong is not trusted (`session`).

It is used without the mount room above it as well (`mountnav bench`), so it refuses by itself what the wire
can't carry: a second motion, a slew while parked or by a position that is not trusted, a skill that the
family lacks. Limits of the telescope, daylight, the journal and the rights of callers are checked above it.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Mapping

from drivers.generic.axes import Axes
from drivers.generic.coordinates import apart_arcsec, check_kind
from drivers.generic.language import Language, Readout, Sent, Wanted
from drivers.generic.link_supervisor import LinkState
from drivers.generic.motions import Motions
from drivers.generic.options import Timing
from drivers.generic.rates import Rates, end_rates, said_rates
from drivers.generic.refusal_words import parked
from drivers.generic.refusals import Took
from drivers.generic.session import ConnectSettings, Listener, Session
from drivers.generic.syncing import sync
from drivers.wire.wire_log import WireLog
from mountnav.clock import pause, real_s
from mountnav.devices import (
    ConnectReport,
    Direction,
    Epoch,
    MountAxis,
    MountReading,
    OffsetRates,
    PierSide,
    RateSpan,
    Skill,
    SlewOutcome,
    SlewState,
    SyncResult,
    TrackingRate,
)
from mountnav.errors import BadRequest, DeviceError, DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent, Icrs, Site

LONGEST_PULSE_S = 60.0
"""The longest guide pulse, s. Chosen: pulses of guiding programs are below 10 s, those of `bench` below 13 s;
a longer one is a mistyped unit. Doubled, an order of 100 s at half the sidereal rate moves it by 12
arcminutes."""
_PULSE_LATE_S = 2.0
"""How much later than we count a pulse may end (s): a queue of orders at 9600 baud, a busy machine. Doubled,
a mount that says "guiding" for ever holds each pulse up for so much longer."""
_PULSE_POLL_S = 0.05
"""Between two questions whether a pulse is over (s): three exchanges at 9600 baud. Doubled, a pulse ends 0.05
s late; halved, the line is busy with that question alone."""


class GenericMount:
    """A `mountnav.devices.Mount` over any language; it is all else that a mount may be, too.

    `Skilled`, `Trusts`, `Announces`, `TakesOffsetRates` and `MovesAxes`: what its family lacks is refused.

    Parameters
    ----------
    language : Language
        The family's commands and answers, with their link.
    name : str, optional
        For messages; the language's address by default.
    site : Site, optional
        Ours, to compare with the mount's.
    set_clock, set_site : bool
        Whether connecting sets the mount's clock and site to ours.
    trust_on_connect : bool
        Whether its position is trusted at the first connecting, unless it shows that it was just switched on.
    swap_sides : bool, optional
        Whether it reports the side of the pier opposite to the one on which the tube hangs; None: not
        checked.
    """

    def __init__(
        self,
        language: Language,
        *,
        name: str | None = None,
        timing: Timing | None = None,
        site: Site | None = None,
        set_clock: bool = False,
        set_site: bool = False,
        trust_on_connect: bool = True,
        swap_sides: bool | None = None,
    ) -> None:
        self.language = language
        self._name = name or language.device
        self._timing = timing or Timing()
        connecting = ConnectSettings(site, set_clock, set_site, trust_on_connect, swap_sides)
        self._session = Session(language, self._name, self._timing, connecting)
        self._motions = Motions(self._session)
        self._refusals = self._motions.refusals
        self._rates = Rates(self._session, self._refusals)
        self._axes = Axes(self._session, self._motions)

    # -- what it is --------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """Name and address."""
        return self._name

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates this mount speaks, as set."""
        return self.language.epoch

    @property
    def sides_stated(self) -> bool:
        """Whether the settings say on which side the tube hangs, by inspection."""
        return self._session.sides_stated

    @property
    def resolution_arcsec(self) -> float:
        """Coarsest step of a commanded or reported position."""
        return self.language.resolution_arcsec

    @property
    def skills(self) -> frozenset[Skill]:
        """What it can do besides slew, sync and stop; known after `open`."""
        return self.language.skills

    @property
    def tracking_rates(self) -> frozenset[TrackingRate]:
        """At which rates it can track; known after `open`."""
        return self.language.tracking_rates

    @property
    def guide_rates_deg_s(self) -> tuple[float, float] | None:
        """Guide speed in right ascension and in declination; None where the mount doesn't report it."""
        return self.language.guide_rates_deg_s

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """The largest rates beside the sidereal one, both positive; None where the mount doesn't say."""
        return self.language.most_offset_arcsec_s

    @property
    def offset_step_arcsec_s(self) -> float:
        """Coarsest step of such a rate; 0 where the protocol carries any number."""
        return self.language.offset_step_arcsec_s

    @property
    def rates_known(self) -> OffsetRates | None:
        """At which offset rates it tracks as far as its driver knows; None where that is not known."""
        return self._session.drift.known

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        """At which speeds each axis can be moved by hand; known after `open`."""
        return self.language.axis_rates_deg_s

    @property
    def axes_moved(self) -> Mapping[MountAxis, float]:
        """Which axes are moved by hand at present, and how fast, °/s."""
        return dict(self._session.axes)

    @property
    def wire_log(self) -> WireLog:
        """The latest messages on its wire."""
        return self.language.log

    @property
    def link(self) -> LinkState:
        """State of the link."""
        return self._session.supervisor.state

    @property
    def report(self) -> ConnectReport | None:
        """What the last connecting found."""
        return self._session.report

    @property
    def slew_state(self) -> SlewState:
        """What the last order to move has come to."""
        return self._session.state

    @property
    def trusted(self) -> bool:
        """Whether its own position can be trusted."""
        return self._session.trusted

    def trust(self) -> None:
        """Trust the position: an operator says that it is right."""
        self._session.trust("an operator confirmed it")

    async def compare(self) -> ConnectReport:
        """Ask for its clock and site again, and compare them with ours. Raises `DeviceError`."""
        return await self._session.compare()

    async def set_site_and_time(self) -> ConnectReport:
        """Set its site and clock to ours, as far as it takes them. Raises `Busy`, `DeviceError`."""
        return await self._session.set_site_and_time()

    def listen(self, listener: Listener) -> None:
        """Call `listener(what, facts)` at each event of the link and of the trust in the position."""
        self._session.listeners.append(listener)

    async def open(self) -> None:
        """Connect, identify the mount, read its state and compare clock, site and epoch with ours.

        Moves and syncs nothing; sets the clock or the site only if the settings say so.

        Raises
        ------
        DeviceMissing
            If there is no such port or link.
        DeviceSilent, DeviceGarbled
            If nothing on it speaks the language.
        """
        await self._session.open()

    async def close(self) -> None:
        """End what moves on by our order, and release the link; closing twice is fine."""
        if self.language.usable:
            await self._axes.close()
            with contextlib.suppress(DeviceError):
                if self._session.drift.ours:
                    await end_rates(self._session, begins_tracking=False)
        await self._session.close()

    async def reading(self) -> MountReading:
        """Where the mount believes it points; repeated until a reading can be believed.

        Raises
        ------
        DeviceSilent, DeviceGarbled, DeviceMissing
            If there is no answer, none that makes sense, or no link.
        """
        await self._session.ready()
        return (await self._session.read()).reading

    # -- orders ------------------------------------------------------------------------------------

    async def slew(self, place: Apparent | Icrs) -> SlewOutcome:
        """Slew to a position in the mount's own coordinates; return when at rest.

        Parameters
        ----------
        place : Apparent or Icrs
            Of the kind that `epoch` says.

        Returns
        -------
        SlewOutcome
            ``ARRIVED`` only when at rest within `Timing.near_arcsec` (or two steps of the wire) of the
            position.

        Raises
        ------
        BadRequest
            If the position is of the other kind of coordinates.
        Busy
            If another order to move runs.
        DeviceRefused
            If it refuses, is parked, or its position can't be trusted; nothing moves.
        RefusedButDone
            If it refused and moved all the same; it was stopped.
        DeviceSilent, DeviceGarbled, DeviceMissing
            If the mount can't be followed any more; a stop was sent.
        """
        check_kind(place, self.epoch, device=self._name)
        session = self._session

        def there(now: Readout) -> bool:
            return apart_arcsec(now.place, place) <= session.near_arcsec()

        async def send(wanted: Wanted) -> Sent:
            return await self.language.send_slew(place, wanted)

        async with self._motions.hold("slew") as stops:
            before = await session.read()
            session.require_trust("the slew")
            if before.parked:
                raise parked("the slew", device=self._name)
            before = await self._as_for_a_star(before)
            return await self._motions.carry_out(send, there, stops=stops, before=before, towards=place)

    async def stop(self) -> None:
        """Stop all motion: at once, past every other exchange, and again until the mount is seen at rest.

        Raises
        ------
        DeviceRefused
            If it still moves after `Timing.stop_timeout_s`.
        DeviceSilent, DeviceGarbled, DeviceMissing
            If the stop can't be sent, or was sent and the mount can't be read.
        """
        await self._motions.stop()

    async def sync(self, place: Apparent | Icrs) -> SyncResult:
        """Send a sync on a position in the mount's own coordinates, once, and read back.

        Parameters
        ----------
        place : Apparent or Icrs
            Of the kind that `epoch` says.

        Returns
        -------
        SyncResult
            Seen (also late), accepted and ignored, or another position taken. The position is trusted after a
            sync that was seen, and not trusted after one that took another position.

        Raises
        ------
        BadRequest
            If the position is of the other kind of coordinates.
        Busy
            If an order to move runs.
        DeviceRefused
            If it refuses, or slews.
        RefusedButDone
            If it refused, and believes another position since.
        DeviceSilent, DeviceGarbled
            If its answer was lost and the readings don't show it.
        """
        check_kind(place, self.epoch, device=self._name)
        return await sync(self._session, self._refusals, place)

    # -- rates and axes ----------------------------------------------------------------------------

    async def set_offset_rates(self, rates: OffsetRates) -> None:
        """Track at these rates beside the sidereal one; return when the mount says so, where it can.

        A slew, a stop, parking, homing, switching tracking and closing end them; so does a link that was
        made again. After a restart or a lost link `rates_known` is None.

        Raises
        ------
        BadRequest
            If a rate is no finite number.
        Busy
            If an order to move runs, or an axis is moved by hand.
        DeviceRefused
            If it can't, the rates are beyond `most_offset_arcsec_s`, it is parked, doesn't track, isn't
            trusted, says no; or if it accepts and says afterwards that it has other rates: those are ended.
        RefusedButDone
            If it said no, and took them: they were ended.
        DeviceSilent, DeviceGarbled, DeviceMissing
            If at which rates it tracks isn't known.
        """
        self._require_skill(Skill.OFFSET_RATES)
        await self._rates.order(rates)

    async def offset_rates(self) -> OffsetRates | None:
        """At which rates it says to track beside the sidereal one; None where it doesn't say."""
        if Skill.OFFSET_RATES not in self.skills:
            return None
        await self._session.ready()
        return await said_rates(self._session)

    async def move_axis(self, axis: MountAxis, rate_deg_s: float) -> None:
        """Move an axis on at a speed until told otherwise, on top of tracking; 0 ends it.

        Returns when the order went out, for 0 when the mount was seen at rest (unless its other axis is
        moved too). An end that is refused, not answered or not seen becomes a stop. Nothing here ends the
        motion in time or at a limit: the caller has to.

        Raises
        ------
        BadRequest
            If it is no axis, or no speed at which that can be moved.
        Busy
            If an order to move or a guide pulse runs.
        DeviceRefused
            If it can't, is parked, slews, or says no; or if a stop or a newer order came before it went out.
        RefusedButDone
            If it said no, and moved: it was stopped.
        DeviceSilent, DeviceGarbled, DeviceMissing
            If its answer was lost; a stop was sent.
        """
        self._require_skill(Skill.MOVE_AXIS)
        await self._axes.move(axis, rate_deg_s)

    async def _as_for_a_star(self, before: Readout, *, begins_tracking: bool = True) -> Readout:
        """End the offset rates before something else moves; a new reading if there were some."""
        if not self._session.drift.to_end:
            return before
        await end_rates(self._session, begins_tracking=begins_tracking)
        return await self._session.read()

    # -- park, home, tracking, guiding -------------------------------------------------------------

    async def park(self) -> SlewOutcome:
        """Go to its park position; return when it reports parked, or rests where it doesn't report it.

        Raises
        ------
        DeviceRefused
            If it can't park, refuses, or its position can't be trusted.
        Busy, DeviceSilent, DeviceGarbled, DeviceMissing
            As of a slew.
        """
        self._require_skill(Skill.PARK)
        async with self._motions.hold("parking") as stops:
            before = await self._session.read()
            self._session.require_trust("parking")
            if before.parked:
                self._session.state = SlewState.ARRIVED
                return SlewOutcome.ARRIVED
            with contextlib.suppress(DeviceRefused):
                # one that doesn't end them may park all the same
                before = await self._as_for_a_star(before, begins_tracking=False)
            return await self._motions.carry_out(
                self.language.send_park, lambda now: now.parked, stops=stops, before=before
            )

    async def unpark(self) -> None:
        """Be ready to move again; return when it reports so.

        Raises
        ------
        DeviceRefused
            If it can't, refuses, or goes on reporting parked.
        RefusedButDone
            If it refused and did it.
        """
        self._require_skill(Skill.UNPARK)
        await self._order("unparking", self.language.send_unpark, lambda now: _not(now.parked))
        await self._wait_until(lambda now: not now.parked, "unparking")

    async def set_park(self) -> None:
        """Take the present position as the park position. Raises `DeviceRefused`."""
        self._require_skill(Skill.SET_PARK)
        await self._order("setting the park position", self.language.send_set_park)

    async def home(self) -> SlewOutcome:
        """Go to its home, or find it by its sensors if it has some: then its position is trusted again.

        Raises
        ------
        DeviceRefused
            If it has none, refuses, or would go there by a position that can't be trusted.
        Busy, DeviceSilent, DeviceGarbled, DeviceMissing
            As of a slew.
        """
        self._require_skill(Skill.HOME)
        finds = Skill.FIND_HOME in self.skills
        async with self._motions.hold("homing") as stops:
            before = await self._session.read()
            if not finds:
                self._session.require_trust("going home")
            before = await self._as_for_a_star(before)
            outcome = await self._motions.carry_out(
                self.language.send_home, lambda now: now.at_home, stops=stops, before=before
            )
            found = finds and outcome is SlewOutcome.ARRIVED and (await self._session.read()).at_home
            if found and not self._session.silent_on_its_way:
                self._session.trust("it has found its home")
            return outcome

    async def set_tracking(self, on: bool, rate: TrackingRate = TrackingRate.SIDEREAL) -> None:
        """Track the sky, or rest; return when the mount reports so. Offset rates end with it.

        Raises
        ------
        BadRequest
            If the rate is the custom one, and the mount takes offset rates.
        DeviceRefused
            If it can't, refuses, or accepts and does otherwise.
        RefusedButDone
            If it refused and did it; tracking that began like this is ended.
        """
        if not on or Skill.TRACKING_RATES not in self.skills:
            self._require_skill(Skill.TRACK)
        if rate is not TrackingRate.SIDEREAL:
            self._require_skill(Skill.TRACKING_RATES)
        if rate is TrackingRate.CUSTOM and Skill.OFFSET_RATES in self.skills:
            raise BadRequest(
                "the custom rate does not say how fast it is",
                device=self._name,
                advice="order offset rates, with their numbers",
            )

        self._session.require_no_job()
        await self._session.ready()
        try:
            await end_rates(self._session, begins_tracking=on)
        except DeviceError:
            # that nothing can be told is no reason to go on tracking
            if on:
                raise

        async def rest() -> None:
            async with self._session.ordering:
                await self.language.send_tracking(False, TrackingRate.SIDEREAL)

        await self._order(
            "switching tracking",
            lambda: self.language.send_tracking(on, rate),
            lambda now: now.tracking if on else _not(now.tracking),
            undo=rest if on else None,
        )
        await self._wait_until(lambda now: now.tracking is None or now.tracking is on, "switching tracking")

    async def guide(self, direction: Direction, duration_s: float) -> None:
        """Move at the guide rate for some time; return when that is over.

        Raises
        ------
        BadRequest
            If the duration is not above 0, or above `LONGEST_PULSE_S`.
        Busy
            If an order to move runs.
        DeviceRefused
            If it can't, or refuses.
        """
        self._require_skill(Skill.GUIDE)
        if not 0.0 < duration_s <= LONGEST_PULSE_S:
            raise BadRequest(
                f"a guide pulse of {duration_s} s",
                device=self._name,
                advice=f"above 0, at most {LONGEST_PULSE_S:g}",
            )
        self._session.require_no_job()
        await self._session.ready()
        before = await self._refusals.before()
        stops, loop = self._session.stops, asyncio.get_running_loop()
        began = loop.time()
        async with self._refusals.checked("the guide pulse", before):
            # two axes may be guided at once, but no slew may begin: the end of a pulse would halt it
            self._session.pulses += 1
            try:
                sent = await self.language.send_guide(
                    direction, duration_s, lambda: self._session.stops == stops
                )
                if sent.lost is not None:
                    raise sent.lost
                await asyncio.sleep(max(0.0, began + real_s(duration_s) - loop.time()))
                await self._pulse_over()
            finally:
                self._session.pulses -= 1

    async def _pulse_over(self) -> None:
        """Wait until the mount reports the end of a pulse, where it can: it began to count later than we did.

        One that reports "guiding" for longer is not waited for: if it can't take the next order it refuses
        that.
        """
        loop = asyncio.get_running_loop()
        until = loop.time() + real_s(_PULSE_LATE_S)
        while await self.language.guiding() and loop.time() < until:
            await pause(_PULSE_POLL_S)

    async def destination_side(self, place: Apparent | Icrs) -> PierSide | None:
        """The side of the pier after a slew to a position; None if the mount can't say."""
        check_kind(place, self.epoch, device=self._name)
        await self._session.ready()
        # some mounts have to be given the position as their target first
        async with self._session.ordering:
            return self._session.side(await self.language.destination_side(place))

    async def _order(
        self,
        order: str,
        send: Callable[[], Awaitable[None]],
        took: Took | None = None,
        *,
        undo: Callable[[], Awaitable[None]] | None = None,
    ) -> None:
        """Send an order that ends by itself."""
        self._session.require_no_job()
        await self._session.ready()
        # what would go on unattended is to be seen to begin: not while the mount still slows down
        seen = self._refusals.before if undo is None else self._refusals.before_at_rest
        before = await seen()
        async with self._refusals.checked(order, before, took=took, undo=undo), self._session.ordering:
            await send()

    def _require_skill(self, skill: Skill) -> None:
        if skill not in self.skills:
            raise DeviceRefused(
                f"it can't: {skill.replace('-', ' ')}", device=self._name, reason=Refusal.UNSUPPORTED
            )

    async def _wait_until(self, true: Callable[[Readout], bool], what: str) -> None:
        loop = asyncio.get_running_loop()
        until = loop.time() + self._timing.start_grace_s + self._timing.poll_s
        while not true(await self._session.read()):
            if loop.time() > until:
                raise DeviceRefused(f"accepted {what} and didn't do it", device=self._name)
            await pause(self._timing.soon_s)


def _not(said: bool | None) -> bool | None:
    """The opposite of what a mount reports; None where it doesn't report it."""
    return None if said is None else not said
