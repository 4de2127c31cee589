"""A second exposure drawn out beside a few stars: no bin of it is bright, but all stars have the same share.

Where few stars were identified, a second exposure with a third of the light that is drawn out over 30 px lies
near or below the noise in every bin. The mean over the stars counts a bright neighbor for little, and so it
counts the brightest star's own second image. Here the light of a stretch of the frame at one offset from
every star is compared with what such stretches hold elsewhere in the frame: each star tells how much likelier
it is that a common share of its light lies there than that nothing but noise and strangers do. Strangers are
as frequent as the frame itself has them, so crowds and uneven noise need no limits of their own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.identification.faint_exposure import FaintExposure
from mountnav.measuring.background import Image
from mountnav.measuring.medians import median
from mountnav.measuring.segmentation import LightSegments
from mountnav.measuring.star_trail import FAR_BIN_PX, REACH_PX

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

STARS_COMPARED = 16
"""Brightest stars whose surroundings are compared. Doubled, fainter ones add time and little light."""
FEWEST_COMPARED = 4
"""Fewer stars than this, whose stretch at an offset lies in the frame, say nothing."""
CORE_FWHM, CORE_PX, FARTHEST_CORE_PX = 3.0, 12.0, 24.0
"""Light within so many widths, and within the first of these pixels but no more than the second, is that of
the star's own image, which the near look sees. Doubled, a second exposure 20 px away would be overlooked."""
SQUARES, LINES, DIRECTIONS = (2, 4, 8), (4, 8, 12), 12
"""Stretches that are looked at, in bins of 4 px: squares of these sides, and lines two bins wide of these
lengths in so many directions. Longer ones are seen as tails (`star_trail`)."""
FLOOR_SIGMA, CEILING_SIGMA = -3.0, 12.0
"""Bins count no less and no more than this in the search, in sigmas of the sky."""
GREATEST_WEIGHT = 6.0
"""No star counts in the search for more than so many times the median of those compared."""
HIGHEST, CANDIDATES = 150, 30
"""Of so many offsets, those with the highest sums, each with the stretch that has it, so many are compared
star by star. Doubled, it costs 10 ms more, and of the drawn frames the same are found."""
APART_BINS = 2
"""Offsets of one stretch that are no farther apart than this, bins, are one candidate."""
SAMPLES = 4000
"""Stretches elsewhere in the frame that tell what noise and strangers bring. With half as many a stranger as
rare as 1 in 2,000 counts as one that was never seen."""
KNOWN_SHARE = 0.6
"""A stretch of which known stars or the frame's edge take more than the rest of this isn't compared."""
SHARES = np.geomspace(0.04, 1.0, 22)
"""Shares of the star's light that are tried: less pulls the middle nowhere."""
SHARE_SCATTER = 0.35
"""By so much of it the single stars' shares scatter: images that are saturated or lie partly in the stretch.
Chosen by hand."""
LOST = 0.1
"""Share of the second images that aren't where they should be: no star says more against it than 1 in 10."""
MOST_NATS = 9.0
"""No star says more for it than this, however bright what lies beside it is (1 in 8,000: one stretch in all
that were sampled)."""
OTHERS_NATS = 3.0
"""All stars but the one that says most say at least this: what lies beside one star is a stranger."""
SURE_NATS = 6.0
"""It is believed if it is so much likelier, as a power of e, than there are stretches that lie no farther
from the star: 1 in 400. Sound frames, drawn and real, stay 3 and more below what is needed (a corner of a
JPEG through a poor lens 1), the drawn one that was overlooked is 1 above it (`benchmarks.trailed`, seed
141421). Doubled, that one is overlooked."""
STRETCHES_PER_OFFSET = 10.0
"""Independent ones of the 39, for that number; and an offset is independent of others `INDEPENDENT_BINS`
away. Chosen by hand."""
INDEPENDENT_BINS = 2.0
ONE_SIDED_SIGMAS = 3.0
"""What isn't brighter by so many sigmas than what lies on the other side of the stars is a spike or a halo:
it pulls the middle nowhere. Doubled, the drawn frame of seed 141421 is overlooked again."""


def _stretches() -> list[Index]:
    """Bins of each stretch, counted from its middle: rows and columns, each of shape (n, 2)."""
    found = []
    for side in SQUARES:
        at = np.arange(side) - side // 2
        found.append(np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.int64))
    for length in LINES:
        for step in range(DIRECTIONS):
            angle = math.pi * step / DIRECTIONS
            along = np.arange(-0.5 * (length - 1), 0.5 * length, 0.5)
            across = np.array([-0.5, 0.5])
            rows = along[:, None] * math.sin(angle) + across * math.cos(angle)
            columns = along[:, None] * math.cos(angle) - across * math.sin(angle)
            bins = np.rint(np.stack((rows, columns), axis=-1).reshape(-1, 2)).astype(np.int64)
            found.append(np.unique(bins, axis=0))
    return found


_STRETCHES = _stretches()
_ROOM = max(LINES) + 2
"""More bins than a stretch reaches from its middle."""
_HALF = REACH_PX // FAR_BIN_PX


@dataclass(frozen=True, slots=True)
class _Evidence:
    """What the stars say of one stretch at one offset, nats."""

    share: float
    stars: int
    nats: float
    others_nats: float


def drawn_out_exposure(
    bins: tuple[Image, Image],
    patches: LightSegments,
    x_px: Array,
    y_px: Array,
    light: Array,
    fwhm_px: float,
    *,
    least_pull_px: float,
) -> FaintExposure | None:
    """Look for a second exposure that moves the middle by at least `least_pull_px`.

    Parameters
    ----------
    bins : (ndarray, ndarray)
        The frame by `star_trail.in_bins`: in sigmas of its sky, and which bins are known.
    patches : LightSegments
        The light of the frame.
    x_px, y_px, light : ndarray, shape (n,)
        Where the plate has all the stars that it knows of, and their light by the catalog.
    fwhm_px : float
        Width of a star's image.

    Returns
    -------
    FaintExposure or None
        The surest one, its `sigmas` those of a Gaussian with the same odds; None where chance would bring as
        much.
    """
    scene = _Scene.of(bins, patches, x_px, y_px, light)
    if scene is None:
        return None
    core_px = min(max(CORE_FWHM * fwhm_px, CORE_PX), FARTHEST_CORE_PX)
    best: FaintExposure | None = None
    surest = 0.0
    for number, down, right in _candidates(scene, core_px):
        offset = np.array([down, right])
        away_bins = math.hypot(down, right)
        trials = math.pi * (away_bins / INDEPENDENT_BINS) ** 2 * STRETCHES_PER_OFFSET
        needed = SURE_NATS + math.log(trials)
        found = scene.evidence(offset, number)
        if found is None or found.nats <= needed + surest or found.others_nats < OTHERS_NATS:
            continue
        one_sided = scene.one_sided(offset, number)
        if one_sided is not None and one_sided * abs(complex(down, right)) * FAR_BIN_PX < least_pull_px:
            continue
        one = FaintExposure(
            FAR_BIN_PX * complex(right, down), found.share, found.stars, math.sqrt(2.0 * found.nats)
        )
        if one.pull_px >= least_pull_px:
            best, surest = one, found.nats - needed
    return best


def _candidates(scene: _Scene, core_px: float) -> list[tuple[int, int, int]]:
    """The offsets with the highest weighted sums over the stars: stretch, rows down, columns to the right."""
    total, square = scene.summed()
    # how much of a stretch is known changes slowly with its place
    cover = _sums(square, _STRETCHES[1]) / _STRETCHES[1].shape[0]
    steps = np.arange(-_HALF, _HALF + 1) * FAR_BIN_PX
    searched = (cover > 0.3 * cover.max()) & (np.hypot(steps[:, None], steps) >= core_px)
    # nothing where it isn't searched: no sum there is among the highest
    scale = np.where(searched, 1.0 / np.sqrt(np.maximum(cover, 1e-12)), 0.0).astype(np.float32)
    best = np.zeros_like(scale)
    which = np.zeros(best.shape, dtype=np.int8)
    for number, stretch in enumerate(_STRETCHES):
        score = _sums(total, stretch)
        score *= scale / np.float32(math.sqrt(len(stretch)))
        higher = score > best
        best[higher], which[higher] = score[higher], number
    highest = np.argpartition(best.ravel(), -HIGHEST)[-HIGHEST:]
    highest = highest[np.argsort(-best.ravel()[highest], kind="stable")]
    chosen: list[tuple[int, int, int]] = []
    for at in highest[best.ravel()[highest] > 0.0].tolist():
        row, column = divmod(at, 2 * _HALF + 1)
        number, down, right = int(which[row, column]), row - _HALF, column - _HALF
        if not any(
            number == other and max(abs(down - row), abs(right - column)) <= APART_BINS
            for other, row, column in chosen
        ):
            chosen.append((number, down, right))
            if len(chosen) == CANDIDATES:
                break
    return chosen


def _sums(image: Image, stretch: Index) -> Image:
    """Sum over a stretch about each bin; beyond the image is nothing."""
    total = np.zeros_like(image)
    height, width = image.shape
    for down, right in stretch.tolist():
        rows = slice(max(0, -down), min(height, height - down))
        columns = slice(max(0, -right), min(width, width - right))
        total[rows, columns] += image[
            rows.start + down : rows.stop + down, columns.start + right : columns.stop + right
        ]
    return total


@dataclass(slots=True)
class _Scene:
    """The frame without its known stars, and the brightest of these.

    Attributes
    ----------
    value : ndarray, shape (rows, columns)
        In sigmas of the sky, 0 where known stars are; `_HALF + _ROOM` bins of nothing all round.
    known : ndarray of bool
        Where there is a value.
    places : ndarray of int, shape (n, 2)
        Rows and columns of the stars there, brightest first.
    flux : ndarray, shape (n,)
        Theirs.
    sampled : ndarray of int, shape (m, 2)
        Places drawn from all that have a value.
    """

    value: Array
    known: Mask
    places: Index
    flux: Array
    sampled: Index
    _elsewhere: dict[int, _Elsewhere]

    @classmethod
    def of(
        cls, bins: tuple[Image, Image], patches: LightSegments, x_px: Array, y_px: Array, light: Array
    ) -> _Scene | None:
        level, cover = bins
        # a second exposure near its star is joined with it
        pieces = patches.parts or patches
        at = pieces.at(x_px, y_px)
        seen = np.flatnonzero(at >= 0)
        own = np.bincount(at[seen], light[seen], minlength=pieces.x_px.size)
        seen = seen[np.argsort(-light[seen], kind="stable")]
        # of each piece the star that has most of its light
        stars = seen[np.sort(np.unique(at[seen], return_index=True)[1])]
        stars = stars[light[stars] > 0.0]
        if stars.size < FEWEST_COMPARED:
            return None
        finer = FAR_BIN_PX // pieces.bin_px
        # sums over small bins, in sigmas of these
        flux = pieces.flux[at[stars]] * light[stars] / own[at[stars]] / finer
        brightest = np.argsort(-flux, kind="stable")[:STARS_COMPARED]
        stars, flux = stars[brightest], flux[brightest]
        lit = np.zeros(int(pieces.labels.max(initial=0)) + 1, dtype=bool)
        lit[at[at >= 0] + 1] = True
        rows, columns = level.shape
        mask = lit[pieces.labels][: rows * finer, : columns * finer]
        mask = np.pad(mask, ((0, rows * finer - mask.shape[0]), (0, columns * finer - mask.shape[1])))
        mask = np.asarray(mask.reshape(rows, finer, columns, finer).any(axis=(1, 3)))
        good = ~ndimage.binary_dilation(mask, structure=np.ones((3, 3), dtype=bool)) & (cover > 0)
        if not good.any():
            return None
        rim = _HALF + _ROOM
        middle = 0.5 * (FAR_BIN_PX - 1)
        places = np.rint((np.column_stack((y_px[stars], x_px[stars])) - middle) / FAR_BIN_PX).astype(np.int64)
        ground = median(level[good])
        value = np.pad(np.where(good, level - ground, 0.0), rim).astype(np.float64)
        places = np.clip(places, 0, np.array(level.shape) - 1) + rim
        where = np.flatnonzero(good)
        drawn = where[np.random.default_rng(0).integers(0, where.size, SAMPLES)]
        sampled = np.column_stack(np.divmod(drawn, columns)) + rim
        return cls(value, np.pad(good, rim), places, flux.astype(np.float64), sampled, {})

    def summed(self) -> tuple[Image, Image]:
        """Weighted sum of the stars' surroundings, and of the squares of the weights where they are known."""
        weight = np.minimum(self.flux, GREATEST_WEIGHT * median(self.flux))
        tame = np.clip(self.value, FLOOR_SIGMA, CEILING_SIGMA).astype(np.float32)
        total = np.zeros((2 * _HALF + 1, 2 * _HALF + 1), dtype=np.float32)
        square = np.zeros_like(total)
        for (row, column), one in zip(self.places.tolist(), weight.tolist(), strict=True):
            window = (slice(row - _HALF, row + _HALF + 1), slice(column - _HALF, column + _HALF + 1))
            total += one * tame[window]
            square += one * one * self.known[window]
        return total, square

    def light_in(self, places: Index, number: int) -> Array:
        """Light of a stretch about places, as if all of it were known; NaN where too little is."""
        stretch = _STRETCHES[number]
        rows, columns = places[:, :1] + stretch[:, 0], places[:, 1:] + stretch[:, 1]
        known = self.known[rows, columns].mean(axis=1)
        light = self.value[rows, columns].sum(axis=1) / np.maximum(known, 1e-9)
        return np.where(known >= KNOWN_SHARE, light, np.nan)

    def elsewhere(self, number: int) -> _Elsewhere | None:
        """What a stretch holds in the rest of the frame; None where it fits nowhere."""
        if number not in self._elsewhere:
            light = self.light_in(self.sampled, number)
            self._elsewhere[number] = _Elsewhere.of(light[np.isfinite(light)])
        found = self._elsewhere[number]
        return found if found.sample.size else None

    def evidence(self, offset: Index, number: int) -> _Evidence | None:
        """What the stars say of a stretch at an offset; None where too few of them can tell."""
        elsewhere = self.elsewhere(number)
        seen = self.light_in(self.places + offset, number)
        told = np.isfinite(seen)
        if elsewhere is None or told.sum() < FEWEST_COMPARED:
            return None
        light = (seen[told] - elsewhere.middle) / elsewhere.sigma
        expected = SHARES[:, None] * self.flux[told] / elsewhere.sigma
        spread = np.hypot(1.0, SHARE_SCATTER * expected)
        there = np.exp(-0.5 * ((light - expected) / spread) ** 2) / (math.sqrt(math.tau) * spread)
        nats = np.log((1.0 - LOST) * there / elsewhere.density(light) + LOST)
        nats = np.minimum(nats, MOST_NATS)
        best = int(np.argmax(nats.sum(axis=1)))
        every = float(nats[best].sum())
        return _Evidence(float(SHARES[best]), int(told.sum()), every, every - float(nats[best].max()))

    def one_sided(self, offset: Index, number: int) -> float | None:
        """Share of the stars' light by which a stretch has more than any near that on the other side of them.

        0 where that may be noise; None where the other side isn't known of enough stars. A star lies up to
        half a bin beside the middle of its own, and spikes are as long as they are drawn: two bins.
        """
        elsewhere = self.elsewhere(number)
        here = self.light_in(self.places + offset, number)
        least: float | None = None
        for shift in np.argwhere(np.ones((5, 5), dtype=bool)) - 2:
            more = here - self.light_in(self.places - offset + shift, number)
            told = np.isfinite(more)
            if elsewhere is None or told.sum() < FEWEST_COMPARED:
                continue
            square = float((self.flux[told] ** 2).sum())
            share = float((more[told] * self.flux[told]).sum()) / square
            if share <= ONE_SIDED_SIGMAS * math.sqrt(2.0 / square) * elsewhere.sigma:
                return 0.0
            least = share if least is None else min(least, share)
        return least


@dataclass(frozen=True, slots=True)
class _Elsewhere:
    """What a stretch of the frame holds where no known star is.

    Attributes
    ----------
    middle, sigma : float
        Median, and scatter of the lower half: strangers add light and take none.
    sample : ndarray
        Sorted, in these units.
    """

    middle: float
    sigma: float
    sample: Array

    @classmethod
    def of(cls, light: Array) -> _Elsewhere:
        if light.size == 0:
            return cls(0.0, 1.0, light)
        middle = median(light)
        sigma = max(1.4826 * median(middle - light[light <= middle]), 1e-6)
        return cls(middle, sigma, np.sort((light - middle) / sigma))

    def density(self, light: Array) -> Array:
        """Probability density of so much light: Gaussian near the middle, beyond as the frame has it.

        What was never seen may still be there as often as once in all samples.
        """
        width = np.maximum(1.0, 0.35 * np.abs(light))
        seen = np.searchsorted(self.sample, light + width) - np.searchsorted(self.sample, light - width)
        tail = (seen + 1.0) / (self.sample.size * 2.0 * width)
        core = np.exp(-0.5 * light**2) / math.sqrt(math.tau)
        return np.where(np.abs(light) < 2.0, core, tail)
