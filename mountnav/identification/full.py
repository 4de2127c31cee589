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
        of: Index | None = None,
    ) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """Measurement in each predicted position's cell, and whether it is in the frame; shape (n, stars)."""
        back = 1.0 / turn
        start = -shift * back
        sign = np.where(mirrored, -1.0, 1.0)
        # in cells; single precision is a thousandth of a pixel
        to_x = np.stack((back.real, -back.imag, start.real), axis=1) / self._cell
        to_y = np.stack((back.imag, back.real, start.imag), axis=1) * (sign / self._cell)[:, None]
        to_x, to_y = to_x.astype(np.float32), to_y.astype(np.float32)
        if of is None:
            along = np.stack((w.real, w.imag, np.ones(w.size))).astype(np.float32)
            x, y = to_x @ along, to_y @ along
        else:
            east, north = w.real.astype(np.float32)[of], w.imag.astype(np.float32)[of]
            x, y = (side[:, :1] * east + side[:, 1:2] * north + side[:, 2:] for side in (to_x, to_y))
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
        stars: Proof,
    ) -> Index:
        """Which plates hit anything beyond their own triangle among the brightest stars; shape (k,)."""
        few = stars.count <= FIRST_STARS
        if few.all():
            return np.arange(turn.size, dtype=np.int64)
        owners, _ = self._owners(turn, shift, mirrored, stars.w[..., :FIRST_STARS], stars.of)
        hit = np.count_nonzero(owners, axis=1) >= FIRST_HITS
        return np.flatnonzero(hit if stars.of is None else hit | few[stars.of])

    def count(
        self,
        turn: NDArray[np.complex128],
        shift: NDArray[np.complex128],
        mirrored: NDArray[np.bool_],
        stars: Proof,
    ) -> tuple[Array, Array, Array]:
        """Hits, close hits (each measurement once at most) and predictions in the frame; shape (n,) each."""
        owners, inside = self._owners(turn, shift, mirrored, stars.w, stars.of)
        far, close = (owners & _FAR).astype(np.int16), (owners >> _CLOSE_BITS).astype(np.int16)
        return _different(far), _different(close), np.count_nonzero(inside, axis=1).astype(float)


NOWHERE_ARCSEC = 1e8
"""Stars that fill up the list of a tile with fewer than others lie so far off that no frame has them."""


@dataclass(frozen=True, slots=True)
class Proof:
    """The stars that plates are held against: of one tile, or of several.

    Attributes
    ----------
    w : ndarray of complex, shape (stars,) or (tiles, stars)
        ξ + iη in arcsec, brightest first.
    count : ndarray of int, shape (tiles,)
        How many of them are stars.
    of : ndarray of int, shape (n,), or None
        To which of the tiles each plate belongs.
    """

    w: NDArray[np.complex128]
    count: Index
    of: Index | None = None

    @classmethod
    def of_tiles(cls, stars: list[NDArray[np.complex128]], of: Index) -> Proof:
        """The stars of each tile, for plates of these tiles."""
        count = np.array([one.size for one in stars], dtype=np.int64)
        if len(stars) == 1:
            return cls(stars[0], count)
        w = np.full((len(stars), int(count.max())), complex(NOWHERE_ARCSEC, NOWHERE_ARCSEC))
        for row, one in zip(w, stars, strict=True):
            row[: one.size] = one
        return cls(w, count, of)

    def only(self, chosen: Index) -> Proof:
        """The same for some of the plates."""
        return self if self.of is None else Proof(self.w, self.count, self.of[chosen])


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
TILE_WORK, HYPOTHESIS_WORK = 4_000, 20
"""What visiting a tile, and trying a hypothesis, cost in catalog triangles: measured, ±20 % between rounds.
Doubled, rounds of many tiles end earlier beside those of few."""
AREAS_REMEMBERED = 40
"""Search areas remembered at once: every round visits the same. A limit of memory."""


class OutOfTime(Exception):
    """The budget is spent."""


@dataclass(frozen=True, slots=True)
class Points:
    """The measurements that take part: places (pixels, brightest first) and the frame's size."""

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
    work : int
        What triangles have cost so far, in catalog triangles (`TILE_WORK`, `HYPOTHESIS_WORK`): the same on
        any machine.
    round_ends : float
        The round under way ends where `work` exceeds this.
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
    work: int = 0
    round_ends: float = np.inf
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
    finder = _Finder(area, turn, frame, frame_triangles, index, grid, settings, search)
    work = waiting = 0
    group: list[_TileStars] = []
    for number in range(len(area)):
        tile = area.tile(number)
        if tile.off_deg < turn.inner_deg:
            continue
        search.check_time()
        search.tiles_tried += 1
        search.work += TILE_WORK
        search.reach_deg = max(search.reach_deg, tile.off_deg)
        if tile.stars.size < settings.min_pairs:
            continue
        places = _flat(tile, area)
        chosen = _corners(*places, turn, tile_deg, settings)
        count = int(chosen.size)
        triangles = count * (count - 1) * (count - 2) // 6
        work += triangles
        if work <= turn.from_triangles:
            continue  # an earlier round was here
        search.work += triangles
        group.append(_TileStars(tile, *places, chosen, search.tiles_tried, search.reach_deg))
        waiting += triangles
        # the nearest tile by itself: most hints mean it
        if waiting > TOGETHER_TRIANGLES or len(group) >= TOGETHER_TILES or number == 0:
            yield from finder.proposed(group)
            group, waiting = [], 0
        if work > turn.most_triangles or search.work > search.round_ends:
            break
    yield from finder.proposed(group)


TOGETHER_TRIANGLES, TOGETHER_TILES = 30_000, 24
"""Tiles are searched together until they have so many catalog triangles, or are so many: what a call of numpy
costs is then paid once for all of them. It changes time, no result."""


@dataclass(frozen=True, slots=True)
class _TileStars:
    """A tile with its stars about its middle, arcsec; and what was counted when it was visited."""

    tile: Tile
    xi: Array
    eta: Array
    chosen: Index
    tiles_tried: int
    reach_deg: float

    @property
    def corners(self) -> NDArray[np.complex128]:
        """The stars that make triangles."""
        w: NDArray[np.complex128] = self.xi[self.chosen] + 1j * self.eta[self.chosen]
        return w


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


@dataclass(frozen=True, slots=True)
class _Finder:
    """Compares tiles with the frame: what a round needs for that."""

    area: SearchArea
    turn: Round
    frame: Points
    frame_triangles: Triangles
    index: TriangleIndex
    grid: MatchGrid
    settings: IdentificationSettings
    search: Search

    def proposed(self, group: list[_TileStars]) -> Iterator[Hypothesis]:
        """Hypotheses of some tiles, tile after tile, the best of each chunk first."""
        if not group:
            return
        settings, frame, scales, search = self.settings, self.frame, self.turn.scales, self.search
        least_arcsec = settings.k_height * 0.5 * (frame.width_px + frame.height_px) * scales[0] * 0.99
        shortest_arcsec, longest_arcsec = self.index.length_bounds()
        w = np.concatenate([one.corners for one in group])
        sizes = [int(one.chosen.size) for one in group]
        triangles = make_triangles(
            w.real,
            w.imag,
            min_side=least_arcsec,
            min_height=least_arcsec,
            max_side=min(float(np.hypot(frame.width_px, frame.height_px)) * scales[1] * 1.01, longest_arcsec),
            min_longest=shortest_arcsec,
            wanted=self.index.may_hold,
            lists=sizes,
        )
        first_star = np.concatenate(([0], np.cumsum(sizes)))
        tile_of = np.repeat(np.arange(len(group)), sizes)[triangles.corners[:, 0]]
        of_frame, of_catalog = self.index.like(triangles, tile_of)
        of_tile = tile_of[of_catalog]
        counts = np.bincount(of_tile, minlength=len(group))
        for start, end in _runs(counts):
            search.check_time()
            a = self.frame_triangles.corners[of_frame[start:end]]
            b = triangles.corners[of_catalog[start:end]]
            yield from self._followed(group, of_tile[start:end], a, b, w, first_star)

    def _followed(
        self,
        group: list[_TileStars],
        of_tile: Index,
        a: Index,
        b: Index,
        w: NDArray[np.complex128],
        first_star: Index,
    ) -> Iterator[Hypothesis]:
        """The best of a chunk, in which each tile's are together; `a` and `b` are like triangles' corners."""
        settings, frame, search, grid = self.settings, self.frame, self.search, self.grid
        scales = self.turn.scales
        z = frame.x_px + 1j * frame.y_px
        middle = 0.5 * complex(frame.width_px - 1, frame.height_px - 1)
        own_arcsec = OWN_STEPS * settings.tile_step * min(frame.width_px, frame.height_px) * scales[1]
        factor, shift, mirrored, kept = constants(z[a], w[b], scales, settings.skew_max)
        # a frame that lies about another tile's middle is that tile's to propose
        there = factor * np.where(mirrored, middle.conjugate(), middle) + shift
        own = np.flatnonzero(np.abs(there) <= own_arcsec)
        if own.size == 0:
            return
        factor, shift, mirrored, kept = factor[own], shift[own], mirrored[own], kept[own]
        tiles, of = np.unique(of_tile[kept], return_inverse=True)
        # each tile's odds count what was tried up to its own
        tried = search.hypotheses + np.cumsum(np.bincount(of))
        stars = Proof.of_tiles([self._proof(group[tile]) for tile in tiles], of)
        ended = search.hypotheses + int(factor.size), search.tiles_tried, search.reach_deg
        look = grid.promising(factor, shift, mirrored, stars)
        if look.size:
            a, b, of = a[kept[look]], b[kept[look]], of[look]
            factor, shift, mirrored = factor[look], shift[look], mirrored[look]
            hits, close, predicted = grid.count(factor, shift, mirrored, stars.only(look))
            chance = 2.0 * np.minimum(
                binomial_sf(hits - 3, predicted - 3, grid.chances[0]),
                binomial_sf(close - 3, predicted - 3, grid.chances[1]),
            )
            good = np.flatnonzero((hits - 3 >= 2) & (chance * tried[of] < FOLLOWED_UP_BELOW))
            ranked = good[np.lexsort((chance[good], of[good]))]
            for number in np.unique(of[ranked]):
                one = group[tiles[number]]
                search.hypotheses, search.tiles_tried = int(tried[number]), one.tiles_tried
                search.reach_deg = one.reach_deg
                for best in ranked[of[ranked] == number][:FINALISTS]:
                    yield self._hypothesis(
                        one,
                        (complex(factor[best]), complex(shift[best]), bool(mirrored[best])),
                        a[best],
                        b[best] - first_star[tiles[number]],
                    )
        search.hypotheses, search.tiles_tried, search.reach_deg = ended
        search.work += HYPOTHESIS_WORK * int(own.size)

    def _proof(self, one: _TileStars) -> NDArray[np.complex128]:
        """The stars of a tile that plates are held against."""
        cap, regions = self.settings.region_cap, self.settings.m_reg
        proved = spread_brightest(one.xi, one.eta, self.settings.n_confirm_stars, regions=regions, cap=cap)
        w: NDArray[np.complex128] = one.xi[proved] + 1j * one.eta[proved]
        return w

    def _hypothesis(
        self, one: _TileStars, similarity: tuple[complex, complex, bool], of_frame: Index, of_tile: Index
    ) -> Hypothesis:
        turn, shift, mirrored = similarity
        frame, stars = self.frame, one.tile.stars[one.chosen][of_tile]
        return Hypothesis(
            plate=similarity_plate(
                one.tile.place,
                turn,
                shift,
                mirrored=mirrored,
                width_px=frame.width_px,
                height_px=frame.height_px,
            ),
            corners=Corners(
                x_px=frame.x_px[of_frame],
                y_px=frame.y_px[of_frame],
                ra_deg=self.area.stars.ra_deg[stars],
                dec_deg=self.area.stars.dec_deg[stars],
            ),
        )


def _runs(counts: Index) -> Iterator[tuple[int, int]]:
    """Cut hypotheses in chunks: of several whole tiles, or a part of one that has too many."""
    start = end = 0
    for count in counts.tolist():
        if end > start and end - start + count > CHUNK:
            yield start, end
            start = end
        end += count
        while end - start > CHUNK:
            yield start, start + CHUNK
            start += CHUNK
            if end - start <= CHUNK and end > start:
                yield start, end
                start = end
    if end > start:
        yield start, end
