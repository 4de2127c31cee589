"""Each reason for not solving, reached by a list that deserves it, with the numbers behind it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Hint, StarList
from mountnav.identification.blind.index import BlindIndex
from mountnav.identification.full import match_radius
from mountnav.identification.refusal import BLIND_STARS, stars_wanted
from mountnav.identification.search import identify
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Flag, SkyQuality, StarImages
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Reason
from mountnav.solving.contradictions import contradictions_with
from mountnav.solving.settings import SolveSettings
from mountnav.solving.solve import solve_stars
from tests.identification.listed_sky import EPOCH, PLACES, anywhere, asked, drawn, galactic, listed, seen

QUALITY = SkyQuality(20, StarImages.DEFOCUSED, 14.0, 0.1, 0.0, 100.0, 10.0, 1.0, 50.0, 0.0)


def refused(measurements, hint, **more):
    got = identify(measurements, embedded_catalog(), hint, epoch_yr=EPOCH, **more)
    assert got.reference is None
    assert got.detail
    return got


def test_no_hint():
    rng = np.random.default_rng(1)
    assert refused(drawn(anywhere, rng).measurements, Hint()).reason is Reason.NO_HINT


def test_too_few_measured():
    """Four stars, where the catalog promises no more than a handful."""
    rng = np.random.default_rng(2)
    pole = PLACES["galactic pole"](rng)
    few = seen(pole, 2.0, 30.0, 1, rng, junk=0, lost=0.0)
    m = few.measurements
    few = listed(m.x_px[:4], m.y_px[:4], m.flux[:4], 1000, 800)
    got = refused(few, Hint(pole, 0.3, 1.9, 2.1))
    assert got.reason is Reason.TOO_FEW_MEASUREMENTS
    assert got.numbers["star_like"] == 4
    line = listed(np.linspace(100, 900, 8), np.linspace(100, 700, 8), np.ones(8), 1000, 800)
    got = refused(line, Hint(pole, 0.3, 1.9, 2.1))
    assert got.reason is Reason.TOO_FEW_MEASUREMENTS
    assert "no triangle" in got.detail


@pytest.mark.long
def test_many_stars_but_no_match():
    rng = np.random.default_rng(3)
    one = drawn(anywhere, rng)
    elsewhere = Icrs((one.center.ra_deg + 90) % 360, one.center.dec_deg / 2)
    got = refused(one.measurements, Hint(elsewhere, 0.5, 3.9, 4.1), budget_s=60)
    assert got.reason is Reason.NO_MATCH
    assert got.numbers["hypotheses"] > 100
    assert got.numbers["searched_deg"] > 2
    assert got.numbers["star_like"] == len(one.measurements)


@pytest.mark.long
def test_cloud():
    """In the Milky Way the catalog promises dozens of stars, and 5 sources are seen, all of them junk."""
    rng = np.random.default_rng(4)
    place = galactic(80.0, 0.0)
    cloudy = listed(rng.uniform(0, 1000, 5), rng.uniform(0, 800, 5), rng.random(5), 1000, 800)
    got = refused(cloudy, Hint(place, 0.5, 3.9, 4.1))
    assert got.reason is Reason.CLOUD_OR_DEFOCUS
    assert got.numbers["promised_stars"] > 25
    dark = listed(np.zeros(0), np.zeros(0), np.zeros(0), 1000, 800)
    assert refused(dark, Hint(place, 0.5, 3.9, 4.1)).reason is Reason.CLOUD_OR_DEFOCUS


@pytest.mark.long
def test_defocus_is_told_by_the_width_and_by_the_quality():
    rng = np.random.default_rng(5)
    places = (rng.uniform(0, 1000, 20), rng.uniform(0, 800, 20), rng.random(20))
    wide = replace(listed(*places, 1000, 800), fwhm_px=np.full(20, 14.0))
    told = replace(listed(*places, 1000, 800), quality=QUALITY)
    for m in (wide, told):
        got = refused(m, Hint(PLACES["galactic pole"](rng), 0.5, 3.9, 4.1), budget_s=60)
        assert got.reason is Reason.CLOUD_OR_DEFOCUS
        assert "defocus" in got.detail


def test_catalog_too_shallow():
    """A field of 3′: many stars measured, none of them in the catalog."""
    rng = np.random.default_rng(6)
    deep = listed(rng.uniform(0, 1000, 80), rng.uniform(0, 800, 80), rng.random(80), 1000, 800)
    got = refused(deep, Hint(PLACES["galactic pole"](rng), 0.1, 0.19, 0.21))
    assert got.reason is Reason.CATALOG_TOO_SHALLOW
    assert got.numbers["catalog_stars"] < 5
    assert "Tycho-2" in got.detail


@pytest.mark.long
def test_chance():
    """Eight stars: a match, but with a limit this strict not one to move a telescope by."""
    rng = np.random.default_rng(7)
    place = PLACES["galactic pole"](rng)
    one = seen(place, 3.2, 40.0, 1, rng, junk=0, lost=0.0, depth=12.0)
    m = one.measurements
    few = listed(m.x_px[:8], m.y_px[:8], m.flux[:8], 1000, 800)
    strict = IdentificationSettings(false_probability_max=1e-40)
    got = refused(few, Hint(one.center, 0.1, 3.1, 3.3), settings=strict, budget_s=60)
    assert got.reason is Reason.CHANCE
    assert got.numbers["more_stars"] >= 1
    assert f"{got.numbers['more_stars']:.0f} more star" in got.detail
    assert 1e-40 < got.numbers["best_false_probability"] < 1e-9
    assert "1e-40" in got.detail


def test_the_stars_that_would_do_grow_with_what_is_missing_and_none_is_told_in_a_crowd():
    strict = IdentificationSettings()
    near, far = (stars_wanted(odds, 8, 1000, 800, strict) for odds in (1e-8, 1e-3))
    assert near is not None
    assert far is not None
    assert near == 1
    assert near < far <= 6
    # as many as these would really do: each is one more chance in so many
    share = 8 * math.pi * match_radius(strict, 1000, 800) ** 2 / (1000 * 800)
    assert 1e-3 * share**far <= strict.false_probability_max
    assert stars_wanted(1e-3, 3000, 1000, 800, strict) is None


@pytest.mark.long
def test_hints_that_rule_each_other_out():
    """No scale is at least 5 and at most 4: solved all the same if it can be, else that is the reason."""
    rng = np.random.default_rng(8)
    one = drawn(anywhere, rng)
    good = asked(rng, one)
    odd = replace(good, scale_low_arcsec_px=5.0, scale_high_arcsec_px=4.0, scale_source="SCALE and PIXSCALE")
    got = identify(one.measurements, embedded_catalog(), odd, epoch_yr=EPOCH)
    assert got.reference is not None
    plate = got.reference.plate
    disproved = contradictions_with(odd, plate.center(), plate.scale_arcsec_px())
    assert [each.about for each in disproved] == ["scale"]
    junk = listed(rng.uniform(0, 1000, 7), rng.uniform(0, 800, 7), rng.random(7), 1000, 800)
    got = refused(junk, odd)
    assert got.reason is Reason.HINT_CONTRADICTS
    assert "SCALE and PIXSCALE" in got.detail
    assert got.numbers["scale_low_arcsec_px"] == 5.0
    assert len(got.contradictions) == 1


def test_out_of_time_says_what_is_likely():
    rng = np.random.default_rng(9)
    one = drawn(anywhere, rng)
    got = refused(one.measurements, asked(rng, one), budget_s=0)
    assert got.reason is Reason.TIMED_OUT
    assert "likely:" in got.detail
    assert got.numbers["budget_s"] == 0


def test_flagged_measurements_are_no_stars_but_may_be_tried():
    """A sharp frame's stars may all look like hot pixels: found all the same."""
    rng = np.random.default_rng(10)
    one = drawn(anywhere, rng)
    flags = np.full(len(one.measurements), int(Flag.NO_PEAK))
    flags[::9] = 0
    got = identify(
        replace(one.measurements, flags=flags), embedded_catalog(), asked(rng, one), epoch_yr=EPOCH
    )
    assert got.reference is not None


@pytest.mark.long
def test_too_few_for_the_whole_sky_are_told_how_many_would_do(sky_index: BlindIndex) -> None:
    rng = np.random.default_rng(4)
    settings = SolveSettings(index=sky_index, blind="only")
    x_px, y_px = rng.uniform(50, 2000, (2, 6))
    stars = StarList(x_px, y_px, np.arange(6.0, 0.0, -1.0), 2048, 2048, source="few")
    verdict = solve_stars(stars, embedded_catalog(), settings=settings)
    assert verdict.solution is None
    assert verdict.reason is Reason.TOO_FEW_MEASUREMENTS
    assert f"{BLIND_STARS} that the catalog has would do, or a hint" in verdict.detail
