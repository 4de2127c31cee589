"""Where to point, as the service takes it: each kind of target by a function of its own."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any, Literal

Target = dict[str, Any]


def icrs(
    ra_deg: float,
    dec_deg: float,
    *,
    pm_ra_cosdec_masyr: float = 0.0,
    pm_dec_masyr: float = 0.0,
    parallax_mas: float = 0.0,
    epoch_yr: float = 2000.0,
) -> Target:
    """A place in the ICRS; one that moves is taken from `epoch_yr` to the present by the service."""
    target: Target = {"kind": "icrs", "ra_deg": ra_deg, "dec_deg": dec_deg}
    if pm_ra_cosdec_masyr or pm_dec_masyr or parallax_mas:
        target |= {
            "pm_ra_cosdec_masyr": pm_ra_cosdec_masyr,
            "pm_dec_masyr": pm_dec_masyr,
            "parallax_mas": parallax_mas,
            "epoch_yr": epoch_yr,
        }
    return target


def apparent(ra_deg: float, dec_deg: float) -> Target:
    """A place of date ("JNow"): true equator and equinox of the moment of the order, no refraction."""
    return {"kind": "apparent", "ra_deg": ra_deg, "dec_deg": dec_deg}


def altaz(alt_deg: float, az_deg: float) -> Target:
    """A direction at the moment of the order, with refraction; azimuth from north through east."""
    return {"kind": "altaz", "alt_deg": alt_deg, "az_deg": az_deg}


def named(name: str) -> Target:
    """A bundled bright object, a body of the solar system, or what was imported; `objects` finds names."""
    return {"kind": "name", "name": name}


def typed(text: str, *, frame: str = "icrs") -> Target:
    """A position as a person types it, ``05h34m31.9s +22°00′52″``; `frame` may be ``jnow-apparent``."""
    return {"kind": "typed", "text": text, "frame": frame}


def rates(
    ra_deg: float,
    dec_deg: float,
    ra_arcsec_s: float,
    dec_arcsec_s: float,
    *,
    begins_utc: datetime | str,
    ends_utc: datetime | str,
    name: str | None = None,
    sigma_arcsec: float | None = None,
) -> Target:
    """A place (ICRS) at an instant that moves evenly, until an end.

    Parameters
    ----------
    ra_arcsec_s, dec_arcsec_s : float
        ″ per second; right ascension not times cos δ, positive to the east.
    begins_utc, ends_utc : datetime or str
        Aware, or ISO 8601 with a time zone.
    name : str, optional
        What to call it.
    sigma_arcsec : float, optional
        How uncertain it is.
    """
    place = {"ra_deg": ra_deg, "dec_deg": dec_deg, "ra_arcsec_s": ra_arcsec_s, "dec_arcsec_s": dec_arcsec_s}
    return _moving(
        "rates", name, sigma_arcsec, begins_utc=instant(begins_utc), ends_utc=instant(ends_utc), **place
    )


def altaz_rates(
    alt_deg: float,
    az_deg: float,
    alt_arcsec_s: float,
    az_arcsec_s: float,
    *,
    begins_utc: datetime | str,
    ends_utc: datetime | str,
    name: str | None = None,
    sigma_arcsec: float | None = None,
) -> Target:
    """A direction over the horizon at an instant that moves evenly; azimuth not times cos of the altitude."""
    place = {"alt_deg": alt_deg, "az_deg": az_deg, "alt_arcsec_s": alt_arcsec_s, "az_arcsec_s": az_arcsec_s}
    return _moving(
        "rates", name, sigma_arcsec, begins_utc=instant(begins_utc), ends_utc=instant(ends_utc), **place
    )


def path(
    waypoints: Sequence[tuple[datetime | str, float, float]],
    *,
    name: str | None = None,
    sigma_arcsec: float | None = None,
) -> Target:
    """A way by waypoints, joined smoothly, up to the last: an instant, RA and Dec (ICRS, degrees) each."""
    points = [{"utc": instant(at), "ra_deg": ra_deg, "dec_deg": dec_deg} for at, ra_deg, dec_deg in waypoints]
    return _moving("path", name, sigma_arcsec, waypoints=points)


def satellite(elements: str) -> Target:
    """An Earth satellite by its elements: two lines (or three with its name), or an OMM; one satellite."""
    return {"kind": "satellite", "elements": elements}


def elements(text: str) -> Target:
    """A minor planet or a comet by its orbital elements.

    A line of MPCORB.DAT or CometEls.txt, JSON of the MPC, or an answer of JPL's SBDB; one body.
    """
    return {"kind": "elements", "elements": text}


def table(text: str, *, made_for: Literal["here", "geocenter"] | None = None) -> Target:
    """A target by an ephemeris table: of Horizons, the MPC's ephemeris service, or plain CSV."""
    target: Target = {"kind": "table", "table": text}
    return target if made_for is None else {**target, "made_for": made_for}


def _moving(kind: str, name: str | None, sigma_arcsec: float | None, **fields: Any) -> Target:
    told = {"name": name, "sigma_arcsec": sigma_arcsec}
    return {"kind": kind, **{key: value for key, value in told.items() if value is not None}, **fields}


def instant(at: datetime | str) -> str:
    """An instant as the service takes it. Raises `ValueError` for one without a time zone."""
    if isinstance(at, str):
        return at
    if at.tzinfo is None:
        raise ValueError(f"{at} doesn't say its time zone")
    return at.astimezone(UTC).isoformat().replace("+00:00", "Z")
