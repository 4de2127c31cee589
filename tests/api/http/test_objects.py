"""GET /v1/objects: what is bundled, what was imported, and what has no place now."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from api.http.routes.objects import search_objects
from mountnav.ephemeris.imported import import_file, use_imports
from mountnav.settings.observatory import AirSettings, SiteSettings
from mountnav.sky.kernel import use_kernels
from tests.ephemeris.samples import CERES_2025, ISS, PALLAS_2024

SERVICE: Any = SimpleNamespace(
    settings=SimpleNamespace(site=SiteSettings(latitude_deg=47.0, longitude_deg=11.0), air=AirSettings())
)


@pytest.fixture(autouse=True)
def imported(tmp_path: Path) -> Iterator[None]:
    (tmp_path / "mpc.dat").write_text(f"{CERES_2025}\n{PALLAS_2024}\n")
    (tmp_path / "stations.txt").write_text(ISS)
    for name in ("mpc.dat", "stations.txt"):
        import_file(tmp_path / name, tmp_path / "imports")
    use_imports(tmp_path / "imports")
    yield
    use_imports()
    use_kernels(())


async def test_imported_objects_are_found_with_rate_and_sigma() -> None:
    (pallas,) = await search_objects(SERVICE, "pallas", 5)
    assert (pallas.name, pallas.kind, pallas.moves, pallas.problem) == (
        "2 Pallas",
        "minor-planet",
        True,
        None,
    )
    assert pallas.icrs.ra_deg is not None
    assert pallas.rate_arcsec_s is not None
    assert 0.0 < pallas.rate_arcsec_s < 0.1
    assert pallas.sigma_arcsec is not None
    assert 0.1 < pallas.sigma_arcsec < 10.0


async def test_planets_move_and_stars_dont() -> None:
    mars, *_ = await search_objects(SERVICE, "mars", 5)
    vega, *_ = await search_objects(SERVICE, "vega", 5)
    assert mars.moves
    assert mars.sigma_arcsec is not None
    assert mars.sigma_arcsec < 0.1
    assert (vega.moves, vega.rate_arcsec_s) == (False, None)


async def test_elements_that_are_too_old_are_told() -> None:
    (station,) = await search_objects(SERVICE, "ISS (Z", 5)
    assert (station.name, station.kind, station.icrs.ra_deg) == ("ISS (ZARYA)", "satellite", None)
    assert station.problem is not None
    assert "its elements are of 2024-06-18" in station.problem


async def test_bundled_ones_come_first_and_the_count_holds() -> None:
    found = await search_objects(SERVICE, "", 4)
    assert len(found) == 4
    assert "minor-planet" not in {one.kind for one in found}
    assert len(await search_objects(SERVICE, "p", 3)) == 3
