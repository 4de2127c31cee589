"""Print how near the centroids come to the Cramér-Rao bound, per rendered frame and magnitude.

Run: python -m benchmarks.centroids [A01 A02 ...]

The bound: inverse Fisher information of (flux, x, y, background) of the true profile, integrated over the
pixels at the star's own place in them, with sky, read and own photon noise [S23 §0.2]. The error is radial,
sqrt(Δx² + Δy²), since the image's x and y are equal here; an efficient estimator of two Gaussian errors of
σ each has a median radial error of 1.1774 σ. Two ratios are printed: *ratio* = median error over the median
a perfect estimator would have, and *strict* = median radial error over the bare σ of one coordinate.
*pull* is the standard deviation of error / stated sigma (from the 16th and 84th percentile), 1 if honest.

Magnitudes: the truth's 100 test pixels give a cubic from the tangent plane to pixels; embedded catalog stars
thrown through it and found within 1 px of a listed star give the zero point, the median of
V + 2.5 log10(electrons); the frames were rendered with 0.2 mag of scatter. Truth electrons are those before
vignetting; the share that arrives is a quadratic in the distance from the center, fitted to the fluxes.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from benchmarks.frames import shared_folder
from mountnav.catalog.embedded import embedded_catalog
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.reading import read_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic

Array = NDArray[np.float64]

GAIN_E_ADU = 1.5  # of every rendered frame: slope of variance over level in their background meshes
BIAS_ADU = 500.0
MEDIAN_RADIAL = float(np.sqrt(2.0 * np.log(2.0)))
FINE = 9
HALF_PX = 14
ISOLATED_PX = 12.0


def pixel_profile(fwhm_px: float, beta: float, x: float, y: float) -> Array:
    """A star of one electron, integrated over the pixels of a stamp by FINE × FINE samples."""
    fine = (np.arange(FINE) + 0.5) / FINE - 0.5
    steps = (np.arange(-HALF_PX, HALF_PX + 1)[:, None] + fine).ravel()
    r2 = (steps[None, :] - x) ** 2 + (steps[:, None] - y) ** 2
    if beta == 0.0:
        sigma2 = fwhm_px**2 / (8.0 * np.log(2.0))
        bell = np.exp(-0.5 * r2 / sigma2) / (2.0 * np.pi * sigma2)
    else:
        alpha2 = 0.25 * fwhm_px**2 / (2.0 ** (1.0 / beta) - 1.0)
        bell = (beta - 1.0) / (np.pi * alpha2) * (1.0 + r2 / alpha2) ** -beta
    side = 2 * HALF_PX + 1
    return np.asarray(bell.reshape(side, FINE, side, FINE).mean(axis=(1, 3)))


def bound_px(fwhm_px: float, beta: float, x: float, y: float, electrons: float, variance_e2: float) -> float:
    """Cramér-Rao bound of one coordinate (root mean square of both), pixels."""
    step = 1e-3

    def at(dx: float, dy: float) -> Array:
        return electrons * pixel_profile(fwhm_px, beta, x + dx, y + dy).ravel()

    model = at(0.0, 0.0)
    slopes = np.stack(
        [
            model / electrons,
            (at(step, 0.0) - at(-step, 0.0)) / (2.0 * step),
            (at(0.0, step) - at(0.0, -step)) / (2.0 * step),
            np.ones_like(model),
        ]
    )
    covariance = np.linalg.inv((slopes / (variance_e2 + model)) @ slopes.T)
    return float(np.sqrt(0.5 * (covariance[1, 1] + covariance[2, 2])))


def zero_point(truth: dict[str, Any]) -> float:
    """Magnitude of a star of one electron, by the catalog and the truth's own test pixels."""
    center = Icrs(truth["ra"], truth["dec"])
    test = {name: np.array(values) for name, values in truth["test"].items()}

    def terms(ra: Array, dec: Array) -> Array:
        xi, eta = (1e2 * np.asarray(c) for c in gnomonic(ra, dec, center.ra_deg, center.dec_deg))
        return np.stack([xi**i * eta**j for i in range(4) for j in range(4 - i)], axis=1)

    to_pixels, *_ = np.linalg.lstsq(terms(test["ra"], test["dec"]), np.c_[test["x"], test["y"]], rcond=None)
    radius = 0.75 * max(truth["w"], truth["h"]) * truth["scale"] / 3600.0
    stars = embedded_catalog().cone(center, radius, epoch_yr=2000.0)
    listed = np.array(truth["stars"])
    distance, index = KDTree(listed[:, :2]).query(terms(stars.ra_deg, stars.dec_deg) @ to_pixels)
    near = distance < 1.0
    return float(np.median(stars.mag[near] + 2.5 * np.log10(listed[index[near], 2])))


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of the isolated unsaturated listed stars of a frame; each array has shape (n,)."""

    mag: Array
    electrons: Array
    radial_px: Array
    pull: Array
    bound_px: Array


def errors_of(truth: dict[str, Any], found: Measurements) -> Errors:
    """Match the listed stars, and take those that stand alone: no other source within 12 px above 1 %."""
    listed = np.array(truth["stars"])
    tree = KDTree(np.c_[found.x_px, found.y_px])
    distance, index = tree.query(listed[:, :2])
    spoilt = int(Flag.SATURATED | Flag.EDGE)
    use = (distance < 2.0) & ((found.flags[index] & spoilt) == 0)
    for k in np.flatnonzero(use):
        near = [i for i in tree.query_ball_point(listed[k, :2], ISOLATED_PX) if i != index[k]]
        use[k] = not (found.flux[near] > 0.01 * found.flux[index[k]]).any()
    listed, index = listed[use], index[use]
    r2 = (listed[:, 0] - 0.5 * truth["w"]) ** 2 + (listed[:, 1] - 0.5 * truth["h"]) ** 2
    ratio = found.flux[index] / listed[:, 2]
    slope, level = np.polyfit(r2, ratio, 1)
    for _ in range(3):
        good = np.abs(ratio - slope * r2 - level) < 0.05 * level
        slope, level = np.polyfit(r2[good], ratio[good], 1)
    arriving = listed[:, 2] * (1.0 + slope / level * r2)
    sky = truth["sky"] * (1.0 + slope / level * r2)
    dx, dy = found.x_px[index] - listed[:, 0], found.y_px[index] - listed[:, 1]
    bounds = [
        bound_px(truth["fwhm"], truth["beta"], x - round(x), y - round(y), e, s + truth["rn"] ** 2)
        for (x, y, _), e, s in zip(listed, arriving, sky, strict=True)
    ]
    return Errors(
        mag=zero_point(truth) - 2.5 * np.log10(listed[:, 2]),
        electrons=arriving,
        radial_px=np.hypot(dx, dy),
        pull=np.stack([dx / found.x_sigma_px[index], dy / found.y_sigma_px[index]]),
        bound_px=np.array(bounds),
    )


def rows(name: str, e: Errors) -> list[str]:
    """Lines of the table: a bin for each magnitude, and all together."""
    lines = []
    lowest, highest = int(np.floor(e.mag.min() + 0.5)), int(np.ceil(e.mag.max() - 0.5))
    bins = [(f"V = {m}", np.abs(e.mag - m) <= 0.5) for m in range(lowest, highest + 1)]
    for title, some in [*bins, ("all", np.ones(e.mag.size, dtype=bool))]:
        if some.sum() < 3:
            continue
        error, bound = float(np.median(e.radial_px[some])), float(np.median(e.bound_px[some]))
        ratio = float(np.median(e.radial_px[some] / e.bound_px[some]))
        low, high = np.percentile(e.pull[:, some], [15.8655, 84.1345])
        lines.append(
            f"| {name} | {title} | {np.median(e.electrons[some]):.0f} | {some.sum()} | {error:.4f} "
            f"| {bound:.4f} | {ratio / MEDIAN_RADIAL:.2f} | {ratio:.2f} | {0.5 * (high - low):.2f} |"
        )
    return lines


def main() -> None:
    names = sys.argv[1:] or ["A01", "A02", "B01", "B02", "C00", "C02", "E00", "E02", "E03", "D01"]
    folder: Path = shared_folder() / "data" / "rendered"
    truths = json.loads((folder / "truth.json").read_text())
    print("| frame | stars | electrons | n | median radial error px | bound σ px | ratio | strict | pull |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in names:
        truth = next(t for t in truths if t["file"].startswith(name))
        found = measure(read_frame(folder / truth["file"]))
        for line in rows(name, errors_of(truth, found)):
            print(line, flush=True)


if __name__ == "__main__":
    main()
