"""Does the tube hang where the mount says? The image turns by 180° at a flip, and at nothing else.

The camera is bolted on: its angle against the axes is one number, the same on both sides once 180° are taken
off on the far one. A mirror changes parity, never this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.devices import PierSide
from mountnav.pointing.doctor.facts import Array, Facts, wrapped
from mountnav.pointing.doctor.priors import CAMERA_TURNED, PIER_SIDE

_SLACK_DEG = 0.7
_AXIS_OFF_DEG = 1.5
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
    facts : Facts
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
