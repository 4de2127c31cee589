"""Did the stars of a frame all have the same path? Turning and breathing fields tell by their arcs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from mountnav.measuring.segmentation import LightSegments
from mountnav.measuring.star_trail import REACH_PX

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

STARS = 40
"""So many of the brightest expected stars are asked. Half of them would tell turns half as well."""
FEWEST = 6
"""Fewer arcs than this tell no motion of a field, which has four numbers."""
BRIGHT = 8
"""So many of the brightest stars are asked alone. Three times as many are the majority that may break."""
OWN_SHARE = 0.95
"""A patch is a star's own if so much of the light that the catalog puts there is this star's."""
STRAY_SIGMAS = 4.0
"""Centers of light farther off the motion than so many of its scatter are neighbors' light."""
LEAST_SCATTER_PX = 0.15
"""No center of a patch, made of whole bins, is known better."""
TELLING_SIGMAS = 5.0
"""From so many of its errors on a difference over the field is one."""
SEEDS = 12
"""So many of the brightest stars propose where a second image of them all may lie."""
OTHERS = 60
"""Among so many of the brightest patches that no star explains."""
GREATEST_TURN = 0.3
"""A second image is turned or grown by no more than this (radians, share): 400 px over a frame of 1,300."""
NEAR_PX = 3.0
"""A patch so near to where the second image of a star should be is that image, so patches are placed."""
CHANCE = 1e-6
"""A second image that chance makes in fewer frames than this is one."""
UNEXPLAINED = 3.0
"""Light of so many times what the catalog lets expect isn't explained by the star: colors and variable stars
make less."""
BRIGHT_SHARE = 0.25
"""LightSegments below this share of the identified stars' median light aren't counted as bright strangers: a
second image as faint as that moves the middle by a fifth of the way."""
UNEXPLAINED_SHARE = 0.1
"""With fewer strangers than this share of the bright patches points aren't asked for a second image of them
all: of one with a third of the light less than half are bright enough, and in a crowd half of these lie in
other stars' patches. Reached in half of all frames it would cost time; doubled, such a one is overlooked."""
CROWD, CROWD_REACH_PX = 400, 60.0
"""Where no patch tells of a second image of drawn-out stars, so many of the brightest measured sources are
asked within this distance of the identified ones. Doubled, each costs four times the time."""
ALIKE_LIGHT = 0.3
"""The two images of a star differ by no more than this share, where any patch may be the second."""
UNLIKE = 2.0
"""Centers of light that scatter by so many times what patches of whole bins do lie otherwise for each star:
trails whose pieces, lengths or neighbors differ. Doubled, fields that turned slightly would state too little;
halved, plain trails would state too much."""
TOLD_SIGMAS, TOLD_PX = 3.0, 0.5
"""Then a distance of so many of its errors, and of so many pixels, between their middle and the plate's
places is told: neighbors in the same patches move the middle of all by up to 0.3 px where a plate is right.
Doubled, 1.3 px of error would be untold; halved, short trails would state what their neighbors do."""


@dataclass(frozen=True, slots=True)
class FieldMotion:
    """How the centers of light of the stars' own patches lie about a plate's places.

    Attributes
    ----------
    center_px : complex
        At the frame's center.
    center_sigma_px : float
        Per coordinate.
    turn : complex
        Change per pixel: the real part grows, the imaginary one turns.
    turn_sigma : float
    scatter_px : float
        Of single stars about this.
    stars : int
    """

    center_px: complex
    center_sigma_px: float
    turn: complex
    turn_sigma: float
    scatter_px: float
    stars: int

    @property
    def differs(self) -> bool:
        """Whether it is another one here than there."""
        return abs(self.turn) > TELLING_SIGMAS * self.turn_sigma

    def beside_px(self, common: complex, *, drawn_out: bool) -> float:
        """How far the middle of the light lies from where a path that is common to all stars has it.

        Parameters
        ----------
        common : complex
            That path's center of light, pixels.
        drawn_out : bool
            Whether the images are no points.

        Returns
        -------
        float
            0 where all stars' light lies alike: a trail in two pieces has two middles, and both are common.
        """
        away_px = abs(self.center_px - common)
        unlike = drawn_out and self.scatter_px > UNLIKE * LEAST_SCATTER_PX
        told = self.differs or (unlike and away_px > max(TOLD_PX, TOLD_SIGMAS * self.center_sigma_px))
        return away_px if told else 0.0


@dataclass(frozen=True, slots=True)
class Centers:
    """Where the middle of single stars' light lies beside a plate's places, brightest star first; shape (n,).

    Attributes
    ----------
    place : ndarray of complex
        The plate's, from the frame's center, pixels: x + iy.
    off : ndarray of complex
    """

    place: Complex
    off: Complex

    def beside(self, path: complex, motion: FieldMotion | None) -> tuple[int, float]:
        """How far the brightest stars' light lies from where both a common path and a motion have it.

        A trail is seen whole where its star is bright; faint ones break into pieces, and a plate on pieces
        finds most stars where it has them.

        Parameters
        ----------
        path : complex
            Of the light, pixels, the same for all.
        motion : FieldMotion or None

        Returns
        -------
        stars : int
            That were asked.
        off_px : float
            Of the median of these stars.
        """
        place, off = self.place[:BRIGHT], self.off[:BRIGHT]
        if off.size == 0:
            return 0, 0.0
        away = [abs(_median(off - path))]
        if motion is not None:
            away.append(abs(_median(off - motion.center_px - motion.turn * place)))
        return int(off.size), min(away)


def _median(of: Complex) -> complex:
    return complex(float(np.median(of.real)), float(np.median(of.imag)))


def centers_of_light(
    patches: LightSegments, x_px: Array, y_px: Array, light: Array, center: complex
) -> Centers:
    """Compare where a plate has its stars with the middle of the light that lies there.

    Parameters
    ----------
    patches : LightSegments
    x_px, y_px : ndarray, shape (n,)
        Where the plate has the stars, identified or not.
    light : ndarray, shape (n,)
        Theirs by the catalog, to a common scale.
    center : complex
        The frame's, pixels: x + iy.

    Returns
    -------
    Centers
    """
    order = np.argsort(-light, kind="stable")
    x, y, light = x_px[order], y_px[order], light[order]
    at = patches.at(x, y)
    total = np.bincount(at[at >= 0], light[at >= 0], minlength=patches.x_px.size)
    some = np.flatnonzero(at >= 0)
    # two stars in one patch tell of neither, if the second isn't faint
    some = some[patches.whole[at[some]] & (light[some] >= OWN_SHARE * total[at[some]])][:STARS]
    place = x[some] + 1j * y[some] - center
    off = patches.x_px[at[some]] + 1j * patches.y_px[at[some]] - center - place
    near = np.abs(off) < REACH_PX
    return Centers(place[near], off[near])


def field_motion(centers: Centers) -> FieldMotion | None:
    """Fit off = a + b·place to what most stars say: least median of squares, then all that are near it.

    Parameters
    ----------
    centers : Centers

    Returns
    -------
    FieldMotion or None
        None where too few stars have a patch of light of their own.
    """
    place, off = centers.place, centers.off
    if place.size < FEWEST:
        return None
    i, j = np.triu_indices(place.size, 1)
    apart = np.abs(place[i] - place[j])
    far = apart > 0.5 * np.median(apart)
    i, j = i[far], j[far]
    b = (off[i] - off[j]) / (place[i] - place[j])
    a = off[i] - b * place[i]
    left = np.median(np.abs(off - a[:, None] - b[:, None] * place), axis=1)
    # a common path is tried as well, so that noise isn't taken for a turn
    best = int(np.argmin(left))
    a0, b0 = complex(a[best]), complex(b[best])
    scatter = max(0.85 * float(left[best]), LEAST_SCATTER_PX)
    for _ in range(4):
        kept = np.abs(off - a0 - b0 * place) < STRAY_SIGMAS * scatter
        if kept.sum() < FEWEST - 1:
            return None
        z, d = place[kept], off[kept]
        middle = z.mean()
        spread2 = float((np.abs(z - middle) ** 2).sum())
        b0 = complex(((z - middle).conj() * (d - d.mean())).sum() / max(spread2, 1e-9))
        a0 = complex(d.mean() - b0 * middle)
        left2 = float((np.abs(d - a0 - b0 * z) ** 2).sum()) / max(1.0, 2.0 * (z.size - 2))
        scatter = max(math.sqrt(left2), LEAST_SCATTER_PX)
    turn_sigma = scatter / math.sqrt(max(spread2, 1e-9))
    center_sigma = math.hypot(scatter / math.sqrt(z.size), turn_sigma * abs(middle))
    return FieldMotion(a0, center_sigma, b0, turn_sigma, scatter, int(z.size))


@dataclass(frozen=True, slots=True)
class SecondImage:
    """A second set of the same stars in a frame.

    Attributes
    ----------
    center_px : complex
        How far from the first at the frame's center.
    turn : complex
        And how that changes per pixel.
    ratio : float
        Of its light to that of the first.
    stars : int
        That were found in it.
    """

    center_px: complex
    turn: complex
    ratio: float
    stars: int

    @property
    def pull_px(self) -> float:
        """How far the middle of both lies from the first, at the frame's center."""
        return abs(self.center_px) * self.ratio / (1.0 + self.ratio)


@dataclass(frozen=True, slots=True)
class UnexplainedLight:
    """The bright patches of light that no star of a plate explains, brightest first; shape (n,).

    Attributes
    ----------
    x_px, y_px, flux : ndarray
    known : ndarray of int
        Indices of the brightest patches that the plate's stars do explain.
    many : bool
        So many of them are bright that they may be stars as well as the known ones are.
    """

    x_px: Array
    y_px: Array
    flux: Array
    known: Index
    many: bool


def unexplained_light(
    patches: LightSegments, x_px: Array, y_px: Array, light: Array
) -> UnexplainedLight | None:
    """Part the patches of light into those that a plate's stars explain and the others.

    Parameters
    ----------
    patches : LightSegments
    x_px, y_px, light : ndarray, shape (n,)
        Where a plate has all the stars that it knows of, and their light by the catalog.

    Returns
    -------
    Strangers or None
        None where no patch is known, so that nothing tells what a star's light is here.
    """
    at = patches.at(x_px, y_px)
    own = np.bincount(at[at >= 0], light[at >= 0], minlength=patches.x_px.size)
    known = np.flatnonzero(own > 0)
    if known.size == 0:
        return None
    brightest = known[np.argsort(-own[known], kind="stable")][:STARS]
    per_light = float(np.median(patches.flux[brightest] / own[brightest]))
    # a faint star that happens to lie in a bright patch doesn't explain it
    strange = patches.flux > UNEXPLAINED * per_light * own
    known = known[~strange[known]]
    if known.size == 0:
        return None
    known = known[np.argsort(-patches.flux[known], kind="stable")][:STARS]
    bright = BRIGHT_SHARE * float(np.median(patches.flux[known[: STARS // 2]]))
    others = np.flatnonzero(strange)
    others = others[np.argsort(-patches.flux[others], kind="stable")][:OTHERS]
    count = int((patches.flux[others] > bright).sum())
    fewest = UNEXPLAINED_SHARE * (count + int((patches.flux[known] > bright).sum()))
    return UnexplainedLight(
        patches.x_px[others], patches.y_px[others], patches.flux[others], known, count >= max(FEWEST, fewest)
    )


def second_image(
    patches: LightSegments,
    x_px: Array,
    y_px: Array,
    light: Array,
    center: complex,
    shape: tuple[int, int],
    *,
    drawn_out: bool = True,
) -> SecondImage | None:
    """Look for the same stars once more, elsewhere, and turned or grown: an exposure in two parts.

    Where the second image lies at the same offset everywhere, `star_trail` sees it too.

    Parameters
    ----------
    patches : LightSegments
    x_px, y_px : ndarray, shape (n,)
        Where a plate has all the stars that it knows of.
    light : ndarray, shape (n,)
        Theirs by the catalog, to a common scale.
    center : complex
    shape : (int, int)
        Of the frame: height, width.
    drawn_out : bool
        Whether the images are no points: then it is looked for however faint it may be, else only where
        there are bright patches that no star explains.

    Returns
    -------
    SecondImage or None
    """
    found = unexplained_light(patches, x_px, y_px, light)
    if found is None or min(found.known.size, found.x_px.size) < FEWEST:
        return None
    if not (drawn_out or found.many):
        return None
    known = found.known
    first = patches.x_px[known] + 1j * patches.y_px[known] - center
    second = found.x_px + 1j * found.y_px - center
    return _second(first, patches.flux[known], second, found.flux, center, shape)


def second_sources(
    x_px: Array, y_px: Array, flux: Array, identified: Index, center: complex, shape: tuple[int, int]
) -> SecondImage | None:
    """Look for the second image of a crowd among the measured sources, where patches of light run together.

    Parameters
    ----------
    x_px, y_px, flux : ndarray, shape (n,)
        All that was measured.
    identified : ndarray of int, shape (m,)
        Those that the plate has a star for.
    center : complex
    shape : (int, int)
        Of the frame: height, width.

    Returns
    -------
    SecondImage or None
        Near by alone (`CROWD_REACH_PX`): farther off the images lie in patches of their own.
    """
    lit = identified[np.isfinite(flux[identified]) & (flux[identified] > 0)]
    lit = lit[np.argsort(-flux[lit], kind="stable")][:STARS]
    if lit.size < FEWEST:
        return None
    every = np.flatnonzero(np.isfinite(flux) & (flux > ALIKE_LIGHT * flux[lit].min()))
    every = every[np.argsort(-flux[every], kind="stable")][:CROWD]
    place = x_px + 1j * y_px - center
    return _second(place[lit], flux[lit], place[every], flux[every], center, shape, CROWD_REACH_PX)


def _second(
    first: Complex,
    first_flux: Array,
    second: Complex,
    second_flux: Array,
    center: complex,
    shape: tuple[int, int],
    reach_px: float = REACH_PX,
) -> SecondImage | None:
    """The similarity near to none that puts most of the first upon some of the second."""
    seeds = min(SEEDS, first.size)
    d = second[None, :] - first[:seeds, None]
    alike = np.ones(d.shape, dtype=bool)
    if reach_px < REACH_PX:
        light = second_flux[None, :] / first_flux[:seeds, None]
        alike = (light > ALIKE_LIGHT) & (light < 1.0 / ALIKE_LIGHT)
    i, j = np.nonzero((np.abs(d) < reach_px) & (np.abs(d) > NEAR_PX) & alike)
    p, q = np.triu_indices(i.size, 1)
    apart = first[i[q]] - first[i[p]]
    wide = (i[p] != i[q]) & (j[p] != j[q]) & (np.abs(apart) > 0.15 * min(shape))
    p, q, apart = p[wide], q[wide], apart[wide]
    b = (d[i[q], j[q]] - d[i[p], j[p]]) / apart
    small = np.abs(b) < GREATEST_TURN
    b, p = b[small], p[small]
    if b.size == 0:
        return None
    a = d[i[p], j[p]] - b * first[i[p]]
    best, hits, chance = None, 0, 1.0
    share = math.pi * NEAR_PX**2 * second.size / (shape[0] * shape[1])
    for part in np.array_split(np.arange(b.size), b.size * first.size * second.size // 4_000_000 + 1):
        there = first + a[part, None] + b[part, None] * first
        near = (np.abs(there[:, :, None] - second) < NEAR_PX).any(axis=2)
        at = there + center
        inside = (at.real > 0) & (at.imag > 0) & (at.real < shape[1]) & (at.imag < shape[0])
        told, asked = near.sum(axis=1), inside.sum(axis=1)
        odds = bdtrc(told - 3.0, np.maximum(asked, told) - 2, min(share, 0.5)) * b.size
        k = int(np.argmin(np.where(told > 3, odds, np.inf)))
        if told[k] > 3 and odds[k] < chance:
            best, hits, chance = int(part[k]), int(told[k]), float(odds[k])
    if best is None or chance > CHANCE:
        return None
    there = first + a[best] + b[best] * first
    away = np.abs(there[:, None] - second)
    near_by = away.min(axis=1) < NEAR_PX
    ratio = float(np.median(second_flux[away.argmin(axis=1)[near_by]] / first_flux[near_by]))
    return SecondImage(complex(a[best]), complex(b[best]), ratio, hits)
