"""Which star is which measurement under a plate, and the rules that forbid some pairs [S23 §3.1-3.2]."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.stars import Stars
from mountnav.identification.plate import Plate
from mountnav.identification.selection import SHARP_SHARE, rank_in_cell
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.measuring.medians import median
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

BY_FLAG = {"no peak": Flag.NO_PEAK, "trail": Flag.TRAIL, "bleed": Flag.BLEED, "edge": Flag.EDGE}
STAR_GROUP = "star group"
MEASUREMENT_GROUP = "measurement group"
DEVIATION = "deviation"
RULES = (*BY_FLAG, STAR_GROUP, MEASUREMENT_GROUP, DEVIATION)
"""Names of all rules, in the order in which they are applied: a candidate counts for the first that hits."""


def in_groups(
    close: Index, x_px: Array, y_px: Array, magnitude: Array, radius_px: float, depth_mag: float
) -> Mask:
    """Points in a tight group: with a neighbor within the radius that is not fainter by `depth_mag`.

    Parameters
    ----------
    close : ndarray of int, shape (k, 2)
        All couples of points within the radius, and perhaps some others.
    x_px, y_px, magnitude : ndarray, shape (n,)
        The points.
    radius_px : float
        r_star_group or r_mea_group.

    Returns
    -------
    ndarray of bool, shape (n,)
        True: it lies in a group.
    """
    inside = np.zeros(x_px.size, dtype=bool)
    a, b = close.T
    near = np.flatnonzero((x_px[a] - x_px[b]) ** 2 + (y_px[a] - y_px[b]) ** 2 <= radius_px**2)
    a, b = a[near], b[near]
    inside[a[magnitude[b] < magnitude[a] + depth_mag]] = True
    inside[b[magnitude[a] < magnitude[b] + depth_mag]] = True
    return inside


def within_k_rej(deviation: Array, k_rej: float) -> Mask:
    """Pairs whose deviation is at most K_rej times the mean deviation modulus [S23 eq. 21-23].

    Parameters
    ----------
    deviation : ndarray, shape (n,)
        Moduli Δ_αδ, any unit.

    Returns
    -------
    ndarray of bool, shape (n,)
        True: the pair is kept.
    """
    kept: Mask = deviation <= k_rej * float(deviation.mean())
    return kept


REACH = 2.0
"""Stars farther than this many half frames from the center aren't projected at all. A polynomial is wild out
there. Halved, stars in the corners would be lost."""
LEAST_PER_FRAGMENT = 3
"""A fragment of the frame never gives fewer pairs than this, however few the others give: poor fields keep
all. Chosen by hand."""


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
"""No pairs at all."""


@dataclass(frozen=True, slots=True)
class Predicted:
    """Stars that a plate puts in the frame, brightest first.

    Attributes
    ----------
    star : ndarray of int, shape (n,)
        Indices in the list of stars.
    x_px, y_px : ndarray, shape (n,)
        Pixels, 0-based: the middle of the first pixel is (0, 0).
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
    """Predict which stars lie in the frame, and where.

    Parameters
    ----------
    margin_px : float
        Stars so far outside the frame's edges are taken as well.
    projected : two ndarrays, shape (len(stars),), optional
        What `plate.project` makes of the stars, if that is known.
    """
    asked = (width_px, height_px, margin_px)
    last = _last
    if last is not None and last.plate is plate and last.stars is stars and last.asked == asked:
        return last.places
    places = _predicted(plate, stars, width_px, height_px, margin_px, projected)
    _remember(_Last(plate, stars, asked, places))
    return places


@dataclass(frozen=True, slots=True)
class _Last:
    """What was predicted last, and of what."""

    plate: Plate
    stars: Stars
    asked: tuple[int, int, float]
    places: Predicted


_last: _Last | None = None
"""Who looks at a frame's light asks for the same plate and the same stars four times in turn."""


def _remember(made: _Last) -> None:
    """Keep it; whoever has it can't change it."""
    global _last
    for values in (made.places.star, made.places.x_px, made.places.y_px):
        values.flags.writeable = False
    _last = made


def _predicted(
    plate: Plate,
    stars: Stars,
    width_px: int,
    height_px: int,
    margin_px: float,
    projected: tuple[Array, Array] | None,
) -> Predicted:
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
    measurement : ndarray of int, shape (m,)
        The measurements that may take part.
    x_px, y_px : ndarray
        Of all measurements.

    Returns
    -------
    pairs : Pairs
        Brightest star first.
    place : ndarray of int, shape (len(pairs),)
        Which of the predicted positions each is.
    """
    if len(places) == 0 or measurement.size == 0:
        return NO_PAIRS, np.zeros(0, dtype=np.int64)
    predictions = np.column_stack((places.x_px, places.y_px))
    sources = np.column_stack((x_px[measurement], y_px[measurement]))
    distance, nearest = (
        np.asarray(part) for part in cKDTree(sources).query(predictions, distance_upper_bound=strobe_px)
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
    fragments : int
        The frame is cut in fragments × fragments parts.
    cap : float
        A fragment gives at most this many times its fair share among the fragments that have pairs, and at
        least three.

    Returns
    -------
    ndarray of bool, shape (n,)
        True: the pair is taken.
    """
    column = np.minimum(np.maximum(((x_px + 0.5) / width_px * fragments).astype(np.int64), 0), fragments - 1)
    row = np.minimum(np.maximum(((y_px + 0.5) / height_px * fragments).astype(np.int64), 0), fragments - 1)
    cell = row * fragments + column
    order = np.argsort(mag, kind="stable")
    rank = np.empty(x_px.size, dtype=np.int64)
    rank[order] = rank_in_cell(cell[order])
    fair = x_px.size / max(1, int(np.count_nonzero(np.bincount(cell))))
    most = max(LEAST_PER_FRAGMENT, math.ceil(cap * fair))
    taken: Mask = rank < most
    return taken


class Neighborhood:
    """Which stars and measurements lie close, found once and used again under plates that differ little.

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
        """Whether all that may lie within a strobe under these positions is remembered."""
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
        strobe_px : float
            No pair lies farther apart.

        Returns
        -------
        pairs : Pairs
            Brightest star first.
        place : ndarray of int, shape (len(pairs),)
            Which of the predicted positions each is.
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
        """Stars in a tight group, shape (len(places),); arguments as of `in_groups`."""
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


UNKNOWN_CENTROID_PX = 0.5
"""Error per coordinate of a measurement that states none, pixels: that of a poor centroid. Chosen by hand."""
UNKNOWN_CATALOG_ARCSEC = 1.0
"""Error per coordinate of a catalog star that states none: that of old photographic catalogs. Chosen by
hand."""
SATURATED_FWHM = 0.02
"""Error of a saturated star's position, in widths, beyond that of the fit to its wings. Chosen by hand."""
FEWEST_MEASUREMENTS = 60
"""At least so many of the brightest measurements are paired, however few stars the catalog has in the frame;
else twice as many as stars. Chosen by hand."""
SPARE_PX = 3.0
"""How much farther than the strobe neighbors are remembered: most plates of one growth differ by less. It
saves time and changes no result: what it doesn't cover is looked up again."""
FEWEST_IN_GROUPS = 500
"""At least so many of the brightest measurements are looked at for tight groups, else four times as many as
pairs: fainter neighbors move no centroid. Chosen by hand."""


class Candidates:
    """The measurements and stars of one frame, with what is known of them whatever the plate.

    Parameters
    ----------
    usable : ndarray of int
        Indices of star-like measurements, brightest first.
    stars : Stars
        Of the whole frame and a margin, brightest first.
    """

    def __init__(
        self, measurements: Measurements, usable: Index, stars: Stars, settings: IdentificationSettings
    ) -> None:
        m = measurements
        self._settings, self._stars, self._measurements, self._usable = settings, stars, m, usable
        self._x_px, self._y_px = m.x_px[usable], m.y_px[usable]
        fwhm = m.fwhm_px[usable]
        fwhm = fwhm[np.isfinite(fwhm) & (fwhm > 0)]
        self._fwhm_px = float(np.clip(median(fwhm), 1.0, 15.0)) if fwhm.size else 3.0
        centroid = np.sqrt(0.5 * (m.x_sigma_px**2 + m.y_sigma_px**2))
        centroid = np.where(np.isfinite(centroid), centroid, UNKNOWN_CENTROID_PX)
        saturated = (m.flags & int(Flag.SATURATED)) != 0
        self._centroid_px = np.hypot(centroid, np.where(saturated, SATURATED_FWHM * self._fwhm_px, 0.0))
        catalog = stars.sigma_arcsec
        self._catalog_arcsec = np.where(np.isfinite(catalog), catalog, UNKNOWN_CATALOG_ARCSEC)
        self._projected: dict[Icrs, tuple[Array, Array]] = {}
        self._last: tuple[Plate, Predicted] | None = None
        self._neighborhood: Neighborhood | None = None
        self._close: Index | None = None
        self._grouped: tuple[int, Mask] | None = None

    @property
    def count(self) -> int:
        """How many measurements may take part."""
        return int(self._usable.size)

    def projected(self, plate: Plate) -> tuple[Array, Array]:
        """Tangential coordinates of all stars, arcsec: computed once for each tangent point."""
        if plate.tangent not in self._projected:
            self._projected[plate.tangent] = plate.project(self._stars.ra_deg, self._stars.dec_deg)
        return self._projected[plate.tangent]

    def in_frame(self, plate: Plate) -> Predicted:
        """Stars that the plate puts in the frame."""
        if self._last is None or self._last[0] is not plate:
            self._last = plate, self._predicted(plate, 0.0)
        return self._last[1]

    def seen(self, pairs: Pairs) -> tuple[Array, Array]:
        """Pixels of the pairs' measurements, shape (n,) each."""
        return self._measurements.x_px[pairs.measurement], self._measurements.y_px[pairs.measurement]

    def known_arcsec(self, pairs: Pairs, scale_arcsec_px: float) -> Array:
        """Error per coordinate as far as it is known: centroid, and catalog at the epoch; shape (n,)."""
        centroid = self._centroid_px[pairs.measurement] * scale_arcsec_px
        return np.asarray(np.hypot(centroid, self._catalog_arcsec[pairs.star]))

    def residuals(self, plate: Plate, pairs: Pairs) -> tuple[Array, Array]:
        """Measured minus catalog (ξ, η, arcsec), shape (n,) each."""
        xi, eta = plate.tangential(*self.seen(pairs))
        star_xi, star_eta = self.projected(plate)
        return xi - star_xi[pairs.star], eta - star_eta[pairs.star]

    def pairs(self, plate: Plate, strobe_px: float) -> Pairs:
        """Pairs that no rule forbids, spread over the fragments."""
        places = self.in_frame(plate)
        near, place = self._near(plate, places, strobe_px)
        if len(near) == 0:
            return NO_PAIRS
        bad = np.logical_or.reduce(list(self._ruled_out(places, near, place).values()))
        return self._spread(near.those(~bad))

    def rejected_by(self, plate: Plate, strobe_px: float, outliers: int) -> dict[str, int]:
        """Count for each rule the candidates at the final plate and strobe that it is the first to forbid."""
        m = self._measurements
        counts = dict.fromkeys(RULES, 0)
        places = self.in_frame(plate)
        near, place = self._near(plate, places, strobe_px)
        # sources that are no stars never were candidates of the fit: which of the stars left over are theirs?
        never = np.isfinite(m.x_px) & np.isfinite(m.y_px)
        never[self._usable] = False
        free = np.ones(len(places), dtype=bool)
        free[place] = False
        left = Predicted(places.star[free], places.x_px[free], places.y_px[free])
        for measurement in nearest_pairs(left, np.flatnonzero(never), m.x_px, m.y_px, strobe_px)[
            0
        ].measurement:
            rule = next((name for name, flag in BY_FLAG.items() if m.flags[measurement] & int(flag)), None)
            if rule is not None:
                counts[rule] += 1
        if len(near):
            blamed = np.zeros(len(near), dtype=bool)
            for rule, bad in self._ruled_out(places, near, place).items():
                counts[rule] += int((bad & ~blamed).sum())
                blamed |= bad
        counts[DEVIATION] = outliers
        return counts

    def _predicted(self, plate: Plate, margin_px: float) -> Predicted:
        m = self._measurements
        return predicted(
            plate,
            self._stars,
            width_px=m.width_px,
            height_px=m.height_px,
            margin_px=margin_px,
            projected=self.projected(plate),
        )

    def _close_by(self, plate: Plate, places: Predicted, strobe_px: float) -> Neighborhood:
        held = self._neighborhood
        if held is None or not held.holds(places, strobe_px):
            reach_px = 2.0 * strobe_px + SPARE_PX
            held = self._neighborhood = Neighborhood(
                self._predicted(plate, reach_px),
                len(self._stars),
                self._x_px,
                self._y_px,
                reach_px=reach_px,
                group_px=self._group_px() + SPARE_PX,
            )
        return held

    def _group_px(self) -> float:
        return self._settings.star_group_fwhm * self._fwhm_px

    def _near(self, plate: Plate, places: Predicted, strobe_px: float) -> tuple[Pairs, Index]:
        """Mutually nearest star and measurement within the strobe; and which position each star has."""
        if len(places) == 0 or self._usable.size == 0:
            return NO_PAIRS, NO_PAIRS.star
        # no more of the brightest measurements than could belong to the catalog's stars
        most = max(FEWEST_MEASUREMENTS, 2 * len(places))
        near, place = self._close_by(plate, places, strobe_px).pairs(places, most, strobe_px)
        return Pairs(self._usable[near.measurement], near.star), place

    def _ruled_out(self, places: Predicted, near: Pairs, place: Index) -> dict[str, Mask]:
        """Candidates that a rule other than K_rej forbids; a candidate may fall under several."""
        flags = self._measurements.flags[near.measurement]
        out = {name: (flags & int(flag)) != 0 for name, flag in BY_FLAG.items()}
        if np.mean(out["no peak"]) > SHARP_SHARE:
            out["no peak"] = np.zeros(len(near), dtype=bool)
        assert self._neighborhood is not None
        out[STAR_GROUP] = self._neighborhood.grouped_stars(
            places, self._stars.mag[places.star], self._group_px(), self._settings.group_magnitudes
        )[place]
        out[MEASUREMENT_GROUP] = self._in_measurement_group(near.measurement)
        return out

    def _in_measurement_group(self, measurement: Index) -> Mask:
        m = self._measurements
        x, y = self._x_px, self._y_px
        radius = self._settings.measurement_group_fwhm * self._fwhm_px
        if self._close is None:
            tree = cKDTree(np.column_stack((x, y)))
            self._close = tree.query_pairs(radius, output_type="ndarray")
            self._magnitude = -2.5 * np.log10(np.maximum(m.flux[self._usable], 1e-9))
        most = min(max(FEWEST_IN_GROUPS, 4 * measurement.size), self.count)
        if self._grouped is None or self._grouped[0] != most:
            close = self._close[(self._close < most).all(axis=1)]
            bad = np.zeros(len(m), dtype=bool)
            depth = self._settings.group_magnitudes
            bad[self._usable] = in_groups(close, x, y, self._magnitude, radius, depth)
            self._grouped = most, bad
        return np.asarray(self._grouped[1][measurement])

    def _spread(self, pairs: Pairs) -> Pairs:
        x, y = self.seen(pairs)
        taken = spread_over_fragments(
            x,
            y,
            self._stars.mag[pairs.star],
            width_px=self._measurements.width_px,
            height_px=self._measurements.height_px,
            fragments=self._settings.fragments,
            cap=self._settings.fragment_cap,
        )
        return pairs.those(taken)
