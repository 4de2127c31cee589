"""Masters from a synthetic camera with every fault, and what they make of its frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mountnav.errors import BadFrame, BadRequest
from mountnav.frames import Frame
from mountnav.measuring.calibration import Calibration, CalibrationPolicy
from mountnav.measuring.calibration.bad_pixels import BadPixel, heal
from mountnav.measuring.calibration.building import build
from mountnav.measuring.calibration.camera_setup import Kind, assumptions
from mountnav.measuring.calibration.masters import Master
from mountnav.measuring.calibration.stacking import StackSettings, clipped
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag
from mountnav.reading import demosaiced, read_frame
from tests.measuring.painted import painted, scattered
from tests.measuring.synthetic_camera import SyntheticCamera, stars, write

SETTINGS = {"XBINNING": 1, "YBINNING": 1, "CCD_TEMP": -10.0, "INSTRUME": "Synthetic"}
FRAMES = 9
SKY_E = 600.0


def median(frame: Frame) -> float:
    return float(np.median(frame.pixels.astype(float)))


def bias_cards(**more: object) -> dict[str, object]:
    return SETTINGS | {"IMAGETYP": "Bias Frame", "EXPTIME": 0.0} | more


def dark_cards(exposure_s: float = 300.0, **more: object) -> dict[str, object]:
    return SETTINGS | {"IMAGETYP": "Dark Frame", "EXPTIME": exposure_s} | more


def flat_cards(**more: object) -> dict[str, object]:
    return SETTINGS | {"IMAGETYP": "Flat Field", "EXPTIME": 2.0, "FILTER": "R"} | more


def light_cards(exposure_s: float = 120.0, **more: object) -> dict[str, object]:
    return SETTINGS | {"IMAGETYP": "Light Frame", "EXPTIME": exposure_s, "FILTER": "R"} | more


def take(folder: Path, camera: SyntheticCamera, count: int = FRAMES) -> None:
    """Bias, dark and flat frames of a camera."""
    for i in range(count):
        write(folder / f"b{i}.fits", camera.exposed(0.0, 0.0, i), **bias_cards())
        write(folder / f"d{i}.fits", camera.exposed(0.0, 300.0, 100 + i), **dark_cards())
        light = 40000.0 * (1.0 + 0.03 * i)
        even = camera.colors(0.5 * light, light, 0.3 * light) if camera.colored else light
        write(folder / f"f{i}.fits", camera.exposed(even, 2.0, 200 + i), **flat_cards())


def master(calibration: Calibration, kind: Kind) -> Master:
    return next(one for one in calibration.masters if one.kind is kind)


@pytest.fixture(scope="module")
def camera() -> SyntheticCamera:
    return SyntheticCamera()


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory, camera: SyntheticCamera) -> Path:
    """A folder with the camera's frames; its masters lie in `m`."""
    folder = tmp_path_factory.mktemp("taken")
    take(folder, camera)
    build(folder / "m", bias=[folder / "b*.fits"], dark=[folder / "d*.fits"], flat=[folder / "f*.fits"])
    return folder


@pytest.fixture(scope="module")
def calibration(taken: Path) -> Calibration:
    return Calibration.load(taken / "m")


class Scene:
    """Stars of equal light all over the frame, one of them far above the full well."""

    def __init__(self, camera: SyntheticCamera, path: Path) -> None:
        rng = np.random.default_rng(3)
        x, y = np.meshgrid(np.linspace(20, camera.width - 20, 15), np.linspace(20, camera.height - 20, 10))
        self.x = (x + rng.uniform(-4, 4, x.shape)).ravel()
        self.y = (y + rng.uniform(-4, 4, y.shape)).ravel()
        electrons = np.full(self.x.size, 8000.0)
        self.full = int(np.argmin(np.hypot(self.x - camera.width / 2, self.y - camera.height / 2)))
        electrons[self.full] = 4e6
        self.electrons = electrons
        light = stars(camera, self.x, self.y, electrons, 3.0) + SKY_E
        write(path, camera.exposed(light, 120.0, 999), **light_cards())
        self.raw = read_frame(path, raw=True)


@pytest.fixture(scope="module")
def scene(taken: Path, camera: SyntheticCamera) -> Scene:
    return Scene(camera, taken / "light.fit")


def found(frame: Frame, scene: Scene) -> tuple[NDArray[np.intp], NDArray[np.bool_], int, object]:
    """Nearest measurement of each star, whether it is one, and how many sources are none of the stars."""
    seen = measure(frame)
    distance = np.hypot(seen.x_px[:, None] - scene.x, seen.y_px[:, None] - scene.y)
    return distance.argmin(axis=0), distance.min(axis=0) < 1.0, int((distance.min(axis=1) > 2.0).sum()), seen


@pytest.mark.long
def test_masters_are_as_good_as_their_frames_allow(calibration: Calibration, camera: SyntheticCamera) -> None:
    read_noise = camera.read_noise_e / camera.gain_e_adu
    bias, dark, flat = (master(calibration, kind) for kind in (Kind.BIAS, Kind.DARK, Kind.FLAT))
    assert np.std(bias.pixels() - camera.bias) == pytest.approx(read_noise / FRAMES**0.5, rel=0.05)
    quiet = ~camera.hot & ~camera.dead
    rest = dark.pixels() - camera.dark_e_s / camera.gain_e_adu
    # noise of nine darks of 300 s and of the bias, in ADU per second
    dark_noise = np.hypot(read_noise, np.sqrt(camera.dark_e_s * 300.0) / camera.gain_e_adu)
    limit = np.hypot(dark_noise, read_noise) / FRAMES**0.5 / 300.0
    assert np.std((rest / limit)[quiet]) == pytest.approx(1.0, abs=0.05)
    truth = camera.response / np.median(camera.response)
    off = (flat.pixels() / truth - 1.0)[quiet]
    photons = 1.0 / np.sqrt(FRAMES * 44800.0 * camera.response[quiet])
    assert np.std(off / photons) == pytest.approx(1.0, abs=0.05)
    assert np.median(flat.pixels()) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.long
def test_noise_and_gain_are_measured_and_kept(calibration: Calibration, camera: SyntheticCamera) -> None:
    flat = master(calibration, Kind.FLAT)
    assert flat.gain_e_adu == pytest.approx(camera.gain_e_adu, rel=0.02)
    assert flat.read_noise_adu == pytest.approx(camera.read_noise_e / camera.gain_e_adu, rel=0.02)
    assert calibration.bias_adu == pytest.approx(float(np.median(camera.bias)), abs=1.0)


@pytest.mark.long
def test_bad_pixels_are_those_of_the_chip(calibration: Calibration, camera: SyntheticCamera) -> None:
    flags = master(calibration, Kind.BAD_PIXELS).flags()
    hot, dead = (flags & BadPixel.HOT) > 0, (flags & BadPixel.DEAD) > 0
    assert hot[camera.hot].mean() == 1.0
    assert hot[~camera.hot].sum() <= 5
    assert dead[camera.dead].mean() == 1.0
    assert dead[~camera.dead].sum() <= 2


def test_a_calibrated_frame_is_even_and_as_quiet_as_its_photons(
    calibration: Calibration, camera: SyntheticCamera
) -> None:
    raw = camera.exposed(SKY_E, 120.0, 55)
    frame, report = calibration.applied(Frame(pixels=raw, header=dict(light_cards(FILTER="R"))))  # type: ignore[arg-type]
    assert report.zero_adu == 0.0
    blocks = frame.pixels.reshape(10, 30, 10, 40).swapaxes(1, 2).reshape(10, 10, -1).mean(axis=2)
    signal = SKY_E * float(np.median(camera.response)) / camera.gain_e_adu
    assert np.median(blocks) == pytest.approx(signal, rel=0.01)
    raw_blocks = raw.reshape(10, 30, 10, 40).swapaxes(1, 2).reshape(10, 10, -1).mean(axis=2) - 503.0
    assert np.std(raw_blocks) / np.mean(raw_blocks) > 0.1
    assert np.std(blocks) / np.mean(blocks) < 0.005
    # shot noise of sky and dark, read noise, and what nine frames leave in the masters
    quiet = ~camera.hot & ~camera.dead
    electrons = SKY_E * camera.response + 120.0 * camera.dark_e_s
    read = camera.read_noise_e**2
    masters = read / FRAMES + (120.0 / 300.0) ** 2 * (read + 300.0 * camera.dark_e_s) / FRAMES
    limit = (
        np.sqrt(electrons + read + masters)
        / camera.gain_e_adu
        / (camera.response / np.median(camera.response))
    )
    assert np.std(((np.asarray(frame.pixels, float) - signal) / limit)[quiet]) < 1.05


@pytest.mark.long
def test_stars_keep_one_flux_all_over_the_frame_and_hot_pixels_are_gone(
    calibration: Calibration, camera: SyntheticCamera, scene: Scene
) -> None:
    scatter = {}
    for name, frame in (("raw", scene.raw), ("calibrated", calibration.applied(scene.raw)[0])):
        nearest, is_found, false, seen = found(frame, scene)
        flux, flags = seen.flux[nearest], seen.flags[nearest]  # type: ignore[attr-defined]
        clean = is_found & (flags == 0)
        scatter[name] = float(np.std(flux[clean]) / np.mean(flux[clean])), int(is_found.sum()), false
        if name == "calibrated":
            assert is_found.all()
            assert false == 0
            assert clean.sum() >= scene.x.size - 2  # the full one, and one beside it
    print(f"\nflux scatter, stars found of {scene.x.size}, false sources: {scatter}")
    # flux error by photons and read noise alone, the profile being known: 4πσ² pixels of sky
    share = camera.response[np.rint(scene.y).astype(int), np.rint(scene.x).astype(int)]
    sky = 4.0 * np.pi * (3.0 / 2.3548) ** 2 * (SKY_E * share + camera.read_noise_e**2)
    limit = np.sqrt(np.mean((8000.0 * share + sky) / (8000.0 * share) ** 2))
    print(f"limit of the scatter {limit:.4f}")
    assert scatter["raw"][2] > 100
    assert scatter["raw"][0] > 0.12
    assert scatter["calibrated"][0] < 0.04


def test_saturated_pixels_stay_saturated_and_no_others_become_so(
    calibration: Calibration, scene: Scene
) -> None:
    before = np.asarray(scene.raw.pixels) >= 65535
    assert before.sum() > 10
    frame, _ = calibration.applied(scene.raw)
    assert frame.saturation_adu is not None
    after = np.asarray(frame.pixels, float) >= 0.995 * frame.saturation_adu
    assert (after == before).all()
    nearest, is_found, _, seen = found(frame, scene)
    flagged = (seen.flags[nearest] & Flag.SATURATED) > 0  # type: ignore[attr-defined]
    assert np.flatnonzero(flagged & is_found).tolist() == [scene.full]


def test_a_frame_is_not_calibrated_twice(calibration: Calibration, scene: Scene) -> None:
    once, first = calibration.applied(scene.raw)
    assert first.steps == "BDF"
    assert once.header["CALSTAT"] == "BDF"
    twice, second = calibration.applied(once)
    assert twice is once
    assert second.steps == ""
    assert second.zero_adu == 0.0
    for cards in (
        {"CALSTAT": "BDF"},
        {"IMAGETYP": "Calibrated Light"},
        {"ZEROCOR": "z", "DARKCOR": "d", "FLATCOR": "done"},
    ):
        frame = replace(scene.raw, header={**scene.raw.header, **cards})
        assert calibration.applied(frame)[0] is frame
    half = replace(scene.raw, header={**scene.raw.header, "CALSTAT": "BD"})
    assert calibration.applied(half)[1].steps == "F"


@pytest.mark.parametrize("pedestal", [-100, 100])
def test_a_pedestal_left_by_another_program_is_no_light(
    calibration: Calibration, scene: Scene, pedestal: int
) -> None:
    once, _ = calibration.applied(replace(scene.raw, header={**scene.raw.header, "FILTER": "other"}))
    cards = {**scene.raw.header, "CALSTAT": "BD", "PEDESTAL": pedestal}
    lifted = replace(
        scene.raw, pixels=np.rint(np.asarray(once.pixels, float) + 100.0).astype(np.int32), header=cards
    )
    frame, report = calibration.applied(lifted)
    assert report.steps == "F"
    assert report.zero_adu == 0.0
    direct, _ = calibration.applied(scene.raw)
    assert median(frame) == pytest.approx(np.median(direct.pixels.astype(float)), abs=1.0)
    untouched = calibration.applied(replace(lifted, header={**cards, "CALSTAT": "BDF"}))[1]
    assert untouched.zero_adu == 100.0


@pytest.mark.parametrize(
    ("cards", "reason"),
    [
        ({"XBINNING": 2, "YBINNING": 2}, "binning"),
        ({"INSTRUME": "Other"}, "camera"),
    ],
)
def test_masters_of_other_settings_are_not_applied(
    calibration: Calibration, scene: Scene, cards: dict[str, int | str], reason: str
) -> None:
    frame = replace(scene.raw, header={**scene.raw.header, **cards})
    same, report = calibration.applied(frame)
    assert same is frame
    assert report.steps == ""
    assert all(reason in line for line in report.not_applied), report.not_applied


def test_a_frame_of_another_size_is_left_alone(calibration: Calibration, scene: Scene) -> None:
    frame = replace(scene.raw, pixels=scene.raw.pixels[:-2])
    same, report = calibration.applied(frame)
    assert same is frame
    assert all("400 × 298" in line for line in report.not_applied)


def test_a_flat_of_another_filter_only_by_policy(taken: Path, calibration: Calibration, scene: Scene) -> None:
    frame = replace(scene.raw, header={**scene.raw.header, "FILTER": "B"})
    report = calibration.applied(frame)[1]
    assert report.steps == "BD"
    assert any("filter is B" in line for line in report.not_applied)
    careless = Calibration.load(taken / "m", policy=CalibrationPolicy(other_filter=True))
    report = careless.applied(frame)[1]
    assert report.steps == "BDF"
    assert any("filter R" in line for line in report.warnings)


def test_dark_temperature_is_heeded(calibration: Calibration, scene: Scene) -> None:
    def at(temperature_c: float) -> tuple[str, str]:
        frame = replace(scene.raw, header={**scene.raw.header, "CCD-TEMP": temperature_c})
        report = calibration.applied(frame)[1]
        return report.steps, " ".join((*report.not_applied, *report.warnings))

    assert at(-11.0) == ("BDF", "")
    assert at(-5.0)[0] == "BDF"
    assert "5.0° away" in at(-5.0)[1]
    assert at(15.0)[0] == "BF"
    assert "25° away" in at(15.0)[1]


def test_without_exposure_no_dark(calibration: Calibration, scene: Scene) -> None:
    header = {key: value for key, value in scene.raw.header.items() if key != "EXPTIME"}
    report = calibration.applied(replace(scene.raw, header=header))[1]
    assert report.steps == "BF"
    assert any("exposure isn't known" in line for line in report.not_applied)


@pytest.mark.long
def test_color_mosaic_is_calibrated_before_it_is_smoothed(tmp_path: Path) -> None:
    camera = SyntheticCamera(colored=True, seed=12)
    take(tmp_path, camera, 5)
    build(tmp_path / "m", bias=[tmp_path / "b*"], dark=[tmp_path / "d*.fits"], flat=[tmp_path / "f*.fits"])
    calibration = Calibration.load(tmp_path / "m")
    flat = master(calibration, Kind.FLAT)
    assert flat.colored
    for row in (0, 1):
        for column in (0, 1):
            assert np.median(flat.pixels()[row::2, column::2]) == pytest.approx(1.0, abs=1e-5)
    path = write(tmp_path / "l.fit", camera.exposed(camera.colors(900, 1200, 700), 120.0, 5), **light_cards())
    raw = read_frame(path, raw=True)
    assert raw.mosaic
    frame, report = calibration.applied(raw)
    assert report.steps == "BDF"
    assert frame.mosaic
    even = demosaiced(frame)
    blocks = even.pixels.reshape(10, 30, 10, 40).swapaxes(1, 2).reshape(10, 10, -1).mean(axis=2)
    assert np.std(blocks) / np.mean(blocks) < 0.01
    assert len(measure(even).x_px) == 0
    assert len(measure(demosaiced(raw)).x_px) > 20  # hot pixels, smeared by the smoothing


def test_dark_that_holds_the_bias_serves_its_own_exposure_only(
    tmp_path: Path, camera: SyntheticCamera
) -> None:
    for i in range(3):
        write(tmp_path / f"d{i}.fits", camera.exposed(0.0, 60.0, i), **dark_cards(60.0))
    report = build(tmp_path / "m", dark=[tmp_path])
    assert any("can't be scaled" in note for note in report.notes)
    calibration = Calibration.load(tmp_path / "m")
    pixels = camera.exposed(SKY_E, 60.0, 9)
    frame, done = calibration.applied(Frame(pixels=pixels, header=dict(light_cards(60.0)), exposure_s=60.0))  # type: ignore[arg-type]
    assert done.dark is not None
    assert done.zero_adu == 0.0
    assert median(frame) == pytest.approx(SKY_E * np.median(camera.response) / 1.6, rel=0.02)
    done = calibration.applied(Frame(pixels=pixels, header=dict(light_cards(120.0))))[1]  # type: ignore[arg-type]
    assert done.dark is None
    assert any("its own exposure" in line for line in done.not_applied)


@pytest.mark.long
def test_several_exposures_and_filters_live_in_one_folder(tmp_path: Path, camera: SyntheticCamera) -> None:
    for i in range(2):
        write(tmp_path / f"b{i}.fits", camera.exposed(0.0, 0.0, i), **bias_cards())
        write(tmp_path / f"d1{i}.fits", camera.exposed(0.0, 30.0, 10 + i), **dark_cards(30.0))
        write(tmp_path / f"d2{i}.fits", camera.exposed(0.0, 600.0, 20 + i), **dark_cards(600.0))
        write(tmp_path / f"fr{i}.fits", camera.exposed(40000.0, 1.0, 30 + i), **flat_cards(FILTER="R"))
        write(tmp_path / f"fb{i}.fits", camera.exposed(30000.0, 1.0, 40 + i), **flat_cards(FILTER="B"))
    build(tmp_path / "m", bias=[tmp_path / "b*"])
    build(tmp_path / "m", dark=[tmp_path / "d*.fits"], flat=[tmp_path / "f*.fits"])
    calibration = Calibration.load(tmp_path / "m")
    names = [one.name for one in calibration.masters if one.kind in (Kind.DARK, Kind.FLAT)]
    assert len(names) == 4
    assert all(one.zero_free for one in calibration.masters if one.kind in (Kind.DARK, Kind.FLAT))
    for exposure, dark, filter_name in ((25.0, "30s", "B"), (500.0, "600s", "R")):
        header = light_cards(exposure, FILTER=filter_name)
        report = calibration.applied(Frame(pixels=camera.exposed(SKY_E, exposure, 3), header=dict(header)))[1]  # type: ignore[arg-type]
        assert report.dark is not None
        assert dark in report.dark
        assert report.flat is not None
        assert report.flat.endswith(f"_{filter_name}.fits")
        assert report.dark_factor == exposure


def test_one_frame_of_each_works_and_is_told(tmp_path: Path, camera: SyntheticCamera) -> None:
    write(tmp_path / "b.fits", camera.exposed(0.0, 0.0, 1), **bias_cards())
    write(tmp_path / "d.fits", camera.exposed(0.0, 300.0, 2), **dark_cards())
    write(tmp_path / "f.fits", camera.exposed(40000.0, 1.0, 3), **flat_cards())
    report = build(
        tmp_path / "m", bias=[tmp_path / "b.fits"], dark=[tmp_path / "d.fits"], flat=[tmp_path / "f.fits"]
    )
    assert sum("from one frame" in note for note in report.notes) == 3
    # a flat calibrated by itself is 1 everywhere (times its level)
    calibration = Calibration.load(tmp_path / "m", policy=CalibrationPolicy(heal_bad_pixels=False))
    with fits.open(tmp_path / "f.fits") as hdus:
        pixels = hdus[0].data.astype(np.uint16)
    frame, _ = calibration.applied(Frame(pixels=pixels, header={**light_cards(2.0), "EXPTIME": 2.0}))  # type: ignore[dict-item]
    good = np.isfinite(frame.pixels)
    assert good.mean() > 0.99
    level = float(np.median(frame.pixels[good]))
    assert np.abs(frame.pixels[good] / level - 1.0).max() < 1e-4


@pytest.mark.long
@pytest.mark.parametrize("packing", ["fz", "gz", "float"])
def test_frames_in_other_packings_give_the_same_master(
    tmp_path: Path, camera: SyntheticCamera, packing: str
) -> None:
    import gzip

    for i in range(3):
        pixels = camera.exposed(0.0, 0.0, i)
        plain = write(tmp_path / f"b{i}.fits", pixels, **bias_cards())
        if packing == "fz":
            hdu = fits.CompImageHDU(pixels, compression_type="RICE_1")
            hdu.header["IMAGETYP"] = "Bias Frame"
            hdu.writeto(tmp_path / f"c{i}.fits.fz")
        elif packing == "gz":
            (tmp_path / f"c{i}.fits.gz").write_bytes(gzip.compress(plain.read_bytes()))
        else:
            write(tmp_path / f"c{i}.fits", pixels.astype(np.float64), **bias_cards())
    build(tmp_path / "plain", bias=[tmp_path / "b*"])
    build(tmp_path / "packed", bias=[tmp_path / "c*"])
    one, other = (
        master(Calibration.load(tmp_path / name), Kind.BIAS).pixels() for name in ("plain", "packed")
    )
    np.testing.assert_array_equal(one, other)


def test_masters_are_standard_fits_and_tell_how_they_were_made(taken: Path) -> None:
    path = next((taken / "m").glob("dark*"))
    with fits.open(path) as hdus:
        hdus.verify("exception")
        header = hdus[0].header
        assert hdus[0].data.dtype == np.dtype(">f4")
        assert header["NCOMBINE"] == FRAMES
        assert header["EXPTIME"] == 300.0
        assert header["CCD-TEMP"] == -10.0
        assert header["MNZEROFR"] is True
        assert 0 <= header["MNREJECT"] < 0.01
        history = "\n".join(header["HISTORY"])
    assert "d0.fits" in history
    assert "corrected by bias" in history


def test_cosmic_rays_are_clipped_in_pairs_and_stacks() -> None:
    rng = np.random.default_rng(0)
    for count in (2, 3, 5, 12):
        cube = rng.normal(100.0, 4.0, (count, 60, 60)).astype(np.float32)
        cube[0, 10:14, 20] += 500.0
        result = clipped(cube, StackSettings())
        assert result.pixels[10:14, 20].max() < 115.0, count
        assert 4 <= result.rejected < 4 + 0.001 * cube.size


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 9), st.sampled_from(["mean", "median"]))
def test_a_stack_does_not_depend_on_the_order(seed: int, count: int, method: str) -> None:
    rng = np.random.default_rng(seed)
    cube = rng.normal(100.0, 4.0, (count, 16, 16)).astype(np.float32)
    cube[rng.random(cube.shape) < 0.02] = np.nan
    cube[rng.random(cube.shape) < 0.02] += 300.0
    one = clipped(cube.copy(), StackSettings(method=method))
    other = clipped(cube[rng.permutation(count)].copy(), StackSettings(method=method))
    np.testing.assert_array_equal(one.pixels, other.pixels)
    assert one.rejected == other.rejected


@pytest.mark.long
def test_a_build_does_not_depend_on_the_order_of_its_files(taken: Path, tmp_path: Path) -> None:
    files = sorted(taken.glob("b*.fits"))
    build(tmp_path / "one", bias=files)
    build(tmp_path / "other", bias=[*files[4:], *files[:4], files[0]])
    one, other = (Calibration.load(tmp_path / name).masters for name in ("one", "other"))
    np.testing.assert_array_equal(one[-1].pixels(), other[-1].pixels())
    assert one[-1].frames == other[-1].frames == FRAMES


@settings(max_examples=20, deadline=None)
@given(st.floats(0.5, 3000.0), st.floats(1.1, 8.0))
def test_a_dark_is_scaled_in_proportion_to_the_exposure(
    calibration: Calibration, exposure_s: float, factor: float
) -> None:
    """What is subtracted beyond the bias grows as the exposure, whatever the pixels."""
    pixels = np.full((300, 400), 20000, np.uint16)

    def subtracted(t: float) -> NDArray[np.float64]:
        header = {key: value for key, value in light_cards(t, FILTER="none").items() if key != "CCD_TEMP"}
        policy = replace(
            calibration, masters=tuple(m for m in calibration.masters if m.kind is not Kind.BAD_PIXELS)
        )
        frame, report = policy.applied(Frame(pixels=pixels, header=dict(header)))  # type: ignore[arg-type]
        assert report.steps == "BD"
        bias = master(calibration, Kind.BIAS).pixels().astype(float)
        left: np.ndarray = 20000.0 - bias - frame.pixels.astype(float)
        return left

    one, more = subtracted(exposure_s), subtracted(factor * exposure_s)
    np.testing.assert_allclose(more, factor * one, rtol=1e-4, atol=0.02 * (1.0 + factor))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([1, 2]))
def test_healing_follows_smooth_light_and_leaves_clusters_missing(seed: int, step: int) -> None:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:40, 0:40].astype(float)
    a, b, c = rng.normal(0, 1, 3)
    truth = (100.0 + a * x + b * y + 0.02 * c * x * y).astype(np.float32)
    bad = rng.random(truth.shape) < 0.02
    bad[20:27, 20:27] = True  # wider than any neighbor reaches
    pixels = np.where(bad, np.float32(6e4), truth)
    healed, missing = heal(pixels, bad, step)
    assert healed + missing == bad.sum()
    assert np.isnan(pixels).sum() == missing
    assert np.isnan(pixels[23, 23])
    filled = bad & np.isfinite(pixels)
    np.testing.assert_allclose(pixels[filled], truth[filled], atol=0.01)
    np.testing.assert_array_equal(pixels[~bad], truth[~bad])


@pytest.mark.long
@pytest.mark.parametrize("fwhm_px", [1.5, 2.5])
def test_healing_keeps_stars_that_missing_pixels_would_spoil(fwhm_px: float) -> None:
    """2 % of the pixels are bad, some in 3 × 3 clusters: what is lost, by what is done to them."""
    size = (600, 600)
    x, y = scattered(400, size, 1)
    rng = np.random.default_rng(2)
    electrons = 10.0 ** rng.uniform(3.3, 4.7, x.size)
    image = (painted(x, y, electrons, fwhm_px=fwhm_px, size=size) + 100.0).astype(np.float32)
    bad = rng.random(size) < 0.02
    for row, column in rng.integers(0, 597, (30, 2)):
        bad[row : row + 3, column : column + 3] = True
    healed, missing = np.where(bad, np.float32(2e4), image), np.where(bad, np.float32(np.nan), image)
    heal(healed, bad, 1)
    clean: dict[str, int] = {}
    rms: dict[str, float] = {}
    for name, pixels in (("no bad pixels", image), ("healed", healed), ("missing", missing)):
        seen = measure(Frame(pixels=pixels, header={"EGAIN": 1.0}))
        distance = np.hypot(seen.x_px[:, None] - x, seen.y_px[:, None] - y)
        good = (distance.min(axis=0) < 1.0) & (seen.flags[distance.argmin(axis=0)] == 0)
        clean[name], rms[name] = int(good.sum()), float(np.sqrt(np.mean(distance.min(axis=0)[good] ** 2)))
        assert (distance.min(axis=1)[seen.flags == 0] > 2.0).sum() == 0, name
    print(
        f"\nFWHM {fwhm_px}: clean stars of {x.size} {clean}, rms px", {k: round(v, 4) for k, v in rms.items()}
    )
    assert clean["healed"] > clean["missing"] + 20
    assert clean["healed"] >= 0.97 * clean["no bad pixels"]
    assert rms["healed"] < (2.0 if fwhm_px < 2.0 else 1.15) * rms["no bad pixels"]


class TestRefusals:
    """Frames that don't belong in a stack; the folder stays as it was."""

    @pytest.fixture
    def folder(self, tmp_path: Path, camera: SyntheticCamera) -> Path:
        for i in range(3):
            write(tmp_path / f"b{i}.fits", camera.exposed(0.0, 0.0, i), **bias_cards())
            write(tmp_path / f"d{i}.fits", camera.exposed(0.0, 300.0, 10 + i), **dark_cards())
        return tmp_path

    def refused(self, folder: Path, error: type[Exception], **what: list[Path]) -> str:
        with pytest.raises(error) as caught:
            build(folder / "m", **what)  # type: ignore[arg-type]
        assert not (folder / "m").exists()
        return str(caught.value)

    @pytest.mark.parametrize(
        ("cards", "words"),
        [
            ({"XBINNING": 2, "YBINNING": 2}, "binning is 2×2, not 1×1"),
            ({"GAIN": 100}, None),
            ({"READOUTM": "Fast"}, None),
            ({"INSTRUME": "Other"}, "camera"),
        ],
    )
    def test_other_settings(
        self, folder: Path, camera: SyntheticCamera, cards: dict[str, object], words: str | None
    ) -> None:
        for i in range(3):  # the others must say something else to differ
            write(folder / f"b{i}.fits", camera.exposed(0.0, 0.0, i), **bias_cards(GAIN=50, READOUTM="Slow"))
        write(
            folder / "b7.fits",
            camera.exposed(0.0, 0.0, 7),
            **bias_cards(**({"GAIN": 50, "READOUTM": "Slow"} | cards)),
        )
        text = self.refused(folder, BadRequest, bias=[folder / "b*"])
        assert "b7.fits" in text
        assert words is None or words in text

    @pytest.mark.long
    @pytest.mark.parametrize(
        ("cards", "asked"),
        [
            ({"GAIN": 200}, "gain=200"),
            ({"OFFSET": 30}, "offset=30"),
            ({"READOUTM": "Fast"}, "readout=Fast"),
            ({"EGAIN": 1.5}, "egain=1.5"),
        ],
    )
    @pytest.mark.parametrize("odd_one", [0, 8])
    def test_a_setting_that_only_one_frame_tells(
        self, tmp_path: Path, camera: SyntheticCamera, cards: dict[str, object], asked: str, odd_one: int
    ) -> None:
        """Nine biases without GAIN and one with GAIN=200 became a master that claimed gain 200."""
        for i in range(9):
            more = cards if i == odd_one else {}
            write(tmp_path / f"b{i}.fits", camera.exposed(0.0, 0.0, i), **bias_cards(**more))
        text = self.refused(tmp_path, BadRequest, bias=[tmp_path / "b*"])
        assert f"doesn't give its {asked.partition('=')[0]}, as 8 of the 9 frames" in text
        assert f"b{odd_one}.fits says" in text
        assert f"--assume {asked}" in text
        report = build(tmp_path / "m", bias=[tmp_path / "b*"], assumed=assumptions([asked]))
        assert len(report.masters) >= 1

    def test_what_one_kind_tells_and_another_does_not(self, folder: Path, camera: SyntheticCamera) -> None:
        for i in range(3):
            write(folder / f"d{i}.fits", camera.exposed(0.0, 300.0, 10 + i), **dark_cards(GAIN=50))
        text = self.refused(folder, BadRequest, bias=[folder / "b*"], dark=[folder / "d*"])
        assert "--assume gain=50" in text

    @pytest.mark.parametrize("said", ["gain", "gain=", "gain=x", "gain=nan", "color=red", "binning=x", ""])
    def test_an_assumption_that_makes_no_sense(self, said: str) -> None:
        with pytest.raises(BadRequest, match="--assume"):
            assumptions([said])

    def test_other_size(self, folder: Path, camera: SyntheticCamera) -> None:
        write(folder / "b7.fits", camera.exposed(0.0, 0.0, 7)[:200], **bias_cards())
        text = self.refused(folder, BadRequest, bias=[folder / "b*"])
        assert "b7.fits: it has 400 × 200 pixels, not 400 × 300" in text

    def test_the_odd_one_is_named_even_if_it_comes_first(self, folder: Path, camera: SyntheticCamera) -> None:
        write(folder / "b.fits", camera.exposed(0.0, 0.0, 7), **bias_cards(XBINNING=2, YBINNING=2))
        text = self.refused(folder, BadRequest, bias=[folder / "b*"])
        assert text.startswith("b.fits: its binning is 2×2, not 1×1, as b0.fits")

    def test_other_color_pattern(self, folder: Path, camera: SyntheticCamera) -> None:
        for i in range(3):
            write(folder / f"b{i}.fits", camera.exposed(0.0, 0.0, i), **bias_cards(BAYERPAT="RGGB"))
        write(folder / "b7.fits", camera.exposed(0.0, 0.0, 7), **bias_cards(BAYERPAT="GBRG"))
        assert "b7.fits: its color pattern" in self.refused(folder, BadRequest, bias=[folder / "b*"])

    def test_kind_by_header(self, folder: Path) -> None:
        assert "calls it a dark" in self.refused(folder, BadFrame, bias=[folder / "d0.fits"])

    def test_dark_full_of_stars(self, folder: Path, camera: SyntheticCamera) -> None:
        rng = np.random.default_rng(1)
        light = stars(camera, rng.uniform(5, 395, 60), rng.uniform(5, 295, 60), np.full(60, 9000.0), 2.5)
        write(folder / "d7.fits", camera.exposed(light, 300.0, 7), **dark_cards())
        text = self.refused(folder, BadFrame, bias=[folder / "b*"], dark=[folder / "d*"])
        assert "d7.fits" in text
        assert "stars" in text

    def test_dark_with_light(self, folder: Path, camera: SyntheticCamera) -> None:
        write(folder / "d7.fits", camera.exposed(2000.0, 300.0, 7), **dark_cards())
        text = self.refused(folder, BadFrame, bias=[folder / "b*"], dark=[folder / "d*"])
        assert "d7.fits: its level is" in text

    @pytest.mark.long
    def test_flats(self, folder: Path, camera: SyntheticCamera) -> None:
        rng = np.random.default_rng(1)
        light = stars(camera, rng.uniform(5, 395, 60), rng.uniform(5, 295, 60), np.full(60, 90000.0), 2.5)
        lights: list[tuple[np.ndarray | float, str]]
        lights = [(300000.0, "saturated"), (25.0, "too faint"), (30000.0 + light, "stars")]
        for number, (even, word) in enumerate(lights):
            path = write(folder / f"f{number}.fits", camera.exposed(even, 2.0, 7), **flat_cards())
            text = self.refused(folder, BadFrame, bias=[folder / "b*"], flat=[path])
            assert path.name in text
            assert word in text

    def test_a_long_bias_a_dark_without_exposure_a_master(
        self, folder: Path, camera: SyntheticCamera
    ) -> None:
        path = write(folder / "x.fits", camera.exposed(0.0, 0.0, 7), EXPTIME=60.0)
        assert "is a dark" in self.refused(folder, BadFrame, bias=[path])
        path = write(folder / "x.fits", camera.exposed(0.0, 0.0, 7))
        assert "no exposure time" in self.refused(folder, BadFrame, dark=[path])
        path = write(folder / "x.fits", camera.exposed(0.0, 0.0, 7), IMAGETYP="Master Bias")
        assert "master" in self.refused(folder, BadFrame, bias=[path])

    def test_files(self, folder: Path, camera: SyntheticCamera) -> None:
        cut = folder / "cut.fits"
        cut.write_bytes((folder / "b0.fits").read_bytes()[:50_000])
        assert "cut.fits" in self.refused(folder, BadFrame, bias=[cut])
        (folder / "no.fits").write_text("notes")
        assert "no.fits" in self.refused(folder, BadFrame, bias=[folder / "no.fits"])
        color = write(folder / "rgb.fits", np.stack([camera.exposed(0.0, 0.0, i) for i in range(3)]))
        assert "rgb.fits" in self.refused(folder, BadFrame, bias=[color])
        assert "not there" in self.refused(folder, BadRequest, bias=[folder / "nothing.fits"])
        assert "nothing to build" in self.refused(folder, BadRequest)

    def test_a_refused_build_leaves_older_masters_as_they_were(
        self, folder: Path, camera: SyntheticCamera
    ) -> None:
        build(folder / "m", bias=[folder / "b*"], dark=[folder / "d*"])
        before = {path.name: path.read_bytes() for path in (folder / "m").iterdir()}
        write(folder / "f.fits", camera.exposed(25.0, 2.0, 7), **flat_cards())
        with pytest.raises(BadFrame):
            build(folder / "m", bias=[folder / "b0.fits"], flat=[folder / "f.fits"])
        assert {path.name: path.read_bytes() for path in (folder / "m").iterdir()} == before

    @pytest.mark.long
    def test_temperatures_and_copies_are_told(self, folder: Path, camera: SyntheticCamera) -> None:
        write(folder / "d7.fits", camera.exposed(0.0, 300.0, 7), **dark_cards(CCD_TEMP=-6.0))
        (folder / "d8.fits").write_bytes((folder / "d0.fits").read_bytes())
        report = build(folder / "m", bias=[folder / "b*"], dark=[folder / "d*"])
        assert any("-10.0 °C" in note and "-6.0 °C" in note for note in report.notes)
        assert any("d8.fits is a copy of d0.fits" in note for note in report.notes)

    def test_a_folder_without_masters(self, folder: Path) -> None:
        for position in (folder, folder / "none"):
            with pytest.raises(BadRequest):
                Calibration.load(position)

    @pytest.mark.long
    def test_masters_replaced_while_in_use(self, folder: Path, camera: SyntheticCamera) -> None:
        build(folder / "m", bias=[folder / "b*"])
        calibration = Calibration.load(folder / "m")
        old = np.array(master(calibration, Kind.BIAS).pixels())
        for i in range(40):  # a longer list of files moves the pixels within the master
            write(folder / f"b{i:02d}.fits", camera.exposed(0.0, 0.0, 50 + i), **bias_cards())
        build(folder / "m", bias=[folder / "b*"])
        new = master(calibration, Kind.BIAS).pixels()
        assert np.std(new - camera.bias) < 0.5 * np.std(old - camera.bias)
        next((folder / "m").glob("bias*")).unlink()
        with pytest.raises(BadFrame, match="gone"):
            master(calibration, Kind.BIAS).pixels()

    def test_a_damaged_master(self, folder: Path) -> None:
        build(folder / "m", bias=[folder / "b*"])
        path = next((folder / "m").glob("bias*"))
        path.write_bytes(path.read_bytes()[:20_000])
        with pytest.raises(BadFrame, match="damaged"):
            Calibration.load(folder / "m")


def test_darks_with_cosmic_rays_are_no_starry_darks(tmp_path: Path) -> None:
    """Half an hour under the sky's own rain: blobs and tracks, but no stars."""
    camera = SyntheticCamera(seed=21)
    rng = np.random.default_rng(8)
    for i in range(3):
        light = np.zeros((camera.height, camera.width))
        for _ in range(150):
            x, y, angle = rng.uniform(5, 395), rng.uniform(5, 295), rng.uniform(0, np.pi)
            for along in np.arange(0, rng.exponential(4.0) + 0.1, 0.5):
                row, column = int(y + along * np.sin(angle)), int(x + along * np.cos(angle))
                if 0 <= row < camera.height and 0 <= column < camera.width:
                    light[row, column] += 1500.0
        write(tmp_path / f"d{i}.fits", camera.exposed(light, 300.0, i), **dark_cards())
    report = build(tmp_path / "m", dark=[tmp_path / "d*"])
    dark = report.masters[0].pixels()
    assert np.percentile(np.abs(dark - camera.bias - 300.0 * camera.dark_e_s / 1.6)[~camera.hot], 99.9) < 30.0
