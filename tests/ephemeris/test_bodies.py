"""Bodies of the solar system: against skyfield, at the ends of the excerpt, and where formulas stand in."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from skyfield.api import Loader, load_file, wgs84

from mountnav.ephemeris import SolarSystemBody, sky_rates
from mountnav.errors import BadRequest
from mountnav.sky import kernel, planets
from mountnav.sky.coordinates import Icrs
from mountnav.sky.jupiter_moons import MOONS, SIGMA_ARCSEC, from_barycenter_km
from mountnav.sky.kernel import SHIPPED_PATH, Kernel, use_kernels
from mountnav.sky.planets import BODIES, position_of_body, sigma_of_body_arcsec
from mountnav.sky.sphere import separation_arcsec
from tests.ephemeris.samples import SITE

IN_SKYFIELD = {
    name: f"{name} barycenter" for name in ("mars", "jupiter", "saturn", "uranus", "neptune", "pluto")
}


@pytest.mark.parametrize("name", BODIES)
def test_bodies_stand_where_skyfield_has_them(name: str, tmp_path: Path) -> None:
    timescale = Loader(tmp_path).timescale(builtin=True)
    ephemeris = load_file(str(SHIPPED_PATH))
    here = ephemeris["earth"] + wgs84.latlon(SITE.latitude_deg, SITE.longitude_deg, SITE.height_m)
    worst = 0.0
    # to 2026: later skyfield guesses another rotation of the Earth, which moves the Moon by 0.5″
    for day in np.random.default_rng(1).uniform(1.0, 4100.0, 12):
        utc = datetime(2015, 1, 2, tzinfo=UTC) + timedelta(days=float(day))
        ra, dec, _ = (
            here.at(timescale.from_datetime(utc)).observe(ephemeris[IN_SKYFIELD.get(name, name)]).radec()
        )
        there = Icrs(float(ra.hours) * 15.0, float(dec.degrees))
        worst = max(worst, separation_arcsec(there, position_of_body(name, utc, SITE)))
    ephemeris.close()
    assert worst < (0.02 if name == "moon" else 0.005)


@pytest.mark.parametrize("year", [1990, 2014, 2056])
def test_outside_of_the_excerpt_formulas_stand_in_and_say_so(year: int) -> None:
    utc = datetime(year, 6, 1, tzinfo=UTC)
    assert sigma_of_body_arcsec("saturn", utc) > 10.0
    assert position_of_body("saturn", utc, SITE)
    with pytest.raises(BadRequest, match="no ephemeris on this machine has Pluto"):
        position_of_body("pluto", utc, SITE)


def test_formulas_and_excerpt_agree_within_what_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    utc = datetime(2026, 3, 1, 5, tzinfo=UTC)
    good = {name: position_of_body(name, utc, SITE) for name in BODIES if name != "pluto"}
    monkeypatch.setattr(planets, "has_body", lambda number, jd: False)
    for name, place in good.items():
        off = separation_arcsec(place, position_of_body(name, utc, SITE))
        # what is told of formulas is half of their worst
        assert off < 2.5 * sigma_of_body_arcsec(name, utc), name


@pytest.mark.parametrize("name", BODIES[:-1])
def test_at_the_ends_of_the_excerpt_the_source_changes_and_is_told(name: str) -> None:
    body = SolarSystemBody(name)
    for edge, inward in ((datetime(2015, 1, 1, tzinfo=UTC), 1), (datetime(2055, 1, 1, tzinfo=UTC), -1)):
        inside, outside = edge + timedelta(days=2 * inward), edge - timedelta(days=2 * inward)
        assert body.sigma_arcsec(inside) <= 0.1
        assert body.sigma_arcsec(outside) >= 0.02
        # Mercury goes 2° a day at most, the Moon 15°
        apart = separation_arcsec(body.icrs(inside, SITE), body.icrs(outside, SITE))
        assert apart < 4.0 * 3600.0 * (16.0 if name == "moon" else 2.3)


def test_the_moon_moves_as_fast_as_it_does() -> None:
    rates = sky_rates(SolarSystemBody("moon"), datetime(2026, 3, 1, 5, tzinfo=UTC), SITE)
    # half a degree an hour, less the observer's own way below it
    assert 0.2 < rates.total_arcsec_s < 0.7


def test_an_unknown_body_is_refused() -> None:
    with pytest.raises(BadRequest, match="no body"):
        SolarSystemBody("vulcan")
    # its name is known, and nothing here has it
    with pytest.raises(BadRequest, match=r"import one that has: mountnav ephemeris import FILE\.bsp"):
        SolarSystemBody("titan").icrs(datetime(2026, 3, 1, tzinfo=UTC), SITE)


def test_an_imported_file_goes_before_the_shipped_one(tmp_path: Path) -> None:
    copy = tmp_path / "other.bsp"
    shutil.copy(SHIPPED_PATH, copy)
    try:
        use_kernels([Kernel(copy)])
        assert kernel.kernels_in_use()[0].path == copy
        assert position_of_body("mars", datetime(2026, 3, 1, tzinfo=UTC), SITE)
    finally:
        use_kernels(())


@pytest.mark.parametrize("size", [0, 3, 1024, 5000, 200_000])
def test_a_cut_file_is_refused_or_whole(tmp_path: Path, size: int) -> None:
    cut = tmp_path / "cut.bsp"
    cut.write_bytes(SHIPPED_PATH.read_bytes()[:size])
    with pytest.raises(BadRequest, match=r"cut\.bsp"):
        Kernel(cut)


def test_a_file_of_anything_else_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.bsp"
    other.write_bytes(b"DAF/SPK " + bytes(range(256)) * 20)
    with pytest.raises(BadRequest, match=r"other\.bsp"):
        Kernel(other)
    with pytest.raises(BadRequest, match="can't be read"):
        Kernel(tmp_path / "none.bsp")


def test_an_imported_file_has_the_satellites_of_jupiter(tmp_path: Path) -> None:
    path = Path(__file__).parent / "data" / "jup310_two_days.bsp"
    timescale = Loader(tmp_path).timescale(builtin=True)
    loaded = load_file(str(path))
    planets_by = load_file(str(SHIPPED_PATH))
    here = planets_by["earth"] + wgs84.latlon(SITE.latitude_deg, SITE.longitude_deg, SITE.height_m)
    utc = datetime(2015, 3, 3, 14, tzinfo=UTC)
    before = sigma_of_body_arcsec("jupiter", utc)
    try:
        use_kernels([Kernel(path)])
        for name in ("io", "europa", "ganymede", "callisto", "jupiter"):
            way = (
                loaded["jupiter barycenter"]
                + loaded.segments[
                    next(n for n, one in enumerate(loaded.segments) if one.target == kernel.NAIF_IDS[name])
                ]
            )
            ra, dec, _ = here.at(timescale.from_datetime(utc)).observe(way).radec()
            there = Icrs(float(ra.hours) * 15.0, float(dec.degrees))
            # the file's Jupiter is of another ephemeris than the shipped Earth
            assert separation_arcsec(there, SolarSystemBody(name).icrs(utc, SITE)) < 0.1
            assert SolarSystemBody(name).sigma_arcsec(utc) <= 0.02
        # the planet itself is in it too, beside its system's barycenter
        assert sigma_of_body_arcsec("jupiter", utc) < before
        with pytest.raises(BadRequest, match="no ephemeris on this machine has Thebe"):
            SolarSystemBody("thebe").icrs(utc + timedelta(days=5), SITE)
    finally:
        use_kernels(())
        loaded.close()
        planets_by.close()


@pytest.mark.parametrize("name", MOONS)
def test_the_moons_of_jupiter_without_an_import_are_where_jpl_has_them(name: str) -> None:
    table = Kernel(Path(__file__).parent / "data" / "jup310_two_days.bsp")
    way = next(one for one in table.segments if one.target == kernel.NAIF_IDS[name])
    for jd in (2457084.1, 2457084.6, 2457085.3):
        off_km = float(np.linalg.norm(from_barycenter_km(name, jd) - way.state(jd, 0.0)[0]))
        # at opposition, 4.2 au away
        assert off_km / (4.2 * 149_597_870.7) * 206_265.0 < 1.1 * SIGMA_ARCSEC[name]
    utc = datetime(2026, 11, 26, 3, tzinfo=UTC)
    apart = separation_arcsec(position_of_body(name, utc, SITE), position_of_body("jupiter", utc, SITE))
    assert 1.0 < apart < 660.0
    assert sigma_of_body_arcsec(name, utc) == SIGMA_ARCSEC[name]
    with pytest.raises(BadRequest, match=f"no ephemeris on this machine has {name.capitalize()}"):
        position_of_body(name, datetime(2060, 1, 1, tzinfo=UTC), SITE)
