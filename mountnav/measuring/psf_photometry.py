"""All peaks of a frame are fitted: the common PSF first, each by itself, then saturated stars and blends."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mountnav.frames import Frame
from mountnav.measuring.background import Background, Image
from mountnav.measuring.cutouts import Cutouts, make_cutouts
from mountnav.measuring.deblend import deblend, find_doubles, typical_shape
from mountnav.measuring.detection import Peaks
from mountnav.measuring.psf import FWHM_PER_SIGMA, Psf, ShapePrior
from mountnav.measuring.psf_fitting import Profiles, fit_profiles, learn_psf, light_on

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_PIXELS_AT_ONCE = 30_000
"""Pixels of all cutouts that are fitted together, so that they stay in the processor's cache. It changes
nothing but time."""
_PSF_CANDIDATES = 400
"""Highest peaks among which the stars are chosen that the PSF is learned from. Doubled or halved, nothing
changed on the frames that were tried."""
_PSF_STARS = 60
"""Stars at most that the PSF is learned from: bounds the time. Halved, the median error of C00 grows from
0.039 to 0.041 px; doubled, no figure changed by 3 %."""
_PSF_STAR_SIGMA = 40.0
"""Their least height in the smoothed frame, in units of its noise: fainter ones say nothing about wings and
misfit. Halved, the median error of C00 grows from 0.039 to 0.043 px; doubled, no figure changed by 3 %."""
_INTEGRATE_BELOW_PX = 2.2
"""Apparent FWHM below which the PSF is integrated over the pixels, px. Sampled at the pixels' centers,
Gaussians of 1.7 px are placed wrong by 0.0001 px, Moffat ones by 0.003 (docs/figures/measuring.md,
*Largest error over all positions within a pixel*). Halved, fluxes of painted stars of 1.5 px scatter by 17 %
more; doubled, nothing is gained, at nine times the cost of the model."""
_SATURATED_SLACK = 0.03
"""One-sigma share of p, q, r by which a saturated star may differ from the typical one: its wings hardly fix
its width. Doubled or halved, no figure changed by 3 %."""
LONELY_FWHM = 2.7
"""Distance to the next peak, in FWHM, from which a star counts as alone, to be tried as two or to teach the
PSF. Doubled or halved, nothing changed on the frames that were tried."""
OVERFLOW_SIGMA = 6.0
"""A pixel of a saturated star holds overflow if it is brighter than the wings allow by this many sigmas
..."""
OVERFLOW_SHARE = 0.4
"""... and this share of their light: PSFs misfit real wings by tenths. Both: chosen by hand; doubled or
halved, nothing changed on the frames that were tried."""
_OVERFLOW_ROUNDS = 4
"""How often a saturated star is fitted again without such pixels. Doubled or halved, nothing changed on the
frames that were tried."""
_LEAST_SKY_NOISES = 3.0
"""A sky level below so many noises has been taken off already and gives no gain. Doubled or halved, nothing
changed on the frames that were tried."""
_FAINT_SKY_E = 100.0
"""Electrons per pixel assumed of the sky there: a faint one's. It sets only the weights and the errors of
frames that tell nothing else. Doubled or halved, nothing changed on the frames that were tried."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """The fits of all peaks, each array of shape (n,), and what their stars have in common.

    Attributes
    ----------
    shape : ShapePrior or None
        Of the typical star; None where there are too few.
    origin : ndarray of int
        Which peak each comes from: a peak that was two stars has two.
    apart_px : ndarray
        Distance to the other star of the same peak; infinite for the rest.
    """

    profiles: Profiles
    psf: Psf
    shape: ShapePrior | None
    origin: NDArray[np.intp]
    apart_px: Array


def known_gain(frame: Frame, wish: float | None, sky: float, noise: float) -> tuple[float, bool]:
    """Electrons per ADU as set or by the header's EGAIN, else as the sky's own noise suggests.

    Parameters
    ----------
    wish : float or None
        What the settings say.
    sky, noise : float
        Level of the sky, and noise per pixel.

    Returns
    -------
    known : bool
        False for a mere guess.
    """
    card = wish or frame.header.get("EGAIN")
    if isinstance(card, (int, float)) and not isinstance(card, bool) and 0.005 < card < 1000.0:
        return float(card), True
    if (
        sky < _LEAST_SKY_NOISES * noise
    ):  # already taken off: a faint sky's worth of electrons, in whatever unit
        return _FAINT_SKY_E**0.5 / noise, False
    return float(np.clip(sky / noise**2, 0.02, 100.0)), False


def fit_peaks(
    sky_free: Image,
    good: Mask,
    saturated: Mask,
    background: Background,
    peaks: Peaks,
    radius_px: Array,
    fwhm_px: float,
    gain: tuple[float, bool],
    most: int,
) -> Fitted:
    """Fit the highest peaks.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        The frame without its background, ADU.
    good : ndarray of bool, shape (height, width)
        Pixels that hold sky and stars, saturated ones excluded.
    saturated : ndarray of bool, shape (height, width)
        Pixels at or above the saturation level.
    radius_px : ndarray, shape (n,)
        Radius of the saturated patch at each peak, 0 for none.
    fwhm_px : float
        About how wide the stars look.
    gain : tuple
        From `known_gain`.
    most : int
        No more than so many.

    Returns
    -------
    Fitted
        In the order of the peaks, then the second stars of peaks that were two.
    """
    trusted = _without_rims(good, saturated)
    x, y, radius = peaks.x_px[:most], peaks.y_px[:most], radius_px[:most]
    noise = background.noise_at(x, y)
    half = half_px(fwhm_px)
    psf = _psf(trusted, sky_free, background, peaks, radius_px, fwhm_px, gain)
    fits = _fit_all(sky_free, trusted, x, y, radius, noise, fwhm_px, psf, None)
    whole = radius == 0
    shape = typical_shape(fits, whole, fwhm_px, psf)
    origin = np.arange(x.size)
    if shape is None:
        return Fitted(fits, psf, None, origin, np.full(x.size, np.inf))
    full = np.flatnonzero(~whole)
    if full.size:
        known = ShapePrior(shape.p, shape.q, shape.r, _SATURATED_SLACK)
        again = _fit_saturated(
            sky_free, trusted, x[full], y[full], radius[full], noise[full], fwhm_px, psf, known
        )
        fits = fits.copied()
        fits.put(full, again)
    lonely = whole & (nearest_other(peaks, x, y, 10.0 * fwhm_px) > LONELY_FWHM * fwhm_px)
    two = find_doubles(sky_free, trusted, fits, lonely, noise, half, psf, shape)
    alone = whole
    apart = np.full(x.size, np.inf)
    if two is not None:
        second = np.arange(x.size, x.size + two.which.size)
        origin = np.concatenate([origin, two.which])
        fits = Profiles.joined([fits, two.faint])
        fits.put(two.which, two.bright)
        x, y, alone, apart = x[origin], y[origin], whole[origin], apart[origin]
        # what was measured together stays; only its light is taken off others
        for some in (two.which, second):
            x[some], y[some], alone[some] = fits.x_px[some], fits.y_px[some], False
            apart[some] = np.hypot(two.bright.x_px - two.faint.x_px, two.bright.y_px - two.faint.y_px)
    fits, _ = deblend(sky_free, trusted, fits, x, y, noise[origin], half, ~alone, psf, shape)
    return Fitted(fits, psf, shape, origin, apart)


def half_px(fwhm_px: float) -> int:
    """Half side of a star's cutout."""
    return int(np.clip(np.ceil(1.5 * fwhm_px), 4, 20))


def nearest_other(peaks: Peaks, x: Array, y: Array, reach_px: float) -> Array:
    """Distance of each measured peak to the nearest other peak, shape (n,); infinite beyond reach."""
    if peaks.x_px.size < 2:
        return np.full(x.size, np.inf)
    tree = KDTree(np.stack([peaks.x_px, peaks.y_px], axis=1))
    distance, _ = tree.query(np.stack([x, y], axis=1), k=2, distance_upper_bound=reach_px)
    return np.asarray(distance, dtype=np.float64)[:, 1]


def _psf(
    good: Mask,
    sky_free: Image,
    background: Background,
    peaks: Peaks,
    radius_px: Array,
    fwhm_px: float,
    gain: tuple[float, bool],
) -> Psf:
    """Learn the stars' common PSF from the brightest that stand alone and are whole."""
    height, width = sky_free.shape
    half = half_px(fwhm_px)
    x, y = peaks.x_px[:_PSF_CANDIDATES], peaks.y_px[:_PSF_CANDIDATES]
    fine = (radius_px[: x.size] == 0) & (peaks.height[: x.size] > _PSF_STAR_SIGMA)
    fine &= (x > half) & (y > half) & (x < width - 1 - half) & (y < height - 1 - half)
    fine &= nearest_other(peaks, x, y, 10.0 * fwhm_px) > 2.0 * fwhm_px
    some = np.flatnonzero(fine)[:_PSF_STARS]
    cutouts = make_cutouts(sky_free, good, x[some], y[some], background.noise_at(x[some], y[some]), half)
    return learn_psf(
        cutouts,
        x[some],
        y[some],
        fwhm_px / FWHM_PER_SIGMA,
        gain[0],
        integrated=fwhm_px < _INTEGRATE_BELOW_PX,
        card=gain[1],
    )


def _fit_all(
    sky_free: Image,
    good: Mask,
    x: Array,
    y: Array,
    radius: Array,
    noise: Array,
    fwhm_px: float,
    psf: Psf,
    shape: ShapePrior | None,
) -> Profiles:
    """Fit in handfuls that fit the processor's cache; cutouts of saturated stars reach past their cores."""
    parts: list[tuple[NDArray[np.intp], Profiles]] = []
    wide_half = _wide_half(radius, fwhm_px)
    for half in np.unique(wide_half):
        members = np.flatnonzero(wide_half == half)
        share = max(1, _PIXELS_AT_ONCE // (2 * int(half) + 1) ** 2)
        for start in range(0, members.size, share):
            some = members[start : start + share]
            cutouts = make_cutouts(sky_free, good, x[some], y[some], noise[some], int(half))
            width_px = fwhm_px / psf.fwhm_per_width
            parts.append((some, fit_profiles(cutouts, x[some], y[some], width_px, psf, shape=shape)))
    return _joined(parts, x.size)


def _wide_half(radius: Array, fwhm_px: float) -> NDArray[np.intp]:
    """Half side of cutouts that reach past saturated cores, in steps of four so that many are alike."""
    plain = half_px(fwhm_px)
    wide = np.clip(np.ceil(radius + np.where(radius > 0, 2.5, 1.5) * fwhm_px), plain, 30).astype(np.intp)
    return np.where(wide > plain, (wide + 3) // 4 * 4, plain)


def _fit_saturated(
    sky_free: Image,
    good: Mask,
    x: Array,
    y: Array,
    radius: Array,
    noise: Array,
    fwhm_px: float,
    psf: Psf,
    shape: ShapePrior,
) -> Profiles:
    """Fit the wings with the typical star's shape, and drop pixels that hold what ran over from the core."""
    parts: list[tuple[NDArray[np.intp], Profiles]] = []
    wide_half = _wide_half(radius, fwhm_px)
    for half in np.unique(wide_half):
        some = np.flatnonzero(wide_half == half)
        cutouts = make_cutouts(sky_free, good, x[some], y[some], noise[some], int(half))
        cutouts, top = _without_flood(cutouts, radius[some], psf, shape)
        for turn in range(_OVERFLOW_ROUNDS):
            fits = fit_profiles(
                cutouts, x[some], y[some], fwhm_px / psf.fwhm_per_width, psf, shape=shape, height=top
            )
            if turn == _OVERFLOW_ROUNDS - 1:
                break
            light = light_on(fits, np.arange(some.size), cutouts.x0, cutouts.y0, cutouts, psf)
            sigma = np.sqrt(psf.variance(cutouts.variance, light))
            over = cutouts.values - light > OVERFLOW_SHARE * light + OVERFLOW_SIGMA * sigma
            if not (over & cutouts.good).any():
                break
            cutouts = replace(cutouts, good=cutouts.good & ~over)
        parts.append((some, fits))
    return _joined(parts, x.size)


def _without_flood(cutouts: Cutouts, radius: Array, psf: Psf, shape: ShapePrior) -> tuple[Cutouts, Array]:
    """Drop pixels brighter than a star makes them that just fills its saturated patch; return its height."""
    per_px2 = np.sqrt(shape.p * shape.r - shape.q**2)
    middle = int(np.flatnonzero((cutouts.dx == 0) & (cutouts.dy == 0))[0])
    top = cutouts.values[:, middle] / psf.of(per_px2 * radius**2)[0]
    # the patch's center is only near the star: a pixel may be nearer by one
    nearest = np.maximum(np.hypot(cutouts.dx, cutouts.dy) - 1.0, 0.0)
    most = 2.0 * top[:, None] * psf.of(per_px2 * nearest**2)[0]
    sigma = np.sqrt(psf.variance(cutouts.variance, most))
    return replace(cutouts, good=cutouts.good & (cutouts.values < most + OVERFLOW_SIGMA * sigma)), top


def _without_rims(good: Mask, saturated: Mask) -> Mask:
    """Take out pixels that may hold some overflow: those next to saturated ones, three in line with three."""
    rows, columns = np.divmod(np.flatnonzero(saturated), saturated.shape[1])
    if rows.size == 0:
        return good
    trusted = good.copy()
    height, width = good.shape

    def at(steps: int, dy: int, dx: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        return np.clip(rows + steps * dy, 0, height - 1), np.clip(columns + steps * dx, 0, width - 1)

    for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        trusted[at(1, dy, dx)] = False
        flows = saturated[at(-1, dy, dx)] & saturated[at(-2, dy, dx)]
        for steps in (2, 3):
            y, x = at(steps, dy, dx)
            trusted[y[flows], x[flows]] = False
    return trusted


def _joined(parts: list[tuple[NDArray[np.intp], Profiles]], count: int) -> Profiles:
    """The fits of all sources, put together from parts with the sources' indices."""
    whole = Profiles.zeros(count)
    for some, part in parts:
        whole.put(some, part)
    return whole
