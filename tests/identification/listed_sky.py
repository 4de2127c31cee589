"""A camera that hands out star lists of the real sky: what it would measure, faults and truth included."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Hint
from mountnav.measuring.measurements import Measurements
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, gnomonic

EPOCH = 2026.0
JUNK = 30


def listed(x, y, flux, width, height, flags=None):
    order = np.argsort(-flux, kind="stable")
    x, y, flux = x[order], y[order], flux[order]
    one = np.ones(x.size)
    flags = np.zeros(x.size, dtype=np.int64) if flags is None else flags[order]
    return Measurements(
        x, y, 0.1 * one, 0.1 * one, flux, 0.01 * flux, 3 * one, 0 * one, flags, width, height, 100.0, 10.0
    )


@dataclass(frozen=True)
class Seen:
    measurements: Measurements
    center: Icrs
    scale: float
    rotation_deg: float
    parity: int
    stars: int


def seen(
    center,
    scale,
    rotation_deg,
    parity,
    rng,
    *,
    width=1000,
    height=800,
    depth=11.5,
    junk=JUNK,
    lost=0.1,
    noise=0.1,
):
    """Stars to `depth`: noise 0.1 px, a tenth lost, magnitudes off by 0.3, and sources that are no stars."""
    stars = embedded_catalog().cone(
        center, 0.51 * math.hypot(width, height) * scale / 3600, epoch_yr=EPOCH, mag_limit=depth
    )
    xi, eta = (
        np.degrees(np.asarray(v)) * 3600 / scale
        for v in gnomonic(stars.ra_deg, stars.dec_deg, center.ra_deg, center.dec_deg)
    )
    angle = math.radians(rotation_deg)
    # +y has position angle `rotation`; +x lies 90° clockwise of it as the sky is seen, hence west
    up = xi * math.sin(angle) + eta * math.cos(angle)
    right = -parity * (xi * math.cos(angle) - eta * math.sin(angle))
    x, y = right + (width - 1) / 2, up + (height - 1) / 2
    inside = (x > 0) & (x < width - 1) & (y > 0) & (y < height - 1)
    keep = inside & (rng.random(x.size) > lost)
    count = int(keep.sum())
    flux = 10 ** (-0.4 * (stars.mag[keep] - 20 + rng.normal(0, 0.3, count)))
    extra = rng.choice(flux, junk) if count else np.ones(junk)
    return Seen(
        listed(
            np.concatenate((x[keep] + rng.normal(0, noise, count), rng.uniform(0, width, junk))),
            np.concatenate((y[keep] + rng.normal(0, noise, count), rng.uniform(0, height, junk))),
            np.concatenate((flux, extra)),
            width,
            height,
        ),
        center,
        scale,
        rotation_deg,
        parity,
        int(inside.sum()),
    )


def galactic(l_deg, b_deg):
    """ICRS of galactic coordinates, by the rotation that defines them [Hipparcos vol. 1 §1.5.3]."""
    to_galactic = np.array(
        [
            [-0.0548755604, -0.8734370902, -0.4838350155],
            [0.4941094279, -0.4448296300, 0.7469822445],
            [-0.8676661490, -0.1980763734, 0.4559837762],
        ]
    )
    longitude, latitude = math.radians(l_deg), math.radians(b_deg)
    seen_from = np.array(
        [
            math.cos(latitude) * math.cos(longitude),
            math.cos(latitude) * math.sin(longitude),
            math.sin(latitude),
        ]
    )
    x, y, z = to_galactic.T @ seen_from
    return Icrs(math.degrees(math.atan2(y, x)) % 360, math.degrees(math.asin(z)))


def anywhere(rng):
    return Icrs(rng.uniform(0, 360), math.degrees(math.asin(rng.uniform(-1, 1))))


PLACES = {
    "anywhere": anywhere,
    "near the poles": lambda rng: Icrs(rng.uniform(0, 360), 89.9 * rng.choice((-1, 1))),
    "the seam at 0 h": lambda rng: Icrs(rng.uniform(-0.3, 0.3) % 360, rng.uniform(-70, 70)),
    "crowded Milky Way": lambda rng: galactic(rng.uniform(-90, 90) % 360, rng.uniform(-3, 3)),
    "galactic pole": lambda rng: galactic(rng.uniform(0, 360), rng.choice((-1, 1)) * rng.uniform(75, 90)),
}


def asked(rng, one, *, fields=0.5, spread=0.05, scale_known=True):
    """A hint that is off by up to `fields` shorter sides, and whose scale is known to ±`spread`."""
    side = min(one.measurements.width_px, one.measurements.height_px) * one.scale
    away, toward = fields * side * math.sqrt(rng.random()), rng.uniform(0, 2 * math.pi)
    place = displaced(one.center, away * math.cos(toward), away * math.sin(toward))
    middle = one.scale * (1 + 0.9 * spread * rng.uniform(-1, 1))
    low, high = (middle / (1 + spread), middle * (1 + spread)) if scale_known else (None, None)
    return Hint(place, max(0.1, fields * side / 3600), low, high)


def drawn(place, rng, **how):
    """A random orientation of a 1.1° × 0.9° field, unless told otherwise."""
    scale = how.pop("scale", 4.0)
    return seen(place(rng), scale, rng.uniform(0, 360), int(rng.choice((-1, 1))), rng, **how)
