"""What is probable before anything was seen: illnesses, ordinary mounts, noise. All of it in one place.

The classes of mounts are mixed, never chosen: a mount without a model may be aligned to an arcminute or to a
degree, and a diagnosis has to hold for both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from mountnav.pointing.doctor.findings import Illness


@dataclass(frozen=True, slots=True)
class Geometry:
    """How a mount's geometry is expected to be: terms and their one-sigma widths, arcsec [POINTING §5].

    Attributes
    ----------
    terms_arcsec : (CH, NP, ME, MA, TF, TX)
        Expected values; TX stands for the refraction that the mount does not know (60″ at one atmosphere).
    side_sigma_arcsec : float
        How far the zero points of one segment may differ between the two sides of the pier.
    weight : float
        Share of such mounts.
    """

    terms_arcsec: tuple[float, float, float, float, float, float]
    sigmas_arcsec: tuple[float, float, float, float, float, float]
    side_sigma_arcsec: float
    weight: float = 1.0


# Mean of the refraction and sag term TX, arcsec. Chosen by hand: its sigma of 35″ covers mounts that
# correct for refraction and mounts that don't.
_REFRACTION = 25.0

_CLASSES = (
    # all errors together about an arcminute
    Geometry((0, 0, 0, 0, 0, _REFRACTION), (60, 30, 60, 60, 30, 35), 90.0, 0.3),
    # set up by a polar scope
    Geometry((0, 0, 0, 0, 0, _REFRACTION), (300, 120, 480, 480, 120, 35), 900.0, 0.35),
    # set up by eye: polar axis up to a degree, cone up to 30′
    Geometry((0, 0, 0, 0, 0, _REFRACTION), (900, 240, 1800, 1800, 240, 35), 3600.0, 0.35),
)
_SKY_SYNC = 0.25
"""Share of mounts that keep a sync on the sky, not on the axes: at a flip the home's error shows twice."""

ORDINARY = (
    *(replace(one, weight=(1.0 - _SKY_SYNC) * one.weight) for one in _CLASSES),
    *(replace(one, weight=_SKY_SYNC * one.weight, side_sigma_arcsec=7200.0) for one in _CLASSES),
)
"""Mounts nothing is known of."""


def within(arcsec: float) -> tuple[Geometry, ...]:
    """Mounts known (by a model in force, or by their operator) to point within so many arcsec."""
    a = max(arcsec, 1.0)
    return (Geometry((0, 0, 0, 0, 0, 0.5 * _REFRACTION), (a, 0.5 * a, a, a, 0.5 * a, 35), 1.5 * a),)


def known(
    *,
    ch_arcsec: float,
    np_arcsec: float,
    me_arcsec: float,
    ma_arcsec: float,
    tf_arcsec: float = 0.0,
    tx_arcsec: float = 0.5 * _REFRACTION,
    sigma_arcsec: float = 30.0,
) -> tuple[Geometry, ...]:
    """A mount whose terms have been measured (by a model, by drift), each to `sigma_arcsec`."""
    s = sigma_arcsec
    terms = (ch_arcsec, np_arcsec, me_arcsec, ma_arcsec, tf_arcsec, tx_arcsec)
    return (Geometry(terms, (s, s, s, s, s, max(s, 35.0)), 2.0 * s),)


NOISES_ARCSEC = (4.0, 12.0, 30.0, 60.0, 100.0, 200.0, 400.0)
"""Repeatability of mounts per coordinate, solve not included."""
# Share of mounts at each repeatability of `NOISES_ARCSEC`; they sum to 1. Chosen by hand.
NOISE_WEIGHTS = (0.1, 0.2, 0.25, 0.25, 0.15, 0.04, 0.01)


def noise_weights(noise_arcsec: float | None) -> tuple[float, ...]:
    """Shares of the noise levels; round `noise_arcsec` (on the sky, both coordinates) if it is known."""
    if noise_arcsec is None:
        return NOISE_WEIGHTS
    off = [math.log(one * math.sqrt(2.0) / noise_arcsec) / 0.35 for one in NOISES_ARCSEC]
    shares = [math.exp(-0.5 * one**2) + 1e-4 for one in off]
    return tuple(one / sum(shares) for one in shares)


TURN_NOISES_ARCSEC = (30.0, 150.0, 900.0)
"""Of the image's direction, beyond that: bending focusers, slack adapters."""
# Share of cameras at each of `TURN_NOISES_ARCSEC`; they sum to 1. Chosen by hand.
TURN_WEIGHTS = (0.5, 0.3, 0.2)

SHAPES: dict[Illness | None, float] = {
    None: 0.90,
    Illness.EPOCH: 0.03,
    Illness.SLIPPED: 0.03,
    Illness.WRONG_LOOK: 0.02,
    Illness.HEMISPHERE: 0.002,
    Illness.UNKNOWN: 0.01,
}
"""Of the pattern of offsets, whatever the zero points; None: healthy."""

SLIP_SIGMA_DEG = 8.0
"""Of a slipped axis."""
# How far a wrong look lies from the truth, degrees, as a sigma for each coordinate. Chosen by hand.
WRONG_LOOK_SIGMA_DEG = 8.0

ZERO_SIGMA_DEG = 1.5
"""Zero points of a healthy mount: home marks, syncs on a wrong star's neighbor, an untouched polar axis."""
# Share of nights whose zero point was set by a sync near the pole. Chosen by hand.
POLE_SYNC = 0.005
POLE_SYNC_SIGMA_DEG = 10.0
"""A sync near the pole carries a cone error into the hour angle by its secant: 30′ at 87° are 10°."""
# Zero points of a mount that was never aligned, degrees. Chosen by hand.
UNALIGNED_SIGMA_DEG = 25.0
ZEROS: dict[Illness | None, float] = {
    None: 0.94,
    Illness.NOT_ALIGNED: 0.02,
    Illness.CLOCK: 0.02,
    Illness.LONGITUDE_SIGN: 0.01,
    Illness.LONGITUDE: 0.01,
}
"""Of the zero points; LONGITUDE stands for any turn about the pole, which a clock may be as well."""
HOUR_SHARES = {1: 0.35, -1: 0.35}
"""Of a clock that is wrong by whole hours: mostly daylight saving time, the other 22 share the rest."""

ALARM = 5e-3
"""Healthy must be less probable than this for anything to be called an illness. As far as the shares above
are right, a healthy mount is then called ill in less than one night of 2,000; the benchmark counts."""
SUSPICION = 0.5
"""Healthy less probable than this: something may be wrong."""
NAMED = 0.9
"""A cause is named alone from here on; below, its rivals are told with it."""

# Share of nights with images that are mirrored against the settings. Chosen by hand.
MIRRORED = 0.02
# Share of nights in which the mount's side of the pier is wrong. Chosen by hand.
PIER_SIDE = 0.02
# Share of nights in which the camera was turned on purpose. Chosen by hand.
CAMERA_TURNED = 0.02
FALSE_SOLVE = 1e-3
"""Of a solved frame."""
