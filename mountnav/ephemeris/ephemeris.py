"""What an ephemeris answers within its span, whatever it is made from; and how fast its target moves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Protocol, runtime_checkable

from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

_STEP_S = 1.0
"""Half the span over which rates are differenced, s: those of a satellite that crosses the sky in minutes
change by less than a thousandth in it. Doubled, the rates of such a pass are four times as wrong."""


@runtime_checkable
class Ephemeris(Protocol):
    """A target that moves among the stars.

    All places are topocentric and astrometric: where a star would have to stand in the ICRS to be seen in the
    same direction from the site; light time is taken off, the chain to the apparent or observed place adds
    aberration and refraction as it does for stars (`mountnav.sky.chain`).
    """

    @property
    def name(self) -> str:
        """What people call it, for messages."""
        ...

    @property
    def begins_utc(self) -> datetime | None:
        """From when on it can be asked; None: any time."""
        ...

    @property
    def ends_utc(self) -> datetime | None:
        """Until when; None: any time."""
        ...

    def icrs(self, utc: datetime, site: Site) -> Icrs:
        """Where it stands.

        Parameters
        ----------
        utc : datetime
            Aware.

        Raises
        ------
        BadRequest
            Outside of its span.
        """
        ...

    def sigma_arcsec(self, utc: datetime) -> float:
        """One-sigma uncertainty of that place, ″, as far as the source tells or implies it; 0 of a star."""
        ...


@dataclass(frozen=True, slots=True)
class StarLike:
    """A place that doesn't move among the stars, as an `Ephemeris`."""

    place: Icrs
    name: str = "a fixed place"
    begins_utc: datetime | None = None
    ends_utc: datetime | None = None

    def icrs(self, utc: datetime, site: Site) -> Icrs:
        """The same at any time."""
        return self.place

    def sigma_arcsec(self, utc: datetime) -> float:
        """None."""
        return 0.0


@dataclass(frozen=True, slots=True)
class SkyRates:
    """How fast a target moves among the stars, ICRS.

    Attributes
    ----------
    ra_arcsec_s : float
        Change of the right ascension, ″/s, not times cos δ.
    total_arcsec_s : float
        Along its way on the sphere.
    """

    ra_arcsec_s: float
    dec_arcsec_s: float
    total_arcsec_s: float


def sky_rates(target: Ephemeris, utc: datetime, site: Site) -> SkyRates:
    """How fast a target moves at an instant, by the difference of its places 2 s apart; at its ends of less.

    Raises
    ------
    BadRequest
        Outside of its span.
    """
    step = timedelta(seconds=_STEP_S)
    begin = utc - step if target.begins_utc is None else max(utc - step, target.begins_utc)
    end = utc + step if target.ends_utc is None else min(utc + step, target.ends_utc)
    seconds = (end - begin).total_seconds()
    before, after = target.icrs(begin, site), target.icrs(end, site)
    if seconds <= 0.0 or math.isclose(seconds, 0.0):
        return SkyRates(0.0, 0.0, 0.0)
    return SkyRates(
        half_turn_deg(after.ra_deg - before.ra_deg) * 3600.0 / seconds,
        (after.dec_deg - before.dec_deg) * 3600.0 / seconds,
        separation_arcsec(before, after) / seconds,
    )


def require_within(
    name: str, utc: datetime, begins: datetime | None, ends: datetime | None, why: str = ""
) -> None:
    """Refuse an instant outside of a span.

    Parameters
    ----------
    name : str
        Of the target.
    utc : datetime
        Aware.
    begins, ends : datetime or None
        None: any time.
    why : str
        What makes the span, for the message.

    Raises
    ------
    BadRequest
        It is naive, or outside.
    """
    require_aware(utc)
    if begins is not None and utc < begins:
        raise BadRequest(f"{name} begins at {told(begins)}{why}, and {told(utc)} is earlier")
    if ends is not None and utc > ends:
        raise BadRequest(f"{name} ends at {told(ends)}{why}, and {told(utc)} is later")


def require_aware(utc: datetime) -> None:
    """Refuse an instant that doesn't say its time zone. Raises BadRequest."""
    if utc.utcoffset() is None:
        raise BadRequest(
            f"the instant {utc.isoformat()} doesn't say its time zone",
            advice="give UTC, for example 2026-11-21T22:00:00Z",
        )


def told(utc: datetime) -> str:
    """An instant for messages: UTC to the second."""
    return f"{utc.astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"
