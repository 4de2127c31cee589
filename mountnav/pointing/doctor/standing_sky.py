"""The sky that was seen stands above the ground, or the place or the time that are configured are wrong.

A wrong longitude or clock of *ours* leaves readings and solved places in agreement: offsets show nothing. But
it turns the whole sky about the pole, and then frames are solved where no telescope can look. Where the sky
stands well both ways, the looks can't tell the sign of the longitude, and nobody is called healthy by them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.devices import PierSide
from mountnav.pointing.doctor.facts import Array, Facts, from_altaz, wrapped
from mountnav.pointing.doctor.findings import CERTAIN, Finding, Illness, Measured
from mountnav.pointing.doctor.sides import log_hour_angles
from mountnav.sky.coordinates import Site
from mountnav.sky.turning import SOLAR_TO_SIDEREAL

BELOW_DEG = -2.0
"""Lower than this no telescope looks, whatever refraction and an uneven horizon do."""
_WORSE = math.log(200.0)
"""So much less ordinary the postures of a German mount must be for a longitude to be excluded by them."""
_NO_TURN_DEG = 2.0
"""A longitude whose sign turns the sky by no more than this does no harm to any limit."""


@dataclass(frozen=True, slots=True)
class SkyCheck:
    """What the sky's standing tells of the configured place and time.

    Attributes
    ----------
    finding : Finding or None
        Looks below the ground.
    suspicion : Finding or None
        The other sign of the longitude explains all sides that seem swapped.
    sign_excluded : bool
        The looks can't be of the same place with the other sign of its longitude.
    """

    finding: Finding | None
    suspicion: Finding | None
    sign_excluded: bool


@dataclass(frozen=True, slots=True)
class _Place:
    """A place or time that it may be instead."""

    illness: Illness
    turn_rad: float
    latitude_deg: float
    words: str
    advice: str


def check_sky(facts: Facts, site: Site, *, altaz: bool, swapped: bool, sign_confirmed: bool) -> SkyCheck:
    """Ask whether the seen sky is above the ground.

    Parameters
    ----------
    facts : Facts
    site : Site
        As configured.
    altaz : bool
        The facts are in the frame of an alt-azimuth mount.
    swapped : bool
        By their hour angles all sides are the wrong way round.
    sign_confirmed : bool
        Somebody else, say the mount, has told the same longitude.
    """
    seen, read = _equatorial(facts, site, altaz)
    low = _below(seen, 0.0, site.latitude_deg) & _below(read, 0.0, site.latitude_deg)
    mirrored = _instead(site)[0]
    told = np.array([one is not PierSide.UNKNOWN for one in facts.sides])
    sided = not altaz and len({one for one in facts.sides if one is not PierSide.UNKNOWN}) > 1
    if low.any():
        return SkyCheck(_below_ground(facts, seen, low, site), None, False)
    harmless = abs(math.degrees(float(wrapped(np.array([mirrored.turn_rad]))[0]))) < _NO_TURN_DEG
    stands = not bool(_below(seen, mirrored.turn_rad, site.latitude_deg).any())
    turned = log_hour_angles(wrapped(seen[:, 0] + mirrored.turn_rad), facts.west, told) if sided else 0.0
    now = log_hour_angles(seen[:, 0], facts.west, told) if sided else 0.0
    other = log_hour_angles(seen[:, 0], ~facts.west, told) if sided else 0.0
    excluded = harmless or sign_confirmed or not stands or turned < now - _WORSE
    suspicion = None
    if swapped and not (harmless or sign_confirmed) and stands and turned >= other - _WORSE:
        suspicion = Finding(
            Illness.LONGITUDE_SIGN,
            0.5,
            math.exp(min(max(turned - now, 0.0), 700.0)),
            {"longitude_deg": Measured(-site.longitude_deg, None, "°")},
            f"the sides of the pier don't fit the hour angles; they would at longitude "
            f"{-site.longitude_deg:.3f}° (east), and we say {site.longitude_deg:.3f}°: the sign of this "
            "service's longitude may be wrong, or all sides are told the wrong way round.",
            mirrored.advice,
            (Illness.PIER_SIDE,),
        )
    return SkyCheck(None, suspicion, excluded)


def _equatorial(facts: Facts, site: Site, altaz: bool) -> tuple[Array, Array]:
    """Hour angles and declinations seen and read; shape (n, 2), rad."""
    seen, read = np.column_stack((facts.lon, facts.lat)), np.column_stack((facts.read_lon, facts.read_lat))
    if altaz:
        latitude = math.radians(site.latitude_deg)
        return from_altaz(seen, latitude), from_altaz(read, latitude)
    return seen, read


def _altitudes_deg(angles: Array, turn_rad: float, latitude_deg: float) -> Array:
    """Geometric altitudes, with the sky turned about the pole."""
    ha, dec, latitude = angles[:, 0] + turn_rad, angles[:, 1], math.radians(latitude_deg)
    up = math.sin(latitude) * np.sin(dec) + math.cos(latitude) * np.cos(dec) * np.cos(ha)
    return np.asarray(np.degrees(np.arcsin(np.clip(up, -1.0, 1.0))))


def _below(angles: Array, turn_rad: float, latitude_deg: float) -> NDArray[np.bool_]:
    return _altitudes_deg(angles, turn_rad, latitude_deg) < BELOW_DEG


def _instead(site: Site) -> list[_Place]:
    """What the place and the time may be instead, the likeliest first."""
    sign = "set this service's longitude ([site] longitude_deg, east positive) with the other sign"
    found = [
        _Place(
            Illness.LONGITUDE_SIGN,
            math.radians(-2.0 * site.longitude_deg),
            site.latitude_deg,
            f"at longitude {-site.longitude_deg:.3f}° (east) all would stand above it: the sign of this "
            "service's longitude is wrong",
            sign,
        ),
        _Place(
            Illness.HEMISPHERE,
            0.0,
            -site.latitude_deg,
            f"at latitude {-site.latitude_deg:.3f}° all would stand above it: the sign of this "
            "service's latitude is wrong",
            "set this service's latitude ([site] latitude_deg) with the other sign, then restart it",
        ),
    ]
    for hours in sorted(range(-12, 13), key=abs):
        if hours:
            found.append(
                _Place(
                    Illness.CLOCK,
                    math.radians(15.0 * SOLAR_TO_SIDEREAL * hours),
                    site.latitude_deg,
                    f"{abs(hours)} h {'later' if hours > 0 else 'earlier'} all would stand above it: this "
                    "service's clock, or that of the frames, is wrong",
                    "set the clock of this machine (UTC, by NTP) and that of the camera's machine",
                )
            )
    return found


def _below_ground(facts: Facts, seen: Array, low: NDArray[np.bool_], site: Site) -> Finding:
    """What to make of looks below the ground."""
    fits = [one for one in _instead(site) if not _below(seen, one.turn_rad, one.latitude_deg).any()]
    best = fits[0] if fits else None
    deepest = float(_altitudes_deg(seen, 0.0, site.latitude_deg).min())
    numbers = {
        "lowest_altitude_deg": Measured(deepest, None, "°"),
        "looks_below_ground": Measured(float(low.sum()), None, "looks"),
        "looks": Measured(float(len(facts)), None, "looks"),
    }
    words = (
        f"{int(low.sum())} of {len(facts)} looks show a sky that stands below the ground (down to "
        f"{deepest:.1f}°) at this time and place, latitude {site.latitude_deg:.3f}°, longitude "
        f"{site.longitude_deg:.3f}° (east): "
    )
    words += best.words if best is not None else "this service's place or its clock is wrong"
    advice = (
        "set this service's place ([site]) and the clock of this machine" if best is None else best.advice
    )
    kinds = tuple(dict.fromkeys(one.illness for one in fits))
    return Finding(
        Illness.LONGITUDE if best is None else best.illness,
        0.99 if len(kinds) == 1 else 0.9,
        CERTAIN,
        numbers,
        f"{words}.",
        f"{advice}; until then no limit can be kept",
        kinds[1:],
        tuple(one for one, is_low in zip(facts.look_ids, low, strict=True) if is_low),
    )


__all__ = ["BELOW_DEG", "SkyCheck", "check_sky"]
