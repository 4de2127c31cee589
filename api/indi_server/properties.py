"""A telescope as INDI properties: one snapshot in, its properties out, by INDI's names and rules.

Pure: asks no device and no clock. What the mount can't do has no property, and what isn't known is off or
Idle, never a guess. CONNECTION and ON_COORD_SET are each client's own: `api.indi_server.connection`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime

from api.indi_server.vectors import Perm, Rule, Vector, number, numbers, switches, texts, timestamp
from api.orders.jobs import Job
from api.orders.vocabulary import LONGEST_PULSE_S
from api.orders.watching import Snapshot, apparent_place
from drivers.indi.codec.messages import State
from mountnav import __version__
from mountnav.devices import STARS_RATES, MountAxis, OffsetRates, PierSide, Skill
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S, Apparent, Site

__all__ = [
    "COORDINATES",
    "MAIN",
    "MOTIONS",
    "PULSES",
    "SPEEDS",
    "Facts",
    "Optics",
    "coordinates_state",
    "driver_info",
    "optics_vector",
    "polling_vector",
    "running",
    "site_vector",
    "time_vector",
    "vectors_of",
]


SITE, OPTIONS = "Site Management", "Options"


@dataclass(frozen=True, slots=True)
class Optics:
    """What a telescope is, as far as the settings say; both needed, or INDI's clients divide by zero."""

    focal_length_mm: float
    aperture_mm: float


def site_vector(site: Site) -> Vector:
    """GEOGRAPHIC_COORD: the site of the settings."""
    return numbers(
        "GEOGRAPHIC_COORD",
        "Scope Location",
        SITE,
        State.OK,
        number("LAT", "Lat (dd:mm:ss)", site.latitude_deg, form="%012.8m", least=-90.0, most=90.0),
        number("LONG", "Lon (dd:mm:ss)", site.longitude_deg % 360.0, form="%012.8m", most=360.0),
        number("ELEV", "Elevation (m)", site.height_m, form="%g", least=-500.0, most=10000.0),
    )


def time_vector(utc: datetime, offset_h: float) -> Vector:
    """TIME_UTC: this machine's clock, and its zone."""
    told = {"UTC": ("UTC Time", timestamp(utc)), "OFFSET": ("UTC Offset", f"{offset_h:.2f}")}
    # Ok: KStars takes the time of a mount that is content with it
    return texts("TIME_UTC", "UTC", SITE, told, State.OK)


def polling_vector(poll_s: float) -> Vector:
    """POLLING_PERIOD: how often the mount is read."""
    return numbers(
        "POLLING_PERIOD",
        "Polling",
        OPTIONS,
        State.OK,
        number("PERIOD_MS", "Period (ms)", 1000.0 * poll_s, form="%.f", least=10.0, most=600_000.0),
    )


def optics_vector(optics: Optics) -> Vector:
    """TELESCOPE_INFO: focal length and aperture; the guider's are said to be the same."""
    focal_length_mm, aperture_mm = optics.focal_length_mm, optics.aperture_mm
    return numbers(
        "TELESCOPE_INFO",
        "Scope Properties",
        OPTIONS,
        State.OK,
        number("TELESCOPE_APERTURE", "Aperture (mm)", aperture_mm, form="%g", most=50_000.0),
        number("TELESCOPE_FOCAL_LENGTH", "Focal Length (mm)", focal_length_mm, form="%g", most=1e6),
        number("GUIDER_APERTURE", "Guider Aperture (mm)", aperture_mm, form="%g", most=50_000.0),
        number("GUIDER_FOCAL_LENGTH", "Guider Focal Length (mm)", focal_length_mm, form="%g", most=1e6),
    )


COORDINATES = "EQUATORIAL_EOD_COORD"
MAIN, GUIDE, INFO = "Main Control", "Guide", "General Info"
_TELESCOPE, _GUIDER = 1, 4
"""Bits of DRIVER_INTERFACE [INDI BaseDevice::DRIVER_INTERFACE]."""
_RATES = {
    "TRACK_SIDEREAL": "Sidereal",
    "TRACK_LUNAR": "Lunar",
    "TRACK_SOLAR": "Solar",
    "TRACK_KING": "King",
}
PULSES = {
    "TELESCOPE_TIMED_GUIDE_NS": {"TIMED_GUIDE_N": "n", "TIMED_GUIDE_S": "s"},
    "TELESCOPE_TIMED_GUIDE_WE": {"TIMED_GUIDE_W": "w", "TIMED_GUIDE_E": "e"},
}
"""Properties of guide pulses: in which direction each element moves the tube."""
_MOST_RATE_ARCSEC_S = 3600.0
"""Largest custom rate that clients are offered where the mount doesn't tell, ″/s: 1 °/s. Doubled, a mistyped
one is refused by the mount alone."""
MOTIONS: dict[str, tuple[MountAxis, dict[str, float]]] = {
    "TELESCOPE_MOTION_NS": ("secondary", {"MOTION_NORTH": 1.0, "MOTION_SOUTH": -1.0}),
    "TELESCOPE_MOTION_WE": ("primary", {"MOTION_WEST": -1.0, "MOTION_EAST": 1.0}),
}
"""Properties of motion keys: which axis each moves, and to which side."""
SPEEDS = {"SLEW_GUIDE": "Guide", "SLEW_CENTERING": "Centering", "SLEW_FIND": "Find", "SLEW_MAX": "Max"}
"""Elements of TELESCOPE_SLEW_RATE, from slow to fast."""
_PARK = {"PARK": "Park(ed)", "UNPARK": "UnPark(ed)"}


@dataclass(frozen=True, slots=True)
class Facts:
    """All that a device's properties are made of.

    Attributes
    ----------
    site : Site
        Of the settings.
    clock_utc : datetime
        What TIME_UTC tells: a moment ago, so that it isn't told twice a second.
    offset_h : float
        Of this machine's zone: local time minus UTC.
    target : Apparent or None
        Where it was last sent by this face.
    rate : str or None
        The tracking rate that was last ordered, by whatever face; None: nobody did.
    offsets : OffsetRates or None
        The rates beside the sidereal one in force; None: none are.
    most_offsets : OffsetRates or None
        The largest that the mount takes; None where it doesn't tell.
    speed : str
        What is chosen of TELESCOPE_SLEW_RATE.
    moved : mapping
        How fast axes are moved by hand, by whatever face, °/s.
    can_move : frozenset
        The axes that can be.
    """

    snapshot: Snapshot
    skills: frozenset[Skill]
    site: Site
    clock_utc: datetime
    offset_h: float
    poll_s: float
    optics: Optics | None = None
    target: Apparent | None = None
    rate: str | None = None
    offsets: OffsetRates | None = None
    most_offsets: OffsetRates | None = None
    speed: str = "SLEW_FIND"
    moved: Mapping[MountAxis, float] = field(default_factory=dict)
    can_move: frozenset[MountAxis] = frozenset()


def driver_info(skills: frozenset[Skill]) -> Vector:
    """DRIVER_INFO: there before anything is connected."""
    interface = _TELESCOPE | (_GUIDER if Skill.GUIDE in skills else 0)
    told = {
        "DRIVER_NAME": ("Name", "mountnav"),
        "DRIVER_EXEC": ("Exec", "mountnav"),
        "DRIVER_VERSION": ("Version", __version__),
        "DRIVER_INTERFACE": ("Interface", str(interface)),
    }
    return texts("DRIVER_INFO", "Driver Info", INFO, told)


def vectors_of(facts: Facts) -> dict[str, Vector]:
    """All properties of a connected device, in the order in which clients show them."""
    found = [*_pointing(facts), *_orders(facts), *_guiding(facts), *_surroundings(facts)]
    return {one.name: one for one in found}


def running(snapshot: Snapshot, *kinds: str) -> Job | None:
    """The job that holds the telescope, if it is of one of these kinds."""
    job = snapshot.job
    return job if job is not None and not job.is_over and job.kind in kinds else None


# -- inside --------------------------------------------------------------------------------------------


def _pointing(facts: Facts) -> list[Vector]:
    snapshot = facts.snapshot
    state = coordinates_state(snapshot)
    place = apparent_place(snapshot)
    found = []
    if place is not None:
        found.append(_places(COORDINATES, "Eq. Coordinates", "rw", state, place))
    if facts.target is not None:
        found.append(_places("TARGET_EOD_COORD", "Slew Target", "ro", State.IDLE, facts.target))
    altitude_deg, azimuth_deg = snapshot.state.altitude_deg, snapshot.state.azimuth_deg
    if place is not None and altitude_deg is not None and azimuth_deg is not None:
        found.append(
            numbers(
                "HORIZONTAL_COORD",
                "Horizontal Coordinates",
                MAIN,
                state,
                number("ALT", "Alt (dd:mm:ss)", altitude_deg, form="%10.6m", least=-90.0, most=90.0),
                number("AZ", "Az (dd:mm:ss)", azimuth_deg, form="%10.6m", most=360.0),
            )
        )
    if Skill.PIER_SIDE in facts.skills:
        reading = snapshot.state.reading
        side = None if reading is None else reading.pier_side
        on = {PierSide.WEST: "PIER_WEST", PierSide.EAST: "PIER_EAST"}.get(side or PierSide.UNKNOWN)
        found.append(
            Vector(
                "TELESCOPE_PIER_SIDE",
                "Pier Side",
                MAIN,
                "Switch",
                "ro",
                State.IDLE if on is None else State.OK,
                switches(on, PIER_WEST="West (pointing east)", PIER_EAST="East (pointing west)"),
                "AtMostOne",
            )
        )
    return found


def coordinates_state(snapshot: Snapshot) -> State:
    """Alert: it can't be read. Busy: it slews. Ok: it follows the sky. Idle: it rests."""
    reading = snapshot.state.reading
    if not snapshot.state.connected or reading is None:
        return State.ALERT
    if snapshot.slewing:
        return State.BUSY
    return State.IDLE if reading.parked or reading.tracking is False else State.OK


def _orders(facts: Facts) -> list[Vector]:
    snapshot, skills = facts.snapshot, facts.skills
    reading = snapshot.state.reading
    found = [
        _switch("TELESCOPE_ABORT_MOTION", "Abort Motion", State.IDLE, None, {"ABORT": "Abort"}, "AtMostOne"),
    ]
    if Skill.PARK in skills:
        found.append(_park(snapshot))
    if Skill.SET_PARK in skills:
        found.append(
            _switch(
                "TELESCOPE_PARK_OPTION",
                "Park Options",
                State.BUSY if running(snapshot, "set-park") else State.IDLE,
                None,
                {"PARK_CURRENT": "Current"},
                "AtMostOne",
            )
        )
    if Skill.HOME in skills:
        state = State.BUSY if running(snapshot, "home") else State.IDLE
        if state is State.IDLE and reading is not None and reading.at_home:
            state = State.OK
        word = {"FIND": "Find"} if Skill.FIND_HOME in skills else {"GO": "Go"}
        on = next(iter(word)) if state is State.BUSY else None
        found.append(_switch("TELESCOPE_HOME", "Home", state, on, word, "AtMostOne"))
    if Skill.TRACK in skills:
        tracking = None if reading is None else reading.tracking
        on = {True: "TRACK_ON", False: "TRACK_OFF"}.get(tracking) if tracking is not None else None
        # as INDI's own mounts have it: tracking is something that goes on
        state = State.BUSY if tracking else State.IDLE
        found.append(
            _switch("TELESCOPE_TRACK_STATE", "Tracking", state, on, {"TRACK_ON": "On", "TRACK_OFF": "Off"})
        )
    custom = Skill.OFFSET_RATES in skills
    if Skill.TRACKING_RATES in skills or custom:
        on = None if facts.rate is None else f"TRACK_{facts.rate.upper()}"
        named = _RATES if Skill.TRACKING_RATES in skills else {"TRACK_SIDEREAL": "Sidereal"}
        if facts.offsets is not None:
            on = "TRACK_CUSTOM"
        modes = {**named, "TRACK_CUSTOM": "Custom"} if custom else named
        found.append(_switch("TELESCOPE_TRACK_MODE", "Track Mode", State.IDLE, on, modes))
    if custom:
        found.append(_track_rate(facts))
    return [*found, *_motions(facts)]


def _track_rate(facts: Facts) -> Vector:
    """TELESCOPE_TRACK_RATE: the whole rates, that of a star included."""
    offsets = facts.offsets or STARS_RATES
    most = facts.most_offsets or OffsetRates(_MOST_RATE_ARCSEC_S, _MOST_RATE_ARCSEC_S)
    star, ra, dec = SIDEREAL_ARCSEC_S, most.ra_arcsec_s, most.dec_arcsec_s
    return numbers(
        "TELESCOPE_TRACK_RATE",
        "Track Rates",
        MAIN,
        State.IDLE if facts.offsets is None else State.BUSY,
        number(
            "TRACK_RATE_RA",
            "RA (arcsecs/s)",
            star - offsets.ra_arcsec_s,
            form="%.6f",
            least=star - ra,
            most=star + ra,
        ),
        number("TRACK_RATE_DE", "DE (arcsecs/s)", offsets.dec_arcsec_s, form="%.6f", least=-dec, most=dec),
        perm="rw",
    )


def _motions(facts: Facts) -> list[Vector]:
    """Keys, and how fast they move."""
    found = []
    for name, (axis, sides) in MOTIONS.items():
        if axis not in facts.can_move:
            continue
        rate = facts.moved.get(axis, 0.0)
        on = next((element for element, side in sides.items() if side * rate > 0.0), None)
        state = State.IDLE if on is None else State.BUSY
        labels = {element: element.removeprefix("MOTION_").capitalize() for element in sides}
        found.append(_switch(name, f"Motion {name[-2]}/{name[-1]}", state, on, labels, "AtMostOne"))
    if found:
        found.append(_switch("TELESCOPE_SLEW_RATE", "Slew Rate", State.OK, facts.speed, SPEEDS))
    return found


def _park(snapshot: Snapshot) -> Vector:
    reading = snapshot.state.reading
    parked = None if reading is None else reading.parked
    going, leaving = running(snapshot, "park"), running(snapshot, "unpark")
    if going is not None or leaving is not None:
        on, state = "PARK" if going is not None else "UNPARK", State.BUSY
    else:
        on, state = ("PARK", State.OK) if parked else ("UNPARK", State.IDLE)
    unknown = parked is None and state is not State.BUSY
    return _switch("TELESCOPE_PARK", "Parking", state, None if unknown else on, _PARK)


def _guiding(facts: Facts) -> list[Vector]:
    if Skill.GUIDE not in facts.skills:
        return []
    job = running(facts.snapshot, "guide")
    found = []
    for name, elements in PULSES.items():
        busy = job is not None and job.request.get("direction") in elements.values()
        found.append(
            numbers(
                name,
                f"Guide {name[-2]}/{name[-1]}",
                GUIDE,
                State.BUSY if busy else State.IDLE,
                *(
                    number(element, f"{element[-1]} (ms)", 0.0, form="%.0f", most=1000.0 * LONGEST_PULSE_S)
                    for element in elements
                ),
                perm="rw",
            )
        )
    return found


def _surroundings(facts: Facts) -> list[Vector]:
    found = [
        site_vector(facts.site),
        time_vector(facts.clock_utc, facts.offset_h),
        polling_vector(facts.poll_s),
    ]
    if facts.optics is not None:
        found.append(optics_vector(facts.optics))
    return found


def _places(name: str, label: str, perm: Perm, state: State, place: Apparent) -> Vector:
    return numbers(
        name,
        label,
        MAIN,
        state,
        number("RA", "RA (hh:mm:ss)", place.ra_deg / 15.0, form="%010.6m", most=24.0),
        number("DEC", "DEC (dd:mm:ss)", place.dec_deg, form="%010.6m", least=-90.0, most=90.0),
        perm=perm,
    )


def _switch(
    name: str, label: str, state: State, on: str | None, labels: dict[str, str], rule: Rule = "OneOfMany"
) -> Vector:
    return Vector(name, label, MAIN, "Switch", "rw", state, switches(on, **labels), rule)
