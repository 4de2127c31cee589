"""What is solved at a glance is as right as what is measured in full; what is not costs only time."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.frames import rendered
from benchmarks.rendered import field_errors_px, truths
from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame, Hint
from mountnav.identification.fast import identify_fast
from mountnav.identification.search import Reach
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.settings import MeasuringSettings
from mountnav.reading import read_frame
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Reason
from mountnav.solving.solve import SolveSettings, solve
from tests.present import present

GLANCE, FULL = SolveSettings(), SolveSettings(glance=False)


def known(shared, word):
    return next(one for one in rendered(shared) if word in one.path.name)


@pytest.mark.long
@pytest.mark.parametrize(
    "word", ["A01", "E03", *(pytest.param(one, marks=pytest.mark.long) for one in ("B02", "C00"))]
)
def test_a_glance_gives_the_same_place(shared, word):
    one = known(shared, word)
    frame, test = read_frame(one.path), truths(shared)[one.path.name]
    quick = solve(frame, embedded_catalog(), hint=one.hint, settings=GLANCE)
    full = solve(frame, embedded_catalog(), hint=one.hint, settings=FULL)
    assert "at a glance" in quick.detail
    assert "at a glance" not in full.detail
    worst = [
        float(np.max(field_errors_px(present(got.solution).wcs, test, one.scale_arcsec_px)))
        for got in (quick, full)
    ]
    assert one.error_px(quick) < 0.01
    assert worst[0] < max(0.02, 1.5 * worst[1])
    assert present(quick.solution).pairs > 0.8 * present(full.solution).pairs


@pytest.mark.long
def test_a_glance_tells_of_the_night_what_measuring_in_full_tells(shared):
    one = known(shared, "A02")
    frame = read_frame(one.path)
    quick = present(solve(frame, embedded_catalog(), hint=one.hint, settings=GLANCE).quality)
    full = present(solve(frame, embedded_catalog(), hint=one.hint, settings=FULL).quality)
    assert quick.images is full.images
    assert quick.fwhm_px == pytest.approx(full.fwhm_px, rel=0.05)
    assert quick.sky_adu == pytest.approx(full.sky_adu, rel=0.02)
    assert quick.noise_adu == pytest.approx(full.noise_adu, rel=0.05)
    assert quick.zero_point_mag == pytest.approx(full.zero_point_mag, abs=0.05)
    assert quick.limiting_mag == pytest.approx(full.limiting_mag, abs=0.2)


@pytest.mark.long
def test_the_errors_of_the_precise_centroids_are_honest(shared):
    one = known(shared, "A01")
    pairs = present(
        solve(read_frame(one.path), embedded_catalog(), hint=one.hint, settings=GLANCE).solution
    ).identified
    pull = np.hypot(pairs.dx_arcsec, pairs.dy_arcsec)[pairs.used]
    sigma = np.hypot(pairs.centroid_sigma_arcsec, pairs.catalog_sigma_arcsec)[pairs.used]
    # for two coordinates the median of the modulus over sigma is 1.18
    assert np.median(pull / sigma) < 1.5


@pytest.mark.long
def test_the_hypotheses_of_a_glance_count_in_the_full_search(shared):
    one = known(shared, "E00")
    hint = replace(one.hint, center=Icrs(one.center.ra_deg, -one.center.dec_deg + 20.0), alternatives=())
    frame = replace(read_frame(one.path), hint=Hint())
    first = identify_fast(
        frame,
        embedded_catalog(),
        hint,
        epoch_yr=2000.0,
        settings=IdentificationSettings(),
        measuring=MeasuringSettings(),
        budget_s=5.0,
        reach=Reach(tried=7),
    )
    assert first.identified is None
    assert first.tried >= 7
    again = solve(frame, embedded_catalog(), hint=hint, settings=SolveSettings(budget_s=3.0))
    assert again.solution is None
    assert again.numbers["hypotheses"] >= first.tried - 7


@pytest.mark.long
@pytest.mark.parametrize("kind", ["noise", "constant", "tiny", "saturated"])
def test_frames_without_stars_come_out_as_without_a_glance(kind):
    rng = np.random.default_rng(3)
    pixels = {
        "noise": rng.normal(1000.0, 10.0, (700, 800)).astype(np.uint16),
        "constant": np.full((700, 800), 1000, np.uint16),
        "tiny": rng.normal(1000.0, 10.0, (20, 24)).astype(np.uint16),
        "saturated": np.full((700, 800), 65535, np.uint16),
    }[kind]
    hint = Hint(Icrs(10.0, 20.0), 1.0, 2.0, 2.2)
    told = []
    for settings in (GLANCE, FULL):
        got = solve(Frame(pixels), embedded_catalog(), hint=hint, settings=replace(settings, budget_s=3.0))
        assert got.solution is None
        told.append(got.reason)
    assert told[0] is told[1]
    assert told[0] in (Reason.BAD_FRAME, Reason.TOO_FEW_MEASUREMENTS, Reason.CLOUD_OR_DEFOCUS)


def test_an_unreadable_shape_is_refused_as_ever():
    got = solve(Frame(np.zeros((5, 5))), embedded_catalog(), hint=Hint(Icrs(1.0, 2.0), 1.0, 2.0, 2.1))
    assert got.reason is Reason.BAD_FRAME
