"""Stars and measurements that lie close: found once by trees, asked again under plates that differ little."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.identification.pairing import Pairs, Predicted
from mountnav.identification.rejection import in_groups

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


class Neighborhood:
    """Which stars and measurements lie close, found once and asked again under plates that differ little.

    Parameters
    ----------
    places : Predicted
        Of the stars in the frame and somewhat outside, under one plate.
    stars : int
        How many stars the list has that `places.star` points into.
    x_px, y_px : ndarray, shape (m,)
        Measurements.
    reach_px : float
        How far stars and measurements may lie apart to be remembered.
    group_px : float
        The same of stars among each other.
    """

    def __init__(
        self, places: Predicted, stars: int, x_px: Array, y_px: Array, *, reach_px: float, group_px: float
    ) -> None:
        self._reach_px, self._x_px, self._y_px = reach_px, x_px, y_px
        self._then = np.full((2, stars), np.nan)
        self._then[:, places.star] = places.x_px, places.y_px
        tree = cKDTree(np.column_stack((places.x_px, places.y_px)))
        sources = cKDTree(np.column_stack((x_px, y_px)))
        found = tree.sparse_distance_matrix(sources, reach_px, output_type="ndarray")
        self._star, self._source = places.star[found["i"]], found["j"].astype(np.int64)
        close = tree.query_pairs(group_px, output_type="ndarray")
        self._groups = places.star[close]

    def holds(self, places: Predicted, strobe_px: float) -> bool:
        """Whether all that may lie within a strobe under these places is remembered."""
        x, y = self._then[:, places.star]
        moved2 = (x - places.x_px) ** 2 + (y - places.y_px) ** 2
        # NaN: a star that wasn't in the frame then
        return bool(np.all(moved2 <= max(self._reach_px - strobe_px, 0.0) ** 2))

    def pairs(self, places: Predicted, most: int, strobe_px: float) -> tuple[Pairs, Index]:
        """Pair each star with one of the first `most` measurements when both are each other's nearest.

        Parameters
        ----------
        places : Predicted
            See `holds`.
        most : int
        strobe_px : float
            No pair lies farther apart.

        Returns
        -------
        pairs : Pairs
            Brightest star first.
        place : ndarray of int, shape (len(pairs),)
            Which of the predicted places each is.
        """
        now = np.full((2, self._then.shape[1]), np.nan)
        now[:, places.star] = places.x_px, places.y_px
        x, y = now[:, self._star]
        distance2 = (x - self._x_px[self._source]) ** 2 + (y - self._y_px[self._source]) ** 2
        near = np.flatnonzero((distance2 < strobe_px**2) & (self._source < most))
        star, source = self._star[near], self._source[near]
        best = mutually_nearest(distance2[near], star, source)
        star, source = star[best], source[best]
        return Pairs(source, star), np.searchsorted(places.star, star)

    def grouped_stars(self, places: Predicted, magnitude: Array, radius_px: float, depth_mag: float) -> Mask:
        """Stars in a tight group, shape (len(places),); arguments as of `rejection.in_groups`."""
        number = np.full(self._then.shape[1], -1)
        number[places.star] = np.arange(len(places))
        close = number[self._groups]
        close = close[(close >= 0).all(axis=1)]
        return in_groups(close, places.x_px, places.y_px, magnitude, radius_px, depth_mag)


def mutually_nearest(distance2: Array, star: Index, source: Index) -> Index:
    """Which of a list of close couples are each other's nearest.

    Parameters
    ----------
    distance2 : ndarray, shape (n,)
        Squared distances.
    star, source : ndarray of int, shape (n,)
        What lies so far apart.

    Returns
    -------
    ndarray of int, shape (k,)
        By rising star.
    """
    if distance2.size == 0:
        return np.zeros(0, dtype=np.int64)
    order = np.argsort(distance2, kind="stable")[::-1]
    star_nearest = np.full(int(star.max()) + 1, -1)
    source_nearest = np.full(int(source.max()) + 1, -1)
    # written farthest first, so that the nearest stays
    star_nearest[star[order]] = order
    source_nearest[source[order]] = order
    best = star_nearest[star_nearest >= 0]
    return np.asarray(best[source_nearest[source[best]] == best])
