"""Frames of the telescopes of [S23 §3.1], drawn from an invented sky, and what a solver made of them."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from mountnav.catalog.stars import Catalog
from mountnav.frames import Hint
from mountnav.simulation.deep_sky import DeepSky
from mountnav.simulation.optics import SimulatedOptics, optics_preset
from mountnav.simulation.render import draw_frame, julian_year
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec
from mountnav.solution import Solution
from mountnav.solving.settings import SolveSettings
from mountnav.solving.solve import solve
from tests.simulation.sky_stores import write_store

RIGHT_PX, RIGHT_ARCSEC, RIGHT_SCALE = 2.0, 3.0, 0.01
"""An answer that is farther off than any of these is wrong."""
MARGIN_DEG = 0.1


@dataclass(frozen=True, slots=True)
class Telescope:
    """How a preset is used.

    Attributes
    ----------
    exposure_s : float
    faintest_mag : float
        V of the faintest stars that are drawn: about where a star is as bright as the noise.
    """

    exposure_s: float
    faintest_mag: float


TELESCOPES = {
    "ison-nm": Telescope(2.0, 18.5),
    "prompt-8": Telescope(30.0, 21.5),
    "mayaki-azt-3": Telescope(30.0, 20.5),
    "vihorlat-vnt": Telescope(60.0, 22.0),
}


@dataclass(frozen=True, slots=True)
class Field:
    """One frame to be: where it looks, through what, and what its user believes."""

    preset: str
    seed: int
    number: int
    center: Icrs
    optics: SimulatedOptics
    believed: Icrs
    hint: Hint

    @property
    def label(self) -> str:
        """How to ask for this frame again."""
        return f"--preset {self.preset} --seed {self.seed} --only {self.number}"


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a frame.

    Attributes
    ----------
    field : Field
    outcome : str
        "solved", "WRONG", or the reason of the refusal.
    told : str
        More about it.
    stars : int
        How many the catalog has in the frame.
    measured : int
        How many sources were measured.
    solve_s : float
        CPU time of measuring and identifying.
    solution : Solution or None
    center_px : float
        How far off the center is; NaN if there is no solution.
    """

    field: Field
    outcome: str
    told: str
    stars: int
    measured: int
    solve_s: float
    solution: Solution | None
    center_px: float


def chosen_field(preset: str, seed: int, number: int, *, radius_deg: float) -> Field:
    """The frame of that number; preset, seed and number fix everything about it.

    Parameters
    ----------
    preset : str
    seed, number : int
        Of ten numbers one is within 2° of a celestial pole, and one on the meridian of RA 0.
    radius_deg : float
        Of the hint; the pointing error has a Rayleigh distribution with sigma 3′, but stays within it.
    """
    chance = np.random.default_rng((seed, sum(preset.encode()), number))
    ra_deg, dec_deg = chance.uniform(0.0, 360.0), math.degrees(math.asin(chance.uniform(-1.0, 1.0)))
    near, side = chance.uniform(-1.0, 1.0), chance.choice((-1.0, 1.0))
    if number % 10 == 8:
        dec_deg = side * (90.0 - 2.0 * math.sqrt(abs(near)))
    elif number % 10 == 9:
        ra_deg = (0.2 * near) % 360.0
    nominal = optics_preset(preset)
    optics = replace(
        nominal,
        scale_arcsec_px=nominal.scale_arcsec_px
        * (1.0 + float(np.clip(chance.normal(0, 0.004), -0.01, 0.01))),
        rotation_deg=chance.uniform(0.0, 360.0),
        parity=int(chance.choice((-1, 1))),
        fwhm_px=nominal.fwhm_px * chance.uniform(0.8, 1.5),
    )
    error_arcsec = min(180.0 * math.sqrt(-2.0 * math.log(1.0 - chance.random())), 0.95 * radius_deg * 3600.0)
    angle = chance.uniform(0.0, math.tau)
    center = Icrs(ra_deg, dec_deg)
    believed = displaced(center, error_arcsec * math.sin(angle), error_arcsec * math.cos(angle))
    scale = nominal.scale_arcsec_px
    hint = Hint(believed, radius_deg, 0.97 * scale, 1.03 * scale)
    return Field(preset, seed, number, center, optics, believed, hint)


def store_for(path: Path, kind: str, fields: list[Field]) -> None:
    """Pack what a catalog has about some frames.

    Parameters
    ----------
    path : Path
    kind : str
        As for `mountnav.simulation.deep_sky.DeepSky.as_catalog`.
    fields : list of Field
        Of one seed and preset.
    """
    # what no frame shows needn't be in the store: it would be most of it
    deepest = min(TELESCOPES[fields[0].preset].faintest_mag + 1.0, 21.5)
    sky = DeepSky(fields[0].seed, faintest_mag=deepest)
    half_deg = fields[0].optics.half_diagonal_deg
    reach_deg = min(2.0 * half_deg, half_deg + 0.5) + MARGIN_DEG
    cones = [(one.believed, one.hint.radius_deg + reach_deg) for one in fields]
    write_store(path, sky.as_catalog(kind), cones)


def result_of(field: Field, catalog: Catalog, *, when: datetime, settings: SolveSettings) -> Result:
    """Draw a frame and solve it.

    Parameters
    ----------
    field : Field
    catalog : Catalog
        What it is solved with.
    when : datetime
        Middle of the exposure.
    settings : SolveSettings
    """
    telescope = TELESCOPES[field.preset]
    sky = DeepSky(field.seed, faintest_mag=telescope.faintest_mag, band="G")
    frame = draw_frame(
        field.center,
        field.optics,
        sky,
        exposure_s=telescope.exposure_s,
        mid_exposure_utc=when,
        seed=(field.seed, field.number),
    )
    began = time.process_time()
    verdict = solve(frame, catalog, hint=field.hint, settings=settings)
    solve_s = time.process_time() - began
    around = catalog.cone(field.center, field.optics.half_diagonal_deg, epoch_yr=julian_year(when))
    # of the circle, the frame's share
    area = field.optics.width_px * field.optics.height_px * (field.optics.scale_arcsec_px / 3600.0) ** 2
    stars = round(len(around) * area / (math.pi * field.optics.half_diagonal_deg**2))
    solution = verdict.solution
    if solution is None:
        assert verdict.reason is not None
        return Result(
            field,
            verdict.reason.name.lower().replace("_", "-"),
            verdict.detail,
            stars,
            verdict.measured,
            solve_s,
            None,
            math.nan,
        )
    off_arcsec = separation_arcsec(solution.center, field.center)
    off_px = off_arcsec / field.optics.scale_arcsec_px
    off_scale = solution.scale_arcsec_px / field.optics.scale_arcsec_px - 1.0
    right = off_px <= RIGHT_PX and off_arcsec <= RIGHT_ARCSEC and abs(off_scale) <= RIGHT_SCALE
    right = right and solution.parity == field.optics.parity
    told = (
        f"{off_px:.2f} px off, scale {off_scale:+.2%}, {solution.pairs} pairs, "
        f"chance {solution.false_probability:.1e}"
    )
    outcome = "solved" if right else "WRONG"
    return Result(field, outcome, told, stars, verdict.measured, solve_s, solution, off_px)


def instant(epoch_yr: float) -> datetime:
    """The moment of a Julian year."""
    return datetime(2000, 1, 1, 12, tzinfo=UTC) + timedelta(days=365.25 * (epoch_yr - 2000.0))
