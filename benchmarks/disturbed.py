"""Spoil the rendered frames with trails, bleeds, cosmic rays, missing and false stars; print the errors.

Run: python -m benchmarks.disturbed [word in the file's name]

The disturbances are painted into the pixels, so that measuring has to cope with them as well.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.frames import shared_folder
from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame, Hint
from mountnav.reading import read_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Verdict
from mountnav.solving.solve import solve

SEED = 2246
PRESETS = "ABCE"
Pixels = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Scene:
    """A rendered frame and what it holds."""

    pixels: Pixels
    fwhm_px: float
    noise_adu: float
    full_adu: float
    stars_x: NDArray[np.float64]
    stars_y: NDArray[np.float64]
    peak_adu: NDArray[np.float64]
    catalog_stars: int


Spoil = Callable[[Scene, np.random.Generator], None]


def trail(scene: Scene, rng: np.random.Generator) -> None:
    """Draw two satellites across the frame, one bright and one faint, as wide as a star."""
    height, width = scene.pixels.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    for level in (60.0, 4.0):
        angle = rng.uniform(0, math.pi)
        off = rng.uniform(-0.3, 0.3) * min(width, height)
        across = (x - width / 2) * math.sin(angle) - (y - height / 2) * math.cos(angle) - off
        scene.pixels[...] += level * scene.noise_adu * np.exp(-0.5 * (across / (scene.fwhm_px / 2.355)) ** 2)


def bleed(scene: Scene, rng: np.random.Generator) -> None:
    """Let eight stars overflow along their columns."""
    height, width = scene.pixels.shape
    for _ in range(8):
        column, row = int(rng.integers(5, width - 5)), int(rng.integers(0, height))
        half = int(rng.integers(30, 400))
        rows = slice(max(0, row - half), min(height, row + half))
        scene.pixels[rows, column - 1 : column + 2] = scene.full_adu
        _add_star(scene, float(column), float(row), 3.0 * scene.full_adu)


def cosmic_rays(scene: Scene, rng: np.random.Generator) -> None:
    """Scatter 1,500 hits of one to six pixels, as bright as bright stars."""
    height, width = scene.pixels.shape
    for _ in range(1500):
        x, y, angle = rng.uniform(0, width), rng.uniform(0, height), rng.uniform(0, math.tau)
        strength = float(rng.choice(scene.peak_adu)) + 20 * scene.noise_adu
        for step in range(int(rng.integers(1, 7))):
            column, row = int(x + step * math.cos(angle)), int(y + step * math.sin(angle))
            if 0 <= column < width and 0 <= row < height:
                scene.pixels[row, column] += strength


def half_missing(scene: Scene, rng: np.random.Generator) -> None:
    """Paint sky over every second of the listed stars that aren't saturated."""
    reach = math.ceil(3.0 * scene.fwhm_px)
    height, width = scene.pixels.shape
    gone = (rng.random(scene.stars_x.size) < 0.5) & (scene.peak_adu < 0.7 * scene.full_adu)
    for x, y in zip(scene.stars_x[gone], scene.stars_y[gone], strict=True):
        row, column = round(y), round(x)
        top, left = max(0, row - reach), max(0, column - reach)
        box = scene.pixels[top : min(height, row + reach + 1), left : min(width, column + reach + 1)]
        if box.size == 0:
            continue
        edge = np.concatenate((box[0], box[-1], box[:, 0], box[:, -1]))
        box[...] = np.median(edge) + scene.noise_adu * rng.standard_normal(box.shape)


def three_times_false(scene: Scene, rng: np.random.Generator) -> None:
    """Add three false stars for each catalog star, as bright as the frame's own."""
    height, width = scene.pixels.shape
    bright = np.sort(scene.peak_adu)[::-1][: max(20, scene.catalog_stars)]
    for _ in range(3 * scene.catalog_stars):
        _add_star(scene, rng.uniform(0, width), rng.uniform(0, height), float(rng.choice(bright)))


def everything(scene: Scene, rng: np.random.Generator) -> None:
    """All of it in one frame."""
    for spoil in (half_missing, three_times_false, trail, bleed, cosmic_rays):
        spoil(scene, rng)


SPOILS: dict[str, Spoil] = {
    "trails": trail,
    "bleeds": bleed,
    "cosmic rays": cosmic_rays,
    "half of the stars missing": half_missing,
    "three times as many false stars": three_times_false,
    "all together": everything,
}


def _add_star(scene: Scene, x_px: float, y_px: float, peak_adu: float) -> None:
    sigma = scene.fwhm_px / 2.355
    reach = math.ceil(5 * sigma)
    height, width = scene.pixels.shape
    rows = np.arange(max(0, round(y_px) - reach), min(height, round(y_px) + reach + 1))
    columns = np.arange(max(0, round(x_px) - reach), min(width, round(x_px) + reach + 1))
    if rows.size == 0 or columns.size == 0:
        return
    bell = np.exp(-0.5 * ((rows - y_px) / sigma) ** 2)[:, None] * np.exp(
        -0.5 * ((columns - x_px) / sigma) ** 2
    )
    scene.pixels[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += (peak_adu * bell).astype(np.float32)


def scene_of(frame: Frame, truth: dict[str, object]) -> Scene:
    """Make a scene of a frame and its entry in truth.json."""
    pixels = frame.pixels.astype(np.float32)
    sky = float(np.median(pixels))
    below = pixels[::7, ::7]
    noise = sky - float(np.percentile(below, 15.8655))
    stars = np.array(truth["stars"], dtype=float)
    x, y = stars[:, 0], stars[:, 1]
    rows = np.clip(np.rint(y).astype(int), 0, pixels.shape[0] - 1)
    columns = np.clip(np.rint(x).astype(int), 0, pixels.shape[1] - 1)
    fwhm = truth["fwhm"]
    count = truth["ncat"]
    assert isinstance(fwhm, float)
    assert isinstance(count, int)
    return Scene(pixels, fwhm, noise, float(pixels.max()), x, y, pixels[rows, columns] - sky, count)


def spoiled(frame: Frame, truth: dict[str, object], spoil: Spoil, seed: int) -> Frame:
    """The frame with one kind of disturbance, as whole numbers of the same type."""
    scene = scene_of(frame, truth)
    spoil(scene, np.random.default_rng(seed))
    kind = frame.pixels.dtype
    top = min(scene.full_adu, float(np.iinfo(kind).max)) if kind.kind in "ui" else scene.full_adu
    return replace(frame, pixels=np.clip(np.rint(scene.pixels), 0, top).astype(kind))


def asked(truth: dict[str, object]) -> Hint:
    """The hint of truth.json: 1°, 5 %."""
    hint = truth["hint"]
    assert isinstance(hint, dict)
    return Hint(Icrs(hint["ra"], hint["dec"]), 1.0, hint["scale"] / 1.05, hint["scale"] * 1.05)


def error_px(verdict: Verdict, truth: dict[str, object]) -> float:
    """How far the solved center is from the truth, pixels; NaN if not solved."""
    if verdict.solution is None:
        return math.nan
    ra, dec, scale = truth["ra"], truth["dec"], truth["scale"]
    assert isinstance(ra, float)
    assert isinstance(dec, float)
    assert isinstance(scale, float)
    return separation_arcsec(verdict.solution.center, Icrs(ra, dec)) / scale


def main() -> None:
    word = sys.argv[1] if len(sys.argv) > 1 else ""
    folder: Path = shared_folder() / "data" / "rendered"
    print("| frame | disturbance | center error px | pairs | reason |\n|---|---|---|---|---|")
    for number, truth in enumerate(json.loads((folder / "truth.json").read_text())):
        name = truth["file"]
        if word not in name or name[0] not in PRESETS:
            continue
        frame = read_frame(folder / name)
        for place, (what, spoil) in enumerate(SPOILS.items()):
            verdict = solve(
                spoiled(frame, truth, spoil, SEED + 100 * number + place),
                embedded_catalog(),
                hint=asked(truth),
            )
            pairs, error = verdict.solution.pairs if verdict.solution else "", error_px(verdict, truth)
            print(
                f"| {name[:3]} | {what} | {error:.3f} | {pairs} | {verdict.reason or ''} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
