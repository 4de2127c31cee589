"""Places all over the sky where the frame's quads fit: the blind counterpart of `full.hypotheses`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Catalog
from mountnav.identification.blind.asking import ASKS, Ask, frame_codes, frame_quads
from mountnav.identification.blind.candidates import Candidates, chances, propose
from mountnav.identification.blind.index import BlindIndex
from mountnav.identification.blind.sky import IndexedSky
from mountnav.identification.blind.view import View
from mountnav.identification.full import Hypothesis, Points, Search, match_radius
from mountnav.identification.plate import ARCSEC_PER_RAD
from mountnav.identification.selection import spread_brightest
from mountnav.identification.settings import IdentificationSettings
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]

FIRST, BATCH = 48, 1000
"""Places tested at once, best fitting quads first: mostly the right one is among the first few."""
WORTH_A_LOOK = 0.3
"""Expected number of places as good by chance, below which a place is followed up."""
FINALISTS = 6
"""Of a batch, so many places are followed up at most."""
FIRST_ASKS = 3
SAME_PLACE = 3
"""Quads that propose the same place are followed up so often: another quad's plate may fare better."""


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
    catalog : Catalog
    scales : (float, float) or None
        Bounds of the scale, arcsec per pixel, if known.
    center : Icrs or None
        The frame's center is within `radius_deg` of it, if known.
    radius_deg : float
    epoch_yr : float
        Julian year of the frame.
    settings : IdentificationSettings
    search : Search
        Counts the places at which other stars than the quad's own were looked for; the odds need it.
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
    sky = IndexedSky(index, catalog, epoch_yr)
    if points.x_px.size < settings.min_pairs:
        return
    view = View.of(
        points, scales, center, radius_deg, match_radius(settings, points.width_px, points.height_px)
    )
    try:
        asks = ASKS[:FIRST_ASKS] if first_only else ASKS
        yield from _rounds(points, sky, view, settings, search, asks)
    finally:
        sky.rest()


def _rounds(
    points: Points,
    sky: IndexedSky,
    view: View,
    settings: IdentificationSettings,
    search: Search,
    asks: Sequence[Ask],
) -> Iterator[Hypothesis]:
    """What each round proposes."""
    seen: set[bytes] = set()
    told: list[Array] = []
    before = search.hypotheses
    for number, ask in enumerate(asks):
        search.check_time()
        if ask.side_deg and view.scale_known:
            continue  # every round has its quads laid on the sphere then
        chosen = spread_brightest(
            points.x_px, points.y_px, ask.count, regions=settings.m_reg, cap=settings.region_cap
        )
        z = points.x_px[chosen] + 1j * points.y_px[chosen]
        quads = frame_quads(ask, z)
        if not len(quads):
            continue
        code, corners, tolerance = frame_codes(ask, z, quads, view.center, view.focal_px(ask.side_deg))
        asked, quad = sky.index.alike(code, tolerance)
        some = _fresh(propose(z[corners[asked]], tolerance[asked], quad, sky, view), seen)
        for start, end in ((0, FIRST), *((at, at + BATCH) for at in range(FIRST, len(some), BATCH))):
            search.check_time()
            part = some.only(np.arange(start, min(end, len(some))))
            yield from _promising(part, sky, view, search, told, before)
        if number >= FIRST_ASKS:
            sky.rest()  # most of the file would be mapped in the end


def _fresh(some: Candidates, seen: set[bytes]) -> Candidates:
    """Those that no earlier round proposed."""
    fresh = []
    for number, key in enumerate(some.keys()):
        if key not in seen:
            seen.add(key)
            fresh.append(number)
    return some.only(np.array(fresh, dtype=np.int64))


def _promising(
    some: Candidates, sky: IndexedSky, view: View, search: Search, told: list[Array], before: int
) -> Iterator[Hypothesis]:
    """Those round whose quad other stars fall on measurements, best first.

    What earlier searches tried (`before`) counts in the odds, not in what is worth asking them.
    """
    if not len(some):
        return
    chance = chances(some, sky, view)
    search.hypotheses += len(some)
    good = np.flatnonzero(chance * (search.hypotheses - before) < WORTH_A_LOOK)
    left = FINALISTS
    for number in good[np.argsort(chance[good], kind="stable")]:
        axis = some.fit.axis[number]
        near = 0.1 * view.diagonal_px * abs(some.fit.turn[number]) / ARCSEC_PER_RAD
        if sum(float(((axis - one) ** 2).sum()) < near**2 for one in told) >= SAME_PLACE:
            continue
        told.append(axis)
        yield some.hypothesis(int(number), sky, view)
        left -= 1
        if left == 0:
            return
