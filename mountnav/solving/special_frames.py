"""Frames that are made ordinary before they are solved: pixels not square, a sky cut off, a range of 0 to 1.

**Pixels that are not square** (1 × 2 binning, older sensors) bend every angle between stars. Along the axis
of the shorter side, brightness is shared out again over pixels as long as those of the other axis, which are
then square; the solution is carried back to the pixels of the file.

**A sky that is cut off**, as in pictures stretched to eight bits for the eye: what was noise is one level in
most pixels and a speck here and there, so that no noise can be estimated and each speck stands out like a
star. Smoothed by about a pixel, specks fade and stars stay.

**Brightness from 0 to 1**, as Siril and PixInsight keep it: taken for counts, a star's light would be less
than one electron, and its position as uncertain. It is measured in the 65535 steps of 16 bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.frames import Frame, Hint
from mountnav.reading.header_times import number
from mountnav.solution import Solution, Verdict

Array = NDArray[np.float64]
Cards = Mapping[str, str | int | float | bool]

SQUARE_WITHIN = 0.01
"""Sides that differ by less count as equal: the linear plate takes it up, and star patterns still match.
Doubled, patterns of stars are bent by more than they may be."""
MOST_OBLONG = 4.0
"""A greater ratio of sides is a mistake of the header: no camera bins more unevenly."""
CLIPPED_SHARE = 0.5
"""Of the pixels at the lowest level, from which on the sky counts as cut off. A sky with its noise has some
percent there. Chosen by hand; frames cut at 0 to 5 times the noise above the sky have 0.54 to 1.00."""
SMOOTHED_PX = 1.2
"""Sigma of the smoothing, pixels. Of 8-bit renderings of two frames, cut at 2 to 5 sigma, 1.0 and 1.5 solved
all, unsmoothed 4 of 8. Doubled, close stars run together."""
GRAIN_SHARE = 0.05
"""Noise that is added, as a share of the middle brightness above the lowest level: where nothing at all is
left, a noise must still be estimated. Doubled, the faintest stars are lost."""
SAMPLED_ROWS, SAMPLED_COLUMNS = 53, 7
"""Every so many rows and columns are looked at for the lowest level: 25,000 of 9 million pixels."""
LEAST_SAMPLE = 400
"""Fewer sampled pixels say nothing of the sky; chosen by hand."""

STEPS = 65535.0
"""Of brightness between 0 and 1: those of the 16 bits that most such frames come from. Doubled, errors of
positions are stated too small by a fifth where photons decide them."""

_BINNING = (("XBINNING", "YBINNING"), ("CCDXBIN", "CCDYBIN"), ("BINX", "BINY"), ("XBIN", "YBIN"))
_SIZES = (("XPIXSZ", "YPIXSZ"), ("PIXSIZE1", "PIXSIZE2"), ("XPIXELSZ", "YPIXELSZ"), ("XPIXSIZE", "YPIXSIZE"))
_OWN_OF_PIXELS = {key for pair in (*_BINNING, *_SIZES) for key in pair}


@dataclass(frozen=True, slots=True)
class SpecialFrame:
    """A frame made ordinary.

    Attributes
    ----------
    widened : callable
        A hint for the frame as it was, made into one for this.
    back : callable
        The verdict on this frame, made into one on the frame as it was.
    sure : bool
        What isn't solved so, isn't as it was either.
    """

    frame: Frame
    widened: Callable[[Hint], Hint]
    back: Callable[[Verdict], Verdict]
    sure: bool = False


def special_frame(frame: Frame) -> SpecialFrame | None:
    """Make a frame ordinary; None if it is.

    Parameters
    ----------
    frame : Frame
        Calibrated and without a mosaic.
    """
    if _from_0_to_1(frame.pixels):
        return _in_steps(frame)
    ratio = pixel_ratio(frame.header)
    if abs(math.log(ratio)) > SQUARE_WITHIN:
        return _squared(frame, ratio)
    share = clipped_share(frame.pixels)
    return _smoothed(frame, share) if share >= CLIPPED_SHARE else None


def pixel_ratio(header: Cards) -> float:
    """Height of a pixel over its width by a header; 1 where it says nothing, or what no camera has.

    Sizes go before binning: where they differ, they are those of binned pixels, or of a sensor whose own
    pixels aren't square.
    """
    for pairs in (_SIZES, _BINNING):
        for across, along in pairs:
            width, height = number(header.get(across)), number(header.get(along))
            if width is None or height is None or width <= 0.0 or height <= 0.0:
                continue
            ratio = height / width
            if not 1.0 / MOST_OBLONG <= ratio <= MOST_OBLONG:
                return 1.0
            if abs(math.log(ratio)) > SQUARE_WITHIN:
                return ratio
            break
    return 1.0


def clipped_share(pixels: NDArray[np.generic]) -> float:
    """Share of a frame's pixels that are at its lowest level, by a sample; 0 where all are."""
    sample = pixels[::SAMPLED_ROWS, ::SAMPLED_COLUMNS]
    if sample.size < LEAST_SAMPLE:
        return 0.0
    lowest = sample.min()  # NaN where there is one, which equals nothing
    at_lowest = int(np.count_nonzero(sample == lowest))
    return 0.0 if at_lowest == sample.size else at_lowest / sample.size


# -- pixels that are not square ------------------------------------------------------------------------------


def _squared(frame: Frame, ratio: float) -> SpecialFrame:
    """Merge columns where pixels are higher than wide, else rows."""
    axis = 1 if ratio > 1.0 else 0
    length = frame.pixels.shape[axis]
    count = max(1, round(length / max(ratio, 1.0 / ratio)))
    merged = length / count  # of old pixels make a new one: exactly so many that both centers are one point
    header = {key: value for key, value in frame.header.items() if key not in _OWN_OF_PIXELS}
    squared = replace(
        frame,
        pixels=_merged(frame.pixels, axis, count),
        header=header,
        hint=_widened(frame.hint, merged),
        notes=(),
    )
    what = "columns" if axis else "rows"
    note = (
        f"its pixels are {ratio:.4g} times as high as wide: measured with {merged:.4g} {what} merged into one"
    )

    def back(verdict: Verdict) -> Verdict:
        solution = verdict.solution
        seen = verdict.seen_px.copy()
        seen[:, 1 - axis] = (seen[:, 1 - axis] + 0.5) * merged - 0.5
        return replace(
            verdict,
            solution=None if solution is None else _on_old_pixels(solution, axis, merged, frame),
            seen_px=seen,
            notes=(*verdict.notes, note),
        )

    return SpecialFrame(squared, lambda hint: _widened(hint, merged), back)


def _widened(hint: Hint, merged: float) -> Hint:
    """A scale may be meant along either side of a pixel."""
    high = hint.scale_high_arcsec_px
    return replace(
        hint,
        scale_high_arcsec_px=None if high is None else high * merged,
        alternatives=tuple(_widened(other, merged) for other in hint.alternatives),
    )


def _merged(pixels: NDArray[np.generic], axis: int, count: int) -> NDArray[np.float32]:
    """Means over equal parts of an axis, which needn't end between two pixels; NaN counts for nothing."""
    lines = np.asarray(pixels if axis else pixels.T, dtype=np.float64)
    known = np.isfinite(lines)
    sums = _shared_out(np.where(known, lines, 0.0), count)
    if known.all():
        means = sums * (count / lines.shape[1])
    else:
        weights = _shared_out(known.astype(np.float64), count)
        with np.errstate(invalid="ignore", divide="ignore"):
            means = np.where(weights > 1e-9, sums / weights, np.nan)
    return np.ascontiguousarray(means if axis else means.T, dtype=np.float32)


def _shared_out(lines: Array, count: int) -> Array:
    """Sums over `count` equal parts of each line."""
    length = lines.shape[1]
    edges = np.linspace(0.0, length, count + 1)
    whole = np.minimum(edges.astype(np.int64), length)
    before = np.zeros((lines.shape[0], length + 1))
    np.cumsum(lines, axis=1, out=before[:, 1:])
    part = edges - whole
    up_to = before[:, whole] + part * lines[:, np.minimum(whole, length - 1)]
    return np.asarray(np.diff(up_to, axis=1))


def _on_old_pixels(solution: Solution, axis: int, merged: float, frame: Frame) -> Solution:
    """A solution of the squared frame, for the pixels of the file: x is `merged` times as long, or y."""
    cards: dict[str, str | int | float] = {}
    for key, value in solution.wcs.items():
        cards[key] = _old_card(key, value, axis, merged) if isinstance(value, float) else value
    cards |= {"IMAGEW": frame.width_px, "IMAGEH": frame.height_px}
    pairs = solution.identified
    name = "x_px" if axis else "y_px"
    moved = (getattr(pairs, name) + 0.5) * merged - 0.5
    return replace(
        solution,
        wcs=cards,
        scale_arcsec_px=solution.scale_arcsec_px / math.sqrt(merged),
        identified=replace(pairs, x_px=moved) if axis else replace(pairs, y_px=moved),
    )


def _old_card(key: str, value: float, axis: int, merged: float) -> float:
    """One card. With u = m·u' and CD·(u + A(u, v), ...) = CD'·(u' + A'(u', v), ...), A = m·A' for x."""
    column = 1 if axis else 2
    if key == f"CRPIX{column}":
        return (value - 0.5) * merged + 0.5
    if key in (f"CD1_{column}", f"CD2_{column}"):
        return value / merged
    name, *powers = key.split("_")
    if name in ("A", "B", "AP", "BP") and len(powers) == 2:
        own = name[0] == ("A" if axis else "B")
        return value * merged ** ((1 if own else 0) - int(powers[1 - axis]))
    return value


# -- brightness from 0 to 1 ----------------------------------------------------------------------------------


def _from_0_to_1(pixels: NDArray[np.generic]) -> bool:
    """Whether a frame's brightness is a share of what is brightest; of most, a sample tells that it isn't."""
    if pixels.dtype.kind != "f":
        return False
    values: Any = pixels
    few = values[::SAMPLED_ROWS, ::SAMPLED_COLUMNS]
    with np.errstate(invalid="ignore"):
        if not few.size or (few > 1.0).any():
            return False
        return bool((values > 0.0).any() and not (values > 1.0).any())


def _in_steps(frame: Frame) -> SpecialFrame:
    full = frame.saturation_adu
    scaled = replace(
        frame,
        pixels=np.multiply(frame.pixels.astype(np.float32), np.float32(STEPS)),
        saturation_adu=None if full is None else full * STEPS,
        notes=(),
    )

    def back(verdict: Verdict) -> Verdict:
        quality, solution = verdict.quality, verdict.solution
        if quality is not None:
            faintest, zero = quality.limiting_flux_adu, quality.zero_point_mag
            quality = replace(
                quality,
                sky_adu=quality.sky_adu / STEPS,
                noise_adu=quality.noise_adu / STEPS,
                limiting_flux_adu=None if faintest is None else faintest / STEPS,
                zero_point_mag=None if zero is None else zero - 2.5 * math.log10(STEPS),
            )
        if solution is not None:
            pairs = solution.identified
            fluxes = replace(pairs, flux=pairs.flux / STEPS, flux_sigma=pairs.flux_sigma / STEPS)
            solution = replace(solution, identified=fluxes)
        return replace(verdict, quality=quality, solution=solution)

    return SpecialFrame(scaled, lambda hint: hint, back, sure=True)


# -- a sky that is cut off -----------------------------------------------------------------------------------


def _smoothed(frame: Frame, share: float) -> SpecialFrame:
    from scipy.ndimage import gaussian_filter

    pixels = np.asarray(frame.pixels, dtype=np.float32)
    lowest = float(np.nanmin(pixels))
    even = gaussian_filter(np.nan_to_num(pixels, nan=lowest), SMOOTHED_PX)
    sample = pixels[::SAMPLED_ROWS, ::SAMPLED_COLUMNS]
    above = sample[sample > lowest] - lowest
    # the same frame gives the same answer
    grain = np.random.default_rng(0).standard_normal(even.shape, dtype=np.float32)
    even += np.float32(GRAIN_SHARE * float(np.median(above))) * grain
    note = f"its sky is cut off, {100.0 * share:.0f} % of it at one level: smoothed before it was measured"

    def back(verdict: Verdict) -> Verdict:
        return replace(verdict, notes=(*verdict.notes, note))

    return SpecialFrame(replace(frame, pixels=even, notes=()), lambda hint: hint, back)
