"""The table of terms against rotations made from scratch here, and against the rigorous form."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mountnav.errors import BadRequest
from mountnav.pointing.model.rigorous import direction, geometry, seen_from, tangent
from mountnav.pointing.model.terms import ALTAZ, EQUATORIAL, ZERO_POINTS, basis, candidates, term
from mountnav.units import RAD_PER_ARCSEC

LATITUDE = math.radians(48.93)
turns = st.floats(-180.0, 180.0)
declinations = st.floats(-89.0, 269.0)
GEOMETRIC = {
    "equatorial": ("IH", "ID", "CH", "NP", "ME", "MA", "TF", "TX"),
    "altaz": ("IA", "IE", "CA", "NPAE", "AN", "AW", "TF", "TX"),
}


def moved(kind, coefficients, lon, lat):
    """Where rigorous rotations move a place to: (ξ, η) in arcsec, by differences of vectors."""
    lon, lat = np.array([lon]), np.array([lat])
    with_errors = seen_from(geometry(kind, LATITUDE, coefficients), lon, lat)
    perfect = seen_from(geometry(kind, LATITUDE, {}), lon, lat)
    xi, eta = tangent(lon, lat)
    off = with_errors - perfect
    return np.array([np.sum(off * xi), np.sum(off * eta)]) / RAD_PER_ARCSEC


@pytest.mark.long
@pytest.mark.parametrize("kind", ["equatorial", "altaz"])
@settings(max_examples=40, deadline=None)
@given(lon=turns, lat=declinations)
def test_the_table_is_the_jacobian_of_the_rotations(kind, lon, lat):
    lon, lat = math.radians(lon), math.radians(lat)
    up = math.sin(lat)
    if kind == "equatorial":
        up = math.sin(LATITUDE) * up + math.cos(LATITUDE) * math.cos(lat) * math.cos(lon)
    for name in GEOMETRIC[kind]:
        if name == "TX" and up < 0.1:
            continue  # held there
        table = basis(kind, [name], np.array([lon]), np.array([lat]), LATITUDE)[0, :, 0]
        # central difference: what is quadratic in the coefficient cancels
        rigorous = (moved(kind, {name: 1.0}, lon, lat) - moved(kind, {name: -1.0}, lon, lat)) / 2.0
        assert rigorous == pytest.approx(table, abs=2e-4), name


@pytest.mark.long
@pytest.mark.parametrize("kind", ["equatorial", "altaz"])
@settings(max_examples=25, deadline=None)
@given(lon=turns, lat=st.floats(-85.0, 85.0), beyond=st.booleans())
def test_empirical_terms_act_as_the_table_says(kind, lon, lat, beyond):
    lon, lat = math.radians(lon), math.radians(180.0 - lat if beyond else lat)
    for name in candidates(kind):
        if name == "TX":
            continue
        table = basis(kind, [name], np.array([lon]), np.array([lat]), LATITUDE)[0, :, 0]
        rigorous = (moved(kind, {name: 1.0}, lon, lat) - moved(kind, {name: -1.0}, lon, lat)) / 2.0
        assert rigorous == pytest.approx(table, abs=2e-4), name


def around(axis, angle_arcsec, vector):
    return Rotation.from_rotvec(np.array(axis, dtype=float) * angle_arcsec * RAD_PER_ARCSEC).apply(vector)


@given(h=turns, dec=st.floats(-80.0, 80.0))
def test_a_raised_polar_axis_and_one_east_of_the_pole(h, dec):
    """ME and MA by what they mean, in axes of the horizon: x south, y west, z up."""
    h, dec = math.radians(h), math.radians(dec)
    pole = np.array([-math.cos(LATITUDE), 0.0, math.sin(LATITUDE)])
    south = np.array([math.sin(LATITUDE), 0.0, math.cos(LATITUDE)])
    west = np.array([0.0, 1.0, 0.0])
    place = math.cos(dec) * math.cos(h) * south + math.cos(dec) * math.sin(h) * west + math.sin(dec) * pole
    xi = -math.sin(h) * south + math.cos(h) * west
    eta = -math.sin(dec) * (math.cos(h) * south + math.sin(h) * west) + math.cos(dec) * pole
    # ME > 0: the whole mount turned about the east-west line such that a star on the meridian, dec 0, is
    # seen higher; MA > 0: such that a star in the west, on the equator, is seen nearer the pole
    for name, axis in (("ME", np.cross(south, pole)), ("MA", np.cross(west, pole))):
        off = (around(axis, 1.0, place) - place) / RAD_PER_ARCSEC
        table = basis("equatorial", [name], np.array([h]), np.array([dec]), LATITUDE)[0, :, 0]
        assert [off @ xi, off @ eta] == pytest.approx(table, abs=2e-4)


def test_signs_that_others_mix_up():
    at = {"lon_rad": np.array([math.radians(30.0)]), "lat_rad": np.array([math.radians(40.0)])}
    through = {"lon_rad": at["lon_rad"] + math.pi, "lat_rad": math.pi - at["lat_rad"]}
    names = ("CH", "NP", "ID", "IH", "ME", "MA", "TF")
    normal = basis("equatorial", names, **at, site_latitude_rad=LATITUDE)[0]
    # the axes' ξ and η point the other way round when the tube looks at the same place through the pole
    beyond = -basis("equatorial", names, **through, site_latitude_rad=LATITUDE)[0]
    for k, name in enumerate(names):
        flips = name in ("CH", "NP", "ID")
        assert beyond[:, k] == pytest.approx(-normal[:, k] if flips else normal[:, k]), name
    alt = basis("altaz", ("CA", "IA", "AN", "AW"), **at, site_latitude_rad=LATITUDE)[0]
    sa, ca, se = math.sin(math.radians(30)), math.cos(math.radians(30)), math.sin(math.radians(40))
    assert (
        pytest.approx(np.array([[-1, 0], [-math.cos(math.radians(40)), 0], [-sa * se, -ca], [-ca * se, sa]]))
        == alt.T
    )


def test_names():
    assert set(EQUATORIAL) >= {
        "IH",
        "ID",
        "CH",
        "NP",
        "ME",
        "MA",
        "TF",
        "TX",
        "FO",
        "DAF",
        "HCES",
        "HCEC",
        "DCES",
        "DCEC",
    }
    assert set(ALTAZ) >= {"IA", "IE", "CA", "NPAE", "AN", "AW", "TF", "TX", "ACES", "ACEC"}
    lon, lat = np.array([0.4]), np.array([0.3])
    told: dict[tuple[Any, str], tuple[float, float]] = {
        ("equatorial", "HHSH2"): (math.sin(0.8) * math.cos(0.3), 0),
        ("equatorial", "HDCH3"): (0, math.cos(1.2)),
        ("equatorial", "HXSH2CD"): (math.sin(0.8) * math.cos(0.3), 0),
        ("altaz", "HASA2"): (math.sin(0.8) * math.cos(0.3), 0),
        ("altaz", "HVCA2"): (math.cos(0.8), 0),
        ("altaz", "HZSA3"): (0, math.sin(1.2)),
        ("altaz", "HZSE2"): (0, math.sin(0.6)),
    }
    for (kind, name), value in told.items():
        assert basis(kind, [name], lon, lat, LATITUDE)[0, :, 0] == pytest.approx(value)
    unknown: tuple[tuple[Any, str], ...] = (
        ("equatorial", "CA"),
        ("altaz", "CH"),
        ("equatorial", "HQSH2"),
        ("equatorial", "HHSA2"),
        ("altaz", "HASA0"),
        ("equatorial", "ih"),
        ("equatorial", ""),
    )
    for kind, name in unknown:
        with pytest.raises(BadRequest, match="not a term"):
            term(kind, name)


@pytest.mark.parametrize("kind", ["equatorial", "altaz"])
def test_no_two_candidates_are_the_same(kind):
    """Such a pair could not be fitted together."""
    rng = np.random.default_rng(5)
    lat = rng.uniform(0.1, 1.4, 400)
    f = basis(kind, (*ZERO_POINTS[kind], *candidates(kind)), rng.uniform(-3, 3, 400), lat, LATITUDE)
    columns = f.reshape(800, -1) / np.linalg.norm(f.reshape(800, -1), axis=0)
    overlap = np.abs(columns.T @ columns) - np.eye(columns.shape[1])
    assert overlap.max() < 0.999


def test_direction_is_what_it_says():
    assert direction(np.array([0.0]), np.array([0.0]))[0] == pytest.approx([1, 0, 0])
    assert direction(np.array([np.pi / 2]), np.array([0.0]))[0] == pytest.approx([0, 1, 0])
    assert direction(np.array([1.0]), np.array([np.pi / 2]))[0] == pytest.approx([0, 0, 1])
