"""What a fake LX200 knows of its horizon: sidereal time, altitude and azimuth, and targets given so."""

from __future__ import annotations

import re

from drivers.lx200.angles import dec_from_text, dec_to_text, ra_to_text
from drivers.wire.command import Unreadable
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.chain import (
    apparent_to_hour_angle,
    hour_angle_to_apparent,
    hour_angle_to_observed,
    observed_to_hour_angle,
    sidereal_time_deg,
)
from mountnav.sky.coordinates import Apparent, GeometricHourAngle, HourAngle, Observed

_AZIMUTH = re.compile(r"(\d{1,3})[*:](\d{2})(?:[:'](\d{2})(?:\.\d)?)?")


class Horizon:
    """Words in altitude and azimuth, by the mount's own clock and site; azimuths from north through east.

    Parameters
    ----------
    mechanics : Mechanics
    """

    def __init__(self, mechanics: Mechanics) -> None:
        self._mechanics = mechanics
        self._az_deg: float | None = None
        self._alt_deg: float | None = None

    def say(self, text: str, *, short: bool) -> bytes | None:
        """Answer `GS`, `GA`, `GZ`, `Sz`, `Sa`; None for anything else. Raises `Unreadable`."""
        if text == "GS":
            mechanics = self._mechanics
            return ra_to_text(sidereal_time_deg(mechanics.believed_utc(), mechanics.believed_site)) + b"#"
        if text in ("GA", "GZ"):
            seen = self._seen()
            if text == "GA":
                return dec_to_text(max(-90.0, min(90.0, seen.alt_deg)), short=short) + b"#"
            # the sign of a declination is not of an azimuth
            steps = round(seen.az_deg * 3600.0) % 1296000
            degrees, minutes = steps // 3600, steps // 60 % 60
            return b"%03d*%02d%s#" % (degrees, minutes, b"" if short else b":%02d" % (steps % 60))
        if text[:2] == "Sz":
            match = _AZIMUTH.fullmatch(text[2:].strip())
            if match is None or int(match[1]) > 360:
                raise Unreadable(f"{text!r} is no azimuth")
            self._az_deg = int(match[1]) + int(match[2]) / 60.0 + int(match[3] or 0) / 3600.0
            return b"1"
        if text[:2] == "Sa":
            wire = text[2:].strip().encode("latin-1")
            self._alt_deg = dec_from_text(wire if wire[:1] in b"+-" else b"+" + wire).deg
            return b"1"
        return None

    def target(self) -> Apparent | None:
        """The place that was given in altitude and azimuth, as it would be read now; None without both."""
        if self._az_deg is None or self._alt_deg is None:
            return None
        mechanics = self._mechanics
        utc, site = mechanics.believed_utc(), mechanics.believed_site
        angles = observed_to_hour_angle(Observed(self._az_deg, self._alt_deg, utc), site)
        return hour_angle_to_apparent(GeometricHourAngle(angles.ha_deg, angles.dec_deg, utc), site)

    def _seen(self) -> Observed:
        mechanics = self._mechanics
        utc, site = mechanics.believed_utc(), mechanics.believed_site
        place = mechanics.reported()
        angles = apparent_to_hour_angle(Apparent(place.ra_deg, place.dec_deg, utc), site)
        # only turned from the pole to the zenith: these mechanics know no refraction
        return hour_angle_to_observed(HourAngle(angles.ha_deg, angles.dec_deg, utc), site)
