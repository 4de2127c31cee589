"""Short, soft, coma-ridden, undersampled, hot-pixel-ridden and 8-bit pictures: what the flags cost blind."""

import io
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from benchmarks.peers.drawing import KINDS, TAKEN, place_of
from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Hint
from mountnav.identification.search import Reach, identify
from mountnav.measuring.measure import measure
from mountnav.reading import read_frame
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.sphere import separation_arcsec
from mountnav.solving.solve import SolveSettings, solve
from mountnav.units import julian_year

SIZE = 1296, 972
FAULTS = ("soft", "coma", "undersampled", "hot pixels", "8 bits", "all of them")
PICTURES = 18
NOISE_PICTURES = 8


def point_image(fault):
    """What soft optics make of a point: a core in a wide halo, or a tail to one side."""
    y, x = np.mgrid[-9:10, -9:10]
    if fault == "soft":
        core = np.exp(-(x**2 + y**2) / (2 * 0.6**2))
        halo = (1 + (x**2 + y**2) / 2.5**2) ** -1.5
        return 0.5 * core / core.sum() + 0.5 * halo / halo.sum()
    tail = sum(
        np.exp(-((x - 1.2 * k) ** 2 + (y - 0.5 * k) ** 2) / (2 * (0.7 + 0.35 * k) ** 2) - k / 3)
        for k in range(6)
    )
    return tail / tail.sum()


def picture(number):
    """A picture of 11°, as a file, and where it was taken: some ten to a hundred stars in it."""
    rng = np.random.default_rng((17, number))
    fault = FAULTS[number % len(FAULTS)]
    optics = SimulatedOptics(
        *SIZE,
        11.0 * 3600 / SIZE[0],
        rotation_deg=float(rng.uniform(0, 360)),
        parity=int(rng.choice((-1, 1))),
        fwhm_px=1.0 if fault == "undersampled" else float(rng.uniform(1.6, 3.0)),
        distortion_px2=float(rng.uniform(-2e-9, 2e-9)),
        zero_point_mag=float(rng.uniform(12.0, 14.5)),
        gain_e_adu=1.0,
        sky_adu_s=float(rng.uniform(5, 40)),
        bias_adu=50.0,
        read_noise_adu=float(rng.uniform(3, 8)),
        bits=12,
    )
    center = place_of(KINDS[number % len(KINDS)], rng)
    frame = draw_frame(
        center, optics, embedded_catalog(), exposure_s=1.0, mid_exposure_utc=TAKEN, seed=(17, number)
    )
    light = frame.pixels.astype(float)
    ground = float(np.median(light))
    if fault in ("soft", "coma", "all of them"):
        light = ground + ndimage.convolve(light - ground, point_image(fault), mode="nearest")
        light += rng.normal(0, 0.7 * optics.read_noise_adu, light.shape)
    if fault in ("hot pixels", "all of them"):
        count = int(rng.uniform(100, 800))
        rows, columns = rng.integers(0, SIZE[1], count), rng.integers(0, SIZE[0], count)
        light[rows, columns] += rng.exponential(300, count)
    return as_file(light, fault, rng), center, optics.scale_arcsec_px


def as_file(light, fault, rng):
    """Eight bits, stretched, as PNG or JPEG."""
    low, high = np.percentile(light, 1) - 5, np.median(light) + rng.uniform(150, 800)
    share = np.clip((light - low) / (high - low), 0, 1)
    grey = (255 * share ** (1 / rng.choice([1.0, 2.2]))).astype(np.uint8)
    file = io.BytesIO()
    if fault == "8 bits":
        Image.fromarray(grey).save(file, "PNG")
    else:
        Image.fromarray(grey).save(file, "JPEG", quality=int(rng.integers(70, 95)))
    return file.getvalue()


def found_without_flags(frame, index):
    measured = measure(frame)
    plain = replace(measured, flags=np.zeros_like(measured.flags))
    reach = Reach(index=index, blind="only")
    return identify(plain, embedded_catalog(), Hint(), epoch_yr=julian_year(TAKEN), reach=reach)


@pytest.mark.long
def test_no_picture_is_missed_blind_for_its_flags(sky_index):
    settings = SolveSettings(index=sky_index, blind="only")
    outcomes: Counter[Any] = Counter()
    for number in range(PICTURES):
        file, center, scale = picture(number)
        frame = replace(read_frame(file, name=f"picture {number}"), mid_exposure_utc=TAKEN)
        solution = solve(frame, embedded_catalog(), settings=settings).solution
        if solution is None:
            outcomes["refused"] += 1
            assert found_without_flags(frame, sky_index).reference is None, f"picture {number}"
            continue
        # coma moves every star alike
        assert separation_arcsec(solution.center, center) < 8 * scale, f"picture {number}"
        outcomes["found"] += 1
    print(outcomes)
    assert outcomes["found"] > PICTURES // 3


@pytest.mark.long
def test_pictures_of_noise_give_no_answer(sky_index):
    settings = SolveSettings(index=sky_index, blind="only")
    for number in range(NOISE_PICTURES):
        rng = np.random.default_rng((18, number))
        light = 60 + rng.normal(0, 6, SIZE[::-1])
        count = int(rng.uniform(50, 500))
        rows, columns = rng.integers(0, SIZE[1], count), rng.integers(0, SIZE[0], count)
        light[rows, columns] += rng.exponential(2000, count)
        light = ndimage.gaussian_filter(light, float(rng.uniform(0.3, 1.2)))
        frame = read_frame(as_file(light, FAULTS[number % len(FAULTS)], rng), name=f"noise {number}")
        assert solve(frame, embedded_catalog(), settings=settings).solution is None
