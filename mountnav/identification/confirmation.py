"""Independent confirmation: stars that had no part in making a plate are asked whether it is right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.stars import Stars
from mountnav.identification.odds import area_share, at_least, chance_at
from mountnav.identification.plate import SIMILARITY, Plate, fit_plate

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_STARS = 150
FEW_STARS = 40
LINEAR_PAIRS = 7
LEAST_CHANCE = 1e-300
"""Below this a probability is not told apart from zero."""


@dataclass(frozen=True, slots=True)
class Corners:
    """The three pairs of a triangle: they made the plate, so they prove nothing.

    Attributes
    ----------
    x_px, y_px, ra_deg, dec_deg : ndarray, shape (3,)
    """

    x_px: Array
    y_px: Array
    ra_deg: Array
    dec_deg: Array


class Witnesses:
    """The measurements and stars that can speak about one hypothesis.

    Parameters
    ----------
    plate : Plate
        What the triangle proposed, untouched by any fit to other stars.
    corners : Corners
    stars : Stars
        Of the whole frame, brightest first.
    x_px, y_px : ndarray, shape (n,)
        Star-like measurements, brightest first.
    width_px, height_px : int
    match_px : float
        How far off the triangle's plate may be.
    """

    def __init__(
        self,
        plate: Plate,
        corners: Corners,
        stars: Stars,
        x_px: Array,
        y_px: Array,
        *,
        width_px: int,
        height_px: int,
        match_px: float,
    ) -> None:
        self._plate = plate.moved_to(plate.center())
        self._width, self._height, self._match_px = width_px, height_px, match_px
        xi, eta = self._plate.project(stars.ra_deg, stars.dec_deg)
        x, y = self._plate.pixels(xi, eta)
        seen = np.flatnonzero(self._inside(x, y))[:MOST_STARS]
        corner = np.isin(stars.ra_deg[seen], corners.ra_deg) & np.isin(stars.dec_deg[seen], corners.dec_deg)
        seen = seen[~corner]
        self._xi, self._eta = xi[seen], eta[seen]
        bright = slice(0, max(60, 2 * int(seen.size)))
        free = ~(np.isin(x_px[bright], corners.x_px) & np.isin(y_px[bright], corners.y_px))
        self._x, self._y = x_px[bright][free], y_px[bright][free]
        corner_xi, corner_eta = self._plate.project(corners.ra_deg, corners.dec_deg)
        self._corners = (corners.x_px, corners.y_px, corner_xi, corner_eta)

    def _inside(self, x: Array, y: Array) -> NDArray[np.bool_]:
        inside: NDArray[np.bool_] = (
            (x > -0.5) & (x < self._width - 0.5) & (y > -0.5) & (y < self._height - 0.5)
        )
        return inside

    def chance(self) -> float:
        """Probability that a wrong plate would be confirmed this well; for one hypothesis.

        The stars predicted in the frame are dealt in two hands (three if they are few). One hand teaches:
        the triangle and that hand's pairs make a plate, and all other stars are predicted with it. For a
        wrong plate the number of those that fall within a strobe of a measurement is binomial, the chance of
        each given by the density of measurements where it falls. Neither the triangle's three stars and
        measurements, nor anything fit to the stars asked, takes part. Each hand teaches once, if stars are
        few the triangle also alone, and two strobes are looked at: the least probability is multiplied by the
        number of looks.

        Returns
        -------
        float
            Never below 1e-300.
        """
        count = int(self._xi.size)
        if count == 0 or self._x.size == 0:
            return 1.0
        tree = cKDTree(np.column_stack((self._x, self._y)))
        few = count < FEW_STARS
        hands = 3 if few else 2
        hand = np.arange(count) % hands
        strobe_px = max(2.5, min(self._match_px, 0.006 * min(self._width, self._height)))
        strobes = (strobe_px, strobe_px / 3.0)
        lessons = [hand == teaching for teaching in range(hands)]
        if few:
            lessons.append(np.zeros(count, dtype=bool))
        shares = [
            area_share(self._x, self._y, strobe, width_px=self._width, height_px=self._height)
            for strobe in strobes
        ]
        least = 1.0
        for teaching in lessons:
            taught = self._taught(teaching, strobe_px, tree)
            x, y = taught.pixels(self._xi[~teaching], self._eta[~teaching])
            inside = self._inside(x, y)
            x, y = x[inside], y[inside]
            if x.size == 0:
                continue
            distance, nearest = (np.asarray(one) for one in tree.query(np.column_stack((x, y))))
            for strobe, share in zip(strobes, shares, strict=True):
                hits = np.unique(nearest[distance <= strobe]).size
                chance = chance_at(share, x, y, width_px=self._width, height_px=self._height)
                least = min(least, float(at_least(np.array([hits]), np.array([x.size]), chance)[0]))
        return float(np.clip(len(lessons) * len(strobes) * least, LEAST_CHANCE, 1.0))

    def _taught(self, teaching: NDArray[np.bool_], strobe_px: float, tree: cKDTree) -> Plate:
        """The plate of the triangle and the pairs of one hand, found without the stars to be asked."""
        plate = self._plate
        for radius in (self._match_px, strobe_px):
            x, y = plate.pixels(self._xi[teaching], self._eta[teaching])
            if x.size == 0:
                break
            distance, nearest = (np.asarray(one) for one in tree.query(np.column_stack((x, y))))
            near = distance <= radius
            found = np.flatnonzero(teaching)[near]
            corner_x, corner_y, corner_xi, corner_eta = self._corners
            pair_x = np.concatenate((corner_x, self._x[nearest[near]]))
            pair_y = np.concatenate((corner_y, self._y[nearest[near]]))
            pair_xi = np.concatenate((corner_xi, self._xi[found]))
            pair_eta = np.concatenate((corner_eta, self._eta[found]))
            degree = 1 if pair_x.size >= LINEAR_PAIRS else SIMILARITY
            plate = fit_plate(self._plate, pair_x, pair_y, pair_xi, pair_eta, np.ones(pair_x.size), degree)
            if plate.parity != self._plate.parity:
                return self._plate
        return plate
