"""Targets of all kinds become the ICRS place of this moment; what makes no sense is refused at once."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from api.orders.job_views import JobView
from api.orders.targets import AltAzTarget, ApparentTarget, IcrsTarget, NamedTarget, Tagged, Target, icrs_of
from api.orders.vocabulary import (
    JOB_EXAMPLES,
    KINDS,
    PLACE_EXAMPLES,
    CenterBody,
    CenterOrder,
    Order,
    SlewBody,
    SlewOrder,
    role_for,
)
from mountnav.sky.chain import icrs_to_apparent, icrs_to_observed
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.sky.sphere import separation_arcsec

SITE = Site(47.0, 11.0, 600.0)
AIR = Air(pressure_hpa=940.0)
NOW = datetime(2026, 11, 22, 2, 30, tzinfo=UTC)
TARGETS: TypeAdapter[Target] = TypeAdapter(Target)
ORDERS: TypeAdapter[Order] = TypeAdapter(Order)

ra = st.floats(0, 359.999)
dec = st.floats(-89.9, 89.9)


@pytest.mark.long
@given(ra, dec)
def test_icrs_stays_and_apparent_comes_back(ra_deg: float, dec_deg: float) -> None:
    here = Icrs(ra_deg, dec_deg)
    assert icrs_of(IcrsTarget(ra_deg=ra_deg, dec_deg=dec_deg), NOW, SITE, AIR) == here
    of_date = icrs_to_apparent(here, NOW)
    found = icrs_of(ApparentTarget(ra_deg=of_date.ra_deg, dec_deg=of_date.dec_deg), NOW, SITE, AIR)
    assert separation_arcsec(found, here) < 0.001


@given(st.floats(10, 89.9), st.floats(0, 359.999))
def test_a_direction_is_the_place_that_stands_there(alt_deg: float, az_deg: float) -> None:
    found = icrs_of(AltAzTarget(alt_deg=alt_deg, az_deg=az_deg), NOW, SITE, AIR)
    seen = icrs_to_observed(found, NOW, SITE, AIR)
    assert separation_arcsec(Icrs(seen.az_deg, seen.alt_deg), Icrs(az_deg, alt_deg)) < 0.01


def test_a_star_is_taken_to_the_present_by_its_motion() -> None:
    # Barnard's star: 10.36″ a year, 26.9 years after 2000
    star = IcrsTarget(
        ra_deg=269.452,
        dec_deg=4.693,
        pm_ra_cosdec_masyr=-799.0,
        pm_dec_masyr=10_328.0,
        parallax_mas=547.0,
        epoch_yr=2000.0,
    )
    found = icrs_of(star, NOW, SITE, AIR)
    assert (found.dec_deg - 4.693) * 3600.0 == pytest.approx(26.89 * 10.328, abs=0.2)
    named = icrs_of(NamedTarget(name="Barnard's Star"), NOW, SITE, AIR)
    assert separation_arcsec(found, named) < 2.0
    assert found == icrs_of(star, NOW, SITE, AIR)


def test_a_typed_position_is_read_before_a_job_begins() -> None:
    asked = TARGETS.validate_python({"kind": "typed", "text": "12h30m, -10°30′"})
    assert icrs_of(asked, NOW, SITE, AIR) == Icrs(187.5, -10.5)
    of_date = TARGETS.validate_python({"kind": "typed", "text": "12h30m, -10°30′", "frame": "jnow-apparent"})
    assert icrs_of(of_date, NOW, SITE, AIR) == icrs_of(
        ApparentTarget(ra_deg=187.5, dec_deg=-10.5), NOW, SITE, AIR
    )
    for lone in ("12h30m", "10:30", "12 -30"):
        with pytest.raises(ValidationError, match=r"Declination is missing|hours or degrees"):
            TARGETS.validate_python({"kind": "typed", "text": lone})


def test_names_are_checked_before_a_job_begins() -> None:
    assert isinstance(TARGETS.validate_python({"kind": "name", "name": "jupiter"}), NamedTarget)
    with pytest.raises(ValidationError, match="Betelgeuse"):
        TARGETS.validate_python({"kind": "name", "name": "Betelgeu"})


@pytest.mark.parametrize(
    "wrong",
    [
        {"ra_deg": 1.0, "dec_deg": 1.0},
        {"kind": "icrs", "ra_deg": float("nan"), "dec_deg": 1.0},
        {"kind": "icrs", "ra_deg": float("inf"), "dec_deg": 1.0},
        {"kind": "icrs", "ra_deg": True, "dec_deg": 1.0},
        {"kind": "icrs", "ra_deg": "1", "dec_deg": 1.0},
        {"kind": "icrs", "ra_deg": 360.0, "dec_deg": 1.0},
        {"kind": "icrs", "ra_deg": -0.1, "dec_deg": 1.0},
        {"kind": "icrs", "ra_deg": 1.0, "dec_deg": 90.01},
        {"kind": "icrs", "ra_deg": 1.0, "dec_deg": 1.0, "epoch_yr": 1.0},
        {"kind": "icrs", "ra_deg": 1.0, "dec_deg": 1.0, "parallax_mas": -1.0},
        {"kind": "icrs", "ra_deg": 1.0, "dec_deg": 1.0, "alt_deg": 1.0},
        {"kind": "apparent", "ra_deg": 1.0},
        {"kind": "altaz", "alt_deg": 1.0, "az_deg": 360.0},
        {"kind": "tle", "name": "ISS"},
    ],
)
def test_what_makes_no_sense_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        TARGETS.validate_python(wrong)


def test_each_kind_is_in_the_union_and_says_its_kind() -> None:
    needed: dict[str, dict[str, Any]] = {
        "slew": {"target": {"kind": "name", "name": "Vega"}},
        "center": {"target": {"kind": "name", "name": "Vega"}},
        "sync-to": {"target": {"kind": "name", "name": "Vega"}},
        "flip": {"target": {"kind": "name", "name": "Vega"}},
        "follow": {"target": {"kind": "name", "name": "Moon"}, "duration_s": 60.0},
        "offset": {"east_arcsec": 1.0, "north_arcsec": 1.0},
        "tracking": {"on": True},
        "guide": {"direction": "n", "duration_s": 1.0},
        "offset-rates": {"ra_arcsec_s": 0.1, "dec_arcsec_s": 0.0},
        "move-axis": {"axis": "primary", "rate_deg_s": 0.1},
        "rotate": {"position_angle_deg": 10.0},
        "mosaic": {"target": {"kind": "name", "name": "Vega"}, "across": 2, "down": 1},
        "spiral-search": {"target": {"kind": "name", "name": "Vega"}},
    }
    for kind, body in KINDS.items():
        order = ORDERS.validate_python({"kind": kind, **needed.get(kind, {})})
        assert type(order) is body
        assert order.kind == kind
        assert issubclass(body, Tagged)
        assert body.model_json_schema()["required"][0] == "kind"


def test_what_overrules_the_guards_needs_more_than_to_operate() -> None:
    roles = {
        str(role_for(ORDERS.validate_python(body)))
        for body in ({"kind": "trust"}, {"kind": "model-run", "put_in_force": True})
    }
    assert roles == {"configure"}
    assert str(role_for(ORDERS.validate_python({"kind": "model-run"}))) == "operate"
    assert str(role_for(SlewOrder(target=NamedTarget(name="Vega")))) == "operate"


def test_the_examples_of_the_description_are_orders() -> None:
    for name, example in JOB_EXAMPLES.items():
        assert ORDERS.validate_python(example["value"]).kind == example["value"]["kind"], name
    for example in PLACE_EXAMPLES.values():
        assert SlewBody.model_validate(example["value"]).order(SlewOrder).kind == "slew"
        assert CenterBody.model_validate(example["value"]).order(CenterOrder).kind == "center"


def test_a_job_is_described_with_the_kinds_of_orders() -> None:
    assert JobView.model_json_schema()["properties"]["kind"]["enum"] == list(KINDS)
