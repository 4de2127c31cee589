"""The reproduction of Table 1 on two small frames: the parts are what they are said to be, and add up."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from benchmarks.table1 import Reduced, exact_places, joined, reduced, report
from mountnav.catalog.embedded import embedded_catalog
from mountnav.simulation.catalog_errors import ErringCatalog
from mountnav.simulation.optics import SimulatedOptics, optics_preset
from mountnav.simulation.render import project
from mountnav.sky.coordinates import Icrs

WHEN = datetime(2013, 6, 15, tzinfo=UTC)
# ISON-NM's field with a quarter of its pixels
SMALL = replace(
    optics_preset("ison-nm"), width_px=1024, height_px=1024, scale_arcsec_px=6.2, zero_point_mag=21.0
)


@pytest.fixture(scope="module")
def done() -> list[Reduced]:
    sky = ErringCatalog(embedded_catalog(), seed=1)
    frames = [
        reduced(number, SMALL, embedded_catalog(), sky, WHEN, Icrs(300.0, 35.0 + number)) for number in (1, 2)
    ]
    reduced_frames = [one for one in frames if not isinstance(one, str)]
    assert len(reduced_frames) == len(frames), frames
    return reduced_frames


@pytest.mark.parametrize("parity", [1, -1])
@pytest.mark.parametrize("distortion", [0.0, 2e-10, -3e-9])
def test_exact_places_invert_the_drawing(parity: int, distortion: float) -> None:
    optics: SimulatedOptics = replace(SMALL, parity=parity, distortion_px2=distortion, rotation_deg=71.0)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-20, 1044, (2, 50))
    x[0] = y[0] = 511.5
    center = Icrs(0.3, 88.0)
    back = project(center, optics, *exact_places(center, optics, x, y))
    assert back[0] == pytest.approx(x, abs=1e-6)
    assert back[1] == pytest.approx(y, abs=1e-6)


@pytest.mark.long
def test_parts_add_up_and_are_of_the_right_size(done: list[Reduced]) -> None:
    parts = joined([one.parts for one in done])
    assert len(parts.sigma) > 300
    assert parts.centroid + parts.catalog + parts.model == pytest.approx(parts.total, abs=1e-5)
    # the catalog's part is the stated error, but for the pairs that K_rej took
    assert 0.85 < np.sqrt(np.mean((parts.catalog / parts.sigma[:, None]) ** 2)) < 1.05
    # the centroid's is far below a pixel, the plate's far below the catalog's
    assert np.median(np.abs(parts.centroid)) < 0.02 * SMALL.scale_arcsec_px
    assert parts.model.std() < 0.5 * parts.catalog.std()
    assert max(one.center_error_px for one in done) < 0.05
    found = np.concatenate(
        [np.column_stack((d.ra_arcsec, d.dec_arcsec)) for d in (one.deviations for one in done)]
    )
    assert found == pytest.approx(parts.total, abs=1e-9)


def test_the_number_fixes_the_frame(done: list[Reduced]) -> None:
    sky = ErringCatalog(embedded_catalog(), seed=1)
    again = reduced(1, SMALL, embedded_catalog(), sky, WHEN, Icrs(300.0, 36.0))
    assert isinstance(again, Reduced)
    assert np.array_equal(again.parts.total, done[0].parts.total)


def test_the_report_holds_the_papers_figures_and_ours(done: list[Reduced]) -> None:
    text = report(done, ["too few stars measured"], WHEN, 1.0, 1.0)
    assert "2 frames of 3 solved" in text
    assert "refused: too few stars measured" in text
    rows = [line.split("|")[1:-1] for line in text.splitlines() if line.startswith("| 0 %")]
    assert [row[1].strip() for row in rows] == ["ΔRA cos δ ″", "ΔDec ″", "Δmag"]
    assert [row[-1].strip() for row in rows] == ["0.08", "0.07", "0.38"]
    ours = np.concatenate([one.deviations.ra_arcsec for one in done])
    assert float(rows[0][4]) == pytest.approx(ours.std(ddof=1), abs=6e-4)
    assert int(rows[0][2]) == ours.size
