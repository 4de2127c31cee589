"""Table 1 of [S23 §4] again, on drawn frames of ISON-NM: what part of the deviations is whose.

Run: python -m benchmarks.table1 [--measurements 30000] [--epoch 2013.45] [--factor 1] [--plot DIR]
     [--catalog gaia-bright] [--catalog-sigma 0.03]
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from api.cli.chosen_catalogs import opened_catalog
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.installed import catalogs_folder
from mountnav.catalog.stars import Catalog
from mountnav.frames import Hint
from mountnav.identification.accuracy import (
    Deviations,
    accuracy_table,
    deviations,
    east_north_arcsec,
    fit_factor,
    pooled,
)
from mountnav.simulation.catalog_errors import ErringCatalog
from mountnav.simulation.optics import SimulatedOptics, optics_preset
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, gnomonic_inverse, separation_arcsec
from mountnav.sky.wcs import places_at_pixels
from mountnav.solution import Solution
from mountnav.solving.solve import solve
from mountnav.units import julian_year

Array = NDArray[np.float64]

SEED = 20230511
EXPOSURE_S = 2.0
"""Stars fainter than V = 8.6 don't saturate, and those of V = 12 have a signal-to-noise ratio of 200."""
DISTORTION_PX2 = 2e-10
"""2 px in the corners: enough that the plate has to be cubic."""
PAPER = {0.0: ("0.003", "0.08", "0.002", "0.07"), 5.0: ("0.002", "0.08", "0.001", "0.07")}
PAPER[10.0] = ("0.001", "0.07", "0.001", "0.06")
PAPER_MAG = {0.0: ("0.03", "0.38"), 5.0: ("0.03", "0.38"), 10.0: ("0.03", "0.37")}
"""Mean and standard deviation of the brightness, mag [S23 Table 1]."""
MAG_TOLD = (
    "The Δmag of drawn frames are no measure of a telescope: no errors of the catalog's magnitudes are drawn "
    "(nor are variable stars, extinction or color beyond the catalog's), so what is left is photon noise "
    "and blends. The paper's own row contradicts itself in print: a standard deviation of 0.38 mag stands "
    "beside a largest modulus of 0.36."
)


@dataclass(frozen=True, slots=True)
class Parts:
    """The deviation of each pair in its parts; shape (n, 2), east and north, arcsec.

    Attributes
    ----------
    total : ndarray
        Measured place by the solution's WCS, minus catalog place: the sum of the three below.
    centroid : ndarray
        Measured pixel minus where the star's light truly fell.
    catalog : ndarray
        The star's true place minus its catalog place.
    model : ndarray
        The solution's place of the measured pixel minus the exact one.
    sigma, centroid_sigma, mag : ndarray, shape (n,)
        The stated errors of catalog and centroid (arcsec), and the magnitude.
    """

    total: Array
    centroid: Array
    catalog: Array
    model: Array
    sigma: Array
    centroid_sigma: Array
    mag: Array


@dataclass(frozen=True, slots=True)
class Reduced:
    """One drawn frame, reduced."""

    solution: Solution
    deviations: Deviations
    parts: Parts
    center_error_px: float


def exact_places(center: Icrs, optics: SimulatedOptics, x_px: Array, y_px: Array) -> tuple[Array, Array]:
    """Places whose light falls on pixels: the inverse of `mountnav.simulation.render.project`."""
    right, up = x_px - (optics.width_px - 1) / 2.0, y_px - (optics.height_px - 1) / 2.0
    seen = np.hypot(right, up)
    ideal = seen.copy()
    for _ in range(8):  # Newton: ideal·(1 + k·ideal²) = seen
        ideal -= (ideal * (1.0 + optics.distortion_px2 * ideal**2) - seen) / (
            1.0 + 3.0 * optics.distortion_px2 * ideal**2
        )
    shrink = np.divide(ideal, seen, out=np.ones_like(seen), where=seen > 0)
    px = math.radians(optics.scale_arcsec_px / 3600.0)
    right, up = right * shrink * optics.parity * px, up * shrink * px
    s, c = math.sin(math.radians(optics.rotation_deg)), math.cos(math.radians(optics.rotation_deg))
    return gnomonic_inverse(up * s - right * c, up * c + right * s, center.ra_deg, center.dec_deg)


def parts_of(
    solution: Solution,
    center: Icrs,
    optics: SimulatedOptics,
    catalog: Catalog,
    sky: ErringCatalog,
    when: datetime,
) -> Parts:
    """Split the deviations of a drawn frame's pairs."""
    pairs = solution.identified
    used = pairs.used
    x, y, ra, dec = pairs.x_px[used], pairs.y_px[used], pairs.ra_deg[used], pairs.dec_deg[used]
    stars = catalog.cone(center, 1.1 * optics.half_diagonal_deg + 0.05, epoch_yr=julian_year(when))
    # the solver's places and these come from the same catalog for the same instant
    row = np.array(
        [np.argmin(np.hypot(stars.ra_deg - a, stars.dec_deg - d)) for a, d in zip(ra, dec, strict=True)],
        dtype=np.intp,
    )
    gap = np.hypot(*east_north_arcsec(ra, dec, stars.ra_deg[row], stars.dec_deg[row]))
    if gap.size and gap.max() > 1e-3:
        raise RuntimeError(f"a pair's star isn't in the catalog: {gap.max():.4f} arcsec off")
    true = sky.displaced(stars)
    true_ra, true_dec = true.ra_deg[row], true.dec_deg[row]
    exact_ra, exact_dec = exact_places(center, optics, x, y)
    told_ra, told_dec = places_at_pixels(solution.wcs, x, y)

    def arc(ra_deg: Array, dec_deg: Array, ra0_deg: Array, dec0_deg: Array) -> Array:
        return np.column_stack(east_north_arcsec(ra_deg, dec_deg, ra0_deg, dec0_deg))

    return Parts(
        total=arc(told_ra, told_dec, ra, dec),
        centroid=arc(exact_ra, exact_dec, true_ra, true_dec),
        catalog=arc(true_ra, true_dec, ra, dec),
        model=arc(told_ra, told_dec, exact_ra, exact_dec),
        sigma=pairs.catalog_sigma_arcsec[used],
        centroid_sigma=pairs.centroid_sigma_arcsec[used],
        mag=pairs.mag[used],
    )


def reduced(
    number: int,
    optics: SimulatedOptics,
    catalog: Catalog,
    sky: ErringCatalog,
    when: datetime,
    center: Icrs | None = None,
    catalog_sigma_arcsec: float = math.inf,
) -> Reduced | str:
    """Draw and reduce a frame of a random field; the number fixes everything about it."""
    chance = np.random.default_rng((SEED, number))
    dec_deg = math.degrees(math.asin(chance.uniform(-1.0, 1.0)))
    center = center or Icrs(chance.uniform(0.0, 360.0), dec_deg)
    optics = replace(
        optics,
        rotation_deg=chance.uniform(0.0, 360.0),
        fwhm_px=chance.uniform(2.5, 3.5),
        distortion_px2=DISTORTION_PX2,
    )
    frame = draw_frame(center, optics, sky, exposure_s=EXPOSURE_S, mid_exposure_utc=when, seed=(SEED, number))
    scale = optics.scale_arcsec_px
    believed = displaced(center, chance.uniform(-600, 600), chance.uniform(-600, 600))
    verdict = solve(frame, catalog, hint=Hint(believed, 0.5, 0.97 * scale, 1.03 * scale))
    solution = verdict.solution
    if solution is None:
        return f"{verdict.reason}: {verdict.detail}"
    return Reduced(
        solution=solution,
        deviations=deviations(solution, catalog_sigma_arcsec=catalog_sigma_arcsec),
        parts=parts_of(solution, center, optics, catalog, sky, when),
        center_error_px=separation_arcsec(solution.center, center) / scale,
    )


def joined(parts: list[Parts]) -> Parts:
    """All pairs of all frames."""
    return Parts(*(np.concatenate([getattr(one, field.name) for one in parts]) for field in fields(Parts)))


def chosen(parts: Parts, which: NDArray[np.bool_]) -> Parts:
    """Some of the pairs."""
    return Parts(*(getattr(parts, field.name)[which] for field in fields(Parts)))


def split_rows(label: str, parts: Parts) -> list[str]:
    """Lines of the table of parts: standard deviations, and two ways to add them up."""
    out = []
    for axis, name in ((0, "RA cos δ"), (1, "Dec")):
        c, k, m, total = (getattr(parts, one)[:, axis] for one in ("centroid", "catalog", "model", "total"))
        vc, vk, vm, vt = (float(np.var(one, ddof=1)) for one in (c, k, m, total))
        cross = 2.0 * float(np.cov(c, k)[0, 1] + np.cov(c, m)[0, 1] + np.cov(k, m)[0, 1])
        told = (vc, vk, vm, vt, vc + vk + vm, vc + vk + vm + cross, vc + vk - vm)
        numbers = " | ".join(f"{math.sqrt(max(v, 0.0)):.4f}" for v in told)
        out.append(f"| {label} | {name} | {total.size} | {numbers} |")
    return out


def _over(errors: Array, sigma: Array) -> float:
    """Spread of errors in units of sigma, by the median modulus: a few outliers don't count."""
    return float(1.4826 * np.median(np.abs(errors / sigma[:, None])))


def report(done: list[Reduced], refused: list[str], when: datetime, factor: float, wall_s: float) -> str:
    """All tables, as Markdown."""
    found, parts = pooled([one.deviations for one in done]), joined([one.parts for one in done])
    pairs = sum(one.solution.pairs for one in done)
    free = sum(float(one.solution.identified.leverage.sum()) for one in done)
    errors = np.array([one.center_error_px for one in done])
    modes = [one.solution.mode for one in done]
    out = [
        f"{len(done)} frames of {len(done) + len(refused)} solved, {len(found)} measurements, frames of "
        f"J{julian_year(when):.2f}, catalog errors × {factor:g}, {wall_s:.0f} s.",
        f"Center against the truth: median {np.median(errors):.4f} px, worst {errors.max():.4f} px. Models: "
        + ", ".join(f"{modes.count(mode)} {mode}" for mode in sorted(set(modes)))
        + f". sqrt(1 - p/n) = {fit_factor(pairs, free):.3f}.",
        f"Errors over the stated ones, by the median: centroid "
        f"{_over(parts.centroid, parts.centroid_sigma):.2f}, "
        f"catalog {_over(parts.catalog, parts.sigma):.2f}.",
        "",
        "| rejected | | number | mean | st. dev. | min mod. | max mod. | paper: mean | paper: st. dev. |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in accuracy_table(found, tuple(PAPER)):
        paper = PAPER[row.rejected_percent]
        told = (
            ("ΔRA cos δ ″", row.ra, *paper[:2]),
            ("ΔDec ″", row.dec, *paper[2:]),
            ("Δmag", row.mag, *PAPER_MAG[row.rejected_percent]),
        )
        for label, one, mean, spread in told:
            out.append(
                f"| {row.rejected_percent:g} % | {label} | {one.number} | {one.mean:+.4f} "
                f"| {one.standard_deviation:.3f} | {one.least_modulus:.1e} | {one.most_modulus:.3f} "
                f"| {mean} | {spread} |"
            )
    out += [
        "",
        MAG_TOLD,
        "",
        "| pairs | | number | centroid c | catalog k | model m | total "
        "| √(c²+k²+m²) | with cross terms | √(c²+k²−m²) |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|",
        *split_rows("all", parts),
    ]
    for label, which in (
        ("catalog σ ≤ 0.05″", parts.sigma <= 0.05),
        ("0.05″ < σ ≤ 0.1″", (parts.sigma > 0.05) & (parts.sigma <= 0.1)),
        ("σ > 0.1″", parts.sigma > 0.1),
        ("V < 10", parts.mag < 10.0),
        ("V ≥ 11.5", parts.mag >= 11.5),
    ):
        if np.count_nonzero(which) > 2:
            out += split_rows(label, chosen(parts, which))
    out += [f"refused: {one}" for one in refused]
    return "\n".join(out)


def run(
    measurements: int,
    when: datetime,
    factor: float,
    optics: SimulatedOptics,
    name: str | None = None,
    catalog_sigma_arcsec: float = math.inf,
) -> tuple[list[Reduced], list[str], float]:
    """Frames of random fields until there are enough measurements."""
    catalog = embedded_catalog() if name is None else opened_catalog(name, catalogs_folder())
    sky = ErringCatalog(catalog, seed=SEED, factor=factor)
    done: list[Reduced] = []
    refused: list[str] = []
    pairs, began = 0, time.monotonic()
    while pairs < measurements:
        number = len(done) + len(refused)
        one = reduced(number, optics, catalog, sky, when, catalog_sigma_arcsec=catalog_sigma_arcsec)
        if isinstance(one, str):
            refused.append(one)
        else:
            done.append(one)
            pairs += len(one.deviations)
    return done, refused, time.monotonic() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--measurements", type=int, default=30_000)
    parser.add_argument("--epoch", type=float, default=2013.45, help="Julian year of the frames")
    parser.add_argument("--factor", type=float, default=1.0, help="true catalog errors over the stated ones")
    parser.add_argument("--catalog", help="an imported one (gaia-bright) instead of the embedded one")
    parser.add_argument(
        "--catalog-sigma",
        type=float,
        default=math.inf,
        metavar="ARCSEC",
        help="count only stars that the catalog states to be placed at least so well",
    )
    parser.add_argument("--plot", type=Path, help="write histograms and a residual map into this folder")
    asked = parser.parse_args()
    when = datetime(2000, 1, 1, 12, tzinfo=UTC) + timedelta(days=365.25 * (asked.epoch - 2000.0))
    done, refused, wall_s = run(
        asked.measurements,
        when,
        asked.factor,
        optics_preset("ison-nm"),
        asked.catalog,
        asked.catalog_sigma,
    )
    print(report(done, refused, when, asked.factor, wall_s))
    if asked.plot is not None:
        from api.cli.accuracy_plots import write_plots

        asked.plot.mkdir(parents=True, exist_ok=True)
        write_plots([one.solution for one in done], asked.plot)


if __name__ == "__main__":
    main()
