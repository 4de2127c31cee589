"""What a solved frame shows of the camera (scale, parity, distortion, angle), and what is usual for it.

The usual values are medians over solves, which a minority of false ones doesn't move.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from statistics import median
from typing import Any, Literal, TypeVar

import numpy as np

from mountnav.devices import PierSide
from mountnav.navigation.reports import Look
from mountnav.sky.chain import icrs_to_hour_angle, icrs_to_observed
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Observed, Site
from mountnav.sky.sphere import (
    displaced,
    half_turn_deg,
    position_angle_deg,
    separation_arcsec,
    turn_deg,
)
from mountnav.solution import Solution

__all__ = [
    "CameraRules",
    "CameraSample",
    "Mounting",
    "Normal",
    "apart_deg",
    "axis_angle_deg",
    "camera_sample",
    "distortion_px2",
    "normal_of",
    "sample_row",
    "samples_of_rows",
    "sound",
]


Mounting = Literal["german", "fork", "altaz"]

_TRANSPORTED_DEG = 5.0
"""A mount that is further off than this is lost, and its reading says nothing of its axes, °. Chosen by hand.
Doubled, looks of a mount that was set up by eye teach a wrong angle of the camera."""
_PAIRS_FOR_DISTORTION = 30
"""With fewer identified stars the distortion isn't taken from their residuals: they scatter too
much. Chosen by hand. Doubled, poor fields teach nothing of it."""


@dataclass(frozen=True, slots=True)
class CameraSample:
    """One solve, as `Learned` takes it.

    Attributes
    ----------
    axis_angle_deg : float
        Position angle of the image's +y axis from the mount's own north (an alt-azimuth mount's zenith).
    cos_latitude : float
        Of the believed place in the mount's frame: what a pole's error is divided by.
    side : PierSide
        As the mount says.
    distortion_px2 : float or None
        Cubic radial: a star at distance r from the center appears at r·(1 + distortion_px2·r²).
    """

    look_id: str
    utc: datetime
    scale_arcsec_px: float
    parity: int
    axis_angle_deg: float
    cos_latitude: float
    side: PierSide = PierSide.UNKNOWN
    distortion_px2: float | None = None


def camera_sample(
    found: Look, site: Site, air: Air, mounting: Mounting | None, *, lost: bool = False
) -> CameraSample:
    """Take from a look what it shows of the camera.

    Parameters
    ----------
    mounting : {"german", "fork", "altaz"} or None
        None: not known.
    lost : bool
        The mount doesn't know where it points: its belief is left out.
    """
    angle_deg, cos_latitude = axis_angle_deg(
        found.seen,
        found.seen if lost else found.believed,
        found.solution.rotation_deg,
        found.mid_exposure_utc,
        site,
        air,
        mounting,
    )
    return CameraSample(
        look_id=found.look_id,
        utc=found.mid_exposure_utc,
        scale_arcsec_px=found.solution.scale_arcsec_px,
        parity=found.solution.parity,
        axis_angle_deg=angle_deg,
        cos_latitude=cos_latitude,
        side=found.after.pier_side or PierSide.UNKNOWN,
        distortion_px2=distortion_px2(found.solution),
    )


def axis_angle_deg(
    seen: Icrs,
    believed: Icrs,
    rotation_deg: float,
    utc: datetime,
    site: Site,
    air: Air,
    mounting: Mounting | None,
) -> tuple[float, float]:
    """Angle of the image's +y axis in the mount's own frame, and the cosine of the latitude there.

    Parameters
    ----------
    rotation_deg : float
        Position angle of +y at `seen`, from the ICRS north through east.
    mounting : {"german", "fork", "altaz"} or None
        Anything but "altaz" turns about a polar axis.

    Returns
    -------
    angle_deg, cos_latitude : float
        In [0, 360), and [0, 1].
    """
    north = displaced(seen, 0.0, 60.0)
    if mounting == "altaz":
        at, up, there = (icrs_to_observed(place, utc, site, air) for place in (seen, north, believed))
        angle_deg, latitude_deg = _transported(at, up, there, rotation_deg), there.alt_deg
    else:
        here, pole, axis = (icrs_to_hour_angle(place, utc, site, air) for place in (seen, north, believed))
        angle_deg, latitude_deg = _transported(here, pole, axis, rotation_deg), axis.dec_deg
    return turn_deg(angle_deg), max(0.0, math.cos(math.radians(latitude_deg)))


_Seen = TypeVar("_Seen", HourAngle, Observed)


def _transported(at: _Seen, north: _Seen, there: _Seen, rotation_deg: float) -> float:
    """The angle at `at`, counted from this frame's north, carried along the great circle to `there`."""
    # azimuths grow the other way round on the sky than position angles
    sense = -1.0 if isinstance(at, Observed) else 1.0
    angle_deg = rotation_deg + sense * position_angle_deg(at, north)
    apart_arcsec = separation_arcsec(at, there)
    if not 0.01 < apart_arcsec < _TRANSPORTED_DEG * 3600.0:
        return angle_deg
    leaves = position_angle_deg(at, there)
    arrives = position_angle_deg(there, at) + 180.0
    return angle_deg + sense * half_turn_deg(arrives - leaves)


def distortion_px2(solution: Solution) -> float | None:
    """Cubic radial distortion: from the SIP terms, or from the pairs' residuals if the plate has none.

    Returns
    -------
    float or None
        Per square pixel; None when there are too few stars.
    """
    order = solution.wcs.get("A_ORDER", 0)
    if isinstance(order, int) and order >= 3:
        terms = [solution.wcs.get(name, 0.0) for name in ("A_3_0", "A_1_2", "B_2_1", "B_0_3")]
        # SIP leads from where a star appears to where it belongs
        return -sum(float(term) for term in terms) / 4.0
    return _from_residuals(solution)


def _from_residuals(solution: Solution) -> float | None:
    pairs = solution.identified
    used = np.flatnonzero(pairs.used) if len(pairs) else np.zeros(0, dtype=int)
    width, height = solution.wcs.get("IMAGEW"), solution.wcs.get("IMAGEH")
    if used.size < _PAIRS_FOR_DISTORTION or not isinstance(width, int) or not isinstance(height, int):
        return None
    matrix = np.array(
        [[float(solution.wcs[f"CD{row}_{column}"]) for column in (1, 2)] for row in (1, 2)], dtype=float
    )
    off = np.linalg.solve(matrix * 3600.0, np.stack([pairs.dx_arcsec[used], pairs.dy_arcsec[used]]))
    u, v = pairs.x_px[used] - (width - 1) / 2.0, pairs.y_px[used] - (height - 1) / 2.0
    unit = max(width, height) / 2.0
    a, b = u / unit, v / unit
    square = a * a + b * b
    zero, one = np.zeros_like(a), np.ones_like(a)
    # what the plate has taken up of it is linear, so the linear terms are free here
    rows = np.vstack(
        [
            np.column_stack([one, a, b, zero, zero, zero, a * square]),
            np.column_stack([zero, zero, zero, one, a, b, b * square]),
        ]
    )
    fitted = np.linalg.lstsq(rows, np.concatenate([off[0], off[1]]), rcond=None)[0]
    return float(fitted[6]) / unit**3


def sound(sample: CameraSample) -> bool:
    """Whether its values are numbers that a camera can have."""
    return (
        math.isfinite(sample.scale_arcsec_px)
        and sample.scale_arcsec_px > 0.0
        and math.isfinite(sample.axis_angle_deg)
        and sample.parity in (1, -1)
    )


def sample_row(sample: CameraSample) -> dict[str, Any]:
    """Make JSON values of it."""
    return asdict(sample) | {"utc": sample.utc.isoformat(), "side": str(sample.side)}


def samples_of_rows(rows: object) -> list[CameraSample]:
    """Make samples of such values; what can't be read is left out."""
    found = [_sample(row) for row in rows if isinstance(row, Mapping)] if isinstance(rows, list) else []
    return [sample for sample in found if sample is not None and sound(sample)]


def _sample(row: Mapping[str, Any]) -> CameraSample | None:
    try:
        bend = row["distortion_px2"]
        return CameraSample(
            look_id=str(row["look_id"]),
            utc=datetime.fromisoformat(row["utc"]),
            scale_arcsec_px=float(row["scale_arcsec_px"]),
            parity=int(row["parity"]),
            axis_angle_deg=float(row["axis_angle_deg"]),
            cos_latitude=float(row["cos_latitude"]),
            side=PierSide(row["side"]),
            distortion_px2=None if bend is None else float(bend),
        )
    except (KeyError, TypeError, ValueError):
        return None


MAD_TO_SIGMA = 1.4826
"""Sigma of a Gaussian over its median absolute deviation, 1 / Φ⁻¹(3/4): a constant of mathematics."""
_MEANINGLESS_DEG = 60.0
"""Where the rotation may be off by this much or more, °, it isn't judged: near the pole the polar error turns
the field. Chosen by hand. Doubled, a camera turned by 90° would pass."""
_STEADY_LEAN = 4.0
"""Angles are learned where the pole's error is magnified by no more than this (75.5° of declination). Chosen
by hand. Doubled (83° of declination), the angle learned near the pole is off by eight times the polar
error."""


@dataclass(frozen=True, slots=True)
class CameraRules:
    """When two solves show the same camera.

    Attributes
    ----------
    mounting : {"german", "fork", "altaz"} or None
        German mounts turn the camera by 180° on the other side of the pier.
    scale_tolerance, rotation_tolerance_deg, polar_error_deg : float
        As of `SyncPolicy`.
    enough : int
        So many must agree, and more than half of all, before they count.
    """

    mounting: Mounting | None = None
    scale_tolerance: float = 0.02
    rotation_tolerance_deg: float = 5.0
    polar_error_deg: float = 1.0
    enough: int = 3

    def same_scale(self, one: float, other: float) -> bool:
        """Whether two scales differ by no more than the tolerance."""
        return abs(math.log(one / other)) <= self.scale_tolerance

    def sided(self, sample: CameraSample) -> bool:
        """Whether the mount reported on which side of its pier the tube hung."""
        return sample.side is not PierSide.UNKNOWN and self.mounting not in ("fork", "altaz")

    def modulo_deg(self, sample: CameraSample) -> float:
        """What the sample's angle is known modulo: half a turn if the side is unknown."""
        return 360.0 if self.mounting in ("fork", "altaz") or self.sided(sample) else 180.0

    def upright_deg(self, sample: CameraSample) -> float:
        """Its angle as it would be in the posture that looks west (ASCOM's east)."""
        turned = 180.0 if self.sided(sample) and sample.side is PierSide.WEST else 0.0
        return (sample.axis_angle_deg - turned) % 360.0

    def allowed_rotation_deg(self, sample: CameraSample) -> float | None:
        """How far the rotation may be off at the sample's place; None where it says nothing: at the pole."""
        allowed = self.rotation_tolerance_deg + self.polar_error_deg / max(sample.cos_latitude, 1e-6)
        return allowed if allowed < _MEANINGLESS_DEG else None


@dataclass(frozen=True, slots=True)
class Normal:
    """Running medians, with their one-sigma scatter (1.4826 MAD).

    Attributes
    ----------
    solves : int
        How many agree.
    camera_angle_deg, camera_angle_sigma_deg : float or None
        Of the image's +y axis, in the posture that looks west (ASCOM's east); None until enough agree.
    modulo_deg : float
        360; 180 if the mount doesn't report its side, and so the angle is known but for half a turn.
    by_side : mapping of PierSide to float
        The same angle, from the solves of either side of the pier.
    """

    solves: int
    scale_arcsec_px: float
    scale_sigma_arcsec_px: float
    parity: int
    camera_angle_deg: float | None = None
    camera_angle_sigma_deg: float | None = None
    modulo_deg: float = 360.0
    by_side: Mapping[PierSide, float] = field(default_factory=dict)
    distortion_px2: float | None = None
    distortion_sigma_px2: float | None = None


def normal_of(samples: Sequence[CameraSample], rules: CameraRules) -> Normal | None:
    """The medians of what the majority of samples agrees on, in whatever order they came.

    Returns
    -------
    Normal or None
        None if fewer than `rules.enough`, or no more than half of all, agree on scale and parity.
    """
    if len(samples) < rules.enough:
        return None
    parity = 1 if 2 * sum(sample.parity > 0 for sample in samples) > len(samples) else -1
    about = math.exp(median(math.log(sample.scale_arcsec_px) for sample in samples))
    agree = [
        sample
        for sample in samples
        if sample.parity == parity and rules.same_scale(sample.scale_arcsec_px, about)
    ]
    if len(agree) < rules.enough or 2 * len(agree) <= len(samples):
        return None
    scale, scale_sigma = _median_sigma([sample.scale_arcsec_px for sample in agree])
    bends = [sample.distortion_px2 for sample in agree if sample.distortion_px2 is not None]
    bend, bend_sigma = _median_sigma(bends) if len(bends) >= rules.enough else (None, None)
    angle, angle_sigma, modulo, by_side = _angle(agree, rules)
    return Normal(
        solves=len(agree),
        scale_arcsec_px=scale,
        scale_sigma_arcsec_px=scale_sigma,
        parity=parity,
        camera_angle_deg=angle,
        camera_angle_sigma_deg=angle_sigma,
        modulo_deg=modulo,
        by_side=by_side,
        distortion_px2=bend,
        distortion_sigma_px2=bend_sigma,
    )


def apart_deg(one_deg: float, other_deg: float, modulo_deg: float = 360.0) -> float:
    """One angle minus the other, within half of what counts as the same."""
    half = modulo_deg / 2.0
    return (one_deg - other_deg + half) % modulo_deg - half


def _angle(
    samples: Sequence[CameraSample], rules: CameraRules
) -> tuple[float | None, float | None, float, dict[PierSide, float]]:
    """Camera angle, its scatter, what it is known modulo, and the same by side."""
    steady = [sample for sample in samples if sample.cos_latitude * _STEADY_LEAN >= 1.0]
    modulo = min((rules.modulo_deg(sample) for sample in steady), default=360.0)
    center = _circular_median(np.array([rules.upright_deg(sample) for sample in steady]), modulo)
    if center is None:
        return None, None, modulo, {}
    agree = []
    for sample in steady:
        allowed = rules.allowed_rotation_deg(sample)
        if allowed is not None and abs(apart_deg(rules.upright_deg(sample), center, modulo)) <= allowed:
            agree.append(sample)
    if len(agree) < rules.enough or 2 * len(agree) <= len(steady):
        return None, None, modulo, {}
    off = [apart_deg(rules.upright_deg(sample), center, modulo) for sample in agree]
    middle, sigma = _median_sigma(off)
    by_side = {}
    for side in (PierSide.EAST, PierSide.WEST):
        of_side = [value for one, value in zip(agree, off, strict=True) if one.side is side]
        if of_side:
            by_side[side] = (center + median(of_side)) % modulo
    return (center + middle) % modulo, sigma, modulo, by_side


def _circular_median(angles_deg: np.ndarray, modulo_deg: float) -> float | None:
    """That one of the angles from which all are least away in sum; the smallest of equals."""
    if angles_deg.size == 0:
        return None
    sorted_deg = np.sort(angles_deg % modulo_deg)
    half = modulo_deg / 2.0
    away = np.abs((sorted_deg[:, None] - sorted_deg[None, :] + half) % modulo_deg - half).sum(axis=1)
    return float(sorted_deg[int(np.argmin(np.round(away, 9)))])


def _median_sigma(values: Sequence[float]) -> tuple[float, float]:
    middle = median(values)
    return middle, MAD_TO_SIGMA * median(abs(value - middle) for value in values)
