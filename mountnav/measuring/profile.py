"""A star's sub-pixel place and shape: an elliptical bell fitted to many stamps at once [S23 §0.2]."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.background import Image

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]
Reals = NDArray[np.floating[Any]]

#: Full width at half maximum over sigma of a Gaussian.
FWHM_PER_SIGMA = 2.0 * np.sqrt(2.0 * np.log(2.0))
_ROUNDS = 12
_STILL_PX = 5e-4
_STRAGGLERS = 0.03
_FEW_MOVING = 0.7
_PARAMETERS = 7
_EVEN = 1e-6
_NARROWEST_SIGMA_PX = 0.3
_LEAST_VARIANCE_PX2 = 0.03
_SHAPE = np.arange(3, 6)
_FAR_DRIFT_SIGMAS = 2.5
#: Squared FWHM that a pixel's own width adds to an image's: 8 ln 2 / 12.
PIXEL_FWHM2 = 8.0 * np.log(2.0) / 12.0
# three-point Gauss-Legendre rule over a pixel
_NODES = (np.sqrt(0.6) / 2.0 * np.array([-1.0, 0.0, 1.0])).astype(np.float32)
_NODE_WEIGHTS = (np.array([5.0, 8.0, 5.0]) / 18.0).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Bell:
    """What all stars of a frame share: the fall of the wings, and how the pixels' noise grows with light.

    The bell is (1 + wing Q / 2)^(-1 / wing), a Moffat function of exponent 1 / wing, and exp(-Q / 2) at
    wing = 0, where Q is the squared distance in widths.

    Attributes
    ----------
    wing : float
        0 for a Gaussian, 0.3 for typical seeing.
    gain_e_adu : float
        Electrons per ADU.
    misfit : float
        Rms of what the model doesn't explain, as a share of the light in the pixel.
    integrated : bool
        Integrate over the pixels; for stars so narrow that their value at the pixel's center won't do.
    """

    wing: float = 0.0
    gain_e_adu: float = 1.0
    misfit: float = 0.0
    integrated: bool = False

    def of(self, q: Array) -> tuple[Array, Array]:
        """Return the bell and -2 times its derivative at squared distances ``q``."""
        if self.wing < 1e-3:
            bell = np.exp(-0.5 * q)
            return bell, bell
        inner = 1.0 + (0.5 * self.wing) * q
        bell = np.exp(np.log(inner) * (-1.0 / self.wing))
        return bell, bell / inner

    @property
    def fwhm_per_width(self) -> float:
        """Full width at half maximum over the width in Q."""
        if self.wing < 1e-3:
            return float(FWHM_PER_SIGMA)
        return float(2.0 * np.sqrt(2.0 * (2.0**self.wing - 1.0) / self.wing))

    @property
    def volume(self) -> float:
        """Integral of the bell of unit width."""
        return float(2.0 * np.pi / (1.0 - self.wing))

    def variance(self, sky_variance: Reals, light: Reals) -> Array:
        """Return the variance of pixels that hold sky and some light of a star."""
        light = np.maximum(light, 0.0)  # a fit may dip below the sky
        return np.asarray(sky_variance + light / self.gain_e_adu + (self.misfit * light) ** 2)


@dataclass(frozen=True, slots=True)
class Stamps:
    """Round cuttings at peaks.

    Attributes
    ----------
    values, variance : ndarray, shape (n, pixels)
        Background-subtracted pixels, and the variance of the sky noise in them.
    good : ndarray of bool, shape (n, pixels)
        False for missing, saturated and outlying pixels.
    dx, dy : ndarray, shape (pixels,)
        Pixel places relative to the stamp's center.
    x0, y0 : ndarray, shape (n,)
        The center pixels' places in the frame.
    """

    values: Array
    variance: Array
    good: NDArray[np.bool_]
    dx: Array
    dy: Array
    x0: Array
    y0: Array


@dataclass(frozen=True, slots=True)
class Profiles:
    """Fitted profiles, each array of shape (n,); lengths in pixels, flux in ADU.

    ``minor_fwhm_px`` and ``major_fwhm_px`` are along the ellipse's axes, the pixels' own width included;
    ``angle_deg`` is the major axis' direction from +x towards +y; ``misfit`` is the residuals' rms inside the
    core over the amplitude, ``chi2`` the reduced one of the whole stamp; ``converged`` tells whether place
    and shape are those of a star.
    """

    x_px: Array
    y_px: Array
    x_sigma_px: Array
    y_sigma_px: Array
    amplitude: Array
    flux: Array
    flux_sigma: Array
    minor_fwhm_px: Array
    major_fwhm_px: Array
    angle_deg: Array
    misfit: Array
    chi2: Array
    converged: NDArray[np.bool_]


def cut_stamps(
    sky_free: Image, good: NDArray[np.bool_], x_px: Array, y_px: Array, noise: Array, half_px: int
) -> Stamps:
    """Cut discs of radius ``half_px`` at places; what hangs over the frame's edge is not good.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
    good : ndarray of bool, shape (height, width)
    x_px, y_px, noise : ndarray, shape (n,)
        Places, and the sky noise per pixel at them.
    half_px : int

    Returns
    -------
    Stamps
    """
    height, width = sky_free.shape
    offset = np.arange(-half_px, half_px + 1)
    dy, dx = (grid.ravel() for grid in np.meshgrid(offset, offset, indexing="ij"))
    disc = np.hypot(dx, dy) <= half_px + 0.5
    dx, dy = dx[disc], dy[disc]
    x0, y0 = np.rint(x_px).astype(int), np.rint(y_px).astype(int)
    columns, rows = x0[:, None] + dx, y0[:, None] + dy
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    flat = np.clip(rows, 0, height - 1) * width + np.clip(columns, 0, width - 1)
    return Stamps(
        values=sky_free.ravel()[flat].astype(np.float64),
        variance=np.broadcast_to((noise * noise)[:, None], flat.shape),
        good=inside & good.ravel()[flat],
        dx=dx.astype(np.float64),
        dy=dy.astype(np.float64),
        x0=x0.astype(np.float64),
        y0=y0.astype(np.float64),
    )


@dataclass(frozen=True, slots=True)
class Shape:
    """The typical star's p, q, r, and how far a fit may stray from them: for stars that can't tell their own.

    ``slack`` is the one-sigma share of p and r, and of their mean for q: one for all, or one each.
    """

    p: float
    q: float
    r: float
    slack: float | Array

    @classmethod
    def round(cls, fwhm_px: float, bell: Bell) -> Shape:
        """A round star that looks so wide."""
        inverse = (bell.fwhm_per_width / fwhm_px) ** 2
        return cls(inverse, 0.0, inverse, 1.0)

    def precision(self) -> Array:
        """Inverse variances of p, q, r, shape (3,) or (n, 3)."""
        scale = np.array([self.p, 0.5 * (self.p + self.r), self.r])
        slack = np.asarray(self.slack, dtype=np.float64)
        return np.asarray(1.0 / (slack[..., None] * scale) ** 2)


@dataclass(frozen=True, slots=True)
class Fit:
    """The state of a fit: parameters (n, 7), their information matrix (n, 7, 7), residuals and slopes."""

    params: Array
    normal: Array
    residual: Reals
    jacobian: Reals
    weights: Reals


def fit_profiles(
    stamps: Stamps,
    x_px: Array,
    y_px: Array,
    width_px: float,
    bell: Bell,
    *,
    shape: Shape | None = None,
    rounds: int = _ROUNDS,
    height: Array | None = None,
) -> Profiles:
    """Fit amplitude, place, an elliptical width and a local sky to each stamp.

    The model is a B(p u² + 2 q u v + r v²) + b with u, v relative to the place and B the frame's bell. All
    stamps go through a damped Gauss-Newton iteration together. A pixel's variance is that of the sky plus
    that of the star's own photons; with these weights the place's error is the Cramér-Rao bound of the
    model, and the reported sigmas are its inverse information matrix. Saturated pixels are left out, so that
    the wings alone place a saturated star.

    Parameters
    ----------
    stamps : Stamps
    x_px, y_px : ndarray, shape (n,)
        Where to start, pixels of the frame.
    width_px : float
        Width to start from, pixels: a Gaussian's sigma.
    bell : Bell
    shape : Shape, optional
        Known beforehand: for saturated stars and blends.
    rounds : int, optional
        At most so many.
    height : ndarray, shape (n,), optional
        Amplitudes to start from.

    Returns
    -------
    Profiles
    """
    fit = fit_bells(stamps, x_px, y_px, width_px, bell, shape=shape, rounds=rounds, height=height)
    return _profiles(fit, stamps, float(stamps.dx.max()), width_px, bell)


def fit_bells(
    stamps: Stamps,
    x_px: Array,
    y_px: Array,
    width_px: float,
    bell: Bell,
    *,
    shape: Shape | None = None,
    rounds: int = _ROUNDS,
    height: Array | None = None,
) -> Fit:
    """Do the work of `fit_profiles`; return the fit's inside for those who judge its residuals."""
    count = stamps.values.shape[0]
    # single precision for the pixels, double for what is fitted: noise is far coarser than either
    dx, dy = stamps.dx[None, :].astype(np.float32), stamps.dy[None, :].astype(np.float32)
    half = float(stamps.dx.max())
    mask = stamps.good
    values = np.where(mask, stamps.values, 0.0).astype(np.float32)
    variance = stamps.variance.astype(np.float32)
    start_u = dx - (x_px - stamps.x0)[:, None].astype(np.float32)
    start_v = dy - (y_px - stamps.y0)[:, None].astype(np.float32)
    form = np.exp(-0.5 * (start_u * start_u + start_v * start_v) / np.float32(width_px**2)) * mask
    amplitude = np.maximum((values * form).sum(axis=1) / np.maximum((form * form).sum(axis=1), 1e-3), 1e-9)
    inverse = 1.0 / width_px**2
    kept = np.zeros((count, _PARAMETERS))
    kept[:, 0] = amplitude if height is None else height
    kept[:, 1], kept[:, 2] = x_px - stamps.x0, y_px - stamps.y0
    kept[:, 3], kept[:, 5] = inverse, inverse
    mean, precision = np.zeros(3), np.zeros((count, 3))
    if shape is not None:
        mean = np.array([shape.p, shape.q, shape.r])
        precision[:] = shape.precision()
        kept[:, 3:6] = mean
    widest = half * 0.8
    coarse = replace(bell, integrated=False)
    now = coarse
    weights = _weights(kept, dx, dy, mask, variance, coarse)
    whole = _Descent(values, mask, variance, precision, mean, weights, kept, np.full(count, 1e-2))
    whole.look(dx, dy, now)
    some, index = whole, None
    switch = min(3, rounds // 2 - 1) if bell.integrated else -1
    for turn in range(rounds):
        moving = some.step(dx, dy, now, half, widest)
        if turn in (1, 2):  # the photons' share of the variance follows the model, twice
            some.weigh(dx, dy, coarse)
        if turn == switch:
            # near enough for the pixels' width to be told from the star's
            now = bell
            some.params[:, 0] *= some.params[:, 0] / np.maximum(_seen_amplitude(some.params), 1e-12)
            some.damping = np.full(count, 1e-3)
            some.look(dx, dy, now)
        if turn < max(3, switch + 2):
            continue
        if np.count_nonzero(moving) <= _STRAGGLERS * count:
            break
        if np.count_nonzero(moving) < _FEW_MOVING * moving.size:  # go on with those alone
            whole.put(index, some)
            index = np.flatnonzero(moving) if index is None else index[moving]
            some = whole.part(index)
    whole.put(index, some)
    weights = _weights(whole.params, dx, dy, mask, variance, now)
    normal = _information(whole.jacobian, weights, precision)[0]
    return Fit(whole.params, normal, whole.residual, whole.jacobian, weights)


@dataclass(slots=True)
class _Descent:
    """Damped Gauss-Newton of many stamps at once: what it works on, and how far it has come."""

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

    def look(self, dx: Pixels, dy: Pixels, bell: Bell) -> None:
        """Start (again) from the parameters as they are."""
        self.jacobian, self.residual = _linear(self.params, dx, dy, self.values, bell)
        self.cost = self._costs(self.params, self.residual)

    def weigh(self, dx: Pixels, dy: Pixels, bell: Bell) -> None:
        """Renew the weights by the model as it is."""
        self.weights = _weights(self.params, dx, dy, self.mask, self.variance, bell)
        self.cost = self._costs(self.params, self.residual)

    def step(self, dx: Pixels, dy: Pixels, bell: Bell, half: float, widest: float) -> NDArray[np.bool_]:
        """Take one step, where it leads down; tell which places still move."""
        normal, weighted = _information(self.jacobian, self.weights, self.precision)
        gradient = (weighted @ self.residual[:, :, None])[:, :, 0].astype(np.float64)
        gradient[:, 3:6] += self.precision * (self.mean - self.params[:, 3:6])
        step = _solve(normal, gradient, self.damping)
        trial = _bounded(self.params + step, self.params, half, widest)
        jacobian, residual = _linear(trial, dx, dy, self.values, bell)
        cost = self._costs(trial, residual)
        worse = ~(cost <= self.cost * (1.0 + _EVEN))
        trial[worse], cost[worse] = self.params[worse], self.cost[worse]
        jacobian[worse], residual[worse] = self.jacobian[worse], self.residual[worse]
        self.damping = np.where(worse, self.damping * 8.0, self.damping * 0.2)
        self.params, self.jacobian, self.residual, self.cost = trial, jacobian, residual, cost
        return np.asarray(np.abs(step[:, 1:3]).max(axis=1) > _STILL_PX)

    def part(self, index: NDArray[np.intp]) -> _Descent:
        """Those of some stamps."""
        return _Descent(
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

    def put(self, index: NDArray[np.intp] | None, part: _Descent) -> None:
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
    xx, yy = (np.maximum(w / determinant - 1.0 / 12.0, _LEAST_VARIANCE_PX2) for w in (r, p))
    room = 0.97 * np.sqrt(xx * yy)
    xy = np.clip(-q / determinant, -room, room)
    determinant = xx * yy - xy * xy
    return yy / determinant, -xy / determinant, xx / determinant


def _linear(params: Array, dx: Pixels, dy: Pixels, values: Pixels, bell: Bell) -> tuple[Pixels, Pixels]:
    """Jacobian (n, 7, pixels) and residual data - model (n, pixels).

    Integrated, only the model's value comes from points within the pixels; the slopes of the bell as wide
    as it looks are near enough to lead there.
    """
    if not bell.integrated:
        jacobian = _slopes(params, params[:, 0], dx, dy, bell)
    else:
        jacobian = _slopes(params, _seen_amplitude(params), dx, dy, bell)
        p, q, r = (w[:, None].astype(np.float32) for w in _narrowed(params))
        x, y = params[:, 1, None].astype(np.float32), params[:, 2, None].astype(np.float32)
        height = np.zeros((params.shape[0], dx.shape[1]), dtype=np.float32)
        for shift_y, weight_y in zip(_NODES, _NODE_WEIGHTS, strict=True):
            v = dy - (y - shift_y)
            rv2, qv = r * v * v, np.float32(2.0) * q * v
            for shift_x, weight_x in zip(_NODES, _NODE_WEIGHTS, strict=True):
                u = dx - (x - shift_x)
                height += (weight_x * weight_y) * bell.of((p * u + qv) * u + rv2)[0]
        jacobian[:, 0] = height
    sky = params[:, 6, None].astype(np.float32)
    return jacobian, values - params[:, 0, None].astype(np.float32) * jacobian[:, 0] - sky


def _seen_amplitude(params: Array) -> Array:
    """Amplitude of the bell of seen width that holds as much light as the narrowed one of amplitude a."""
    p, q, r = _narrowed(params)
    seen = params[:, 3] * params[:, 5] - params[:, 4] ** 2
    return np.asarray(params[:, 0] * np.sqrt(seen / (p * r - q * q)))


def _slopes(params: Array, amplitude: Array, dx: Pixels, dy: Pixels, bell: Bell) -> Pixels:
    """Derivatives of the model by its parameters at points, (n, 7, points)."""
    x, y, p, q, r = (params[:, i, None].astype(np.float32) for i in range(1, 6))
    u, v = dx - x, dy - y
    along_x, along_y = p * u + q * v, q * u + r * v
    height, slope = bell.of(along_x * u + along_y * v)
    slope = amplitude[:, None].astype(np.float32) * slope
    jacobian = np.empty((params.shape[0], _PARAMETERS, dx.shape[1]), dtype=np.float32)
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
    params: Array, dx: Pixels, dy: Pixels, mask: NDArray[np.bool_], variance: Pixels, bell: Bell
) -> Pixels:
    x, y, p, q, r = (params[:, i, None].astype(np.float32) for i in range(1, 6))
    u, v = dx - x, dy - y
    amplitude = _seen_amplitude(params) if bell.integrated else params[:, 0]
    height = np.maximum(amplitude, 0.0)[:, None].astype(np.float32)
    light = height * bell.of((p * u + 2.0 * q * v) * u + r * v * v)[0]
    return np.asarray(mask / bell.variance(variance, light), dtype=np.float32)


def _solve(normal: Array, gradient: Array, damping: Array) -> Array:
    """Solve the damped normal equations after scaling them to a unit diagonal."""
    diagonal = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-30))
    scaled = normal / (diagonal[:, :, None] * diagonal[:, None, :])
    scaled += (damping[:, None, None] + 1e-10) * np.eye(_PARAMETERS)
    return np.asarray(np.linalg.solve(scaled, (gradient / diagonal)[:, :, None])[:, :, 0] / diagonal)


def _bounded(trial: Array, before: Array, half: float, widest: float) -> Array:
    """Keep a step inside the stamp, and widths between a hot pixel's and the stamp's."""
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


def _profiles(fit: Fit, stamps: Stamps, half: float, sigma: float, bell: Bell) -> Profiles:
    params, normal, residual, mask = fit.params, fit.normal, fit.residual, stamps.good
    a, x, y, p, q, r, _ = params.T
    covariance = covariances(normal)
    # where nearly all pixels are masked the matrix is singular: such a fit knows nothing, and says so
    diagonal = np.einsum("nii->ni", covariance)
    known = (diagonal[:, :3] > 0.0).all(axis=1)
    sigmas = np.where(known[:, None], np.sqrt(np.maximum(diagonal, 0.0)), half)
    mean, swing = 0.5 * (p + r), np.hypot(0.5 * (p - r), q)
    narrow = 1.0 / np.sqrt(mean + swing)
    wide = 1.0 / np.sqrt(np.maximum(mean - swing, 1e-6))
    area = bell.volume * narrow * wide
    a = _seen_amplitude(params) if bell.integrated else a
    # flux = a · volume / √(pr − q²): its error takes the shape's covariance along
    slope = np.zeros_like(params)
    slope[:, 0] = area * a / np.maximum(params[:, 0], 1e-12)
    excess = np.maximum(p * r - q * q, 1e-12)
    slope[:, 3], slope[:, 5] = -0.5 * a * area * r / excess, -0.5 * a * area * p / excess
    slope[:, 4] = a * area * q / excess
    flux_variance = np.einsum("ni,nij,nj->n", slope, covariance, slope)
    known &= flux_variance > 0.0
    flux_sigma = np.where(known, np.sqrt(np.maximum(flux_variance, 0.0)), np.abs(a * area))
    u, v = stamps.dx[None, :] - x[:, None], stamps.dy[None, :] - y[:, None]
    core = mask & (p[:, None] * u * u + 2.0 * q[:, None] * u * v + r[:, None] * v * v < 4.0)
    pixels = np.maximum(core.sum(axis=1), 1)
    misfit = np.sqrt((residual**2 * core).sum(axis=1) / pixels) / np.maximum(a, 1e-12)
    drift = np.hypot(x, y)
    converged = (
        (drift < max(_FAR_DRIFT_SIGMAS * sigma, 1.5)) & (a > 0) & known & np.isfinite(sigmas).all(axis=1)
    )
    return Profiles(
        x_px=stamps.x0 + x,
        y_px=stamps.y0 + y,
        x_sigma_px=sigmas[:, 1],
        y_sigma_px=sigmas[:, 2],
        amplitude=a,
        flux=a * area,
        flux_sigma=flux_sigma,
        minor_fwhm_px=bell.fwhm_per_width * narrow,
        major_fwhm_px=bell.fwhm_per_width * wide,
        # the model's Q grows fastest along the minor axis; the major one is square to it
        angle_deg=np.degrees(0.5 * np.arctan2(-2.0 * q, r - p)),
        misfit=misfit,
        chi2=(fit.weights * residual**2).sum(axis=1) / np.maximum(mask.sum(axis=1) - _PARAMETERS, 1.0),
        converged=np.asarray(converged),
    )


def covariances(normal: Array) -> Array:
    """Invert information matrices (n, 7, 7) after scaling them to a unit diagonal."""
    diagonal = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-30))
    scaled = normal / (diagonal[:, :, None] * diagonal[:, None, :]) + 1e-9 * np.eye(normal.shape[1])
    return np.asarray(np.linalg.inv(scaled) / (diagonal[:, :, None] * diagonal[:, None, :]))


def inverse_widths(fits: Profiles, bell: Bell) -> tuple[Array, Array, Array]:
    """Return p, q, r of Q = p u² + 2 q u v + r v², each of shape (n,)."""
    angle = np.radians(fits.angle_deg)
    along, across = ((bell.fwhm_per_width / w) ** 2 for w in (fits.major_fwhm_px, fits.minor_fwhm_px))
    cos, sin = np.cos(angle), np.sin(angle)
    return (
        along * cos * cos + across * sin * sin,
        (along - across) * sin * cos,
        along * sin * sin + across * cos * cos,
    )


def light_on(
    fits: Profiles, which: NDArray[np.intp], x0: Array, y0: Array, stamps: Stamps, bell: Bell
) -> Array:
    """Light of fitted stars on stamps of the same form as others, shape (len(which), pixels).

    Parameters
    ----------
    fits : Profiles
    which : ndarray of int, shape (k,)
        Whose light.
    x0, y0 : ndarray, shape (k,)
        Center pixel of the stamp that it falls on.
    stamps : Stamps
        For the form alone.
    bell : Bell

    Returns
    -------
    ndarray
    """
    u = x0[:, None] + stamps.dx - fits.x_px[which, None]
    v = y0[:, None] + stamps.dy - fits.y_px[which, None]
    p, q, r = (w[which, None] for w in inverse_widths(fits, bell))
    return np.asarray(fits.amplitude[which, None] * bell.of(p * u * u + 2.0 * q * u * v + r * v * v)[0])
