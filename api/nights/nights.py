"""The nights of the settings, put together: a runner for each telescope that has them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial

from api.nights.night_runner import NightParts, NightRunner, Nights
from api.observatory import Heard, Observatory
from drivers.wire.wire_log import WireLog
from mountnav.catalog.stars import Catalog
from mountnav.journal.sql_journal import SqlJournal
from mountnav.navigation.policy import CenteringPolicy
from mountnav.night.session import Listen
from mountnav.settings.observatory import Settings, TelescopeSettings


def nights_of(
    settings: Settings,
    observatory: Observatory,
    catalog: Catalog,
    heard: Heard,
    journal: SqlJournal,
    *,
    make_way: Callable[[str], Awaitable[None]],
) -> Nights:
    """Make the runners; nothing runs before their start.

    Parameters
    ----------
    settings : Settings
    observatory : Observatory
    catalog : Catalog
    heard : callable
        ``heard(telescope_id, kind, data)``: told of each decision.
    journal : SqlJournal
        Also tells where the last run of the service ended.
    make_way : callable
        ``make_way(telescope_id)`` ends what others do with a telescope that must be parked now.
    """

    def runner(one: TelescopeSettings) -> NightRunner:
        telescope = observatory.telescope(one.id)
        navigator = telescope.navigator
        wire_log = navigator.mount.told("wire_log")
        return NightRunner(
            NightParts(
                telescope_id=one.id,
                settings=one.night,
                navigator=navigator,
                site=settings.site.site,
                catalog=catalog,
                solving=navigator.solving,
                listen=_listener(heard, one.id),
                journal=telescope.journal,
                search_radius_deg=navigator.policy.search_radius_deg,
                ready=telescope.ready,
                scale_arcsec_px=_scale(navigator.policy),
                recall=journal.recent,
                wire_log=wire_log if isinstance(wire_log, WireLog) else None,
                recording=telescope.recording,
                make_way=partial(make_way, one.id),
            )
        )

    return Nights(runner(one) for one in settings.telescope if one.night.enabled)


def _listener(heard: Heard, telescope_id: str) -> Listen:
    return lambda kind, data: heard(telescope_id, kind, data)


def _scale(policy: CenteringPolicy) -> tuple[float, float] | None:
    scale_arcsec_px = policy.scale_arcsec_px
    if scale_arcsec_px is None:
        return None
    low, high = (scale_arcsec_px * (1.0 + sign * policy.scale_tolerance) for sign in (-1.0, 1.0))
    return low, high
