"""INDI clients' orders, given to the dispatcher, and what each came to in INDI's words.

A short order is answered at its end, a long one when it is under way: `follow` is given its job.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from datetime import datetime

from api.access.callers import Caller
from api.indi_server.life import ClientLife
from api.indi_server.properties import COORDINATES, MOTIONS, PULSES, SPEEDS
from api.indi_server.vectors import Vector
from api.orders.goto_orders import GotoOrders
from api.orders.job import Job
from api.orders.kept_motions import KeptAxes, KeptRates, ladder
from api.orders.targets import ApparentTarget
from api.orders.vocabulary import GuideOrder, HomeOrder, ParkOrder, SetParkOrder, TrackingOrder, UnparkOrder
from api.orders.watching import Watch
from drivers.indi.codec.messages import Ordered, State
from mountnav.clock import utc_now
from mountnav.devices import STARS_RATES, OffsetRates
from mountnav.mount import CheckedMount
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S, Apparent, Site

__all__ = ["Answer", "IndiOrders", "chosen_switch", "number_of", "site_answer", "time_answer"]


_SAME_TIME_S = 5.0
"""A client's clock this near to ours counts as the same, s: some send whole seconds, late. Doubled, a wrong
clock of 10 s is not reported to its user."""
_SAME_PLACE_DEG = 0.02
"""A client's site this near to ours counts as the same, deg: 2 km; chosen by hand. Doubled, 4 km off goes
without a word."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What an order came to, for the client that gave it.

    Attributes
    ----------
    name : str
        The property.
    state : State or None
        Instead of the property's own; None: as it is now.
    """

    name: str
    state: State | None = None
    words: str = ""

    @classmethod
    def refused(cls, name: str, words: str) -> Answer:
        """It is not done, and why."""
        return cls(name, State.ALERT, f"[ERROR] {words}")


def chosen_switch(ordered: Ordered, shown: Vector) -> str | None:
    """The one switch that a client turns on; None if it turns none on.

    Raises
    ------
    ValueError
        More than one, or one that isn't there.
    """
    known = {member.name for member in shown.members}
    strange = sorted(set(ordered.values) - known)
    if strange:
        raise ValueError(f"{ordered.name} has no {', '.join(strange)}, but {', '.join(sorted(known))}")
    on = [name for name, value in ordered.values.items() if value is True]
    if len(on) > 1:
        raise ValueError(f"{ordered.name} takes one switch, not {', '.join(on)}")
    return on[0] if on else None


def number_of(ordered: Ordered, element: str) -> float:
    """A finite number of an order. Raises `ValueError`."""
    value = ordered.values.get(element)
    if not isinstance(value, float) or not math.isfinite(value):
        raise ValueError(f"{ordered.name} needs a number for {element}")
    return value


def site_answer(ordered: Ordered, site: Site) -> Answer:
    """Compare the site that a client tells with ours; it is never taken."""
    latitude_deg, longitude_deg = number_of(ordered, "LAT"), number_of(ordered, "LONG")
    off_deg = max(
        abs(latitude_deg - site.latitude_deg),
        abs((longitude_deg - site.longitude_deg + 180.0) % 360.0 - 180.0),
    )
    if off_deg <= _SAME_PLACE_DEG:
        return Answer(ordered.name, State.OK, "[INFO] the site is that of the service's settings")
    return Answer.refused(
        ordered.name,
        f"the site stays as in the service's settings (latitude {site.latitude_deg:.4f}°, longitude "
        f"{site.longitude_deg:.4f}° east): told {off_deg:.2f}° from there; which one is wrong?",
    )


def time_answer(ordered: Ordered, now: datetime) -> Answer:
    """Compare the time that a client tells with ours; it is never taken.

    Raises
    ------
    ValueError
        It is none.
    """
    told = datetime.fromisoformat(f"{str(ordered.values.get('UTC', '')).strip().rstrip('Z')}+00:00")
    off_s = (told - now).total_seconds()
    if abs(off_s) <= _SAME_TIME_S:
        return Answer(ordered.name, State.OK, "[INFO] the service's clock says so too")
    return Answer.refused(
        ordered.name,
        f"the service keeps its own machine's time: told {off_s:+.0f} s from it; which one is wrong?",
    )


class IndiOrders:
    """Takes the orders to one telescope.

    Parameters
    ----------
    mount : CheckedMount
        For what it is and can.
    axes : KeptAxes
        Moves what keys move.
    rates : KeptRates
        Keeps custom rates.
    follow : callable
        ``follow(job, name)``: a job is under way for an order to that property.

    Attributes
    ----------
    target : Apparent or None
        Where it was last sent.
    rate : str or None
        The tracking rate that was last ordered.
    speed : str
        What is chosen of TELESCOPE_SLEW_RATE.
    custom : OffsetRates
        The custom rates that were set last, for when that mode is chosen.
    here : dict
        The lives of the callers whose connections are open, by their names.
    """

    def __init__(
        self,
        ordering: GotoOrders,
        watch: Watch,
        mount: CheckedMount,
        *,
        axes: KeptAxes,
        rates: KeptRates,
        follow: Callable[[Job, str], None],
    ) -> None:
        self.target: Apparent | None = None
        self.rate: str | None = None
        self.speed = "SLEW_FIND"
        self.custom = STARS_RATES
        self.here: dict[str, ClientLife] = {}
        self._ordering = ordering
        self._watch = watch
        self._mount = mount
        self._site: Site = mount.site
        self._axes = axes
        self._rates = rates
        self._follow = follow

    async def take(self, caller: Caller, ordered: Ordered, shown: Vector, mode: str) -> Answer:
        """Carry an order out.

        Parameters
        ----------
        shown : Vector
            The property as it is.
        mode : str
            What this client has chosen of ON_COORD_SET.

        Raises
        ------
        NotTaken
        ValueError
            It makes no sense.
        """
        name = ordered.name
        if name == COORDINATES:
            return await self._pointed(caller, ordered, mode)
        if name in PULSES:
            return await self._pulse(caller, ordered)
        if name in MOTIONS:
            return await self._key(caller, ordered, shown)
        if name == "TELESCOPE_TRACK_RATE":
            return await self._track_rate(caller, ordered)
        if name == "GEOGRAPHIC_COORD":
            return site_answer(ordered, self._site)
        if name == "TIME_UTC":
            return time_answer(ordered, utc_now())
        give: dict[str, Callable[[Caller, str], Awaitable[Answer]]] = {
            "TELESCOPE_PARK": self._park,
            "TELESCOPE_PARK_OPTION": self._set_park,
            "TELESCOPE_TRACK_STATE": self._track,
            "TELESCOPE_TRACK_MODE": self._track_mode,
            "TELESCOPE_HOME": self._home,
            "TELESCOPE_SLEW_RATE": self._choose_speed,
        }
        if name not in give:
            return Answer.refused(name, f"{name} can only be read")
        chosen = chosen_switch(ordered, shown)
        return Answer(name) if chosen is None else await give[name](caller, chosen)

    async def _pointed(self, caller: Caller, ordered: Ordered, mode: str) -> Answer:
        ra_h, dec_deg = number_of(ordered, "RA"), number_of(ordered, "DEC")
        if not (0.0 <= ra_h <= 24.0 and abs(dec_deg) <= 90.0):
            return Answer.refused(COORDINATES, f"RA {ra_h:g} h, DEC {dec_deg:g}° is no place")
        target = ApparentTarget(ra_deg=(ra_h * 15.0) % 360.0, dec_deg=dec_deg)
        if mode == "SYNC":
            await self._ordering.sync(caller, target)
            return Answer(COORDINATES, words="[INFO] synced")
        job = await self._ordering.goto(caller, target)
        self.target = Apparent(target.ra_deg, target.dec_deg, utc_now())
        self._follow(job, COORDINATES)
        return Answer(COORDINATES)

    async def _park(self, caller: Caller, chosen: str) -> Answer:
        if chosen == "UNPARK":
            await self._ordering.short(caller, UnparkOrder())
        else:
            self._follow(await self._ordering.long(caller, ParkOrder()), "TELESCOPE_PARK")
        return Answer("TELESCOPE_PARK")

    async def _set_park(self, caller: Caller, chosen: str) -> Answer:
        await self._ordering.short(caller, SetParkOrder())
        return Answer("TELESCOPE_PARK_OPTION", State.OK, "[INFO] parks here from now on")

    async def _home(self, caller: Caller, chosen: str) -> Answer:
        self._follow(await self._ordering.long(caller, HomeOrder()), "TELESCOPE_HOME")
        return Answer("TELESCOPE_HOME")

    async def _track(self, caller: Caller, chosen: str) -> Answer:
        await self._tracking(caller, chosen == "TRACK_ON", self.rate or "sidereal")
        return Answer("TELESCOPE_TRACK_STATE")

    async def _track_mode(self, caller: Caller, chosen: str) -> Answer:
        rate = chosen.removeprefix("TRACK_").lower()
        if rate == "custom":
            return await self._custom(caller, "TELESCOPE_TRACK_MODE")
        if self._mount.offset_rates_in_force is not None:
            await self._rates.set(caller, STARS_RATES, lambda: None)
        reading = self._watch.latest.state.reading
        if reading is not None and reading.tracking:
            await self._tracking(caller, True, rate)
        # else it counts when tracking is switched on
        self.rate = rate
        return Answer("TELESCOPE_TRACK_MODE", State.OK)

    async def _tracking(self, caller: Caller, on: bool, rate: str) -> None:
        order = TrackingOrder.model_validate({"on": on, "rate": rate})
        await self._ordering.short(caller, order)

    async def _track_rate(self, caller: Caller, ordered: Ordered) -> Answer:
        """Whole rates; in force at once if that mode is, or when it is chosen, as INDI has it."""
        ra_arcsec_s, dec_arcsec_s = number_of(ordered, "TRACK_RATE_RA"), number_of(ordered, "TRACK_RATE_DE")
        wanted = OffsetRates(SIDEREAL_ARCSEC_S - ra_arcsec_s, dec_arcsec_s)
        most = self._mount.most_offset_arcsec_s
        if most is not None and (
            abs(wanted.ra_arcsec_s) > most.ra_arcsec_s or abs(wanted.dec_arcsec_s) > most.dec_arcsec_s
        ):
            return Answer.refused(
                ordered.name,
                f"the mount takes {most.ra_arcsec_s:g}″/s in RA and {most.dec_arcsec_s:g}″/s in Dec beside "
                f"the sidereal rate ({SIDEREAL_ARCSEC_S:.4f}″/s) at most",
            )
        self.custom = wanted
        if self._mount.offset_rates_in_force is None:
            return Answer(ordered.name, State.OK, "[INFO] in force when TRACK_CUSTOM is chosen")
        return await self._custom(caller, ordered.name)

    async def _custom(self, caller: Caller, name: str) -> Answer:
        if self.custom.none:
            return Answer.refused(name, "those are a star's rates: set TELESCOPE_TRACK_RATE before")

        def silent_s() -> float | None:
            life = self.here.get(caller.name)
            return None if life is None else life.silent_s()

        await self._rates.set(caller, self.custom, silent_s)
        force = self._mount.offset_rates_in_force
        until = (
            ""
            if force is None
            else f" until {force.ends_utc:%H:%M:%S} UTC, put off while this client is heard"
        )
        return Answer(name, State.OK, f"[INFO] custom rates{until}")

    async def _choose_speed(self, caller: Caller, chosen: str) -> Answer:
        self.speed = chosen
        return Answer("TELESCOPE_SLEW_RATE", State.OK)

    async def _key(self, caller: Caller, ordered: Ordered, shown: Vector) -> Answer:
        """Pressed: it moves. Released, or none pressed: it ends."""
        axis, sides = MOTIONS[ordered.name]
        chosen = chosen_switch(ordered, shown)
        if chosen is None:
            await self._axes.end(caller, axis)
            return Answer(ordered.name, State.IDLE)
        most_deg_s = self._mount.following_policy.most_axis_deg_s
        speeds = ladder(self._mount.axis_rates_deg_s.get(axis, ()), most_deg_s)
        if not speeds:
            return Answer.refused(ordered.name, "this axis can't be moved")
        speed_deg_s = speeds[list(SPEEDS).index(self.speed)]

        def lives() -> str | None:
            life = self.here.get(caller.name)
            return "its client has gone" if life is None else life.why_gone()

        await self._axes.move(caller, axis, sides[chosen] * speed_deg_s, lives)
        return Answer(ordered.name, State.BUSY)

    async def _pulse(self, caller: Caller, ordered: Ordered) -> Answer:
        elements = PULSES[ordered.name]
        lasting = {element: number_of(ordered, element) for element in elements if element in ordered.values}
        wanted = {one: ms for one, ms in lasting.items() if ms != 0.0}
        if not wanted:
            return Answer(ordered.name)
        if len(wanted) > 1:
            return Answer.refused(ordered.name, "a pulse has one direction")
        ((one, ms),) = wanted.items()
        if not 0.0 < ms <= 60_000.0:
            return Answer.refused(ordered.name, f"a pulse lasts 1 to 60000 ms, not {ms:g}")
        order = GuideOrder.model_validate({"direction": elements[one], "duration_s": ms / 1000.0})
        await self._ordering.short(caller, order)
        return Answer(ordered.name)
