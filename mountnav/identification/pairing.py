"""Which star is which measurement under a plate: mutually nearest, spread over fragments [S23 §3.1]."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.stars import Stars
from mountnav.identification.plate import Plate
from mountnav.identification.selection import rank_in_cell

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

REACH = 2.0
"""Stars farther than this many half frames from the center are not even asked."""
LEAST_PER_FRAGMENT = 3


@dataclass(frozen=True, slots=True)
class Pairs:
    """Identified pairs.

    Attributes
    ----------
    measurement, star : ndarray of int, shape (n,)
        Indices in the measurements and in the stars.
    """

    measurement: Index
    star: Index

    def __len__(self) -> int:
        return int(self.star.size)

    def those(self, chosen: Mask | Index) -> Pairs:
        """Some of them."""
        return Pairs(self.measurement[chosen], self.star[chosen])


NO_PAIRS = Pairs(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))


@dataclass(frozen=True, slots=True)
class Predicted:
    """Stars that a plate puts in the frame, brightest first.

    Attributes
    ----------
    star : ndarray of int, shape (n,)
        Indices in the list of stars.
    x_px, y_px : ndarray, shape (n,)
    """

    star: Index
    x_px: Array
    y_px: Array

    def __len__(self) -> int:
        return int(self.star.size)


def predicted(
    plate: Plate,
    stars: Stars,
    *,
    width_px: int,
    height_px: int,
    margin_px: float = 0.0,
    projected: tuple[Array, Array] | None = None,
) -> Predicted:
    """Put stars in the frame.

    Parameters
    ----------
    plate : Plate
    stars : Stars
    width_px, height_px : int
    margin_px : float
        Stars so far outside the frame's edges are taken as well.
    projected : two ndarrays, shape (len(stars),), optional
        What `plate.project` makes of the stars, if that is known.

    Returns
    -------
    Predicted
    """
    xi, eta = projected if projected is not None else plate.project(stars.ra_deg, stars.dec_deg)
    reach = REACH * plate.unit_px * plate.scale_arcsec_px()
    # NaN, a star behind, is never near
    seen = np.flatnonzero((xi - plate.xi[0]) ** 2 + (eta - plate.eta[0]) ** 2 < reach**2)
    x, y = plate.pixels(xi[seen], eta[seen])
    least, right, high = -0.5 - margin_px, width_px - 0.5 + margin_px, height_px - 0.5 + margin_px
    inside = (x > least) & (x < right) & (y > least) & (y < high)
    return Predicted(seen[inside], x[inside], y[inside])


def nearest_pairs(
    places: Predicted, measurement: Index, x_px: Array, y_px: Array, strobe_px: float
) -> tuple[Pairs, Index]:
    """Pair each star with a measurement when both are each other's nearest and within the strobe.

    Parameters
    ----------
    places : Predicted
    measurement : ndarray of int, shape (m,)
        The measurements that may take part.
    x_px, y_px : ndarray
        Of all measurements.
    strobe_px : float

    Returns
    -------
    pairs : Pairs
        Brightest star first.
    place : ndarray of int, shape (len(pairs),)
        Which of the predicted places each is.
    """
    if len(places) == 0 or measurement.size == 0:
        return NO_PAIRS, np.zeros(0, dtype=np.int64)
    predictions = np.column_stack((places.x_px, places.y_px))
    sources = np.column_stack((x_px[measurement], y_px[measurement]))
    distance, nearest = (
        np.asarray(one) for one in cKDTree(sources).query(predictions, distance_upper_bound=strobe_px)
    )
    found = np.flatnonzero(np.isfinite(distance))
    back = np.asarray(cKDTree(predictions).query(sources[nearest[found]])[1])
    found = found[back == found]
    return Pairs(measurement[nearest[found]], places.star[found]), found


def spread_over_fragments(
    x_px: Array, y_px: Array, mag: Array, *, width_px: int, height_px: int, fragments: int, cap: float
) -> Mask:
    """Take the brightest pairs of each fragment of the frame, so that none outvotes the others.

    Parameters
    ----------
    x_px, y_px, mag : ndarray, shape (n,)
        Places and magnitudes of the pairs.
    width_px, height_px : int
    fragments : int
        The frame is cut in fragments × fragments parts.
    cap : float
        A fragment gives at most this many times its fair share among the fragments that have pairs, and at
        least three.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    column = np.clip(((x_px + 0.5) / width_px * fragments).astype(np.int64), 0, fragments - 1)
    row = np.clip(((y_px + 0.5) / height_px * fragments).astype(np.int64), 0, fragments - 1)
    cell = row * fragments + column
    order = np.argsort(mag, kind="stable")
    rank = np.empty(x_px.size, dtype=np.int64)
    rank[order] = rank_in_cell(cell[order])
    fair = x_px.size / max(1, np.unique(cell).size)
    most = max(LEAST_PER_FRAGMENT, math.ceil(cap * fair))
    taken: Mask = rank < most
    return taken
