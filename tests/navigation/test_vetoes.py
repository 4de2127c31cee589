"""What stands against a sync, a line of a table each: look, context, and the doubts that must come out."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.devices import MountReading, PierSide
from mountnav.errors import BadSettings, SyncDoubt
from mountnav.measuring.measurements import SkyQuality, StarImages
from mountnav.navigation.reports import Look
from mountnav.navigation.sync_judge import SyncCounts, night_of
from mountnav.navigation.sync_policy import SyncPolicy, SyncRule
from mountnav.navigation.sync_trigger import SyncTrigger, decided
from mountnav.navigation.vetoes import (
    ADVICE,
    GRAVEST_FIRST,
    Counts,
    SyncContext,
    claimed,
    frame_vetoes,
    in_order,
    place_vetoes,
    policy_vetoes,
    solution_vetoes,
)
from mountnav.pointing.model.in_force import Expected
from mountnav.settings.sync import SyncSettings
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import Offset, displaced
from mountnav.solution import MOVED_KEY
from tests.navigation.sync_rig import look_of, solution_at

SITE = Site(48.93, 22.27, 700.0)
AIR = Air(pressure_hpa=930.0)
NOW = datetime(2026, 11, 21, 22, 0, tzinfo=UTC)
POLICY = SyncPolicy()


def look(
    *,
    east: float = 0.0,
    north: float = 100.0,
    ha_deg: float = 20.0,
    dec_deg: float = 30.0,
    age_s: float = 5.0,
    wandered: float = 0.0,
    before: dict[str, Any] | None = None,
    after: dict[str, Any] | None = None,
    **solved: Any,
) -> Look:
    end = NOW - timedelta(seconds=age_s)
    begin, middle = end - timedelta(seconds=4), end - timedelta(seconds=2)
    believed = hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, middle), SITE, AIR)
    seen = displaced(believed, east, north)
    first = MountReading(
        displaced(believed, 0.0, -wandered / 2), begin, **{"slewing": False, **(before or {})}
    )
    last = MountReading(displaced(believed, 0.0, wandered / 2), end, **{"slewing": False, **(after or {})})
    return look_of(seen, first, last, middle, solution_at(seen, 12.0, **solved), "look")


def drawn_out(arcsec: float) -> Look:
    """A look in whose frame the sky moved so far."""
    found = look()
    numbers = {MOVED_KEY: arcsec / 2.0 / found.solution.scale_arcsec_px}
    return replace(found, verdict=replace(found.verdict, numbers=numbers))


def seen_for(tolerance_arcsec: float, found: Look) -> Look:
    """The same look, taken for a work with a tolerance."""
    return replace(found, tolerance_arcsec=tolerance_arcsec)


def trailed(fwhm_px: float, ellipticity: float, images: StarImages = StarImages.TRAILED) -> Look:
    """A look whose stars are drawn out, at 2″ a pixel."""
    found = look()
    quality = SkyQuality(50, images, fwhm_px, ellipticity, 0.0, 100.0, 5.0, 0.0, None, 0.0)
    return replace(found, verdict=replace(found.verdict, quality=quality))


def context(**given: Any) -> SyncContext:
    facts: dict[str, Any] = {"now": NOW, "site": SITE, "air": AIR, "resolution_arcsec": 1.0} | given
    return SyncContext(**facts)


EAST, WEST = {"pier_side": PierSide.EAST}, {"pier_side": PierSide.WEST}


@pytest.mark.parametrize(
    ("found", "known", "doubts"),
    [
        (look(), {}, set()),
        (look(wandered=30.5), {}, set()),
        (look(wandered=32.0), {}, {SyncDoubt.MOVED}),
        (drawn_out(30.5), {}, set()),
        (drawn_out(31.5), {}, {SyncDoubt.MOVED}),
        # what was looked at for a finer work has to be known as well as that
        (seen_for(20.0, drawn_out(20.5)), {}, set()),
        (seen_for(20.0, drawn_out(21.5)), {}, {SyncDoubt.UNSURE}),
        (seen_for(20.0, drawn_out(31.5)), {}, {SyncDoubt.MOVED}),
        (seen_for(5.0, look(wandered=5.9)), {}, set()),
        (seen_for(5.0, look(wandered=6.2)), {}, {SyncDoubt.UNSURE}),
        (seen_for(300.0, drawn_out(31.5)), {}, {SyncDoubt.MOVED}),
        (seen_for(4.0, look(center_sigma_arcsec=4.9)), {}, set()),
        (seen_for(4.0, look(center_sigma_arcsec=5.1)), {}, {SyncDoubt.UNSURE}),
        (look(center_sigma_arcsec=31.5), {}, {SyncDoubt.UNSURE}),
        (look(center_sigma_arcsec=float("nan")), {}, {SyncDoubt.UNSURE}),
        # a trail of 40 px: 40″ from its middle to its end
        (trailed(28.0, 0.9), {}, {SyncDoubt.UNSURE}),
        (trailed(28.0, 0.9, StarImages.DEFOCUSED), {}, set()),
        (trailed(6.0, 0.6), {}, set()),
        (look(before={"slewing": True}), {}, {SyncDoubt.MOVED}),
        (look(after={"slewing": True}), {}, {SyncDoubt.MOVED}),
        (look(before=EAST, after=WEST), {}, {SyncDoubt.MOVED}),
        (look(before=EAST, after=EAST), {}, set()),
        # a mount that isn't asked each time for its side has not changed it
        (look(before=EAST), {}, set()),
        (look(before={"tracking": False}), {}, {SyncDoubt.NOT_TRACKING}),
        (look(after={"tracking": False}), {}, {SyncDoubt.NOT_TRACKING}),
        (look(after={"tracking": True}), {}, set()),
        (look(age_s=119.0), {}, set()),
        (look(age_s=121.0), {}, {SyncDoubt.TOO_OLD}),
        # a clock that runs ahead is as bad as an old frame
        (look(age_s=-121.0), {}, {SyncDoubt.TOO_OLD}),
        # the exposure began 9 s ago
        (look(), {"last_moved_utc": NOW - timedelta(seconds=9.1)}, set()),
        (look(), {"last_moved_utc": NOW - timedelta(seconds=8.9)}, {SyncDoubt.OLDER_THAN_MOVE}),
        (look(), {"last_moved_utc": NOW}, {SyncDoubt.OLDER_THAN_MOVE}),
    ],
)
def test_the_frame(found: Look, known: dict[str, Any], doubts: set[SyncDoubt]) -> None:
    assert set(frame_vetoes(found, POLICY, context(**known))) == doubts


@pytest.mark.parametrize(
    ("solved", "doubts"),
    [
        ({}, set()),
        ({"false_probability": 1e-9}, set()),
        ({"false_probability": 1.1e-9}, {SyncDoubt.ODDS}),
        ({"false_probability": float("nan")}, {SyncDoubt.ODDS}),
        ({"pairs": 4}, set()),
        ({"pairs": 3}, {SyncDoubt.FEW_STARS}),
    ],
)
def test_the_solution(solved: dict[str, Any], doubts: set[SyncDoubt]) -> None:
    assert set(solution_vetoes(look(**solved), POLICY)) == doubts


MODEL = {"expected": Expected(Offset(0.0, 100.0), 20.0), "modeled": True}


@pytest.mark.parametrize(
    ("found", "policy", "known", "doubts"),
    [
        (look(north=7200.0), POLICY, {}, set()),
        (look(north=7201.0), POLICY, {}, {SyncDoubt.TOO_FAR}),
        (look(north=121.0), replace(POLICY, max_arcsec=120.0), {}, {SyncDoubt.TOO_FAR}),
        # 5 sigma of 20″ (and a little for the mount's step), and 120″
        (look(north=100.0), POLICY, MODEL, set()),
        (look(north=318.0), POLICY, MODEL, set()),
        (look(north=322.0), POLICY, MODEL, {SyncDoubt.NOT_EXPECTED}),
        (look(north=-122.0), POLICY, MODEL, {SyncDoubt.NOT_EXPECTED}),
        (look(north=100.0, east=230.0), POLICY, MODEL, {SyncDoubt.NOT_EXPECTED}),
        # without a model the pole may be a degree off
        (look(north=790.0), POLICY, MODEL | {"modeled": False}, set()),
        (look(north=810.0), POLICY, MODEL | {"modeled": False}, {SyncDoubt.NOT_EXPECTED}),
        # a false solution is far off, and not where the model lets it be
        (look(north=9000.0), POLICY, MODEL, {SyncDoubt.TOO_FAR, SyncDoubt.NOT_EXPECTED}),
        (look(ha_deg=60.0, dec_deg=-20.0), POLICY, {}, {SyncDoubt.TOO_LOW}),
        (look(ha_deg=60.0, dec_deg=-20.0), replace(POLICY, min_altitude_deg=-5.0), {}, set()),
        (look(ha_deg=-170.0, dec_deg=-30.0), POLICY, {}, {SyncDoubt.TOO_LOW}),
        (look(ha_deg=0.05), POLICY, {}, set()),
        (look(ha_deg=1.9), replace(POLICY, min_meridian_deg=2.0), {}, {SyncDoubt.NEAR_MERIDIAN}),
        (look(ha_deg=-2.1), replace(POLICY, min_meridian_deg=2.0), {}, set()),
        # the pole that is off shows to the east, and a sync takes it for hour angle
        (look(dec_deg=85.5), POLICY, {}, {SyncDoubt.NEAR_POLE}),
        (look(dec_deg=60.0, east=3000.0), POLICY, {"lost": True}, set()),
        (look(dec_deg=86.0), POLICY, {"lost": True}, {SyncDoubt.NEAR_POLE}),
        (look(dec_deg=84.5), POLICY, {}, set()),
        (look(dec_deg=-2.0, east=2000.0), POLICY, {}, set()),
        (look(dec_deg=60.0, east=1780.0), POLICY, {}, set()),
        (look(dec_deg=60.0, east=-1820.0), POLICY, {}, {SyncDoubt.NEAR_POLE}),
        (look(dec_deg=84.5, east=200.0), POLICY, {}, {SyncDoubt.NEAR_POLE}),
        (look(dec_deg=89.5), POLICY, {"polar": False}, set()),
        (
            look(north=100.0),
            POLICY,
            MODEL | {"expected": Expected(Offset(9000.0, 0.0), 1.0), "trusted": False},
            set(),
        ),
        # below the pole is the meridian as well
        (
            look(ha_deg=179.0, dec_deg=70.0),
            replace(POLICY, min_meridian_deg=2.0),
            {},
            {SyncDoubt.NEAR_MERIDIAN},
        ),
    ],
)
def test_the_place(found: Look, policy: SyncPolicy, known: dict[str, Any], doubts: set[SyncDoubt]) -> None:
    told = place_vetoes(claimed(found), policy, context(**known))
    assert set(told) == doubts
    assert all(any(digit in words for digit in "0123456789") for words in told.values())


def rule(rule: SyncRule, **given: Any) -> SyncPolicy:
    return replace(POLICY, rule=rule, **given)


@pytest.mark.parametrize(
    ("policy", "off", "counts", "doubts"),
    [
        (rule(SyncRule.NEVER), 3000.0, Counts(), {SyncDoubt.POLICY_NEVER}),
        (rule(SyncRule.ALWAYS), 0.0, Counts(70, 8), set()),
        (rule(SyncRule.FIRST_OF_NIGHT), 0.0, Counts(), set()),
        (rule(SyncRule.FIRST_OF_NIGHT), 3000.0, Counts(1, 0), {SyncDoubt.NOT_FIRST}),
        (rule(SyncRule.PER_TARGET), 3000.0, Counts(9, 0), set()),
        (rule(SyncRule.PER_TARGET), 3000.0, Counts(9, 1), {SyncDoubt.SAME_TARGET}),
        (rule(SyncRule.WHEN_OFF_BY), 10.1, Counts(70, 8), set()),
        (rule(SyncRule.WHEN_OFF_BY), 9.9, Counts(), {SyncDoubt.NOT_OFF_ENOUGH}),
        (rule(SyncRule.WHEN_OFF_BY, off_by_arcsec=60.0), 59.0, Counts(), {SyncDoubt.NOT_OFF_ENOUGH}),
        (rule(SyncRule.ALWAYS, max_per_night=5), 100.0, Counts(4, 0), set()),
        (rule(SyncRule.ALWAYS, max_per_night=5), 100.0, Counts(5, 0), {SyncDoubt.TOO_MANY}),
        (rule(SyncRule.ALWAYS, max_per_target=2), 100.0, Counts(5, 2), {SyncDoubt.TOO_MANY}),
        (rule(SyncRule.ALWAYS, max_per_target=2), 100.0, Counts(5, 1), set()),
    ],
)
def test_the_policy(policy: SyncPolicy, off: float, counts: Counts, doubts: set[SyncDoubt]) -> None:
    assert set(policy_vetoes(look(north=off), policy, context(counts=counts))) == doubts


def test_a_coarse_mount_is_not_synced_within_its_own_step() -> None:
    found = look(north=12.0)
    assert policy_vetoes(found, POLICY, context(resolution_arcsec=1.0)) == {}
    assert set(policy_vetoes(found, POLICY, context(resolution_arcsec=15.0))) == {SyncDoubt.NOT_OFF_ENOUGH}


def test_every_doubt_has_its_rank_and_its_advice() -> None:
    assert set(GRAVEST_FIRST) == set(SyncDoubt) == set(ADVICE)
    assert len(GRAVEST_FIRST) == len(SyncDoubt)


@given(st.permutations(list(SyncDoubt)), st.integers(0, len(SyncDoubt)))
def test_the_gravest_comes_first_however_they_were_found(kinds: list[SyncDoubt], many: int) -> None:
    some = kinds[:many]
    decision = decided({kind: f"{kind} 1" for kind in some}, look())
    assert list(decision.doubts) == [kind for kind in GRAVEST_FIRST if kind in some]
    assert list(in_order(dict.fromkeys(some, ""))) == list(decision.doubts)
    assert decision.allowed is not some or not some
    assert decision.allowed == (not some)


def test_doubts_about_the_look_forbid_an_offset_too_and_the_policy_does_not() -> None:
    decision = decided({SyncDoubt.NOT_FIRST: "", SyncDoubt.SCALE: "", SyncDoubt.NEAR_MERIDIAN: ""}, look())
    assert decision.against_the_sky == (SyncDoubt.SCALE,)
    assert not SyncTrigger.ORDERED.by_rule
    assert not SyncTrigger.RECOVERY.by_rule
    assert SyncTrigger.RECOVERY.not_asked == {SyncDoubt.TOO_FAR, SyncDoubt.NOT_EXPECTED, SyncDoubt.UNSURE}
    assert SyncTrigger.CENTERING.not_asked == set()


# -- counting --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("utc", "longitude_deg", "night"),
    [
        # local noon is at 12 h minus longitude / 15
        (datetime(2026, 11, 21, 22, 0, tzinfo=UTC), 0.0, "2026-11-21"),
        (datetime(2026, 11, 22, 3, 0, tzinfo=UTC), 0.0, "2026-11-21"),
        (datetime(2026, 11, 22, 11, 59, tzinfo=UTC), 0.0, "2026-11-21"),
        (datetime(2026, 11, 22, 12, 1, tzinfo=UTC), 0.0, "2026-11-22"),
        (datetime(2026, 11, 22, 3, 0, tzinfo=UTC), -155.0, "2026-11-21"),
        (datetime(2026, 11, 22, 13, 0, tzinfo=UTC), -155.0, "2026-11-21"),
        (datetime(2026, 11, 22, 13, 0, tzinfo=UTC), 149.0, "2026-11-22"),
        (datetime(2026, 11, 22, 1, 0, tzinfo=UTC), 149.0, "2026-11-21"),
    ],
)
def test_a_night_runs_from_noon_to_noon(utc: datetime, longitude_deg: float, night: str) -> None:
    assert night_of(utc, Site(0.0, longitude_deg)) == night


def test_targets_are_counted_by_name_or_by_place() -> None:
    counts = SyncCounts(SITE, 1.0)
    m1, near, far = Icrs(83.6, 22.0), Icrs(83.6, 22.5), Icrs(83.6, 25.0)
    counts.add(NOW, "M1", m1)
    counts.add(NOW, None, far)
    assert counts.at(NOW, "M1", far) == Counts(2, 2)  # by name, and by place where one has none
    assert counts.at(NOW, "Crab", m1) == Counts(2, 0)
    assert counts.at(NOW, None, near) == Counts(2, 1)
    assert counts.at(NOW + timedelta(days=1), "M1", m1) == Counts(0, 0)
    counts.add(NOW + timedelta(days=1), "M1", m1)
    assert counts.at(NOW + timedelta(days=1), "M1", m1) == Counts(1, 1)


# -- settings --------------------------------------------------------------------------------------


def test_nothing_set_is_the_policy_of_the_core() -> None:
    assert SyncSettings().policy == SyncPolicy()


def test_settings_reach_the_policy() -> None:
    made = SyncSettings.model_validate(
        {"rule": "first-of-night", "max_arcsec": 600, "max_per_night": 0, "max_per_target": 2, "verify": True}
    ).policy
    assert made.rule is SyncRule.FIRST_OF_NIGHT
    assert (made.max_arcsec, made.max_per_night, made.max_per_target, made.verify) == (600.0, None, 2, True)
    knobs = set(SyncSettings.model_fields)
    assert all(name in str(SyncSettings.__doc__) for name in knobs)
    # all but what no operator needs is there
    assert {name for name in SyncPolicy.__dataclass_fields__ if name not in knobs} == {
        "same_target_deg", "max_motion_arcsec", "read_back_arcsec", "expected_floor_bare_arcsec"
    }  # fmt: skip


@pytest.mark.parametrize(
    "wrong", [{"max_arcsec": 0.0}, {"max_per_night": 0}, {"verify_arcsec": float("nan")}]
)
def test_a_policy_that_makes_no_sense_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadSettings):
        SyncPolicy(**wrong)


def test_the_stated_error_holds_the_half_of_what_the_sky_moved() -> None:
    found = drawn_out(24.0)
    own = found.solution.center_sigma_arcsec
    # the solution is the middle, and the tube stands 12″ from it now
    assert found.sigma_arcsec == pytest.approx(math.hypot(own, 12.0))
    assert claimed(found).sigma_arcsec == found.sigma_arcsec
    # a mount whose reading went along is as far off at the end as in the middle
    along = replace(found, after=replace(found.after, place=displaced(found.believed, 0.0, 24.0)))
    along = replace(along, before=replace(found.before, place=found.believed))
    assert along.sigma_arcsec == pytest.approx(own, abs=0.01)


def test_an_offset_within_its_own_error_is_none() -> None:
    found = drawn_out(28.0)
    found = replace(found, offset=Offset(0.0, 13.0))
    assert SyncDoubt.NOT_OFF_ENOUGH in policy_vetoes(found, POLICY, context())
    assert not policy_vetoes(replace(found, offset=Offset(0.0, 15.0)), POLICY, context())


def test_a_recovery_does_not_ask_how_well_the_offset_is_known() -> None:
    assert SyncDoubt.UNSURE in SyncTrigger.RECOVERY.not_asked
    assert SyncDoubt.UNSURE not in SyncTrigger.ORDERED.not_asked
    assert SyncDoubt.MOVED not in SyncTrigger.RECOVERY.not_asked
