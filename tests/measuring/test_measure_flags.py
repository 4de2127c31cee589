"""Each flag for its own cause: how many it catches, and how many it wrongly accuses, on painted frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag, StarImages
from tests.measuring.nearest import nearest
from tests.measuring.painted import Array, as_frame, painted, scattered, spots, star

SIZE = (900, 900)
TOP = 45_000.0


@dataclass(frozen=True)
class Scene:
    """A frame with one offender of each kind in every cell of a grid, and plain stars in the others."""

    x: Array
    y: Array
    cause: np.ndarray  # of str


@pytest.fixture(scope="module")
def judged() -> tuple[Scene, np.ndarray, np.ndarray]:
    """Flags and distance of the source nearest to each position, and the scene."""
    fwhm = 3.0
    chance = np.random.default_rng(71)
    x, y = scattered(225, SIZE, seed=72, margin=30.0)
    kinds = ["plain"] * 145 + ["hot"] * 20 + ["cosmic"] * 20 + ["blend"] * 16 + ["full"] * 8 + ["galaxy"] * 16
    cause = np.array(kinds)[chance.permutation(225)]
    electrons = np.exp(chance.uniform(np.log(1.5e4), np.log(2e5), 225))
    electrons[cause == "full"] = 3e6
    stellar = np.isin(cause, ["plain", "blend", "full"])
    second = cause == "blend"
    turn = chance.uniform(0.0, 2.0 * np.pi, 225)
    image = painted(
        np.r_[x[stellar], (x + 1.2 * fwhm * np.cos(turn))[second]],
        np.r_[y[stellar], (y + 1.2 * fwhm * np.sin(turn))[second]],
        np.r_[electrons[stellar], 0.5 * electrons[second]],
        fwhm_px=fwhm,
        size=SIZE,
        seed=73,
    )
    for k in np.flatnonzero(cause == "galaxy"):
        smear = spots(trail_px=14.0, trail_deg=float(np.degrees(turn[k])))
        column, row = round(x[k]), round(y[k])
        cutout = electrons[k] * star(fwhm, 0.0, smear, x[k] - column, y[k] - row, 20)
        image[row - 20 : row + 21, column - 20 : column + 21] += cutout
    x[cause == "hot"], y[cause == "hot"] = np.rint(x[cause == "hot"]), np.rint(y[cause == "hot"])
    for k in np.flatnonzero(cause == "hot"):
        image[int(y[k]), int(x[k])] += chance.uniform(1_500.0, 20_000.0)
    for k in np.flatnonzero(cause == "cosmic"):
        steps = np.arange(-3, 4)
        rows = np.rint(y[k] + steps * np.sin(turn[k])).astype(int)
        columns = np.rint(x[k] + steps * np.cos(turn[k])).astype(int)
        image[rows, columns] += chance.uniform(2_000.0, 10_000.0)
    found = measure(as_frame(image, top=TOP))
    distance, index = nearest(np.c_[found.x_px, found.y_px], np.c_[x, y])
    return Scene(x, y, cause), found.flags[index], distance


def rates(scene: Scene, flags: np.ndarray, flag: Flag, causes: list[str]) -> tuple[float, float]:
    """Share of the guilty that is caught, and share of the accused that is guilty."""
    guilty, accused = np.isin(scene.cause, causes), (flags & int(flag)) > 0
    caught = (guilty & accused).sum()
    return float(caught / guilty.sum()), float(caught / max(1, accused.sum()))


@pytest.mark.long
@pytest.mark.parametrize(
    ("flag", "causes"),
    [
        (Flag.NO_PEAK, ["hot", "cosmic"]),
        (Flag.BLENDED, ["blend"]),
        (Flag.SATURATED, ["full"]),
    ],
)
def test_a_flag_catches_its_cause_and_nothing_else(
    judged: tuple[Scene, np.ndarray, np.ndarray], flag: Flag, causes: list[str]
) -> None:
    scene, flags, distance = judged
    there = distance < 4.0
    kept = Scene(scene.x[there], scene.y[there], scene.cause[there])
    if flag is Flag.NO_PEAK:  # long things that are no blend may be called that as well
        plain = kept.cause != "galaxy"
        kept, flags = Scene(kept.x[plain], kept.y[plain], kept.cause[plain]), flags[there][plain]
    else:
        flags = flags[there]
    recall, precision = rates(kept, flags, flag, causes)
    print(f"\n{flag.name}: recall {recall:.2f}, precision {precision:.2f}")
    assert recall >= 0.9
    assert precision >= 0.9


@pytest.mark.long
def test_long_things_are_accused_of_something(judged: tuple[Scene, np.ndarray, np.ndarray]) -> None:
    scene, flags, distance = judged
    long = (scene.cause == "galaxy") & (distance < 6.0)
    assert long.sum() >= 14
    assert ((flags[long] & int(Flag.ELONGATED | Flag.NO_PEAK | Flag.BLENDED)) > 0).mean() >= 0.9


def test_plain_stars_go_unflagged(judged: tuple[Scene, np.ndarray, np.ndarray]) -> None:
    scene, flags, distance = judged
    plain = scene.cause == "plain"
    assert (distance[plain] < 0.3).mean() >= 0.99
    assert (flags[plain] == 0).mean() >= 0.97


def test_stars_on_the_edge_are_told() -> None:
    along = np.linspace(30.0, 370.0, 12)
    x = np.r_[along, along, np.full(12, 0.7), np.full(12, 398.5), along]
    y = np.r_[np.full(12, 1.2), np.full(12, 399.0), along, along, np.full(12, 200.0)]
    found = measure(as_frame(painted(x, y, np.full(60, 6e4), fwhm_px=3.0, size=(400, 400), seed=74)))
    distance, index = nearest(np.c_[found.x_px, found.y_px], np.c_[x, y])
    edge = (found.flags[index] & int(Flag.EDGE)) > 0
    assert (distance < 1.5).mean() > 0.95
    assert edge[:48].all()
    assert not edge[48:].any()


@pytest.mark.long
@pytest.mark.parametrize("count", [300, 1500])
def test_hot_pixels_never_pass_for_the_typical_star(count: int) -> None:
    rng = np.random.default_rng(count)
    x, y = scattered(80, (700, 900), 5)
    flux = 10 ** rng.uniform(3.3, 5.0, 80)
    image = painted(x, y, flux, size=(700, 900), fwhm_px=2.8, seed=5)
    columns, rows = rng.integers(0, 900, count), rng.integers(0, 700, count)
    image[rows, columns] += 10 ** rng.uniform(3.0, 4.5, count)
    found = measure(as_frame(image))
    assert found.quality is not None
    assert found.quality.fwhm_px == pytest.approx(2.8, rel=0.05)
    assert found.quality.images is StarImages.WELL_SAMPLED
    distance, index = nearest(np.column_stack((found.x_px, found.y_px)), np.column_stack((x, y)))
    pixels = np.column_stack((columns, rows))
    unhit = nearest(pixels, np.column_stack((x, y)))[0] > 6.0
    assert unhit.sum() > 30
    assert (distance[unhit] < 0.2).mean() > 0.97
    assert ((found.flags[index[unhit]] & int(Flag.NO_PEAK)) == 0).mean() > 0.97
    hot_distance, hot = nearest(np.column_stack((found.x_px, found.y_px)), pixels)
    away = nearest(np.column_stack((x, y)), pixels)[0] > 8.0
    listed = away & (hot_distance < 0.7)
    assert listed.sum() > 50
    assert ((found.flags[hot[listed]] & int(Flag.NO_PEAK)) > 0).mean() > 0.99
