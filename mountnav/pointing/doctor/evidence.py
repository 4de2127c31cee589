"""How probable the looks are under a hypothesis, with all that the mount's geometry may be integrated out.

First the mechanics: where a mount with geometry errors looks, for many observations at once, by rotations
that are exact at any size. The tests compare it with `mountnav.simulation.geometry`. It has two things that
the doctor needs and `mountnav.pointing.model.rigorous` lacks: many sets of terms at once (the derivatives of
a fit in one call), and the direction of the image (the solved rotation says something of the polar axis that
the position alone doesn't).

Then the fit: a mount's terms, its zero points and the hypothesis' own parameters are fitted (Gauss-Newton);
the evidence follows from the fit's curvature (Laplace's approximation), summed over classes of mounts and
noise levels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.pointing.doctor.facts import Array, Facts, wrapped
from mountnav.pointing.doctor.priors import (
    NOISE_WEIGHTS,
    NOISES_ARCSEC,
    TURN_NOISES_ARCSEC,
    TURN_WEIGHTS,
    Geometry,
)
from mountnav.units import RAD_PER_ARCSEC

GLOBAL = ("CH", "NP", "ME", "MA", "TF", "TX")


def _turned(a: Array, b: Array, angle: Array) -> tuple[Array, Array]:
    c, s = np.cos(angle), np.sin(angle)
    return a * c - b * s, a * s + b * c


def looks_at(lon: Array, lat: Array, terms: Array, axis_latitude: float) -> tuple[Array, Array]:
    """Direction of the tube and of its "up" for axis angles.

    Parameters
    ----------
    lon, lat : ndarray, shape (..., n)
        Axis angles, zero points included; beyond the pole past 90°.
    terms : ndarray, shape (..., 6)
        CH NP ME MA TF TX, rad [POINTING §5].

    Returns
    -------
    tube, up : ndarray, shape (..., n, 3)
        Unit vectors.
    """
    ch, np_, me, ma, tf, tx = (terms[..., number, None] for number in range(6))
    zero = np.zeros(np.broadcast_shapes(lon.shape, ch.shape))
    tube = _through(np.cos(ch) + zero, np.sin(ch) + zero, zero, lon, lat, np_, me, ma)
    up = _through(zero, zero, zero + 1.0, lon, lat, np_, me, ma)
    zenith = np.array([math.cos(axis_latitude), 0.0, math.sin(axis_latitude)])
    cos_z = tube @ zenith
    away = tube * cos_z[..., None] - zenith
    # sunk by TF sin z and TX tan z
    sunk = tube + (tf + tx / np.maximum(cos_z, 0.05))[..., None] * away
    return sunk / np.linalg.norm(sunk, axis=-1, keepdims=True), up


def _through(x: Any, y: Any, z: Any, lon: Any, lat: Any, np_: Any, me: Any, ma: Any) -> Array:
    x, z = _turned(x, z, lat)
    z, y = _turned(z, y, np_)
    x, y = _turned(x, y, lon)
    x, z = _turned(x, z, me)
    y, z = _turned(y, z, ma)
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


class Sky:
    """The tangent planes of the places seen, in which misses are counted."""

    def __init__(self, lon: Array, lat: Array, turned: Array) -> None:
        sin_lon, cos_lon, sin_lat, cos_lat = np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat)
        self.seen = np.column_stack((cos_lat * cos_lon, cos_lat * sin_lon, sin_lat))
        self.west = np.column_stack((-sin_lon, cos_lon, np.zeros_like(lon)))
        self.north = np.column_stack((-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat))
        self.turned = turned

    def misses(self, tube: Array, up: Array) -> tuple[Array, Array, Array]:
        """Predicted minus seen: west, north, and image angle (camera's own angle still in it), rad."""
        west = np.einsum("...ni,ni->...n", tube, self.west)
        north = np.einsum("...ni,ni->...n", tube, self.north)
        along = np.einsum("...ni,ni->...n", tube, self.seen)
        sine = np.hypot(west, north)
        stretch = np.where(sine > 1e-9, np.arctan2(sine, along) / np.maximum(sine, 1e-12), 1.0)
        angle = np.arctan2(
            -np.einsum("...ni,ni->...n", up, self.west), np.einsum("...ni,ni->...n", up, self.north)
        )
        return west * stretch, north * stretch, wrapped(angle - self.turned)


_ZERO_SIGMA = np.pi
# Most Gauss-Newton steps of a fit. Chosen by hand; a fit that isn't done by then is judged where it stands.
_ROUNDS = 8
# A fit has converged when no prediction changes by more than this, rad (0.5″): far below the smallest noise
# level, 4″. Doubled, still below it.
_DONE = 0.5 * RAD_PER_ARCSEC
# Step of the numerical derivatives, rad (0.4″). Chosen by hand between rounding and curvature.
_STEP = 2e-6
_GLOBALS = len(GLOBAL)


@dataclass(frozen=True, slots=True)
class Zeros:
    """Zero points as columns: what is added to each observation's axis angles.

    Attributes
    ----------
    lon, lat : ndarray, shape (n, q)
        How much of each unknown.
    sigma : ndarray, shape (q,)
        Its prior width, rad (or of no unit); NaN: the class' width between the sides of the pier.
    """

    lon: Array
    lat: Array
    sigma: Array
    names: tuple[str, ...]

    def with_columns(self, lon: Array, lat: Array, sigma: float, name: str) -> Zeros:
        """Add one unknown."""
        return Zeros(
            np.column_stack((self.lon, lon)),
            np.column_stack((self.lat, lat)),
            np.append(self.sigma, sigma),
            (*self.names, name),
        )


def zeros_of(facts: Facts) -> Zeros:
    """Each segment its own zero points, and a difference for the other side of the pier within it."""
    n = len(facts)
    lon, lat, sigma, names = [], [], [], []
    segments = np.array(facts.segments)
    for segment in dict.fromkeys(facts.segments):
        mask = (segments == segment).astype(float)
        masks = [(mask, _ZERO_SIGMA, "")]
        first = bool(facts.west[int(np.argmax(mask))])
        other = mask * (facts.west != first)
        if other.any():
            masks.append((other, np.nan, " other side"))
        for one, width, what in masks:
            for axis in ("IH", "ID"):
                lon.append(one if axis == "IH" else np.zeros(n))
                lat.append(one if axis == "ID" else np.zeros(n))
                sigma.append(width)
                names.append(f"{axis}{what} {segment}")
    return Zeros(np.column_stack(lon), np.column_stack(lat), np.array(sigma), tuple(names))


@dataclass(frozen=True, slots=True)
class Fitted:
    """A hypothesis fitted.

    Attributes
    ----------
    best : ndarray, shape (p,)
        CH NP ME MA TF TX (rad), the camera's angle, then the zero columns.
    covariance : ndarray, shape (p, p)
        Of the parameters.
    names : tuple of str
        Of the zero columns.
    noise_arcsec : float
        Most probable repeatability per coordinate.
    misses : ndarray, shape (n, 2)
        Seen minus fitted, west and north, rad.
    """

    log_evidence: float
    best: Array
    covariance: Array
    names: tuple[str, ...]
    noise_arcsec: float
    misses: Array

    def zero(self, name: str) -> tuple[float, float]:
        """Value and sigma of a zero column."""
        number = _GLOBALS + 1 + self.names.index(name)
        return float(self.best[number]), float(np.sqrt(self.covariance[number, number]))

    def term(self, name: str) -> tuple[float, float]:
        """Value and sigma of a term, arcsec."""
        number = GLOBAL.index(name)
        return float(self.best[number] / RAD_PER_ARCSEC), float(
            np.sqrt(self.covariance[number, number]) / RAD_PER_ARCSEC
        )


class Fit:
    """Fits of one set of observations; made once, asked for each hypothesis."""

    def __init__(
        self,
        facts: Facts,
        classes: tuple[Geometry, ...],
        beyond: NDArray[np.bool_],
        noise_weights: Sequence[float] = NOISE_WEIGHTS,
        *,
        use_turns: bool = True,
    ) -> None:
        self._facts, self._classes = facts, classes
        self._beyond, self._noise_weights = beyond, noise_weights
        self._turns = np.isfinite(facts.turned) & use_turns
        self._sky = Sky(facts.lon, facts.lat, np.where(self._turns, facts.turned, 0.0))
        self._seen_lon, self._seen_lat = self._mechanical(facts.lon, facts.lat)
        self._widest = np.max([one.sigmas_arcsec for one in classes], axis=0) * RAD_PER_ARCSEC
        self._middle = np.mean([one.terms_arcsec for one in classes], axis=0) * RAD_PER_ARCSEC

    def of_part(self, mask: NDArray[np.bool_]) -> Fit:
        """Make the fit of some of the observations."""
        part, use = self._facts.part(mask), bool(self._turns.any())
        return Fit(part, self._classes, self._beyond[mask], self._noise_weights, use_turns=use)

    def _mechanical(self, lon: Array, lat: Array) -> tuple[Array, Array]:
        """Axis angles of the side each look was made from."""
        pole = np.copysign(np.pi, self._facts.axis_latitude)
        return np.where(self._beyond, lon + np.pi, lon), np.where(self._beyond, pole - lat, lat)

    def fitted(self, read_lon: Array, read_lat: Array, zeros: Zeros, sense: float = 1.0) -> Fitted:
        """Fit one hypothesis.

        Parameters
        ----------
        read_lon, read_lat : ndarray, shape (n,)
            Readings as the hypothesis takes them.
        sense : {1, -1}
            -1: both axes count the other way.
        """
        lon, lat = self._mechanical(read_lon, read_lat)
        lon, lat = sense * lon, sense * lat
        extra = self._start(lon, lat, zeros)
        camera = self._camera(lon, lat, zeros, extra)
        x = np.concatenate((self._middle, [camera], extra))
        jacobian, miss = self._derived(lon, lat, zeros, x)
        rows = self._weights(np.array([60.0]), np.array([150.0]))[0]
        width = self._prior_sigma(zeros, self._widest, 3600.0 * RAD_PER_ARCSEC)
        middle = np.concatenate((self._middle, np.zeros(1 + extra.size)))
        middle[_GLOBALS] = x[_GLOBALS]
        for _ in range(_ROUNDS):
            a = (jacobian.T * rows) @ jacobian + np.diag(width**-2)
            step = np.linalg.solve(a, (jacobian.T * rows) @ -miss - (x - middle) / width**2)
            x = x + step
            jacobian, miss = self._derived(lon, lat, zeros, x)
            if float(np.max(np.abs(jacobian @ step))) < _DONE:
                break
        return self._evidence(zeros, x, middle, jacobian, miss)

    def _start(self, lon: Array, lat: Array, zeros: Zeros) -> Array:
        """Zero points from bare differences, cut at half turns as far from all of them as can be."""
        d_lon, d_lat = self._seen_lon - lon, self._seen_lat - lat
        d_lon = d_lon[0] + wrapped(d_lon - d_lon[0])
        d_lon = d_lon - 2.0 * np.pi * np.round(np.median(d_lon) / (2.0 * np.pi))
        d_lat = wrapped(d_lat)
        weight = np.maximum(np.abs(np.cos(self._facts.lat)), 0.05)
        rows = np.vstack((zeros.lon * weight[:, None], zeros.lat))
        right = np.concatenate((d_lon * weight, d_lat))
        # held a little, so that a difference of sides is nought unless it has to be something
        sigma = np.where(np.isnan(zeros.sigma), 0.05, zeros.sigma)
        ridge = np.diag((0.01 / sigma) ** 2)
        return np.linalg.solve(rows.T @ rows + ridge, rows.T @ right)

    def _camera(self, lon: Array, lat: Array, zeros: Zeros, extra: Array) -> float:
        if not self._turns.any():
            return 0.0
        tube = looks_at(
            lon + zeros.lon @ extra, lat + zeros.lat @ extra, self._middle, self._facts.axis_latitude
        )
        turn = -self._sky.misses(*tube)[2][self._turns]
        return float(np.angle(np.sum(np.exp(1j * turn))))

    def _derived(self, lon: Array, lat: Array, zeros: Zeros, x: Array) -> tuple[Array, Array]:
        """Jacobian, shape (3 n, p), and misses, shape (3 n,): west, north, turn."""
        n, q = lon.size, len(zeros.names)
        terms = np.repeat(x[None, :_GLOBALS], _GLOBALS + 3, axis=0)
        terms[np.arange(1, _GLOBALS + 1), np.arange(_GLOBALS)] += _STEP
        extra = x[_GLOBALS + 1 :]
        all_lon = np.repeat((lon + zeros.lon @ extra)[None], _GLOBALS + 3, axis=0)
        all_lat = np.repeat((lat + zeros.lat @ extra)[None], _GLOBALS + 3, axis=0)
        all_lon[-2] += _STEP
        all_lat[-1] += _STEP
        west, north, turn = self._sky.misses(*looks_at(all_lon, all_lat, terms, self._facts.axis_latitude))
        turn = np.where(self._turns, wrapped(turn + x[_GLOBALS]), 0.0)
        every = np.concatenate((west, north, turn), axis=1)
        slope = every[1:] - every[0]
        slope[:, 2 * n :] = wrapped(slope[:, 2 * n :])
        slope /= _STEP
        jacobian = np.empty((3 * n, _GLOBALS + 1 + q))
        jacobian[:, :_GLOBALS] = slope[:_GLOBALS].T
        jacobian[:, _GLOBALS] = np.concatenate((np.zeros(2 * n), self._turns.astype(float)))
        jacobian[:, _GLOBALS + 1 :] = (
            np.tile(zeros.lon, (3, 1)) * slope[-2][:, None] + np.tile(zeros.lat, (3, 1)) * slope[-1][:, None]
        )
        return jacobian, every[0]

    def _weights(self, noises_arcsec: Array, turns_arcsec: Array) -> Array:
        """Inverse variances of the rows for each pair of noises; shape (pairs, 3 n)."""
        place = self._facts.sigma**2 + (noises_arcsec[:, None] * RAD_PER_ARCSEC) ** 2
        turn = (turns_arcsec[:, None] * RAD_PER_ARCSEC) ** 2 + (noises_arcsec[:, None] * RAD_PER_ARCSEC) ** 2
        return np.concatenate((1.0 / place, 1.0 / place, self._turns / turn), axis=1)

    def _prior_sigma(self, zeros: Zeros, terms: Array, between_sides: float) -> Array:
        extra = np.where(np.isnan(zeros.sigma), between_sides, zeros.sigma)
        return np.concatenate((terms, [np.pi], extra))

    def _evidence(self, zeros: Zeros, x: Array, middle: Array, jacobian: Array, miss: Array) -> Fitted:
        noises = np.repeat(NOISES_ARCSEC, len(TURN_NOISES_ARCSEC))
        turns = np.tile(TURN_NOISES_ARCSEC, len(NOISES_ARCSEC))
        log_share = np.log(np.outer(self._noise_weights, TURN_WEIGHTS).ravel())
        if not self._turns.any():
            noises, turns = np.array(NOISES_ARCSEC), np.full(len(NOISES_ARCSEC), 150.0)
            log_share = np.log(self._noise_weights)
        rows = self._weights(noises, turns)
        used = rows[0] > 0.0
        rows, jacobian_used = rows[:, used], jacobian[used]
        right = (jacobian @ x - miss)[used]
        log_rows = 0.5 * np.log(rows / (2.0 * np.pi)).sum(axis=1)
        weighted = rows[:, :, None] * jacobian_used
        normal = np.swapaxes(weighted, 1, 2) @ jacobian_used
        logs, solved = [], []
        for one in self._classes:
            width = self._prior_sigma(
                zeros, np.array(one.sigmas_arcsec) * RAD_PER_ARCSEC, one.side_sigma_arcsec * RAD_PER_ARCSEC
            )
            expected = middle.copy()
            expected[:_GLOBALS] = np.array(one.terms_arcsec) * RAD_PER_ARCSEC
            y = right - jacobian_used @ expected
            b = np.einsum("krp,r->kp", weighted, y)
            a = normal + np.diag(width**-2)
            # balanced, so that widths from arcseconds to half turns don't spoil the factors
            scale = 1.0 / np.sqrt(np.einsum("kpp->kp", a))
            a *= scale[:, :, None] * scale[:, None, :]
            factor = np.linalg.cholesky(a)
            log_det = 2.0 * (np.log(np.einsum("kpp->kp", factor)) - np.log(scale)).sum(axis=1)
            best = scale * np.linalg.solve(a, (scale * b)[:, :, None])[:, :, 0]
            chi2 = np.einsum("kr,r->k", rows, y * y) - np.einsum("kp,kp->k", b, best)
            logs.append(
                np.log(one.weight) + log_share + log_rows - 0.5 * chi2 - 0.5 * log_det - np.log(width).sum()
            )
            solved.append((best + expected, a, scale))
        every = np.array(logs)
        number, pair = np.unravel_index(int(np.argmax(every)), every.shape)
        best, balanced, scale = (each[pair] for each in solved[number])
        n = len(self._facts)
        after = miss + jacobian @ (best - x)
        top = float(every.max())
        return Fitted(
            log_evidence=top + float(np.log(np.exp(every - top).sum())),
            best=best,
            covariance=np.linalg.inv(balanced) * np.outer(scale, scale),
            names=zeros.names,
            noise_arcsec=float(noises[pair]),
            misses=-np.column_stack((after[:n], after[n : 2 * n])),
        )
