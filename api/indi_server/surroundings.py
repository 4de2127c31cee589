"""Where and when a telescope stands, and what it is: the INDI properties that only tell."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from api.indi_server.vectors import Vector, number, numbers, texts, timestamp
from drivers.indi.codec import State
from mountnav.sky.coordinates import Site

SITE, OPTIONS = "Site Management", "Options"


@dataclass(frozen=True, slots=True)
class Optics:
    """What a telescope is, as far as the settings say; both needed, or INDI's clients divide by zero."""

    focal_length_mm: float
    aperture_mm: float


def site_vector(site: Site) -> Vector:
    """GEOGRAPHIC_COORD: the site of the settings."""
    return numbers(
        "GEOGRAPHIC_COORD",
        "Scope Location",
        SITE,
        State.OK,
        number("LAT", "Lat (dd:mm:ss)", site.latitude_deg, form="%012.8m", least=-90.0, most=90.0),
        number("LONG", "Lon (dd:mm:ss)", site.longitude_deg % 360.0, form="%012.8m", most=360.0),
        number("ELEV", "Elevation (m)", site.height_m, form="%g", least=-500.0, most=10000.0),
    )


def time_vector(utc: datetime, offset_h: float) -> Vector:
    """TIME_UTC: this machine's clock, and its zone."""
    told = {"UTC": ("UTC Time", timestamp(utc)), "OFFSET": ("UTC Offset", f"{offset_h:.2f}")}
    # Ok: KStars takes the time of a mount that is content with it
    return texts("TIME_UTC", "UTC", SITE, told, State.OK)


def polling_vector(poll_s: float) -> Vector:
    """POLLING_PERIOD: how often the mount is read."""
    return numbers(
        "POLLING_PERIOD",
        "Polling",
        OPTIONS,
        State.OK,
        number("PERIOD_MS", "Period (ms)", 1000.0 * poll_s, form="%.f", least=10.0, most=600_000.0),
    )


def optics_vector(optics: Optics) -> Vector:
    """TELESCOPE_INFO: focal length and aperture; the guider's are said to be the same."""
    focal_length_mm, aperture_mm = optics.focal_length_mm, optics.aperture_mm
    return numbers(
        "TELESCOPE_INFO",
        "Scope Properties",
        OPTIONS,
        State.OK,
        number("TELESCOPE_APERTURE", "Aperture (mm)", aperture_mm, form="%g", most=50_000.0),
        number("TELESCOPE_FOCAL_LENGTH", "Focal Length (mm)", focal_length_mm, form="%g", most=1e6),
        number("GUIDER_APERTURE", "Guider Aperture (mm)", aperture_mm, form="%g", most=50_000.0),
        number("GUIDER_FOCAL_LENGTH", "Guider Focal Length (mm)", focal_length_mm, form="%g", most=1e6),
    )


__all__ = ["Optics", "optics_vector", "polling_vector", "site_vector", "time_vector"]
