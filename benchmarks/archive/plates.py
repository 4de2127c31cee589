"""Drawn photographic plates, solved with all their exposures: negatives, grain, scratches, a wedge.

    python -m benchmarks.archive.plates [--plates 24] [--seed 1]

Each fourth plate has one exposure, each fourth three, each eighth shows no stars at all; the others two that
are shifted and of unequal length. The emulsion is a logarithm of light with grain that is a pixel wide. All
solutions are judged: one that is no exposure within a fifth of a star's width, and a pixel, is false.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from mountnav.catalog.embedded import embedded_catalog
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Verdict

TAKEN_UTC = datetime(1931, 5, 2, 22, tzinfo=UTC)
WIDTH, HEIGHT, SCALE_ARCSEC_PX = 1200, 900, 8.0
"""A scan of 2.7° by 2°."""
GRAIN = 0.006
"""Density of the grain, one sigma: the sky's own is 0.3."""
FWHMS_PX = (2.5, 4.0, 7.0, 12.0)


@dataclass(frozen=True, slots=True)
class DrawnPlate:
    """A plate.

    Attributes
    ----------
    exposures : tuple of Icrs
        Their centers; none of a plate without stars.
    scan : ndarray of uint16
    """

    exposures: tuple[Icrs, ...]
    fwhm_px: float
    negative: bool
    scan: NDArray[np.uint16]

    def false(self, verdict: Verdict) -> int:
        """How many solutions are no exposure of this plate."""
        near = max(1.0, 0.2 * self.fwhm_px) * SCALE_ARCSEC_PX
        solutions = () if verdict.solution is None else (verdict.solution, *verdict.further)
        return sum(
            all(separation_arcsec(solution.center, place) > near for place in self.exposures)
            for solution in solutions
        )


def drawn_plate(number: int, seed: int = 1) -> DrawnPlate:
    """Draw one: which kind it is, follows from its number."""
    rng = np.random.default_rng((seed, number))
    count = 0 if number % 8 == 7 else 1 if number % 4 == 0 else 3 if number % 4 == 2 else 2
    center = Icrs(float(rng.uniform(0, 360)), float(rng.uniform(-60, 60)))
    others = [
        Icrs(center.ra_deg, center.dec_deg + float(rng.uniform(0.08, 0.2)) * sign) for sign in (1.0, -1.0)
    ]
    places = (center, *others)[:count]
    fwhm_px = FWHMS_PX[int(rng.integers(len(FWHMS_PX)))]
    optics = SimulatedOptics(
        WIDTH,
        HEIGHT,
        SCALE_ARCSEC_PX,
        rotation_deg=float(rng.uniform(0, 360)),
        fwhm_px=fwhm_px,
        faint_stars_deg2=20.0,
        sky_adu_s=100.0,
    )
    light = np.full((HEIGHT, WIDTH), 2000.0)
    for at, place in enumerate(places):
        exposure_s = 20.0 if at == 0 else float(rng.uniform(8.0, 20.0))
        frame = draw_frame(
            place,
            optics,
            embedded_catalog(),
            exposure_s=exposure_s,
            mid_exposure_utc=TAKEN_UTC,
            seed=(seed, number, at),
        )
        light += np.asarray(frame.pixels, dtype=np.float64)
    density = np.log10(1.0 + light / np.median(light))
    grain = gaussian_filter(rng.normal(0.0, 1.0, density.shape), 0.7)
    density += GRAIN * grain / grain.std()
    _scratch(density, rng)
    for step in range(8):  # a wedge of known densities, as some observatories exposed beside the sky
        density[20:60, 40 + 60 * step : 90 + 60 * step] += 0.1 * (step + 1)
    negative = number % 3 != 2
    transmitted = 10.0**-density
    scan = 60_000.0 * (transmitted if negative else 1.0 - transmitted)
    return DrawnPlate(places, fwhm_px, negative, np.clip(scan, 0, 65535).astype(np.uint16))


def _scratch(density: NDArray[np.float64], rng: np.random.Generator) -> None:
    """Lines where the emulsion is gone, or dirt lies."""
    along = np.arange(-400, 400)
    for _ in range(4):
        y0, x0, angle = rng.uniform(0, HEIGHT), rng.uniform(0, WIDTH), rng.uniform(0, np.pi)
        y, x = (y0 + along * np.sin(angle)).astype(int), (x0 + along * np.cos(angle)).astype(int)
        inside = (y >= 0) & (y < HEIGHT) & (x >= 0) & (x < WIDTH)
        density[y[inside], x[inside]] += rng.choice([-0.15, 0.4])


def write_plate(plate: DrawnPlate, path: Path) -> None:
    """As a scanner's FITS file."""
    from astropy.io import fits

    fits.PrimaryHDU(plate.scan).writeto(path)


def main() -> None:
    """Solve all, and judge."""
    from mountnav.frames import Frame, Hint
    from mountnav.solving.settings import MOST_EXPOSURES, SolveSettings
    from mountnav.solving.solve import solve

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plates", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    settings = SolveSettings(blind="never", exposures=MOST_EXPOSURES)
    shown = found = false = 0
    began_s = time.process_time()
    spent_s = 0.0
    for number in range(asked.plates):
        plate = drawn_plate(number, asked.seed)
        place = plate.exposures[0] if plate.exposures else Icrs(120.0, 20.0)
        hint = Hint(Icrs((place.ra_deg + 0.3) % 360.0, place.dec_deg - 0.2), 1.0)
        frame = Frame(plate.scan, TAKEN_UTC, hint=Hint(), source=f"plate {number}")
        began_s = time.process_time()
        verdict = solve(frame, embedded_catalog(), hint=hint, settings=settings)
        spent_s += time.process_time() - began_s
        wrong = plate.false(verdict)
        solutions = (0 if verdict.solution is None else 1 + len(verdict.further)) - wrong
        shown, found, false = shown + len(plate.exposures), found + solutions, false + wrong
        print(
            f"{number:3} {'negative' if plate.negative else 'positive'} FWHM {plate.fwhm_px:4.1f} px: "
            f"{solutions} of {len(plate.exposures)} exposures, {wrong} false",
            flush=True,
        )
    print(f"{found} of {shown} exposures found, {false} false; {spent_s / asked.plates:.2f} CPU s a plate")


if __name__ == "__main__":
    main()
