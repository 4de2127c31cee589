"""A whole mount made of a language: the face that navigation sees, the same for every family.

- A place is published when the judge believes it (`judging`); an order that moves or syncs is sent once.
- A slew has arrived when the mount rests *and* is where it was sent (`moving`).
- A sync has happened when the readings show it (`syncing`).
- The link is watched and made again; a position that may be wrong doesn't count (`keeping`, `tended`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from drivers.generic.coordinates import apart_arcsec, check_kind
from drivers.generic.language import Language, Readout, Sent, Wanted
from drivers.generic.link_supervisor import LinkState
from drivers.generic.motions import Motions
from drivers.generic.options import Timing
from drivers.generic.refusals import Took
from drivers.generic.session import ConnectSettings, Listener, Session
from drivers.generic.syncing import sync
from drivers.wire.wire_log import WireLog
from mountnav.clock import pause, real_s
from mountnav.devices import (
    ConnectReport,
    Direction,
    Epoch,
    MountReading,
    PierSide,
    Skill,
    SlewOutcome,
    SlewState,
    SyncResult,
    TrackingRate,
)
from mountnav.errors import BadRequest, Busy, DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent, Icrs, Site

LONGEST_PULSE_S = 60.0
_PULSE_LATE_S = 2.0
"""How much later than we count a pulse may end (s): a queue of orders at 9600 baud, a busy machine. Doubled,
a mount that says "guiding" for ever holds each pulse up for so much longer."""
_PULSE_LOOK_S = 0.05
"""Between two such questions (s): three exchanges at 9600 baud."""


class GenericMount:
    """A `mountnav.devices.Mount` that speaks some language; skilled, trusting, announcing.

    Parameters
    ----------
    language : Language
        What the family can say, with its link.
    name : str, optional
        For messages; the language's address by default.
    timing : Timing
    site : Site, optional
        Ours, to compare with the mount's.
    set_clock, set_site : bool
        Whether connecting sets the mount's clock and site to ours.
    trust_on_connect : bool
        Whether its position counts at the first connecting, unless it shows that it was just switched on.
    swap_sides : bool, optional
        It tells the other side of the pier than the one on which the tube hangs; None: nobody has looked.
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
        self._tended = Session(language, self._name, self._timing, connecting)
        self._mover = Motions(self._tended)
        self._refusals = self._mover.refusals

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
        """Whether somebody has looked where the tube hangs, and said so in the settings."""
        return self._tended.sides_stated

    @property
    def resolution_arcsec(self) -> float:
        """Coarsest step of a commanded or reported place."""
        return self.language.resolution_arcsec

    @property
    def skills(self) -> frozenset[Skill]:
        """What it can do besides, known after `open`."""
        return self.language.skills

    @property
    def tracking_rates(self) -> frozenset[TrackingRate]:
        """At which rates it can be told to follow, known after `open`."""
        return self.language.tracking_rates

    @property
    def guide_rates_deg_s(self) -> tuple[float, float] | None:
        """How fast a pulse moves in right ascension and in declination; None where it doesn't tell."""
        return self.language.guide_rates_deg_s

    @property
    def wire_log(self) -> WireLog:
        """All that went over its wire lately."""
        return self.language.log

    @property
    def link(self) -> LinkState:
        """What is known of the link."""
        return self._tended.keeper.state

    @property
    def report(self) -> ConnectReport | None:
        """What the last connecting found."""
        return self._tended.report

    @property
    def slew_state(self) -> SlewState:
        """What the last order to move has come to."""
        return self._tended.state

    @property
    def trusted(self) -> bool:
        """Whether its own position counts."""
        return self._tended.trusted

    def trust(self) -> None:
        """An operator's word that the position is right."""
        self._tended.trust("the operator says so")

    async def compare(self) -> ConnectReport:
        """Ask for its clock and site again, and compare them with ours. Raises `DeviceError`."""
        return await self._tended.compare()

    async def set_site_and_time(self) -> ConnectReport:
        """Set its site and clock to ours, as far as it takes them. Raises `DeviceRefused`, `DeviceError`."""
        return await self._tended.set_site_and_time()

    def listen(self, listener: Listener) -> None:
        """Tell `listener(what, facts)` of what happens to the link and to the position."""
        self._tended.listeners.append(listener)

    async def open(self) -> None:
        """Connect, find out who is there, read the state and compare clock, site and epoch with ours.

        Moves and syncs nothing; sets the clock or the site only if the configuration says so.

        Raises
        ------
        DeviceMissing
            If there is no such port or link.
        DeviceSilent, DeviceGarbled
            If nothing on it speaks the language.
        """
        await self._tended.open()

    async def close(self) -> None:
        """Release the link; closing twice is fine."""
        await self._tended.close()

    async def reading(self) -> MountReading:
        """Where the mount believes it points; asked again until it can be believed.

        Raises
        ------
        DeviceSilent, DeviceGarbled, DeviceMissing
            If there is no answer, none that makes sense, or no link.
        """
        await self._tended.ready()
        return (await self._tended.look()).reading

    # -- orders ------------------------------------------------------------------------------------

    async def slew(self, place: Apparent | Icrs) -> SlewOutcome:
        """Go to a place in the mount's own coordinates; return when at rest.

        Parameters
        ----------
        place : Apparent or Icrs
            Of the kind that `epoch` says.

        Returns
        -------
        SlewOutcome
            ``ARRIVED`` only when at rest within `Timing.near_arcsec` (or two steps of the wire) of the place.

        Raises
        ------
        BadRequest
            If the place is of the other kind.
        Busy
            If another order to move runs.
        DeviceRefused
            When it says no, is parked, or its position can't be trusted; nothing moves.
        RefusedButDone
            When it said no and moved all the same; it was stopped.
        DeviceSilent, DeviceGarbled, DeviceMissing
            If the mount can't be followed any more; a stop was sent.
        """
        check_kind(place, self.epoch, device=self._name)
        tended = self._tended

        def there(now: Readout) -> bool:
            return apart_arcsec(now.place, place) <= tended.near_arcsec()

        async def send(wanted: Wanted) -> Sent:
            return await self.language.send_slew(place, wanted)

        async with self._mover.job("slew") as stops:
            before = await tended.look()
            tended.require_trust("the slew")
            if before.parked:
                raise DeviceRefused(
                    "the slew refused: it is parked",
                    device=self._name,
                    advice="unpark it first",
                    reason=Refusal.PARKED,
                )
            return await self._mover.ordered(send, there, stops=stops, before=before, towards=place)

    async def stop(self) -> None:
        """Stop all motion: at once, past every other exchange, and again until the mount is seen at rest.

        Raises
        ------
        DeviceRefused
            If it still moves after `Timing.stop_timeout_s`.
        DeviceSilent, DeviceGarbled, DeviceMissing
            If the stop can't be sent, or was sent and the mount can't be read.
        """
        await self._mover.stop()

    async def sync(self, place: Apparent | Icrs) -> SyncResult:
        """Tell the mount that it points at a place in its own coordinates, once, and read back.

        Parameters
        ----------
        place : Apparent or Icrs
            Of the kind that `epoch` says.

        Returns
        -------
        SyncResult
            Seen (also late), accepted and ignored, or another place taken. A sync that was seen makes the
            position count; after one that took another place it counts no more.

        Raises
        ------
        BadRequest
            If the place is of the other kind.
        Busy
            If an order to move runs.
        DeviceRefused
            When it says no, or slews.
        RefusedButDone
            When it said no, and believes something else since.
        DeviceSilent, DeviceGarbled
            If its answer was lost and the readings don't show it.
        """
        check_kind(place, self.epoch, device=self._name)
        return await sync(self._tended, self._refusals, place)

    # -- park, home, tracking, guiding -------------------------------------------------------------

    async def park(self) -> SlewOutcome:
        """Go to its park position and stay; return when it says it is parked, or rests if it can't say.

        Raises
        ------
        DeviceRefused
            If it can't park, says no, or its position can't be trusted.
        Busy, DeviceSilent, DeviceGarbled, DeviceMissing
            As of a slew.
        """
        self._require_skill(Skill.PARK)
        async with self._mover.job("parking") as stops:
            before = await self._tended.look()
            self._tended.require_trust("parking")
            if before.parked:
                self._tended.state = SlewState.ARRIVED
                return SlewOutcome.ARRIVED
            return await self._mover.ordered(
                self.language.send_park, lambda now: now.parked, stops=stops, before=before
            )

    async def unpark(self) -> None:
        """Be ready to move again; return when it says so.

        Raises
        ------
        DeviceRefused
            If it can't, says no, or goes on saying it is parked.
        RefusedButDone
            If it said no and did it.
        """
        self._require_skill(Skill.UNPARK)
        await self._told("unparking", self.language.send_unpark, lambda now: _not(now.parked))
        await self._until(lambda now: not now.parked, "unparking")

    async def set_park(self) -> None:
        """Take the present place for the park position. Raises `DeviceRefused`."""
        self._require_skill(Skill.SET_PARK)
        await self._told("setting the park position", self.language.send_set_park)

    async def home(self) -> SlewOutcome:
        """Go to its home, or find it by its sensors if it has some: then its position counts again.

        Raises
        ------
        DeviceRefused
            If it has none, says no, or would go there by a position that can't be trusted.
        Busy, DeviceSilent, DeviceGarbled, DeviceMissing
            As of a slew.
        """
        self._require_skill(Skill.HOME)
        finds = Skill.FIND_HOME in self.skills
        async with self._mover.job("homing") as stops:
            before = await self._tended.look()
            if not finds:
                self._tended.require_trust("going home")
            outcome = await self._mover.ordered(
                self.language.send_home, lambda now: now.at_home, stops=stops, before=before
            )
            found = finds and outcome is SlewOutcome.ARRIVED and (await self._tended.look()).at_home
            if found and not self._tended.silent_on_its_way:
                self._tended.trust("it has found its home")
            return outcome

    async def set_tracking(self, on: bool, rate: TrackingRate = TrackingRate.SIDEREAL) -> None:
        """Follow the sky, or rest; return when the mount says so.

        Raises
        ------
        DeviceRefused
            If it can't, says no, or says yes and does otherwise.
        RefusedButDone
            If it said no and did it; tracking that was begun so is ended.
        """
        if not on or Skill.TRACKING_RATES not in self.skills:
            self._require_skill(Skill.TRACK)
        if rate is not TrackingRate.SIDEREAL:
            self._require_skill(Skill.TRACKING_RATES)

        async def rest() -> None:
            async with self._tended.ordering:
                await self.language.send_tracking(False, TrackingRate.SIDEREAL)

        await self._told(
            "switching tracking",
            lambda: self.language.send_tracking(on, rate),
            lambda now: now.tracking if on else _not(now.tracking),
            undo=rest if on else None,
        )
        await self._until(lambda now: now.tracking is None or now.tracking is on, "switching tracking")

    async def guide(self, direction: Direction, duration_s: float) -> None:
        """Move at the guide rate for a moment; return when that is over.

        Raises
        ------
        BadRequest
            If the duration is none.
        DeviceRefused
            If it can't, or says no.
        """
        self._require_skill(Skill.GUIDE)
        if not 0.0 < duration_s <= LONGEST_PULSE_S:
            raise BadRequest(
                f"a guide pulse of {duration_s} s",
                device=self._name,
                advice=f"above 0, at most {LONGEST_PULSE_S:g}",
            )
        self._require_no_job()
        await self._tended.ready()
        before = await self._refusals.before()
        stops, loop = self._tended.stops, asyncio.get_running_loop()
        began = loop.time()
        async with self._refusals.seen_to("the guide pulse", before):
            # two axes may be guided at once, but no slew may begin: the end of a pulse would halt it
            self._tended.pulses += 1
            try:
                sent = await self.language.send_guide(
                    direction, duration_s, lambda: self._tended.stops == stops
                )
                if sent.lost is not None:
                    raise sent.lost
                await asyncio.sleep(max(0.0, began + real_s(duration_s) - loop.time()))
                await self._pulse_over()
            finally:
                self._tended.pulses -= 1

    async def _pulse_over(self) -> None:
        """Wait until the mount says so, where it can: it counts from when it took the order up, not we.

        One that says "guiding" for longer is left to say so: the next order that can't be is refused by it.
        """
        loop = asyncio.get_running_loop()
        until = loop.time() + real_s(_PULSE_LATE_S)
        while await self.language.guiding() and loop.time() < until:
            await pause(_PULSE_LOOK_S)

    async def destination_side(self, place: Apparent | Icrs) -> PierSide | None:
        """On which side of the pier it would look at a place; None if it can't tell."""
        check_kind(place, self.epoch, device=self._name)
        await self._tended.ready()
        # some have to be given the place as the target first
        async with self._tended.ordering:
            return self._tended.side(await self.language.destination_side(place))

    async def _told(
        self,
        order: str,
        send: Callable[[], Awaitable[None]],
        took: Took | None = None,
        *,
        undo: Callable[[], Awaitable[None]] | None = None,
    ) -> None:
        """Give an order that ends by itself."""
        self._require_no_job()
        await self._tended.ready()
        before = await self._refusals.before()
        async with self._refusals.seen_to(order, before, took=took, undo=undo), self._tended.ordering:
            await send()

    def _require_no_job(self) -> None:
        if self._tended.job is not None:
            raise Busy(
                f"a {self._tended.job} is running", device=self._name, advice="wait for it, or stop it"
            )

    def _require_skill(self, skill: Skill) -> None:
        if skill not in self.skills:
            raise DeviceRefused(
                f"it can't: {skill.replace('-', ' ')}", device=self._name, reason=Refusal.UNSUPPORTED
            )

    async def _until(self, true: Callable[[Readout], bool], what: str) -> None:
        loop = asyncio.get_running_loop()
        until = loop.time() + self._timing.start_grace_s + self._timing.poll_s
        while not true(await self._tended.look()):
            if loop.time() > until:
                raise DeviceRefused(f"accepted {what} and didn't do it", device=self._name)
            await pause(min(0.2, self._timing.poll_s))


def _not(said: bool | None) -> bool | None:
    """The contrary of what a mount says; None where it can't tell."""
    return None if said is None else not said
