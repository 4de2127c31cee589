"""Alpaca's management answers: versions, who serves, which devices there are [Alpaca §6]."""

from __future__ import annotations

from collections.abc import Sequence

from api.alpaca.paths import Page
from api.alpaca.telescope import AlpacaTelescope
from mountnav import __version__


def management_value(page: Page, devices: Sequence[AlpacaTelescope], location: str) -> object:
    """The value of one of the management's answers.

    Parameters
    ----------
    page : Page
    devices : sequence of AlpacaTelescope
    location : str
        Of the settings.
    """
    match page:
        case "apiversions":
            return [1]
        case "description":
            return {
                "ServerName": "mountnav",
                "Manufacturer": "mountnav",
                "ManufacturerVersion": __version__,
                "Location": location,
            }
        case "configureddevices":
            return [
                {
                    "DeviceName": device.name,
                    "DeviceType": "Telescope",
                    "DeviceNumber": device.number,
                    "UniqueID": device.unique_id,
                }
                for device in devices
            ]


__all__ = ["management_value"]
