"""A second exposure too faint to be seen star by star: its light, summed at one offset from the known stars.

Where few stars were identified a second exposure with a sixth of the light shows in one or two patches that
no star explains: the images of the others are drawn out below the noise, or lie beyond the frame's edge. Each
bright star and each such patch propose an offset and a share of light. The frame is then measured at that
offset from all other stars (forced photometry): what is a second exposure has that share of their light there
too, and what is a galaxy, a planet or a variable star doesn't. What other offsets bring tells how much of it
is chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.identification.double_exposure import UnexplainedLight
from mountnav.measuring.background import Image
from mountnav.measuring.medians import median
from mountnav.measuring.segmentation import LightSegments
from mountnav.measuring.star_trail import FAR_BIN_PX, REACH_PX

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STARS_MEASURED = 12
"""Brightest known stars at whose offsets the frame is measured. Doubled, fainter ones add noise and time."""
PROPOSERS, PROPOSED = 6, 12
"""Of so many stars and so many unexplained patches, the brightest, each pair proposes an offset. Doubled,
four times as many pairs cost time, and chance agrees as much more often."""
LEAST_SHARE, GREATEST_SHARE = 0.03, 0.6
"""A second exposure has a share of the first one's light within these: less pulls the middle nowhere, more is
seen star by star (`second_image`). Chosen by hand."""
APERTURE_BINS = 9
"""Side of the square, in bins of 4 px, in which light is summed: a second exposure may be drawn out by 30 px,
and its offset is known to a third of that. Doubled, noise and neighbors count twice as much."""
OVERLAP_PX = 1.5 * APERTURE_BINS * FAR_BIN_PX
"""Squares whose middles are nearer to each other than this share light: a diagonal and a little."""
COVERED = 0.7
"""A square of which known stars' light covers more than the rest of this isn't measured."""
CUT_SIGMA = 40.0
"""Bins count no more than this, in sigmas of the sky, so that no bright neighbor decides."""
TAME_SHARE, TAME_SIGMA = 2.0, 3.0
"""Nor does one star's place count for more than so many times its expected light, and so many sigmas."""
OTHER_OFFSETS, NEAREST_PX = 400, 40.0
"""So many offsets drawn about the stars, none nearer than this, tell what chance brings. With half as many a
share of 1/200 of chance passes for none."""
SIGNIFICANT = 5.0
"""The sum must be above that of the other offsets by so many of their scatter (median absolute deviation),
and above each of them. The drawn frame that was overlooked reaches 6.6 (`benchmarks.trailed`, seed 75741)."""
SHARE_AGREES = 1.7
"""The share of light at the other stars' places agrees with that of the patch within this factor: the drawn
frame 1.2, what chance brings above 5 sigmas 1.7 to 20."""
FEWEST_MEASURED = 4
"""Fewer other stars than this, whose places at the offset lie in the frame, say nothing."""


@dataclass(frozen=True, slots=True)
class FaintExposure:
    """A second exposure by the sum of its light.

    Attributes
    ----------
    offset_px : complex
        From the known stars to it.
    share : float
        Of its light to that of the first.
    stars : int
        Whose places were measured.
    sigmas : float
        Of the sum, in the scatter of what other offsets bring.
    """

    offset_px: complex
    share: float
    stars: int
    sigmas: float

    @property
    def pull_px(self) -> float:
        """How far the middle of both lies from the first."""
        return abs(self.offset_px) * self.share / (1.0 + self.share)


def faint_exposure(
    bins: tuple[Image, Image],
    patches: LightSegments,
    x_px: Array,
    y_px: Array,
    left: UnexplainedLight,
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
    x_px, y_px : ndarray, shape (n,)
        Where the plate has all the stars that it knows of.
    left : UnexplainedLight
        What they leave of the patches.

    Returns
    -------
    FaintExposure or None
        The most significant one; None where chance would bring as much.
    """
    if left.known.size <= FEWEST_MEASURED or left.x_px.size == 0:
        return None
    stars = left.known[:STARS_MEASURED]
    sums = _Sums.of(bins, patches, x_px, y_px)
    there = patches.x_px[stars] + 1j * patches.y_px[stars]
    light = sums.whole_at(there)
    places = left.x_px[:PROPOSED] + 1j * left.y_px[:PROPOSED]
    patch_light = sums.whole_at(places)
    found: FaintExposure | None = None
    for i in range(min(PROPOSERS, stars.size)):
        if light[i] <= 0.0:
            continue
        for j in range(places.size):
            offset, share = complex(places[j] - there[i]), float(patch_light[j] / light[i])
            if not LEAST_SHARE < share < GREATEST_SHARE or abs(offset) > REACH_PX:
                continue
            if abs(offset) * share / (1.0 + share) < least_pull_px:
                continue
            others = np.arange(stars.size) != i
            one = _measured(sums, there[others], light[others], complex(places[j]), offset, share)
            if one is not None and (found is None or one.sigmas > found.sigmas):
                found = one
    return found


@dataclass(frozen=True, slots=True)
class _Sums:
    """Light summed over squares about each bin, with and without that of the known stars."""

    whole: Image
    others: Image
    covered: Image
    noise: float

    @classmethod
    def of(cls, bins: tuple[Image, Image], patches: LightSegments, x_px: Array, y_px: Array) -> _Sums:
        level, cover = bins
        known = np.zeros(int(patches.labels.max(initial=0)) + 1, dtype=bool)
        at = patches.at(x_px, y_px)
        known[at[at >= 0] + 1] = True
        mask = known[patches.labels]
        finer = FAR_BIN_PX // patches.bin_px
        rows, columns = level.shape
        mask = mask[: rows * finer, : columns * finer]
        mask = np.pad(mask, ((0, rows * finer - mask.shape[0]), (0, columns * finer - mask.shape[1])))
        mask = np.asarray(mask.reshape(rows, finer, columns, finer).any(axis=(1, 3)))
        good = (~ndimage.binary_dilation(mask) & (cover > 0)).astype(np.float32)
        area = float(APERTURE_BINS**2)

        def summed(image: Image) -> Image:
            return np.asarray(ndimage.uniform_filter(image, APERTURE_BINS, mode="constant") * area)

        others, covered = summed(np.clip(level, -TAME_SIGMA, CUT_SIGMA) * good), summed(good) / area
        clear = others[covered > COVERED]
        spread = median(np.abs(clear - median(clear))) if clear.size else math.inf
        return cls(summed(level), others, covered, 1.4826 * spread)

    def _bins_at(self, places: NDArray[np.complex128]) -> tuple[Index, Index]:
        middle = 0.5 * (FAR_BIN_PX - 1)
        column = np.rint((places.real - middle) / FAR_BIN_PX).astype(np.int64)
        row = np.rint((places.imag - middle) / FAR_BIN_PX).astype(np.int64)
        return row, column

    def whole_at(self, places: NDArray[np.complex128]) -> Array:
        """All the light about places in the frame."""
        row, column = self._bins_at(places)
        rows, columns = self.whole.shape
        at = self.whole[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
        return np.asarray(at, dtype=np.float64)

    def others_at(self, places: NDArray[np.complex128]) -> tuple[Array, NDArray[np.bool_]]:
        """What isn't the known stars' light about places, and where that can be measured."""
        row, column = self._bins_at(places)
        rows, columns = self.others.shape
        half = APERTURE_BINS // 2
        inside = (row >= half) & (column >= half) & (row < rows - half) & (column < columns - half)
        row, column = np.where(inside, row, 0), np.where(inside, column, 0)
        inside &= self.covered[row, column] > COVERED
        return np.where(inside, self.others[row, column], 0.0).astype(np.float64), inside


def _measured(
    sums: _Sums,
    there: NDArray[np.complex128],
    light: Array,
    proposer: complex,
    offset: complex,
    share: float,
) -> FaintExposure | None:
    """Weighted sum of the light at an offset from the stars, against that at other offsets.

    The patch that has proposed it, at `proposer`, counts nowhere.
    """
    rng = np.random.default_rng(0)
    radius = np.sqrt(rng.uniform(NEAREST_PX**2, float(REACH_PX) ** 2, OTHER_OFFSETS))
    elsewhere = radius * np.exp(1j * rng.uniform(0.0, math.tau, OTHER_OFFSETS))
    # a square that overlaps with that of the offset itself holds a part of the same light
    elsewhere = elsewhere[np.abs(elsewhere - offset) > OVERLAP_PX]
    offsets = np.append(offset, elsewhere)
    at = there[None, :] + offsets[:, None]
    values, inside = sums.others_at(at)
    inside &= np.abs(at - proposer) > OVERLAP_PX
    weight = np.where(inside, light[None, :], 0.0)
    values = np.minimum(values, TAME_SHARE * share * light[None, :] + TAME_SIGMA * sums.noise)
    square = (weight**2).sum(axis=1)
    measured = inside.sum(axis=1) >= FEWEST_MEASURED
    if not measured[0] or square[0] <= 0.0:
        return None
    score = (values * weight).sum(axis=1) / np.sqrt(np.maximum(square, 1e-300))
    chance = score[1:][measured[1:]]
    if chance.size < OTHER_OFFSETS // 4:
        return None
    middle = median(chance)
    scatter = 1.4826 * median(np.abs(chance - middle))
    seen = float((values[0] * weight[0]).sum() / square[0])
    if scatter <= 0.0 or not share / SHARE_AGREES < seen < share * SHARE_AGREES:
        return None
    sigmas = (float(score[0]) - middle) / scatter
    if sigmas < SIGNIFICANT or score[0] <= chance.max():
        return None
    return FaintExposure(offset, seen, int(inside[0].sum()), sigmas)
