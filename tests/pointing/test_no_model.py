"""Without a pointing model: what a sync is worth grows worse with the way, and is nothing across the pier."""

from __future__ import annotations

from datetime import UTC, datetime

from mountnav.devices import PierSide
from mountnav.pointing.model.in_force import NoModel
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Icrs

NOW = datetime(2026, 3, 1, 20, 0, tzinfo=UTC)
HERE, NEAR, FAR = Icrs(100.0, 40.0), Icrs(102.0, 40.0), Icrs(160.0, 10.0)


def test_a_sync_is_worth_less_far_away_and_nothing_on_the_other_side() -> None:
    pointing = NoModel(3000.0)
    assert pointing.expected(NEAR, NOW, PierSide.EAST).sigma_arcsec == 3000.0
    synced = PointingObservation(NOW, HERE, 1.0, HERE, PierSide.EAST, "segment")
    pointing.new_segment("segment", synced)
    near = pointing.expected(NEAR, NOW, PierSide.EAST).sigma_arcsec
    far = pointing.expected(FAR, NOW, PierSide.EAST).sigma_arcsec
    assert 5.0 < near < 60.0 < far < 3000.0
    assert pointing.expected(NEAR, NOW, PierSide.UNKNOWN).sigma_arcsec == near
    assert pointing.expected(NEAR, NOW, PierSide.WEST).sigma_arcsec == 3000.0
    pointing.new_segment("another", None)
    assert pointing.expected(NEAR, NOW, PierSide.EAST).sigma_arcsec == 3000.0
    assert pointing.aim(FAR, NOW, PierSide.WEST) == FAR
