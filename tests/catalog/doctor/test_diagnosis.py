"""The doctor's counts against the sky, its verdicts, and its advice."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.doctor.counts import (
    SOLVED_SHARE,
    SURE_STARS,
    FrameSize,
    Reach,
    SampleFields,
    counted,
    failing,
    failing_near,
    failing_on_mean,
    modeled,
    plane_fields,
    pole_fields,
    spread_fields,
    stars_in_frame,
)
from mountnav.catalog.doctor.diagnosis import (
    CameraFacts,
    NamedCatalog,
    Verdict,
    advice_for,
    diagnose,
    reach_of,
)
from mountnav.catalog.doctor.obtainable import ObtainableCatalog, in_size, obtainable_catalogs
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.catalog.readers import CATALOGS
from mountnav.catalog.star_counts import density_deg2, galactic
from mountnav.catalog.stars import Stars
from mountnav.sky.coordinates import Icrs
from tests.present import present
from tests.short_part import one_in

EPOCH = 2026.9
TYCHO2 = (NamedCatalog("tycho2", embedded_catalog()),)
WHOLE = Reach()


def few_places(count: int, reach: Reach = WHOLE) -> tuple[SampleFields, SampleFields, SampleFields]:
    return (
        spread_fields(reach, count),
        pole_fields(reach).only(slice(0, 5)),
        plane_fields(reach).only(slice(0, 5)),
    )


def camera(width_deg: float, height_deg: float, depth_mag: float, **more: object) -> CameraFacts:
    return CameraFacts("t", FrameSize(width_deg, height_deg, depth_mag), **more)  # type: ignore[arg-type]


class Strewn:
    """A catalog of given places that hands out all of them, however small the cone."""

    name = "strewn"

    def __init__(self, ra_deg: np.ndarray, dec_deg: np.ndarray, mag: np.ndarray) -> None:
        order = np.argsort(mag)
        self.ra_deg, self.dec_deg, self.mag = ra_deg[order], dec_deg[order], mag[order]

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        keep = self.mag <= (math.inf if mag_limit is None else mag_limit)
        still = np.zeros(int(keep.sum()))
        return Stars(
            self.ra_deg[keep],
            self.dec_deg[keep],
            still,
            self.mag[keep],
            still,
            still,
            epoch_yr,
            "V",
            self.name,
        )


# -- probability of a solve --------------------------------------------------------------------------


def test_more_stars_are_never_worse() -> None:
    assert list(SOLVED_SHARE) == sorted(SOLVED_SHARE)
    assert failing([0, 4, 5, SURE_STARS, 500]).tolist() == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0])


def test_a_mean_is_poissons() -> None:
    rng = np.random.default_rng(3)
    for mean in (0.3, 4.0, 8.0, 15.0, 40.0):
        drawn = failing(rng.poisson(mean, 200_000)).mean()
        assert failing_on_mean(mean) == pytest.approx(drawn, abs=4e-3)
    assert failing_on_mean(0.0) == pytest.approx(1.0)


# -- places --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("latitude", "altitude", "low", "high"),
    [
        (47.0, 15.0, -28.0, 90.0),
        (-30.0, 15.0, -90.0, 45.0),
        (0.0, 0.0, -90.0, 90.0),
        (60.0, 80.0, 50.0, 70.0),
    ],
)
def test_what_a_telescope_reaches(latitude: float, altitude: float, low: float, high: float) -> None:
    reach = reach_of(latitude, altitude)
    assert (reach.low_dec_deg, reach.high_dec_deg) == pytest.approx((low, high))


@given(st.floats(-90, 90), st.floats(-90, 90))
@settings(max_examples=50, deadline=None)
def test_places_lie_evenly_in_what_is_reached(latitude: float, altitude: float) -> None:
    reach = reach_of(latitude, altitude)
    places = spread_fields(reach, 1000, 100)
    assert len(places) == 1000
    assert places.dec_deg.min() >= reach.low_dec_deg - 1e-9
    assert places.dec_deg.max() <= reach.high_dec_deg + 1e-9
    low, high = np.sin(np.radians([reach.low_dec_deg, reach.high_dec_deg]))
    for part in (places, places.only(slice(0, 100))):
        height = (np.sin(np.radians(part.dec_deg)) - low) / (high - low)
        assert np.abs(np.sort(height) - np.linspace(0, 1, len(part))).max() < 0.02
        thirds = np.histogram(part.ra_deg, 3, (0, 360))[0] / len(part)
        assert np.abs(thirds - 1 / 3).max() < 0.1


def test_pole_and_plane_are_where_they_are() -> None:
    _, b_pole = galactic(pole_fields(WHOLE).ra_deg, pole_fields(WHOLE).dec_deg)
    _, b_plane = galactic(plane_fields(WHOLE).ra_deg, plane_fields(WHOLE).dec_deg)
    assert np.abs(b_pole).min() >= 75.0
    assert np.abs(b_plane).max() <= 5.0
    assert (b_pole > 0).any()
    assert (b_pole < 0).any()
    # 10° about the north celestial pole there is neither
    assert len(pole_fields(Reach(80.0, 90.0))) == len(plane_fields(Reach(80.0, 90.0))) == 0


# -- counts --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dec", [0.0, 61.0, -89.9, 90.0])
@pytest.mark.parametrize("rotation", [0.0, 33.0, 250.0])
def test_a_frame_holds_what_its_wcs_says(dec: float, rotation: float) -> None:
    rng = np.random.default_rng(8)
    ra, down = rng.uniform(0, 360, 4000), np.degrees(np.arcsin(rng.uniform(-1, 1, 4000)))
    near = np.radians(rng.uniform(-3, 3, (2, 4000)))
    center = Icrs(359.9, dec)
    from mountnav.sky.sphere import gnomonic_inverse

    about = gnomonic_inverse(near[0], near[1], center.ra_deg, center.dec_deg)
    ra, down = np.concatenate((ra, about[0])), np.concatenate((down, about[1]))
    sky = Strewn(ra, down, rng.uniform(5, 15, ra.size))
    frame = FrameSize(4.0, 2.0, 12.0)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval = [center.ra_deg, center.dec_deg]
    angle = math.radians(rotation)
    step = 0.001
    # +y has the position angle `rotation`
    wcs.wcs.cd = step * np.array([[-math.cos(angle), math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    wcs.wcs.crpix = [1.0, 1.0]
    x, y = wcs.wcs_world2pix(sky.ra_deg, sky.dec_deg, 0)
    half = [math.degrees(math.tan(math.radians(side / 2))) / step for side in (4.0, 2.0)]
    front = np.isfinite(x) & np.isfinite(y)
    toward = np.cos(np.radians(sky.dec_deg)) * np.cos(np.radians(dec)) * np.cos(
        np.radians(sky.ra_deg - center.ra_deg)
    ) + np.sin(np.radians(sky.dec_deg)) * math.sin(math.radians(dec))
    inside = front & (toward > 0) & (np.abs(x) <= half[0]) & (np.abs(y) <= half[1]) & (sky.mag <= 12.0)
    found = stars_in_frame(sky, frame, center, rotation, epoch_yr=EPOCH)
    assert found.size == int(inside.sum()) > 100
    assert found.tolist() == sorted(sky.mag[inside].tolist())


@pytest.mark.long
@pytest.mark.parametrize(
    ("side", "share", "within"),
    [(0.3, 0.84, 0.05), (0.5, 0.39, 0.05), (0.75, 0.034, 0.02), (1.0, 0.0006, 0.003)],
)
def test_poor_fields_are_as_many_as_were_counted_elsewhere(side: float, share: float, within: float) -> None:
    """Share of fields with fewer than 10 stars of Tycho-2 [CATALOGS §0; of all its stars, in fact]."""
    places = spread_fields(WHOLE, 800)
    poor = [
        stars_in_frame(
            embedded_catalog(), FrameSize(side, side, 20.0), Icrs(ra, dec), turn, epoch_yr=EPOCH
        ).size
        < 10
        for ra, dec, turn in zip(places.ra_deg, places.dec_deg, places.rotation_deg, strict=True)
    ]
    assert np.mean(poor) == pytest.approx(share, abs=within)


@pytest.mark.long
@pytest.mark.parametrize("side", [0.6, 1.0])
def test_the_short_cuts_change_nothing(side: float) -> None:
    frame = FrameSize(side, side, 11.5)
    places, pole, plane = few_places(700)
    found = counted(embedded_catalog(), frame, places, pole, plane, epoch_yr=EPOCH)
    numbers = [
        stars_in_frame(embedded_catalog(), frame, Icrs(ra, dec), turn, epoch_yr=EPOCH).size
        for ra, dec, turn in zip(places.ra_deg, places.dec_deg, places.rotation_deg, strict=True)
    ]
    assert found.looked_at == 700
    np.testing.assert_array_equal(found.fails, failing(numbers))
    assert found.fails.max() > 0
    assert found.median == np.median(numbers[:300])


@pytest.mark.long
def test_a_rich_sky_is_not_counted_to_the_end() -> None:
    places, pole, plane = few_places(2000)
    found = counted(embedded_catalog(), FrameSize(8.0, 6.0, 9.5), places, pole, plane, epoch_yr=EPOCH)
    assert found.looked_at == 300
    assert found.fails.sum() == 0.0
    assert found.plane > found.median > found.pole > 50


@pytest.mark.long
@pytest.mark.parametrize("depth", [10.5, 11.5])
@pytest.mark.parametrize("side", one_in(2, [1.0, 0.75, 0.45, 0.3]))
def test_the_model_is_near_the_real_counts(side: float, depth: float) -> None:
    frame = FrameSize(side, side, depth)
    places, pole, plane = spread_fields(WHOLE, 900), pole_fields(WHOLE), plane_fields(WHOLE)
    real = counted(embedded_catalog(), frame, places, pole, plane, epoch_yr=EPOCH)
    model = modeled(11.5, None, frame, places, pole, plane)
    assert model.fails.mean() == pytest.approx(real.fails.mean(), rel=0.15, abs=0.012)
    assert model.pole == pytest.approx(real.pole, rel=0.2, abs=0.2)
    assert model.plane == pytest.approx(real.plane, rel=0.2)
    assert model.median == pytest.approx(real.median, abs=max(1.0, 0.15 * real.median))


def test_a_thinned_catalog_has_no_more_than_it_has() -> None:
    places, pole, plane = few_places(300)
    thin = modeled(18.0, 50.0, FrameSize(0.5, 0.5, 17.0), places, pole, plane)
    assert thin.plane == thin.median == pytest.approx(12.5)


# -- verdicts ------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_wide_field_suffices_and_costs_no_advice() -> None:
    found = diagnose(camera(1.75, 1.75, 15.5), reach_of(33.0, 15.0), TYCHO2, epoch_yr=EPOCH, fields=600)
    assert found.verdict is Verdict.SUFFICES
    assert found.together < 0.001
    assert found.advice == found.remedies == ()
    assert found.here[0].plane > found.here[0].median > found.here[0].pole > 40


@pytest.mark.long
def test_a_narrow_field_is_told_which_catalog_and_how() -> None:
    found = diagnose(camera(0.377, 0.377, 17.5), reach_of(-30.169, 15.0), TYCHO2, epoch_yr=EPOCH, fields=600)
    assert found.verdict is Verdict.INSUFFICIENT
    assert 0.3 < found.together < 0.5
    smallest, finest = found.remedies
    assert smallest.known is not None
    assert finest.known is not None
    assert smallest.known.installed_gb < finest.known.installed_gb
    assert finest.known.sigma_arcsec < smallest.known.sigma_arcsec
    for one in found.remedies:
        assert one.fails_share < 0.01
        # nothing that would do is smaller, and nothing as small is finer
        assert any(
            present(one.known).command in text and in_size(present(one.known).download_gb) in text
            for text in found.advice
        )
    assert any("--dec-range -90 49" in text for text in found.advice)


@pytest.mark.long
def test_no_smaller_catalog_would_have_sufficed() -> None:
    reach = reach_of(46.4, 15.0)
    places, pole, plane = spread_fields(reach, 600), pole_fields(reach), plane_fields(reach)
    facts = camera(0.27, 0.2024, 16.8)
    smallest = diagnose(facts, reach, TYCHO2, epoch_yr=EPOCH, fields=600).remedies[0].known
    assert smallest is not None
    assert facts.frame is not None
    for known in obtainable_catalogs():
        if known.has_magnitudes and known.installed_gb < smallest.installed_gb:
            found = modeled(known.faintest_mag, known.densest_deg2, facts.frame, places, pole, plane)
            assert found.fails.mean() >= 0.01, known.name


@pytest.mark.long
def test_a_field_too_small_for_any_catalog_is_told_what_helps() -> None:
    found = diagnose(camera(0.079, 0.079, 15.5), reach_of(49.0, 15.0), TYCHO2, epoch_yr=EPOCH, fields=600)
    assert found.verdict is Verdict.INSUFFICIENT
    assert found.advice[0].startswith("no catalog suffices")
    assert any("expose longer" in text for text in found.advice)
    assert any("wider camera" in text for text in found.advice)
    assert found.remedies[0].fails_share > 0.01


@pytest.mark.long
def test_an_estimated_depth_is_said_to_be_one() -> None:
    found = diagnose(
        camera(0.3, 0.3, 15.0, depth_is_estimate=True), reach_of(49.0, 15.0), TYCHO2, epoch_yr=EPOCH
    )
    assert "limiting_mag" in found.advice[-1]


def test_an_unknown_camera_is_unknown() -> None:
    found = diagnose(CameraFacts("t", None, problem="set it"), WHOLE, TYCHO2, epoch_yr=EPOCH, fields=600)
    assert (found.verdict, found.advice, found.here) == (Verdict.UNKNOWN, ("set it",), ())


@pytest.fixture
def north(tmp_path: Path) -> PackedStore:
    """A deep catalog of the sky north of the equator, even: 20 stars per square degree."""
    rng = np.random.default_rng(1)
    count = 412_530
    e, epoch = np.full(count, 30.0), np.full(count, 2016.0)
    still = np.zeros(count)
    columns = CatalogColumns(
        rng.uniform(0, 360, count),
        np.degrees(np.arcsin(rng.uniform(0, 1, count))),
        still,
        still,
        rng.uniform(9, 10.5, count),
        error_curve((e, e), (e / 10, e / 10), (epoch, epoch)),
    )
    pack(columns, tmp_path / "north.mnc", name="north", band="V", epoch_yr=2000.0, nside=32)
    return PackedStore(tmp_path / "north.mnc")


@pytest.mark.long
def test_what_a_catalog_has_no_sky_for_is_told_apart(north: PackedStore) -> None:
    reach = Reach(-30.0, 90.0)
    both = diagnose(
        camera(1.1, 1.1, 10.5), reach, (*TYCHO2, NamedCatalog("north", north)), epoch_yr=EPOCH, fields=600
    )
    by_slug = {one.slug: one for one in both.here}
    # a third of the reachable sky lies south, and a strip at the border is not trusted
    assert by_slug["north"].uncovered_share == pytest.approx(1 / 3, abs=0.08)
    assert by_slug["north"].fails_share == pytest.approx(by_slug["north"].uncovered_share, abs=0.005)
    assert by_slug["north"].fails_share >= by_slug["north"].uncovered_share
    assert by_slug["tycho2"].uncovered_share == 0.0
    # the best for each field: the south is Tycho-2's
    assert both.together < min(one.fails_share for one in both.here)
    assert by_slug["north"].median == pytest.approx(24.2, abs=2.0)


# -- advice at night -----------------------------------------------------------------------------------


def test_advice_at_night_names_number_catalog_size_and_command() -> None:
    text = advice_for(0.377, 0.377, 17.5, Icrs(192.86, 27.13), [embedded_catalog()])
    assert text.startswith("Tycho-2 holds about ")
    held = float(text.split("about ")[1].split()[0])
    assert held == pytest.approx(3.5, abs=1.5)
    assert "mountnav catalog import " in text
    assert " on disk" in text
    assert len(text) < 400


def test_advice_at_night_follows_the_place() -> None:
    frame = (0.377, 0.377, 17.5)
    plane = advice_for(*frame, Icrs(266.4, -29.0), [])
    anywhere = advice_for(*frame, None, [embedded_catalog()])
    assert plane.startswith("there is no catalog")
    assert "in the median of the sky" in anywhere
    hopeless = advice_for(0.079, 0.079, 14.0, Icrs(192.86, 27.13), [embedded_catalog()])
    assert "expose longer" in hopeless
    assert "import" not in hopeless
    plenty = advice_for(2.0, 2.0, 13.0, Icrs(266.4, -29.0), [embedded_catalog()])
    assert plenty.endswith("which is enough")


# -- what can be had -----------------------------------------------------------------------------------


@pytest.mark.parametrize("known", obtainable_catalogs(), ids=lambda one: one.name)
def test_what_can_be_had_is_consistent(known: ObtainableCatalog) -> None:
    assert known.kind in CATALOGS
    assert known.command.startswith(f"mountnav catalog import {known.kind} ")
    assert known.terms
    places = spread_fields(WHOLE, 2000)
    density = density_deg2(places.ra_deg, places.dec_deg, known.faintest_mag)
    if known.densest_deg2 is not None:
        density = np.minimum(density, known.densest_deg2)
    # the stars that the model expects of such a catalog are about those that it has
    assert float(density.mean()) * 41252.96 == pytest.approx(known.stars, rel=0.4)


def test_the_unevenness_of_the_sky_costs_where_stars_are_just_enough() -> None:
    assert failing_near(25.0) > failing_on_mean(25.0)
    assert failing_near(1.0) == pytest.approx(failing_on_mean(1.0), abs=0.01)
