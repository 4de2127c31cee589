"""What offset is believed."""

from __future__ import annotations

import pytest

from mountnav.errors import BadSettings, OffsetTooLarge
from mountnav.pointing.offset import check_offset
from mountnav.sky.sphere import Offset


def test_offsets_up_to_the_cap_are_believed() -> None:
    check_offset(Offset(300.0, 400.0), 500.0)
    check_offset(Offset(0.0, 0.0), 1.0)


def test_a_longer_one_is_refused_with_its_parts_and_the_way_out() -> None:
    with pytest.raises(OffsetTooLarge) as refusal:
        check_offset(Offset(-11160.0, 0.0), 7200.0)
    text = str(refusal.value)
    assert "186.0′" in text
    assert "-11160″ east" in text
    assert "120.0′" in text
    assert "longitude" in text


def test_no_number_is_not_believed() -> None:
    with pytest.raises(OffsetTooLarge):
        check_offset(Offset(float("nan"), 0.0), 7200.0)


@pytest.mark.parametrize("cap_arcsec", [0.0, -1.0, float("nan")])
def test_a_cap_that_caps_everything_is_a_wrong_setting(cap_arcsec: float) -> None:
    with pytest.raises(BadSettings):
        check_offset(Offset(1.0, 1.0), cap_arcsec)
