"""The first line of a recorded night: the settings that it was taken with, without what is secret."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from mountnav import __version__
from mountnav.settings.observatory import Settings
from mountnav.settings.secrets import masked_settings
from mountnav.settings.telescope import TelescopeSettings


def recording_header(telescope: TelescopeSettings, settings: Settings) -> dict[str, Any]:
    """The header of a telescope's night, as JSON values.

    Neither the service's and the report's tables nor the journal's address are among them, and of the others
    no secret: recordings are handed to others.
    """
    kept = settings.model_copy(update={"telescope": (telescope,)})
    return {
        "telescope": telescope.id,
        "mountnav": __version__,
        "begun_utc": datetime.now(UTC).isoformat(),
        "settings": masked_settings(kept, exclude={"service", "journal", "report"}, exclude_none=True),
    }


def recorded_settings(header: dict[str, Any]) -> Settings:
    """The settings of a header. Raises `ValueError` where this version no longer knows them."""
    return Settings.model_validate(header["settings"])
