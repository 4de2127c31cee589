"""What offset is believed."""

from __future__ import annotations

import pytest

from mountnav.errors import BadSettings
from mountnav.pointing.offset import too_far
from mountnav.sky.sphere import Offset


def test_offsets_up_to_the_cap_are_believed() -> None:
    assert too_far(Offset(300.0, 400.0), 500.0) is None
    assert too_far(Offset(0.0, 0.0), 1.0) is None


def test_a_longer_one_is_not_and_its_parts_are_told() -> None:
    words = too_far(Offset(-11160.0, 0.0), 7200.0) or ""
    assert "186.0′" in words
    assert "-11160″ east" in words
    assert "120.0′" in words


def test_no_number_is_not_believed() -> None:
    assert too_far(Offset(float("nan"), 0.0), 7200.0)


@pytest.mark.parametrize("cap_arcsec", [0.0, -1.0, float("nan")])
def test_a_cap_that_caps_everything_is_a_wrong_setting(cap_arcsec: float) -> None:
    with pytest.raises(BadSettings):
        too_far(Offset(1.0, 1.0), cap_arcsec)
