"""What is shown of a telescope's state: as it was read last, where it stands in the sky, and what comes."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta

from api.http.models import NextLimitView, TelescopeView
from api.http.places import place
from api.observatory import Telescope
from api.orders.watching import Snapshot
from mountnav.devices import MountReading
from mountnav.mount import CheckedMount
from mountnav.sky.chain import icrs_to_hour_angle, sidereal_time_deg

_WITHIN_S = 12 * 3600.0


def telescope_view(telescope: Telescope, snapshot: Snapshot, warnings: Sequence[str] = ()) -> TelescopeView:
    """View of a telescope as it was read last. Asks no device.

    Parameters
    ----------
    telescope : Telescope
    snapshot : Snapshot
    warnings : sequence of str
        Of the service; those of the telescope come before.
    """
    state, navigator = snapshot.state, telescope.navigator
    reading, mount = state.reading, navigator.mount
    own = navigator.learned.warnings(
        configured_scale_arcsec_px=navigator.policy.scale_arcsec_px,
        tolerance=navigator.policy.scale_tolerance,
    )
    limit = None if reading is None else _next_limit(mount, reading)
    here = None
    if reading is not None and state.icrs is not None:
        here = icrs_to_hour_angle(state.icrs, reading.utc, mount.site, mount.air)
    return TelescopeView(
        id=state.name,
        connected=state.connected,
        activity=state.activity,
        mount=telescope.mount_address,
        reading=None if reading is None else place(reading.place),
        icrs=None if state.icrs is None else place(state.icrs),
        read_utc=None if reading is None else reading.utc,
        altitude_deg=state.altitude_deg,
        azimuth_deg=state.azimuth_deg,
        hour_angle_deg=None if here is None else here.ha_deg,
        local_sidereal_time_deg=None if reading is None else sidereal_time_deg(reading.utc, mount.site),
        slewing=snapshot.slewing or (None if reading is None else reading.slewing),
        job_id=None if snapshot.job is None else snapshot.job.id,
        problem=state.problem,
        trusted=state.trusted,
        contradiction=mount.contradiction if state.connected else None,
        link=state.link,
        slew_state=state.slew_state,
        tracking=None if reading is None else reading.tracking,
        parked=None if reading is None else reading.parked,
        pier_side=str(reading.pier_side) if reading is not None and reading.pier_side else None,
        time_to_limit_s=None if limit is None else limit.after_s,
        next_limit=limit,
        learned=navigator.learned.words,
        warnings=[*own, *warnings],
    )


def _next_limit(mount: CheckedMount, reading: MountReading) -> NextLimitView | None:
    """Which limit tracking on leads to; a mount that doesn't say whether it tracks is taken to."""
    if reading.tracking is False or reading.parked:
        return None
    soon = mount.reached(reading, within_s=_WITHIN_S)
    if soon is None:
        return None
    return NextLimitView(
        limit=str(soon.limit),
        after_s=soon.after_s,
        utc=reading.utc + timedelta(seconds=soon.after_s),
        altitude_deg=soon.alt_deg,
        azimuth_deg=soon.az_deg,
    )


__all__ = ["telescope_view"]
