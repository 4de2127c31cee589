"""Members of the site and the optics: what the settings say is read, nothing is written [Alpaca §5]."""

from __future__ import annotations

from api.alpaca.member import Member, Parameter, decimal, never, nothing, truth
from api.alpaca.telescope import AlpacaTelescope, Call


def _latitude(device: AlpacaTelescope, call: Call) -> float:
    return device.mount.site.latitude_deg


def _longitude(device: AlpacaTelescope, call: Call) -> float:
    return device.mount.site.longitude_deg


def _elevation(device: AlpacaTelescope, call: Call) -> float:
    return device.mount.site.height_m


def _has_aperture(device: AlpacaTelescope) -> bool:
    return device.told.aperture_mm is not None


def _aperture_m(device: AlpacaTelescope, call: Call) -> float:
    return (device.told.aperture_mm or 0.0) / 1000.0


def _has_focal_length(device: AlpacaTelescope) -> bool:
    return device.told.focal_length_mm is not None


def _focal_length_m(device: AlpacaTelescope, call: Call) -> float:
    return (device.told.focal_length_mm or 0.0) / 1000.0


_SET_ONCE = "it is set in one place, the settings of the service"

MEMBERS: tuple[Member, ...] = (
    Member("GET", "sitelatitude", _latitude, default=0.0),
    Member(
        "PUT",
        "sitelatitude",
        nothing,
        takes=(Parameter("SiteLatitude", decimal),),
        able=never,
        why_not=_SET_ONCE,
    ),
    Member("GET", "sitelongitude", _longitude, default=0.0),
    Member(
        "PUT",
        "sitelongitude",
        nothing,
        takes=(Parameter("SiteLongitude", decimal),),
        able=never,
        why_not=_SET_ONCE,
    ),
    Member("GET", "siteelevation", _elevation, default=0.0),
    Member(
        "PUT",
        "siteelevation",
        nothing,
        takes=(Parameter("SiteElevation", decimal),),
        able=never,
        why_not=_SET_ONCE,
    ),
    # places are without refraction, whatever the mount's air is
    Member("GET", "doesrefraction", lambda device, call: False, default=False),
    Member(
        "PUT",
        "doesrefraction",
        nothing,
        takes=(Parameter("DoesRefraction", truth),),
        able=never,
        why_not=_SET_ONCE,
    ),
    # what the tube holds back of its aperture no setting tells
    Member("GET", "aperturearea", nothing, able=never, default=0.0, why_not="no setting tells it"),
    Member(
        "GET",
        "aperturediameter",
        _aperture_m,
        able=_has_aperture,
        default=0.0,
        why_not="aperture_mm isn't set",
    ),
    Member(
        "GET",
        "focallength",
        _focal_length_m,
        able=_has_focal_length,
        default=0.0,
        why_not="focal_length_mm isn't set",
    ),
)

__all__ = ["MEMBERS"]
