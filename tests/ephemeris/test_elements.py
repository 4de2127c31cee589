"""Two-body motion, integrated orbits, and how elements get old: against lists, tables and integrators."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from mountnav.ephemeris.any_text import read_elements
from mountnav.ephemeris.elements import (
    GM_SUN_AU3_DAY2,
    OrbitElements,
    OwnForces,
    by_mean_anomaly,
    two_body,
)
from mountnav.ephemeris.horizons import read_horizons
from mountnav.ephemeris.mpes import read_mpes
from mountnav.ephemeris.small_body import SmallBody, _Way
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.kernel import barycentric_state_km
from mountnav.sky.sphere import separation_arcsec
from mountnav.units import AU_KM
from tests.ephemeris.samples import (
    CERES_2023,
    CERES_2024,
    CERES_2025,
    GEOCENTER,
    HALLEY,
    HOWELL,
    PALLAS_2024,
    SITE,
    astroquery_file,
)

eccentricities = st.one_of(
    st.floats(0.0, 0.999), st.sampled_from([0.0, 1.0, 1.0 - 1e-12, 1.0 + 1e-12, 0.99999]), st.floats(1.0, 8.0)
)


@pytest.mark.long
@given(
    st.floats(0.01, 40.0),
    eccentricities,
    st.floats(0.0, math.pi),
    st.floats(0.0, 6.28),
    st.floats(0.0, 6.28),
    st.floats(-30_000.0, 30_000.0),
)
def test_two_body_motion_keeps_what_it_must(
    q: float, e: float, incl: float, node: float, peri: float, days: float
) -> None:
    place, velocity = two_body(q, e, incl, node, peri, days)
    r = float(np.linalg.norm(place))
    energy = float(velocity @ velocity) / 2.0 - GM_SUN_AU3_DAY2 / r
    assert energy == pytest.approx(
        -GM_SUN_AU3_DAY2 * (1.0 - e) / (2.0 * q), abs=1e-8 * GM_SUN_AU3_DAY2 / min(r, q)
    )
    spin = float(np.linalg.norm(np.cross(place, velocity)))
    assert spin == pytest.approx(math.sqrt(GM_SUN_AU3_DAY2 * q * (1.0 + e)), rel=1e-8)
    assert r >= q * (1.0 - 1e-9)
    # and it moves by its own velocity
    step = 1e-3 * r / float(np.linalg.norm(velocity))
    later, before = (two_body(q, e, incl, node, peri, days + sign * step)[0] for sign in (1, -1))
    assert np.allclose(
        (later - before) / (2.0 * step), velocity, rtol=1e-4, atol=1e-4 * np.linalg.norm(velocity)
    )


def _all_at_once(elements: OrbitElements, days: float) -> np.ndarray:
    """Another integration: all bodies at once, by each other's pull, from where DE440 has them at the epoch.

    Nothing is shared with the room but the beginning.
    """
    numbers = (10, 1, 2, 399, 301, 4, 5, 6, 7, 8, 9)
    masses = np.array(
        [
            2.9591220828411956e-04,
            4.9125001948893182e-11,
            7.2434523326441187e-10,
            8.8876924467071022e-10,
            1.0931894624024351e-11,
            9.5495488297258119e-11,
            2.8253458252257917e-07,
            8.4597059933762903e-08,
            1.2920265649682399e-08,
            1.5243573478851939e-08,
            2.1750964648933581e-12,
            0.0,
        ]
    )
    states = []
    for number in numbers:
        state = barycentric_state_km(number, elements.epoch_jd, 0.0)
        assert state is not None
        states.append(np.concatenate(state) / AU_KM)
    place, velocity = elements.heliocentric(elements.epoch_jd)
    states.append(np.concatenate((place, velocity)) + states[0])
    start = np.array(states)

    def pull(_: float, flat: np.ndarray) -> np.ndarray:
        at, moves = flat[:36].reshape(12, 3), flat[36:].reshape(12, 3)
        apart = at[None] - at[:, None]
        cubed = (apart**2).sum(axis=2) ** 1.5
        np.fill_diagonal(cubed, 1.0)
        total = (masses[None, :, None] * apart / cubed[:, :, None]).sum(axis=1)
        r, v = at[11] - at[0], moves[11] - moves[0]
        distance, gm = float(np.linalg.norm(r)), masses[0]
        einstein = gm / (173.14463267424034**2 * distance**3)
        total[11] += einstein * ((4.0 * gm / distance - v @ v) * r + 4.0 * (r @ v) * v)
        return np.concatenate((moves.ravel(), total.ravel()))

    flat = np.concatenate((start[:, :3].ravel(), start[:, 3:].ravel()))
    found = solve_ivp(pull, (0.0, days), flat, method="DOP853", rtol=1e-11, atol=1e-13)
    return np.asarray(found.y[33:36, -1])


ORBITS = [
    ("main belt", 2.7660, 0.0785, 145.85, 10.587, 80.255, 73.42),
    ("Amor", 1.4583, 0.2227, 310.55, 10.828, 304.29, 178.9),
    ("Aten", 0.9227, 0.1911, 180.0, 3.33, 204.4, 126.4),
    ("Apollo near the Sun", 1.078, 0.8269, 50.0, 22.8, 88.0, 31.4),
    ("Trojan", 5.2, 0.147, 10.0, 10.3, 316.5, 133.0),
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "a", "e", "anomaly", "incl", "node", "peri"), ORBITS)
def test_an_orbit_of_a_year_is_that_of_another_integration(
    name: str, a: float, e: float, anomaly: float, incl: float, node: float, peri: float
) -> None:
    q, tp = by_mean_anomaly(a, e, anomaly, 2460200.5)
    elements = OrbitElements(name, 2460200.5, q, e, incl, node, peri, tp)
    found = _Way(elements, forward=True).state(365.25)[:3]
    assert np.linalg.norm(found - _all_at_once(elements, 365.25)) * 206_265.0 < 0.01


@pytest.mark.long
@pytest.mark.parametrize(("older", "newer"), [(CERES_2023, CERES_2024), (CERES_2024, CERES_2025)])
def test_elements_of_the_mpc_a_year_apart_lead_to_one_place(older: str, newer: str) -> None:
    for day in (datetime(2024, 3, 31, tzinfo=UTC), datetime(2025, 5, 5, tzinfo=UTC)):
        places = [SmallBody(read_elements(line)[0]).icrs(day, SITE) for line in (older, newer)]
        assert separation_arcsec(*places) < 0.2
        # without the planets' pull they would be a minute of arc apart
    kept = read_elements(older)[0]
    then = read_elements(newer)[0]
    two = kept.heliocentric(then.epoch_jd)[0] - then.heliocentric(then.epoch_jd)[0]
    assert np.linalg.norm(two) * 206_265.0 > 20.0


def test_horizons_has_ceres_at_the_same_places() -> None:
    """A recorded table of 2022, by the elements of 2020 that stand in its header."""
    table = read_horizons(astroquery_file("jplhorizons", "ceres_ephemerides_range.txt"))
    elements = OrbitElements(
        "1 Ceres",
        2458849.5,
        2.556401146697176,
        0.07687465013145245,
        10.59127767086216,
        80.3011901917491,
        73.80896808746482,
        2458240.1791309435,
        uncertainty=0,
    )
    body = SmallBody(elements)
    for row in table.rows:
        assert separation_arcsec(row.place, body.icrs(row.utc, GEOCENTER)) < 0.05


def test_enckes_recorded_ephemeris_moves_as_it_tells() -> None:
    table = read_mpes(astroquery_file("mpc", "2P_ephemeris_500-a-t.html"))
    assert table.name == "2P/Encke"
    rates = [separation_arcsec(a.place, b.place) for a, b in zip(table.rows, table.rows[1:], strict=False)]
    # its column of the motion runs from 27.9 to 36.8″ an hour
    assert 24.0 * 27.5 < min(rates) < max(rates) < 24.0 * 37.2


@pytest.mark.parametrize("line", [CERES_2023, PALLAS_2024, HALLEY, HOWELL])
def test_sigma_grows_with_the_age_of_the_elements(line: str) -> None:
    elements = read_elements(line)[0]
    assert [elements.along_arcsec(years) for years in (0, 1, 5)] == sorted(
        elements.along_arcsec(years) for years in (0, 1, 5)
    )
    unsure = OrbitElements(
        **{
            name: getattr(elements, name)
            for name in (
                "name",
                "epoch_jd",
                "q_au",
                "eccentricity",
                "inclination_deg",
                "node_deg",
                "peri_deg",
            )
        },
        perihelion_jd=elements.perihelion_jd,
        uncertainty=7,
    )
    assert unsure.along_arcsec(1.0) > 50.0 * elements.along_arcsec(1.0)


def test_what_is_too_uncertain_is_refused_with_numbers() -> None:
    elements = read_elements(CERES_2025[:105] + "9" + CERES_2025[106:])[0]
    assert elements.uncertainty == 9
    body = SmallBody(elements)
    with pytest.raises(BadRequest, match=r"may be .*° off by elements of 2025-05-05 \(U = 9\)"):
        body.icrs(datetime(2026, 11, 26, tzinfo=UTC), SITE)


def test_elements_without_planets_or_too_far_away_are_refused() -> None:
    old = OrbitElements("old", 2455000.5, 1.0, 0.1, 1.0, 2.0, 3.0, 2455000.5)
    with pytest.raises(
        BadRequest, match=r"elements of old are of 2009-06-18: no ephemeris on this machine covers that date"
    ):
        SmallBody(old)
    body = SmallBody(read_elements(CERES_2025)[0])
    with pytest.raises(BadRequest, match=r"16\.\d years away; 15 are the most"):
        body.icrs(datetime(2042, 1, 1, tzinfo=UTC), SITE)


@pytest.mark.long
def test_a_comets_own_forces_move_it() -> None:
    values = {"e": 0.64, "q": 1.24, "i": 7.04, "om": 50.1, "w": 12.7, "tp": 2460500.0}
    plain = OrbitElements("p", 2460400.5, 1.24, 0.64, 7.04, 50.1, 12.7, 2460500.0, comet=True)
    pushed = OrbitElements(
        "p", 2460400.5, 1.24, 0.64, 7.04, 50.1, 12.7, 2460500.0, comet=True, forces=OwnForces(1e-9, 1e-9, 0.0)
    )
    record = {
        "object": {"fullname": "p", "kind": "cn"},
        "orbit": {
            "epoch": "2460400.5",
            "elements": [{"name": name, "value": str(value)} for name, value in values.items()],
            "model_pars": [{"name": "A1", "value": "1e-9"}, {"name": "A2", "value": "1e-9"}],
        },
    }
    read = read_elements(json.dumps(record))[0]
    assert read.forces == pushed.forces
    away = [_Way(one, forward=True).state(250.0)[:3] for one in (plain, pushed, read)]
    assert 1e-7 < np.linalg.norm(away[0] - away[1]) < 1e-3
    assert np.allclose(away[1], away[2], atol=1e-12)


def test_sbdb_with_its_covariance() -> None:
    told = json.loads(astroquery_file("jplsbdb", "ceres.dat"))
    elements = read_elements(json.dumps(told))[0]
    assert (elements.name, elements.epoch_jd, elements.uncertainty) == ("1 Ceres", 2458200.5, 0)
    assert elements.covariance is not None
    body = SmallBody(elements)
    sigma = body.sigma_arcsec(datetime(2018, 3, 23, tzinfo=UTC))
    # Ceres is known to milliarcseconds: what is told is the integration's own
    assert 0.04 < sigma < 0.2
    worse = json.loads(astroquery_file("jplsbdb", "ceres.dat"))
    matrix = worse["orbit"]["covariance"]["data"]
    worse["orbit"]["covariance"]["data"] = [[str(float(one) * 1e14) for one in row] for row in matrix]
    unsure = SmallBody(read_elements(json.dumps(worse))[0])
    assert unsure.sigma_arcsec(datetime(2018, 3, 23, tzinfo=UTC)) > 50.0


@pytest.mark.parametrize(
    ("name", "says"),
    [("67P.dat", "2010-10-24"), ("apophis.dat", "2008-09-24"), ("phaethon.dat", "2011-11-08")],
)
def test_older_answers_of_sbdb_are_read_and_want_older_planets(name: str, says: str) -> None:
    elements = read_elements(astroquery_file("jplsbdb", name))[0]
    assert elements.forces is not None
    with pytest.raises(BadRequest, match=says):
        SmallBody(elements)


def test_a_second_question_is_answered_by_what_was_integrated() -> None:
    body = SmallBody(read_elements(CERES_2025)[0])
    utc = datetime(2026, 3, 1, tzinfo=UTC)
    body.icrs(utc, SITE)
    pieces = len(body._ways[True]._ends)
    for minutes in range(50):
        body.icrs(utc - timedelta(minutes=minutes), Site(10.0, 20.0))
    assert len(body._ways[True]._ends) == pieces


def test_backward_and_forward_meet() -> None:
    elements = read_elements(CERES_2024)[0]
    way = _Way(elements, forward=False).state(-300.0)
    # from there forward again, by the elements that touch the way there
    ahead = _Way(elements, forward=True)
    assert np.allclose(ahead.state(0.0), _Way(elements, forward=False).state(0.0))
    assert np.linalg.norm(way[:3]) > 2.0


def test_the_place_of_two_body_motion_is_right_at_the_epoch() -> None:
    elements = read_elements(CERES_2023)[0]
    assert SmallBody(elements).icrs(datetime(2023, 2, 25, tzinfo=UTC), SITE) != Icrs(0.0, 0.0)
    assert by_mean_anomaly(2.0, 0.5, 0.0, 2460000.5) == (1.0, 2460000.5)
    with pytest.raises(BadRequest, match="not an ellipse"):
        by_mean_anomaly(2.0, 1.5, 0.0, 2460000.5)


def test_it_ends_where_the_planets_do() -> None:
    elements = OrbitElements("late", 2471000.5, 2.0, 0.1, 1.0, 2.0, 3.0, 2471000.5, uncertainty=0)
    body = SmallBody(elements)
    assert body.ends_utc is not None
    assert body.ends_utc < datetime(2055, 1, 1, tzinfo=UTC)
    assert body.icrs(body.ends_utc, SITE)
    with pytest.raises(BadRequest, match="there the planets' places end"):
        body.icrs(body.ends_utc + timedelta(days=1), SITE)
