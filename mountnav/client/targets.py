"""Where to point, as the service takes it: each kind of target by a function of its own."""

from __future__ import annotations

from typing import Any

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
    """A bundled bright object or a planet; `objects` finds names."""
    return {"kind": "name", "name": name}


def typed(text: str, *, frame: str = "icrs") -> Target:
    """A position as a person types it, ``05h34m31.9s +22°00′52″``; `frame` may be ``jnow-apparent``."""
    return {"kind": "typed", "text": text, "frame": frame}
