"""Targets that move, as orders name them: read at once, bounded, refused before a job begins."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from api.orders.targets import (
    AltAzTarget,
    AnyTarget,
    IcrsTarget,
    NamedTarget,
    Target,
    ephemeris_of,
    icrs_of,
    moves,
    require_filter,
    require_place,
)
from mountnav.ephemeris.imported import import_file, use_imports
from mountnav.errors import BadRequest, OutsideLimits
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.sky.kernel import use_kernels
from mountnav.sky.sphere import separation_arcsec
from tests.ephemeris.samples import CERES_2025, HALLEY, ISS
from tests.ephemeris.test_tables import BEGIN, horizons

SITE = Site(47.0, 11.0, 600.0)
AIR = Air(pressure_hpa=940.0)
NOW = datetime(2026, 11, 22, 2, 30, tzinfo=UTC)
TARGETS: TypeAdapter[Any] = TypeAdapter(Target)

RATES = {
    "kind": "rates",
    "begins_utc": "2026-11-22T02:00:00Z",
    "ends_utc": "2026-11-22T04:00:00+00:00",
    "ra_deg": 100.0,
    "dec_deg": 20.0,
    "ra_arcsec_s": 2.0,
    "dec_arcsec_s": -1.0,
}
OVER_HORIZON = {
    "kind": "rates",
    "begins_utc": "2026-11-22T02:00:00Z",
    "ends_utc": "2026-11-22T04:00:00Z",
    "az_deg": 100.0,
    "alt_deg": 40.0,
    "az_arcsec_s": 0.0,
    "alt_arcsec_s": 1.0,
}
PATH = {
    "kind": "path",
    "waypoints": [
        {"utc": "2026-11-22T02:00:00Z", "ra_deg": 10.0, "dec_deg": 20.0},
        {"utc": "2026-11-22T03:00:00Z", "ra_deg": 11.0, "dec_deg": 20.5},
    ],
}


def read(**told: Any) -> AnyTarget:
    return TARGETS.validate_json(json.dumps(told))  # type: ignore[no-any-return]


ALL = [
    RATES,
    OVER_HORIZON,
    PATH,
    {"kind": "satellite", "elements": ISS},
    {"kind": "elements", "elements": CERES_2025},
    {"kind": "elements", "elements": HALLEY},
    {"kind": "table", "table": horizons(csv=True, degrees=True, apparent=False, center="geocenter")},
    {"kind": "name", "name": "Mars"},
]


@pytest.mark.parametrize("told", ALL)
def test_each_kind_has_a_place_in_its_span_and_stays_the_same_when_it_is_kept(told: dict[str, Any]) -> None:
    target = read(**told)
    assert moves(target)
    found = ephemeris_of(target, NOW, SITE, AIR)
    utc = (
        NOW
        if found.begins_utc is None or found.ends_utc is None
        else found.begins_utc + (found.ends_utc - found.begins_utc) / 2
    )
    if found.ends_utc is not None and found.ends_utc - timedelta(days=365) > NOW:
        utc = NOW
    place = icrs_of(target, utc, SITE, AIR)
    assert 0.0 <= place.ra_deg < 360.0
    assert found.sigma_arcsec(utc) >= 0.0
    assert found.name
    # a job's request is kept as JSON, and read again as Python
    kept = json.loads(json.dumps(target.model_dump(exclude_none=True)))
    again = TARGETS.validate_python(kept)
    assert icrs_of(again, utc, SITE, AIR) == place


def test_what_stands_still_is_an_ephemeris_too() -> None:
    for target in (IcrsTarget(ra_deg=10.0, dec_deg=20.0), AltAzTarget(alt_deg=50.0, az_deg=100.0)):
        assert not moves(target)
        found = ephemeris_of(target, NOW, SITE, AIR)
        assert (
            found.icrs(NOW, SITE)
            == found.icrs(NOW + timedelta(hours=5), SITE)
            == icrs_of(target, NOW, SITE, AIR)
        )
    assert not moves(NamedTarget(name="Vega"))
    assert moves(NamedTarget(name="Moon"))


def test_rates_over_the_horizon_count_with_refraction() -> None:
    utc = datetime(2026, 11, 22, 3, tzinfo=UTC)
    seen = icrs_to_observed(icrs_of(read(**OVER_HORIZON), utc, SITE, AIR), utc, SITE, AIR)
    assert (seen.az_deg, seen.alt_deg) == (pytest.approx(100.0, abs=1e-5), pytest.approx(41.0, abs=1e-5))


@pytest.mark.parametrize(
    ("base", "change", "says"),
    [
        (RATES, {"ends_utc": "2026-11-22T04:00:00"}, "time zone"),
        (RATES, {"ends_utc": "tomorrow"}, "not a time such as"),
        (RATES, {"ends_utc": 1e9}, "string"),
        (RATES, {"ends_utc": "0001-01-01T00:00:00+23:59"}, "outside the years that are supported"),
        (RATES, {"ends_utc": "2026-11-22T01:00:00Z"}, "can't end"),
        (RATES, {"ends_utc": "2026-12-22T01:00:00Z"}, "too long"),
        (RATES, {"ra_arcsec_s": None}, "rates need all of"),
        (RATES, {"az_deg": 1.0}, "rates need all of"),
        (RATES, {"ra_arcsec_s": 1e6}, "less than or equal"),
        (RATES, {"dec_arcsec_s": 36_000.0}, "over the pole"),
        (RATES, {"more": 1}, "Extra inputs"),
        (RATES, {"name": ""}, "at least 1"),
        (PATH, {"waypoints": PATH["waypoints"][:1]}, "at least 2"),
        (PATH, {"waypoints": [*PATH["waypoints"], PATH["waypoints"][0]]}, "no later"),
        (
            PATH,
            {
                "waypoints": [
                    PATH["waypoints"][0],
                    {"utc": "2026-11-22T03:00:00Z", "az_deg": 1.0, "alt_deg": 2.0},
                ]
            },
            "Field required",
        ),
        (PATH, {"waypoints": [PATH["waypoints"][0]] * 2001}, "at most 2000"),
        ({"kind": "satellite"}, {"elements": "x" * 50_001}, "at most 50000"),
        ({"kind": "satellite"}, {"elements": "x"}, "not elements of an Earth satellite"),
        ({"kind": "satellite"}, {"elements": ISS.replace("51.6400", "51.6500")}, "checksum"),
        ({"kind": "satellite"}, {"elements": ISS + ISS}, "2 objects .* exactly one is needed"),
        ({"kind": "elements"}, {"elements": CERES_2025[:90]}, "letters"),
        ({"kind": "elements"}, {"elements": f"{CERES_2025}\n{HALLEY}"}, "2 objects .* exactly one is needed"),
        ({"kind": "table"}, {"table": "x" * 200_001}, "at most 200000"),
        ({"kind": "table"}, {"table": "utc,ra_deg\n"}, "observer|one of"),
        ({"kind": "table"}, {"table": "x", "made_for": "moon"}, "here"),
        ({"kind": "name"}, {"name": "no such thing"}, "mountnav ephemeris import"),
    ],
)
def test_what_is_no_target_is_refused_with_words(
    base: dict[str, Any], change: dict[str, Any], says: str
) -> None:
    with pytest.raises(ValidationError, match=says):
        read(**base | change)


@pytest.mark.long
@given(st.text(max_size=400))
def test_any_text_is_a_target_or_refused(text: str) -> None:
    for kind, key in (
        ("satellite", "elements"),
        ("elements", "elements"),
        ("table", "table"),
        ("name", "name"),
    ):
        with pytest.raises(ValidationError):
            read(kind=kind, **{key: text + "\x00?"})


def test_a_target_that_is_over_or_too_old_is_refused_before_a_job_begins() -> None:
    with pytest.raises(BadRequest, match=r"ends at 2026-11-22 04:00:00 UTC"):
        require_place(read(**RATES), NOW + timedelta(hours=5), SITE, AIR)
    with pytest.raises(BadRequest, match="its elements are of 2024-06-18"):
        require_place(read(kind="satellite", elements=ISS), NOW, SITE, AIR)
    # one that begins later may be waited for
    require_place(read(**RATES), NOW - timedelta(hours=5), SITE, AIR)
    require_place(IcrsTarget(ra_deg=1.0, dec_deg=2.0), NOW, SITE, AIR)
    table = horizons(csv=False, degrees=False, apparent=False, center="geocenter")
    with pytest.raises(BadRequest, match="ends at"):
        require_place(read(kind="table", table=table), NOW, SITE, AIR)
    require_place(read(kind="table", table=table), BEGIN + timedelta(hours=2), SITE, AIR)


def test_the_sun_wants_a_declared_filter() -> None:
    for name in ("Sun", "sun", " SUN"):
        with pytest.raises(OutsideLimits, match="without a solar filter"):
            require_filter(NamedTarget(name=name), solar_filter=False)
        require_filter(NamedTarget(name=name), solar_filter=True)
    require_filter(NamedTarget(name="Moon"), solar_filter=False)


@pytest.fixture
def with_ceres(tmp_path: Path) -> Iterator[None]:
    (tmp_path / "mpc.dat").write_text(CERES_2025)
    import_file(tmp_path / "mpc.dat", tmp_path / "imports")
    use_imports(tmp_path / "imports")
    yield
    use_imports()
    use_kernels(())


@pytest.mark.usefixtures("with_ceres")
def test_an_imported_name_is_a_target() -> None:
    by_name, by_line = NamedTarget(name="Ceres"), read(kind="elements", elements=CERES_2025)
    assert moves(by_name)
    assert icrs_of(by_name, NOW, SITE, AIR) == icrs_of(by_line, NOW, SITE, AIR)
    assert separation_arcsec(icrs_of(by_name, NOW, SITE, AIR), Icrs(0.0, 0.0)) > 1.0
