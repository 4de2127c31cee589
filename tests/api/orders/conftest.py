"""A list of jobs without a service."""

from __future__ import annotations

import pytest

from api.events import Events
from api.orders.jobs import Jobs


@pytest.fixture
def jobs() -> Jobs:
    return Jobs(Events(100), kept=10)
