"""A scale learned from other frames makes the search shorter, and changes no answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Hint, StarList
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic, separation_arcsec
from mountnav.solution import Verdict
from mountnav.solving.priors import CameraPrior, prior_of
from mountnav.solving.settings import SolveSettings
from mountnav.solving.solve import solve_stars
from mountnav.units import ARCSEC_PER_RAD

CENTER, SCALE = Icrs(83.2, 21.4), 6.0
PLACED = Hint(center=Icrs(83.5, 21.2), radius_deg=1.0)
PRIOR = CameraPrior("", "", 1600, 1200, 5.95, 6.05, 20)


@pytest.fixture(scope="module")
def stars() -> StarList:
    """Where the catalog's stars fall in a frame, 0.1 px off."""
    found = embedded_catalog().cone(CENTER, 1.6, epoch_yr=2026.0)
    xi, eta = gnomonic(found.ra_deg, found.dec_deg, CENTER.ra_deg, CENTER.dec_deg)
    noise = np.random.default_rng(5).normal(0.0, 0.1, (2, len(found)))
    x = 799.5 - np.asarray(xi) * ARCSEC_PER_RAD / SCALE + noise[0]
    y = 599.5 + np.asarray(eta) * ARCSEC_PER_RAD / SCALE + noise[1]
    inside = (x > 0) & (x < 1599) & (y > 0) & (y < 1199) & (found.mag < 11.0)
    return StarList(x[inside], y[inside], 10 ** (-0.4 * found.mag[inside]), 1600, 1200)


def _solved(stars: StarList, *priors: CameraPrior, hint: Hint = PLACED) -> Verdict:
    settings = SolveSettings(blind="never", priors=priors)
    verdict = solve_stars(stars, embedded_catalog(), hint=hint, settings=settings)
    assert verdict.solution is not None, verdict.detail
    assert separation_arcsec(verdict.solution.center, CENTER) < 1.0
    return verdict


def test_the_search_is_shorter_and_says_what_was_assumed(stars: StarList) -> None:
    without, given = _solved(stars), _solved(stars, PRIOR)
    assert without.prior is None
    assert given.prior is not None
    assert (given.prior.held, given.prior.frames) == (True, 20)
    assert given.numbers["hypotheses"] < 0.2 * without.numbers["hypotheses"]
    assert not given.contradictions


def test_a_frame_that_contradicts_is_solved_as_without_it(stars: StarList) -> None:
    wrong = replace(PRIOR, scale_low_arcsec_px=2.95, scale_high_arcsec_px=3.05)
    without, given = _solved(stars), _solved(stars, wrong)
    assert given.prior is not None
    assert not given.prior.held
    assert given.solution is not None
    assert without.solution is not None
    # another triangle may have proposed it: the same plate but for roundings
    assert separation_arcsec(given.solution.center, without.solution.center) < 1e-3
    # what was tried in vain was one more chance to be fooled
    assert given.numbers["hypotheses"] > without.numbers["hypotheses"]
    assert given.solution.false_probability >= without.solution.false_probability
    assert [(one.about, one.source) for one in given.contradictions] == [
        ("scale", "the camera's prior of 20 frames")
    ]


def test_it_is_asked_only_where_it_saves_something(stars: StarList) -> None:
    known = replace(PLACED, scale_low_arcsec_px=5.5, scale_high_arcsec_px=6.5)
    assert _solved(stars, PRIOR, hint=known).prior is None
    assert _solved(stars, replace(PRIOR, width_px=800)).prior is None
    assert PRIOR.narrowed(Hint()) is None  # no place: the index tells the scale
    wrong = replace(PLACED, scale_low_arcsec_px=11.0, scale_high_arcsec_px=13.0, alternatives=(PLACED,))
    narrowed = PRIOR.narrowed(wrong)
    assert narrowed is not None
    assert (narrowed.scale_low_arcsec_px, narrowed.center, narrowed.alternatives) == (5.95, PLACED.center, ())


def test_a_camera_is_known_by_all_of_its_names_and_its_size() -> None:
    other = replace(PRIOR, instrument="SBIG")
    assert prior_of((other, PRIOR), "", "", 1600, 1200) is PRIOR
    assert prior_of((other, PRIOR), "SBIG", "", 1600, 1200) is other
    assert prior_of((other, PRIOR), "SBIG", "C11", 1600, 1200) is None
