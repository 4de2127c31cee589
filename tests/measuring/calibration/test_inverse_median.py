"""The inverse median filter on painted groups of frames: what is even afterwards, and what must stay."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.errors import BadFrame, BadRequest
from mountnav.frames import Frame
from mountnav.measuring.calibration import Calibration
from mountnav.measuring.calibration.building import build
from mountnav.measuring.calibration.inverse_median import inverse_median
from mountnav.measuring.measure import measure
from mountnav.reading import read_frame
from tests.measuring.synthetic_camera import SyntheticCamera, stars, write

Array = NDArray[np.float64]
HEIGHT, WIDTH = 450, 600
ZERO_ADU = 500.0
SKY_E = 900.0


@pytest.fixture(scope="module")
def camera() -> SyntheticCamera:
    camera = SyntheticCamera(height=HEIGHT, width=WIDTH, hot_pixels=0, dead_pixels=0)
    camera.dark_e_s[:] = 0.0
    camera.bias[:] = ZERO_ADU
    return camera


class Field:
    """A frame of stars, with a nebula or without, under a sky of even brightness or with a gradient."""

    def __init__(
        self,
        camera: SyntheticCamera,
        seed: int,
        *,
        nebula_at: tuple[float, float] | None = None,
        tilt: float = 0.0,
    ) -> None:
        rng = np.random.default_rng(seed)
        self.x, self.y = rng.uniform(12, WIDTH - 12, 80), rng.uniform(12, HEIGHT - 12, 80)
        self.electrons = 10.0 ** rng.uniform(3.8, 5.0, 80)
        light = stars(camera, self.x, self.y, self.electrons, 3.0) + SKY_E * (1.0 + 0.02 * seed)
        y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
        if nebula_at:
            light += SKY_E * np.exp(-((x - nebula_at[0]) ** 2 / 5000.0 + (y - nebula_at[1]) ** 2 / 3000.0))
        light += tilt * SKY_E * (x / WIDTH - 0.5) / camera.response  # moonlight straying in: no vignetting
        self.frame = Frame(
            pixels=camera.exposed(light, 60.0, seed), header={"EGAIN": 1.6}, source=f"field {seed}"
        )

    def outcome(self, frame: Frame) -> tuple[int, int, float]:
        """How many stars are found, how many sources are none, and the scatter of flux over true light."""
        seen = measure(frame)
        distance = np.hypot(seen.x_px[:, None] - self.x, seen.y_px[:, None] - self.y)
        is_found = distance.min(axis=0) < 1.0
        nearest = distance.argmin(axis=0)
        good = is_found & (seen.flags[nearest] == 0) & (self.electrons > 1e4)
        ratio = (seen.flux[nearest] / self.electrons)[good]
        return (
            int(is_found.sum()),
            int((distance.min(axis=1) > 3.0).sum()),
            float(np.std(ratio) / np.mean(ratio)),
        )


def response_of(camera: SyntheticCamera) -> Array:
    smooth = ndimage.gaussian_filter(camera.response, 4.0)
    return np.asarray(smooth / np.median(smooth))


def large_scale(frame: Frame) -> Array:
    return np.asarray(ndimage.median_filter(frame.pixels[::4, ::4].astype(float), 15))


@pytest.mark.long
def test_a_group_gives_the_response_and_even_frames(camera: SyntheticCamera) -> None:
    fields = [Field(camera, seed) for seed in range(1, 6)]
    found = inverse_median([field.frame for field in fields], zero_adu=ZERO_ADU)
    assert found.notes == ()
    ratio = found.response_rows(0, HEIGHT) / response_of(camera)
    assert np.std(response_of(camera)) > 0.15
    assert np.std(ratio) < 0.012  # the rest is dust, too small for the mesh
    for field in fields[:2]:
        before, after = field.frame, found.evened(field.frame).frame
        assert np.std(large_scale(after)) < 0.1 * np.std(large_scale(before))
        stars_before, false_before, scatter_before = field.outcome(before)
        stars_after, false_after, scatter_after = field.outcome(after)
        assert stars_after >= stars_before - 1
        assert false_after <= false_before + 1
        assert scatter_before > 0.12
        assert scatter_after < 0.04


@pytest.mark.long
def test_a_nebula_that_moves_is_neither_eaten_nor_printed_into_the_others(camera: SyntheticCamera) -> None:
    positions = [(200.0, 220.0), (330.0, 150.0), (420.0, 300.0), (250.0, 330.0), (380.0, 240.0)]
    fields = [Field(camera, seed, nebula_at=position) for seed, position in enumerate(positions, start=1)]
    found = inverse_median([field.frame for field in fields], zero_adu=ZERO_ADU)
    assert np.std(found.response_rows(0, HEIGHT) / response_of(camera)) < 0.03
    without = Field(camera, 1).frame
    plain = inverse_median([Field(camera, seed).frame for seed in range(1, 6)], zero_adu=ZERO_ADU)
    nebula = large_scale(found.evened(fields[0].frame).frame) - large_scale(plain.evened(without).frame)
    true_peak = SKY_E / camera.gain_e_adu * float(np.median(camera.response))
    assert nebula[220 // 4, 200 // 4] == pytest.approx(true_peak, rel=0.15)
    assert nebula.min() > -0.05 * true_peak  # no holes round it


@pytest.mark.long
@pytest.mark.parametrize("group", [1, 4])
def test_one_field_alone_keeps_its_nebula(camera: SyntheticCamera, group: int) -> None:
    """One frame, or four of the same field: only symmetric vignetting is believed."""
    field = Field(camera, 1, nebula_at=(200.0, 220.0))
    frames = [field.frame] * group
    found = inverse_median(frames if group > 1 else frames[0], zero_adu=ZERO_ADU)
    assert any("symmetric" in note for note in found.notes)
    even = found.evened(field.frame)
    peak = SKY_E / camera.gain_e_adu * float(np.median(camera.response))
    rest = large_scale(even.frame) - np.median(large_scale(even.frame))
    assert rest[220 // 4, 200 // 4] > 0.8 * peak
    assert rest.min() > -0.1 * peak
    stars_before, false_before, scatter_before = field.outcome(field.frame)
    stars_after, false_after, scatter_after = field.outcome(even.frame)
    assert stars_after >= stars_before - 1
    assert false_after <= false_before + 1
    assert scatter_after < 0.5 * scatter_before


@pytest.mark.long
def test_a_gradient_is_subtracted_not_divided(camera: SyntheticCamera) -> None:
    tilts = (0.0, 0.3, -0.3, 0.15, -0.15)
    fields = [Field(camera, seed, tilt=tilt) for seed, tilt in enumerate(tilts, start=1)]
    found = inverse_median([field.frame for field in fields], zero_adu=ZERO_ADU)
    assert np.std(found.response_rows(0, HEIGHT) / response_of(camera)) < 0.02
    tilted = fields[1]
    even = found.evened(tilted.frame)
    assert np.ptp(even.additive_adu) == pytest.approx(0.3 * SKY_E / camera.gain_e_adu, rel=0.15)
    assert tilted.outcome(even.frame)[2] < 0.04
    assert np.std(large_scale(even.frame)) < 0.1 * np.std(large_scale(tilted.frame))


@pytest.mark.long
def test_without_a_zero_level_nothing_is_divided(camera: SyntheticCamera) -> None:
    field = Field(camera, 1)
    found = inverse_median(field.frame)
    assert (found.response == 1.0).all()
    even = found.evened(field.frame).frame
    assert np.std(large_scale(even)) < 0.1 * np.std(large_scale(field.frame))
    assert field.outcome(even)[0] >= field.outcome(field.frame)[0] - 1
    assert field.outcome(even)[2] == pytest.approx(field.outcome(field.frame)[2], rel=0.05)


def test_saturated_pixels_stay_so(camera: SyntheticCamera) -> None:
    pixels = np.asarray(Field(camera, 1).frame.pixels).copy()
    pixels[200:206, 300:306] = 65535
    frame = Frame(pixels=pixels)
    even = inverse_median(frame, zero_adu=ZERO_ADU).evened(frame).frame
    assert even.saturation_adu is not None
    assert ((np.asarray(even.pixels, float) >= 0.995 * even.saturation_adu) == (pixels == 65535)).all()


@settings(max_examples=15, deadline=None)
@given(st.floats(0.3, 8.0), st.integers(0, 1000))
def test_brighter_light_changes_nothing_in_the_response(factor: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:120, 0:160]
    shade = 1.0 - 0.4 * (((x - 80) / 160) ** 2 + ((y - 60) / 160) ** 2)
    frames = [
        Frame(pixels=shade * 1000.0 * (1.0 + 0.1 * i) + rng.normal(0, 5, shade.shape)) for i in range(3)
    ]
    one = inverse_median(frames, zero_adu=0.0).response
    other = inverse_median(
        [Frame(pixels=np.asarray(frame.pixels, float) * factor) for frame in frames], zero_adu=0.0
    ).response
    np.testing.assert_allclose(other, one, rtol=2e-3)
    backwards = inverse_median(frames[::-1], zero_adu=0.0).response
    np.testing.assert_array_equal(backwards, one)


def test_what_can_not_be_evened_is_refused(camera: SyntheticCamera) -> None:
    frame = Field(camera, 1).frame
    with pytest.raises(BadRequest, match="at least one"):
        inverse_median([])
    with pytest.raises(BadRequest, match="different sizes"):
        inverse_median([frame, Frame(pixels=np.asarray(frame.pixels)[:-20])])
    with pytest.raises(BadRequest, match="above the zero level"):
        inverse_median(frame, zero_adu=5000.0)
    with pytest.raises(BadFrame, match="hardly any pixel"):
        inverse_median(Frame(pixels=np.full((100, 100), np.nan)))
    with pytest.raises(BadFrame, match="the group"):
        inverse_median(frame).evened(Frame(pixels=np.asarray(frame.pixels)[:-20]))


@pytest.mark.long
def test_light_frames_make_a_flat(tmp_path: Path, camera: SyntheticCamera) -> None:
    cards = {"IMAGETYP": "Light Frame", "FILTER": "V", "EXPTIME": 60.0}
    for seed in range(1, 5):
        write(tmp_path / f"l{seed}.fits", np.asarray(Field(camera, seed).frame.pixels), **cards)
    with pytest.raises(BadRequest, match="--zero"):
        build(tmp_path / "m", lights=[tmp_path])
    report = build(tmp_path / "m", lights=[tmp_path], zero_adu=ZERO_ADU)
    (flat,) = report.masters
    assert flat.from_lights
    assert np.std(flat.pixels() / response_of(camera)) < 0.012
    for i in range(3):
        write(tmp_path / f"b{i}.fit", camera.exposed(0.0, 0.0, 90 + i), IMAGETYP="Bias Frame")
    build(tmp_path / "m", bias=[tmp_path / "b*.fit"])
    frame, done = Calibration.load(tmp_path / "m").applied(read_frame(tmp_path / "l1.fits", raw=True))
    assert done.steps == "BF"
    assert Field(camera, 1).outcome(frame)[2] < 0.04


@pytest.mark.long
def test_light_frames_of_a_mosaic_make_a_flat(tmp_path: Path, camera: SyntheticCamera) -> None:
    cards = {"IMAGETYP": "Light Frame", "EXPTIME": 60.0, "BAYERPAT": "RGGB"}
    for i in range(3):
        write(
            tmp_path / f"b{i}.fit", camera.exposed(0.0, 0.0, 90 + i), IMAGETYP="Bias Frame", BAYERPAT="RGGB"
        )
    for seed in range(3):
        rng = np.random.default_rng(seed)
        positions = rng.uniform(10, WIDTH - 10, 60), rng.uniform(10, HEIGHT - 10, 60)
        light = stars(camera, *positions, np.full(60, 2e4), 3.0) + camera.colors(500.0, 900.0, 700.0)
        write(tmp_path / f"l{seed}.fits", camera.exposed(light, 60.0, seed), **cards)
    build(tmp_path / "m", bias=[tmp_path / "b*.fit"], lights=[tmp_path / "l*.fits"])
    calibration = Calibration.load(tmp_path / "m")
    frame, done = calibration.applied(read_frame(tmp_path / "l1.fits", raw=True))
    assert done.steps == "BF"
    greens = np.asarray(frame.pixels, float)[0::2, 1::2]
    assert np.std(large_scale(Frame(pixels=greens))) < 0.02 * np.median(greens)


@pytest.mark.long
def test_real_frames_keep_their_bright_stars(shared: Path) -> None:
    """Some without flats, of which the zero level isn't known: brightest hundred before and after."""
    folder = shared / "data" / "frames"
    known = {frame["file"] for frame in json.loads((folder / "manifest.json").read_text())["frames"]}
    kept = total = 0
    for name in (
        "tlemoult+astrometry/FINDER-1.fits.gz",
        "thatsfine+pteropractice/Practice_Star_Field.fits.gz",
    ):
        assert any(name in one or one in name for one in known)
        frame = read_frame(folder / name)
        before, after = measure(frame), measure(inverse_median(frame).evened(frame).frame)
        x, y = before.x_px[:100, None], before.y_px[:100, None]
        distance = np.hypot(x - after.x_px, y - after.y_px).min(axis=1)
        kept += int((distance < 1.0).sum())
        total += distance.size
    print(f"\nof the {total} brightest sources {kept} are found again")
    assert kept >= 0.99 * total


@pytest.mark.long
def test_all_real_frames_of_stars_keep_them_and_get_no_others(shared: Path) -> None:
    """The hundred brightest unflagged sources of each frame with a truth, before and after, and back."""
    folder = shared / "data" / "frames"
    found, new = np.zeros(2, int), np.zeros(2, int)
    for about in json.loads((folder / "manifest.json").read_text())["frames"]:
        if about["truth_grade"] not in ("A", "B"):
            continue
        frame = read_frame(folder / about["file"])
        before, after = measure(frame), measure(inverse_median(frame).evened(frame).frame)
        for one, other, count in ((before, after, found), (after, before, new)):
            clean = np.flatnonzero(one.flags == 0)[:100]
            if clean.size and other.x_px.size:
                x, y = one.x_px[clean, None], one.y_px[clean, None]
                count += (int((np.hypot(x - other.x_px, y - other.y_px).min(axis=1) < 1.0).sum()), clean.size)
    print(f"\n{found[0]} of {found[1]} found again; {new[1] - new[0]} of {new[1]} new")
    assert found[0] >= 0.98 * found[1]
    assert new[0] >= 0.98 * new[1]
