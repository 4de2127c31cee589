"""Places that four stars propose, and whether other stars of their level fall on measurements there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc

from mountnav.identification.blind.placing import Placed, placed
from mountnav.identification.blind.sky import IndexedSky
from mountnav.identification.blind.view import View
from mountnav.identification.confirmation import Corners
from mountnav.identification.full import Hypothesis
from mountnav.identification.plate import ARCSEC_PER_RAD, similarity_plate
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]

FIT_SHARE = 0.5
"""Root mean square of the four residuals, in the tolerance of the round: each may be off by that, not all."""
LEAST_FIT_PX = 0.25
AROUND_SPACINGS = 2.5
"""Stars are predicted so far round the quad, in mean distances of the level's stars: some twenty."""
CENTROID_PX = 0.15
"""A quad that fits better than this does so by luck."""
BENT = 5e-4
"""How fast a lens departs from the plate of a quad, in pixels for each pixel away from it."""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Places on the sky, each proposed by one quad, best fitting first.

    Attributes
    ----------
    corners : ndarray of complex, shape (n, 4)
        The measurements A, B, C, D, x + iy in pixels.
    stars : ndarray of int, shape (n, 4)
        Their star numbers.
    level : ndarray of int, shape (n,)
    vectors : ndarray, shape (n, 4, 3)
        The stars' unit vectors.
    fit : Placed
    """

    corners: Complex
    stars: Index
    level: Index
    vectors: Array
    fit: Placed

    def __len__(self) -> int:
        return int(self.level.size)

    def only(self, chosen: Index) -> Candidates:
        """Some of them."""
        return Candidates(
            self.corners[chosen],
            self.stars[chosen],
            self.level[chosen],
            self.vectors[chosen],
            self.fit.only(chosen),
        )

    def keys(self) -> list[bytes]:
        """What tells one candidate from another: its measurements and stars."""
        rows = np.concatenate((np.rint(8.0 * self.corners.real).astype(np.int64), self.stars), axis=1)
        return [row.tobytes() for row in rows]

    def hypothesis(self, number: int, sky: IndexedSky, view: View) -> Hypothesis:
        """One of them as the full search knows it."""
        fit, z = self.fit, self.corners[number]
        ra_deg, dec_deg = sky.catalog_places(self.stars[number])
        return Hypothesis(
            plate=similarity_plate(
                Icrs(float(fit.ra_deg[number]), float(fit.dec_deg[number])),
                complex(fit.turn[number]),
                complex(fit.shift[number]),
                mirrored=bool(fit.mirrored[number]),
                width_px=view.width_px,
                height_px=view.height_px,
            ),
            corners=Corners(z.real.copy(), z.imag.copy(), ra_deg, dec_deg),
        )


def propose(corners: Complex, tolerance: Array, quad: Index, sky: IndexedSky, view: View) -> Candidates:
    """What like-shaped quads say of the frame's place, where that can be.

    Parameters
    ----------
    corners : ndarray of complex, shape (n, 4)
        Of the frame.
    tolerance : ndarray, shape (n,)
        Of their codes.
    quad : ndarray of int, shape (n,)
        Numbers in the index.
    sky : IndexedSky
    view : View

    Returns
    -------
    Candidates
        Nothing but the four stars and what is known of scale and place was used.
    """
    stars = sky.index.stars(quad)
    vectors = sky.vectors(stars)
    fit = placed(corners, vectors, view.center)
    length = np.abs(corners[:, 0] - corners[:, 1])
    most = np.maximum(FIT_SHARE * tolerance * length, LEAST_FIT_PX)
    kept = np.flatnonzero(view.possible(fit) & (fit.residual_px <= most))
    kept = kept[np.argsort(fit.residual_px[kept] / length[kept], kind="stable")]
    return Candidates(
        corners[kept], stars[kept], sky.index.level(stars[kept, 0]), vectors[kept], fit.only(kept)
    )


def chances(some: Candidates, sky: IndexedSky, view: View) -> Array:
    """How probable it is that so many stars round the quad fall on measurements by chance.

    Parameters
    ----------
    some : Candidates
    sky : IndexedSky
    view : View

    Returns
    -------
    ndarray, shape (n,)
        Of each place, by the Poisson law; the quad's own four don't count. A screen, not the odds.
    """
    fit, count = some.fit, len(some)
    middle = some.corners.mean(axis=1)
    span = np.abs(some.corners - middle[:, None]).max(axis=1)
    axis = some.vectors.sum(axis=1)
    axis /= np.sqrt((axis**2).sum(axis=1))[:, None]
    half = np.arctan(0.5 * view.diagonal_px * np.abs(fit.turn) / ARCSEC_PER_RAD)
    dense = view.z.size / (view.width_px * view.height_px)
    hits, expected = np.zeros(count), np.zeros(count)
    for level in np.unique(some.level):
        here = np.flatnonzero(some.level == level)
        around = math.radians(AROUND_SPACINGS / math.sqrt(sky.index.density_deg2[level]))
        circle, star, vectors = sky.around(int(level), axis[here], np.minimum(2.0 * half[here], around))
        which = here[circle]
        place = fit.pixels(which, vectors)
        asked = np.flatnonzero(view.inside(place) & (some.stars[which] != star[:, None]).all(axis=1))
        if asked.size == 0:
            continue
        which, place = which[asked], place[asked]
        away = np.abs(place - middle[which])
        reach = 1.0 + 3.0 * np.maximum(fit.residual_px[which], CENTROID_PX) * (1.0 + away / span[which])
        reach = np.minimum(reach + BENT * away, view.reach_px)
        distance, nearest = (
            np.asarray(one) for one in view.tree.query(np.column_stack((place.real, place.imag)))
        )
        own = (np.abs(some.corners[which] - view.z[nearest][:, None]) < 1e-6).any(axis=1)
        hits += np.bincount(which, weights=(distance <= reach) & ~own, minlength=count)
        expected += np.bincount(which, weights=-np.expm1(-dense * np.pi * reach**2), minlength=count)
    return np.where(hits > 0, gammainc(np.maximum(hits, 1.0), np.maximum(expected, 1e-12)), 1.0)
