"""Members that move: tracking, guiding, parking, slewing, syncs and stops, and abilities [Alpaca §5].

Parking and homing are begun at once, and watched by AtPark, AtHome and Slewing. Slews and syncs are refused
as far as is known before, then ordered. MoveAxis and offsets of the tracking rate have an end of their own,
since a client that dies says nothing more: `api.orders.kept_motions`. What the telescope can follows from
the mount's skills.
"""

from __future__ import annotations

from collections.abc import Callable

from api.alpaca.codec import turned
from api.alpaca.errors import (
    error_of,
    invalid_operation,
    invalid_value,
    not_implemented,
    not_set,
    parked,
)
from api.alpaca.member import (
    ALT,
    ALT_RANGE,
    AXIS,
    AXIS_RANGE,
    AZ,
    AZ_RANGE,
    DEC,
    DEC_RANGE,
    RA,
    RA_RANGE,
    Member,
    Parameter,
    Range,
    always,
    decimal,
    never,
    nothing,
    truth,
    whole,
    with_skill,
)
from api.alpaca.motion import DIRECTIONS
from api.alpaca.telescope import AlpacaTelescope, Call, Targets
from api.orders.execute_order import there
from api.orders.goto_orders import NotTaken as OrderNotTaken
from api.orders.targets import AltAzTarget, ApparentTarget, IcrsTarget
from api.orders.vocabulary import (
    LONGEST_PULSE_S,
    GuideOrder,
    HomeOrder,
    ParkOrder,
    RateWord,
    SetParkOrder,
    SlewOrder,
    SyncToOrder,
    TrackingOrder,
    UnparkOrder,
)
from mountnav.devices import STARS_RATES, MountAxis, OffsetRates, RateSpan, Skill, TrackingRate
from mountnav.navigation.navigator import Navigator
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S

__all__ = [
    "ABILITIES",
    "LONGEST_SETTLE_S",
    "PARKING",
    "RATES",
    "SLEWING",
    "TRACKING",
    "can_slew_alt_az",
    "can_unpark",
    "rate_of",
    "rates_of",
]


RATES = (TrackingRate.SIDEREAL, TrackingRate.LUNAR, TrackingRate.SOLAR, TrackingRate.KING)
"""As Alpaca counts them: 0 to 3."""


def rates_of(device: AlpacaTelescope) -> tuple[TrackingRate, ...]:
    """The rates that the mount takes, in Alpaca's order; sidereal alone where it has no choice."""
    if not device.can(Skill.TRACKING_RATES):
        return (TrackingRate.SIDEREAL,)
    told = device.mount.tracking_rates
    known = told if isinstance(told, frozenset) else _UNKNOWN
    return tuple(rate for rate in RATES if rate is TrackingRate.SIDEREAL or rate in known)


def rate_of(device: AlpacaTelescope) -> TrackingRate:
    """The rate in force: as last ordered, by whatever face; else as asked for here; else sidereal."""
    ordered = device.mount.tracking_rate if device.is_tracking else None
    found = ordered or device.rate or TrackingRate.SIDEREAL
    return found if found in RATES else TrackingRate.SIDEREAL


_WORDS: dict[TrackingRate, RateWord] = {
    TrackingRate.SIDEREAL: "sidereal",
    TrackingRate.LUNAR: "lunar",
    TrackingRate.SOLAR: "solar",
    TrackingRate.KING: "king",
}
_UNKNOWN = frozenset({TrackingRate.LUNAR, TrackingRate.SOLAR})
"""Taken to be there on a mount that has rates and doesn't tell which."""


async def _set_tracking(device: AlpacaTelescope, call: Call) -> None:
    on = call.flag("Tracking")
    if device.is_parked:
        if on:
            raise parked("Tracking True")
        return
    if device.is_slewing and on and device.reading.tracking:
        return  # it does, and will when it is there
    await device.carry_out(call, TrackingOrder(on=on, rate=_WORDS[device.rate or rate_of(device)]))


async def _set_rate(device: AlpacaTelescope, call: Call) -> None:
    number = int(call.number("TrackingRate"))
    known = rates_of(device)
    if not 0 <= number < len(RATES) or RATES[number] not in known:
        can = ", ".join(f"{RATES.index(rate)} ({rate})" for rate in known)
        raise invalid_value("TrackingRate", number, f"this mount can {can}")
    rate = RATES[number]
    if rate is not TrackingRate.SIDEREAL:
        try:
            await _end_offsets(device, call)
        except OrderNotTaken as refusal:
            raise error_of(refusal.problem) from None
    if device.can(Skill.TRACKING_RATES) and device.is_tracking and not device.is_parked:
        await device.carry_out(call, TrackingOrder(on=True, rate=_WORDS[rate]))
    device.rate = rate


def _guide_rates_deg_s(device: AlpacaTelescope) -> tuple[float, float] | None:
    """How fast a pulse moves in right ascension and in declination, where the mount tells."""
    match device.mount.guide_rates_deg_s:
        case (float(ra_deg_s), float(dec_deg_s)):
            return ra_deg_s, dec_deg_s
    return None


def _tells_guide_rates(device: AlpacaTelescope) -> bool:
    return device.can(Skill.GUIDE) and _guide_rates_deg_s(device) is not None


def _guide_rate_ra(device: AlpacaTelescope, call: Call) -> float:
    return (_guide_rates_deg_s(device) or (0.0, 0.0))[0]


def _guide_rate_dec(device: AlpacaTelescope, call: Call) -> float:
    return (_guide_rates_deg_s(device) or (0.0, 0.0))[1]


async def _guide(device: AlpacaTelescope, call: Call) -> None:
    if device.is_slewing:
        raise invalid_operation("no guide pulse while the telescope slews")
    duration_ms = call.number("Duration")
    if duration_ms == 0:
        return
    direction = DIRECTIONS[int(call.number("Direction"))]
    order = GuideOrder(direction=direction, duration_s=duration_ms / 1000.0)
    await device.pulses.guide(call.caller, order, stops_given=call.stops_given)


_GUIDE_RATES = {"GuideRateRightAscension": _guide_rate_ra, "GuideRateDeclination": _guide_rate_dec}
_UNTOLD = "the mount doesn't give it"
_AT_THE_MOUNT = "it is set at the mount"


def offsets_of(device: AlpacaTelescope) -> OffsetRates:
    """The offsets in force, by whatever face; none where the rate isn't sidereal [Alpaca §5]."""
    force = device.mount.offset_rates_in_force
    return STARS_RATES if force is None or rate_of(device) is not TrackingRate.SIDEREAL else force.rates


def _ra_rate(device: AlpacaTelescope, call: Call) -> float:
    return offsets_of(device).ra_arcsec_s / SIDEREAL_ARCSEC_S


def _dec_rate(device: AlpacaTelescope, call: Call) -> float:
    return offsets_of(device).dec_arcsec_s


async def _set_ra_rate(device: AlpacaTelescope, call: Call) -> None:
    wanted = OffsetRates(
        call.number("RightAscensionRate") * SIDEREAL_ARCSEC_S, offsets_of(device).dec_arcsec_s
    )
    await _set_offsets(device, call, "RightAscensionRate", wanted, abs(wanted.ra_arcsec_s))


async def _set_dec_rate(device: AlpacaTelescope, call: Call) -> None:
    wanted = OffsetRates(offsets_of(device).ra_arcsec_s, call.number("DeclinationRate"))
    await _set_offsets(device, call, "DeclinationRate", wanted, abs(wanted.dec_arcsec_s))


async def _set_offsets(
    device: AlpacaTelescope, call: Call, name: str, wanted: OffsetRates, size_arcsec_s: float
) -> None:
    """Order offsets; with an end, put off as long as the client goes on talking."""
    most = device.mount.most_offset_arcsec_s
    if most is not None:
        of_ra = name == "RightAscensionRate"
        bound_arcsec_s = most.ra_arcsec_s if of_ra else most.dec_arcsec_s
        if size_arcsec_s > bound_arcsec_s * _ROUNDED:
            bound = bound_arcsec_s / SIDEREAL_ARCSEC_S if of_ra else bound_arcsec_s
            raise invalid_value(name, call.number(name), f"this mount takes {-bound:g} to {bound:g}")
    if wanted == offsets_of(device) and wanted.none:
        return
    if size_arcsec_s > 0.0 and rate_of(device) is not TrackingRate.SIDEREAL:
        raise invalid_operation(f"{name} is an offset of the sidereal rate: set TrackingRate 0 before")
    if size_arcsec_s > 0.0:
        _require_tracking(device, name)
    if device.is_slewing:
        raise invalid_operation(f"{name} can't be set while the telescope moves")
    try:
        await device.offsets.set(
            call.caller,
            wanted,
            lambda: device.silent_s(call.client),
            stops_given=call.stops_given,
        )
    except OrderNotTaken as refusal:
        raise error_of(refusal.problem) from None


_ROUNDED = 1.0 + 1e-9
"""A rate this little above the largest is the largest, rounded on its way."""


async def _end_offsets(device: AlpacaTelescope, call: Call) -> None:
    if not offsets_of(device).none:
        await device.offsets.set(call.caller, STARS_RATES, lambda: None)


TRACKING: tuple[Member, ...] = (
    Member(
        "PUT",
        "tracking",
        _set_tracking,
        (Parameter("Tracking", truth),),
        with_skill(Skill.TRACK),
        orders="tracking",
    ),
    Member(
        "GET",
        "trackingrates",
        lambda device, call: [RATES.index(rate) for rate in rates_of(device)],
        default=[],
    ),
    Member("GET", "trackingrate", lambda device, call: RATES.index(rate_of(device))),
    Member("PUT", "trackingrate", _set_rate, (Parameter("TrackingRate", whole),), orders="tracking"),
    Member("GET", "rightascensionrate", _ra_rate, default=0.0),
    Member(
        "PUT",
        "rightascensionrate",
        _set_ra_rate,
        (Parameter("RightAscensionRate", decimal),),
        with_skill(Skill.OFFSET_RATES),
        parked=False,
        orders="offset-rates",
    ),
    Member("GET", "declinationrate", _dec_rate, default=0.0),
    Member(
        "PUT",
        "declinationrate",
        _set_dec_rate,
        (Parameter("DeclinationRate", decimal),),
        with_skill(Skill.OFFSET_RATES),
        parked=False,
        orders="offset-rates",
    ),
    Member(
        "PUT",
        "pulseguide",
        _guide,
        (Parameter("Direction", whole), Parameter("Duration", whole)),
        with_skill(Skill.GUIDE),
        (Range("Direction", 0, 3), Range("Duration", 0, 1000 * LONGEST_PULSE_S)),
        parked=False,
        orders="guide",
    ),
    *(
        Member("GET", name.lower(), rate, able=_tells_guide_rates, default=0.0, why_not=_UNTOLD)
        for name, rate in _GUIDE_RATES.items()
    ),
    *(
        Member("PUT", name.lower(), nothing, (Parameter(name, decimal),), never, why_not=_AT_THE_MOUNT)
        for name in _GUIDE_RATES
    ),
)


_AT_ONCE_S = 0.5
"""So long an unpark is waited for: most mounts have it done by then, and a client sees it at once."""


def _runs(device: AlpacaTelescope, kind: str) -> bool:
    """Whether this is just what is done, no matter who ordered it."""
    job = device.snapshot.job
    return job is not None and job.kind == kind


async def _park(device: AlpacaTelescope, call: Call) -> None:
    """Twice is harmless, no matter who began it. What this client has under way makes room."""
    if (device.is_parked and not device.is_slewing) or _runs(device, "park"):
        return

    def arrived() -> None:
        device.stations.remember("park", device.snapshot)

    await device.motion.begin(
        call.caller, call.client, ParkOrder(), stops_given=call.stops_given, supersede=True, arrived=arrived
    )


async def _unpark(device: AlpacaTelescope, call: Call) -> None:
    """Once more is harmless; so is one that isn't needed."""
    await device.motion.stopped()
    if _runs(device, "unpark") or (not device.is_parked and not _runs(device, "park")):
        return

    def arrived() -> None:
        device.stations.forget("park")

    await device.motion.begin(
        call.caller, call.client, UnparkOrder(), stops_given=call.stops_given, arrived=arrived
    )
    await device.motion.wait(_AT_ONCE_S)
    if not device.motion.under_way:
        await device.motion.ended()


async def _find_home(device: AlpacaTelescope, call: Call) -> None:
    def arrived() -> None:
        device.stations.remember("home", device.snapshot)

    await device.motion.begin(
        call.caller, call.client, HomeOrder(), stops_given=call.stops_given, arrived=arrived
    )


async def _set_park(device: AlpacaTelescope, call: Call) -> None:
    await device.carry_out(call, SetParkOrder())


can_unpark = with_skill(Skill.PARK, Skill.UNPARK)

PARKING: tuple[Member, ...] = (
    Member("PUT", "park", _park, able=with_skill(Skill.PARK), orders="park"),
    Member("PUT", "unpark", _unpark, able=can_unpark, orders="unpark"),
    Member("PUT", "findhome", _find_home, able=with_skill(Skill.HOME), parked=False, orders="home"),
    Member("PUT", "setpark", _set_park, able=with_skill(Skill.SET_PARK), orders="set-park"),
)


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
    if device.axes.rates_deg_s:
        raise invalid_operation(
            "an axis is moved by MoveAxis: set its rate to 0, or AbortSlew, before a slew"
        )
    mine = device.motion.slews_for(call.client)
    if not mine:
        # a mount on its way may well say that it doesn't track
        _require_tracking(device, "a slew to right ascension and declination")
    place = _place(device, ra_h, dec_deg)
    await device.check(call, place, supersede=mine)
    device.targets = Targets(ra_h, dec_deg, call.client)
    await device.motion.begin(
        call.caller, call.client, SlewOrder(target=place), stops_given=call.stops_given, supersede=mine
    )


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
    if device.axes.rates_deg_s:
        raise invalid_operation(
            "an axis is moved by MoveAxis: set its rate to 0, or AbortSlew, before a slew"
        )
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

    await device.motion.begin(
        call.caller, call.client, SlewOrder(target=place), stops_given=call.stops_given, work=work
    )


async def _slew_to_alt_az_and_wait(device: AlpacaTelescope, call: Call) -> None:
    await _slew_to_alt_az(device, call)
    await device.motion.ended()


async def _sync(device: AlpacaTelescope, call: Call, ra_h: float, dec_deg: float) -> None:
    """Sync the mount within a planetarium's bounds; it is read again before the answer."""
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
    """Stop, no matter who ordered what; only a telescope that is parked and stands still has nothing to stop.

    It is tried even while the mount gives no answers: that may be when it is needed most.
    """
    device.require_client(call.client)
    if device.is_known and not device.is_slewing and device.is_parked:
        raise parked("AbortSlew")
    device.pulses.aborting()
    device.axes.forget()
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

SLEWING: tuple[Member, ...] = (
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


AXES: tuple[MountAxis | None, ...] = ("primary", "secondary", None)
"""As Alpaca counts them; the third, of a third mirror or a field, no mount here has."""


def axis_spans(device: AlpacaTelescope, number: int) -> tuple[RateSpan, ...]:
    """At which speeds an axis can be moved, within `[telescope.following]`; none if it can't."""
    axis = AXES[number]
    if axis is None or not device.can(Skill.MOVE_AXIS):
        return ()
    most_deg_s = device.mount.following_policy.most_axis_deg_s
    return tuple(
        RateSpan(span.least_deg_s, min(span.most_deg_s, most_deg_s))
        for span in device.mount.axis_rates_deg_s.get(axis, ())
        if span.least_deg_s <= most_deg_s
    )


def _axis_number(call: Call) -> int:
    return int(call.number("Axis"))


def _can_move_axis(device: AlpacaTelescope, call: Call) -> bool:
    return bool(axis_spans(device, _axis_number(call)))


def _axis_rates(device: AlpacaTelescope, call: Call) -> list[dict[str, float]]:
    return [
        {"Minimum": span.least_deg_s, "Maximum": span.most_deg_s}
        for span in axis_spans(device, _axis_number(call))
    ]


async def _move_axis(device: AlpacaTelescope, call: Call) -> None:
    """Move an axis on, for as long as the client is heard and no longer than the settings have it; 0 ends it.

    What ended it by itself is told as the failure of a motion: by the next reading of Slewing.
    """
    number, rate_deg_s = _axis_number(call), call.number("Rate")
    axis, spans = AXES[number], axis_spans(device, number)
    if axis is None or not spans:
        raise not_implemented(f"MoveAxis of axis {number}", "this mount can't move it")
    speed_deg_s = abs(rate_deg_s)
    if speed_deg_s > 0.0 and not any(
        span.least_deg_s <= speed_deg_s * _ROUNDED and speed_deg_s <= span.most_deg_s * _ROUNDED
        for span in spans
    ):
        can = ", ".join(f"{span.least_deg_s:g} to {span.most_deg_s:g}" for span in spans)
        raise invalid_value("Rate", rate_deg_s, f"AxisRates of axis {number} are {can} deg/s")
    _require_unparked(device, "MoveAxis")
    try:
        if speed_deg_s == 0.0:
            await device.axes.end(call.caller, axis)
            await device.watch.refresh()
            return
        await device.motion.stopped()
        if device.motion.under_way:
            raise invalid_operation("a slew is under way: wait for Slewing False, or AbortSlew")
        device.motion.begin_by_hand()
        await device.axes.move(
            call.caller,
            axis,
            rate_deg_s,
            lambda: device.why_silent(call.client),
            stops_given=call.stops_given,
        )
    except OrderNotTaken as refusal:
        raise error_of(refusal.problem) from None


_CAN: dict[str, Callable[[AlpacaTelescope], bool]] = {
    "canfindhome": with_skill(Skill.HOME),
    "canpark": with_skill(Skill.PARK),
    "canpulseguide": with_skill(Skill.GUIDE),
    "cansetdeclinationrate": with_skill(Skill.OFFSET_RATES),
    "cansetguiderates": never,
    "cansetpark": with_skill(Skill.SET_PARK),
    "cansetpierside": never,
    "cansetrightascensionrate": with_skill(Skill.OFFSET_RATES),
    "cansettracking": with_skill(Skill.TRACK),
    "canslew": always,
    "canslewasync": always,
    "canslewaltaz": can_slew_alt_az,
    "canslewaltazasync": can_slew_alt_az,
    "cansync": always,
    "cansyncaltaz": never,
    "canunpark": can_unpark,
}


def _can(able: Callable[[AlpacaTelescope], bool]) -> Callable[[AlpacaTelescope, Call], object]:
    return lambda device, call: able(device)


ABILITIES: tuple[Member, ...] = (
    *(Member("GET", name, _can(able), default=False) for name, able in _CAN.items()),
    Member("GET", "canmoveaxis", _can_move_axis, (AXIS,), ranges=(AXIS_RANGE,), default=False),
    Member("GET", "axisrates", _axis_rates, (AXIS,), ranges=(AXIS_RANGE,), default=[]),
    Member(
        "PUT",
        "moveaxis",
        _move_axis,
        (AXIS, Parameter("Rate", decimal)),
        with_skill(Skill.MOVE_AXIS),
        (AXIS_RANGE,),
        orders="move-axis",
    ),
)
