"""What every step of a trial needs: the mount, where it stands, and places it can be sent to."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable
from dataclasses import dataclass

from drivers.acceptance.report import Finding
from drivers.generic.coordinates import apart_arcsec
from drivers.generic.mount import GenericMount
from mountnav.clock import utc_now
from mountnav.devices import SlewOutcome, for_mount, from_mount
from mountnav.errors import DeviceError, DeviceRefused, MountnavError
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_hour_angle, icrs_to_observed
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Icrs, Site
from mountnav.sky.sphere import displaced

REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Trial:
    """A mount on trial.

    Attributes
    ----------
    mount : GenericMount
        Opened.
    site, air : Site, Air
        Where it stands.
    lowest_altitude_deg : float
        No step but the one about limits goes lower.
    watch_s : float
        How long a tracking mount is watched.
    """

    mount: GenericMount
    site: Site
    air: Air
    lowest_altitude_deg: float = 20.0
    watch_s: float = 30.0

    async def place(self) -> Apparent | Icrs:
        """Where it says it points."""
        return (await self.mount.reading()).place

    def altitude_deg(self, place: Apparent | Icrs) -> float:
        """Of a place, now."""
        return icrs_to_observed(from_mount(place), utc_now(), self.site, self.air).alt_deg

    def hour_angle_deg(self, place: Apparent | Icrs) -> float:
        """Of a place, now."""
        return icrs_to_hour_angle(from_mount(place), utc_now(), self.site, self.air).ha_deg

    def at_hour_angle(self, ha_deg: float, dec_deg: float) -> Apparent | Icrs:
        """The place that stands at an hour angle now, in the mount's own coordinates."""
        now = utc_now()
        icrs = hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, now), self.site, self.air)
        return for_mount(icrs, self.mount.epoch, now)

    def beside(self, place: Apparent | Icrs, east_deg: float, north_deg: float) -> Apparent | Icrs:
        """A place that far from another, on the sphere."""
        moved = displaced(from_mount(place), east_deg * 3600.0, north_deg * 3600.0)
        return for_mount(moved, self.mount.epoch, utc_now())

    async def go(self, key: str, place: Apparent | Icrs, *, wanted: str = "arrived") -> list[Finding]:
        """Slew somewhere, and tell how it ended, how far off, and how long it took.

        Parameters
        ----------
        key : str
            Of the findings.
        place : Apparent or Icrs
        wanted : str
            How it should end.
        """
        began = time.monotonic()
        outcome, words = await self.outcome(self.mount.slew(place))
        took_s = time.monotonic() - began
        findings = [Finding(key, outcome, fine=outcome == wanted, words=words)]
        if outcome == SlewOutcome.ARRIVED:
            miss_arcsec = apart_arcsec(await self.place(), place)
            findings.append(Finding(f"{key}.miss", miss_arcsec, "arcsec"))
            findings.append(Finding(f"{key}.time", took_s, "s"))
        return findings

    async def outcome(self, order: Awaitable[object]) -> tuple[str, str]:
        """Carry out an order, and tell in a word how it ended; a refusal keeps its reason and its words."""
        try:
            ended = await order
        except DeviceRefused as refusal:
            return f"{REFUSED}: {refusal.reason}", refusal.what
        except MountnavError as error:
            return error.slug, error.what
        return str(ended) if isinstance(ended, str) else "done", ""

    async def settled(self, seconds: float) -> None:
        """Let some time pass, watching that the mount still answers."""
        until = time.monotonic() + seconds
        while (left_s := until - time.monotonic()) > 0.0:
            await asyncio.sleep(min(left_s, 0.5))
            await self.mount.reading()


async def halt(trial: Trial) -> str:
    """Stop the mount on the way out of a step that went wrong; tells if that failed too."""
    try:
        await trial.mount.stop()
    except DeviceError as error:
        return f"; the stop failed too: {error}"
    return ""
