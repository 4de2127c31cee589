"""What the tests of the simulation share: a clock that stands until it is put on, a site, a catalog in memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from mountnav.catalog.stars import Stars
from mountnav.sky.coordinates import Icrs, Site


@dataclass
class HandClock:
    """A clock that is moved by hand."""

    now: datetime = field(default_factory=lambda: datetime(2026, 11, 21, 22, tzinfo=UTC))

    def __call__(self) -> datetime:
        return self.now

    def on(self, seconds: float) -> datetime:
        self.now += timedelta(seconds=seconds)
        return self.now


@dataclass
class MemoryCatalog:
    """A few stars round a place, moved by their proper motions from J2000."""

    ra_deg: np.ndarray
    dec_deg: np.ndarray
    mag: np.ndarray
    pm_ra: np.ndarray
    pm_dec: np.ndarray
    name: str = "memory"

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        years = (epoch_yr - 2000.0) / 3.6e6
        order = np.argsort(self.mag)
        ra = self.ra_deg + self.pm_ra * years / np.cos(np.radians(self.dec_deg))
        dec = self.dec_deg + self.pm_dec * years
        columns = (ra, dec, np.full(ra.size, 0.01), self.mag, self.pm_ra, self.pm_dec)
        return Stars(*(column[order] for column in columns), epoch_yr, "V", self.name)


def catalog_round(center: Icrs, *, n: int = 25, spread_deg: float = 0.6, pm: float = 0.0) -> MemoryCatalog:
    """Make `n` stars evenly strewn round a place (on a jittered grid, so that none are blended)."""
    rng = np.random.default_rng(3)
    side = int(np.ceil(np.sqrt(n)))
    gx, gy = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    step = 2.0 / side
    east = (gx.ravel()[:n] + rng.uniform(-0.2, 0.2, n) * step) * spread_deg
    north = (gy.ravel()[:n] + rng.uniform(-0.2, 0.2, n) * step) * spread_deg
    dec = center.dec_deg + north
    ra = (center.ra_deg + east / np.cos(np.radians(dec))) % 360.0
    return MemoryCatalog(ra, dec, rng.uniform(7.0, 9.0, n), np.full(n, pm), np.full(n, -pm))


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def site() -> Site:
    return Site(48.93, 22.27, 700.0)
