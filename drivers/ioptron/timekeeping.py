"""An iOptron mount's clock and site, read and written in the words of either set."""

from __future__ import annotations

from datetime import datetime, timedelta

from drivers.ioptron.talk import Talk
from mountnav.sky.coordinates import Site, utc_now


async def read_clock(talk: Talk) -> datetime | None:
    """Its clock, aware UTC, corrected for the way; None where it tells none.

    The v2 set tells local time, zone and summer time apart: reckoned back.
    """
    before = utc_now()
    clock = await talk.known(talk.words.clock)
    if clock is None:
        return None
    way = (utc_now() - before) / 2
    return clock.utc + timedelta(seconds=0.5 * talk.words.clock_step_s) + way


async def write_clock(talk: Talk, utc: datetime) -> None:
    """Set its clock; with the v2 set its zone as well, to UTC. Raises `DeviceRefused`."""
    ahead = utc - utc_now()
    await talk.settled("setting the clock", moves=False)
    for command in talk.words.before_clock:
        await talk.obeyed(command)
    for command in talk.words.set_clock(utc_now() + ahead):
        await talk.obeyed(command)


async def write_site(talk: Talk, site: Site) -> None:
    """Tell it where it stands, and on which hemisphere. Raises `DeviceRefused`."""
    await talk.settled("setting the site", moves=False)
    longitude_deg = (site.longitude_deg + 180.0) % 360.0 - 180.0
    for command in talk.words.set_site(site.latitude_deg, longitude_deg):
        await talk.obeyed(command)
