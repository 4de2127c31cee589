"""Lists of stars that others measured: ranks aren't trusted, y may run either way, chance is never solved."""

from __future__ import annotations

import os
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Hint, StarList
from mountnav.measuring.measure import measure
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solving.settings import SolveSettings
from mountnav.solving.solve import solve_stars

if TYPE_CHECKING:
    from mountnav.identification.blind.index import BlindIndex
    from mountnav.solution import Verdict

CENTER = Icrs(83.2, 21.4)
OPTICS = SimulatedOptics(800, 600, 10.0, rotation_deg=33.0, faint_stars_deg2=50.0, sky_adu_s=10.0)
NEAR = Hint(center=Icrs(83.0, 21.5), radius_deg=2.0, scale_low_arcsec_px=9.0, scale_high_arcsec_px=11.0)


@pytest.fixture(scope="module")
def stars() -> StarList:
    """The measured stars of a drawn frame."""
    utc = datetime(2026, 11, 21, 20, tzinfo=UTC)
    found = measure(
        draw_frame(CENTER, OPTICS, embedded_catalog(), exposure_s=10.0, mid_exposure_utc=utc, seed=(7,))
    )
    order = np.argsort(-found.flux)[:250]
    return StarList(found.x_px[order], found.y_px[order], found.flux[order], 800, 600)


def solved(stars: StarList, index: BlindIndex, hint: Hint | None = None) -> Verdict:
    """Solve at the hint, or blind."""
    settings = SolveSettings(index=index, blind="only" if hint is None else "never")
    return solve_stars(stars, embedded_catalog(), hint=hint, settings=settings)


def assert_true(verdict: Verdict, parity: int = 1, within_px: float = 0.05) -> None:
    """It is solved, and right."""
    assert verdict.solution is not None, verdict.detail
    assert separation_arcsec(verdict.solution.center, CENTER) < within_px * OPTICS.scale_arcsec_px
    assert verdict.solution.parity == parity


def _none(flux: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.full(flux.size, np.nan)


ORDERS = {
    "true": lambda flux, rng: flux,
    "as Siril's amplitudes": lambda flux, rng: (
        np.minimum(flux, np.median(flux)) * rng.lognormal(0.0, 0.5, flux.size)
    ),
    "shuffled": lambda flux, rng: rng.permutation(flux),
    "the faintest first": lambda flux, rng: -flux,
    "not told": _none,
}  # fmt: skip


def ordered(stars: StarList, order: str, count: int, rng: np.random.Generator) -> StarList:
    """Some of the stars, in an order of brightness."""
    flux = ORDERS[order](stars.flux[:count], rng)
    mixed = rng.permutation(count)
    return replace(stars, x_px=stars.x_px[mixed], y_px=stars.y_px[mixed], flux=flux[mixed])


@pytest.mark.long
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("hint", [None, NEAR], ids=["blind", "hinted"])
def test_the_sixty_brightest_are_found_in_any_order(
    stars: StarList, sky_index: BlindIndex, order: str, hint: Hint | None
) -> None:
    assert_true(solved(ordered(stars, order, 60, np.random.default_rng(5)), sky_index, hint))


@pytest.mark.long
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("hint", [None, NEAR], ids=["blind", "hinted"])
def test_a_wrong_order_never_makes_it_wrong(
    stars: StarList, sky_index: BlindIndex, order: str, hint: Hint | None
) -> None:
    rng = np.random.default_rng(5)
    for count in (250, 120):
        verdict = solved(ordered(stars, order, count, rng), sky_index, hint)
        # a refusal is allowed where ranks are nonsense among many stars, a wrong place never
        if verdict.solution is not None or order == "true":
            assert_true(verdict)


@pytest.mark.long
@pytest.mark.parametrize("hint", [None, NEAR], ids=["blind", "hinted"])
def test_upside_down_it_is_the_mirrored_sky(
    stars: StarList, sky_index: BlindIndex, hint: Hint | None
) -> None:
    turned = replace(stars, y_px=stars.height_px - 1 - stars.y_px)
    assert_true(solved(stars, sky_index, hint), 1)
    verdict = solved(turned, sky_index, hint)
    assert_true(verdict, -1)
    assert "solved from a list of stars: their light was not looked at" in verdict.notes


def test_a_list_of_another_size_than_its_frame_is_found_where_it_is(
    stars: StarList, sky_index: BlindIndex
) -> None:
    moved = replace(stars, x_px=stars.x_px + 100.0, width_px=1000)
    verdict = solved(moved, sky_index)
    assert verdict.solution is not None
    assert separation_arcsec(verdict.solution.icrs_at(499.5, 299.5), CENTER) < 1.0


def random_list(rng: np.random.Generator) -> StarList:
    """Stars by chance: evenly, in clumps, on a grid, or on lines, as bad detections lie."""
    count, kind = int(rng.integers(4, 400)), int(rng.integers(4))
    width, height = (int(side) for side in rng.integers(300, 4000, 2))
    x, y = rng.uniform(0.0, width - 1, count), rng.uniform(0.0, height - 1, count)
    if kind == 1:
        middle = rng.integers(0, max(1, count // 10), count)
        x, y = x[middle] + rng.normal(0.0, 20.0, count), y[middle] + rng.normal(0.0, 20.0, count)
    elif kind == 2:
        step = float(rng.uniform(20.0, 100.0))
        x, y = np.round(x / step) * step, np.round(y / step) * step
    elif kind == 3:
        x[: count // 2] = x[0] + rng.normal(0.0, 0.3, count // 2)
    flux = rng.pareto(1.5, count) + 1.0
    return StarList(x, y, flux, width, height)


@pytest.mark.long
def test_random_lists_are_never_solved(sky_index: BlindIndex) -> None:
    first, count = (int(os.environ.get(f"MOUNTNAV_LISTS_{name}", default)) for name, default in
                    (("FIRST", "0"), ("COUNT", "50")))  # fmt: skip
    for seed in range(first, first + count):
        rng = np.random.default_rng((17, seed))
        stars = random_list(rng)
        hint = None
        if seed % 50 == 0:  # at a hint the search takes longer
            center = Icrs(
                float(rng.uniform(0.0, 360.0)), float(np.degrees(np.arcsin(rng.uniform(-1.0, 1.0))))
            )
            scale = float(rng.uniform(1.0, 20.0))
            hint = Hint(center, 2.0, scale_low_arcsec_px=0.9 * scale, scale_high_arcsec_px=1.1 * scale)
        verdict = solved(stars, sky_index, hint)
        assert verdict.solution is None, (seed, verdict.detail)
