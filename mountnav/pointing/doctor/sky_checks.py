"""Checks of each look by itself: mirrored images, the side of the pier, a sky below the ground.

Parity: an image is mirrored or it isn't, and no motion of a mount changes that [POINTING §9].

Side of the pier: the image turns by 180° at a flip and at nothing else. The camera is bolted on, so its angle
against the axes is one number, the same on both sides once 180° are subtracted on the far one. A mirror
changes the parity, never this angle.

Sky below the ground: a wrong longitude or clock of the *service* leaves the mount's readings and the solved
positions in agreement, so that offsets show nothing. But it turns the whole sky about the pole, and then
frames are solved where no telescope can look. Where the sky is above the ground with either sign of the
longitude, the looks can't tell the sign, and the mount isn't called healthy because of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.devices import PierSide
from mountnav.pointing.doctor.facts import Array, Facts, from_altaz, wrapped
from mountnav.pointing.doctor.findings import CERTAIN, Finding, Illness, Measured
from mountnav.pointing.doctor.priors import CAMERA_TURNED, FALSE_SOLVE, MIRRORED, PIER_SIDE
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import SOLAR_TO_SIDEREAL, Site

__all__ = ["BELOW_DEG", "SkyCheck", "check_sky"]


_WORDS = {1: "not mirrored", -1: "mirrored"}


def mirror_findings(observations: Sequence[PointingObservation], expected: int | None) -> list[Finding]:
    """Compare parities with the expected one, or with the first if none is.

    Parameters
    ----------
    observations : sequence of PointingObservation
        In order of time.
    expected : int or None
        +1 or -1; None: not known.
    """
    told = [one for one in observations if one.parity is not None]
    if not told:
        return []
    assert told[0].parity is not None
    usual = expected if expected is not None else told[0].parity
    others = [one for one in told if one.parity != usual]
    if not others:
        return []
    tail = 0
    while tail < len(told) and told[-1 - tail].parity != usual:
        tail += 1
    numbers = {
        "mirrored_looks": Measured(float(len(others)), None, "looks"),
        "looks": Measured(float(len(told)), None, "looks"),
    }
    ids = tuple(one.look_id for one in others)
    words = f"{len(others)} of {len(told)} looks are {_WORDS[-usual]}"
    if tail == 0:
        advice = "a false solution, or another camera's frame: don't use it"
        return [
            Finding(Illness.WRONG_LOOK, 0.99, CERTAIN, numbers, f"{words}, the last is not.", advice, (), ids)
        ]
    # one that stands alone may be a false solution, until the next look says the same
    against = min(1.0, FALSE_SOLVE**tail / MIRRORED)
    return [
        Finding(
            Illness.MIRRORED,
            1.0 / (1.0 + against),
            min(1.0 / max(against, 1e-300), CERTAIN),
            numbers,
            f"{words}; they should be {_WORDS[usual]}: the image is mirrored.",
            "a diagonal, a flipped readout or another program's mirroring: undo it, or set the parity; until "
            "then directions taken from the image are reversed",
            (Illness.WRONG_LOOK,) if tail == 1 else (),
            ids,
        )
    ]


# Part of the sigma of a camera's angle that is the same everywhere, degrees. Chosen by hand.
_SLACK_DEG = 0.7
# How far a polar axis nobody has measured is off, degrees, sigma; near the pole the image turns by it times
# sec δ. Chosen by hand. Doubled, a flip is less certain near the pole.
_AXIS_OFF_DEG = 1.5
# Least cos δ (2.9° from the pole) that the angle is divided by, so that no sigma is infinite.
_HIGHEST_COS = 0.05
_PAST_MERIDIAN_DEG = 12.0
"""How far mounts commonly track past the meridian: each such stretch farther is e times rarer."""


@dataclass(frozen=True, slots=True)
class SideCheck:
    """What the rotations and the hour angles tell of the sides.

    Attributes
    ----------
    probability_wrong : float
        That sides are misreported.
    probability_turned : float
        That the camera was turned instead.
    turned : ndarray of bool, shape (n,)
        Looks whose image stands upside down against what their reported side says.
    beyond : ndarray of bool, shape (n,)
        On which side of the pole the tube really was.
    jump_deg, jump_sigma_deg : float or None
        By how much the camera's angle differs between the groups; None where it doesn't.
    unchanged_flip : bool
        The side was reported to change, and the image did not turn.
    swapped : bool
        All sides the wrong way round, by their hour angles.
    rotations_agree : bool
        The rotations may be used for the geometry.
    looks : tuple of int
        Which looks tell it.
    """

    probability_wrong: float
    probability_turned: float
    turned: NDArray[np.bool_]
    beyond: NDArray[np.bool_]
    jump_deg: float | None
    jump_sigma_deg: float | None
    unchanged_flip: bool
    swapped: bool
    rotations_agree: bool
    looks: tuple[int, ...] = ()


def check_sides(facts: Facts, *, rotator: bool = False, equatorial: bool = True) -> SideCheck:
    """Compare reported sides with rotations and hour angles.

    Parameters
    ----------
    rotator : bool
        The camera may turn of its own accord: its rotations say nothing.
    equatorial : bool
        Alt-azimuth mounts have no sides.
    """
    n = len(facts)
    told = np.array([one is not PierSide.UNKNOWN for one in facts.sides])
    known = np.isfinite(facts.turned) & (not rotator)
    nothing = np.zeros(n, dtype=bool)
    swapped = _log_swapped(facts, told) if equatorial else -math.inf
    odds_swapped = math.exp(min(swapped, 100.0)) * PIER_SIDE
    beyond = facts.west if odds_swapped < 1.0 else np.where(told, ~facts.west, facts.west)
    plain = SideCheck(
        odds_swapped / (1.0 + odds_swapped),
        0.0,
        nothing,
        beyond,
        None,
        None,
        False,
        odds_swapped >= 1.0,
        False,
    )
    if known.sum() < 2:
        return plain
    camera = wrapped(facts.turned - np.where(facts.west, math.pi, 0.0))
    sigma = _sigma(facts.lat)
    trusted = known & (sigma < math.radians(25.0))
    if trusted.sum() < 2:
        wrong = odds_swapped / (1.0 + odds_swapped)
        return SideCheck(
            wrong, 0.0, nothing, beyond, None, None, False, odds_swapped >= 1.0, bool(known.any())
        )
    weight = np.where(trusted, sigma**-2, 0.0)
    # doubled angles don't see half turns: the axis of all, then the two groups about it
    axis = 0.5 * np.angle(np.sum(weight * np.exp(2j * np.where(trusted, camera, 0.0))))
    away = np.abs(wrapped(camera - axis))
    upside = trusted & (away > math.pi / 2.0)
    off_axis = wrapped(2.0 * (camera - axis)) / 2.0
    on_axis = bool(np.all(np.abs(off_axis[trusted]) < np.maximum(4.0 * sigma[trusted], math.radians(1.0))))
    if upside.sum() > (trusted & ~upside).sum():
        upside = trusted & ~upside
    if not on_axis and not equatorial:
        return plain  # a derotator keeps the sky upright
    if not on_axis:
        return SideCheck(0.0, 1.0, nothing, beyond, *_spread(camera, sigma, trusted), False, False, False)
    if not upside.any():
        return replace(plain, rotations_agree=True)
    if not (upside & told).any() or not (trusted & ~upside & told).any():
        # nobody told another side: the image alone says where the tube was
        truly = np.where(upside, ~facts.west, facts.west)
        if log_hour_angles(facts.lon, truly, trusted) < log_hour_angles(facts.lon, ~truly, trusted):
            truly = np.where(trusted & ~told, ~truly, truly)
        # near the pole the image tells nothing: by the hour angle, as mounts choose
        truly = np.where(~trusted & ~told, facts.lon < 0.0, truly)
        return replace(plain, rotations_agree=True, beyond=truly)
    jump, jump_sigma = _jump(camera, sigma, upside, trusted & ~upside)
    # a hand that turns a camera stops anywhere; half a turn by chance is rare (but a rotator does it)
    density = math.exp(-0.5 * ((180.0 - abs(jump)) / max(jump_sigma, 0.5)) ** 2) / (
        max(jump_sigma, 0.5) * math.sqrt(2.0 * math.pi)
    )
    odds = PIER_SIDE * density / (CAMERA_TURNED / 360.0)
    wrong = odds / (1.0 + odds)
    truly = np.where(upside, ~facts.west, facts.west)
    if (
        log_hour_angles(facts.lon, truly, trusted) < log_hour_angles(facts.lon, ~truly, trusted)
        and told.any()
    ):
        truly, upside = np.where(trusted, ~truly, truly), trusted & ~upside
    changed = bool(np.any(facts.west[trusted]) and not np.all(facts.west[trusted]))
    image = np.where(trusted, wrapped(facts.turned - axis), 0.0)
    unchanged = changed and len(set((np.abs(image[trusted]) > math.pi / 2.0).tolist())) == 1
    looks = tuple(int(one) for one in np.flatnonzero(upside))
    return SideCheck(wrong, 1.0 - wrong, upside, truly, jump, jump_sigma, unchanged, False, True, looks)


def _sigma(lat: Array) -> Array:
    """How well a camera's angle is known when nothing is known of the polar axis, rad."""
    return np.radians(np.hypot(_SLACK_DEG, _AXIS_OFF_DEG / np.maximum(np.abs(np.cos(lat)), _HIGHEST_COS)))


def _jump(
    camera: Array, sigma: Array, one: NDArray[np.bool_], other: NDArray[np.bool_]
) -> tuple[float, float]:
    means, variances = [], []
    for group in (one, other):
        weight = sigma[group] ** -2
        means.append(float(np.angle(np.sum(weight * np.exp(1j * camera[group])))))
        variances.append(1.0 / float(weight.sum()))
    jump = float(wrapped(np.array([means[0] - means[1]]))[0])
    return math.degrees(jump), math.degrees(math.sqrt(sum(variances)))


def _spread(camera: Array, sigma: Array, trusted: NDArray[np.bool_]) -> tuple[float, float]:
    """By how much the camera's angle differs at most, with its sigma."""
    numbers = np.flatnonzero(trusted)
    first = numbers[0]
    off = wrapped(camera - camera[first])
    far = numbers[int(np.argmax(np.abs(off[numbers])))]
    return math.degrees(float(off[far])), math.degrees(math.hypot(float(sigma[first]), float(sigma[far])))


def log_hour_angles(lon: Array, beyond: NDArray[np.bool_], counted: NDArray[np.bool_]) -> float:
    """How ordinary it is to look at these hour angles from these sides: east looks west."""
    past = np.where(beyond, lon, -lon)  # west side: past the meridian when west of it
    past = np.where(past > 0.0, np.minimum(past, math.pi - past), 0.0)
    return -float(np.sum(np.degrees(past[counted]) / _PAST_MERIDIAN_DEG))


def _log_swapped(facts: Facts, told: NDArray[np.bool_]) -> float:
    """Logarithm of how much more ordinary the hour angles are with all sides swapped.

    Asked only where both sides were told: a fork may call itself "east" for ever.
    """
    if len({one for one, known in zip(facts.sides, told, strict=True) if known}) < 2:
        return -math.inf
    return log_hour_angles(facts.lon, ~facts.west, told) - log_hour_angles(facts.lon, facts.west, told)


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
