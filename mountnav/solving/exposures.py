"""Photographic plates with several exposures: each one's solution, from the sources that the others leave.

Observers moved the telescope a little between exposures on one plate: the same stars stand there twice or
oftener. An ordinary solve has one answer for a frame: of such a one the middle of its light, or none
(`mountnav.identification.double_exposure`). Here each exposure is asked for by itself.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.catalog.stars import Catalog
from mountnav.frames import Frame, Hint, StarList
from mountnav.identification.selection import star_like
from mountnav.measuring.measure import measure
from mountnav.reading import demosaiced
from mountnav.solution import Reason, Solution, Verdict
from mountnav.solving.settings import MOST_EXPOSURES, SolveSettings
from mountnav.solving.solve import merged_hint, solve_stars

SAME_OPTICS = 0.01
"""The scale of later exposures is that of the first within this share: only the direction changed."""

ROOM = 1.5
"""A later exposure's center is sought as far as so many diagonals from the first: parts of both are on the
plate. Chosen by hand."""

_TAIL = 0.5
"""Percent of a plate's pixels, at either end of their brightness, that stars are sought among; a scratch or a
step wedge takes up to some percent, stars a fifth to two. What it says is no more than which side is tried
first."""
_SAMPLED = 200_000
"""Pixels that it is told from."""
_LEAST_BUDGET_S = 0.05
"""Of a search that follows others, CPU s."""
_SCRATCH_PX = 5
"""Side of the square whose median a scratch of one or two pixels can't move. Doubled, stars twice as wide are
taken for scratches."""
_SCRATCH_SIGMA = 6.0
"""How far from that median a pixel stands that is on a scratch, in units of the grain. Chosen by hand."""
_PATCH_PX = 31
"""Side from which what is bright all over is no star but a wedge of known densities, a label or ink, px. The
stars drawn are up to 12 px wide. Doubled, smaller steps of a wedge stay; halved, the brightest stars go."""
_PATCH_SIGMA = 5.0
"""How far above the sky such a patch stands, in units of the sky's noise in those medians. Chosen by hand."""
_NORMAL = 1.4826
"""Standard deviation over median deviation of a normal distribution."""
_PATCH_RIM_PX = 8
"""Width of a patch's edge, which goes with it; chosen by hand."""


def solve_exposures(
    frame: Frame,
    catalog: Catalog,
    *,
    hint: Hint | None = None,
    settings: SolveSettings | None = None,
    most: int = MOST_EXPOSURES,
    tried: int = 0,
) -> tuple[Verdict, ...]:
    """Solve each exposure of a plate.

    Parameters
    ----------
    hint : Hint, optional
        Goes before what the frame's header says, field by field.
    most : int
        So many exposures are looked for.
    tried : int
        Hypotheses that were tried for the same plate before: the odds count them.

    Returns
    -------
    tuple of Verdict
        Solved ones, that with the most pairs first or nearly so; the last one tells why no further was found,
        unless `most` were. What was tried for one counts in the odds of the next. They rest on the places of
        sources alone: the note of a star list is theirs, too.
    """
    settings = settings or SolveSettings()
    frame = demosaiced(frame)
    found = measure(frame, settings=settings.measuring)
    left = star_like(found)
    believed = merged_hint(frame.hint, hint)
    verdicts: list[Verdict] = []
    began_s = time.thread_time()
    while len(verdicts) < most:
        stars = StarList(
            found.x_px[left],
            found.y_px[left],
            found.flux[left],
            frame.width_px,
            frame.height_px,
            source=frame.source,
        )
        verdict = solve_stars(
            stars,
            catalog,
            hint=believed,
            settings=replace(settings, budget_s=_left_s(settings.budget_s, began_s)),
            mid_exposure_utc=frame.mid_exposure_utc,
            tried=tried,
        )
        verdicts.append(verdict)
        solution = verdict.solution
        if solution is None:
            break
        tried = int(verdict.numbers.get("hypotheses", tried))
        pairs = solution.identified
        taken = set(zip(pairs.x_px.tolist(), pairs.y_px.tolist(), strict=True))
        places = zip(found.x_px[left].tolist(), found.y_px[left].tolist(), strict=True)
        left = left[np.array([place not in taken for place in places], dtype=bool)]
        if len(verdicts) == 1:
            believed = _same_optics(solution, frame)
            settings = replace(settings, blind="never")
    return tuple(verdicts)


def solve_plate(
    frame: Frame,
    catalog: Catalog,
    *,
    hint: Hint | None = None,
    settings: SolveSettings,
    tried: int = 0,
    read_s: float = 0.0,
) -> Verdict:
    """Solve a plate, dark stars on a light sky or the other way round.

    Parameters
    ----------
    settings : SolveSettings
        ``exposures`` of which are looked for.
    tried : int
        As in `solve_exposures`.
    read_s : float
        Wall time that was taken before.

    Returns
    -------
    Verdict
        On one exposure, with the others in ``further``; or the refusal.
    """
    began_s, computed_s = time.monotonic(), time.thread_time()
    frame = demosaiced(frame)
    refused: Verdict | None = None
    likelier = looks_negative(frame.pixels)
    for negative, mended in ((side, mended) for side in (likelier, not likelier) for mended in (False, True)):
        seen = replace(frame, pixels=_turned(frame.pixels), saturation_adu=None) if negative else frame
        if mended:
            seen = replace(seen, pixels=mended_plate(seen.pixels), saturation_adu=None)
        left = replace(settings, budget_s=_left_s(settings.budget_s, computed_s))
        verdicts = solve_exposures(
            seen, catalog, hint=hint, settings=left, most=settings.exposures, tried=tried
        )
        first, last = verdicts[0], verdicts[-1]
        tried = int(last.numbers.get("hypotheses", tried))
        if first.solved or refused is None:
            refused = first  # what the likelier side is refused for is told
        if first.solved:
            break
    assert refused is not None  # both sides were tried
    further = tuple(one.solution for one in verdicts[1:] if one.solution is not None) if first.solved else ()
    notes = refused.notes
    if first.solved:
        if negative:
            notes = (*notes, "a negative: dark stars on a light sky")
        if mended:
            notes = (*notes, "found after scratches, wedges and labels were taken off")
        if further:
            notes = (*notes, f"{1 + len(further)} exposures on one plate")
        if len(verdicts) == settings.exposures and last.solved:
            notes = (*notes, "there may be further exposures: no more were sought")
        elif last.reason is Reason.TIMED_OUT:
            notes = (*notes, "there may be further exposures: the time for the search ran out")
    total_s = time.monotonic() - began_s + read_s
    return replace(refused, further=further, notes=notes, times=replace(refused.times, total_s=total_s))


def looks_negative(pixels: NDArray[Any]) -> bool:
    """Whether what stands out of the sky is darker than it: by far more pixels, and by more."""
    flat = np.asarray(pixels).reshape(-1)
    sample = flat[:: max(1, flat.size // _SAMPLED)].astype(np.float64)
    sample = sample[np.isfinite(sample)]
    if not sample.size:
        return False
    low, middle, high = np.percentile(sample, (_TAIL, 50.0, 100.0 - _TAIL))
    return bool(middle - low > high - middle)


def mended_plate(pixels: NDArray[Any]) -> NDArray[np.float32]:
    """A positive plate without what is too narrow or too wide for a star.

    Scratches are a pixel or two wide and taken for the width of the stars; the steps of a wedge pile up at
    one level and are taken for full wells that bleed. Either way stars of 7 or 12 px count as no stars.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        Bright stars.

    Returns
    -------
    ndarray of float32, shape (height, width)
        Scratches are filled by the median beside them; wide patches are NaN. Stars that are hardly wider than
        a scratch lose their tops: seek those on the plate as it is.
    """
    plate = np.array(pixels, dtype=np.float32)
    sky = np.float32(np.nanmedian(plate))
    plate[~np.isfinite(plate)] = sky
    smooth = ndimage.median_filter(plate, _SCRATCH_PX)
    off = np.abs(plate - smooth)
    grain = _NORMAL * float(np.median(off))
    scratched = off > _SCRATCH_SIGMA * grain
    plate[scratched] = smooth[scratched]
    spread = _NORMAL * float(np.median(np.abs(smooth - sky)))
    wide = ndimage.grey_opening(smooth, size=(_PATCH_PX, _PATCH_PX)) > sky + _PATCH_SIGMA * spread
    if wide.any():
        wide = ndimage.binary_dilation(wide, iterations=_PATCH_RIM_PX)
        plate[wide] = np.nan
    return plate


def _turned(pixels: NDArray[Any]) -> NDArray[np.float32]:
    """The positive of a negative."""
    told = np.asarray(pixels, dtype=np.float32)
    return np.asarray(np.nanmax(told) - told, dtype=np.float32)


def _left_s(budget_s: float, began_s: float) -> float:
    """What is left of a budget of processor time; never nothing, so that a refusal has its reason."""
    return max(_LEAST_BUDGET_S, budget_s - (time.thread_time() - began_s))


def _same_optics(solution: Solution, frame: Frame) -> Hint:
    """What the first exposure tells of the others."""
    scale = solution.scale_arcsec_px
    diagonal_deg = float(np.hypot(frame.width_px, frame.height_px)) * scale / 3600.0
    return Hint(
        solution.center,
        ROOM * diagonal_deg,
        scale * (1.0 - SAME_OPTICS),
        scale * (1.0 + SAME_OPTICS),
        center_source="the first exposure",
        scale_source="the first exposure",
    )
