"""A model in force tells the doctor the mount's geometry: signs and all, for both kinds of mounts."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from mountnav.pointing.doctor.evidence import looks_at
from mountnav.pointing.doctor.facts import geometry_of, to_altaz
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.model.terms import axis_place, term

LATITUDE = 48.0
VALUES = {
    "equatorial": {"CH": 40.0, "NP": -30.0, "ME": 60.0, "MA": -50.0, "TF": 25.0},
    "altaz": {"CA": 40.0, "NPAE": -30.0, "AN": 60.0, "AW": -50.0, "TF": 25.0},
}


def model(kind: Any) -> PointingModel:
    zero = ("IH", "ID") if kind == "equatorial" else ("IA", "IE")
    values = {zero[0]: 0.0, zero[1]: 0.0} | VALUES[kind]
    k = len(values)
    return PointingModel(
        id="m",
        kind=kind,
        site_latitude_deg=LATITUDE,
        does_refraction=False,
        terms=tuple(values),
        coefficients_arcsec=tuple(values.values()),
        sigma_arcsec=(5.0,) * k,
        covariance_arcsec2=tuple(tuple(25.0 * (i == j) for j in range(k)) for i in range(k)),
        scatter_arcsec=20.0,
        made_utc=datetime(2026, 11, 21, tzinfo=UTC),
    )


@pytest.mark.parametrize("kind", ["equatorial", "altaz"])
def test_terms_mean_the_same_to_both(kind: Any) -> None:
    (geometry,), noise = geometry_of(model(kind))
    assert noise == pytest.approx(28.3, abs=0.1)
    assert geometry.sigmas_arcsec[:4] == (10.0, 10.0, 10.0, 10.0)
    lon, lat = np.radians([10.0, 100.0, -130.0]), np.radians([20.0, 55.0, 40.0])
    arcsec = np.pi / 648000.0
    terms = np.array(geometry.terms_arcsec) * arcsec
    terms[5] = 0.0
    tube, _ = looks_at(lon, lat, terms, np.pi / 2.0 if kind == "altaz" else np.radians(LATITUDE))
    # the model's azimuth runs from the north, the doctor's from the south
    own = lon + np.pi if kind == "altaz" else lon
    place = axis_place(kind, own, lat, np.radians(LATITUDE))
    xi, eta = np.zeros(3), np.zeros(3)
    for name, value in VALUES[kind].items():
        one_xi, one_eta = term(kind, name).function(place)
        xi, eta = xi + value * one_xi, eta + value * one_eta
    got_lon, got_lat = np.arctan2(tube[:, 1], tube[:, 0]), np.arcsin(tube[:, 2])
    off = np.angle(np.exp(1j * (got_lon - lon))) * np.cos(lat) / arcsec
    assert np.allclose(off, xi, atol=0.3)
    assert np.allclose((got_lat - lat) / arcsec, eta, atol=0.3)


def test_altaz_frame_has_the_zenith_as_its_pole() -> None:
    latitude = np.radians(LATITUDE)
    meridian = to_altaz(np.array([[0.0, latitude], [0.0, 0.0], [np.pi / 2, 0.0]]), latitude)
    assert meridian[0, 1] == pytest.approx(np.pi / 2)
    assert np.degrees(meridian[1]) == pytest.approx([0.0, 90.0 - LATITUDE])  # south
    assert np.degrees(meridian[2]) == pytest.approx([90.0, 0.0], abs=1e-9)  # west
