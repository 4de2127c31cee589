"""Members that slew, sync and stop: refused as far as is known before, then ordered [Alpaca §5]."""

from __future__ import annotations

from api.alpaca.codec import turned
from api.alpaca.errors import invalid_operation, not_set, parked
from api.alpaca.member import (
    ALT,
    ALT_RANGE,
    AZ,
    AZ_RANGE,
    DEC,
    DEC_RANGE,
    RA,
    RA_RANGE,
    Member,
    Parameter,
    Range,
    decimal,
    never,
    nothing,
    whole,
    with_skill,
)
from api.alpaca.telescope import AlpacaTelescope, Call, Targets
from api.orders.execute_order import there
from api.orders.targets import AltAzTarget, ApparentTarget, IcrsTarget
from api.orders.vocabulary import SlewOrder, SyncToOrder
from mountnav.devices import Skill
from mountnav.navigation.navigator import Navigator

LONGEST_SETTLE_S = 300
"""Largest SlewSettleTime, s; chosen by hand, far beyond what mounts need. Doubled, a mistyped one keeps
Slewing true for ten minutes."""


def _place(device: AlpacaTelescope, ra_h: float, dec_deg: float) -> ApparentTarget | IcrsTarget:
    """A place in the mount's own system, which is the one that EquatorialSystem tells."""
    ra_deg = turned(ra_h * 15.0, 360.0)
    if device.mount.epoch == "icrs":
        return IcrsTarget(ra_deg=ra_deg, dec_deg=dec_deg)
    return ApparentTarget(ra_deg=ra_deg, dec_deg=dec_deg)


def _target(device: AlpacaTelescope) -> tuple[float, float]:
    targets = device.targets
    if targets.ra_h is None:
        raise not_set("TargetRightAscension")
    if targets.dec_deg is None:
        raise not_set("TargetDeclination")
    return targets.ra_h, targets.dec_deg


def _require_tracking(device: AlpacaTelescope, what: str) -> None:
    if not device.is_tracking:
        raise invalid_operation(f"{what} needs Tracking True: the mount isn't tracking")


async def _slew(device: AlpacaTelescope, call: Call, ra_h: float, dec_deg: float) -> None:
    """Begin a slew; one that this client has under way makes room for it, its way to park or home doesn't."""
    mine = device.motion.slews_for(call.client)
    if not mine:
        # a mount on its way may well say that it doesn't track
        _require_tracking(device, "a slew to right ascension and declination")
    place = _place(device, ra_h, dec_deg)
    await device.check(call, place, supersede=mine)
    device.targets = Targets(ra_h, dec_deg, call.client)
    await device.motion.begin(call.caller, call.client, SlewOrder(target=place), supersede=mine)


async def _slew_to_coordinates(device: AlpacaTelescope, call: Call) -> None:
    await _slew(device, call, call.number("RightAscension"), call.number("Declination"))


async def _slew_to_coordinates_and_wait(device: AlpacaTelescope, call: Call) -> None:
    await _slew_to_coordinates(device, call)
    await device.motion.ended()


async def _slew_to_target(device: AlpacaTelescope, call: Call) -> None:
    ra_h, dec_deg = _target(device)
    _require_unparked(device, "a slew")
    await _slew(device, call, ra_h, dec_deg)


async def _slew_to_target_and_wait(device: AlpacaTelescope, call: Call) -> None:
    await _slew_to_target(device, call)
    await device.motion.ended()


async def _slew_to_alt_az(device: AlpacaTelescope, call: Call) -> None:
    """Go there and rest. The way is checked as any other; tracking ends when it has arrived."""
    if device.is_tracking:
        raise invalid_operation("a slew to altitude and azimuth needs Tracking False")
    place = AltAzTarget(alt_deg=call.number("Altitude"), az_deg=turned(call.number("Azimuth"), 360.0))
    await device.check(call, place)

    async def work(navigator: Navigator) -> object:
        # some mounts slew only while they track, and those that do track when they have arrived
        await navigator.set_tracking(True)
        try:
            await navigator.slew(there(navigator, place))
            # the sky has turned meanwhile: a second, short slew makes up for it
            return await navigator.slew(there(navigator, place))
        finally:
            await navigator.set_tracking(False)

    await device.motion.begin(call.caller, call.client, SlewOrder(target=place), work=work)


async def _slew_to_alt_az_and_wait(device: AlpacaTelescope, call: Call) -> None:
    await _slew_to_alt_az(device, call)
    await device.motion.ended()


async def _sync(device: AlpacaTelescope, call: Call, ra_h: float, dec_deg: float) -> None:
    """Tell the mount where it points, within the bounds of told syncs; it is read anew before the answer."""
    _require_tracking(device, "a sync")
    device.targets = Targets(ra_h, dec_deg, call.client)
    await device.carry_out(call, SyncToOrder(target=_place(device, ra_h, dec_deg)))


async def _sync_to_coordinates(device: AlpacaTelescope, call: Call) -> None:
    await _sync(device, call, call.number("RightAscension"), call.number("Declination"))


async def _sync_to_target(device: AlpacaTelescope, call: Call) -> None:
    ra_h, dec_deg = _target(device)
    _require_unparked(device, "a sync")
    await _sync(device, call, ra_h, dec_deg)


def _require_unparked(device: AlpacaTelescope, what: str) -> None:
    """For members whose value has to be looked at first: range rules come before parked."""
    if device.is_parked:
        raise parked(what)


async def _abort(device: AlpacaTelescope, call: Call) -> None:
    """Stop, whoever ordered what; only a telescope that is parked and stands still has nothing to stop.

    It is tried even while the mount gives no answers: that may be when it is needed most.
    """
    device.require_client(call.client)
    if device.is_known and not device.is_slewing and device.is_parked:
        raise parked("AbortSlew")
    device.pulses.aborting()
    await device.motion.abort(call.caller)


def _target_ra(device: AlpacaTelescope, call: Call) -> float:
    if device.targets.ra_h is None:
        raise not_set("TargetRightAscension")
    return device.targets.ra_h


def _target_dec(device: AlpacaTelescope, call: Call) -> float:
    if device.targets.dec_deg is None:
        raise not_set("TargetDeclination")
    return device.targets.dec_deg


def _set_target_ra(device: AlpacaTelescope, call: Call) -> None:
    device.targets.ra_h, device.targets.by = call.number("TargetRightAscension"), call.client


def _set_target_dec(device: AlpacaTelescope, call: Call) -> None:
    device.targets.dec_deg, device.targets.by = call.number("TargetDeclination"), call.client


def _settle(device: AlpacaTelescope, call: Call) -> int:
    return device.motion.settle_s


def _set_settle(device: AlpacaTelescope, call: Call) -> None:
    device.motion.settle_s = int(call.number("SlewSettleTime"))


_PLACE = (RA, DEC)
_PLACE_RANGES = (RA_RANGE, DEC_RANGE)
_DIRECTION = (AZ, ALT)
_DIRECTION_RANGES = (AZ_RANGE, ALT_RANGE)
_SKY = "a sync is one on a place of the sky: use SyncToCoordinates"
can_slew_alt_az = with_skill(Skill.TRACK)

MEMBERS: tuple[Member, ...] = (
    Member(
        "PUT",
        "slewtocoordinates",
        _slew_to_coordinates_and_wait,
        _PLACE,
        ranges=_PLACE_RANGES,
        parked=False,
        orders="slew",
    ),
    Member(
        "PUT",
        "slewtocoordinatesasync",
        _slew_to_coordinates,
        _PLACE,
        ranges=_PLACE_RANGES,
        parked=False,
        orders="slew",
    ),
    Member("PUT", "slewtotarget", _slew_to_target_and_wait, orders="slew"),
    Member("PUT", "slewtotargetasync", _slew_to_target, orders="slew"),
    Member(
        "PUT",
        "slewtoaltaz",
        _slew_to_alt_az_and_wait,
        _DIRECTION,
        can_slew_alt_az,
        _DIRECTION_RANGES,
        parked=False,
        orders="slew",
    ),
    Member(
        "PUT",
        "slewtoaltazasync",
        _slew_to_alt_az,
        _DIRECTION,
        can_slew_alt_az,
        _DIRECTION_RANGES,
        parked=False,
        orders="slew",
    ),
    Member(
        "PUT",
        "synctocoordinates",
        _sync_to_coordinates,
        _PLACE,
        ranges=_PLACE_RANGES,
        parked=False,
        orders="sync-to",
    ),
    Member("PUT", "synctotarget", _sync_to_target, orders="sync-to"),
    Member("PUT", "synctoaltaz", nothing, _DIRECTION, never, why_not=_SKY),
    Member("PUT", "abortslew", _abort, offline=True, orders="stop"),
    Member("GET", "targetrightascension", _target_ra, default=0.0),
    Member(
        "PUT",
        "targetrightascension",
        _set_target_ra,
        (Parameter("TargetRightAscension", decimal),),
        ranges=(Range("TargetRightAscension", 0.0, 24.0, below=True),),
    ),
    Member("GET", "targetdeclination", _target_dec, default=0.0),
    Member(
        "PUT",
        "targetdeclination",
        _set_target_dec,
        (Parameter("TargetDeclination", decimal),),
        ranges=(Range("TargetDeclination", -90.0, 90.0),),
    ),
    Member("GET", "slewsettletime", _settle),
    Member(
        "PUT",
        "slewsettletime",
        _set_settle,
        (Parameter("SlewSettleTime", whole),),
        ranges=(Range("SlewSettleTime", 0, LONGEST_SETTLE_S),),
    ),
)

__all__ = ["LONGEST_SETTLE_S", "MEMBERS", "can_slew_alt_az"]
