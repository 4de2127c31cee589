"""Positions all over the sky where the frame's quads fit: the blind counterpart of `full.hypotheses`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import gammainc

from mountnav.catalog.space_motion import places, unit_vectors
from mountnav.catalog.stars import Catalog
from mountnav.identification.blind.index import BlindIndex
from mountnav.identification.blind.indexed_stars import IndexedStars
from mountnav.identification.blind.quads import QUAD_QUERIES, QuadQuery, frame_codes, frame_quads
from mountnav.identification.full import Hypothesis, Points, Search, match_radius
from mountnav.identification.odds import Corners
from mountnav.identification.plate import similarity_plate
from mountnav.identification.rounds import SCALE_LEAST_ARCSEC_PX, SCALE_MOST_ARCSEC_PX
from mountnav.identification.selection import spread_brightest
from mountnav.identification.settings import IdentificationSettings
from mountnav.sky.coordinates import Icrs
from mountnav.units import ARCSEC_PER_RAD

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]

ROUNDS = 2
"""The tangent point is the frame's center, which the fit itself finds: each round brings it nearer."""
FARTHEST = 2.0
"""The center is sought no farther from the quad than that, in radians on its tangent plane: 63°."""
LEAST_DEPTH = 0.05
"""Cosine of the angle from the tangent point beyond which nothing is seen: 87°."""


@dataclass(frozen=True, slots=True)
class FrameSimilarities:
    """Similarities w = turn·z + shift (z conjugate where mirrored) of n frames; w = ξ + iη in arcsec.

    Attributes
    ----------
    axis : ndarray, shape (n, 3)
        Unit vector of the tangent point: the frame's center, nearly.
    ra_deg, dec_deg : ndarray, shape (n,)
        The same.
    turn, shift : ndarray of complex, shape (n,)
        Arcsec per pixel, and arcsec.
    mirrored : ndarray of bool, shape (n,)
        True: z is conjugated.
    residual_px : ndarray, shape (n,)
        Root mean square distance of the four stars from their measurements.
    """

    axis: Array
    ra_deg: Array
    dec_deg: Array
    turn: Complex
    shift: Complex
    mirrored: NDArray[np.bool_]
    residual_px: Array

    def only(self, chosen: Index) -> FrameSimilarities:
        """Some of them."""
        return FrameSimilarities(
            self.axis[chosen],
            self.ra_deg[chosen],
            self.dec_deg[chosen],
            self.turn[chosen],
            self.shift[chosen],
            self.mirrored[chosen],
            self.residual_px[chosen],
        )

    def pixels(self, which: Index, vectors: Array) -> Complex:
        """Where stars fall in frames, x + iy; NaN behind the frame.

        Parameters
        ----------
        which : ndarray of int, shape (m,)
            The frame.
        vectors : ndarray, shape (m, 3)
            The star.
        """
        w = _tangential(vectors, self.axis[which], self.ra_deg[which], self.dec_deg[which])
        z = (w - self.shift[which]) / self.turn[which]
        out: Complex = np.where(self.mirrored[which], z.conj(), z)
        return out


def fit_similarities(z: Complex, vectors: Array, center: complex) -> FrameSimilarities:
    """Fit a similarity to each set of four pairs.

    Parameters
    ----------
    z : ndarray of complex, shape (n, 4)
        Measurements, x + iy in pixels.
    vectors : ndarray, shape (n, 4, 3)
        Their stars.
    center : complex
        The frame's center in pixels.
    """
    count = len(z)
    axis = vectors.sum(axis=1)
    axis /= np.sqrt((axis**2).sum(axis=1))[:, None]
    flat, again = vectors.reshape(-1, 3), np.repeat(np.arange(count), 4)
    ra_deg, dec_deg = places(axis.T)
    w = _tangential(flat, axis[again], ra_deg[again], dec_deg[again]).reshape(-1, 4)
    # the third corner lies to the other side of the first two, or it doesn't
    mirrored = _side(z) * _side(w) < 0.0
    seen = np.where(mirrored[:, None], z.conj(), z)
    middle = np.where(mirrored, np.conj(center), center)
    turn, shift = _similarity(seen, w)
    for _ in range(ROUNDS):
        to_center = (turn * middle + shift) / ARCSEC_PER_RAD
        # a wrong match may put the center anywhere
        to_center *= np.minimum(1.0, FARTHEST / np.maximum(np.abs(to_center), 1e-12))
        axis = _raised(to_center, axis, ra_deg, dec_deg)
        ra_deg, dec_deg = places(axis.T)
        w = _tangential(flat, axis[again], ra_deg[again], dec_deg[again]).reshape(-1, 4)
        turn, shift = _similarity(seen, w)
    off = w - turn[:, None] * seen - shift[:, None]
    residual = np.sqrt(np.mean(off.real**2 + off.imag**2, axis=1)) / np.abs(turn)
    return FrameSimilarities(axis, ra_deg, dec_deg, turn, shift, mirrored, residual)


def _similarity(z: Complex, w: Complex) -> tuple[Complex, Complex]:
    """Least squares fit of w = turn·z + shift for each row."""
    z_mean, w_mean = z.mean(axis=1), w.mean(axis=1)
    dz, dw = z - z_mean[:, None], w - w_mean[:, None]
    turn: Complex = (dz.conj() * dw).sum(axis=1) / (dz.real**2 + dz.imag**2).sum(axis=1)
    return turn, w_mean - turn * z_mean


def _side(place: Complex) -> Array:
    side: Array = ((place[:, 1] - place[:, 0]).conj() * (place[:, 2] - place[:, 0])).imag
    return side


def _axes(ra_deg: Array, dec_deg: Array) -> tuple[Array, Array]:
    """East and north at positions."""
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    sin_ra, cos_ra, sin_dec, cos_dec = np.sin(ra), np.cos(ra), np.sin(dec), np.cos(dec)
    east = np.stack((-sin_ra, cos_ra, np.zeros_like(ra)), axis=1)
    return east, np.stack((-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec), axis=1)


def _tangential(vectors: Array, axis: Array, ra_deg: Array, dec_deg: Array) -> Complex:
    """ξ + iη in arcsec of stars about as many tangent points."""
    east, north = _axes(ra_deg, dec_deg)
    depth = np.einsum("nc,nc->n", vectors, axis)
    stretch = np.where(depth > LEAST_DEPTH, ARCSEC_PER_RAD / np.maximum(depth, LEAST_DEPTH), np.nan)
    xi = np.einsum("nc,nc->n", vectors, east)
    eta = np.einsum("nc,nc->n", vectors, north)
    w: Complex = xi * stretch + 1j * (eta * stretch)
    return w


def _raised(middle: Complex, axis: Array, ra_deg: Array, dec_deg: Array) -> Array:
    """Unit vectors of tangential coordinates, radians."""
    east, north = _axes(ra_deg, dec_deg)
    moved = axis + middle.real[:, None] * east + middle.imag[:, None] * north
    moved /= np.sqrt((moved**2).sum(axis=1))[:, None]
    return moved


SCALES = (SCALE_LEAST_ARCSEC_PX, SCALE_MOST_ARCSEC_PX)
"""Arcsec per pixel, where none is known."""
KNOWN_SCALE = 1.5
"""The scale counts as known if its bounds lie within this factor. Chosen by hand."""
WIDEST_DEG = 76.0
"""No frame diagonal beyond this is believed: 40° by 60° has one of 68.6°."""
MOST_POINTS = 300
"""Number of the brightest measurements that predicted stars may fall on. More cost time, and chance pairs get
closer."""


@dataclass(frozen=True, slots=True)
class FrameView:
    """The frame as it is searched for: its measurements, and what is known of its scale and position.

    Attributes
    ----------
    z : ndarray of complex, shape (n,)
        The brightest measurements, x + iy in pixels, brightest first.
    tree : cKDTree
        The same.
    scales : (float, float)
        Bounds, arcsec per pixel.
    axis : ndarray, shape (3,), or None
        The frame's center lies within `radius_rad` of it.
    reach_px : float
        No star is said to fall on a measurement farther off than that.
    """

    z: Complex
    tree: cKDTree
    width_px: int
    height_px: int
    scales: tuple[float, float]
    axis: Array | None
    radius_rad: float
    reach_px: float

    @classmethod
    def of(
        cls,
        points: Points,
        scales: tuple[float, float] | None,
        center: Icrs | None,
        radius_deg: float,
        reach_px: float,
    ) -> FrameView:
        """A frame with these points; bounds beyond 0.3 to 200 ″/px are drawn in."""
        low, high = scales or SCALES
        x, y = points.x_px[:MOST_POINTS], points.y_px[:MOST_POINTS]
        return cls(
            z=x + 1j * y,
            tree=cKDTree(np.column_stack((x, y))),
            width_px=points.width_px,
            height_px=points.height_px,
            scales=(max(low, SCALES[0]), min(high, SCALES[1])),
            axis=None
            if center is None or radius_deg >= 180.0
            else unit_vectors(center.ra_deg, center.dec_deg),
            radius_rad=math.radians(radius_deg),
            reach_px=reach_px,
        )

    @property
    def center(self) -> complex:
        """The frame's center in pixels."""
        return complex((self.width_px - 1) / 2, (self.height_px - 1) / 2)

    @property
    def diagonal_px(self) -> float:
        """Corner to corner."""
        return math.hypot(self.width_px, self.height_px)

    @property
    def scale_known(self) -> bool:
        """Whether the scale is known well enough to lay the frame on the sphere."""
        return self.scales[1] <= KNOWN_SCALE * self.scales[0]

    def focal_px(self, side_deg: float) -> float | None:
        """Focal length in pixels by the scale if known, or by a supposed shorter side; None: infinite."""
        if self.scale_known:
            return ARCSEC_PER_RAD / math.sqrt(self.scales[0] * self.scales[1])
        if side_deg > 0.0:
            return 0.5 * min(self.width_px, self.height_px) / math.tan(math.radians(0.5 * side_deg))
        return None

    def inside(self, place: Complex) -> NDArray[np.bool_]:
        """Which places lie in the frame; NaN doesn't."""
        x, y = place.real, place.imag
        within: NDArray[np.bool_] = (x > 0) & (x < self.width_px - 1) & (y > 0) & (y < self.height_px - 1)
        return within

    def possible(self, fit: FrameSimilarities) -> NDArray[np.bool_]:
        """Which similarities agree with what is known of scale and position, and are a camera's at all."""
        scale = np.abs(fit.turn)
        good = (scale >= 0.99 * self.scales[0]) & (scale <= 1.01 * self.scales[1])
        good &= scale * self.diagonal_px <= 2.0 * math.tan(math.radians(0.5 * WIDEST_DEG)) * ARCSEC_PER_RAD
        if self.axis is not None:
            away = 2.0 * np.arcsin(np.minimum(0.5 * np.sqrt(((fit.axis - self.axis) ** 2).sum(axis=1)), 1.0))
            good &= away <= self.radius_rad
        return good


FIT_SHARE = 0.5
"""Root mean square of the four residuals, in the tolerance of the round: each may be off by that, not all."""
LEAST_FIT_PX = 0.25
"""But a root mean square below this, pixels, is good enough in any round: small quads are held to no less
than the noise of centroids. Chosen by hand; doubled, more positions are tested and counted in the odds."""
AROUND_SPACINGS = 2.5
"""Stars are predicted so far round the quad, in mean distances of the level's stars: some twenty. Chosen by
hand."""
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
        Level of the index that the quad was found in.
    vectors : ndarray, shape (n, 4, 3)
        The stars' unit vectors.
    """

    corners: Complex
    stars: Index
    level: Index
    vectors: Array
    fit: FrameSimilarities

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
        """Key of each candidate: its measurements and stars."""
        rows = np.concatenate((np.rint(8.0 * self.corners.real).astype(np.int64), self.stars), axis=1)
        return [row.tobytes() for row in rows]

    def hypothesis(self, number: int, sky: IndexedStars, view: FrameView) -> Hypothesis:
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


def propose(
    corners: Complex, tolerance: Array, quad: Index, sky: IndexedStars, view: FrameView
) -> Candidates:
    """What like-shaped quads say of the frame's position, where that can be.

    Parameters
    ----------
    corners : ndarray of complex, shape (n, 4)
        Of the frame.
    tolerance : ndarray, shape (n,)
        Of their codes.
    quad : ndarray of int, shape (n,)
        Numbers in the index.

    Returns
    -------
    Candidates
        Nothing but the four stars and what is known of scale and position was used.
    """
    stars = sky.index.stars(quad)
    vectors = sky.vectors(stars)
    fit = fit_similarities(corners, vectors, view.center)
    length = np.abs(corners[:, 0] - corners[:, 1])
    most = np.maximum(FIT_SHARE * tolerance * length, LEAST_FIT_PX)
    kept = np.flatnonzero(view.possible(fit) & (fit.residual_px <= most))
    kept = kept[np.argsort(fit.residual_px[kept] / length[kept], kind="stable")]
    return Candidates(
        corners[kept], stars[kept], sky.index.level(stars[kept, 0]), vectors[kept], fit.only(kept)
    )


def chances(some: Candidates, sky: IndexedStars, view: FrameView) -> Array:
    """How probable it is that so many stars round the quad fall on measurements by chance.

    Returns
    -------
    ndarray, shape (n,)
        Of each position, by the Poisson law; the quad's own four don't count. A screen, not the odds.
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
        visible = np.flatnonzero(view.inside(place) & (some.stars[which] != star[:, None]).all(axis=1))
        if visible.size == 0:
            continue
        which, place = which[visible], place[visible]
        away = np.abs(place - middle[which])
        reach = 1.0 + 3.0 * np.maximum(fit.residual_px[which], CENTROID_PX) * (1.0 + away / span[which])
        reach = np.minimum(reach + BENT * away, view.reach_px)
        distance, nearest = (
            np.asarray(part) for part in view.tree.query(np.column_stack((place.real, place.imag)))
        )
        own = (np.abs(some.corners[which] - view.z[nearest][:, None]) < 1e-6).any(axis=1)
        hits += np.bincount(which, weights=(distance <= reach) & ~own, minlength=count)
        expected += np.bincount(which, weights=-np.expm1(-dense * np.pi * reach**2), minlength=count)
    return np.where(hits > 0, gammainc(np.maximum(hits, 1.0), np.maximum(expected, 1e-12)), 1.0)


FIRST, BATCH = 48, 1000
"""Positions tested at once, best fitting quads first: mostly the right one is among the first few, and one
batch of the others costs little more than a few. It changes time, and by how many hypotheses the odds are
multiplied."""
FOLLOWED_UP_BELOW = 0.3
"""Expected number of positions as good by chance, below which a position is followed up."""
FINALISTS = 6
"""Of a batch, so many positions are followed up at most. Chosen by hand: each costs a verification."""
FIRST_QUERIES = 3
"""Rounds for a frame with a near hint, since triangles follow."""
SAME_PLACE = 3
"""Quads that propose the same position are followed up so often: another quad's plate may fare better."""


def blind_hypotheses(
    points: Points,
    index: BlindIndex,
    catalog: Catalog,
    *,
    scales: tuple[float, float] | None,
    center: Icrs | None,
    radius_deg: float,
    epoch_yr: float,
    settings: IdentificationSettings,
    search: Search,
    first_only: bool = False,
) -> Iterator[Hypothesis]:
    """Propose plates anywhere on the sky, most promising first within each round.

    Parameters
    ----------
    points : Points
        Star-like measurements, brightest first.
    index : BlindIndex
        Made from `catalog`.
    scales : (float, float) or None
        Bounds of the scale, arcsec per pixel, if known.
    center : Icrs or None
        The frame's center is within `radius_deg` of it, if known.
    epoch_yr : float
        Julian year of the frame.
    search : Search
        Counts the positions at which other stars than the quad's own were looked for; the odds need it.
    first_only : bool
        Only the first rounds, which find most frames in some milliseconds.

    Yields
    ------
    Hypothesis
        With four corners.

    Raises
    ------
    BadSettings
        The index is of another catalog.
    OutOfTime
        When the budget is spent.
    """
    sky = IndexedStars(index, catalog, epoch_yr)
    if points.x_px.size < settings.min_pairs:
        return
    view = FrameView.of(
        points, scales, center, radius_deg, match_radius(settings, points.width_px, points.height_px)
    )
    try:
        queries = QUAD_QUERIES[:FIRST_QUERIES] if first_only else QUAD_QUERIES
        yield from _rounds(points, sky, view, settings, search, queries)
    finally:
        sky.rest()


def _rounds(
    points: Points,
    sky: IndexedStars,
    view: FrameView,
    settings: IdentificationSettings,
    search: Search,
    queries: Sequence[QuadQuery],
) -> Iterator[Hypothesis]:
    """Candidates of all rounds, one round after the other."""
    seen: set[bytes] = set()
    followed_up: list[Array] = []
    before = search.hypotheses
    for query in queries:
        search.check_time()
        if query.side_deg and view.scale_known:
            continue  # every round has its quads laid on the sphere then
        chosen = spread_brightest(
            points.x_px, points.y_px, query.count, regions=settings.m_reg, cap=settings.region_cap
        )
        z = points.x_px[chosen] + 1j * points.y_px[chosen]
        quads = frame_quads(query, z)
        if not len(quads):
            continue
        code, corners, tolerance = frame_codes(query, z, quads, view.center, view.focal_px(query.side_deg))
        which, quad = sky.index.alike(code, tolerance)
        some = _fresh(propose(z[corners[which]], tolerance[which], quad, sky, view), seen)
        for start, end in ((0, FIRST), *((at, at + BATCH) for at in range(FIRST, len(some), BATCH))):
            search.check_time()
            part = some.only(np.arange(start, min(end, len(some))))
            yield from _promising(part, sky, view, search, followed_up, before)


def _fresh(some: Candidates, seen: set[bytes]) -> Candidates:
    """Candidates that no earlier round proposed."""
    fresh = []
    for number, key in enumerate(some.keys()):
        if key not in seen:
            seen.add(key)
            fresh.append(number)
    return some.only(np.array(fresh, dtype=np.int64))


def _promising(
    some: Candidates,
    sky: IndexedStars,
    view: FrameView,
    search: Search,
    followed_up: list[Array],
    before: int,
) -> Iterator[Hypothesis]:
    """Those round whose quad other stars fall on measurements, best first.

    What earlier searches tried (`before`) counts in the odds, not in what is worth asking them.
    """
    if not len(some):
        return
    chance = chances(some, sky, view)
    search.hypotheses += len(some)
    good = np.flatnonzero(chance * (search.hypotheses - before) < FOLLOWED_UP_BELOW)
    left = FINALISTS
    for number in good[np.argsort(chance[good], kind="stable")]:
        axis = some.fit.axis[number]
        near = 0.1 * view.diagonal_px * abs(some.fit.turn[number]) / ARCSEC_PER_RAD
        if (
            sum(float(((axis - axis_before) ** 2).sum()) < near**2 for axis_before in followed_up)
            >= SAME_PLACE
        ):
            continue
        followed_up.append(axis)
        yield some.hypothesis(int(number), sky, view)
        left -= 1
        if left == 0:
            return
