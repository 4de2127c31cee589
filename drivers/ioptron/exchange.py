"""How an iOptron mount is asked and ordered, and what we compute for one that does not say it.

A bare `1` says nothing of its question, and each stop is answered by one. So every order is preceded by a
question whose answer is a text: when that has come, no older `1` is on its way.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import TypeVar

from drivers.generic.serial_language import OptionalQuestions
from drivers.ioptron.codec import v3
from drivers.ioptron.codec.dialect import CommandSet
from drivers.ioptron.codec.greeting import GREETING, Model
from drivers.ioptron.codec.values import MountState, Status
from drivers.wire.command import Command
from drivers.wire.link import Link
from mountnav.clock import utc_now
from mountnav.devices import PierSide
from mountnav.errors import DeviceError, DeviceGarbled, DeviceRefused, DeviceSilent, Refusal
from mountnav.sky.chain import apparent_to_hour_angle, hour_angle_to_observed, icrs_to_apparent
from mountnav.sky.coordinates import Apparent, GeometricHourAngle, HourAngle, Icrs, Site

T = TypeVar("T")


class IoptronExchange:
    """A link, and the words that are spoken on it.

    Parameters
    ----------
    model : Model
        Who answers; `words` and `model` are put right by the greeting.
    """

    def __init__(self, link: Link, words: CommandSet, model: Model) -> None:
        self.link = link
        self.words = words
        self.model = model
        self.refining = OptionalQuestions(link, self._alive)

    async def ask(self, command: Command[T]) -> T:
        """Ask, or order once; raises as `Link.ask` does."""
        return await self.link.ask(command)

    async def known(self, command: Command[T]) -> T | None:
        """Ask what it may lack; None where it does. See `OptionalQuestions.known`."""
        return await self.refining.known(command)

    async def _alive(self) -> None:
        await self.link.ask(GREETING)

    async def settled(self, what: str, *, moves: bool = True) -> Status:
        """Ask for a text, so that no older `1` is on its way; refuse what a parked mount can't do.

        Raises
        ------
        DeviceRefused
            If it is parked, and the order is none for a parked mount.
        """
        status = await self.link.ask(self.words.status)
        if moves and status.state is MountState.PARKED:
            raise self.no(f"{what} refused: it is parked", Refusal.PARKED, "unpark it first")
        return status

    async def told(self, command: Command[bool]) -> tuple[bool | None, DeviceError | None]:
        """Send an order once; its answer, or why there is none."""
        try:
            return await self.link.ask(command), None
        except (DeviceSilent, DeviceGarbled) as failure:
            return None, failure

    async def obeyed(self, command: Command[bool], what: str | None = None) -> None:
        """Order what must be done. Raises `DeviceRefused` when the answer is 0."""
        if not await self.link.ask(command):
            raise self.no(f"refused {what or command.meaning}: 0", Refusal.OTHER)

    def no(self, what: str, reason: Refusal, advice: str | None = None) -> DeviceRefused:
        """Make a refusal."""
        return DeviceRefused(what, device=self.link.device, advice=advice, reason=reason)


def site_of(status: Status) -> Site:
    """Where it believes to stand."""
    return Site(status.latitude_deg, status.longitude_deg)


_NEAR_MERIDIAN_DEG = 1.0
"""So near to the hour angle where it flips the side after a slew is not foretold. Chosen by hand: what the
sky turns in four minutes, more than a slew takes."""


async def why_not(exchange: IoptronExchange, place: Apparent | Icrs, status: Status) -> DeviceRefused:
    """Tell why a slew was answered 0, as far as its altitude limit does [IOPTRON310 :MS1# :GAL#]."""
    limit_deg = await exchange.known(v3.ALTITUDE_LIMIT)
    site = site_of(status)
    angle = _hour_angle(place, site)
    seen = hour_angle_to_observed(HourAngle(angle.ha_deg, angle.dec_deg, angle.utc), site)
    if limit_deg is not None and seen.alt_deg < limit_deg:
        return exchange.no(
            f"refused the slew: the place is {seen.alt_deg:.1f}° high, its limit is {limit_deg}°",
            Refusal.BELOW_HORIZON,
            "wait until it has risen, or lower the mount's altitude limit",
        )
    return exchange.no(
        "refused the slew: 0", Refusal.LIMIT, "below its altitude limit, or beyond a mechanical one"
    )


async def destination_side(
    exchange: IoptronExchange, place: Apparent | Icrs, flips_past_deg: float
) -> PierSide | None:
    """On which side `:MS1#` ends: its normal posture looks west from the east side.

    None near the meridian, where it depends on what it does there and where it comes from.
    """
    ha_deg = _hour_angle(place, site_of(await exchange.ask(exchange.words.status))).ha_deg
    near_deg = flips_past_deg + _NEAR_MERIDIAN_DEG
    if not near_deg < abs(ha_deg) < 180.0 - near_deg:
        return None
    return PierSide.EAST if ha_deg > 0.0 else PierSide.WEST


def _hour_angle(place: Apparent | Icrs, site: Site) -> GeometricHourAngle:
    """Hour angle now, as a mount computes it that knows no refraction."""
    if isinstance(place, Icrs):
        place = icrs_to_apparent(place, utc_now())
    return apparent_to_hour_angle(Apparent(place.ra_deg, place.dec_deg, utc_now()), site)


async def read_clock(exchange: IoptronExchange) -> datetime | None:
    """Its clock, aware UTC, corrected for the way; None where it reports none.

    The v2 set has local time, zone and summer time apart: converted.
    """
    before = utc_now()
    clock = await exchange.known(exchange.words.clock)
    if clock is None:
        return None
    way = (utc_now() - before) / 2
    return clock.utc + timedelta(seconds=0.5 * exchange.words.clock_step_s) + way


async def write_clock(exchange: IoptronExchange, utc: datetime) -> None:
    """Set its clock; with the v2 set its zone as well, to UTC. Raises `DeviceRefused`."""
    ahead = utc - utc_now()
    await exchange.settled("setting the clock", moves=False)
    for command in exchange.words.before_clock:
        await exchange.obeyed(command)
    for command in exchange.words.set_clock(utc_now() + ahead):
        await exchange.obeyed(command)


async def write_site(exchange: IoptronExchange, site: Site) -> None:
    """Tell it where it stands, and on which hemisphere. Raises `DeviceRefused`."""
    await exchange.settled("setting the site", moves=False)
    longitude_deg = (site.longitude_deg + 180.0) % 360.0 - 180.0
    for command in exchange.words.set_site(site.latitude_deg, longitude_deg):
        await exchange.obeyed(command)
