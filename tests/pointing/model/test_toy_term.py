"""A pointing term is added by one entry of a table: done with a toy (docs/how-to/add-a-pointing-term.md)."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from api.cli.model import model_lines
from mountnav.errors import BadRequest
from mountnav.pointing.model.fit import fit
from mountnav.pointing.model.model import PointingModel, model_of
from mountnav.pointing.model.rigorous import axes_for, geometry, seen_from
from mountnav.pointing.model.terms import EQUATORIAL, Term, candidates, term
from mountnav.units import RAD_PER_ARCSEC
from tests.conftest import ROOT
from tests.pointing.model.model_data import telescope

PAGE = ROOT / "docs" / "how-to" / "add-a-pointing-term.md"

TOY = Term(
    "TOY",
    "counterweight bar bends (a toy)",
    lambda p: (np.zeros_like(p.lon_rad), p.sin_lon * p.sin_lat),
)

TRUTH = {"IH": 300.0, "ID": -200.0, "CH": 60.0, "ME": 120.0, "MA": -90.0, "TF": 40.0, "TOY": 45.0}


@pytest.fixture
def _listed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one entry."""
    monkeypatch.setitem(EQUATORIAL, TOY.name, TOY)


def test_without_the_entry_it_is_unknown() -> None:
    with pytest.raises(BadRequest, match="'TOY' is not a term"):
        term("equatorial", "TOY")


@pytest.mark.usefixtures("_listed")
def test_it_is_fitted() -> None:
    names = ("CH", "ME", "MA", "TF", "TOY")
    found = _model(TRUTH, names)
    value, sigma = _coefficient(found)
    assert sigma < 3.0
    assert value == pytest.approx(45.0, abs=4.0 * sigma)


@pytest.mark.usefixtures("_listed")
def test_it_is_selected() -> None:
    assert "TOY" in candidates("equatorial")
    assert "TOY" not in candidates("altaz")
    found = _model(TRUTH, "auto")
    assert "TOY" in found.terms
    # and not where the telescope doesn't bend
    assert "TOY" not in _model({**TRUTH, "TOY": 0.0}, "auto").terms


@pytest.mark.usefixtures("_listed")
def test_it_is_applied_and_inverted() -> None:
    latitude = math.radians(48.93)
    ha, dec = np.radians([[-50.0, -10.0, 35.0, 70.0], [60.0, -5.0, 40.0, 20.0]])
    beyond = np.zeros(4, dtype=np.bool_)
    bent = geometry("equatorial", latitude, {"TOY": 45.0})
    seen = seen_from(bent, ha, dec)
    off = np.arcsin(seen[:, 2]) - dec
    assert off / RAD_PER_ARCSEC == pytest.approx(45.0 * np.sin(ha) * np.sin(dec), abs=0.02)
    axes = axes_for(bent, seen, beyond)
    assert axes.lon_rad == pytest.approx(ha, abs=1e-11)
    assert axes.lat_rad == pytest.approx(dec, abs=1e-11)


@pytest.mark.usefixtures("_listed")
def test_it_is_shown() -> None:
    found = _model(TRUTH, "auto")
    (line,) = (one for one in model_lines(found) if one.startswith("  TOY"))
    assert line.endswith("counterweight bar bends (a toy)")


def test_the_page_shows_this_code() -> None:
    code = Path(__file__).read_text()
    shown = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(shown) == 4
    for block in shown:
        assert block.strip() in code


def _model(truth: dict[str, float], terms: Sequence[str] | Literal["auto"]) -> PointingModel:
    looks = telescope("equatorial", truth, n=60, noise_arcsec=2.0)
    return model_of(fit(looks, terms), made_utc=datetime(2026, 11, 21, tzinfo=UTC))


def _coefficient(model: PointingModel) -> tuple[float, float]:
    at = model.terms.index("TOY")
    return model.coefficients_arcsec[at], model.sigma_arcsec[at]
