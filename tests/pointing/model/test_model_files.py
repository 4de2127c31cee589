"""Model files, and those of PMFIT and TPOINT: what is written is read again, what is damaged is refused."""

import json
import math
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.errors import BadRequest, BadSettings, ModelRefused
from mountnav.pointing.model.fit import fit
from mountnav.pointing.model.in_force import ModelInForce, NoModel
from mountnav.pointing.model.model import PointingModel, model_of
from mountnav.pointing.model.tpoint_file import (
    model_from,
    read_coefficients,
    read_observations_text,
    write_coefficients,
)
from mountnav.settings.model import ModelSettings
from mountnav.sky.coordinates import Air, Site
from tests.pointing.model.model_data import SIX, pmfit, telescope
from tests.pointing.model.tpoint_writing import write_pmfit, write_tpoint_observations

WHEN = datetime(2026, 11, 22, 3, 0, tzinfo=UTC)


def a_model(**more) -> PointingModel:
    found = fit(telescope("equatorial", {"CH": 100.0, "ME": 60.0, "MA": -30.0}, n=30), SIX)
    return model_of(found, made_utc=WHEN, telescope="east", source="test", **more)


def test_a_model_file_comes_back_the_same(tmp_path):
    model = a_model()
    path = tmp_path / "east.json"
    model.save(path)
    model.save(path)
    assert PointingModel.load(path) == model
    assert [one.name for one in tmp_path.iterdir()] == ["east.json"]


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("format", "something", "not a pointing model of mountnav"),
        ("version", 2, "version 2"),
        ("kind", "dobson", "kind"),
        ("terms", ["IH", "ID"], "2 terms need"),
        ("terms", ["IH", "ID", "CH", "ME", "MA", "ZZ"], "not a term"),
        ("terms", ["ID", "IH", "CH", "ME", "MA", "TF"], "begin with IH, ID"),
        ("coefficients_arcsec", [1.0, 2.0, "x", 1, 1, 1], "could not convert"),
        ("scatter_arcsec", None, "not a pointing model"),
        ("made_utc", "2026-11-22T03:00:00", "time zone"),
        ("does_refraction", "no", "true or false"),
        ("covariance_arcsec2", [[-1.0] * 6] * 6, "covariance"),
        ("surprise", 1, "surprise"),
    ],
)
def test_a_damaged_model_is_refused(key, value, said):
    record = json.loads(a_model().to_json()) | {key: value}
    with pytest.raises(BadRequest, match=f"m.json.*{said}"):
        PointingModel.from_json(json.dumps(record), name="m.json")


def test_no_model_at_all(tmp_path):
    with pytest.raises(BadRequest, match="can't be read"):
        PointingModel.load(tmp_path / "none.json")
    for text in ("", "[]", "{", "null"):
        with pytest.raises(BadRequest):
            PointingModel.from_json(text)


def test_the_settings_name_it(tmp_path):
    path = tmp_path / "east.json"
    a_model().save(path)
    site, air = Site(48.93, 22.27), Air(930.0)
    assert isinstance(ModelSettings().pointing(site=site, air=air), NoModel)
    there = ModelSettings(file=path).pointing(site=site, air=air, mounting="german")
    assert isinstance(there, ModelInForce)
    with pytest.raises(BadSettings, match=r"can't be read.*mountnav model fit"):
        ModelSettings(file=tmp_path / "none").pointing(site=site, air=air)
    with pytest.raises(BadSettings, match="equatorial model, the mount is altaz"):
        ModelSettings(file=path).pointing(site=site, air=air, mounting="altaz")
    with pytest.raises(ModelRefused, match="latitude"):
        ModelSettings(file=path).pointing(site=Site(10.0, 0.0), air=air)


def test_pmfit_file_round_trip(shared):
    m = pmfit(shared)
    again = read_observations_text(write_pmfit(m, "again"))
    assert len(again) == 39
    assert again.read_lon_rad == pytest.approx(m.read_lon_rad, abs=1e-8)
    assert again.seen == pytest.approx(m.seen, abs=1e-8)
    assert fit(again, SIX).after.sky_rms_arcsec == pytest.approx(5.782, abs=0.005)


@pytest.mark.parametrize("write", [write_pmfit, write_tpoint_observations])
def test_both_sides_of_the_pier_round_trip(write):
    m = telescope("equatorial", {"CH": 300.0, "NP": 50.0}, n=40, both_sides=True, latitude_deg=-31.2)
    again = read_observations_text(write(m, "both sides"))
    assert np.array_equal(again.beyond, m.beyond)
    assert again.seen == pytest.approx(m.seen, abs=3e-8)
    one, other = fit(m, ("CH", "NP", "ME", "MA")), fit(again, ("CH", "NP", "ME", "MA"))
    assert other.coefficients_arcsec == pytest.approx(one.coefficients_arcsec, abs=0.05)
    assert math.degrees(again.site_latitude_rad) == pytest.approx(-31.2)


def test_altaz_round_trip():
    m = telescope("altaz", {"CA": 100.0, "AN": 30.0}, n=20)
    again = read_observations_text(write_pmfit(m, "8 m"))
    assert again.kind == "altaz"
    assert again.seen == pytest.approx(m.seen, abs=3e-8)
    with pytest.raises(BadRequest, match="PMFIT"):
        write_tpoint_observations(m, "8 m")


def test_a_tpoint_file_of_observations():
    text = """A night
! a remark
:NODA
:EQUAT
-00 30 00 2026 11 22
05 00 00.0 -00 10 00.0  05 00 04.0 -00 10 30.0  06 30  ! Rigel's neighborhood
23 30 00.0 +40 00 00.0  23 30 00.0 +40 00 00.0  00 15 30.0
END
what follows counts for nothing
"""
    m = read_observations_text(text)
    assert math.degrees(m.site_latitude_rad) == pytest.approx(-0.5)
    lon, lat = m.seen_angles
    assert np.degrees(lon) == pytest.approx([22.5, 11.375])
    assert np.degrees(lat) == pytest.approx([-1 / 6, 40.0])
    assert np.degrees(m.read_lon_rad[0]) == pytest.approx(22.5 - 1 / 60)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not a file of PMFIT"),
        ("caption\nE\nnorth\n", "line 3: no latitude"),
        ("caption\nE\n48\n1.0 2.0 3.0\n", "line 4"),
        ("caption\nE\n48\n1.0 2.0 3.0 x\n", "line 4"),
        ("caption\nE\n48\n", "no observations"),
        ("caption\nE\n148\n1.0 2.0 3.0 4.0\n", "latitude"),
        ("caption\n:EQUAT\n48 00 00\n1 2 3 4\nEND\n", "line 4"),
        ("caption\n:ALTAZ\n48 00 00\n", ":ALTAZ"),
        ("caption\n:EQUAT\nEND\n", "no latitude"),
    ],
)
def test_files_that_are_none(text, said):
    with pytest.raises(BadRequest, match=said):
        read_observations_text(text, name="f")


TPOINT = """5m horseshoe, 14 terms
T   39     1.6500    58.200    -0.067
  IH        -92.2580     4.03400
  ID       -126.7380     2.27300
  CH        +44.2100     3.26600
= ME        +64.8480
& MA         -2.9920     1.39500
  TF        +10.9930     1.64700
  HDSH3      +1.5000     0.40000
END
"""


def test_coefficients_of_tpoint():
    read = read_coefficients(TPOINT)
    assert read.kind == "equatorial"
    assert (read.n, read.sky_rms_arcsec) == (39, 1.65)
    assert read.values_arcsec["ME"] == 64.848
    assert read.sigma_arcsec["ME"] == 0.0
    model = model_from(read, model_id="x", site_latitude_deg=33.356, made_utc=WHEN)
    assert model.terms[:3] == ("IH", "ID", "CH")
    again = read_coefficients(write_coefficients(model))
    assert again.values_arcsec == read.values_arcsec
    assert again.n == 39
    in_force = ModelInForce(model, site=Site(33.356, -116.9), air=Air(830.0))
    assert in_force.model_id == "x"


@settings(deadline=None)
@given(
    st.dictionaries(
        st.sampled_from(["IA", "IE", "CA", "NPAE", "AN", "AW", "TX", "HZSA3"]),
        st.tuples(st.floats(-9e4, 9e4), st.floats(0.0, 900.0)),
        min_size=1,
    )
)
def test_any_coefficients_round_trip(values):
    values = {"CA": (1.0, 0.5)} | values
    text = "a\nT 10 5.0 0 0\n" + "".join(f"{name} {c!r} {s!r}\n" for name, (c, s) in values.items()) + "END\n"
    model = model_from(read_coefficients(text), model_id="m", site_latitude_deg=1.0, made_utc=WHEN)
    again = read_coefficients(write_coefficients(model))
    assert again.kind == "altaz"
    for name, (coefficient, sigma) in values.items():
        assert again.values_arcsec[name] == pytest.approx(coefficient, abs=1e-4)
        assert again.sigma_arcsec[name] == pytest.approx(sigma, abs=1e-5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "line 2"),
        ("caption\nT many 3\nEND", "line 2"),
        ("caption\nT 3 1.0 0 0\n IH x 1\nEND", "line 3"),
        ("caption\nT 3 1.0 0 0\n IH 1 1\n IH 2 1\nEND", "twice"),
        ("caption\nT 3 1.0 0 0\n IH 1 1\n PHH 2 1\n A1D 3 1\nEND", "PHH, A1D"),
        ("caption\nT 3 1.0 0 0\nEND", "none at all"),
    ],
)
def test_coefficients_that_are_none(text, said):
    with pytest.raises(BadRequest, match=said):
        read_coefficients(text, name="f")
