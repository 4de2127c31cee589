"""Which sources persist over a series: three frames make a source; rays, trails and satellites drop out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PATIENCE = 10
"""A source seen too seldom and not at all in so many frames is forgotten. Frames. A limit of memory; dithered
series need several."""


@dataclass(frozen=True, slots=True)
class PersistentSources:
    """Sources seen in enough frames; each array has shape (n,), those seen most often first.

    Attributes
    ----------
    x_px, y_px : ndarray
        Mean places in the pixels of the frame that the others are followed from.
    frames : ndarray of int
        In how many frames.
    flux : ndarray
        Mean flux, ADU.
    """

    x_px: Array
    y_px: Array
    frames: Index
    flux: Array

    def __len__(self) -> int:
        return int(self.x_px.size)


class Persistence:
    """Keeps the sources of a series in common pixels.

    Parameters
    ----------
    least_frames : int
        Frames that make a source persistent [S23: three].
    """

    def __init__(self, least_frames: int = 3) -> None:
        self._least = least_frames
        self._x: Array = np.zeros(0)
        self._y: Array = np.zeros(0)
        self._flux: Array = np.zeros(0)
        self._count: Index = np.zeros(0, dtype=np.int64)
        self._seen: Index = np.zeros(0, dtype=np.int64)
        self._id: Index = np.zeros(0, dtype=np.int64)
        self._out_of_sight: Index = np.zeros(0, dtype=np.int64)  # persistent, but left behind by a slew
        self._next = 0
        self._frames = 0

    def add(self, x_px: Array, y_px: Array, flux: Array, reach_px: float) -> Index:
        """Add a frame's measurements.

        Parameters
        ----------
        x_px, y_px : ndarray, shape (n,)
            In common pixels: moved by the frame's shift.
        flux : ndarray, shape (n,)
            ADU.
        reach_px : float
            How near two sightings of one source lie.

        Returns
        -------
        ndarray of int, shape (n,)
            Each measurement's source, by its number.
        """
        from scipy.spatial import cKDTree  # 0.2 s that a service does not need to start

        self._frames += 1
        ids = np.full(x_px.size, -1, dtype=np.int64)
        if x_px.size and self._x.size:
            here, known = np.column_stack((x_px, y_px)), np.column_stack((self._x, self._y))
            tree = cKDTree(known)
            distance, nearest = (np.asarray(part) for part in tree.query(here, distance_upper_bound=reach_px))
            found = np.flatnonzero(np.isfinite(distance))
            partner = nearest[found].astype(np.int64)
            back = np.asarray(cKDTree(here).query(known[partner])[1])
            mutual = back == found
            found, partner = found[mutual], partner[mutual]
            ids[found] = self._id[partner]
            self._count[partner] += 1
            self._seen[partner] = self._frames
            part = 1.0 / self._count[partner]
            self._x[partner] += (x_px[found] - self._x[partner]) * part
            self._y[partner] += (y_px[found] - self._y[partner]) * part
            self._flux[partner] += (flux[found] - self._flux[partner]) * part
        new = np.flatnonzero(ids < 0)
        ids[new] = np.arange(self._next, self._next + new.size)
        self._next += new.size
        self._x = np.concatenate((self._x, x_px[new]))
        self._y = np.concatenate((self._y, y_px[new]))
        self._flux = np.concatenate((self._flux, flux[new]))
        self._count = np.concatenate((self._count, np.ones(new.size, dtype=np.int64)))
        self._seen = np.concatenate((self._seen, np.full(new.size, self._frames)))
        self._id = np.concatenate((self._id, ids[new]))
        self._forget()
        return ids

    def persistent(self, ids: Index) -> NDArray[np.bool_]:
        """Which of these sources have been seen in enough frames by now; shape as `ids`."""
        enough = self._id[self._count >= self._least]
        known: NDArray[np.bool_] = np.isin(ids, np.concatenate((enough, self._out_of_sight)))
        return known

    def sources(self) -> PersistentSources:
        """All persistent sources within sight of the frame that the pixels are of."""
        chosen = np.flatnonzero(self._count >= self._least)
        chosen = chosen[np.argsort(-self._count[chosen], kind="stable")]
        return PersistentSources(self._x[chosen], self._y[chosen], self._count[chosen], self._flux[chosen])

    def change_pixels(self, to_new: Callable[[Array, Array], tuple[Array, Array]]) -> None:
        """Go over to another frame's pixels.

        Parameters
        ----------
        to_new : callable
            Takes and gives x and y, shape (n,); NaN where a source can't be seen any more.
        """
        x, y = to_new(self._x, self._y)
        good = np.isfinite(x) & np.isfinite(y)
        self._x, self._y = x, y
        gone = self._id[~good & (self._count >= self._least)]
        self._out_of_sight = np.concatenate((self._out_of_sight, gone))
        self._keep(good)

    def _forget(self) -> None:
        self._keep((self._count >= self._least) | (self._seen > self._frames - PATIENCE))

    def _keep(self, kept: NDArray[np.bool_]) -> None:
        if kept.all():
            return
        self._x, self._y, self._flux = self._x[kept], self._y[kept], self._flux[kept]
        self._count, self._seen, self._id = self._count[kept], self._seen[kept], self._id[kept]
