"""Tracking at rates beside the sidereal one: ordered once, read back, ended before anything else moves.

Which rates a mount has after an order is known when it says so. One that can't say is taken at its word. An
answer that was lost is made good by reading back, or the rates are unknown, and that is raised. A mount that
refuses and takes them all the same is found out: by what it says, or by its drift as far as readings show it.

Whether the mount truly moves as it says only the sky tells; that is looked for above (`mountnav.navigation`).
"""

from __future__ import annotations

import asyncio
import contextlib
import math

from drivers.generic.language import Readout
from drivers.generic.one_axis import refuse_lame_axis
from drivers.generic.refusal_words import parked, rates_text
from drivers.generic.refusals import Refusals
from drivers.generic.session import Session
from mountnav.clock import pause
from mountnav.devices import STARS_RATES, OffsetRates, Skill, offset_speed_arcsec_s
from mountnav.errors import (
    BadRequest,
    DeviceError,
    DeviceGarbled,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
    Refusal,
)

_AS_ORDERED = 1e-3
"""Share by which a rate that is read back may differ from the one ordered, besides a step of the protocol:
decimal digits that were cut. Chosen: 1″/s that is off by so much misses its target by 4″ in an hour. Doubled,
by 7″; halved, protocols with four digits fail."""
_LEAST_ARCSEC_S = 5e-4
"""″/s by which a rate may always differ: 1.8″ in an hour. Chosen by hand: the fourth decimal. Doubled, a slow
comet (0.01″/s) may be off by a tenth; halved, conversions through float32 fail."""

_SHOWS = 2.0
"""A drift shows when it is so many times what readings may wander: once more than what is looked for.
Doubled, more refusals leave the rates unknown."""


class Rates:
    """Orders one mount to track at rates beside the sidereal one."""

    def __init__(self, session: Session, refusals: Refusals) -> None:
        self._session = session
        self._refusals = refusals
        self._one = asyncio.Lock()
        """Held by one order for all of its time: the read-back of one must not see the next."""

    async def order(self, rates: OffsetRates) -> None:
        """Track at these rates; see `GenericMount.set_offset_rates`."""
        self._check(rates)
        self._session.require_no_job()
        stops, links = self._session.stops, self._session.links
        await self._session.ready()
        if self._session.links != links:
            # it was opened anew: the rates of an order that is old now may not be wanted any more
            links = self._session.links
        async with self._one:
            await self._order(rates, stops, links)

    def _check(self, rates: OffsetRates) -> None:
        session = self._session
        most = session.language.most_offset_arcsec_s
        both = (
            ("right ascension", rates.ra_arcsec_s, None if most is None else most.ra_arcsec_s),
            ("declination", rates.dec_arcsec_s, None if most is None else most.dec_arcsec_s),
        )
        for axis, rate, most_arcsec_s in both:
            if not math.isfinite(rate):
                raise BadRequest(
                    f"an offset rate of {rate}″/s in {axis}", device=session.name, advice="a finite number"
                )
            if most is not None:
                refuse_lame_axis(rates, most, "", device=session.name)
            if most_arcsec_s is not None and abs(rate) > most_arcsec_s:
                raise DeviceRefused(
                    f"can't track at {rate:+.4f}″/s in {axis}: it takes at most {most_arcsec_s:.4f}″/s",
                    device=session.name,
                    advice="choose a slower target, or one that is further from the pole",
                    reason=Refusal.LIMIT,
                )

    async def _order(self, rates: OffsetRates, stops: int, links: int) -> None:
        session, drift = self._session, self._session.drift
        before = await self._refusals.before_at_rest()
        had = drift.known
        if not rates.none:
            session.require_trust("tracking at offset rates")
            if before.parked:
                raise parked("tracking at offset rates", device=session.name)
            # some say that they slew as long as they track at rates of their own
            if before.slewing and not drift.may:
                raise DeviceRefused(
                    "can't track at offset rates: it slews", device=session.name, reason=Refusal.BUSY
                )
            if before.tracking is False:
                raise DeviceRefused(
                    "can't track at offset rates: it doesn't track",
                    device=session.name,
                    advice="switch tracking on first",
                    reason=Refusal.NOT_TRACKING,
                )

        async def took() -> bool:
            told = await session.told_rates()
            if told is None or told.none:
                return False
            return self._same(told, rates) if had is None else not self._same(told, had)

        async def end() -> None:
            await end_rates(session, begins_tracking=True)

        lost: DeviceError | None = None
        went_out = False
        try:
            async with (
                self._refusals.checked("the offset rates", before, undo=end, ask=took),
                session.ordering,
            ):
                unmoved = session.job is None and not session.axes
                if session.stops == stops and session.links == links and unmoved:
                    drift.going_out(rates)
                    went_out = True
                    await session.language.send_offset_rates(rates)
        except DeviceRefused:
            # as far as it can be seen it tracks as before
            if drift.known is None and had is not None and await self._seen(rates, had, before):
                drift.settled(had)
            raise
        except (DeviceSilent, DeviceGarbled) as failure:
            lost = failure
        if not went_out:
            session.require_no_job()
        self._require_wanted(stops, links, "was overtaken" if went_out else "was not sent")
        await self._read_back(rates, stops, links, lost)

    async def _seen(self, rates: OffsetRates, had: OffsetRates, before: Readout) -> bool:
        """Whether a mount that refused rates is known to have those from before."""
        session = self._session
        with contextlib.suppress(DeviceError):
            told = await session.told_rates()
            if told is not None:
                return self._same(told, had)
        # it can't say: what would have shown within the time for which refusals are watched did not
        free_arcsec = session.timing.resting_free_arcsec(session.language.resolution_arcsec)
        change = OffsetRates(rates.ra_arcsec_s - had.ra_arcsec_s, rates.dec_arcsec_s - had.dec_arcsec_s)
        speed_arcsec_s = offset_speed_arcsec_s(change, before.place.dec_deg)
        return speed_arcsec_s * session.timing.start_grace_s > _SHOWS * free_arcsec

    def _require_wanted(self, stops: int, links: int, what: str) -> None:
        session = self._session
        if session.links != links:
            session.drift.unknown()
            raise DeviceMissing(
                "its link was lost: at which rates it tracks is not known",
                device=session.name,
                advice="look at the sky",
            )
        if session.stops != stops:
            raise DeviceRefused(
                f"the order to track at offset rates {what}: a stop came", device=session.name
            )

    async def _read_back(self, rates: OffsetRates, stops: int, links: int, lost: DeviceError | None) -> None:
        session, drift = self._session, self._session.drift
        loop = asyncio.get_running_loop()
        until = loop.time() + session.timing.start_grace_s + session.timing.poll_s
        while True:
            try:
                told = await session.told_rates()
            except DeviceError as trouble:
                drift.unknown()
                raise _unknown(lost or trouble, session) from trouble
            self._require_wanted(stops, links, "was overtaken")
            if told is None:
                if lost is not None:
                    drift.unknown()
                    raise _unknown(lost, session) from lost
                drift.settled(rates if rates.none else session.language.rounded_rates(rates))
                return
            if self._same(told, rates):
                drift.settled(told)
                return
            if loop.time() > until:
                break
            await pause(session.timing.soon_s)
        drift.settled(told)
        drift.ours = not told.none
        if lost is not None:
            raise type(lost)(
                f"{lost.what}; asked for its offset rates it says {rates_text(told)}, not what was ordered",
                device=session.name,
                advice=lost.advice,
            ) from lost
        said = f"accepted offset rates of {rates_text(rates)}, and says that it has {rates_text(told)}"
        if not told.none:
            try:
                await end_rates(session, begins_tracking=True)
                said = f"{said}; they were ended"
            except DeviceError as trouble:
                said = f"{said}; and they could not be ended: {trouble.what}"
        raise DeviceRefused(
            said, device=session.name, advice="its driver or firmware takes other rates or other units"
        )

    def _same(self, told: OffsetRates, ordered: OffsetRates) -> bool:
        return same_rates(told, ordered, self._session.language.offset_step_arcsec_s)


def same_rates(told: OffsetRates, ordered: OffsetRates, step_arcsec_s: float) -> bool:
    """Whether rates that were read back are those ordered, within what the protocol rounds."""

    def same(one: float, other: float) -> bool:
        return abs(one - other) <= max(step_arcsec_s, _LEAST_ARCSEC_S) + _AS_ORDERED * abs(other)

    return same(told.ra_arcsec_s, ordered.ra_arcsec_s) and same(told.dec_arcsec_s, ordered.dec_arcsec_s)


async def said_rates(session: Session) -> OffsetRates | None:
    """Ask it at which offset rates it tracks, and keep what it says; None where it doesn't say."""
    told = await session.told_rates()
    if told is not None and session.job is None:
        session.drift.settled(told)
    return told


async def end_rates(session: Session, *, begins_tracking: bool) -> None:
    """End the rates that may be in force, and read back. Does nothing where there are none.

    Parameters
    ----------
    begins_tracking : bool
        Whether a mount that rests may be told, too: some begin to track when they are told a star's rates.
        One that is not told keeps nothing in force, and is told before it moves again.

    Raises
    ------
    DeviceRefused
        If it says no, or goes on saying that it has some.
    DeviceSilent, DeviceGarbled, DeviceMissing
        If it can't be told, or whether it ended them isn't known.
    """
    drift = session.drift
    if not drift.to_end or Skill.OFFSET_RATES not in session.language.skills:
        return
    if not begins_tracking:
        now = await session.read()
        if now.tracking is False or now.parked:
            drift.unknown()
            return
    loop = asyncio.get_running_loop()
    until = loop.time() + session.timing.start_grace_s + session.timing.poll_s
    async with session.ordering:
        drift.going_out(STARS_RATES)
        try:
            await session.language.send_offset_rates(STARS_RATES)
        except (DeviceSilent, DeviceGarbled):
            told = await session.told_rates()
            if told is None or not told.none:
                raise
    while True:
        told = await session.told_rates()
        if told is None or same_rates(told, STARS_RATES, session.language.offset_step_arcsec_s):
            drift.settled(STARS_RATES)
            return
        if loop.time() > until:
            break
        await pause(session.timing.soon_s)
    drift.settled(told)
    drift.ours = True
    raise DeviceRefused(
        f"was told to track at the sidereal rate, and says that it has offset rates of {rates_text(told)}",
        device=session.name,
        advice="switch its tracking off and on, or restart its driver",
    )


def _unknown(failure: DeviceError, session: Session) -> DeviceError:
    kind = (
        type(failure) if isinstance(failure, (DeviceSilent, DeviceGarbled, DeviceMissing)) else DeviceSilent
    )
    return kind(
        f"{failure.what}: at which offset rates it tracks is not known",
        device=session.name,
        advice="stop it, or look at the sky",
    )
