"""Fields drawn straight as lists: a camera with known distortion, its stars and what was measured of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Stars
from mountnav.identification.plate import Plate, similarity_plate
from mountnav.identification.reference import Reference, Selection
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Measurements
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic_inverse
from mountnav.units import ARCSEC_PER_RAD

Array = NDArray[np.float64]

WIDTH, HEIGHT = 2000, 1600


@dataclass(frozen=True, slots=True)
class Camera:
    """Truth: pixels to sky. Distortions in pixels at half the longer side."""

    place: Icrs = field(default_factory=lambda: Icrs(123.4, -35.0))
    scale: float = 1.5
    rotation_deg: float = 33.0
    mirrored: bool = False
    radial_px: float = 0.0
    decenter_px: tuple[float, float] = (0.0, 0.0)
    shear_px: tuple[float, float] = (0.0, 0.0)

    def plate(self) -> Plate:
        """The camera without its distortion."""
        turn = self.scale * np.exp(1j * np.radians(self.rotation_deg))
        middle = complex((WIDTH - 1) / 2, (HEIGHT - 1) / 2 * (-1 if self.mirrored else 1))
        return similarity_plate(
            self.place, turn, -turn * middle, mirrored=self.mirrored, width_px=WIDTH, height_px=HEIGHT
        )

    def sky(self, x: Array, y: Array) -> tuple[Array, Array]:
        """True right ascension and declination, degrees, of pixels."""
        half = 0.5 * max(WIDTH, HEIGHT)
        cx, cy = self.decenter_px
        u, v = (x - (WIDTH - 1) / 2 - cx) / half, (y - (HEIGHT - 1) / 2 - cy) / half
        square = u * u + v * v
        dx = self.radial_px * u * square + self.shear_px[0] * u + self.shear_px[1] * v
        dy = self.radial_px * v * square - self.shear_px[0] * v + self.shear_px[1] * u
        xi, eta = self.plate().tangential(x + dx, y + dy)
        place = self.place
        ra, dec = gnomonic_inverse(xi / ARCSEC_PER_RAD, eta / ARCSEC_PER_RAD, place.ra_deg, place.dec_deg)
        return np.asarray(ra) % 360.0, np.asarray(dec)


def spots(rng: np.random.Generator, count: int, layout: str) -> tuple[Array, Array]:
    """Pixels of stars: even, or in a corner, one half, a strip, or mostly in a cluster."""
    x, y = rng.uniform(0, WIDTH - 1, count), rng.uniform(0, HEIGHT - 1, count)
    if layout == "corner":
        x, y = 0.4 * x, 0.4 * y
    elif layout == "half":
        x = 0.5 * x
    elif layout == "strip":
        y = 0.4 * HEIGHT + 0.2 * y
    elif layout == "cluster":
        inside = slice(0, count - max(2, count // 4))
        x[inside] = np.clip(rng.normal(0.6 * WIDTH, 0.08 * WIDTH, count)[inside], 0, WIDTH - 1)
        y[inside] = np.clip(rng.normal(0.4 * HEIGHT, 0.08 * HEIGHT, count)[inside], 0, HEIGHT - 1)
    return x, y


def stars_at(ra: Array, dec: Array, *, sigma_arcsec: Array, mag: Array) -> Stars:
    """A list of stars of epoch 2000, in the order given."""
    still = np.zeros(ra.size)
    return Stars(ra, dec, sigma_arcsec, mag, still, still, 2000.0, "V", "drawn")


def measurements_at(x: Array, y: Array, sigma_px: Array, mag: Array, *, fwhm_px: float = 3.0) -> Measurements:
    """Clean measurements, in the order given."""
    count = x.size
    flux = 10 ** (-0.4 * (mag - 20.0))
    return Measurements(
        x_px=x,
        y_px=y,
        x_sigma_px=sigma_px,
        y_sigma_px=sigma_px,
        flux=flux,
        flux_sigma=0.01 * flux,
        fwhm_px=np.full(count, fwhm_px),
        ellipticity=np.zeros(count),
        flags=np.zeros(count, dtype=np.int64),
        width_px=WIDTH,
        height_px=HEIGHT,
        background_adu=100.0,
        noise_adu=5.0,
    )


def draw(
    rng: np.random.Generator,
    camera: Camera,
    count: int,
    *,
    layout: str = "even",
    centroid_px: tuple[float, float] = (0.01, 0.15),
    catalog_arcsec: tuple[float, float] = (0.02, 0.1),
    understated: float = 1.0,
    wrong: float = 0.0,
    wrong_px: float = 8.0,
) -> tuple[Measurements, Stars]:
    """Stars and measurements; errors are `understated` times what they say, a share `wrong` is far off."""
    x, y = spots(rng, count, layout)
    share = np.sort(rng.uniform(0, 1, count))
    mag = 8.0 + 5.0 * share
    centroid = centroid_px[0] * (centroid_px[1] / centroid_px[0]) ** share
    catalog = catalog_arcsec[0] * (catalog_arcsec[1] / catalog_arcsec[0]) ** share
    ra, dec = camera.sky(x, y)
    dec_off = rng.normal(0, 1, count) * catalog * understated / 3600
    ra_off = rng.normal(0, 1, count) * catalog * understated / 3600 / np.cos(np.radians(dec))
    stars = stars_at((ra + ra_off) % 360.0, dec + dec_off, sigma_arcsec=catalog, mag=mag)
    dx, dy = rng.normal(0, 1, (2, count)) * centroid * understated
    bad = rng.choice(count, round(wrong * count), replace=False)
    reach, angle = wrong_px * np.sqrt(rng.uniform(0.1, 1, bad.size)), rng.uniform(0, 2 * np.pi, bad.size)
    dx[bad] += reach * np.cos(angle)
    dy[bad] += reach * np.sin(angle)
    return measurements_at(x + dx, y + dy, centroid, mag), stars


def grown(
    measurements: Measurements,
    stars: Stars,
    start: Plate,
    *,
    strobe_px: float = 10.0,
    settings: IdentificationSettings | None = None,
) -> Reference | None:
    """The reference that grows from a plate."""
    every = np.arange(len(measurements))
    return Selection(measurements, every, stars, settings or IdentificationSettings()).grow(start, strobe_px)


def field_errors_px(plate: Plate, camera: Camera) -> Array:
    """Distances (px) between a plate and the truth at 100 points all over the frame."""
    x, y = (
        side.ravel() for side in np.meshgrid(np.linspace(0, WIDTH - 1, 10), np.linspace(0, HEIGHT - 1, 10))
    )
    xi, eta = plate.tangential(x, y)
    true_xi, true_eta = plate.project(*camera.sky(x, y))
    return np.asarray(np.hypot(xi - true_xi, eta - true_eta) / camera.scale)
