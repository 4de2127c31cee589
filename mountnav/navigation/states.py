"""What is known of a telescope now, for whoever asks; trouble is part of the answer."""

from __future__ import annotations

from dataclasses import replace

from mountnav.errors import DeviceError
from mountnav.mount import CheckedMount
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.kinds import from_mount
from mountnav.navigation.reports import TelescopeState
from mountnav.sky.chain import icrs_to_observed


async def state_of(
    equipment: Equipment, *, activity: str, connected: bool, problem: str | None
) -> TelescopeState:
    """Where the telescope believes it points, and what it does. Never raises for device trouble.

    Parameters
    ----------
    equipment : Equipment
    activity : str
    connected : bool
        Whether its devices are open.
    problem : str or None
        What is known to be wrong.
    """
    mount = equipment.mount
    known = TelescopeState(
        equipment.name,
        connected=False,
        activity=activity,
        reading=None,
        icrs=None,
        altitude_deg=None,
        azimuth_deg=None,
        problem=problem,
        trusted=mount.trusted
        if connected and (mount.told("trusted") is not None or not mount.trusted)
        else None,
        link=_told(mount, "link"),
        slew_state=_told(mount, "slew_state"),
    )
    if not connected:
        return known
    try:
        reading = await mount.reading()
    except DeviceError as error:
        return replace(known, problem=str(error))
    icrs = from_mount(reading.place)
    observed = icrs_to_observed(icrs, reading.utc, equipment.site, equipment.air)
    return replace(
        known,
        connected=True,
        reading=reading,
        icrs=icrs,
        altitude_deg=observed.alt_deg,
        azimuth_deg=observed.az_deg,
        link=_told(mount, "link"),
    )


def _trusted(mount: CheckedMount) -> bool | None:
    """Whether its position counts; None of a mount that can't tell, as long as nothing speaks against it."""
    return None if mount.trusted and mount.told("trusted") is None else mount.trusted


def _told(mount: CheckedMount, what: str) -> str | None:
    """Something that only some mounts tell."""
    value = mount.told(what)
    return None if value is None else str(value)


__all__ = ["state_of"]
