"""What an LX200 shows of itself: who it is, where it looks, whether it was switched off and on.

It asks, and sets nothing but the forms of the answers; orders are `drivers.lx200.language`'s.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace

from drivers.generic.language import Identity, Readout
from drivers.lx200.codec import base
from drivers.lx200.codec.dialect import Dialect, Handshake, Pointing, State
from drivers.lx200.codec.greeting import recognized, weak
from drivers.lx200.exchange import Lx200Exchange
from drivers.wire.link import Link
from mountnav.clock import utc_now
from mountnav.devices import Epoch
from mountnav.errors import DeviceGarbled, DeviceRefused, DeviceSilent, Refusal
from mountnav.sky.coordinates import Apparent, Icrs

_SHORT_ARCSEC = 15.0
"""Right ascensions with a coarser step than this come in the short format."""
_NAMELESS = (
    "it tells no name, so it is given the few words that any clone has; if it knows more, name its dialect "
    "in the URL (?dialect=...)"
)


class Lx200Reader:
    """The questions of one link, in their order, and what their answers showed.

    Parameters
    ----------
    named : Dialect or None
        The dialect that was chosen for it; None to find it by its handshake.
    """

    def __init__(self, link: Link, named: Dialect | None) -> None:
        self._link = link
        self._named = named
        self.exchange = Lx200Exchange(link)
        """How it is asked."""
        self.dialect: Dialect | None = named
        self.step_arcsec = _SHORT_ARCSEC
        self.rests = False
        """Whether it was last seen neither tracking nor at its home."""
        self.guide_rate_deg_s: float | None = None
        """Of a pulse, as it said at opening."""
        self._known: Handshake | None = None
        self._troubles = 0
        self._look_for_power_up = True
        self._fresh = False
        self._boot: str | None = None
        self._starting = False
        self._parking: str | None = None

    @property
    def short(self) -> bool:
        """Whether it speaks the short format."""
        return self.step_arcsec > _SHORT_ARCSEC

    @property
    def ready(self) -> bool:
        """Whether it has finished starting up."""
        return self._boot is None

    def parking_ordered(self) -> None:
        """It was ordered to park: where it can't say so, it is parked when it has come to rest."""
        self._parking = "ordered"

    def parking_over(self) -> None:
        """It was ordered to move otherwise."""
        self._parking = None

    def clock_was_set(self) -> None:
        """What its clock showed of a power-up is gone."""
        self._fresh, self._look_for_power_up = False, True

    # -- who ---------------------------------------------------------------------------------------

    async def identify(self) -> Identity:
        """Find dialect and format; only a mount in the short format is asked to toggle it.

        Raises
        ------
        DeviceSilent, DeviceGarbled
            If it reports no place, or no greeting that can be believed.
        """
        self.exchange.has_letter = False
        self.exchange.refining.begin()
        handshake = await self._handshake()
        if handshake.product is None and self._known is not None:
            # it gave its name before: on a bad line that counts more than a silence now
            handshake = self._known
        dialect = self._named or await self._proven(handshake)
        if handshake.product is not None:
            self._known = handshake
        dialect = self.dialect = dialect.fitted(dialect, handshake)
        self._boot = dialect.boot(handshake)
        # what it was found starting up as counts once it is ready
        self._fresh, self._starting = self._starting, self._boot is not None
        self._parking, self.rests = None, False
        for order in dialect.prelude:
            await self.exchange(order)
        if self.ready:
            spot = await dialect.place(self.exchange)
            if spot.ra.step_arcsec > _SHORT_ARCSEC and dialect.toggle is not None:
                # it toggles: sent once, and only to a mount seen in the short format [LX200 :U#]
                await self.exchange(dialect.toggle)
                spot = await dialect.place(self.exchange)
            self.step_arcsec = spot.ra.step_arcsec
            dialect = self.dialect = await self._refined(dialect, spot)
        self._look_for_power_up = True
        named = " ".join(filter(None, (handshake.product, handshake.firmware)))
        text = f"{dialect.caption}: {named}" if named else dialect.caption
        problems = (self._boot,) if self._boot else self.exchange.refining.notes
        if self._named is None and dialect.name == "basic":
            problems = (_NAMELESS, *problems)
        return Identity(text, problems)

    async def _handshake(self) -> Handshake:
        """Ask what every dialect bears; clones may know one greeting, or none."""
        if self._named is not None and not self._named.greets:
            return Handshake()
        letter = await self.exchange.known(base.ALIGNMENT)
        self.exchange.has_letter = letter is not None
        product = await self.exchange.known(base.PRODUCT)
        firmware = await self.exchange.known(base.FIRMWARE) if product is not None else None
        return Handshake(
            None if letter is None else letter.letter, letter is not None and letter.ended, product, firmware
        )

    async def _proven(self, handshake: Handshake) -> Dialect:
        """The dialect that a handshake shows; one of the poor ones is believed when it shows twice."""
        dialect = recognized(handshake)
        if weak(dialect) and handshake not in (again := await self._handshake(), self._known):
            raise DeviceGarbled(
                f"its answers to the greeting contradict each other: {handshake}, then {again}",
                device=self._link.device,
                advice="check cable, speed (baud) and that nothing else talks to the mount",
            )
        return dialect

    async def _refined(self, dialect: Dialect, spot: Pointing) -> Dialect:
        """Ask all that the mount may lack, and leave out what it does lack."""
        lacks = self.exchange.refining.lacks
        dialect = dialect.without(dialect, lacks)
        if spot.state is None and dialect.state is not None:
            await dialect.state(self.exchange)
        for question in dialect.asked_sometimes:
            await self.exchange.known(question)
        if dialect.fresh is not None:
            await dialect.fresh(self.exchange)
        if dialect.offsets is not None and dialect.offsets.read is not None:
            await dialect.offsets.read(self.exchange)
        dialect = dialect.without(dialect, lacks)
        if dialect.read_guide_rate is not None:
            # one that doesn't say is guided all the same
            self.guide_rate_deg_s = await dialect.read_guide_rate(self.exchange)
        if dialect.read_clock is not None and await dialect.read_clock(self.exchange) is None:
            dialect = replace(dialect, read_clock=None)
        if dialect.read_site is not None and await dialect.read_site(self.exchange) is None:
            dialect = replace(dialect, read_site=None)
        return dialect

    # -- where -------------------------------------------------------------------------------------

    async def readout(self, epoch: Epoch) -> Readout:
        """Place, then state; evidence of a power-up is looked for after every trouble on the line.

        Raises
        ------
        DeviceRefused
            While it has not finished starting up.
        """
        if not self.ready:
            await self._see_whether_it_is_ready()
        assert self.dialect is not None
        troubles = self._link.troubles
        before = utc_now()
        spot = await self.dialect.place(self.exchange)
        span = utc_now() - before
        utc = before + span / 2
        state = await self._state_of(spot, self.dialect)
        self.rests = state.tracking is False and not state.at_home
        self.step_arcsec = spot.ra.step_arcsec
        doubtful = self._link.troubles != troubles
        fresh = state.fresh or await self._was_switched_on(self.dialect)
        ra_deg, dec_deg = spot.ra.deg, spot.dec.deg
        return Readout(
            place=Icrs(ra_deg, dec_deg) if epoch == "icrs" else Apparent(ra_deg, dec_deg, utc),
            utc=utc,
            span_s=span.total_seconds(),
            slewing=state.slewing,
            tracking=state.tracking,
            parked=self._parked(state, self.dialect),
            at_home=state.at_home,
            pier_side=state.pier_side,
            fresh=fresh,
            doubtful=doubtful,
        )

    async def _state_of(self, spot: Pointing, dialect: Dialect) -> State:
        if spot.state is not None:
            return spot.state
        return await dialect.state(self.exchange) if dialect.state else State()

    async def _see_whether_it_is_ready(self) -> None:
        assert self.dialect is not None
        boot = self.dialect.boot(await self._handshake())
        if boot is not None:
            raise DeviceRefused(boot, device=self._link.device, reason=Refusal.BUSY)
        self._boot = None
        self._fresh, self._starting = True, False
        # while it started up it answered little: nothing is missing for that
        self.exchange.refining.begin()

    async def _was_switched_on(self, dialect: Dialect) -> bool:
        if self._link.troubles != self._troubles:
            self._look_for_power_up = True
        # once found it is asked every time: a sync, or a clock that was set, ends some evidence
        if dialect.fresh is not None and (self._look_for_power_up or self._fresh):
            # a mount that doesn't know the question gives no evidence
            with contextlib.suppress(DeviceSilent, DeviceGarbled):
                self._fresh = await dialect.fresh(self.exchange)
            self._look_for_power_up = False
        self._troubles = self._link.troubles
        return self._fresh

    def _parked(self, state: State, dialect: Dialect) -> bool | None:
        if not dialect.parks_unread:
            return state.parked
        if self._parking == "ordered" and state.slewing:
            self._parking = "under way"
        elif self._parking == "under way" and state.slewing is False:
            self._parking = "parked"
        return {"under way": False, "parked": True}.get(self._parking or "")
