"""A mount on trial: what every step needs, its site, positions that it can be sent to, and how orders end."""

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
"""How the outcome of a refused order begins, in findings; its reason follows."""

_WATCH_EACH_S = 0.5
"""s between two readings while a step waits: the usual heartbeat of a driver."""


@dataclass(frozen=True, slots=True)
class Trial:
    """A mount on trial.

    Attributes
    ----------
    mount : GenericMount
        Opened.
    site, air : Site, Air
        Where it stands; for altitudes.
    lowest_altitude_deg : float
        No step except the one about limits goes lower. The default of 20° keeps clear of walls and trees.
    watch_s : float
        How long the rate of tracking is measured; 30 s at a step of 15 arcsec tell 15 arcsec/s from 0.
    """

    mount: GenericMount
    site: Site
    air: Air
    lowest_altitude_deg: float = 20.0
    watch_s: float = 30.0

    async def place(self) -> Apparent | Icrs:
        """The position that the mount reports."""
        return (await self.mount.reading()).place

    def altitude_deg(self, place: Apparent | Icrs) -> float:
        """The altitude of a position now."""
        return icrs_to_observed(from_mount(place), utc_now(), self.site, self.air).alt_deg

    def hour_angle_deg(self, place: Apparent | Icrs) -> float:
        """The hour angle of a position now."""
        return icrs_to_hour_angle(from_mount(place), utc_now(), self.site, self.air).ha_deg

    def at_hour_angle(self, ha_deg: float, dec_deg: float) -> Apparent | Icrs:
        """The position that is at an hour angle now, in the mount's own coordinates."""
        now = utc_now()
        icrs = hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, now), self.site, self.air)
        return for_mount(icrs, self.mount.epoch, now)

    def beside(self, place: Apparent | Icrs, east_deg: float, north_deg: float) -> Apparent | Icrs:
        """A position offset from another, on the sphere."""
        moved = displaced(from_mount(place), east_deg * 3600.0, north_deg * 3600.0)
        return for_mount(moved, self.mount.epoch, utc_now())

    async def go(self, key: str, place: Apparent | Icrs, *, wanted: str = "arrived") -> list[Finding]:
        """Slew to a position; findings: how it ended, how far off, and how long it took.

        Parameters
        ----------
        key : str
            Of the findings.
        wanted : str
            The outcome that counts as fine.
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
        """Carry out an order; return its outcome in a word, and more words if there are any."""
        try:
            ended = await order
        except DeviceRefused as refusal:
            return f"{REFUSED}: {refusal.reason}", refusal.what
        except MountnavError as error:
            return error.slug, error.what
        return str(ended) if isinstance(ended, str) else "done", ""

    async def settled(self, seconds: float) -> None:
        """Wait, reading the mount meanwhile: it must go on answering."""
        until = time.monotonic() + seconds
        while (left_s := until - time.monotonic()) > 0.0:
            await asyncio.sleep(min(left_s, _WATCH_EACH_S))
            await self.mount.reading()


async def halt(trial: Trial) -> str:
    """Stop the mount after a step that failed; return words for the report if the stop fails too."""
    try:
        await trial.mount.stop()
    except DeviceError as error:
        return f"; the stop failed too: {error}"
    return ""
