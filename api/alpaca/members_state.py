"""Members that read: the device, its site and optics, where it points and what it does [Alpaca §4, §5].

All is answered from the cached state. Of the site and optics the settings are read, and nothing is written.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime

from api.alpaca.codec import instant, turned
from api.alpaca.errors import AlpacaError, Number
from api.alpaca.member import (
    DEC,
    DEC_RANGE,
    RA,
    RA_RANGE,
    Member,
    Parameter,
    decimal,
    never,
    nothing,
    truth,
    whole,
    with_skill,
    words,
)
from api.alpaca.telescope import AlpacaTelescope, Call
from mountnav import __version__
from mountnav.clock import utc_now
from mountnav.devices import PierSide, Skill
from mountnav.sky.chain import sidereal_time_deg
from mountnav.sky.coordinates import Apparent, Icrs

__all__ = ["COMMON", "INTERFACE_VERSION", "READING", "SITE", "iso"]


INTERFACE_VERSION = 4
"""ITelescopeV4."""


def _description(device: AlpacaTelescope, call: Call) -> str:
    return f"{device.id}: {device.mount.name}, guarded by mountnav"


def _driver_info(device: AlpacaTelescope, call: Call) -> str:
    return f"mountnav {__version__}: every order is checked against this telescope's limits before it is sent"


def _driver_version(device: AlpacaTelescope, call: Call) -> str:
    return ".".join(__version__.split(".")[:2])


def _name(device: AlpacaTelescope, call: Call) -> str:
    return device.name


def _connected(device: AlpacaTelescope, call: Call) -> bool:
    return device.connected(call.client)


async def _set_connected(device: AlpacaTelescope, call: Call) -> None:
    if call.flag("Connected"):
        await device.connect(call.client)
    else:
        device.disconnect(call.client)


async def _connect(device: AlpacaTelescope, call: Call) -> None:
    device.connecting.begin(call.client)


def _connecting(device: AlpacaTelescope, call: Call) -> bool:
    if (failure := device.connecting.failed_before(call.client)) is not None:
        raise failure
    return device.connecting.under_way


def _disconnect(device: AlpacaTelescope, call: Call) -> None:
    device.disconnect(call.client)


def _action(device: AlpacaTelescope, call: Call) -> str:
    name = call.given["Action"]
    raise AlpacaError(Number.ACTION_NOT_IMPLEMENTED, f"there is no action {name}: this telescope has none")


_UNSEEN = "nothing goes to the mount unseen: use the members of the interface"
_COMMAND = (Parameter("Command", words), Parameter("Raw", truth))

COMMON: tuple[Member, ...] = (
    Member("GET", "name", _name, offline=True, default=""),
    Member("GET", "description", _description, default=""),
    Member("GET", "driverinfo", _driver_info, offline=True, default=""),
    Member("GET", "driverversion", _driver_version, offline=True, default=""),
    Member("GET", "interfaceversion", lambda device, call: INTERFACE_VERSION, offline=True),
    Member("GET", "supportedactions", lambda device, call: [], default=[]),
    Member("GET", "connected", _connected, offline=True, default=False),
    Member("PUT", "connected", _set_connected, takes=(Parameter("Connected", truth),), offline=True),
    Member("PUT", "connect", _connect, offline=True),
    Member("GET", "connecting", _connecting, offline=True, default=False),
    Member("PUT", "disconnect", _disconnect, offline=True),
    Member(
        "PUT",
        "action",
        _action,
        takes=(Parameter("Action", words), Parameter("Parameters", words, fallback="")),
        answers=True,
        default="",
    ),
    Member("PUT", "commandblind", nothing, takes=_COMMAND, able=never, why_not=_UNSEEN),
    Member(
        "PUT",
        "commandbool",
        nothing,
        takes=_COMMAND,
        able=never,
        answers=True,
        default=False,
        why_not=_UNSEEN,
    ),
    Member(
        "PUT", "commandstring", nothing, takes=_COMMAND, able=never, answers=True, default="", why_not=_UNSEEN
    ),
)


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

SITE: tuple[Member, ...] = (
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
    Member("GET", "aperturearea", nothing, able=never, default=0.0, why_not="no setting gives it"),
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


SIDES = {PierSide.EAST: 0, PierSide.WEST: 1, PierSide.UNKNOWN: -1}
"""0: the normal pointing state, as on a German mount that looks west; 1: through the pole."""
_ALIGNMENTS = {"altaz": 0, "fork": 1, "german": 2}
"""AlignmentMode: algAltAz, algPolar, algGermanPolar."""
_SYSTEMS = {"apparent": 1, "icrs": 2}
"""EquatorialSystem: equTopocentric, equJ2000."""


def right_ascension_h(device: AlpacaTelescope, call: Call) -> float:
    """Hours, in the system that EquatorialSystem tells."""
    return turned(device.reading.place.ra_deg / 15.0, 24.0)


def declination_deg(device: AlpacaTelescope, call: Call) -> float:
    """Degrees, in the system that EquatorialSystem tells."""
    return device.reading.place.dec_deg


def altitude_deg(device: AlpacaTelescope, call: Call) -> float:
    """As seen, with refraction."""
    return _known(device, device.snapshot.state.altitude_deg)


def azimuth_deg(device: AlpacaTelescope, call: Call) -> float:
    """North 0, east 90."""
    return turned(_known(device, device.snapshot.state.azimuth_deg), 360.0)


def sidereal_time_h(device: AlpacaTelescope, call: Call) -> float:
    """Local apparent sidereal time now."""
    return turned(sidereal_time_deg(utc_now(), device.mount.site) / 15.0, 24.0)


def side_of_pier(device: AlpacaTelescope, call: Call) -> int:
    """The pointing state."""
    side = device.reading.pier_side
    return SIDES[PierSide.UNKNOWN if side is None else side]


async def destination_side(device: AlpacaTelescope, call: Call) -> int:
    """The pointing state after a slew there, as the mount itself says."""
    ra_deg, dec_deg = turned(call.number("RightAscension") * 15.0, 360.0), call.number("Declination")
    place = Icrs(ra_deg, dec_deg) if device.mount.epoch == "icrs" else Apparent(ra_deg, dec_deg, utc_now())
    side = await device.mount.destination_side(place)
    return SIDES[PierSide.UNKNOWN if side is None else side]


def slewing(device: AlpacaTelescope, call: Call) -> bool:
    """Whether it moves. Raises the failure of the last motion, if this client hasn't been reported."""
    if not device.motion.under_way and (failure := device.motion.failed_before(call.client)) is not None:
        raise failure
    return device.is_slewing


def pulse_guiding(device: AlpacaTelescope, call: Call) -> bool:
    """Whether a guide pulse runs or waits, no matter who ordered it."""
    if device.pulses.running:
        return True
    if (failure := device.pulses.failed_before()) is not None:
        raise failure
    job = device.snapshot.job
    return job is not None and job.kind == "guide"


def utc_date(device: AlpacaTelescope, call: Call) -> str:
    """The service's clock: the one that all times are taken from."""
    return iso(utc_now())


def iso(utc: datetime) -> str:
    """As the standard writes instants."""
    return f"{utc.astimezone(UTC):%Y-%m-%dT%H:%M:%S.%f}Z"


def device_state(device: AlpacaTelescope, call: Call) -> list[dict[str, object]]:
    """All that moves, at once; what isn't implemented, or isn't known just now, is left out."""
    states: list[dict[str, object]] = []
    for name, value, able in _STATES:
        if not able(device):
            continue
        try:
            states.append({"Name": name, "Value": value(device, call)})
        except AlpacaError:
            continue
    states.append({"Name": "TimeStamp", "Value": iso(device.snapshot.utc)})
    return states


def _known(device: AlpacaTelescope, value: float | None) -> float:
    if value is None:
        raise AlpacaError(
            0x502, f"{device.id}: not known just now: {device.snapshot.state.problem or 'no answer'}"
        )
    _ = device.reading  # raises if it is too old
    return value


def _alignment(device: AlpacaTelescope, call: Call) -> int:
    mounting = device.mount.mounting
    assert mounting is not None, "only asked where it is known"
    return _ALIGNMENTS[mounting]


def _has_alignment(device: AlpacaTelescope) -> bool:
    return device.mount.mounting is not None


def _is_slewing(device: AlpacaTelescope, call: Call) -> bool:
    return device.is_slewing


def _is_guiding(device: AlpacaTelescope, call: Call) -> bool:
    job = device.snapshot.job
    return device.pulses.running or (job is not None and job.kind == "guide")


def _any(device: AlpacaTelescope) -> bool:
    return True


def _with_sides(skill: Skill) -> Callable[[AlpacaTelescope], bool]:
    """A mount that has sides of a pier, and tells them."""
    return lambda device: device.can(skill) and device.mount.mounting in ("german", None)


_sides = _with_sides(Skill.PIER_SIDE)
_STATES = (
    ("Altitude", altitude_deg, _any),
    ("AtHome", lambda device, call: device.at_home, _any),
    ("AtPark", lambda device, call: device.at_park, _any),
    ("Azimuth", azimuth_deg, _any),
    ("Declination", declination_deg, _any),
    ("IsPulseGuiding", _is_guiding, with_skill(Skill.GUIDE)),
    ("RightAscension", right_ascension_h, _any),
    ("SideOfPier", side_of_pier, _sides),
    ("SiderealTime", sidereal_time_h, _any),
    ("Slewing", _is_slewing, _any),
    ("Tracking", lambda device, call: device.is_tracking, _any),
    ("UTCDate", utc_date, _any),
)

_FLIP = "a flip is checked, and centered again, by the service: POST /v1/telescopes/{id}/flip"
_CLOCK = "the time is the clock's of the service's machine"

READING: tuple[Member, ...] = (
    Member("GET", "devicestate", device_state, default=[]),
    Member("GET", "alignmentmode", _alignment, able=_has_alignment),
    Member("GET", "equatorialsystem", lambda device, call: _SYSTEMS[device.mount.epoch]),
    Member("GET", "rightascension", right_ascension_h, default=0.0),
    Member("GET", "declination", declination_deg, default=0.0),
    Member("GET", "altitude", altitude_deg, default=0.0),
    Member("GET", "azimuth", azimuth_deg, default=0.0),
    Member("GET", "siderealtime", sidereal_time_h, default=0.0),
    Member("GET", "sideofpier", side_of_pier, able=_sides, default=-1),
    Member("PUT", "sideofpier", nothing, takes=(Parameter("SideOfPier", whole),), able=never, why_not=_FLIP),
    Member(
        "GET",
        "destinationsideofpier",
        destination_side,
        takes=(RA, DEC),
        ranges=(RA_RANGE, DEC_RANGE),
        able=_with_sides(Skill.DESTINATION_SIDE),
        default=-1,
    ),
    Member("GET", "slewing", slewing, default=False),
    Member("GET", "athome", lambda device, call: device.at_home, default=False),
    Member("GET", "atpark", lambda device, call: device.at_park, default=False),
    Member("GET", "tracking", lambda device, call: device.is_tracking, default=False),
    Member("GET", "ispulseguiding", pulse_guiding, able=with_skill(Skill.GUIDE), default=False),
    Member("GET", "utcdate", utc_date, default=""),
    Member("PUT", "utcdate", nothing, takes=(Parameter("UTCDate", instant),), able=never, why_not=_CLOCK),
)
