"""A server of stars; what it failed at before is forgotten."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from mountnav.catalog.online import catalog as rest
from tests.catalog.online.star_server import StarServer, star_server


@pytest.fixture
def server() -> Iterator[StarServer]:
    with star_server() as started:
        yield started


@pytest.fixture(autouse=True)
def _nobody_rests() -> Iterator[None]:
    rest._failures.clear()
    yield
    rest._failures.clear()
