"""What the tests of series share: a small telescope, and frames of it wherever it looks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Catalog
from mountnav.frames import Frame
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs

OPTICS = SimulatedOptics(
    640, 480, 6.0, rotation_deg=12.0, distortion_px2=1e-8, faint_stars_deg2=150.0, sky_adu_s=10.0
)
START = datetime(2026, 11, 21, 20, tzinfo=UTC)
CENTER = Icrs(83.2, 21.4)

Draw = Callable[..., Frame]


@pytest.fixture(scope="session")
def catalog() -> Catalog:
    return embedded_catalog()


@pytest.fixture(scope="session")
def draw(catalog: Catalog) -> Draw:
    """Draw frame `number` of a series, one a minute, at a center."""

    def drawn(number: int, center: Icrs, optics: SimulatedOptics = OPTICS, **changes) -> Frame:
        frame = draw_frame(
            center,
            optics,
            catalog,
            exposure_s=10.0,
            mid_exposure_utc=START + timedelta(minutes=number),
            seed=(11, number),
            **changes,
        )
        return replace(frame, source=f"frame {number}")

    return drawn
