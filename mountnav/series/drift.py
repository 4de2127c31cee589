"""Drift of a series: jumps cut it into segments, and each segment's centers give a rate with its error."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.sky.sphere import half_turn_deg

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEAST_FRAMES = 3
"""Fewer points give no drift: two always lie on a line, and the rate has no error."""
JUMP_MADS = 8.0
"""A step that departs from the usual rate by more than so many times the scatter of the steps (by their
median departure) is a jump. Chosen by hand."""
FEW_STEPS = 4
"""With fewer steps than this the usual rate is that of the calmest one, and no scatter of the steps is
known."""
FEWEST_FOR_OUTLIERS = 5
"""Points; of fewer none can be shown to be the wrong one, and the calm of the rest is chance."""
FEWEST_FOR_CORRELATION = 6
"""Points; of fewer the correlation of neighbors can't be distinguished from chance."""
MOST_CORRELATED = 0.97
"""So alike are neighbors at most held to be: the error is eight times that of independent ones then."""
ONE_SIGMA = 0.8413447460685429
"""Share of a normal deviate below one sigma."""
TUKEY = 4.685
"""Residuals beyond so many of their scatter have no weight: Tukey's biweight at the usual constant, which has
95 % efficiency for normal errors."""
MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution per median absolute deviation."""


@dataclass(frozen=True, slots=True)
class Track:
    """Centers over time; each array has shape (n,), in order of time.

    Attributes
    ----------
    minutes : ndarray
        Since any instant.
    ra_deg, dec_deg : ndarray
        Centers.
    sigma_arcsec : ndarray
        Error per coordinate of each center relative to its anchor.
    anchor : ndarray of int
        Which solved frame each was followed from; centers with the same anchor share its error.
    anchor_sigma_arcsec : ndarray
        Error per coordinate of that frame's own center.
    scale_sigma : float
        Relative error of the anchors' scale, and of their turn in radians. What was followed is wrong by that
        share of its way, all of it alike: no number of frames averages it away.
    """

    minutes: Array
    ra_deg: Array
    dec_deg: Array
    sigma_arcsec: Array
    anchor: Index
    anchor_sigma_arcsec: Array
    scale_sigma: float = 0.0

    def __len__(self) -> int:
        return int(self.minutes.size)

    def part(self, start: int, stop: int) -> Track:
        """Points start to stop."""
        return Track(
            self.minutes[start:stop],
            self.ra_deg[start:stop],
            self.dec_deg[start:stop],
            self.sigma_arcsec[start:stop],
            self.anchor[start:stop],
            self.anchor_sigma_arcsec[start:stop],
            self.scale_sigma,
        )

    def east_north_arcsec(self) -> tuple[Array, Array]:
        """Δα·cos δ (δ: the mean of the track) and Δδ from the first point, arcsec; shape (n,) each."""
        cosine = math.cos(math.radians(float(np.mean(self.dec_deg))))
        east = np.array([half_turn_deg(float(off_deg)) for off_deg in self.ra_deg - self.ra_deg[0]])
        return east * 3600.0 * cosine, (self.dec_deg - self.dec_deg[0]) * 3600.0


@dataclass(frozen=True, slots=True)
class Drift:
    """Rates at which the frame's center moves over the sky.

    Attributes
    ----------
    ra_arcsec_min, dec_arcsec_min : float
        d(α)/dt · cos δ, and d(δ)/dt.
    ra_sigma_arcsec_min, dec_sigma_arcsec_min : float
        Standard errors, scaled up by the scatter about the straight line where that exceeds the errors.
    rms_arcsec : float
        Scatter about the line, both coordinates in quadrature.
    frames : int
        Points in the fit.
    outliers : int
        Points of next to no weight.
    """

    ra_arcsec_min: float
    dec_arcsec_min: float
    ra_sigma_arcsec_min: float
    dec_sigma_arcsec_min: float
    rms_arcsec: float
    frames: int
    outliers: int


def jumps(track: Track, least_arcsec: float) -> list[int]:
    """Find where a series jumps: dithers, slews, a slipped mount.

    Parameters
    ----------
    least_arcsec : float
        Nothing smaller counts.

    Returns
    -------
    list of int
        Points that a jump led to. A step is a jump when it departs from the median rate by more than
        `least_arcsec`, by more than 8 times the median departure, and by more than 5 of its errors.
    """
    if len(track) < 2:
        return []
    east, north = track.east_north_arcsec()
    step = np.diff(east) + 1j * np.diff(north)
    gap = np.maximum(np.diff(track.minutes), 1e-6)
    rate = step / gap
    if rate.size < FEW_STEPS:
        usual = complex(rate[int(np.argmin(np.abs(rate)))])  # of two or three steps the calmest
    else:
        usual = complex(float(np.median(rate.real)), float(np.median(rate.imag)))
    off = np.abs(step - usual * gap)
    scatter = MAD_TO_SIGMA * float(np.median(off)) if rate.size >= FEW_STEPS else 0.0
    variance = track.sigma_arcsec[1:] ** 2 + track.sigma_arcsec[:-1] ** 2
    changed = track.anchor[1:] != track.anchor[:-1]
    variance += np.where(
        changed, track.anchor_sigma_arcsec[1:] ** 2 + track.anchor_sigma_arcsec[:-1] ** 2, 0.0
    )
    limit = np.maximum(max(least_arcsec, JUMP_MADS * scatter), 5.0 * np.sqrt(variance))
    return [int(step) + 1 for step in np.flatnonzero(off > limit)]


def fit_drift(track: Track) -> Drift | None:
    """Fit straight lines to a segment's centers, by weighted, robust regression.

    Centers followed from one solved frame share its error: an offset of each solved frame but the first is
    fitted too, held to zero by that frame's error. A wrong center is weighted down (Tukey's biweight).

    Parameters
    ----------
    track : Track
        Without jumps.

    Returns
    -------
    Drift or None
        None for fewer than three points, or for points of one instant.
    """
    if len(track) < LEAST_FRAMES or float(np.ptp(track.minutes)) <= 0.0:
        return None
    east, north = track.east_north_arcsec()
    from scipy import special  # 0.2 s that a service does not need to start

    time = track.minutes - float(track.minutes.mean())
    columns, ties = _columns(track, time)
    floor = max(1e-4, 0.1 * float(np.median(track.sigma_arcsec)))
    sigma = np.maximum(track.sigma_arcsec, floor)
    robust = np.ones(len(track))
    for _ in range(12):
        root = np.sqrt(robust) / sigma
        rows = np.vstack((columns * root[:, None], ties))
        right = np.zeros((rows.shape[0], 2))
        right[: len(track)] = np.column_stack((east, north)) * root[:, None]
        got = np.linalg.lstsq(rows, right, rcond=None)[0]
        rest = np.column_stack((east, north)) - columns @ got
        z = np.hypot(rest[:, 0], rest[:, 1]) / sigma
        scatter = max(1.0, float(np.median(z)) / 1.1774)  # the median of a Rayleigh deviate
        weight = np.clip(1.0 - (z / (TUKEY * scatter)) ** 2, 0.0, None) ** 2
        if len(track) < FEWEST_FOR_OUTLIERS or float(np.max(np.abs(weight - robust))) < 1e-3:
            break
        robust = np.where(np.sum(weight > 0.1) >= LEAST_FRAMES, weight, robust)
    inverse = np.linalg.pinv(rows.T @ rows)
    free = max(float(robust.sum()) - 2.0, 1.0)
    chi2 = (robust[:, None] * (rest / sigma[:, None]) ** 2).sum(axis=0) / free
    # the scatter of few points is itself hardly known: its share of the error is Student's
    student = float(special.stdtrit(free, ONE_SIGMA))
    # by chance one axis of few points is calm: it is held to be no calmer than both together
    chi2 = np.maximum(chi2, chi2.mean())
    errors = np.sqrt(inverse[1, 1] * np.maximum(chi2 * student**2, 1.0))
    errors = errors * _serial_factor(rest / sigma[:, None], robust)
    errors = np.hypot(errors, track.scale_sigma * float(np.hypot(got[1, 0], got[1, 1])))
    return Drift(
        ra_arcsec_min=float(got[1, 0]),
        dec_arcsec_min=float(got[1, 1]),
        ra_sigma_arcsec_min=float(errors[0]),
        dec_sigma_arcsec_min=float(errors[1]),
        rms_arcsec=float(np.sqrt((robust[:, None] * rest**2).sum() / robust.sum())),
        frames=len(track),
        outliers=int((robust < 0.1).sum()),
    )


def _serial_factor(z: Array, weight: Array) -> float:
    """By how much a line's error exceeds that of independent residuals.

    Seeing, wind and a worm's period make neighbors alike; then n residuals say as little of a rate as
    n (1 - ρ) / (1 + ρ) independent ones, with ρ their correlation from one to the next [AR(1); e.g.
    Priestley, Spectral Analysis and Time Series, 5.3]. The estimate of ρ about a fitted line is low by
    (2 + 4 ρ) / n, which is given back.

    Parameters
    ----------
    z : ndarray, shape (n, 2)
        Residuals in units of their errors.
    weight : ndarray, shape (n,)
        One a residual.

    Returns
    -------
    float
        1 or more.
    """
    count = len(z)
    if count < FEWEST_FOR_CORRELATION:
        return 1.0
    scaled = z * np.sqrt(weight)[:, None]
    power = float((scaled**2).sum())
    if power == 0.0:
        return 1.0
    rho = float((scaled[1:] * scaled[:-1]).sum()) / power
    rho = min(max((count * rho + 2.0) / (count - 4.0), 0.0), MOST_CORRELATED)
    return math.sqrt((1.0 + rho) / (1.0 - rho))


def joined(drifts: list[Drift]) -> Drift | None:
    """Weighted mean of segments' rates; errors grow where the segments disagree.

    Returns
    -------
    Drift or None
        None if there is none.
    """
    if len(drifts) < 2:
        return drifts[0] if drifts else None
    rates = np.array([(drift.ra_arcsec_min, drift.dec_arcsec_min) for drift in drifts])
    errors = np.array([(drift.ra_sigma_arcsec_min, drift.dec_sigma_arcsec_min) for drift in drifts])
    weight = 1.0 / np.maximum(errors, 1e-9) ** 2
    mean = (weight * rates).sum(axis=0) / weight.sum(axis=0)
    chi2 = (weight * (rates - mean) ** 2).sum(axis=0) / (len(drifts) - 1)
    sigma = np.sqrt(np.maximum(chi2, 1.0) / weight.sum(axis=0))
    frames = np.array([drift.frames for drift in drifts], dtype=float)
    rms = np.array([drift.rms_arcsec for drift in drifts])
    return Drift(
        float(mean[0]),
        float(mean[1]),
        float(sigma[0]),
        float(sigma[1]),
        float(np.sqrt((frames * rms**2).sum() / frames.sum())),
        int(frames.sum()),
        sum(drift.outliers for drift in drifts),
    )


def _columns(track: Track, time: Array) -> tuple[Array, Array]:
    """Columns of the fit (1, time, one for each anchor but the first), and rows that hold those offsets."""
    names, first = np.unique(track.anchor, return_index=True)
    order = np.argsort(first)
    others = names[order][1:]
    columns = np.column_stack(
        [np.ones(len(track)), time, *((track.anchor == name).astype(float) for name in others)]
    )
    ties = np.zeros((others.size, columns.shape[1]))
    of_first = float(track.anchor_sigma_arcsec[first[order][0]])
    for number, place in enumerate(first[order][1:]):
        ties[number, 2 + number] = 1.0 / max(
            math.hypot(of_first, float(track.anchor_sigma_arcsec[place])), 1e-3
        )
    return columns, ties
