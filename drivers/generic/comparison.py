"""A mount's clock, site and epoch compared with ours: reported at connecting, nothing is changed."""

from __future__ import annotations

from datetime import datetime

from drivers.generic.language import Identity, Language, Readout
from mountnav.clock import utc_now
from mountnav.devices import ConnectReport, from_mount
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

CLOCK_TOLERANCE_S = 2.0
"""A mount's clock is reported as wrong beyond this, s: protocols carry whole seconds, and an answer takes up
to one. 2 s are 30 arcseconds of sky. Doubled, an error of an arcminute in right ascension goes
unmentioned."""
SITE_TOLERANCE_ARCSEC = 120.0
"""A mount's site is reported as wrong beyond this: the classic LX200 protocol carries whole minutes of arc.
Halved, sites are called wrong that were only rounded."""

LOWEST_PLACE_DEG = -10.0
"""No tube points lower than this except when parked: a position there is wrong. Doubled, a mount whose clock
is an hour off in the east or west is believed."""
_NOTHING_DEG = 0.001
"""A position so near to 0, 0 is that of memory without a value: finer than any mount's readings. Doubled or
halved, nothing changes: real positions are steps of 0.004° or more apart or exactly there."""
_ODD_CLOCK_S = 120.0
"""A clock that is whole hours off to within this has a wrong zone or daylight saving, s. Chosen: clocks set
by hand are off by a minute or two. Doubled, a clock that is merely wrong is now and then explained by its
zone."""
_ZONES_H = 14
"""The largest offset of a time zone from UTC, hours (UTC+14, Kiritimati)."""
_SAME_PLACE_DEG = 0.1
"""Coordinates of a site are taken for the same within this when its longitude may have the wrong sign.
Chosen: 10 km. Doubled or halved, nothing changes away from the meridian of Greenwich."""


def implausible(readout: Readout, site: Site | None) -> str:
    """Why the position that a mount reports at connecting can't be where it points; empty if it may be."""
    place = readout.place
    if readout.parked:
        return ""
    if abs(half_turn_deg(place.ra_deg)) < _NOTHING_DEG and abs(place.dec_deg) < _NOTHING_DEG:
        return "it reports right ascension 0 and declination 0, as a mount that was never set does"
    if site is None:
        return ""
    altitude_deg = icrs_to_observed(from_mount(place), readout.utc, site, Air()).alt_deg
    if altitude_deg < LOWEST_PLACE_DEG:
        return f"the position that it reports is {-altitude_deg:.0f}° below the horizon of our site"
    return ""


async def compare(
    language: Language, identity: Identity, site: Site | None, *, trusted: bool, done: tuple[str, ...] = ()
) -> ConnectReport:
    """Ask a connected mount for its clock and its site, and compare.

    Parameters
    ----------
    language : Language
        Opened.
    identity : Identity
        What opening it found.
    site : Site or None
        Ours.
    trusted : bool
        Whether its position is trusted, for the report.
    done : tuple of str
        What was set while connecting, for the report.

    Raises
    ------
    DeviceError
        If the mount doesn't answer.
    """
    problems = list(identity.problems)
    if language.epoch != language.usual_epoch:
        problems.append(
            f"it is set to speak {language.epoch} coordinates, its family "
            f"usually speaks {language.usual_epoch}"
        )
    clock = await language.read_clock()
    clock_off_s = None if clock is None else (clock - utc_now()).total_seconds()
    if clock_off_s is not None and abs(clock_off_s) > CLOCK_TOLERANCE_S:
        problems.append(_clock_problem(clock_off_s, clock))
    theirs = await language.read_site()
    latitude_off_deg = longitude_off_deg = site_off_arcsec = None
    if theirs is not None and site is not None:
        latitude_off_deg = theirs.latitude_deg - site.latitude_deg
        longitude_off_deg = half_turn_deg(theirs.longitude_deg - site.longitude_deg)
        site_off_arcsec = separation_arcsec(
            Icrs(theirs.longitude_deg % 360.0, theirs.latitude_deg),
            Icrs(site.longitude_deg % 360.0, site.latitude_deg),
        )
        if site_off_arcsec > SITE_TOLERANCE_ARCSEC:
            problems.append(_site_problem(theirs, site))
    return ConnectReport(
        identity=identity.text,
        epoch=language.epoch,
        clock_off_s=clock_off_s,
        site_off_arcsec=site_off_arcsec,
        latitude_off_deg=latitude_off_deg,
        longitude_off_deg=longitude_off_deg,
        trusted=trusted,
        problems=tuple(problems),
        done=done,
    )


def _clock_problem(off_s: float, clock: datetime | None) -> str:
    hours = round(off_s / 3600.0)
    side = "ahead of" if off_s > 0 else "behind"
    text = f"its clock is {abs(off_s):.0f} s {side} ours (it says {clock:%Y-%m-%d %H:%M:%S} UTC)"
    if hours and abs(off_s - 3600.0 * hours) < _ODD_CLOCK_S and abs(hours) <= _ZONES_H:
        return f"{text}: {abs(hours)} h, so its time zone or daylight saving is wrong"
    return text


def _site_problem(theirs: Site, ours: Site) -> str:
    text = (
        f"it believes that it is at latitude {theirs.latitude_deg:.3f}°, "
        f"longitude {theirs.longitude_deg:.3f}° (east), "
        f"we at {ours.latitude_deg:.3f}°, {ours.longitude_deg:.3f}°"
    )
    same_latitude = abs(theirs.latitude_deg - ours.latitude_deg) < _SAME_PLACE_DEG
    if same_latitude and abs(half_turn_deg(theirs.longitude_deg + ours.longitude_deg)) < _SAME_PLACE_DEG:
        return f"{text}: the sign of the longitude is wrong"
    return text
