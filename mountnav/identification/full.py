"""Full identification: triangles propose the six plate constants, stars confirm them [S23 §2.2]."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Catalog
from mountnav.identification.anchors import Anchors
from mountnav.identification.budget import Budget
from mountnav.identification.odds import Corners, binomial_sf, strobe_chances
from mountnav.identification.plate import Plate, constants, similarity_plate
from mountnav.identification.rounds import Round
from mountnav.identification.search_area import SearchArea, Tile, arcsec
from mountnav.identification.selection import spread_brightest, trail_pieces
from mountnav.identification.settings import IdentificationSettings
from mountnav.identification.triangles import TriangleIndex, Triangles, make_triangles
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CELLS_PER_RADIUS = 6
"""Cells of the raster to Δr_ident: a place is rounded by a twelfth of the radius. Doubled, the raster takes
four times the memory."""
CLOSE_RADIUS_CELLS = 2
"""A third of the radius: a camera without distortion hits so well, and then fewer stars suffice. In cells."""
FIRST_STARS = 60
"""Number of the brightest stars that are counted first; most hypotheses fail there."""
FIRST_HITS = 4
"""Hits that earn a second look: the triangle's three, and one. With more, true plates of poor catalogs fail
there."""


_CLOSE_BITS, _FAR = 16, 0xFFFF
"""A cell's word: the owner within the close radius above these bits, the one within the radius below."""


class MatchGrid:
    """Counts, for many plates at once, how many stars fall on measurements.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        The measurements of Ω_bl100, brightest first.
    radius_px : float
        Δr_ident.
    width_px, height_px : int
        Size of the frame.
    """

    def __init__(self, x_px: Array, y_px: Array, radius_px: float, *, width_px: int, height_px: int) -> None:
        self._cell = radius_px / CELLS_PER_RADIUS
        self._width, self._height = width_px, height_px
        self.size = int(x_px.size)
        columns = int(np.ceil(width_px / self._cell)) + 1
        rows = int(np.ceil(height_px / self._cell)) + 1
        # zeros: pages that no measurement touches are never written
        self._cells = np.zeros((rows, columns), dtype=np.int32)
        self._paint(x_px[::-1] / self._cell, y_px[::-1] / self._cell)
        self.chances = tuple(
            float(strobe_chances(x_px, y_px, radius, width_px=width_px, height_px=height_px).mean())
            for radius in (radius_px, radius_px * CLOSE_RADIUS_CELLS / CELLS_PER_RADIUS)
        )
        """Chance of a hit within the radius, and within the close one."""

    def _paint(self, x: Array, y: Array) -> None:
        """Write measurements' numbers, from 1, round their positions (in cells); the last wins overlaps."""
        rows, columns = self._cells.shape
        for reach, bits in ((CELLS_PER_RADIUS, 0), (CLOSE_RADIUS_CELLS, _CLOSE_BITS)):
            offset = np.arange(-reach - 1, reach + 2)
            down, right = (side.ravel() for side in np.meshgrid(offset, offset, indexing="ij"))
            nearest = np.maximum(np.abs(down) - 1, 0) ** 2 + np.maximum(np.abs(right) - 1, 0) ** 2
            down, right = down[nearest <= reach**2], right[nearest <= reach**2]
            row, column = y.astype(np.int64)[:, None] + down, x.astype(np.int64)[:, None] + right
            hit = (row + 0.5 - y[:, None]) ** 2 + (column + 0.5 - x[:, None]) ** 2 <= reach**2
            hit &= (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
            number = np.broadcast_to((x.size - np.arange(x.size))[:, None], hit.shape)[hit]
            row, column = row[hit], column[hit]
            below = self._cells[row, column] & _FAR if bits else 0
            self._cells[row, column] = below | (number << bits)

    def _owners(
        self,
        turn: NDArray[np.complex128],
        shift: NDArray[np.complex128],
        mirrored: NDArray[np.bool_],
        w: NDArray[np.complex128],
    ) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """Measurement in each predicted position's cell, and whether it is in the frame; shape (n, stars)."""
        back = 1.0 / turn
        start = -shift * back
        sign = np.where(mirrored, -1.0, 1.0)
        along = np.stack((w.real, w.imag, np.ones(w.size))).astype(np.float32)
        # in cells; single precision is a thousandth of a pixel
        to_x = np.stack((back.real, -back.imag, start.real), axis=1) / self._cell
        to_y = np.stack((back.imag, back.real, start.imag), axis=1) * (sign / self._cell)[:, None]
        x, y = to_x.astype(np.float32) @ along, to_y.astype(np.float32) @ along
        least, right, high = (
            np.float32(edge_px / self._cell) for edge_px in (-0.5, self._width - 0.5, self._height - 0.5)
        )
        inside = (x > least) & (x < right)
        inside &= y > least
        inside &= y < high
        # what isn't in the frame is looked up in the corner, and left out
        x *= inside
        y *= inside
        flat = y.astype(np.int32)
        flat *= self._cells.shape[1]
        flat += x.astype(np.int32)
        return self._cells.ravel().take(flat) * inside, inside

    def promising(
        self,
        turn: NDArray[np.complex128],
        shift: NDArray[np.complex128],
        mirrored: NDArray[np.bool_],
        w: NDArray[np.complex128],
    ) -> Index:
        """Which plates hit anything beyond their own triangle among the brightest stars; shape (k,)."""
        if w.size <= FIRST_STARS:
            return np.arange(turn.size, dtype=np.int64)
        owners, _ = self._owners(turn, shift, mirrored, w[:FIRST_STARS])
        return np.flatnonzero(np.count_nonzero(owners, axis=1) >= FIRST_HITS)

    def count(
        self,
        turn: NDArray[np.complex128],
        shift: NDArray[np.complex128],
        mirrored: NDArray[np.bool_],
        w: NDArray[np.complex128],
    ) -> tuple[Array, Array, Array]:
        """Hits, close hits (each measurement once at most) and predictions in the frame; shape (n,) each."""
        owners, inside = self._owners(turn, shift, mirrored, w)
        far, close = (owners & _FAR).astype(np.int16), (owners >> _CLOSE_BITS).astype(np.int16)
        return _different(far), _different(close), np.count_nonzero(inside, axis=1).astype(float)


def _different(owner: NDArray[np.int16]) -> Array:
    """How many different measurements stand in each row, 0 being none; shape (n,)."""
    owner.sort(axis=1)
    fresh = (owner[:, 1:] != owner[:, :-1]) & (owner[:, 1:] > 0)
    return np.asarray(fresh.sum(axis=1) + (owner[:, 0] > 0), dtype=float)


CHUNK = 4000
"""Hypotheses tried at once: 4000 × 60 complex numbers fit a processor's cache."""
FINALISTS = 3
"""Number of the best hypotheses of a chunk that are followed up. Chosen by hand: each costs a verification.
Doubled or halved, the tests of search, refusal and plate pass all the same."""
FOLLOWED_UP_BELOW = 0.3
"""Expected number of chance matches as good as a hypothesis' raster count, below which it is followed up.
Doubled or halved, the tests of search, refusal and plate pass all the same."""
STRAIGHT_FIELD_DEG = 4.0
"""Telescopes of fields up to this, shorter side, bend the frame by less than 0.2 %, or 7′ of an angle; lenses
of wider ones by up to 0.5 %."""
NOISY_FRAME_PX = 1000
"""Shorter side of a frame in whose triangles a centroid that is 1 px off needs all of Δγ. An angle is off by
the error over the side, so larger frames need less in proportion. Doubled, hopeless frames cost more; halved,
frames of 1000 px with such centroids are lost (of six crowded ones two)."""
LEAST_ANGLE_SHARE = 0.4
"""But no less than this share of Δγ, 12′: optics bend. Doubled, costly rounds over a frame of 3056 px cost
nearly twice as much; halved, what telescopes bend exceeds it."""
OWN_STEPS = 1.0
"""A tile's hypotheses are those whose frame has its center no farther from the tile's middle than so many
steps of the tiles: no position is farther than 0.58 from the nearest. Doubled, each hypothesis is tried in
seven tiles; halved, positions between tiles belong to none."""
AREAS_REMEMBERED = 40
"""Search areas remembered at once: every round visits the same. A limit of memory."""


class OutOfTime(Exception):
    """The budget is spent."""


@dataclass(frozen=True, slots=True)
class Points:
    """The measurements that take part: places (pixels, brightest first) and the frame's size.

    Attributes
    ----------
    x_px, y_px : ndarray, shape (n,)
    """

    x_px: Array
    y_px: Array
    width_px: int
    height_px: int

    def first(self, chosen: Index) -> Points:
        """The points with these indices."""
        return Points(self.x_px[chosen], self.y_px[chosen], self.width_px, self.height_px)


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A plate that triangles proposed and stars seem to confirm.

    Attributes
    ----------
    plate : Plate
        Similarity.
    corners : Corners
        The triangle.
    """

    plate: Plate
    corners: Corners


@dataclass(slots=True)
class Search:
    """Counters and caches of one search: what it tried, what it saw, what it has left to spend.

    Attributes
    ----------
    budget : Budget
        When it ends.
    hypotheses : int
        Plates tried: each is one more chance to be fooled.
    frame_triangles : int
        Most triangles that the frame's measurements made.
    tiles_tried : int
        Tiles visited, again in every round.
    reach_deg : float
        How far from the assumed center the farthest of them lay.
    best_probability : float
        Least false-positive probability among refused hypotheses.
    most_published : float
        Largest share of the pairs that could be, in the paper's count.
    strobe_chance : float
        Share of positions where chance has a measurement of Ω_bl100 within Δr_ident.
    whole_sky : bool
        The index of the whole sky was searched.
    anchors : Anchors
        Which parts of the sky were searched, at what scales: the second kind of odds needs it.
    """

    budget: Budget
    hypotheses: int = 0
    frame_triangles: int = 0
    best_probability: float = 1.0
    tiles_tried: int = 0
    whole_sky: bool = False
    reach_deg: float = 0.0
    most_published: float = 0.0
    strobe_chance: float = 0.0
    anchors: Anchors = field(default_factory=Anchors)
    _areas: dict[tuple[float, ...], SearchArea] = field(default_factory=dict)
    _pieces: dict[bytes, Index] = field(default_factory=dict)

    def check_time(self) -> None:
        """Raise OutOfTime when the budget is spent."""
        if self.budget.spent:
            raise OutOfTime

    def pieces(self, x_px: Array, y_px: Array) -> Index:
        """Which source each measurement is a piece of, remembered: every hypothesis needs it."""
        key = x_px.tobytes()
        if key not in self._pieces:
            self._pieces[key] = trail_pieces(x_px, y_px)
        return self._pieces[key]

    def area(
        self,
        catalog: Catalog,
        center: Icrs,
        radius_deg: float,
        step_deg: float,
        tile_deg: float,
        *,
        count: int,
        epoch_yr: float,
        most_tiles: int,
    ) -> SearchArea:
        """A `SearchArea`, kept for the next rounds: each of them visits the same tiles."""
        key = (center.ra_deg, center.dec_deg, radius_deg, step_deg, tile_deg, count, most_tiles)
        if key not in self._areas:
            if len(self._areas) >= AREAS_REMEMBERED:
                self._areas.clear()
            self._areas[key] = SearchArea(
                catalog,
                center,
                radius_deg,
                step_deg,
                tile_deg,
                count=count,
                epoch_yr=epoch_yr,
                most_tiles=most_tiles,
            )
        return self._areas[key]


def match_radius(settings: IdentificationSettings, width_px: int, height_px: int) -> float:
    """Δr_ident in pixels, bounded by a share of the frame: 10 px of a small frame prove nothing."""
    return max(2.5, min(settings.match_px, settings.match_share * min(width_px, height_px)))


def hypotheses(
    points: Points,
    turn: Round,
    catalog: Catalog,
    center: Icrs,
    *,
    epoch_yr: float,
    settings: IdentificationSettings,
    search: Search,
) -> Iterator[Hypothesis]:
    """Propose plates, most promising first within each step, until the round's area is used up.

    Parameters
    ----------
    points : Points
        Star-like measurements, brightest first.
    turn : Round
        Which stars make triangles, between what scales, how far off.
    center : Icrs
        The assumed center.
    epoch_yr : float
        Julian year of the frame.
    search : Search
        Counts what is tried; the odds need it.

    Raises
    ------
    OutOfTime
        When the budget is spent.
    """
    width, height = points.width_px, points.height_px
    scale = float(np.sqrt(turn.scales[0] * turn.scales[1]))
    regions, cap = settings.m_reg, settings.region_cap
    x, y = points.x_px, points.y_px
    confirm = points.first(spread_brightest(x, y, settings.n_confirm_measurements, regions=regions, cap=cap))
    frame = points.first(spread_brightest(x, y, turn.stage[0], regions=regions, cap=cap))
    least_px = settings.k_height * 0.5 * (width + height)
    frame_triangles = make_triangles(
        frame.x_px, frame.y_px, min_side=least_px, min_height=least_px, limit=settings.frame_triangles
    )
    search.frame_triangles = max(search.frame_triangles, len(frame_triangles))
    if not len(frame_triangles):
        return
    index = TriangleIndex(
        frame_triangles,
        angle_rad=_angle_rad(turn, min(width, height), settings),
        scale_low=turn.scales[0],
        scale_high=turn.scales[1],
    )
    grid = MatchGrid(
        confirm.x_px,
        confirm.y_px,
        match_radius(settings, width, height),
        width_px=width,
        height_px=height,
    )
    search.strobe_chance = max(search.strobe_chance, grid.chances[0])
    tile_deg = min(settings.tile_radius * float(np.hypot(width, height)) * scale / 3600.0, 40.0)
    area = search.area(
        catalog,
        center,
        turn.outer_deg,
        settings.tile_step * min(width, height) * scale / 3600.0,
        tile_deg,
        count=2 * settings.n_confirm_stars,
        epoch_yr=epoch_yr,
        most_tiles=turn.most_tiles,
    )
    work = 0
    for number in range(len(area)):
        tile = area.tile(number)
        if tile.off_deg < turn.inner_deg:
            continue
        search.check_time()
        search.tiles_tried += 1
        search.reach_deg = max(search.reach_deg, tile.off_deg)
        if tile.stars.size < settings.min_pairs:
            continue
        places = _flat(tile, area)
        chosen = _corners(*places, turn, tile_deg, settings)
        count = int(chosen.size)
        work += count * (count - 1) * (count - 2) // 6
        if work <= turn.from_triangles:
            continue  # an earlier round was here
        yield from _in_tile(
            tile, places, chosen, area, turn, frame, frame_triangles, index, grid, settings, search
        )
        if work > turn.most_triangles:
            return


def _angle_rad(turn: Round, shorter_px: int, settings: IdentificationSettings) -> float:
    """How far corner angles may differ: in costly rounds over the narrow fields of large frames, less."""
    widest_deg = shorter_px * turn.scales[1] / 3600.0
    if turn.stage == settings.stages[0] or widest_deg > STRAIGHT_FIELD_DEG:
        return float(np.radians(settings.angle_arcmin / 60.0))
    share = max(LEAST_ANGLE_SHARE, min(1.0, NOISY_FRAME_PX / shorter_px))
    return float(np.radians(share * settings.angle_arcmin / 60.0))


def _flat(tile: Tile, area: SearchArea) -> tuple[Array, Array]:
    """Its stars about its middle, arcsec in the tangent plane."""
    ra_deg, dec_deg = area.stars.ra_deg[tile.stars], area.stars.dec_deg[tile.stars]
    xi_rad, eta_rad = gnomonic(ra_deg, dec_deg, tile.place.ra_deg, tile.place.dec_deg)
    return arcsec(np.asarray(xi_rad)), arcsec(np.asarray(eta_rad))


def _corners(xi: Array, eta: Array, turn: Round, tile_deg: float, settings: IdentificationSettings) -> Index:
    """Stars of a tile that make triangles, brightest first: in costly rounds over wide areas, its inner ones.

    Triangles grow with the third power of the stars, and stars at a tile's rim lie in few frames that are
    this tile's: its neighbors use them.
    """
    share, most = settings.corner_radius / settings.tile_radius, turn.stage[1]
    inner = np.arange(xi.size)
    if turn.inner and share < 1.0:
        most = max(settings.stages[0][1], round(most * share**2))
        near = np.flatnonzero(np.hypot(xi, eta) <= arcsec(np.tan(np.radians(share * tile_deg))))
        # where stars are few each of them counts
        inner = near if near.size >= most else inner
    regions, cap = settings.m_reg, settings.region_cap
    return np.asarray(inner[spread_brightest(xi[inner], eta[inner], most, regions=regions, cap=cap)])


def _in_tile(
    tile: Tile,
    places: tuple[Array, Array],
    chosen: Index,
    area: SearchArea,
    turn: Round,
    frame: Points,
    frame_triangles: Triangles,
    index: TriangleIndex,
    grid: MatchGrid,
    settings: IdentificationSettings,
    search: Search,
) -> Iterator[Hypothesis]:
    """Hypotheses of one tile, best of each chunk first."""
    ra_deg, dec_deg = area.stars.ra_deg[tile.stars], area.stars.dec_deg[tile.stars]
    xi, eta = places
    cap, regions, scales = settings.region_cap, settings.m_reg, turn.scales
    proved = spread_brightest(xi, eta, settings.n_confirm_stars, regions=regions, cap=cap)
    least_arcsec = settings.k_height * 0.5 * (frame.width_px + frame.height_px) * scales[0] * 0.99
    shortest_arcsec, longest_arcsec = index.length_bounds()
    catalog_triangles = make_triangles(
        xi[chosen],
        eta[chosen],
        min_side=least_arcsec,
        min_height=least_arcsec,
        max_side=min(float(np.hypot(frame.width_px, frame.height_px)) * scales[1] * 1.01, longest_arcsec),
        min_longest=shortest_arcsec,
        wanted=index.may_hold,
    )
    of_frame, of_catalog = index.like(catalog_triangles)
    z = frame.x_px + 1j * frame.y_px
    w = xi[chosen] + 1j * eta[chosen]
    w_proof = xi[proved] + 1j * eta[proved]
    middle = 0.5 * complex(frame.width_px - 1, frame.height_px - 1)
    own_arcsec = OWN_STEPS * settings.tile_step * min(frame.width_px, frame.height_px) * scales[1]
    for start in range(0, of_frame.size, CHUNK):
        search.check_time()
        a = frame_triangles.corners[of_frame[start : start + CHUNK]]
        b = catalog_triangles.corners[of_catalog[start : start + CHUNK]]
        factor, shift, mirrored, kept = constants(z[a], w[b], scales, settings.skew_max)
        # a frame that lies about another tile's middle is that tile's to propose
        there = factor * np.where(mirrored, middle.conjugate(), middle) + shift
        own = np.abs(there) <= own_arcsec
        factor, shift, mirrored, kept = factor[own], shift[own], mirrored[own], kept[own]
        search.hypotheses += int(factor.size)
        look = grid.promising(factor, shift, mirrored, w_proof)
        if look.size == 0:
            continue
        a, b = a[kept[look]], b[kept[look]]
        factor, shift, mirrored = factor[look], shift[look], mirrored[look]
        hits, close, predicted = grid.count(factor, shift, mirrored, w_proof)
        chance = 2.0 * np.minimum(
            binomial_sf(hits - 3, predicted - 3, grid.chances[0]),
            binomial_sf(close - 3, predicted - 3, grid.chances[1]),
        )
        good = (hits - 3 >= 2) & (chance * search.hypotheses < FOLLOWED_UP_BELOW)
        ranked = np.flatnonzero(good)[np.argsort(chance[good], kind="stable")]
        for best in ranked[:FINALISTS]:
            yield Hypothesis(
                plate=similarity_plate(
                    tile.place,
                    complex(factor[best]),
                    complex(shift[best]),
                    mirrored=bool(mirrored[best]),
                    width_px=frame.width_px,
                    height_px=frame.height_px,
                ),
                corners=Corners(
                    x_px=frame.x_px[a[best]],
                    y_px=frame.y_px[a[best]],
                    ra_deg=ra_deg[chosen][b[best]],
                    dec_deg=dec_deg[chosen][b[best]],
                ),
            )
