"""Full identification: triangles propose the six plate constants, stars confirm them [S23 §2.2]."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Catalog, Stars
from mountnav.identification.area import arcsec, stars_round, tiles
from mountnav.identification.confirmation import Corners
from mountnav.identification.odds import area_share, at_least
from mountnav.identification.plate import Plate, constants, similarity_plate
from mountnav.identification.selection import spread_brightest
from mountnav.identification.settings import IdentificationSettings, Stage
from mountnav.identification.triangles import TriangleIndex, Triangles, make_triangles
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CHUNK = 20000
"""Hypotheses tried at once: 20000 × 100 complex numbers are 32 MB."""
FINALISTS = 4
"""Of a chunk, so many of the best hypotheses are followed up."""


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
    hits, predicted : int
        Measurements hit, of stars predicted in the frame; the triangle's three not counted.
    """

    plate: Plate
    corners: Corners
    hits: int
    predicted: int


@dataclass(slots=True)
class Search:
    """What one search has cost and seen so far.

    Attributes
    ----------
    deadline_s : float
        `time.monotonic` value at which it ends.
    hypotheses : int
        Plates tried: each is one more chance to be fooled.
    frame_triangles : int
        Most triangles that the frame's measurements made.
    most_stars : int
        Most catalog stars that a tile held.
    tiles_tried : int
        Tiles visited, again in every stage.
    best_probability : float
        Least false-positive probability among refused hypotheses.
    """

    deadline_s: float
    hypotheses: int = 0
    frame_triangles: int = 0
    most_stars: int = 0
    best_probability: float = 1.0
    tiles_tried: int = 0
    _stars: dict[tuple[float, float, float], Stars] = field(default_factory=dict)

    def check_time(self) -> None:
        """Raise OutOfTime when the budget is spent."""
        if time.monotonic() > self.deadline_s:
            raise OutOfTime

    def stars(self, catalog: Catalog, tile: Icrs, radius_deg: float, count: int, epoch_yr: float) -> Stars:
        """`stars_round`, remembered: every stage visits the same tiles."""
        key = (tile.ra_deg, tile.dec_deg, radius_deg)
        if key not in self._stars:
            if len(self._stars) > 400:
                self._stars.clear()
            self._stars[key] = stars_round(catalog, tile, radius_deg, count, epoch_yr=epoch_yr)
        return self._stars[key]


def match_radius(settings: IdentificationSettings, width_px: int, height_px: int) -> float:
    """Δr_ident in pixels, bounded by a share of the frame: 10 px of a small frame prove nothing."""
    return max(2.5, min(settings.match_px, settings.match_share * min(width_px, height_px)))


def hypotheses(
    points: Points,
    stage: Stage,
    catalog: Catalog,
    center: Icrs,
    radius_deg: float,
    scale_low: float,
    scale_high: float,
    *,
    epoch_yr: float,
    settings: IdentificationSettings,
    search: Search,
) -> Iterator[Hypothesis]:
    """Propose plates, most promising first within each step, until the search area is used up.

    Parameters
    ----------
    points : Points
        Star-like measurements, brightest first.
    stage : (int, int)
        How many of the brightest measurements and of a tile's stars make triangles.
    catalog : Catalog
    center, radius_deg
        The assumed center and how far off it may be.
    scale_low, scale_high : float
        Bounds of the scale, arcsec per pixel.
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
    radius_px = match_radius(settings, width, height)
    scale = float(np.sqrt(scale_low * scale_high))
    step_deg = settings.tile_step * min(width, height) * scale / 3600.0
    cone_deg = min(settings.tile_radius * float(np.hypot(width, height)) * scale / 3600.0, 40.0)
    confirm = points.first(
        spread_brightest(
            points.x_px,
            points.y_px,
            settings.n_confirm_measurements,
            regions=settings.m_reg,
            cap=settings.region_cap,
        )
    )
    board = _Board(confirm, radius_px)
    size = 0.5 * (width + height)
    frame = points.first(
        spread_brightest(points.x_px, points.y_px, stage[0], regions=settings.m_reg, cap=settings.region_cap)
    )
    frame_triangles = make_triangles(
        frame.x_px,
        frame.y_px,
        min_side=settings.k_height * size,
        min_height=settings.k_height * size,
        limit=settings.frame_triangles,
    )
    search.frame_triangles = max(search.frame_triangles, len(frame_triangles))
    if not len(frame_triangles):
        return
    for tile in tiles(center, radius_deg, step_deg):
        search.check_time()
        search.tiles_tried += 1
        stars = search.stars(catalog, tile, cone_deg, 2 * settings.n_confirm_stars, epoch_yr)
        yield from _in_tile(
            tile, stars, stage, frame, frame_triangles, board, (scale_low, scale_high), settings, search
        )


def _in_tile(
    tile: Icrs,
    stars: Stars,
    stage: Stage,
    frame: Points,
    frame_triangles: Triangles,
    board: _Board,
    scales: tuple[float, float],
    settings: IdentificationSettings,
    search: Search,
) -> Iterator[Hypothesis]:
    """Hypotheses of one tile, best of each chunk first."""
    search.most_stars = max(search.most_stars, len(stars))
    if len(stars) < settings.min_pairs:
        return
    xi_rad, eta_rad = gnomonic(stars.ra_deg, stars.dec_deg, tile.ra_deg, tile.dec_deg)
    xi, eta = arcsec(np.asarray(xi_rad)), arcsec(np.asarray(eta_rad))
    cap, regions = settings.region_cap, settings.m_reg
    chosen = spread_brightest(xi, eta, stage[1], regions=regions, cap=cap)
    proved = spread_brightest(xi, eta, settings.n_confirm_stars, regions=regions, cap=cap)
    size = 0.5 * (frame.width_px + frame.height_px)
    catalog_triangles = make_triangles(
        xi[chosen],
        eta[chosen],
        min_side=settings.k_height * size * scales[0] * 0.99,
        min_height=settings.k_height * size * scales[0] * 0.99,
        max_side=float(np.hypot(frame.width_px, frame.height_px)) * scales[1] * 1.01,
    )
    index = TriangleIndex(
        catalog_triangles,
        angle_rad=float(np.radians(settings.angle_arcmin / 60.0)),
        scale_low=scales[0],
        scale_high=scales[1],
    )
    of_frame, of_catalog = index.like(frame_triangles)
    z = frame.x_px + 1j * frame.y_px
    w = xi[chosen] + 1j * eta[chosen]
    w_proof = xi[proved] + 1j * eta[proved]
    for start in range(0, of_frame.size, CHUNK):
        search.check_time()
        a = frame_triangles.corners[of_frame[start : start + CHUNK]]
        b = catalog_triangles.corners[of_catalog[start : start + CHUNK]]
        turn, shift, mirrored, kept = constants(z[a], w[b], scales, settings.skew_max)
        a, b = a[kept], b[kept]
        if turn.size == 0:
            continue
        search.hypotheses += int(turn.size)
        hits, predicted = board.count(turn, shift, mirrored, w_proof)
        chance = at_least(hits - 3, predicted - 3, board.chance)
        possible = np.minimum(predicted, board.size)
        good = (hits - 3 >= 2) & (hits >= settings.min_share * possible) & (chance * search.hypotheses < 1e-2)
        ranked = np.flatnonzero(good)[np.argsort(chance[good], kind="stable")]
        for best in ranked[:FINALISTS]:
            yield Hypothesis(
                plate=similarity_plate(
                    tile,
                    complex(turn[best]),
                    complex(shift[best]),
                    mirrored=bool(mirrored[best]),
                    width_px=frame.width_px,
                    height_px=frame.height_px,
                ),
                corners=Corners(
                    x_px=frame.x_px[a[best]],
                    y_px=frame.y_px[a[best]],
                    ra_deg=stars.ra_deg[chosen][b[best]],
                    dec_deg=stars.dec_deg[chosen][b[best]],
                ),
                hits=int(hits[best]) - 3,
                predicted=int(predicted[best]) - 3,
            )


class _Board:
    """A raster of the frame that knows which cells lie near a measurement: a lookup for millions of stars."""

    def __init__(self, points: Points, radius_px: float) -> None:
        self._cell = radius_px / 3.0
        self._width, self._height = points.width_px, points.height_px
        self.size = int(points.x_px.size)
        columns = int(np.ceil(points.width_px / self._cell)) + 1
        rows = int(np.ceil(points.height_px / self._cell)) + 1
        self._board = np.full((rows, columns), -1, dtype=np.int32)
        offset = np.arange(-4, 5)
        for number in range(self.size - 1, -1, -1):  # the brightest last: it owns what overlaps
            x, y = points.x_px[number] / self._cell, points.y_px[number] / self._cell
            column, row = int(x) + offset, int(y) + offset
            near = np.hypot(column[None, :] + 0.5 - x, row[:, None] + 0.5 - y) <= 3.0
            near &= ((column >= 0) & (column < columns))[None, :] & ((row >= 0) & (row < rows))[:, None]
            r, c = np.nonzero(near)
            self._board[row[r], column[c]] = number
        share = area_share(points.x_px, points.y_px, radius_px, width_px=self._width, height_px=self._height)
        self.chance = float(share.mean())

    def count(
        self,
        turn: NDArray[np.complex128],
        shift: NDArray[np.complex128],
        mirrored: NDArray[np.bool_],
        w: NDArray[np.complex128],
    ) -> tuple[Array, Array]:
        """Hits (each measurement once at most) and predictions in the frame, per hypothesis; shape (n,)."""
        z = (w[None, :] - shift[:, None]) / turn[:, None]
        x, y = z.real, np.where(mirrored[:, None], -z.imag, z.imag)
        inside = (x > -0.5) & (x < self._width - 0.5) & (y > -0.5) & (y < self._height - 0.5)
        column = np.where(inside, x / self._cell, 0.0).astype(np.int32)
        row = np.where(inside, y / self._cell, 0.0).astype(np.int32)
        owner = np.where(inside, self._board[np.maximum(row, 0), np.maximum(column, 0)], -1)
        owner.sort(axis=1)
        fresh = (owner[:, 1:] != owner[:, :-1]) & (owner[:, 1:] >= 0)
        hits = fresh.sum(axis=1) + (owner[:, 0] >= 0)
        return hits.astype(float), inside.sum(axis=1).astype(float)
