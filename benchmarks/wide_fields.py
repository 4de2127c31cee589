"""Draw frames of wide and bent lenses, solve them, hold their WCS against the truth over the whole field.

Run: python -m benchmarks.wide_fields [--first 1] [--frames 20] [--lists] [--scrambled]

Each seed draws a lens (equidistant, equisolid, stereographic, gnomonic, or one bent by 10 % at 40°), a field
of 54°, 72°, 100° or 150°, a place anywhere, a rotation, a parity, and an axis that is off the center by up to
some 20 px. The frames hold planets that no catalog has, the Moon with its glow in every other one, and from
100° on, in every third, a horizon beyond which there is no sky. Odd seeds are solved blind, even ones with a
hint (8°, scale to 10 %). Errors are those of a grid of 21 × 21 points where there is sky, in pixels.

``--lists`` takes lists of stars (0.1 px of noise, one in ten lost, 60 false ones) in place of frames: several
times as fast. ``--scrambled`` turns each star of such a list about the center by a random angle: no such sky
is anywhere, and a solution is wrong.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame, Hint, StarList
from mountnav.identification.blind.cache import cached_index
from mountnav.identification.blind.index import BlindIndex
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame, project
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced
from mountnav.sky.wcs import is_zpn, places_at_pixels
from mountnav.solution import Verdict
from mountnav.solving.settings import SolveSettings
from mountnav.solving.solve import solve, solve_stars
from mountnav.units import ARCSEC_PER_RAD

Array = NDArray[np.float64]

UTC_OF_ALL = datetime(2026, 3, 1, 3, tzinfo=UTC)
EPOCH_YR = 2026.16
LENSES = (
    ("gnomonic", 54.0),
    ("equidistant", 54.0),
    ("equisolid", 72.0),
    ("equidistant", 72.0),
    ("equidistant", 100.0),
    ("equisolid", 100.0),
    ("stereographic", 100.0),
    ("equidistant", 150.0),
    ("equisolid", 150.0),
    ("stereographic", 150.0),
    ("bent", 40.0),
    ("bent", 40.0),
)
"""Lens and width of the field, degrees; "bent" is gnomonic with 10 % at the corner, barrel or cushion."""
SIZES = ((1800, 1200), (1500, 1500), (1600, 1100))
MARGIN_PX = 20
"""Frames are cut from ones larger by so much, not from their middle: the axis is off the center."""
HORIZON = 0.92
"""Where there is a horizon, it lies so far out, in half the shorter side."""


@dataclass(frozen=True, slots=True)
class Wide:
    """A drawn lens and where it looks.

    Attributes
    ----------
    left_px, low_px : int
        The frame's first pixel in what the optics would show.
    """

    seed: int
    name: str
    optics: SimulatedOptics
    center: Icrs
    left_px: int
    low_px: int
    width_px: int
    height_px: int
    horizon: bool

    def pixels(self, ra_deg: Array, dec_deg: Array) -> tuple[Array, Array]:
        """Where positions truly fall in the frame."""
        x, y = project(self.center, self.optics, ra_deg, dec_deg)
        return x - self.left_px, y - self.low_px

    def sky(self, x_px: Array, y_px: Array) -> NDArray[np.bool_]:
        """Where there is sky."""
        if not self.horizon:
            return np.ones(x_px.shape, dtype=bool)
        off = np.hypot(x_px - (self.width_px - 1) / 2, y_px - (self.height_px - 1) / 2)
        return np.asarray(off < HORIZON * 0.5 * min(self.width_px, self.height_px))

    def hint(self) -> Hint | None:
        """What is told: nothing of odd seeds."""
        if self.seed % 2:
            return None
        rng = np.random.default_rng((self.seed, 5))
        scale = self.optics.scale_arcsec_px
        off = 3600.0 * rng.uniform(-4, 4, 2)
        near = displaced(self.center, float(off[0]), float(off[1]))
        return Hint(near, 8.0, scale / 1.1, scale * 1.1)


def drawn_lens(seed: int) -> Wide:
    """The lens of a seed."""
    rng = np.random.default_rng((20261126, seed))
    lens, side_deg = LENSES[int(rng.integers(len(LENSES)))]
    width, height = SIZES[int(rng.integers(len(SIZES)))]
    half = math.radians(0.5 * side_deg)
    focal = {
        "equidistant": half,
        "equisolid": 2 * math.sin(0.5 * half),
        "stereographic": 2 * math.tan(0.5 * half),
    }.get(lens, math.tan(half))
    scale = focal * ARCSEC_PER_RAD / (0.5 * width)
    corner2 = 0.25 * (width**2 + height**2)
    bent = float(rng.choice([-0.1, 0.1])) / corner2 if lens == "bent" else 0.0
    optics = SimulatedOptics(
        width + 2 * MARGIN_PX,
        height + 2 * MARGIN_PX,
        scale,
        rotation_deg=float(rng.uniform(0, 360)),
        parity=int(rng.choice([-1, 1])),
        fwhm_px=float(rng.uniform(2.0, 3.0)),
        distortion_px2=bent,
        zero_point_mag=15.5,
        sky_adu_s=30.0,
        projection="gnomonic" if lens == "bent" else lens,
    )
    center = Icrs(float(rng.uniform(0, 360)), float(np.degrees(np.arcsin(rng.uniform(-1, 1)))))
    left, low = (int(one) for one in rng.integers(0, 2 * MARGIN_PX, 2))
    horizon = side_deg >= 100.0 and rng.random() < 1 / 3
    return Wide(seed, f"{lens} {side_deg:.0f}°", optics, center, left, low, width, height, horizon)


def drawn_frame(wide: Wide) -> Frame:
    """A frame of it, with planets, the Moon, a horizon."""
    rng = np.random.default_rng((wide.seed, 1))
    whole = draw_frame(
        wide.center,
        wide.optics,
        embedded_catalog(),
        exposure_s=10.0,
        mid_exposure_utc=UTC_OF_ALL,
        seed=wide.seed,
    ).pixels
    pixels = whole[wide.low_px : wide.low_px + wide.height_px, wide.left_px : wide.left_px + wide.width_px]
    light = pixels.astype(np.float32)
    y, x = np.mgrid[0 : wide.height_px, 0 : wide.width_px].astype(np.float32)
    for _ in range(4):  # planets
        at_x, at_y, peak = (
            rng.uniform(0, wide.width_px),
            rng.uniform(0, wide.height_px),
            10 ** rng.uniform(4, 5.5),
        )
        light += peak * np.exp(-0.5 * ((x - at_x) ** 2 + (y - at_y) ** 2) / 1.2**2)
    if rng.random() < 0.5:
        at_x, at_y = rng.uniform(0, wide.width_px), rng.uniform(0, wide.height_px)
        disk_px = max(4.0, 950.0 / wide.optics.scale_arcsec_px)
        off = np.hypot(x - at_x, y - at_y)
        glow = 3000.0 * np.exp(-off / 60.0)
        light += np.sqrt(glow) * rng.standard_normal(light.shape, dtype=np.float32) + glow
        light[off < disk_px] = 65535
    ground = ~wide.sky(x.astype(float), y.astype(float))
    light[ground] = 305.0 + 6.0 * rng.standard_normal(int(ground.sum()))
    return Frame(
        pixels=np.clip(np.rint(light), 0, 65535).astype(np.uint16),
        mid_exposure_utc=UTC_OF_ALL,
        source=f"wide {wide.seed}",
        saturation_adu=65535.0,
    )


def drawn_list(wide: Wide, *, scrambled: bool = False) -> StarList:
    """The list of its 600 brightest stars, some lost, some false."""
    rng = np.random.default_rng((wide.seed, 2))
    reach_deg = min(1.05 * wide.optics.half_diagonal_deg, 118.0)
    stars = embedded_catalog().cone(wide.center, reach_deg, epoch_yr=EPOCH_YR, mag_limit=7.0)
    x, y = wide.pixels(stars.ra_deg, stars.dec_deg)
    inside = (x > 0) & (x < wide.width_px - 1) & (y > 0) & (y < wide.height_px - 1) & wide.sky(x, y)
    inside &= rng.random(x.size) < 0.9
    at = np.flatnonzero(inside)[:600]
    x, y, mag = x[at], y[at], stars.mag[at] + rng.normal(0, 0.2, at.size)
    if scrambled:
        middle = complex((wide.width_px - 1) / 2, (wide.height_px - 1) / 2)
        z = (x + 1j * y - middle) * np.exp(1j * rng.uniform(0, math.tau, x.size)) + middle
        x, y = z.real, z.imag
        keep = (x > 0) & (x < wide.width_px - 1) & (y > 0) & (y < wide.height_px - 1)
        x, y, mag = x[keep], y[keep], mag[keep]
    x, y = x + rng.normal(0, 0.1, x.size), y + rng.normal(0, 0.1, x.size)
    false_x, false_y = rng.uniform(0, wide.width_px - 1, 60), rng.uniform(0, wide.height_px - 1, 60)
    false_mag = rng.choice(mag, 60) if mag.size else np.zeros(60)
    flux = 10.0 ** (-0.4 * (np.concatenate((mag, false_mag)) - 12.0))
    return StarList(
        np.concatenate((x, false_x)),
        np.concatenate((y, false_y)),
        flux,
        wide.width_px,
        wide.height_px,
        source=f"wide {wide.seed}",
    )


def field_errors_px(wide: Wide, verdict: Verdict) -> Array:
    """Errors of the WCS on a grid where there is sky; infinite where it says that there is none."""
    assert verdict.solution is not None
    x, y = (
        side.ravel()
        for side in np.meshgrid(np.linspace(0, wide.width_px - 1, 21), np.linspace(0, wide.height_px - 1, 21))
    )
    sky = wide.sky(x, y)
    x, y = x[sky], y[sky]
    ra, dec = places_at_pixels(verdict.solution.wcs, x, y)
    known = np.isfinite(ra)
    true_x, true_y = wide.pixels(np.where(known, ra, 0.0), np.where(known, dec, 0.0))
    errors = np.hypot(true_x - x, true_y - y)
    return np.where(known & np.isfinite(errors), errors, np.inf)


def asked(wide: Wide, index: BlindIndex, *, lists: bool = False, scrambled: bool = False) -> Verdict:
    """Solve the frame or the list of a lens."""
    hint = wide.hint()
    settings = SolveSettings(index=index, blind="only" if hint is None else "never")
    if lists or scrambled:
        stars = drawn_list(wide, scrambled=scrambled)
        # a list has no date: its stars are wanted where they are drawn
        settings = replace(settings, undated_utc=UTC_OF_ALL)
        return solve_stars(stars, embedded_catalog(), hint=hint, settings=settings)
    return solve(drawn_frame(wide), embedded_catalog(), hint=hint, settings=settings)


def main() -> None:
    """Print a line for each, and the sums."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.wide_fields")
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--lists", action="store_true")
    parser.add_argument("--scrambled", action="store_true")
    given = parser.parse_args()
    index, came, rms = cached_index(embedded_catalog()), Counter[str](), []
    for seed in range(given.first, given.first + given.frames):
        wide = drawn_lens(seed)
        began_s = time.process_time()
        verdict = asked(wide, index, lists=given.lists, scrambled=given.scrambled)
        spent_s = time.process_time() - began_s
        how = "blind" if wide.hint() is None else "hint"
        solution = verdict.solution
        if solution is None:
            came["refused"] += 1
            if not given.scrambled:
                print(f"{seed} {wide.name} {how}: {verdict.reason}: {verdict.detail[:90]} ({spent_s:.1f} s)")
            continue
        errors = field_errors_px(wide, verdict)
        one = float(np.sqrt(np.mean(errors**2)))
        told = any("not proven" in note for note in verdict.notes)
        wrong = given.scrambled or float(np.median(errors)) > 1.0
        beyond = not wrong and errors.max() > 1.0
        came[
            "wrong" if wrong else "edge off, told" if beyond and told else "edge off" if beyond else "right"
        ] += 1
        rms.append(one)
        print(
            f"{seed} {wide.name}{' horizon' if wide.horizon else ''} {how}: rms {one:.3f} px, worst "
            f"{errors.max():.3f}, {solution.pairs} pairs, {solution.mode}, "
            f"{'ZPN' if is_zpn(solution.wcs) else 'SIP ' + str(solution.wcs.get('A_ORDER', 0))}, odds "
            f"{solution.false_probability:.0e}, {spent_s:.1f} s{', told' if told else ''}"
            f"{' WRONG' if wrong else ''}",
            flush=True,
        )
    told_rms = f"; field rms median {np.median(rms):.3f}, worst {max(rms):.3f} px" if rms else ""
    print(", ".join(f"{name} {count}" for name, count in came.items()) + told_rms)


if __name__ == "__main__":
    main()
