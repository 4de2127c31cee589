"""The solver itself on frames with few stars: what the doctor's table of chances rests on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mountnav.catalog.doctor.counts import SOLVED_SHARE
from mountnav.catalog.stars import Stars
from mountnav.frames import Hint
from mountnav.identification.search import identify
from mountnav.measuring.measurements import Measurements
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, gnomonic_inverse, separation_arcsec

SIDE, SCALE, EPOCH = 1024, 0.66, 2026.0
FIELD_DEG = SIDE * SCALE / 3600.0
LOST, ARTIFACTS, FAINTER, NOISE_PX = 0.1, 10, 5, 0.1
AROUND = 12.0


class MadeUp:
    """Stars strewn round one frame, as dense as in it."""

    name = "made up"

    def __init__(self, ra_deg: np.ndarray, dec_deg: np.ndarray, mag: np.ndarray) -> None:
        self.ra_deg, self.dec_deg, self.mag = ra_deg, dec_deg, mag
        self.axes = self.vectors(ra_deg, dec_deg)

    @staticmethod
    def vectors(ra_deg: np.ndarray, dec_deg: np.ndarray) -> np.ndarray:
        ra, dec = np.radians(ra_deg), np.radians(dec_deg)
        return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        axis = self.vectors(np.array(center.ra_deg), np.array(center.dec_deg))
        near = axis @ self.axes >= math.cos(math.radians(radius_deg))
        if mag_limit is not None:
            near &= self.mag <= mag_limit
        rows = np.flatnonzero(near)
        rows = rows[np.argsort(self.mag[rows])]
        still = np.zeros(rows.size)
        return Stars(
            self.ra_deg[rows],
            self.dec_deg[rows],
            still + 0.05,
            self.mag[rows],
            still,
            still,
            epoch_yr,
            "V",
            self.name,
        )


def measured(x: np.ndarray, y: np.ndarray, flux: np.ndarray) -> Measurements:
    order = np.argsort(-flux, kind="stable")
    one = np.ones(x.size)
    return Measurements(
        x[order],
        y[order],
        NOISE_PX * one,
        NOISE_PX * one,
        flux[order],
        0.01 * flux[order],
        3 * one,
        0 * one,
        np.zeros(x.size, dtype=np.int64),
        SIDE,
        SIDE,
        100.0,
        10.0,
    )


def solved(count: int, rng: np.random.Generator) -> bool:
    """Draw a frame with so many catalog stars, and have it identified. A wrong answer is an error."""
    center = Icrs(rng.uniform(0, 360), math.degrees(math.asin(rng.uniform(-1, 1))))
    x, y = rng.uniform(0, SIDE - 1, (2, count))
    outside = rng.uniform(-AROUND / 2, AROUND / 2, (2, rng.poisson(count * AROUND**2)))
    outside = outside[:, np.abs(outside).max(axis=0) > 0.5]
    right = np.concatenate(((x - (SIDE - 1) / 2) * SCALE / 3600.0, outside[0] * FIELD_DEG))
    up = np.concatenate(((y - (SIDE - 1) / 2) * SCALE / 3600.0, outside[1] * FIELD_DEG))
    turn, parity = rng.uniform(0, 2 * math.pi), int(rng.choice((-1, 1)))
    xi = up * math.sin(turn) - parity * right * math.cos(turn)
    eta = up * math.cos(turn) + parity * right * math.sin(turn)
    ra, dec = gnomonic_inverse(np.radians(xi), np.radians(eta), center.ra_deg, center.dec_deg)
    mag = 12.0 + np.log10(rng.random(ra.size)) / 0.35
    seen = rng.random(count) > LOST
    flux = 10 ** (-0.4 * (mag[:count][seen] - 20 + rng.normal(0, 0.3, int(seen.sum()))))
    bright = rng.choice(flux, ARTIFACTS) if flux.size else np.ones(ARTIFACTS)
    faint = 10 ** (-0.4 * (12.0 - 20 + rng.uniform(0.2, 3.0, FAINTER * count)))
    others = rng.uniform(0, SIDE, (2, ARTIFACTS + FAINTER * count))
    noise = rng.normal(0, NOISE_PX, (2, int(seen.sum())))
    frame = measured(
        np.concatenate((x[seen] + noise[0], others[0])),
        np.concatenate((y[seen] + noise[1], others[1])),
        np.concatenate((flux, bright, faint)),
    )
    off, toward = 0.5 * FIELD_DEG * 3600 * math.sqrt(rng.random()), rng.uniform(0, 2 * math.pi)
    hint = Hint(
        displaced(center, off * math.cos(toward), off * math.sin(toward)),
        0.5 * FIELD_DEG,
        0.97 * SCALE,
        1.03 * SCALE,
    )
    got = identify(frame, MadeUp(ra, dec, mag), hint, epoch_yr=EPOCH, budget_s=20.0)
    if got.reference is None:
        return False
    assert separation_arcsec(got.reference.plate.center(), center) < SCALE
    return True


@pytest.mark.long
@pytest.mark.parametrize("count", [4, 5, 6, 7, 8, 10])
def test_frames_with_few_stars_are_solved_as_often_as_the_doctor_says(count: int) -> None:
    rng, tried = np.random.default_rng(40 + count), 30
    found = sum(solved(count, rng) for _ in range(tried))
    print(f"{count} stars: {found} of {tried} solved, the table says {SOLVED_SHARE[count]:.1%}")
    expected = tried * SOLVED_SHARE[count]
    spread = math.sqrt(expected * (1.0 - SOLVED_SHARE[count]))
    assert abs(found - expected) <= 3.0 * spread + 1.0
