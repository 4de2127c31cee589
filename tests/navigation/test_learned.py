"""What solves teach of the camera: medians that mind neither order, nor false solves, nor wrong settings."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.devices import PierSide
from mountnav.errors import BadSettings, SyncDoubt
from mountnav.frames import Hint
from mountnav.identification.plate import Plate
from mountnav.identification.wcs import wcs_cards
from mountnav.navigation.camera import CameraSample, axis_angle_deg, distortion_px2
from mountnav.navigation.learned import Learned, LessonKind
from mountnav.pointing.limits import Mounting
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.chain import apparent_to_icrs, hour_angle_to_apparent
from mountnav.sky.coordinates import Air, GeometricHourAngle, Icrs, Site
from mountnav.sky.sphere import displaced, half_turn_deg
from mountnav.solution import IdentifiedPairs, Solution

SITE = Site(48.93, 22.27, 700.0)
AIR = Air(pressure_hpa=930.0, temperature_c=5.0, relative_humidity=0.7)
START = datetime(2026, 11, 21, 22, 0, tzinfo=UTC)
CAMERA_DEG = 33.0


def sample(
    number: int = 0,
    *,
    scale: float = 2.34,
    angle_deg: float = CAMERA_DEG,
    parity: int = 1,
    side: PierSide = PierSide.EAST,
    cos: float = 0.8,
) -> CameraSample:
    turned = 180.0 if side is PierSide.WEST else 0.0
    return CameraSample(
        f"look-{number}",
        START + timedelta(minutes=number),
        scale,
        parity,
        (angle_deg + turned) % 360.0,
        cos,
        side,
    )


def taught(*samples: CameraSample, **parameters: object) -> Learned:
    learned = Learned(mounting="german", **parameters)  # type: ignore[arg-type]
    for one in samples:
        learned.learn(one)
    return learned


# -- medians ---------------------------------------------------------------------------------------

inliers = st.builds(
    lambda scale, angle, side: sample(scale=scale, angle_deg=angle, side=side),
    st.floats(2.34 * 0.995, 2.34 * 1.005),
    st.floats(CAMERA_DEG - 1.0, CAMERA_DEG + 1.0),
    st.sampled_from([PierSide.EAST, PierSide.WEST]),
)


def _restored(data: Mapping[str, Any], mounting: Mounting | None = None) -> Learned:
    """What another start makes of it."""
    made = Learned(mounting=mounting)
    made.restore(data)
    return made


@pytest.mark.long
@given(st.lists(inliers, min_size=5, max_size=30), st.randoms(use_true_random=False))
def test_medians_do_not_depend_on_the_order(samples: list[CameraSample], chance: random.Random) -> None:
    one = taught(*samples)
    chance.shuffle(samples)
    other = taught(*samples)
    assert one.normal == other.normal
    assert one.normal is not None
    assert one.normal.scale_arcsec_px == pytest.approx(
        np.median([s.scale_arcsec_px for s in samples]), rel=1e-9
    )


outliers = st.builds(
    lambda scale, angle, parity: sample(scale=scale, angle_deg=angle, parity=parity),
    st.sampled_from([0.7, 1.1, 1.9, 3.3, 5.0]),
    st.floats(0.0, 359.0),
    st.sampled_from([1, -1]),
)


@pytest.mark.long
@given(
    st.lists(inliers, min_size=8, max_size=20),
    st.lists(outliers, min_size=1, max_size=3),
    st.randoms(use_true_random=False),
)
def test_a_minority_of_false_solves_moves_nothing_wherever_it_comes(
    samples: list[CameraSample], false: list[CameraSample], chance: random.Random
) -> None:
    honest = taught(*samples)
    mixed = [*samples, *false]
    chance.shuffle(mixed)
    learned = taught(*mixed)
    assert honest.normal is not None
    assert learned.normal is not None
    assert learned.normal.parity == 1
    # within the scatter of the honest ones: the solves that agree are the same
    assert learned.normal.scale_arcsec_px == pytest.approx(honest.normal.scale_arcsec_px, rel=0.006)
    assert learned.normal.camera_angle_deg == pytest.approx(honest.normal.camera_angle_deg, abs=1.1)


@given(st.floats(0.0, 360.0), st.lists(st.floats(-2.0, 2.0), min_size=4, max_size=12))
def test_the_camera_angle_may_lie_anywhere_on_the_circle(about: float, off: list[float]) -> None:
    learned = taught(*(sample(angle_deg=(about + one) % 360.0) for one in off))
    assert learned.normal is not None
    angle = learned.normal.camera_angle_deg
    assert angle is not None
    assert abs(half_turn_deg(angle - about - float(np.median(off)))) < 1e-6


def test_nothing_counts_before_enough_agree() -> None:
    learned = taught(sample(0), sample(1, scale=1.1, angle_deg=200.0))
    assert learned.normal is None
    assert learned.departures(sample(2, scale=9.9)) == {}
    assert learned.hint(Hint()) == Hint()
    learned.learn(sample(2))
    # two against one is a majority, and still not enough
    assert learned.normal is None
    learned.learn(sample(3))
    assert learned.normal is not None
    assert learned.normal.solves == 3
    with pytest.raises(BadSettings):
        Learned(enough=10, anew=3)


# -- departures ------------------------------------------------------------------------------------

SIX = [sample(n, side=PierSide.WEST if n % 2 else PierSide.EAST) for n in range(6)]


@pytest.mark.parametrize(
    ("shown", "doubts"),
    [
        (sample(9), set()),
        (sample(9, side=PierSide.WEST), set()),
        (sample(9, scale=2.34 * 1.019), set()),
        (sample(9, scale=2.34 * 1.021), {SyncDoubt.SCALE}),
        (sample(9, parity=-1), {SyncDoubt.PARITY}),
        # 5° are allowed, and a pole that is 1° off, at this declination: 1.25°
        (sample(9, angle_deg=CAMERA_DEG + 6.2), set()),
        (sample(9, angle_deg=CAMERA_DEG - 6.3), {SyncDoubt.ROTATION}),
        (sample(9, angle_deg=CAMERA_DEG + 90.0), {SyncDoubt.ROTATION}),
        (sample(9, angle_deg=CAMERA_DEG + 181.0), {SyncDoubt.WRONG_SIDE}),
        (sample(9, angle_deg=CAMERA_DEG + 180.0, side=PierSide.WEST), {SyncDoubt.WRONG_SIDE}),
        # a mount that doesn't tell its side may be on either
        (sample(9, angle_deg=CAMERA_DEG + 180.0, side=PierSide.UNKNOWN), set()),
        (sample(9, angle_deg=CAMERA_DEG + 170.0, side=PierSide.UNKNOWN), {SyncDoubt.ROTATION}),
        # near the pole it means less, at the pole nothing
        (sample(9, angle_deg=CAMERA_DEG + 15.0, cos=0.09), set()),
        (sample(9, angle_deg=CAMERA_DEG + 130.0, cos=0.09), {SyncDoubt.ROTATION}),
        (sample(9, angle_deg=CAMERA_DEG + 130.0, cos=0.002), set()),
        (
            sample(9, scale=1.2, parity=-1, angle_deg=100.0),
            {SyncDoubt.SCALE, SyncDoubt.PARITY, SyncDoubt.ROTATION},
        ),
    ],
)
def test_what_a_solve_shows_that_the_others_did_not(shown: CameraSample, doubts: set[SyncDoubt]) -> None:
    learned = taught(*SIX)
    told = learned.departures(shown)
    assert set(told) == doubts
    assert all(any(digit in words for digit in "0123456789") for words in told.values())


def test_the_side_is_seen_by_the_rotation() -> None:
    learned = taught(*SIX)
    for says in PierSide:
        assert learned.side_seen(replace(sample(9), side=says)) is PierSide.EAST
        west = replace(sample(9), side=says, axis_angle_deg=CAMERA_DEG + 179.0)
        assert learned.side_seen(west) is PierSide.WEST
    assert learned.side_seen(replace(sample(9), axis_angle_deg=CAMERA_DEG + 90.0)) is PierSide.UNKNOWN
    assert learned.side_seen(sample(9, cos=0.001)) is PierSide.UNKNOWN
    assert learned.normal is not None
    assert learned.normal.by_side == {PierSide.EAST: CAMERA_DEG, PierSide.WEST: CAMERA_DEG}
    # what was learned of a mount that doesn't tell its side can't tell it either
    unsided = taught(
        *(sample(n, angle_deg=CAMERA_DEG + 180.0 * (n % 2), side=PierSide.UNKNOWN) for n in range(6))
    )
    assert unsided.normal is not None
    assert unsided.normal.modulo_deg == 180.0
    assert unsided.normal.camera_angle_deg == pytest.approx(CAMERA_DEG)
    assert unsided.side_seen(sample(9)) is PierSide.UNKNOWN


# -- a camera that was changed ---------------------------------------------------------------------


def test_a_turned_camera_is_the_new_normal_after_some_solves_and_is_announced() -> None:
    learned = taught(*SIX)
    lessons = [learned.learn(sample(10 + n, angle_deg=CAMERA_DEG + 90.0 + 0.1 * n)) for n in range(5)]
    assert [one.kind for one in lessons] == [LessonKind.ASIDE] * 4 + [LessonKind.NEW_NORMAL]
    assert "33.0° → 123.2°" in lessons[-1].words
    assert lessons[-1].worth_writing
    assert learned.departures(sample(20, angle_deg=CAMERA_DEG + 90.0)) == {}
    assert set(learned.departures(sample(20))) == {SyncDoubt.ROTATION}


def test_false_solves_that_disagree_never_become_normal() -> None:
    learned = taught(*SIX)
    chance = random.Random(4)
    for n in range(200):
        lesson = learned.learn(
            sample(n, scale=chance.uniform(0.5, 5.0), angle_deg=chance.uniform(50.0, 350.0), parity=-1)
        )
        assert lesson.kind is LessonKind.ASIDE
    assert learned.normal == taught(*SIX).normal
    assert "differ from those before" in learned.warnings()[0]
    learned.learn(sample(300))
    assert learned.warnings() == ()
    assert learned.waiting == 0


def test_a_misreported_side_never_becomes_normal_by_itself() -> None:
    learned = taught(*SIX)
    for n in range(30):
        assert learned.learn(sample(10 + n, angle_deg=CAMERA_DEG + 180.0)).kind is LessonKind.ASIDE
    learned.forget()
    assert learned.normal is None


def test_a_rotator_is_not_judged() -> None:
    learned = taught(*(sample(n, angle_deg=37.0 * n) for n in range(9)))
    assert learned.normal is not None
    assert learned.normal.camera_angle_deg is None
    assert learned.departures(sample(10, angle_deg=200.0)) == {}


# -- what it is good for ---------------------------------------------------------------------------


def test_a_wrong_focal_length_is_only_a_warning() -> None:
    learned = taught(*(sample(n) for n in range(30)))
    (warning,) = learned.warnings(configured_scale_arcsec_px=1.9, focal_length_mm=400.0)
    assert "400 mm" in warning
    assert "1.9″/px" in warning
    assert "30 solves say 2.34″/px (325 mm" in warning
    assert learned.warnings(configured_scale_arcsec_px=2.3) == ()
    hint = learned.hint(Hint(scale_low_arcsec_px=1.8, scale_high_arcsec_px=2.0, radius_deg=3.0))
    assert hint.scale_low_arcsec_px is not None
    assert hint.scale_high_arcsec_px is not None
    assert hint.scale_low_arcsec_px < 2.34 < hint.scale_high_arcsec_px
    assert hint.scale_high_arcsec_px / hint.scale_low_arcsec_px < 1.05
    assert hint.radius_deg == 3.0


@pytest.mark.long
@given(st.lists(st.one_of(inliers, outliers), max_size=60))
def test_it_survives_a_restart(samples: list[CameraSample]) -> None:
    learned = taught(*samples)
    data = json.loads(json.dumps(learned.as_dict()))
    again = _restored(data, mounting="german")
    assert again.normal == learned.normal
    assert again.waiting == learned.waiting
    assert again.as_dict() == learned.as_dict()


def test_a_damaged_journal_teaches_nothing_wrong() -> None:
    data = taught(*SIX).as_dict()
    data["kept"][0]["scale_arcsec_px"] = float("nan")
    data["kept"][1]["side"] = "left"
    del data["kept"][2]["utc"]
    data["kept"].append("nonsense")
    again = _restored(data, mounting="german")
    assert again.normal is not None
    assert again.normal.solves == 3
    assert _restored({"format": 99, "kept": data["kept"]}).normal is None
    assert taught(replace(sample(), scale_arcsec_px=math.inf)).as_dict()["kept"] == []


# -- the angle to the axes, against a mount whose geometry is known -----------------------------------


def shown_angle(ha_deg: float, dec_deg: float, errors: PointingErrors, side: PierSide) -> CameraSample:
    """Send a German mount somewhere, and take from the truth what a solve would show."""
    utc = START
    mechanics = Mechanics(SITE, AIR, errors, machine=Machine(mounting="german"), clock=lambda: utc)
    mechanics.slew(hour_angle_to_apparent(GeometricHourAngle(ha_deg, dec_deg, utc), SITE), side)
    arrived = utc + timedelta(minutes=10)
    reading = mechanics.reported(arrived)
    rotation = mechanics.tube_angle_deg(arrived) + CAMERA_DEG
    angle, cos = axis_angle_deg(
        mechanics.truth(arrived), apparent_to_icrs(reading), rotation, arrived, SITE, AIR, "german"
    )
    return CameraSample("x", arrived, 2.34, 1, angle, cos, side)


@pytest.mark.parametrize("side", [PierSide.EAST, PierSide.WEST])
def test_the_camera_angle_is_one_all_over_the_sky_on_both_sides(side: PierSide) -> None:
    # a pole that is 0.8° off: the position angle itself wanders by 0.8° / cos δ, 9° at 85°
    errors = PointingErrors(me_arcsec=2000.0, ma_arcsec=-2000.0, ch_arcsec=300.0)
    learned = Learned(mounting="german")
    for ha_deg in (-60.0, -20.0, 15.0, 50.0):
        for dec_deg in (-10.0, 30.0, 60.0, 75.0, 85.0, 89.5):
            one = shown_angle(ha_deg, dec_deg, errors, side)
            upright = one.axis_angle_deg - (180.0 if side is PierSide.WEST else 0.0)
            assert abs(half_turn_deg(upright - CAMERA_DEG)) < 1.1 + 0.1 / one.cos_latitude
            assert learned.departures(one) == {}
            learned.learn(one)
    assert learned.normal is not None
    assert learned.normal.camera_angle_deg == pytest.approx(CAMERA_DEG, abs=0.6)


def test_the_icrs_pole_is_not_the_pole_of_date() -> None:
    # the ICRS north is up to 0.15° / cos δ from the north of date, 4° at 88°; refraction turns the rest
    perfect = PointingErrors()
    for dec_deg in (30.0, 80.0, 88.0):
        assert shown_angle(40.0, dec_deg, perfect, PierSide.EAST).axis_angle_deg == pytest.approx(
            CAMERA_DEG, abs=0.3
        )


# -- distortion ------------------------------------------------------------------------------------

BEND = 2.0e-9


def plate(degree: int) -> Plate:
    """A camera whose stars appear at r·(1 + BEND·r²), to first order."""
    terms = 10 if degree == 3 else 3
    xi, eta = np.zeros(terms), np.zeros(terms)
    unit = 1000.0
    xi[1], eta[2] = -2.0 * unit, 2.0 * unit
    if degree == 3:
        cubic = -BEND * unit**3 * 2.0
        # 1 x y xx xy yy xxx xxy xyy yyy
        xi[6], xi[8] = -cubic, -cubic
        eta[7], eta[9] = cubic, cubic
    return Plate(Icrs(50.0, 40.0), 1499.5, 999.5, unit, degree, 1, xi, eta)


def solved(cards: dict[str, str | int | float], pairs: IdentifiedPairs) -> Solution:
    return Solution(
        Icrs(50.0, 40.0), 0.1, 2.0, 0.0, 1, 0.3, len(pairs), 0, 1e-20, "full", cards, np.eye(2), pairs
    )  # fmt: skip


def pairs_of(x: np.ndarray, y: np.ndarray, dx: np.ndarray, dy: np.ndarray) -> IdentifiedPairs:
    zero = np.zeros_like(x)
    flags, used = np.zeros(x.size, dtype=np.int64), np.ones(x.size, dtype=bool)
    return IdentifiedPairs(
        x, y, zero, zero, dx, dy, zero, zero, zero, zero, zero, flags, used, zero
    )  # fmt: skip


def test_distortion_comes_from_the_sip_terms() -> None:
    none = pairs_of(*[np.zeros(0)] * 4)
    found = distortion_px2(solved(wcs_cards(plate(3), width_px=3000, height_px=2000), none))
    assert found == pytest.approx(BEND, rel=0.01)
    assert distortion_px2(solved(wcs_cards(plate(1), width_px=3000, height_px=2000), none)) is None


def test_distortion_comes_from_the_residuals_of_a_linear_plate() -> None:
    chance = np.random.default_rng(3)
    x, y = chance.uniform(0, 3000, 60), chance.uniform(0, 2000, 60)
    u, v = x - 1499.5, y - 999.5
    square = u * u + v * v
    # measured minus catalog, in arcsec: ξ runs against x
    dx, dy = -2.0 * BEND * u * square, 2.0 * BEND * v * square
    noise = chance.normal(0.0, 0.3, (2, 60))
    cards = wcs_cards(plate(1), width_px=3000, height_px=2000)
    found = distortion_px2(solved(cards, pairs_of(x, y, dx + noise[0] + 0.4, dy + noise[1])))
    assert found == pytest.approx(BEND, rel=0.1)


def test_a_displaced_belief_is_carried_in_parallel() -> None:
    # at the pole's side a step to the east turns the north: the angle is counted from the north of the belief
    seen = Icrs(10.0, 88.0)
    believed = displaced(seen, 3600.0, 0.0)
    here, _ = axis_angle_deg(seen, seen, 0.0, START, SITE, AIR, "fork")
    there, _ = axis_angle_deg(seen, believed, 0.0, START, SITE, AIR, "fork")
    # 1° east at 2° from the pole is about 27° of right ascension
    assert abs(half_turn_deg(there - here)) == pytest.approx(26.6, abs=2.0)
