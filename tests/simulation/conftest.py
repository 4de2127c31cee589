"""What the tests of the simulation share: a clock that stands until it is put on, a site."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import pytest

from mountnav.sky.coordinates import Site


@dataclass
class HandClock:
    """A clock that is moved by hand."""

    now: datetime = field(default_factory=lambda: datetime(2026, 11, 21, 22, tzinfo=UTC))

    def __call__(self) -> datetime:
        return self.now

    def on(self, seconds: float) -> datetime:
        self.now += timedelta(seconds=seconds)
        return self.now


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def site() -> Site:
    return Site(48.93, 22.27, 700.0)
