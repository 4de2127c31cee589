"""The first line of a recorded night: the settings that it was taken with, without what is secret."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from mountnav import __version__
from mountnav.settings.observatory import Settings
from mountnav.settings.telescope import TelescopeSettings


def recording_header(one: TelescopeSettings, settings: Settings) -> dict[str, Any]:
    """Make it.

    Parameters
    ----------
    one : TelescopeSettings
        The telescope whose night it is.
    settings : Settings

    Returns
    -------
    dict
        JSON values. Neither the service's token nor the journal's address is among them.
    """
    kept = settings.model_copy(update={"telescope": (one,)})
    return {
        "telescope": one.id,
        "mountnav": __version__,
        "begun_utc": datetime.now(UTC).isoformat(),
        "settings": kept.model_dump(mode="json", exclude={"service", "journal"}, exclude_none=True),
    }


def recorded_settings(header: dict[str, Any]) -> Settings:
    """Read the settings back. Raises `ValueError` where this version knows them no more."""
    return Settings.model_validate(header["settings"])
