"""The demo's promise holds at any hour: five stars are up, far apart, and each starts more than 5′ off."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from itertools import combinations

import pytest

from api.demo.observatory import demo_settings
from api.demo.targets import NAMED_STARS, targets_up_now
from mountnav.catalog.embedded import embedded_catalog
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

EVENING = datetime(2026, 11, 21, 18, 0, tzinfo=UTC)


@pytest.mark.parametrize("name", NAMED_STARS)
def test_each_named_star_is_bright_in_the_catalog(name: str) -> None:
    ra_deg, dec_deg = NAMED_STARS[name]
    near = embedded_catalog().cone(Icrs(ra_deg, dec_deg), 0.03, epoch_yr=2000.0)
    assert near.mag[0] < 3.5


@pytest.mark.long
@pytest.mark.parametrize("hour", range(24))
def test_at_any_hour_five_targets_start_more_than_five_arcminutes_off(hour: int) -> None:
    settings = demo_settings("127.0.0.1", 8000)
    site, air = settings.site.site, settings.air.air
    now = [EVENING + timedelta(hours=hour)]
    targets = targets_up_now(now[0], site, air, embedded_catalog())
    assert len(targets) == 5
    for one, other in combinations(targets, 2):
        assert separation_arcsec(one.position, other.position) > 15 * 3600

    demo = settings.telescope[0]
    assert demo.mount.errors is not None
    mechanics = Mechanics(
        site,
        air,
        PointingErrors(**demo.mount.errors.model_dump()),
        slew_rate_deg_s=15.0,
        clock=lambda: now[0],
    )
    for target in targets:
        mechanics.slew(icrs_to_apparent(target.position, now[0]))
        now[0] += timedelta(seconds=30)
        error_arcsec = separation_arcsec(mechanics.truth(), target.position)
        # and less than the demo's settings let a sync heal
        assert 300.0 < error_arcsec < demo.centering.max_sync_arcsec
        mechanics.sync(icrs_to_apparent(mechanics.truth(), now[0]))
