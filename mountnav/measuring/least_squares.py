"""The fit of PSFs to many cutouts at once: a damped Gauss-Newton iteration [S23 §0.2]."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.cutouts import Cutouts
from mountnav.measuring.psf import LEAST_VARIANCE_PX2, NODE_WEIGHTS, NODES, Array, Psf, Reals, ShapePrior

Pixels = NDArray[np.float32]

ROUNDS = 12
"""So many steps at most, unless the caller sets another number."""
PARAMETERS = 7
"""Amplitude, x, y, p, q, r, local sky."""
_STILL_PX = 5e-4
"""A star whose position moves by less than this in a step, px, has converged: a fifth of the error of the
best stars (docs/figures/measuring.md)."""
_STRAGGLERS = 0.03
"""Share of stars that may still move when the iteration ends: what doesn't converge never ends it."""
_REPACK_BELOW = 0.7
"""Share of moving stars below which the iteration goes on with those alone: copying them costs about a
step."""
_COST_ROUNDING = 1e-6
"""Relative rise of χ² that is rounding in single precision and no step in the wrong direction."""
_NARROWEST_SIGMA_PX = 0.3
"""Least width σ of a fit, px: a hot pixel's."""
_SHAPE = np.arange(3, 6)
"""Where p, q, r stand among the parameters."""


@dataclass(frozen=True, slots=True)
class Fit:
    """The state of a fit: parameters (n, 7), their information matrix (n, 7, 7), residuals and slopes."""

    params: Array
    normal: Array
    residual: Reals
    jacobian: Reals
    weights: Reals

    def part(self, some: NDArray[np.bool_]) -> Fit:
        """Those of some sources."""
        return Fit(
            self.params[some], self.normal[some], self.residual[some], self.jacobian[some], self.weights[some]
        )


def fit_psfs(
    cutouts: Cutouts,
    x_px: Array,
    y_px: Array,
    width_px: float,
    psf: Psf,
    *,
    shape: ShapePrior | None = None,
    rounds: int = ROUNDS,
    height: Array | None = None,
) -> Fit:
    """Do the work of `psf_fitting.fit_profiles`; the fit's inside is for callers that judge its residuals."""
    count = cutouts.values.shape[0]
    # single precision for the pixels, double for what is fitted: noise is far coarser than either
    dx, dy = cutouts.dx[None, :].astype(np.float32), cutouts.dy[None, :].astype(np.float32)
    half = float(cutouts.dx.max())
    mask = cutouts.good
    values = np.where(mask, cutouts.values, 0.0).astype(np.float32)
    variance = cutouts.variance.astype(np.float32)
    start_u = dx - (x_px - cutouts.x0)[:, None].astype(np.float32)
    start_v = dy - (y_px - cutouts.y0)[:, None].astype(np.float32)
    form = np.exp(-0.5 * (start_u * start_u + start_v * start_v) / np.float32(width_px**2)) * mask
    amplitude = np.maximum((values * form).sum(axis=1) / np.maximum((form * form).sum(axis=1), 1e-3), 1e-9)
    inverse = 1.0 / width_px**2
    kept = np.zeros((count, PARAMETERS))
    kept[:, 0] = amplitude if height is None else height
    kept[:, 1], kept[:, 2] = x_px - cutouts.x0, y_px - cutouts.y0
    kept[:, 3], kept[:, 5] = inverse, inverse
    mean, precision = np.zeros(3), np.zeros((count, 3))
    if shape is not None:
        mean = np.array([shape.p, shape.q, shape.r])
        precision[:] = shape.precision()
        kept[:, 3:6] = mean
    widest = half * 0.8
    coarse = replace(psf, integrated=False)
    now = coarse
    weights = _weights(kept, dx, dy, mask, variance, coarse)
    whole = _GaussNewton(values, mask, variance, precision, mean, weights, kept, np.full(count, 1e-2))
    whole.restart(dx, dy, now)
    some, index = whole, None
    switch = min(3, rounds // 2 - 1) if psf.integrated else -1
    for turn in range(rounds):
        moving = some.step(dx, dy, now, half, widest)
        if turn in (1, 2):  # the photons' share of the variance follows the model, twice
            some.weigh(dx, dy, coarse)
        if turn == switch:
            # near enough to separate the pixels' width from the star's
            now = psf
            some.params[:, 0] *= some.params[:, 0] / np.maximum(seen_amplitude(some.params), 1e-12)
            some.damping = np.full(count, 1e-3)
            some.restart(dx, dy, now)
        if turn < max(3, switch + 2):
            continue
        if np.count_nonzero(moving) <= _STRAGGLERS * count:
            break
        if np.count_nonzero(moving) < _REPACK_BELOW * moving.size:  # go on with those alone
            whole.put(index, some)
            index = np.flatnonzero(moving) if index is None else index[moving]
            some = whole.part(index)
    whole.put(index, some)
    weights = _weights(whole.params, dx, dy, mask, variance, now)
    normal = _information(whole.jacobian, weights, precision)[0]
    return Fit(whole.params, normal, whole.residual, whole.jacobian, weights)


@dataclass(slots=True)
class _GaussNewton:
    """Damped Gauss-Newton of many cutouts at once: what it works on, and how far it has come."""

    values: Pixels
    mask: NDArray[np.bool_]
    variance: Pixels
    precision: Array
    mean: Array
    weights: Pixels
    params: Array
    damping: Array
    jacobian: Pixels = field(default_factory=lambda: np.zeros((0, 0, 0), dtype=np.float32))
    residual: Pixels = field(default_factory=lambda: np.zeros((0, 0), dtype=np.float32))
    cost: Array = field(default_factory=lambda: np.zeros(0))

    def restart(self, dx: Pixels, dy: Pixels, psf: Psf) -> None:
        """Start (again) from the parameters as they are."""
        self.jacobian, self.residual = _linear(self.params, dx, dy, self.values, psf)
        self.cost = self._costs(self.params, self.residual)

    def weigh(self, dx: Pixels, dy: Pixels, psf: Psf) -> None:
        """Renew the weights by the model as it is."""
        self.weights = _weights(self.params, dx, dy, self.mask, self.variance, psf)
        self.cost = self._costs(self.params, self.residual)

    def step(self, dx: Pixels, dy: Pixels, psf: Psf, half: float, widest: float) -> NDArray[np.bool_]:
        """Take one step where it lowers the cost; return which positions still move."""
        normal, weighted = _information(self.jacobian, self.weights, self.precision)
        gradient = (weighted @ self.residual[:, :, None])[:, :, 0].astype(np.float64)
        gradient[:, 3:6] += self.precision * (self.mean - self.params[:, 3:6])
        step = _solve(normal, gradient, self.damping)
        trial = _bounded(self.params + step, self.params, half, widest)
        jacobian, residual = _linear(trial, dx, dy, self.values, psf)
        cost = self._costs(trial, residual)
        worse = ~(cost <= self.cost * (1.0 + _COST_ROUNDING))
        trial[worse], cost[worse] = self.params[worse], self.cost[worse]
        jacobian[worse], residual[worse] = self.jacobian[worse], self.residual[worse]
        self.damping = np.where(worse, self.damping * 8.0, self.damping * 0.2)
        self.params, self.jacobian, self.residual, self.cost = trial, jacobian, residual, cost
        return np.asarray(np.abs(step[:, 1:3]).max(axis=1) > _STILL_PX)

    def part(self, index: NDArray[np.intp]) -> _GaussNewton:
        """Those of some cutouts."""
        return _GaussNewton(
            self.values[index],
            self.mask[index],
            self.variance[index],
            self.precision[index],
            self.mean,
            self.weights[index],
            self.params[index],
            self.damping[index],
            self.jacobian[index],
            self.residual[index],
            self.cost[index],
        )

    def put(self, index: NDArray[np.intp] | None, part: _GaussNewton) -> None:
        """Write back what a part came to; without an index it is this itself."""
        if index is None:
            return
        for name in ("weights", "params", "damping", "jacobian", "residual", "cost"):
            getattr(self, name)[index] = getattr(part, name)

    def _costs(self, params: Array, residual: Pixels) -> Array:
        prior = (self.precision * (params[:, 3:6] - self.mean) ** 2).sum(axis=1)
        return np.asarray((self.weights * residual * residual).sum(axis=1) + prior, dtype=np.float64)


def _information(jacobian: Pixels, weights: Pixels, precision: Array) -> tuple[Array, Pixels]:
    """Information matrices (n, 7, 7), and the weighted Jacobian."""
    weighted = jacobian * weights[:, None, :]
    normal = (weighted @ jacobian.transpose(0, 2, 1)).astype(np.float64)
    normal[:, _SHAPE, _SHAPE] += precision
    return normal, weighted


def _narrowed(params: Array) -> tuple[Array, Array, Array]:
    """Take the pixels' own variance, 1/12, off the widths: p, q, r of the image that falls on the pixels."""
    p, q, r = params[:, 3], params[:, 4], params[:, 5]
    determinant = p * r - q * q
    xx, yy = (np.maximum(w / determinant - 1.0 / 12.0, LEAST_VARIANCE_PX2) for w in (r, p))
    room = 0.97 * np.sqrt(xx * yy)
    xy = np.clip(-q / determinant, -room, room)
    determinant = xx * yy - xy * xy
    return yy / determinant, -xy / determinant, xx / determinant


def _linear(params: Array, dx: Pixels, dy: Pixels, values: Pixels, psf: Psf) -> tuple[Pixels, Pixels]:
    """Jacobian (n, 7, pixels) and residual data - model (n, pixels).

    Integrated, only the model's value comes from points within the pixels; the slopes of the PSF as wide
    as it looks are near enough to lead there.
    """
    if not psf.integrated:
        jacobian = _slopes(params, params[:, 0], dx, dy, psf)
    else:
        jacobian = _slopes(params, seen_amplitude(params), dx, dy, psf)
        p, q, r = (w[:, None].astype(np.float32) for w in _narrowed(params))
        x, y = params[:, 1, None].astype(np.float32), params[:, 2, None].astype(np.float32)
        height = np.zeros((params.shape[0], dx.shape[1]), dtype=np.float32)
        for shift_y, weight_y in zip(NODES, NODE_WEIGHTS, strict=True):
            v = dy - (y - shift_y)
            rv2, qv = r * v * v, np.float32(2.0) * q * v
            for shift_x, weight_x in zip(NODES, NODE_WEIGHTS, strict=True):
                u = dx - (x - shift_x)
                height += (weight_x * weight_y) * psf.of((p * u + qv) * u + rv2)[0]
        jacobian[:, 0] = height
    sky = params[:, 6, None].astype(np.float32)
    return jacobian, values - params[:, 0, None].astype(np.float32) * jacobian[:, 0] - sky


def seen_amplitude(params: Array) -> Array:
    """Amplitude of the PSF of seen width that holds as much light as the narrowed one of amplitude a."""
    p, q, r = _narrowed(params)
    seen = params[:, 3] * params[:, 5] - params[:, 4] ** 2
    return np.asarray(params[:, 0] * np.sqrt(seen / (p * r - q * q)))


def _slopes(params: Array, amplitude: Array, dx: Pixels, dy: Pixels, psf: Psf) -> Pixels:
    """Derivatives of the model by its parameters at points, (n, 7, points)."""
    x, y, p, q, r = (params[:, i, None].astype(np.float32) for i in range(1, 6))
    u, v = dx - x, dy - y
    along_x, along_y = p * u + q * v, q * u + r * v
    height, slope = psf.of(along_x * u + along_y * v)
    slope = amplitude[:, None].astype(np.float32) * slope
    jacobian = np.empty((params.shape[0], PARAMETERS, dx.shape[1]), dtype=np.float32)
    jacobian[:, 0] = height
    np.multiply(slope, along_x, out=jacobian[:, 1])
    np.multiply(slope, along_y, out=jacobian[:, 2])
    u *= slope
    np.multiply(u, v, out=jacobian[:, 4])
    np.negative(jacobian[:, 4], out=jacobian[:, 4])
    v *= v
    v *= slope
    np.multiply(v, np.float32(-0.5), out=jacobian[:, 5])
    u *= dx - x
    np.multiply(u, np.float32(-0.5), out=jacobian[:, 3])
    jacobian[:, 6] = 1.0
    return jacobian


def _weights(
    params: Array, dx: Pixels, dy: Pixels, mask: NDArray[np.bool_], variance: Pixels, psf: Psf
) -> Pixels:
    x, y, p, q, r = (params[:, i, None].astype(np.float32) for i in range(1, 6))
    u, v = dx - x, dy - y
    amplitude = seen_amplitude(params) if psf.integrated else params[:, 0]
    height = np.maximum(amplitude, 0.0)[:, None].astype(np.float32)
    light = height * psf.of((p * u + 2.0 * q * v) * u + r * v * v)[0]
    return np.asarray(mask / psf.variance(variance, light), dtype=np.float32)


def _solve(normal: Array, gradient: Array, damping: Array) -> Array:
    """Solve the damped normal equations after scaling them to a unit diagonal."""
    diagonal = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-30))
    scaled = normal / (diagonal[:, :, None] * diagonal[:, None, :])
    scaled += (damping[:, None, None] + 1e-10) * np.eye(PARAMETERS)
    return np.asarray(np.linalg.solve(scaled, (gradient / diagonal)[:, :, None])[:, :, 0] / diagonal)


def _bounded(trial: Array, before: Array, half: float, widest: float) -> Array:
    """Keep a step inside the cutout, and widths between a hot pixel's and the cutout's."""
    trial = trial.copy()
    trial[:, 0] = np.clip(trial[:, 0], 0.2 * before[:, 0], 5.0 * before[:, 0])
    trial[:, 1:3] = before[:, 1:3] + np.clip(trial[:, 1:3] - before[:, 1:3], -1.5, 1.5)
    trial[:, 1:3] = np.clip(trial[:, 1:3], -half, half)
    least, most = 1.0 / widest**2, 1.0 / _NARROWEST_SIGMA_PX**2
    for i in (3, 5):
        trial[:, i] = np.clip(trial[:, i], 0.3 * before[:, i], 3.0 * before[:, i])
        trial[:, i] = np.clip(trial[:, i], least, most)
    room = 0.97 * np.sqrt(trial[:, 3] * trial[:, 5])
    trial[:, 4] = np.clip(trial[:, 4], -room, room)
    return trial


def covariances(normal: Array) -> Array:
    """Invert information matrices (n, 7, 7) after scaling them to a unit diagonal."""
    diagonal = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-30))
    scaled = normal / (diagonal[:, :, None] * diagonal[:, None, :]) + 1e-9 * np.eye(normal.shape[1])
    return np.asarray(np.linalg.inv(scaled) / (diagonal[:, :, None] * diagonal[:, None, :]))
