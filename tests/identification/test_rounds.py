"""What is left to triangles where the index goes over the whole sky."""

import math

import pytest

from mountnav.frames import Hint
from mountnav.identification.budget import Budget
from mountnav.identification.full import Search
from mountnav.identification.rounds import (
    INDEX_LEAST_DEG,
    INDEX_MOST_DEG,
    OUTWARD_BESIDE_INDEX,
    in_index,
    plan,
)
from mountnav.identification.search import ENOUGH_WORK, LATER_LEAST, _end_of_round, _Step
from mountnav.identification.settings import IdentificationSettings
from mountnav.sky.coordinates import Icrs

SIDE = 2000
SETTINGS = IdentificationSettings()


def rounds(low, high, *, indexed, radius=1.0, flagged=True):
    parts = plan(Hint(Icrs(80, 10), radius, low, high), SIDE, SETTINGS, flagged=flagged, indexed=indexed)
    return [turn for part in parts for turn in part]


@pytest.mark.parametrize(("low", "high"), [(2.0, 2.2), (10.0, 12.0), (0.5, 0.6), (90.0, 99.0), (None, None)])
def test_what_the_hint_says_is_tried_with_and_without_the_index(low, high):
    def stages(turns):
        wide = 1e9 if low is None else high
        narrow = 0.0 if low is None else low
        return {
            turn.stage
            for turn in turns
            if turn.inner_deg == 0
            and narrow <= turn.scales[0]
            and turn.scales[1] <= wide
            and not turn.flagged
        }

    assert stages(rounds(low, high, indexed=True)) == stages(rounds(low, high, indexed=False))
    for indexed in (False, True):
        first = plan(Hint(Icrs(80, 10), 1.0, low, high), SIDE, SETTINGS, flagged=False, indexed=indexed)[0]
        assert first == plan(Hint(Icrs(80, 10), 1.0, low, high), SIDE, SETTINGS, flagged=False)[0]


def test_only_fields_that_the_index_is_not_made_for_are_sought_at_other_scales():
    others = [turn for turn in rounds(2.0, 2.2, indexed=True) if turn.scales != (2.0, 2.2)]
    assert others
    for turn in others:
        low_deg, high_deg = (SIDE * scale / 3600 for scale in turn.scales)
        assert low_deg < INDEX_LEAST_DEG or high_deg > INDEX_MOST_DEG
    assert len(others) < len([turn for turn in rounds(2.0, 2.2, indexed=False) if turn.scales != (2.0, 2.2)])


def test_farther_out_is_sought_less_far_beside_the_index():
    def farthest(low, high, *, indexed):
        return max(turn.outer_deg for turn in rounds(low, high, indexed=indexed))

    side_deg = SIDE * math.sqrt(2.0 * 2.2) / 3600
    assert farthest(2.0, 2.2, indexed=True) == pytest.approx(1.0 + OUTWARD_BESIDE_INDEX * side_deg)
    assert farthest(2.0, 2.2, indexed=False) > farthest(2.0, 2.2, indexed=True)
    # the index hardly finds such narrow ones
    assert farthest(0.5, 0.6, indexed=True) == farthest(0.5, 0.6, indexed=False)


def test_the_limits_of_the_index():
    assert in_index((2.0, 2.2), SIDE)
    assert not in_index((1.0, 2.2), SIDE)
    assert not in_index((60.0, 80.0), SIDE)


@pytest.mark.parametrize("before", [0, ENOUGH_WORK // 2, 3 * ENOUGH_WORK])
@pytest.mark.parametrize("count", [1, 12, 40])
def test_later_rounds_share_what_work_is_left_and_none_is_left_out(before, count):
    search = Search(Budget.of(1.0), work=before)
    for number in range(count):
        end = _end_of_round(_Step(None, None, rounds_left=count - number), search)
        assert end >= search.work + LATER_LEAST
        search.work = int(end)
    assert search.work <= max(before, ENOUGH_WORK) + count * LATER_LEAST


def test_a_round_that_is_not_bounded_has_no_end():
    assert _end_of_round(_Step(None, None), Search(Budget.of(1.0), work=10 * ENOUGH_WORK)) == math.inf
