"""Frames with pixels that aren't square, and pictures whose sky is cut off: solved, to the right place."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from astropy.wcs import WCS

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame, Hint
from mountnav.reading import frame_from_array
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Verdict
from mountnav.solving.solve import solve
from mountnav.solving.special_frames import clipped_share, pixel_ratio, special_frame

PLACE = Icrs(85.0, 30.0)
SCALE_ARCSEC_PX = 4.0
Cards = dict[str, str | int | float | bool]
INSTANT = datetime(2026, 1, 1, tzinfo=UTC)
HINT = Hint(center=PLACE, radius_deg=1.0)


@pytest.fixture(scope="module")
def square() -> Frame:
    optics = SimulatedOptics(1200, 900, SCALE_ARCSEC_PX)
    catalog = embedded_catalog()
    return draw_frame(PLACE, optics, catalog, exposure_s=4.0, mid_exposure_utc=INSTANT, seed=(0, 1))


def _solved(frame: Frame, hint: Hint = HINT) -> Verdict:
    verdict = solve(frame, embedded_catalog(), hint=hint)
    assert verdict.solution is not None, verdict.detail
    return verdict


def _binned(frame: Frame, columns: int, rows: int, cards: Cards) -> Frame:
    pixels = np.asarray(frame.pixels, dtype=np.float64)
    high, wide = pixels.shape[0] // rows, pixels.shape[1] // columns
    binned = pixels.reshape(high, rows, wide, columns).sum(axis=(1, 3)).astype(np.float32)
    return replace(frame_from_array(binned, cards), mid_exposure_utc=INSTANT)


@pytest.mark.long
@pytest.mark.parametrize(("columns", "rows"), [(1, 2), (2, 1), (1, 3)])
@pytest.mark.parametrize("by", ["binning", "sizes"])
def test_uneven_binning_is_solved_on_the_pixels_of_the_file(
    square: Frame, columns: int, rows: int, by: str
) -> None:
    cards: Cards
    if by == "binning":
        cards = {"XBINNING": columns, "YBINNING": rows, "XPIXSZ": 3.76, "YPIXSZ": 3.76}
    else:
        cards = {"XPIXSZ": 3.76 * columns, "YPIXSZ": 3.76 * rows, "XBINNING": columns, "YBINNING": rows}
    frame = _binned(square, columns, rows, cards)
    verdict = _solved(frame)
    found, plain = verdict.solution, _solved(square).solution
    assert found is not None
    assert plain is not None
    assert separation_arcsec(found.center, plain.center) < 0.3 * SCALE_ARCSEC_PX
    assert found.scale_arcsec_px == pytest.approx(SCALE_ARCSEC_PX * (columns * rows) ** 0.5, rel=1e-3)
    assert (found.wcs["IMAGEW"], found.wcs["IMAGEH"]) == (1200 // columns, 900 // rows)
    assert found.wcs["CRPIX1"] == pytest.approx((1200 // columns + 1) / 2)
    # a corner, and each star, through the cards as other programs read them
    wcs, whole = WCS(found.wcs), WCS(plain.wcs)
    corner = wcs.all_pix2world([[9.5, 9.5]], 0)[0]
    same = whole.all_pix2world([[10 * columns - 0.5, 10 * rows - 0.5]], 0)[0]
    assert separation_arcsec(Icrs(*map(float, corner)), Icrs(*map(float, same))) < SCALE_ARCSEC_PX
    pairs = found.identified
    sky = wcs.all_pix2world(np.column_stack((pairs.x_px, pairs.y_px)), 0)
    off = [
        separation_arcsec(Icrs(*map(float, one)), Icrs(float(ra), float(dec)))
        for one, ra, dec in zip(sky, pairs.ra_deg, pairs.dec_deg, strict=True)
    ]
    assert np.median(off) < 0.3 * SCALE_ARCSEC_PX * rows * columns
    assert verdict.seen_px[:, 0].max() < 1200 // columns
    assert verdict.seen_px[:, 1].max() > 0.7 * (900 // rows)
    assert any("merged into one" in note for note in verdict.notes)


def test_the_inverse_polynomials_of_a_bent_field_are_carried_back_too() -> None:
    optics = SimulatedOptics(1500, 1200, 9.0, distortion_px2=4e-9)
    bent = draw_frame(
        PLACE, optics, embedded_catalog(), exposure_s=4.0, mid_exposure_utc=INSTANT, seed=(0, 1)
    )
    found = _solved(_binned(bent, 1, 2, {"XBINNING": 1, "YBINNING": 2})).solution
    assert found is not None
    wcs = WCS(found.wcs)
    assert wcs.sip is not None
    places = np.array([[10.0, 20.0], [1400.0, 30.0], [700.0, 580.0]])
    there = wcs.sip_foc2pix(wcs.sip_pix2foc(places, 0), 0)
    assert np.abs(there - places).max() < 0.02


def test_a_scale_may_be_meant_along_either_side(square: Frame) -> None:
    frame = _binned(square, 1, 2, {"XBINNING": 1, "YBINNING": 2})
    for scale in (SCALE_ARCSEC_PX, 2 * SCALE_ARCSEC_PX):
        hint = replace(HINT, scale_low_arcsec_px=0.95 * scale, scale_high_arcsec_px=1.05 * scale)
        assert _solved(frame, hint).solved


@pytest.mark.long  # the search on merged pixels is gone through in vain
def test_a_header_that_is_wrong_does_no_harm(square: Frame) -> None:
    wrong = replace(square, header={"XBINNING": 1, "YBINNING": 2})
    verdict = _solved(wrong)
    assert verdict.solution is not None
    assert separation_arcsec(verdict.solution.center, PLACE) < SCALE_ARCSEC_PX


@pytest.mark.parametrize(
    ("header", "ratio"),
    [
        ({}, 1.0),
        ({"XPIXSZ": 3.76, "YPIXSZ": 3.76}, 1.0),
        ({"XPIXSZ": 9.6, "YPIXSZ": 7.5}, 7.5 / 9.6),
        ({"XPIXSZ": 3.76, "YPIXSZ": 3.77}, 1.0),
        ({"XPIXSZ": 3.76, "YPIXSZ": 0.0, "XBINNING": 1, "YBINNING": 2}, 2.0),
        ({"XBINNING": 1, "YBINNING": 16}, 1.0),
        ({"XBINNING": "two", "YBINNING": 2}, 1.0),
    ],
)
def test_what_a_header_says_of_the_shape(header: dict[str, float | str], ratio: float) -> None:
    assert pixel_ratio(header) == pytest.approx(ratio)


def test_missing_pixels_count_for_nothing() -> None:
    pixels = np.full((40, 40), 7.0, np.float32)
    pixels[3, 4:8] = np.nan
    special = special_frame(Frame(pixels, header={"XPIXSZ": 1.0, "YPIXSZ": 2.5}))
    assert special is not None
    merged = special.frame.pixels.astype(np.float64)
    assert merged.shape == (40, 16)
    assert np.nanmax(np.abs(merged - 7.0)) < 1e-5
    assert np.isnan(merged).sum() == 1


@pytest.mark.long
@pytest.mark.parametrize("cut", [1.0, 3.0, 5.0])
@pytest.mark.parametrize("curve", [1.0, 0.5])
def test_a_stretched_picture_with_its_sky_cut_off_is_solved(square: Frame, cut: float, curve: float) -> None:
    pixels = square.pixels.astype(np.float64)
    middle = float(np.median(pixels))
    noise = 1.4826 * float(np.median(np.abs(pixels - middle)))
    share = np.clip((pixels - middle - cut * noise) / (60.0 * noise), 0.0, 1.0) ** curve
    picture = replace(frame_from_array((255.0 * share).astype(np.uint8)), mid_exposure_utc=INSTANT)
    verdict = _solved(picture)
    assert verdict.solution is not None
    assert separation_arcsec(verdict.solution.center, PLACE) < 0.5 * SCALE_ARCSEC_PX
    assert any("its sky is cut off" in note for note in verdict.notes)


def test_brightness_from_0_to_1_is_as_good_as_counts(square: Frame) -> None:
    pixels = square.pixels.astype(np.float32) / np.float32(65535.0)
    whole, part = _solved(square), _solved(replace(square, pixels=pixels))
    one, two = whole.solution, part.solution
    assert one is not None
    assert two is not None
    assert two.pairs == one.pairs
    assert separation_arcsec(one.center, two.center) < 0.01 * SCALE_ARCSEC_PX
    assert two.center_sigma_arcsec == pytest.approx(one.center_sigma_arcsec, rel=0.1)
    assert two.identified.flux.max() == pytest.approx(one.identified.flux.max() / 65535.0, rel=0.01)
    assert whole.quality is not None
    assert part.quality is not None
    assert part.quality.noise_adu == pytest.approx(whole.quality.noise_adu / 65535.0, rel=0.05)
    assert part.quality.limiting_mag == pytest.approx(whole.quality.limiting_mag, abs=0.1)
    assert part.notes == whole.notes


def test_an_ordinary_frame_is_left_as_it_is(square: Frame) -> None:
    assert special_frame(square) is None
    assert clipped_share(square.pixels) < 0.1
    assert clipped_share(np.zeros((900, 900), np.uint8)) == 0.0
    assert clipped_share(np.full((900, 900), np.nan)) == 0.0
