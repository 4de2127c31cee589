"""Field rotation and change of scale during an exposure, from the centers of light of single stars' arcs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.medians import median, medians_of_rows
from mountnav.measuring.segmentation import LightSegments
from mountnav.measuring.star_trail import REACH_PX

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

STARS = 40
"""Number of the brightest expected stars whose patches of light are used. With half as many a rotation has an
error 1.4 times as large."""
FEWEST = 6
"""Fewer arcs than this give no motion of a field, which has four parameters."""
BRIGHT = 8
"""Number of the brightest stars that are compared with the others: their trails are seen whole. Three times
as many would be the majority, whose trails may break into pieces."""
OWN_SHARE = 0.95
"""A patch belongs to one star if at least this share of the catalog's light in it is that star's. Chosen by
hand."""
STRAY_SIGMAS = 4.0
"""Centers of light farther from the fitted motion than so many times its scatter hold neighbors' light. One
honest star in 3,000 (two coordinates)."""
LEAST_SCATTER_PX = 0.15
"""Least scatter of centers of light, pixels: patches are made of whole bins of 2 px."""
TELLING_SIGMAS = 5.0
"""A rotation or growth of more than so many of its errors is significant. Chance makes one in fewer than 10^5
frames; halved, one plain frame in twenty would be taken for one that turned."""
UNLIKE = 2.0
"""Centers of light that scatter by so many times what patches of whole bins do lie otherwise for each star:
trails whose pieces, lengths or neighbors differ. Doubled, fields that turned slightly would state too little;
halved, plain trails would state too much."""
TOLD_SIGMAS, TOLD_PX = 3.0, 0.5
"""Then a distance of so many of its errors, and of so many pixels, between their middle and the plate's
positions is significant: neighbors in the same patches move the middle of all by up to 0.3 px where a plate
is right. Doubled, 1.3 px of error would be left out; halved, short trails would state what their neighbors
do."""


@dataclass(frozen=True, slots=True)
class FieldMotion:
    """Offset, rotation and growth of the stars' centers of light against a plate's positions.

    Attributes
    ----------
    center_px : complex
        At the frame's center.
    center_sigma_px : float
        Per coordinate.
    turn : complex
        Change per pixel: the real part grows, the imaginary one turns.
    scatter_px : float
        Of single stars about this.
    """

    center_px: complex
    center_sigma_px: float
    turn: complex
    turn_sigma: float
    scatter_px: float
    stars: int

    @property
    def differs(self) -> bool:
        """Whether the rotation or growth is significant."""
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
        significant = self.differs or (unlike and away_px > max(TOLD_PX, TOLD_SIGMAS * self.center_sigma_px))
        return away_px if significant else 0.0


@dataclass(frozen=True, slots=True)
class Centers:
    """Offsets of single stars' centers of light from a plate's positions, brightest star first; shape (n,).

    Attributes
    ----------
    place : ndarray of complex
        The plate's, from the frame's center, pixels: x + iy.
    """

    place: Complex
    off: Complex

    def beside(self, path: complex, motion: FieldMotion | None) -> tuple[int, float, float]:
        """How far the brightest stars' light lies from where both a common path and a motion have it.

        A trail is seen whole where its star is bright; faint ones break into pieces, and a plate on pieces
        finds most stars where it has them.

        Parameters
        ----------
        path : complex
            Of the light, pixels, the same for all.

        Returns
        -------
        stars : int
            Number of them.
        off_px : float
            Of the median of these stars.
        scattered_px : float
            Median distance of each of them, in whatever direction: where a field turned, and its faint stars
            show only the brightest part of the way, the bright ones lie beside it all around.
        """
        place, off = self.place[:BRIGHT], self.off[:BRIGHT]
        if off.size == 0:
            return 0, 0.0, 0.0
        left = [off - path]
        if motion is not None:
            left.append(off - motion.center_px - motion.turn * place)
        away, scattered = (
            min(abs(_median(one)) for one in left),
            min(median(np.abs(one)) for one in left),
        )
        return int(off.size), away, scattered


def _median(of: Complex) -> complex:
    return complex(median(of.real), median(of.imag))


def centers_of_light(
    patches: LightSegments, x_px: Array, y_px: Array, light: Array, center: complex
) -> Centers:
    """Compare where a plate has its stars with the middle of the light that lies there.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        Where the plate has the stars, identified or not.
    light : ndarray, shape (n,)
        Theirs by the catalog, to a common scale.
    center : complex
        The frame's, pixels: x + iy.
    """
    order = np.argsort(-light, kind="stable")
    x, y, light = x_px[order], y_px[order], light[order]
    at = patches.at(x, y)
    total = np.bincount(at[at >= 0], light[at >= 0], minlength=patches.x_px.size)
    some = np.flatnonzero(at >= 0)
    # a patch with a second star that isn't faint gives the position of neither
    some = some[patches.whole[at[some]] & (light[some] >= OWN_SHARE * total[at[some]])][:STARS]
    place = x[some] + 1j * y[some] - center
    off = patches.x_px[at[some]] + 1j * patches.y_px[at[some]] - center - place
    near = np.abs(off) < REACH_PX
    return Centers(place[near], off[near])


def field_motion(centers: Centers) -> FieldMotion | None:
    """Fit off = a + b·place to what most stars say: least median of squares, then all that are near it.

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
    far = apart > 0.5 * median(apart)
    i, j = i[far], j[far]
    b = (off[i] - off[j]) / (place[i] - place[j])
    a = off[i] - b * place[i]
    left = medians_of_rows(np.abs(off - a[:, None] - b[:, None] * place))
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
