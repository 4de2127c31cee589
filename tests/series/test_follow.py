"""Following simulated series: shifts and drift against truth, and all that goes wrong in a night."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mountnav.frames import Frame, Hint
from mountnav.identification.settings import PreliminarySettings
from mountnav.identification.wcs import plate_from_cards
from mountnav.measuring.measure import measure
from mountnav.series.follow import SeriesFollower, follow
from mountnav.series.results import Mode, SeriesReport, SeriesSettings
from mountnav.series.shift import icrs_at_pixels
from mountnav.simulation.render import project
from mountnav.simulation.trails import SatelliteTrail
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec
from mountnav.units import julian_year
from tests.present import present
from tests.series.against_catalog import place_by_catalog
from tests.series.conftest import CENTER, OPTICS

HINT = Hint(center=CENTER, radius_deg=1.0)
SCALE = OPTICS.scale_arcsec_px


def drifting(frames: int, east: float, north: float, start: Icrs = CENTER) -> list[Icrs]:
    return [displaced(start, east * i, north * i) for i in range(frames)]


def true_shift(anchor: Icrs, center: Icrs, optics=OPTICS) -> tuple[float, float]:
    x, y = project(anchor, optics, np.array([center.ra_deg]), np.array([center.dec_deg]))
    return float(x[0]) - (optics.width_px - 1) / 2, float(y[0]) - (optics.height_px - 1) / 2


def followed(frames, catalog, hint: Hint | None = HINT, **changes) -> SeriesReport:
    return follow(frames, catalog, hint=hint, settings=SeriesSettings(**changes))


@pytest.fixture(scope="module")
def night(draw, catalog) -> tuple[SeriesReport, list[Icrs]]:
    """Twelve frames with drift; a satellite crosses the fifth."""
    centers = drifting(12, 30.0, -12.0)
    trail = SatelliteTrail(-20, 60, 660, 420, 4000.0)
    frames = [draw(i, c, trails=(trail,) if i == 5 else ()) for i, c in enumerate(centers)]
    return followed(frames, catalog), centers


@pytest.mark.long
def test_shifts_are_true(night) -> None:
    report, centers = night
    off = []
    for one in report.frames[1:]:
        assert one.shift is not None
        dx, dy = true_shift(centers[one.shift.anchor], centers[one.number])
        off.append(((one.shift.dx_px - dx), (one.shift.dy_px - dy)))
        assert abs(off[-1][0]) < 6 * one.shift.dx_sigma_px + 0.002
        assert one.shift.false_probability < 1e-9
    assert math.sqrt(np.mean(np.sum(np.square(off), axis=1))) < 0.03


@pytest.mark.long
def test_one_frame_is_solved_the_rest_followed_and_audited(night) -> None:
    report, centers = night
    assert [one.mode for one in report.frames] == [
        Mode.FULL, *[Mode.PRELIMINARY] * 9, Mode.FULL, Mode.PRELIMINARY
    ]  # fmt: skip
    audited = report.frames[10]
    assert audited.audit is not None
    assert audited.audit.total_arcsec < 0.3 * SCALE
    for one, true in zip(report.frames, centers, strict=True):
        assert one.center is not None
        assert separation_arcsec(present(one.center), true) < 0.1 * SCALE
        middle = one.solution.icrs_at((one.width_px - 1) / 2, (one.height_px - 1) / 2)
        assert separation_arcsec(middle, one.center) < 1e-3
        assert one.solution.false_probability < 1e-9
        assert one.solution.center_sigma_arcsec > 0


@pytest.mark.long
def test_drift_is_true_and_within_its_error(night) -> None:
    report, centers = night
    assert len(report.segments) == 1
    drift = report.drift
    cosine = math.cos(math.radians(np.mean([one.dec_deg for one in centers])))
    east = (centers[-1].ra_deg - centers[0].ra_deg) * 3600 * cosine / 11
    north = (centers[-1].dec_deg - centers[0].dec_deg) * 3600 / 11
    assert abs(drift.ra_arcsec_min - east) < 5 * drift.ra_sigma_arcsec_min + 0.002
    assert abs(drift.dec_arcsec_min - north) < 5 * drift.dec_sigma_arcsec_min + 0.002
    assert drift.ra_sigma_arcsec_min < 0.05


@pytest.mark.long
def test_the_satellite_does_not_persist(night) -> None:
    report, _ = night
    usual = np.median([one.persistent for one in report.frames])
    assert all(abs(one.persistent - usual) < 0.15 * usual for one in report.frames)
    s = np.linspace(0, 1, 200)
    x, y = -20 + 680 * s, 60 + 360 * s
    shift = report.frames[5].shift
    sources = report.persistent
    near = np.hypot(
        sources.x_px[:, None] - shift.dx_px - x[None, :], sources.y_px[:, None] - shift.dy_px - y[None, :]
    ).min(axis=1)
    # no more persistent sources along the trail than anywhere else on as wide a strip
    strip = 2 * 2.0 * 770 / (640 * 480)
    assert (near < 2.0).sum() < 3 * strip * len(sources) + 3


@pytest.mark.long
def test_jumps_split_the_series_and_leave_the_drift_alone(draw, catalog) -> None:
    centers = drifting(12, 6.0, 3.0)
    centers = [displaced(c, 90.0 * (i >= 4), -60.0 * (i >= 8)) for i, c in enumerate(centers)]
    report = followed([draw(i, c) for i, c in enumerate(centers)], catalog, audit_every=0)
    assert [one.frames for one in report.segments] == [
        tuple(range(4)), tuple(range(4, 8)), tuple(range(8, 12))
    ]  # fmt: skip
    assert present(report.segments[1].jump).east_arcsec == pytest.approx(90.0, abs=1.0)
    assert present(report.segments[2].jump).north_arcsec == pytest.approx(-60.0, abs=1.0)
    assert present(report.drift).ra_arcsec_min == pytest.approx(6.0, abs=0.1)
    assert present(report.drift).dec_arcsec_min == pytest.approx(3.0, abs=0.1)


@pytest.mark.long
def test_a_slew_to_another_field_starts_anew(draw, catalog) -> None:
    there = Icrs(84.9, 20.6)
    centers = [*drifting(4, 5.0, 5.0), *drifting(4, 5.0, 5.0, there)]
    report = followed([draw(i, c) for i, c in enumerate(centers)], catalog)
    assert [one.mode for one in report.frames].count(Mode.FULL) == 2
    assert report.frames[4].mode is Mode.FULL
    assert "not followed" in report.frames[4].notes[0]
    assert {present(one.shift).anchor for one in report.frames[5:]} == {4}
    for one, true in zip(report.frames, centers, strict=True):
        assert separation_arcsec(present(one.center), true) < 0.1 * SCALE
    assert [len(one.frames) for one in report.segments] == [4, 4]


@pytest.mark.long
def test_field_rotation_is_seen_and_solved_fully(draw, catalog) -> None:
    """An alt-az mount: the field turns by 0.15° a minute."""
    frames = [draw(i, CENTER, replace(OPTICS, rotation_deg=12 + 0.15 * i)) for i in range(6)]
    report = followed(frames, catalog)
    for number, one in enumerate(report.frames):
        assert one.mode is Mode.FULL
        assert present(one.solution).rotation_deg == pytest.approx(12 + 0.15 * number, abs=0.02)
        assert separation_arcsec(present(one.center), CENTER) < 0.1 * SCALE
    assert all("turned" in one.notes[0] or "not followed" in one.notes[0] for one in report.frames[1:])
    assert report.frames[-1].persistent > 100
    assert abs(present(report.drift).ra_arcsec_min) < 5 * present(report.drift).ra_sigma_arcsec_min


@pytest.mark.long
def test_a_meridian_flip_is_solved_anew(draw, catalog) -> None:
    frames = [draw(i, CENTER, replace(OPTICS, rotation_deg=12 + 180 * (i >= 3))) for i in range(6)]
    report = followed(frames, catalog)
    assert report.frames[3].mode is Mode.FULL
    assert report.frames[5].mode is Mode.PRELIMINARY
    assert present(report.frames[5].solution).rotation_deg == pytest.approx(192.0, abs=0.1)
    assert all(separation_arcsec(present(one.center), CENTER) < 0.1 * SCALE for one in report.frames)


@pytest.mark.long
def test_bad_frames_in_the_middle_are_told_and_the_series_goes_on(draw, catalog, tmp_path: Path) -> None:
    text = tmp_path / "notes.fits"
    text.write_text("no image")
    centers = drifting(7, 10.0, 0.0)
    drawn = [draw(i, c) for i, c in enumerate(centers)]
    frames: list[Frame | Path] = list(drawn)
    frames[2] = text
    frames[3] = replace(drawn[3], pixels=np.full((480, 640), 300, dtype=np.uint16))
    cloud = np.random.default_rng(1).normal(500, 8, (480, 640)).astype(np.float32)
    frames[4] = replace(drawn[4], pixels=cloud)
    report = followed(frames, catalog)
    assert [one.solution is not None for one in report.frames] == [
        True,
        True,
        False,
        False,
        False,
        True,
        True,
    ]
    assert all(one.notes for one in report.frames[2:5])
    assert "same value" in report.frames[3].notes[0]
    assert {present(one.shift).anchor for one in report.frames[5:]} == {0}
    assert present(report.drift).frames == 4
    assert present(report.drift).ra_arcsec_min == pytest.approx(10.0, abs=0.1)


@pytest.mark.long
def test_another_binning_in_the_middle(draw, catalog) -> None:
    half = replace(
        OPTICS, width_px=320, height_px=240, scale_arcsec_px=12.0, fwhm_px=1.6, distortion_px2=4e-8
    )
    frames = [draw(i, c, half if i == 2 else OPTICS) for i, c in enumerate(drifting(5, 10.0, 0.0))]
    report = followed(frames, catalog)
    assert report.frames[2].mode is Mode.FULL
    assert report.frames[2].shift is None
    assert "another size" in report.frames[2].notes[0]
    assert {present(one.shift).anchor for one in report.frames[3:]} == {0}
    assert len(report.segments) == 1
    assert present(report.drift).ra_arcsec_min == pytest.approx(10.0, abs=0.2)


@pytest.mark.long
def test_without_times_there_are_shifts_but_no_drift(draw, catalog) -> None:
    frames = [replace(draw(i, c), mid_exposure_utc=None) for i, c in enumerate(drifting(4, 20.0, 0.0))]
    report = followed(frames, catalog)
    assert report.drift is None
    assert "when it was taken" in report.reason
    assert report.segments == ()
    assert all(one.shift is not None and one.center is not None for one in report.frames[1:])


@pytest.mark.long
def test_one_frame_without_a_time_takes_no_part_in_the_drift(draw, catalog) -> None:
    frames = [draw(i, c) for i, c in enumerate(drifting(5, 20.0, 0.0))]
    frames[2] = replace(frames[2], mid_exposure_utc=None)
    report = followed(frames, catalog)
    assert present(report.drift).frames == 4
    assert report.frames[2].center is not None


@pytest.mark.long
def test_a_first_frame_without_stars_is_no_anchor_for_long(draw, catalog) -> None:
    centers = drifting(5, 10.0, 0.0)
    frames = [draw(i, c) for i, c in enumerate(centers)]
    frames[0] = replace(
        frames[0], pixels=np.random.default_rng(1).normal(500, 8, (480, 640)).astype(np.float32)
    )
    report = followed(frames, catalog)
    assert report.frames[0].center is None
    assert report.frames[1].mode is Mode.FULL
    assert all(one.center is not None for one in report.frames[1:])


@pytest.mark.long
def test_without_any_hint_there_are_shifts_and_no_centers(draw, catalog) -> None:
    centers = drifting(4, 20.0, 0.0)
    frames = [draw(i, c) for i, c in enumerate(centers)]
    report = followed(frames, catalog, hint=None, solving=replace(SeriesSettings().solving, budget_s=0.05))
    assert all(one.solution is None for one in report.frames)
    assert report.drift is None
    assert "solved" in report.reason
    for one in report.frames[1:]:
        dx, dy = true_shift(centers[0], centers[one.number])
        assert (present(one.shift).dx_px, present(one.shift).dy_px) == pytest.approx((dx, dy), abs=0.05)


@pytest.mark.long
def test_frames_before_the_first_solved_one_are_placed_afterwards(draw, catalog) -> None:
    """Only the third frame's header tells where it was taken."""
    centers = drifting(5, 10.0, 5.0)
    frames = [draw(i, c) for i, c in enumerate(centers)]
    frames[2] = replace(frames[2], hint=replace(frames[2].hint, center=CENTER))
    follower = SeriesFollower(
        catalog, settings=SeriesSettings(solving=replace(SeriesSettings().solving, budget_s=2.0))
    )
    first = follower.add(frames[0])
    assert first.center is None
    for one in frames[1:]:
        follower.add(one)
    report = follower.report()
    for one, true in zip(report.frames, centers, strict=True):
        assert one.center is not None, one.notes
        assert separation_arcsec(present(one.center), true) < 0.1 * SCALE
    assert present(report.frames[0].shift).anchor == 2
    assert present(report.drift).ra_arcsec_min == pytest.approx(10.0, abs=0.2)


@pytest.mark.long
@pytest.mark.parametrize(
    "start",
    [
        Icrs(359.9999, 2.0),
        pytest.param(Icrs(40.0, 89.6), marks=pytest.mark.long),
        Icrs(200.0, -89.2),
    ],
)
def test_seam_and_poles_make_no_difference(draw, catalog, start) -> None:
    centers = drifting(5, 4.0, 3.0, start)
    frames = [draw(i, c) for i, c in enumerate(centers)]
    report = followed(frames, catalog, Hint(center=start, radius_deg=1.0))
    for one, true in zip(report.frames, centers, strict=True):
        assert separation_arcsec(present(one.center), true) < 0.1 * SCALE
    east = [math.remainder(one.ra_deg - start.ra_deg, 360) * 3600 for one in centers]
    cosine = math.cos(math.radians(np.mean([one.dec_deg for one in centers])))
    assert present(report.drift).ra_arcsec_min == pytest.approx(
        cosine * np.polyfit(range(5), east, 1)[0], abs=0.1
    )


@pytest.mark.long
def test_the_papers_profile_follows_too(draw, catalog) -> None:
    centers = drifting(5, 10.0, -10.0)
    sparse = replace(OPTICS, faint_stars_deg2=0.0)
    frames = [draw(i, c, sparse) for i, c in enumerate(centers)]
    report = followed(frames, catalog, preliminary=PreliminarySettings())
    for one, true in zip(report.frames, centers, strict=True):
        assert separation_arcsec(present(one.center), true) < SCALE


@pytest.mark.long
def test_streaming_tells_the_same_as_the_whole(draw, catalog) -> None:
    frames = [draw(i, c) for i, c in enumerate(drifting(4, 15.0, 0.0))]
    follower = SeriesFollower(catalog, hint=HINT)
    results = [follower.add(one) for one in frames]
    whole = follow(frames, catalog, hint=HINT)
    for one, other in zip(results, whole.frames, strict=True):
        assert one.center == other.center
        assert one.shift == other.shift
    assert [one.persistent > 0 for one in results] == [False, False, True, True]
    assert all(one.persistent > 0 for one in whole.frames)


@pytest.mark.long
def test_a_frame_is_placed_by_the_catalog_when_only_its_center_is_unknown(draw, catalog) -> None:
    solved = present(followed([draw(0, CENTER)], catalog).frames[0].solution)
    plate = plate_from_cards(solved.wcs, width_px=640, height_px=480)
    for number, (east, north) in enumerate(((0, 0), (600, -300), (-1300, 900), (100, 1200))):
        true = displaced(CENTER, east, north)
        frame = draw(number + 1, true)
        got = place_by_catalog(
            measure(frame), plate, CENTER, catalog, epoch_yr=julian_year(frame.mid_exposure_utc)
        )
        assert got.move is not None, got.preliminary.detail
        assert separation_arcsec(got.move.center, true) < 0.2 * SCALE
    elsewhere = measure(draw(9, Icrs(120.0, -30.0)))
    got = place_by_catalog(elsewhere, plate, CENTER, catalog, epoch_yr=2026.9)
    assert got.move is None


class EmptyingCatalog:
    """A catalog that can be emptied: full solutions then fail, as under cloud."""

    def __init__(self, catalog) -> None:
        self.catalog, self.empty = catalog, False
        self.name = catalog.name

    def cone(self, center, radius_deg, *, epoch_yr, mag_limit=None):
        limit = -5.0 if self.empty else mag_limit
        return self.catalog.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=limit)


@pytest.mark.long
def test_a_turned_field_that_can_not_be_solved_is_placed_with_its_turn(draw, catalog) -> None:
    emptying = EmptyingCatalog(catalog)
    follower = SeriesFollower(
        emptying, hint=HINT, settings=SeriesSettings(solving=replace(SeriesSettings().solving, budget_s=1.0))
    )
    follower.add(draw(0, CENTER))
    emptying.empty = True
    true = displaced(CENTER, 60.0, -90.0)
    got = follower.add(draw(1, true, replace(OPTICS, rotation_deg=12.12)))
    assert got.mode is Mode.PRELIMINARY
    assert "turned" in got.notes[0]
    assert "full solution" in got.notes[1]
    assert present(got.solution).rotation_deg == pytest.approx(12.12, abs=0.01)
    assert separation_arcsec(present(got.center), true) < 0.1 * SCALE
    middle = present(present(got.solution).icrs_at((got.width_px - 1) / 2, (got.height_px - 1) / 2))
    assert separation_arcsec(middle, present(got.center)) < 1e-3


@pytest.mark.long
def test_an_audit_that_contradicts_the_shift_starts_anew(draw, catalog) -> None:
    """As if the first frame's solution had been wrong by five pixels."""
    centers = drifting(4, 10.0, 0.0)
    follower = SeriesFollower(catalog, hint=HINT, settings=SeriesSettings(audit_every=2))
    follower.add(draw(0, centers[0]))
    (size, anchor), *_ = follower._anchors.items()
    plate = present(anchor.plate)
    wrong = replace(plate, tangent=displaced(plate.tangent, 0.0, 5 * SCALE))
    ra, dec = icrs_at_pixels(wrong, anchor.sources.x_px, anchor.sources.y_px)
    follower._anchors[size] = replace(anchor, plate=wrong, ra_deg=ra, dec_deg=dec)
    followed_wrongly = follower.add(draw(1, centers[1]))
    assert separation_arcsec(present(followed_wrongly.center), centers[1]) > 4 * SCALE
    audited = follower.add(draw(2, centers[2]))
    assert audited.mode is Mode.FULL
    assert "contradicts" in audited.notes[0]
    assert separation_arcsec(present(audited.center), centers[2]) < 0.1 * SCALE
    after = follower.add(draw(3, centers[3]))
    assert present(after.shift).anchor == 2
    assert separation_arcsec(present(after.center), centers[3]) < 0.1 * SCALE


@pytest.mark.long
def test_copies_of_a_frame_are_told_and_count_once(draw, catalog) -> None:
    first, second = (draw(number, center) for number, center in enumerate(drifting(2, 3.0, 0.0)))
    report = followed([first, replace(first), second, first], catalog)
    assert [one.mode is Mode.NONE for one in report.frames] == [False, True, False, True]
    assert "a copy of frame 0" in report.frames[1].notes[0]
    plain = followed([first, second], catalog)
    assert [one.persistent for one in report.frames if one.mode is not Mode.NONE] == [
        one.persistent for one in plain.frames
    ]
