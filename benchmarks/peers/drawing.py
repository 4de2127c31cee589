"""Frames drawn for the comparison: telescopes like those of the rendered frames, at new places."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from benchmarks.peers.running import Job
from mountnav.catalog.stars import Catalog, Stars
from mountnav.frames import Frame, Hint
from mountnav.simulation.catalog_errors import ErringCatalog
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame, project
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced
from mountnav.units import julian_year

TAKEN = datetime(2026, 3, 1, 3, tzinfo=UTC)
GAIN_E_ADU = 1.5
HINT_OFF_DEG, HINT_SCALE = 1.0, 0.05
KINDS = ("random", "galplane", "galpole")
_TO_GALACTIC = np.array(
    [
        [-0.0548755604, -0.8734370902, -0.4838350155],
        [0.4941094279, -0.4448296300, 0.7469822445],
        [-0.8676661490, -0.1980763734, 0.4559837762],
    ]
)  # [Hipparcos vol. 1 §1.5.3]


@dataclass(frozen=True, slots=True)
class Preset:
    """A telescope as in the rendered frames' truth.json; the ranges are what was found there.

    Attributes
    ----------
    width_px, height_px : int
    scale_arcsec_px : float
        Nominal; a frame's own differs by up to `scale_spread`.
    zero_point_e : float
        Magnitude of a star that gives one electron in the exposure.
    sky_e : (float, float)
        Sky in electrons per pixel.
    read_noise_e : float
    fwhm_px : (float, float)
    distortion_px2 : (float, float)
    faint_deg2 : (float, float)
        Stars no catalog holds, per square degree: poor and rich sky.
    catalog_stars : (int, int)
        Frames with fewer or more stars of the catalog are drawn elsewhere.
    """

    width_px: int
    height_px: int
    scale_arcsec_px: float
    zero_point_e: float
    sky_e: tuple[float, float]
    read_noise_e: float
    fwhm_px: tuple[float, float]
    distortion_px2: tuple[float, float]
    faint_deg2: tuple[float, float]
    catalog_stars: tuple[int, int] = (0, 1_000_000)
    scale_spread: float = 0.01


PRESETS = {
    "A": Preset(3056, 3056, 2.0672, 23.6, (120, 200), 10, (2.8, 3.5), (1e-10, 2e-10), (1900, 4900)),
    "B": Preset(3000, 2000, 3.6, 20.93, (30, 46), 5, (1.7, 2.4), (2e-10, 6e-10), (420, 2000)),
    "C": Preset(
        3948, 2764, 9.124, 18.03, (25, 46), 3, (2.5, 2.8), (2e-10, 8e-10), (40, 120), scale_spread=0.02
    ),
    "E": Preset(2048, 2048, 1.3185, 22.9, (30, 53), 7, (2.2, 3.3), (-2e-10, 3e-10), (1500, 3300), (7, 16)),
    "D": Preset(
        2048, 2048, 0.6628, 26.37, (79, 92), 8, (2.4, 2.7), (-1e-10, 1e-10), (20_000, 21_000), (5, 17)
    ),
}
"""The presets of the rendered frames; E and D are kept to fields with few catalog stars."""


class SeenSky:
    """A catalog as a sky shows it: stars off by their own errors, some missing, magnitudes of another band.

    Parameters
    ----------
    catalog : Catalog
    seed : int
    """

    def __init__(self, catalog: Catalog, seed: int) -> None:
        # Tycho-2's true errors are 1.14 to 1.20 times the stated ones (docs/reference/catalog.md)
        self._sky = ErringCatalog(catalog, seed=seed, factor=1.17)
        self._seed = seed

    @property
    def name(self) -> str:
        """Name for provenance."""
        return f"{self._sky.name}, 2 % missing"

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        """Stars of the sky; the missing ones are the same for the same cone."""
        stars = self._sky.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)
        rng = np.random.default_rng(self._seed)
        there = rng.random(len(stars)) >= 0.02
        mag = stars.mag + rng.normal(0.0, 0.2, len(stars))
        columns = ("ra_deg", "dec_deg", "sigma_arcsec", "pm_ra_cosdec_mas_yr", "pm_dec_mas_yr")
        return replace(stars, mag=mag[there], **{name: getattr(stars, name)[there] for name in columns})


def place_of(kind: str, rng: np.random.Generator) -> Icrs:
    """A random place anywhere, within 5° of the galactic plane, or within 25° of a galactic pole."""
    if kind == "random":
        return Icrs(float(rng.uniform(0, 360)), math.degrees(math.asin(rng.uniform(-1, 1))))
    sine = (
        math.sin(math.radians(rng.uniform(-5, 5)))
        if kind == "galplane"
        else float(rng.choice((-1, 1))) * rng.uniform(math.cos(math.radians(25)), 1)
    )
    longitude, cosine = rng.uniform(0, math.tau), math.sqrt(1 - sine * sine)
    x, y, z = _TO_GALACTIC.T @ np.array([cosine * math.cos(longitude), cosine * math.sin(longitude), sine])
    return Icrs(math.degrees(math.atan2(y, x)) % 360.0, math.degrees(math.asin(z)))


def stars_inside(center: Icrs, optics: SimulatedOptics, catalog: Catalog) -> int:
    """How many of the catalog's stars lie in the frame."""
    stars = catalog.cone(center, 1.02 * optics.half_diagonal_deg, epoch_yr=julian_year(TAKEN))
    x, y = project(center, optics, stars.ra_deg, stars.dec_deg)
    inside: NDArray[np.bool_] = (x > 0) & (x < optics.width_px - 1) & (y > 0) & (y < optics.height_px - 1)
    return int(np.count_nonzero(inside))


def drawn(letter: str, number: int, seed: int, catalog: Catalog, folder: Path) -> Job:
    """Draw a frame and write it as a camera would; the same letter, number and seed give the same frame.

    Parameters
    ----------
    letter : str
        Of `PRESETS`.
    number : int
        Which frame; also decides of what kind of sky it is.
    seed : int
    catalog : Catalog
        The sky's stars are those of this catalog, moved by their errors.
    folder : Path
        Where "A00.fits" goes.

    Returns
    -------
    Job
    """
    preset = PRESETS[letter]
    rng = np.random.default_rng((seed, ord(letter), number))
    kind = KINDS[number % len(KINDS)]
    rich = float(rng.uniform(0, 1)) if kind == "random" else float(kind == "galplane")
    sky_e = float(rng.uniform(*preset.sky_e))
    optics = SimulatedOptics(
        preset.width_px,
        preset.height_px,
        preset.scale_arcsec_px * (1 + float(rng.uniform(-1, 1)) * preset.scale_spread),
        rotation_deg=float(rng.uniform(0, 360)),
        parity=int(rng.choice((-1, 1))),
        fwhm_px=float(rng.uniform(*preset.fwhm_px)),
        distortion_px2=float(rng.uniform(*preset.distortion_px2)),
        zero_point_mag=preset.zero_point_e - 2.5 * math.log10(GAIN_E_ADU),
        gain_e_adu=GAIN_E_ADU,
        sky_adu_s=sky_e / GAIN_E_ADU,
        read_noise_adu=preset.read_noise_e / GAIN_E_ADU,
        faint_stars_deg2=preset.faint_deg2[0] + rich * (preset.faint_deg2[1] - preset.faint_deg2[0]),
        faint_brightest_mag=11.8,
    )
    fewest, most = preset.catalog_stars
    while True:
        center = place_of(kind, rng)
        count = stars_inside(center, optics, catalog)
        if fewest <= count <= most:
            break
        # a rich sky may have no such field at all
        kind = "random"
    sky = SeenSky(catalog, int(rng.integers(1 << 31)))
    frame = draw_frame(
        center,
        optics,
        sky,
        exposure_s=1.0,
        mid_exposure_utc=TAKEN,
        seed=(seed, ord(letter), number),
    )
    name = f"{letter}{number:02d}"
    write_plain(frame, folder / f"{name}.fits")
    return Job(
        name=name,
        preset=letter,
        path=folder / f"{name}.fits",
        width_px=optics.width_px,
        height_px=optics.height_px,
        center=center,
        scale_arcsec_px=optics.scale_arcsec_px,
        hint=hint_near(center, optics.scale_arcsec_px, rng),
        catalog_stars=count,
    )


def hint_near(center: Icrs, scale_arcsec_px: float, rng: np.random.Generator) -> Hint:
    """What a user believes: a place off by up to 1°, a scale off by up to 5 %, with bounds that hold it."""
    away, toward = 3600 * HINT_OFF_DEG * math.sqrt(rng.random()), rng.uniform(0, math.tau)
    scale = scale_arcsec_px / (1 + HINT_SCALE * float(rng.uniform(-0.95, 0.95)))
    return Hint(
        displaced(center, away * math.cos(toward), away * math.sin(toward)),
        HINT_OFF_DEG,
        scale * (1 - HINT_SCALE),
        scale * (1 + HINT_SCALE),
    )


def write_plain(frame: Frame, path: Path) -> None:
    """Write unsigned 16-bit FITS without a word about place or scale."""
    header = fits.Header()
    for card in ("DATE-OBS", "EXPTIME"):
        if card in frame.header:
            header[card] = frame.header[card]
    pixels = np.asarray(frame.pixels)
    if pixels.dtype != np.uint16:
        pixels = np.clip(np.rint(pixels), 0, 65535).astype(np.uint16)
    fits.PrimaryHDU(pixels, header).writeto(path)
