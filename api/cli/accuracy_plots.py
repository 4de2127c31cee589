"""Pictures of an accuracy run: histograms as [S23 Fig. 6], and the residual vectors over the frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mountnav.identification.accuracy import Deviations, deviations, pooled
from mountnav.solution import Solution

Array = NDArray[np.float64]

MOST_ARROWS = 400
"""Above this the map shows the mean vector of each cell. chosen by eye: more arrows hide each other."""
CELLS = 14
"""Cells along the longer side of that map. chosen by eye: about as many arrows as without cells; twice as
many hold too few measurements for a mean."""
FEWEST_IN_CELL = 3
"""Measurements of a cell that is drawn: the mean of fewer shows their noise and not the camera."""
REACH_SIGMA = 4.5
"""Half width of a histogram in standard deviations of its middle half. chosen by eye: a Gaussian's tails are
seen to their end, and outliers don't press all others into one bar."""
IQR_SIGMA = 1.349
"""Distance of the quartiles of a Gaussian, in its standard deviations."""
SCALE_ARROW_SHARE = 0.1
"""Length of the arrow that shows the scale, of the frame's longer side. chosen by eye."""
_BAR, _CURVE, _ARROW = "#4c78a8", "#d1495b", "#22577a"


def write_plots(
    solutions: Sequence[Solution],
    folder: Path,
    *,
    every: bool = False,
    leave_one_out: bool = False,
    catalog_sigma_arcsec: float = math.inf,
) -> list[Path]:
    """Write `histograms.png`, and a `residuals-WxH.png` for each size of frame.

    Parameters
    ----------
    solutions : sequence of Solution
        At least one.
    folder : Path
        Exists.
    catalog_sigma_arcsec : float
        See `mountnav.identification.accuracy.deviations`.

    Returns
    -------
    list of Path
        What was written.
    """
    by_size: dict[tuple[int, int], list[Deviations]] = {}
    for solution in solutions:
        size = (int(solution.wcs["IMAGEW"]), int(solution.wcs["IMAGEH"]))
        found = deviations(
            solution,
            every=every,
            leave_one_out=leave_one_out,
            catalog_sigma_arcsec=catalog_sigma_arcsec,
        )
        by_size.setdefault(size, []).append(found)
    parts = [part for group in by_size.values() for part in group]
    written = [folder / "histograms.png"]
    _save(histograms(pooled(parts), frames=len(parts)), written[0])
    for (width, height), group in by_size.items():
        written.append(folder / f"residuals-{width}x{height}.png")
        _save(residual_map(pooled(group), width, height, frames=len(group)), written[-1])
    return written


def histograms(found: Deviations, *, frames: int) -> Figure:
    """Histograms of ΔRA cos δ, ΔDec and Δmag, the last left out where there is none.

    Parameters
    ----------
    frames : int
        From how many frames, for the title.
    """
    panels: list[tuple[str, str, Array]] = [
        ("ΔRA cos δ", "″", found.ra_arcsec),
        ("ΔDec", "″", found.dec_arcsec),
    ]
    mag = found.mag[np.isfinite(found.mag)]
    if mag.size:
        panels.append(("Δmag", " mag", mag))
    figure = Figure(figsize=(4.4 * len(panels), 3.6), layout="constrained")
    figure.suptitle(
        f"Measured minus catalog: {len(found)} measurements in {_frames(frames)} "
        "(curve: Gaussian of the same mean and standard deviation)",
        fontsize=10,
    )
    for number, (label, unit, values) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), number + 1)
        _histogram(axes, label, unit, values)
        if number == 0:
            axes.set_ylabel("measurements")
    return figure


def _histogram(axes: Axes, label: str, unit: str, values: Array) -> None:
    mean, deviation = float(values.mean()), float(values.std(ddof=1)) if values.size > 1 else 0.0
    # the middle half of the values sets the scale: a few outliers shall not press all into one bar
    low, middle, high = np.percentile(values, [25.0, 50.0, 75.0])
    reach = REACH_SIGMA * max((high - low) / IQR_SIGMA, 1e-6)
    bins = int(np.clip(2.0 * math.sqrt(values.size), 9, 61))
    edges = np.linspace(middle - reach, middle + reach, bins + 1)
    axes.hist(values, bins=edges.tolist(), color=_BAR, edgecolor="white", linewidth=0.4)
    if deviation > 0.0:
        x = np.linspace(edges[0], edges[-1], 200)
        gaussian = np.exp(-0.5 * ((x - mean) / deviation) ** 2) / (deviation * math.sqrt(math.tau))
        axes.plot(x, gaussian * values.size * (edges[1] - edges[0]), color=_CURVE, linewidth=1.2)
    outside = int(np.sum((values < edges[0]) | (values > edges[-1])))
    text = f"mean {mean:+.4f}{unit}\nst. dev. {deviation:.3f}{unit}"
    if outside:
        text += f"\n{outside} outside"
    axes.text(0.97, 0.96, text, transform=axes.transAxes, ha="right", va="top", fontsize=8.5)
    axes.set_ylim(top=axes.get_ylim()[1] * 1.18)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    axes.set_xlabel(f"{label} ({unit.strip()})")
    axes.spines[["top", "right"]].set_visible(False)


def residual_map(found: Deviations, width_px: int, height_px: int, *, frames: int) -> Figure:
    """Draw the deviations as arrows over the frame; of many measurements the mean in each cell.

    Arrows point along the frame's axes, not north and east, so that what the camera does adds up over frames
    that are turned differently.

    Parameters
    ----------
    width_px, height_px : int
        Size of the frame.
    frames : int
        From how many frames.
    """
    each = len(found) <= MOST_ARROWS
    x, y, right, up = (
        (found.x_px, found.y_px, found.along_x_arcsec, found.along_y_arcsec)
        if each
        else _cell_means(found, width_px, height_px)
    )
    longer = max(width_px, height_px)
    figure = Figure(
        figsize=(1.3 + 6.2 * width_px / longer, 1.5 + 6.2 * height_px / longer), layout="constrained"
    )
    axes = figure.add_subplot()
    length = np.hypot(right, up)
    shown = _round_length(float(np.median(length)) * 2.0 if length.size else 1.0)
    arrows = axes.quiver(
        x,
        y,
        right,
        up,
        angles="uv",
        scale=shown / (SCALE_ARROW_SHARE * longer),
        scale_units="x",
        units="width",
        width=0.0028,
        color=_ARROW,
    )
    axes.plot(x, y, ".", color=_ARROW, markersize=2.5)
    axes.quiverkey(arrows, 0.86, 1.03, shown, f"{shown:g}″", labelpos="E", coordinates="axes")
    what = "each measurement" if each else f"mean of each cell, {len(found)} measurements"
    axes.set_title(f"Deviations, {what}, {_frames(frames)}", fontsize=10, loc="left")
    axes.set_xlim(-0.5, width_px - 0.5)
    axes.set_ylim(-0.5, height_px - 0.5)
    axes.set_aspect("equal")
    axes.set_xlabel("x (px)")
    axes.set_ylabel("y (px)")
    return figure


def _cell_means(found: Deviations, width_px: int, height_px: int) -> tuple[Array, Array, Array, Array]:
    """Middle and mean deviation of each cell that holds enough measurements."""
    side = max(width_px, height_px) / CELLS
    columns = math.ceil(width_px / side)
    column = np.clip(found.x_px // side, 0, columns - 1).astype(np.intp)
    row = np.maximum(found.y_px // side, 0).astype(np.intp)
    cell = row * columns + column
    number = np.bincount(cell).astype(np.float64)
    full = number >= FEWEST_IN_CELL

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(cell, weights=values)[full] / number[full])

    return mean(found.x_px), mean(found.y_px), mean(found.along_x_arcsec), mean(found.along_y_arcsec)


def _round_length(length: float) -> float:
    """1, 2 or 5 times a power of ten, not below `length`."""
    power = 10.0 ** math.floor(math.log10(max(length, 1e-6)))
    return next(
        float(f"{step * power:.3g}") for step in (1.0, 2.0, 5.0, 10.0) if step * power >= length * 0.999
    )


def _frames(number: int) -> str:
    return "1 frame" if number == 1 else f"{number} frames"


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    # without the library's name and version the same run gives the same file
    figure.savefig(path, dpi=110, metadata={"Software": None})
