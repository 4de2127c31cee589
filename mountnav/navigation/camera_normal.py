"""What is usual for a camera: medians over solves, which a minority of false ones doesn't move."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median

import numpy as np

from mountnav.devices import PierSide
from mountnav.navigation.camera_samples import CameraSample, Mounting

MAD_TO_SIGMA = 1.4826
_MEANINGLESS_DEG = 60.0
_STEADY_LEAN = 4.0
"""Angles are learned where the pole's error is magnified by no more than this (75.5° of declination)."""


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
        """Whether the mount told on which side of its pier the tube hung."""
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
    scale_arcsec_px, scale_sigma_arcsec_px : float
    parity : int
    camera_angle_deg, camera_angle_sigma_deg : float or None
        Of the image's +y axis, in the posture that looks west (ASCOM's east); None until enough agree.
    modulo_deg : float
        360; 180 if the mount doesn't tell its side, and so the angle is known but for half a turn.
    by_side : mapping of PierSide to float
        The same angle, from the solves of either side of the pier.
    distortion_px2, distortion_sigma_px2 : float or None
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
    parity = 1 if 2 * sum(one.parity > 0 for one in samples) > len(samples) else -1
    about = math.exp(median(math.log(one.scale_arcsec_px) for one in samples))
    agree = [one for one in samples if one.parity == parity and rules.same_scale(one.scale_arcsec_px, about)]
    if len(agree) < rules.enough or 2 * len(agree) <= len(samples):
        return None
    scale, scale_sigma = _median_sigma([one.scale_arcsec_px for one in agree])
    bends = [one.distortion_px2 for one in agree if one.distortion_px2 is not None]
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
    steady = [one for one in samples if one.cos_latitude * _STEADY_LEAN >= 1.0]
    modulo = min((rules.modulo_deg(one) for one in steady), default=360.0)
    center = _circular_median(np.array([rules.upright_deg(one) for one in steady]), modulo)
    if center is None:
        return None, None, modulo, {}
    agree = []
    for one in steady:
        allowed = rules.allowed_rotation_deg(one)
        if allowed is not None and abs(apart_deg(rules.upright_deg(one), center, modulo)) <= allowed:
            agree.append(one)
    if len(agree) < rules.enough or 2 * len(agree) <= len(steady):
        return None, None, modulo, {}
    off = [apart_deg(rules.upright_deg(one), center, modulo) for one in agree]
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


__all__ = ["CameraRules", "Normal", "apart_deg", "normal_of"]
