"""Full identification: triangles propose the six plate constants, stars confirm them [S23 §2.2]."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Catalog
from mountnav.identification.anchor_count import Anchors
from mountnav.identification.area import arcsec
from mountnav.identification.board import Board
from mountnav.identification.budget import Budget
from mountnav.identification.combs import pieces
from mountnav.identification.confirmation import Corners
from mountnav.identification.odds import at_least
from mountnav.identification.patch import Patch, Tile
from mountnav.identification.plate import Plate, constants, similarity_plate
from mountnav.identification.rounds import Round
from mountnav.identification.selection import spread_brightest
from mountnav.identification.settings import IdentificationSettings
from mountnav.identification.triangles import TriangleIndex, Triangles, make_triangles
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CHUNK = 4000
"""Hypotheses tried at once: 4000 × 60 complex numbers fit a processor's cache."""
FINALISTS = 3
"""Of a chunk, so many of the best hypotheses are followed up."""
WORTH_A_LOOK = 0.3
"""Expected number of chance matches as good as a hypothesis' raster count, below which it is followed up."""
OWN_STEPS = 1.0
"""A tile's hypotheses are those whose frame has its center no farther from the tile's middle than so many
steps of the tiles: no place is farther than 0.58 from the nearest. Doubled, each hypothesis is tried in seven
tiles; halved, places between tiles are nobody's."""
PATCHES = 40
"""Patches of sky remembered at once."""


class OutOfTime(Exception):
    """The budget is spent."""


@dataclass(frozen=True, slots=True)
class Points:
    """The measurements that take part: places (pixels, brightest first) and the frame's size.

    Attributes
    ----------
    x_px, y_px : ndarray, shape (n,)
    width_px, height_px : int
    """

    x_px: Array
    y_px: Array
    width_px: int
    height_px: int

    def first(self, chosen: Index) -> Points:
        """Only those."""
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
    """What one search has cost and seen so far.

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
        Share of places where chance has a measurement of Ω_bl100 within Δr_ident.
    whole_sky : bool
        The index of the whole sky was asked.
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
    _patches: dict[tuple[float, ...], Patch] = field(default_factory=dict)
    _pieces: dict[bytes, Index] = field(default_factory=dict)

    def check_time(self) -> None:
        """Raise OutOfTime when the budget is spent."""
        if self.budget.spent:
            raise OutOfTime

    def pieces(self, x_px: Array, y_px: Array) -> Index:
        """Which source each measurement is a piece of, remembered: every hypothesis asks for it."""
        key = x_px.tobytes()
        if key not in self._pieces:
            self._pieces[key] = pieces(x_px, y_px)
        return self._pieces[key]

    def patch(
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
    ) -> Patch:
        """A `Patch`, remembered: every round visits the same tiles."""
        key = (center.ra_deg, center.dec_deg, radius_deg, step_deg, tile_deg, count, most_tiles)
        if key not in self._patches:
            if len(self._patches) >= PATCHES:
                self._patches.clear()
            self._patches[key] = Patch(
                catalog,
                center,
                radius_deg,
                step_deg,
                tile_deg,
                count=count,
                epoch_yr=epoch_yr,
                most_tiles=most_tiles,
            )
        return self._patches[key]


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
    catalog : Catalog
    center : Icrs
        The assumed center.
    epoch_yr : float
        Julian year of the frame.
    settings : IdentificationSettings
    search : Search
        Counts what is tried; the odds need it.

    Yields
    ------
    Hypothesis

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
        angle_rad=float(np.radians(settings.angle_arcmin / 60.0)),
        scale_low=turn.scales[0],
        scale_high=turn.scales[1],
    )
    board = Board(
        confirm.x_px,
        confirm.y_px,
        match_radius(settings, width, height),
        width_px=width,
        height_px=height,
    )
    search.strobe_chance = max(search.strobe_chance, board.chances[0])
    tile_deg = min(settings.tile_radius * float(np.hypot(width, height)) * scale / 3600.0, 40.0)
    patch = search.patch(
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
    for number in range(len(patch)):
        tile = patch.tile(number)
        if tile.off_deg < turn.inner_deg:
            continue
        search.check_time()
        search.tiles_tried += 1
        search.reach_deg = max(search.reach_deg, tile.off_deg)
        if tile.stars.size < settings.min_pairs:
            continue
        places = _flat(tile, patch)
        chosen = _corners(*places, turn, tile_deg, settings)
        count = int(chosen.size)
        work += count * (count - 1) * (count - 2) // 6
        if work <= turn.from_triangles:
            continue  # an earlier round was here
        yield from _in_tile(
            tile, places, chosen, patch, turn, frame, frame_triangles, index, board, settings, search
        )
        if work > turn.most_triangles:
            return


def _flat(tile: Tile, patch: Patch) -> tuple[Array, Array]:
    """Its stars about its middle, arcsec in the tangent plane."""
    ra_deg, dec_deg = patch.stars.ra_deg[tile.stars], patch.stars.dec_deg[tile.stars]
    xi_rad, eta_rad = gnomonic(ra_deg, dec_deg, tile.place.ra_deg, tile.place.dec_deg)
    return arcsec(np.asarray(xi_rad)), arcsec(np.asarray(eta_rad))


def _corners(xi: Array, eta: Array, turn: Round, tile_deg: float, settings: IdentificationSettings) -> Index:
    """Stars of a tile that make triangles, brightest first: in dear rounds over wide areas, its inner ones.

    Triangles grow with the third power of the stars, and stars at a tile's rim lie in few frames that are
    this tile's: they are its neighbors' to ask.
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
    patch: Patch,
    turn: Round,
    frame: Points,
    frame_triangles: Triangles,
    index: TriangleIndex,
    board: Board,
    settings: IdentificationSettings,
    search: Search,
) -> Iterator[Hypothesis]:
    """Hypotheses of one tile, best of each chunk first."""
    ra_deg, dec_deg = patch.stars.ra_deg[tile.stars], patch.stars.dec_deg[tile.stars]
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
        look = board.promising(factor, shift, mirrored, w_proof)
        if look.size == 0:
            continue
        a, b = a[kept[look]], b[kept[look]]
        factor, shift, mirrored = factor[look], shift[look], mirrored[look]
        hits, close, predicted = board.count(factor, shift, mirrored, w_proof)
        chance = 2.0 * np.minimum(
            at_least(hits - 3, predicted - 3, board.chances[0]),
            at_least(close - 3, predicted - 3, board.chances[1]),
        )
        good = (hits - 3 >= 2) & (chance * search.hypotheses < WORTH_A_LOOK)
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
