"""A night at a glance: Sun, Moon and target over the hours, what the looks saw, what was done when.

Made for a strip that is drawn over the night; nothing that steers uses it.
"""

from __future__ import annotations

import math
from datetime import datetime, timedelta

from pydantic import BaseModel, Field

from api.http.headline_views import NightTimesView, night_times
from api.observatory.last_frame import LastFrame, SkySeen
from api.orders.job_views import Finite
from mountnav.devices import MountReading
from mountnav.journal.observations import reading_at
from mountnav.journal.reading import JournalReader, Line, Wanted
from mountnav.journal.records import CommandRecord, Entry, EntryKind, LookRecord, Outcome
from mountnav.journal.wording import in_words
from mountnav.mount import CheckedMount
from mountnav.pointing.limits.bodies import bodies
from mountnav.sky.chain import apparent_to_icrs, hour_angle_to_observed, icrs_to_hour_angle
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent, GeometricHourAngle, HourAngle, Icrs, Site
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

__all__ = ["TonightView", "tonight_view"]

_STEP = timedelta(minutes=10)
"""Between two points of a curve: 2.5° of the sky's turning, drawn as smooth. Doubled, corners show."""
_BESIDE = timedelta(minutes=30)
"""So long before sunset and after sunrise the strip shows. Doubled, the night is drawn narrower."""
_BEFORE_NOW, _AFTER_NOW = timedelta(hours=1), timedelta(hours=3)
"""Before sunset, and where the Sun doesn't set: so much round now is shown in any case. Doubled, the night is
drawn narrower."""
_MOST_LINES = 1500
"""Lines of the journal that a strip is made of, the newest; a busy night has some thousand. Doubled, reading
them takes twice 30 ms."""
_MOST_ACTS = 300
"""Marks on a strip; more than one for each two pixels can't be told apart."""
_MOVES = frozenset({"slew", "sync", "park", "unpark", "home", "stop", "set-park", "flip", "tracking"})
"""Commands that a strip marks; guide pulses and rates would fill it."""
_MARKED = frozenset(
    {
        EntryKind.FAULT,
        EntryKind.LINK,
        EntryKind.REFUSAL,
        EntryKind.CENTERING,
        EntryKind.NIGHT,
        EntryKind.MODEL,
    }
)
_TROUBLES = frozenset({EntryKind.FAULT, EntryKind.REFUSAL})
_WELL = frozenset({Outcome.DONE, Outcome.LATE})
"""Ends of commands that need nobody's eye."""


class SkyAtView(BaseModel):
    """How high Sun, Moon and target stand at an instant; no refraction for Sun and Moon."""

    utc: datetime
    sun_altitude_deg: float
    moon_altitude_deg: float
    target_altitude_deg: Finite = Field(
        description="Of what the telescope looks at, or goes to; null: nothing"
    )
    lowest_deg: Finite = Field(
        description="The lowest altitude that the limits allow at the target's azimuth then"
    )


class LookSeenView(BaseModel):
    """What a look found."""

    utc: datetime = Field(description="Mid-exposure")
    solved: bool
    error_arcsec: Finite = Field(description="Seen minus believed; null of a look that was not solved")
    fwhm_arcsec: Finite
    limiting_mag: Finite
    zero_point_mag: Finite = Field(
        description="Magnitude of a star of 1 ADU; known of frames since the service was started"
    )
    exposure_s: Finite


class ActView(BaseModel):
    """What was done, or went wrong."""

    utc: datetime
    kind: str = Field(description="slew, sync, park, stop, ... or an entry's kind: fault, link, refusal, ...")
    words: str
    trouble: bool


class TonightView(BaseModel):
    """The night that now belongs to, as far as it is known, and the sky until its end."""

    telescope: str
    utc: datetime = Field(description="Now, by the service's clock")
    from_utc: datetime
    until_utc: datetime
    times: NightTimesView
    moon_lit_percent: float = Field(description="Share of the Moon's disk that is lit")
    max_altitude_deg: float
    sky: list[SkyAtView]
    looks: list[LookSeenView]
    acts: list[ActView]
    cut: bool = Field(description="Whether the night has more lines in the journal than were read")


def tonight_view(
    telescope_id: str,
    mount: CheckedMount,
    target: Icrs | None,
    frames: LastFrame | None,
    where: str,
    utc: datetime,
) -> TonightView:
    """Show the night of a telescope. Reads the journal: to be called in a thread.

    Parameters
    ----------
    target : Icrs or None
        What the telescope looks at, or goes to.
    where : str
        The journal.

    Raises
    ------
    JournalFailed, BadSettings
        The journal can't be read.
    """
    site = mount.site
    times = night_times(utc, site)
    begin, end = _span(times, utc)
    found = _lines(where, telescope_id, begin)
    around = bodies(utc.replace(microsecond=0), site)
    seen = () if frames is None else tuple(frames.seen)
    acts = [act for line in found if (act := _act(line)) is not None]
    return TonightView(
        telescope=telescope_id,
        utc=utc,
        from_utc=begin,
        until_utc=end,
        times=times,
        moon_lit_percent=round(100.0 * _lit(around.sun, around.moon), 1),
        max_altitude_deg=mount.limits.max_altitude_deg,
        sky=_sky(mount, target, begin, end, utc),
        looks=[_look(line.record, seen) for line in found if isinstance(line.record, LookRecord)],
        acts=acts[-_MOST_ACTS:],
        cut=len(found) >= _MOST_LINES or len(acts) > _MOST_ACTS,
    )


def _span(times: NightTimesView, utc: datetime) -> tuple[datetime, datetime]:
    begin, end = utc - _BEFORE_NOW, utc + _AFTER_NOW
    if times.sun_sets_utc is not None:
        begin = min(begin, times.sun_sets_utc - _BESIDE)
    if times.sun_rises_utc is not None:
        end = max(end if times.sun_sets_utc is None else utc + _BESIDE, times.sun_rises_utc + _BESIDE)
    return begin.replace(microsecond=0), end.replace(microsecond=0)


def _lines(where: str, telescope_id: str, since: datetime) -> list[Line]:
    from mountnav.journal.database import default_url

    reader = JournalReader(where or default_url())
    newest = reader.lines(Wanted(telescope=telescope_id, since=since), limit=_MOST_LINES, newest_first=True)
    return newest[::-1]


def _sky(
    mount: CheckedMount, target: Icrs | None, begin: datetime, end: datetime, utc: datetime
) -> list[SkyAtView]:
    """Curves: the target by its hour angle turned on, good to what refraction changes."""
    site, limits = mount.site, mount.limits
    here = None if target is None else icrs_to_hour_angle(target, utc, site, mount.air)
    views = []
    for number in range(math.ceil((end - begin) / _STEP) + 1):
        at = min(begin + number * _STEP, end)
        around = bodies(at, site)
        alt_deg = lowest_deg = None
        if here is not None:
            turned_deg = here.ha_deg + SIDEREAL_DEG_S * (at - utc).total_seconds()
            seen = hour_angle_to_observed(HourAngle(half_turn_deg(turned_deg), here.dec_deg, at), site)
            alt_deg, lowest_deg = seen.alt_deg, limits.min_altitude_deg
            if limits.horizon is not None:
                lowest_deg = max(lowest_deg, limits.horizon.altitude_at(seen.az_deg))
        views.append(
            SkyAtView(
                utc=at,
                sun_altitude_deg=round(_altitude(around.sun, site), 2),
                moon_altitude_deg=round(_altitude(around.moon, site), 2),
                target_altitude_deg=None if alt_deg is None else round(alt_deg, 2),
                lowest_deg=None if lowest_deg is None else round(lowest_deg, 2),
            )
        )
    return views


def _altitude(body: GeometricHourAngle, site: Site) -> float:
    return hour_angle_to_observed(HourAngle(body.ha_deg, body.dec_deg, body.utc), site).alt_deg


def _lit(sun: GeometricHourAngle, moon: GeometricHourAngle) -> float:
    """Share of the Moon's disk that is lit, of 1: by its distance from the Sun; 1 % off at the most."""
    first, second = math.radians(sun.dec_deg), math.radians(moon.dec_deg)
    apart = math.sin(first) * math.sin(second) + math.cos(first) * math.cos(second) * math.cos(
        math.radians(sun.ha_deg - moon.ha_deg)
    )
    return 0.5 * (1.0 - apart)


def _look(record: LookRecord, seen: tuple[SkySeen, ...]) -> LookSeenView:
    sky = next((one for one in reversed(seen) if one.utc == record.utc), None)
    known = record.fwhm_px is not None and record.scale_arcsec_px is not None
    return LookSeenView(
        utc=record.utc,
        solved=record.solved,
        error_arcsec=_error(record.seen, record.before, record.after, record.utc),
        fwhm_arcsec=record.fwhm_px * record.scale_arcsec_px  # type: ignore[operator]
        if known
        else None,
        limiting_mag=record.limiting_mag,
        zero_point_mag=None if sky is None else sky.zero_point_mag,
        exposure_s=record.exposure_s or None,
    )


def _error(seen: Icrs | None, before: MountReading, after: MountReading, utc: datetime) -> float | None:
    """How far the tube was from where the mount believed it; None where it moved during the look."""
    believed = None if seen is None else reading_at(before, after, utc)
    if seen is None or believed is None:
        return None
    place = apparent_to_icrs(believed) if isinstance(believed, Apparent) else believed
    return separation_arcsec(seen, place)


def _act(line: Line) -> ActView | None:
    record = line.record
    if isinstance(record, CommandRecord):
        if record.order not in _MOVES:
            return None
        trouble = line.end is not None and line.end.outcome not in _WELL
        return ActView(utc=record.utc, kind=record.order, words=in_words(line), trouble=trouble)
    if isinstance(record, Entry) and record.kind in _MARKED:
        words = in_words(line)
        trouble = record.kind in _TROUBLES or (
            record.kind is EntryKind.LINK and not words.startswith("connected")
        )
        return ActView(utc=record.utc, kind=str(record.kind), words=words, trouble=trouble)
    return None
