"""The other end of a hand control's cable, over the mechanics of a telescope that points wrong.

It answers as the hand control of an AVX did in the recorded dialogues: every order with ``#``, carried out or
not, an absent board with silence. A SynScan differs in how it reports its version, in its tracking modes, in
what it passes on to its motors, and in speaking J2000. It does no I/O: `drivers.fakes.bench` puts it on a
wire.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from datetime import UTC, datetime, timedelta

from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from drivers.family import Fakes
from drivers.nexstar.codec.dialect import STARSENSE, Handset, Tracking, Version
from drivers.nexstar.codec.passthrough import (
    LUNAR,
    SIDEREAL,
    SOLAR,
    Axis,
    Order,
    PassThrough,
    is_tracking_rate,
    pass_through_from_bytes,
)
from drivers.nexstar.codec.replies import pair_from_text, pair_to_text
from drivers.nexstar.codec.site_and_time import (
    WireSite,
    WireTime,
    fine_time_from_bytes,
    site_from_bytes,
    site_to_bytes,
    time_from_bytes,
    time_to_bytes,
)
from drivers.wire.command import Unreadable
from mountnav.clock import utc_now
from mountnav.devices import Epoch, PierSide, TrackingRate
from mountnav.simulation.machine import AxisAngles, Machine
from mountnav.simulation.mechanics import Direction, Mechanics
from mountnav.simulation.posture import axes_at, turned_near
from mountnav.sky.chain import (
    apparent_to_icrs,
    hour_angle_to_icrs,
    hour_angle_to_observed,
    icrs_to_apparent,
    icrs_to_hour_angle,
    observed_to_hour_angle,
)
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Apparent, HourAngle, Icrs, Observed, Site
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

_NO_AIR = Air(pressure_hpa=0.0)
"""The hand control's altitude knows no refraction."""


def believed_horizon(mechanics: Mechanics) -> tuple[float, float]:
    """Return azimuth and altitude (deg) of where it believes to look."""
    angles = _hour_angle(mechanics, mechanics.reported())
    seen = hour_angle_to_observed(angles, mechanics.believed_site)
    return seen.az_deg, seen.alt_deg


def point_at_horizon(mechanics: Mechanics, az_deg: float, alt_deg: float) -> None:
    """Turn both axes until it believes to look there; it tracks afterwards if it did before."""
    site, now, tracking = mechanics.believed_site, mechanics.reported(), mechanics.tracking
    shown = mechanics.believed_utc(now.utc)
    angles = observed_to_hour_angle(Observed(az_deg, alt_deg, shown), site)
    target = icrs_to_apparent(hour_angle_to_icrs(angles, site, _NO_AIR), shown)
    side = mechanics.destination_side(replace(target, utc=now.utc))
    wanted = axes_at(angles.ha_deg, angles.dec_deg, mechanics.machine, side, site.latitude_deg)
    encoders = mechanics.axis_angle("ha", now.utc), mechanics.axis_angle("dec", now.utc)
    off = _belief_beyond_encoders(mechanics, now, encoders)
    aim = turned_near((wanted[0] - off[0], wanted[1] - off[1]), encoders, mechanics.machine, off[0])
    mechanics.drive_to("ha", aim[0])
    mechanics.drive_to("dec", aim[1])
    mechanics.tracking = tracking


def _hour_angle(mechanics: Mechanics, place: Apparent) -> HourAngle:
    """Hour angle that it makes of a place, by its own clock and site."""
    shown = mechanics.believed_utc(place.utc)
    icrs = apparent_to_icrs(replace(place, utc=shown))
    return icrs_to_hour_angle(icrs, shown, mechanics.believed_site, _NO_AIR)


def _belief_beyond_encoders(mechanics: Mechanics, now: Apparent, encoders: AxisAngles) -> AxisAngles:
    """What syncs have added to the encoders' angles."""
    angles, side = _hour_angle(mechanics, now), mechanics.pier_side(now.utc)
    latitude_deg = mechanics.believed_site.latitude_deg
    believed = axes_at(angles.ha_deg, angles.dec_deg, mechanics.machine, side, latitude_deg)
    return half_turn_deg(believed[0] - encoders[0]), half_turn_deg(believed[1] - encoders[1])


_GUIDE_RATE = 0x80
"""Half the sidereal rate, in 256ths [NexStar P 0x47]: what a fake guides at until it is set otherwise."""
_RATES = {SIDEREAL: TrackingRate.SIDEREAL, SOLAR: TrackingRate.SOLAR, LUNAR: TrackingRate.LUNAR}
# of the nine keys of the hand control; where a mount is slower, its own limit holds
_FIXED_RATES_DEG_S = (
    0.0,
    *(SIDEREAL_DEG_S * times for times in (2.0, 4.0, 8.0, 16.0, 32.0)),
    0.3,
    1.0,
    2.0,
    4.0,
)
_KEYS_ONLY = (Order.MOVE_UP, Order.MOVE_DOWN, Order.RATE_UP, Order.RATE_DOWN)
_OTHER_WAY: dict[Direction, Direction] = {"n": "s", "s": "n", "e": "w", "w": "e"}


class FakeMotors:
    """Two motor boards, right ascension and declination; no focuser.

    Parameters
    ----------
    mechanics : Mechanics
        What moves. Plus is the way it tracks in the north on the one axis; on the other it raises the
        declination, but lowers it where the tube of a German mount hangs in the east.
    version : Version or None
        Of their firmware; None: behind a SynScan, which passes speeds on and nothing else.
    monotonic : callable
        Seconds, for timed pulses.
    """

    def __init__(self, mechanics: Mechanics, version: Version | None, monotonic: Callable[[], float]) -> None:
        self.southern = False
        self.own: dict[Axis, float] | None = None
        """Speeds over the ground that it was told while tracking was off, ″/s; None: the hand control's."""
        self._mechanics = mechanics
        self._version = version
        self._monotonic = monotonic
        self._pulses: dict[Axis, float] = {}
        self._rates = {Axis.RA: _GUIDE_RATE, Axis.DEC: _GUIDE_RATE}

    def reboot(self) -> None:
        """Forget what runs."""
        self._pulses.clear()
        self.own = None

    def dues(self) -> list[float]:
        """Instants at which pulses end."""
        return list(self._pulses.values())

    def end_pulses(self) -> None:
        """Forget the pulses whose time is over; the mechanics have ended them."""
        now = self._monotonic()
        self._pulses = {axis: due for axis, due in self._pulses.items() if due > now}

    def answer(self, message: PassThrough) -> bytes | None:
        """Carry out a message; None where there is no such board, or it does not know the order."""
        if message.device not in (Axis.RA, Axis.DEC):
            return None
        axis, data = Axis(message.device), message.data
        if self._version is None:
            return self._rate(axis, message.order, data) if message.order in _KEYS_ONLY else None
        if message.order == Order.VERSION:
            return bytes([self._version.major, self._version.minor])
        if message.order == Order.PULSE_RATE:
            return bytes([self._rates[axis]])
        if message.order == Order.PULSING:
            return bytes([axis in self._pulses])
        if message.order == Order.SET_PULSE_RATE and data:
            self._rates[axis] = data[0]
            return b""
        if message.order == Order.PULSE and len(data) >= 2:
            self._pulse(axis, data[0] - 256 if data[0] > 127 else data[0], data[1] / 100.0)
            return b""
        return self._rate(axis, message.order, data)

    def _pulse(self, axis: Axis, percent: int, pulse_s: float) -> None:
        rate_deg_s = abs(percent) / 100.0 * SIDEREAL_DEG_S
        if self._mechanics.pulse(self._direction(axis, percent < 0), rate_deg_s, pulse_s):
            self._pulses[axis] = self._monotonic() + pulse_s

    def _rate(self, axis: Axis, order: int, data: bytes) -> bytes | None:
        if order in (Order.MOVE_UP, Order.MOVE_DOWN) and data and data[0] < len(_FIXED_RATES_DEG_S):
            rate_deg_s = _FIXED_RATES_DEG_S[data[0]]
            self._move(axis, -rate_deg_s if order == Order.MOVE_DOWN else rate_deg_s)
            return b""
        if order in (Order.RATE_UP, Order.RATE_DOWN) and len(data) >= 2:
            if is_tracking_rate(data):
                self._mechanics.rate = _RATES[int.from_bytes(data[:2], "big")]
                self._mechanics.tracking = True
                return b""
            rate_arcsec_s = int.from_bytes(data[:2], "big") / 4.0
            signed = -rate_arcsec_s if order == Order.RATE_DOWN else rate_arcsec_s
            if self.own is None and self._mechanics.tracking:
                self._move(axis, signed / 3600.0)
            else:
                self._run(axis, signed)
            return b""
        return None

    def _run(self, axis: Axis, rate_arcsec_s: float) -> None:
        """Run a motor over the ground: the hand control, which doesn't track, leaves it so [NexStar P]."""
        own = self.own or dict.fromkeys(Axis, 0.0)
        own[axis] = rate_arcsec_s
        self.own = own
        west = -own[Axis.RA] if self.southern else own[Axis.RA]
        east_side = self._mechanics.pier_side() is PierSide.EAST
        north = -own[Axis.DEC] if east_side else own[Axis.DEC]
        self._mechanics.track_at(west / 3600.0, north / 3600.0)
        self._mechanics.tracking = True

    def taken_back(self, *, tracking: bool) -> None:
        """The hand control says what the motors do."""
        if self.own is not None:
            self.own = None
            self._mechanics.rate = TrackingRate.SIDEREAL
        self._mechanics.tracking = tracking

    def _move(self, axis: Axis, rate_deg_s: float) -> None:
        self._pulses.pop(axis, None)
        if self.own is not None and rate_deg_s == 0.0:
            self._run(axis, 0.0)
            return
        direction = self._direction(axis, rate_deg_s < 0)
        if rate_deg_s == 0.0:
            self._mechanics.stop_move(direction)
        else:
            self._mechanics.move(direction, abs(rate_deg_s))

    def _direction(self, axis: Axis, down: bool) -> Direction:
        if axis is Axis.RA:
            direction: Direction = "e" if down else "w"
            return _OTHER_WAY[direction] if self.southern else direction
        direction = "s" if down else "n"
        return _OTHER_WAY[direction] if self._mechanics.pier_side() is PierSide.EAST else direction


AVX = Handset(Version(5, 31), 0x11, 20, Version(7, 11))
"""As in the recorded dialogues."""

# a command's first byte says how long it is [NexStar table]
_LENGTHS = {
    **dict.fromkeys(b"VvmeEzZLJMtphwiu", 1),
    **dict.fromkeys(b"KT", 2),
    **dict.fromkeys(b"WHI", 9),
    ord("P"): 8,
    **dict.fromkeys(b"rsb", 18),
    **dict.fromkeys(b"RSB", 10),
}


_STANDS_ARCSEC = 1.0
"""A fake that is so near to its target stands there. Chosen by hand."""


class FakeNexstar(WireFake):
    """A hand control on the wire, with a mount behind it.

    Parameters
    ----------
    mechanics : Mechanics
        What moves, and what it believes of itself.
    handset : Handset
        Which one it is; what it can't do for its age, it doesn't know.
    version : tuple of int, optional
        Another firmware: major, minor.
    epoch : {"apparent", "icrs"}, optional
        What its coordinates mean: JNow for Celestron, J2000 for SynScan [NexStar SynScan differences].
    aligned : bool
        Whether its alignment is done; if not, no goto to a place on the sky is carried out, nor a sync.
    lowest_altitude_deg : float
        A goto below is answered and not carried out.
    sync_reach_deg : float or None
        A sync further off is answered and not carried out.
    coarse : bool
        Whether the last two of eight digits are 00, as of real ones.
    faults, clock, monotonic
        As of `WireFake`; its own clock is that of the mechanics.
    """

    IDENTITY = (b"V", b"v", b"m", b"P\x01\x10\xfe", b"P\x01\x11\xfe")

    def __init__(
        self,
        mechanics: Mechanics,
        *,
        handset: Handset = AVX,
        version: tuple[int, int] | None = None,
        epoch: Epoch | None = None,
        aligned: bool = True,
        lowest_altitude_deg: float = 0.0,
        sync_reach_deg: float | None = None,
        coarse: bool = True,
        faults: Iterable[Fault] = (),
        clock: Callable[[], datetime] = utc_now,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(mechanics, faults=faults, clock=clock, monotonic=monotonic)
        if version is not None:
            handset = replace(handset, version=Version(*version))
        self.handset = handset
        self.aligned = aligned
        self.motors = FakeMotors(mechanics, None if handset.synscan else handset.motors, monotonic)
        self._epoch: Epoch = epoch or ("icrs" if handset.synscan else "apparent")
        self._lowest_altitude_deg = lowest_altitude_deg
        self._sync_reach_deg = sync_reach_deg
        self._coarse = coarse
        self._goto = False
        self._sent_to: tuple[float, float] | None = None
        self._mode = handset.usual_mode(mechanics.site.latitude_deg) or Tracking.EQUATORIAL_NORTH
        self.motors.southern = self._mode is Tracking.EQUATORIAL_SOUTH
        self._zone_h, self._daylight_saving = 0.0, False
        self._knows = self._letters()

    # -- the wire --------------------------------------------------------------------------------

    def cut(self, buffer: bytes) -> tuple[bytes | None, bytes]:
        """Cut off the next command; half of one waits for its rest, whatever that is [NexStar s]."""
        while buffer:
            length = _LENGTHS.get(buffer[0])
            if length is not None:
                return (buffer[:length], buffer[length:]) if len(buffer) >= length else (None, buffer)
            self.unknown.append(buffer[:1])
            buffer = buffer[1:]
        return None, b""

    def deaf_reply(self, command: bytes) -> bytes:
        """Answer as to every order."""
        return b"#"

    def reboot(self) -> None:
        """Forget alignment, goto and tracking; clock and site as the mechanics do."""
        super().reboot()
        self.motors.reboot()
        self.aligned = self._goto = False
        self.mechanics.tracking = False

    def dues(self) -> list[float]:
        """Ends of guide pulses."""
        return self.motors.dues()

    def tick(self) -> None:
        """End guide pulses."""
        self.motors.end_pulses()

    def carry_out(self, command: bytes) -> bytes | None:
        """Do what a command says."""
        letter, rest = command[:1], command[1:]
        if letter not in self._knows:
            return None
        if letter == b"K":
            return rest + b"#"
        if letter == b"P":
            return self._pass_through(command)
        try:
            return (self._order(letter, rest) if rest else self._question(letter)) + b"#"
        except (Unreadable, ValueError, IndexError):
            # what a real one says to digits that are none has not been seen: silence
            return None

    def _letters(self) -> frozenset[bytes]:
        """Those that a hand control of this age knows."""
        handset = self.handset
        letters = "KVERZBLJM"
        if not handset.short_places:
            letters += "erTP"
        if handset.tells_model:
            letters += "mzb"
        if handset.tells_tracking:
            letters += "twWhH"
        if handset.variant is not None:
            letters += "v"
        if handset.quarter_zones:
            # `u` is sent before a park and answered so: it takes syncs back [INDI unsync]
            letters += "iIu"
        if handset.knows_sync:
            letters += "sS"
        if handset.tells_pier_side:
            letters += "p"
        return frozenset(letter.encode() for letter in letters)

    def _pass_through(self, command: bytes) -> bytes | None:
        try:
            message = pass_through_from_bytes(command)
        except Unreadable:
            return None
        answer = self.motors.answer(message)
        if answer is None:
            # neither does an absent board answer, nor the hand control for it [NexStar P]
            return None
        self._goto = self._goto and self.mechanics.slewing()
        return answer[: message.answer_length].ljust(message.answer_length, b"\0") + b"#"

    # -- the meaning -----------------------------------------------------------------------------

    def _question(self, letter: bytes) -> bytes:
        if letter in b"eEzZ":
            return self._pair(letter)
        if letter == b"M":
            if self._goto:
                self.mechanics.stop()
            self._goto = False
            return b""
        self._goto = self._goto and self.mechanics.slewing()
        handset, version = self.handset, self.handset.version
        answers: dict[bytes, Callable[[], bytes]] = {
            b"V": lambda: (
                b"%02X%02X%02X" % (version.major, version.minor, version.build)
                if handset.synscan
                else bytes([version.major, version.minor])
            ),
            b"v": lambda: bytes([handset.variant or 0]),
            b"m": lambda: bytes([handset.model or 0]),
            b"L": lambda: b"1" if self._goto else b"0",
            b"J": lambda: bytes([self.aligned]),
            b"t": lambda: bytes([handset.number(self._mode) if self._tracks else 0]),
            b"p": self._pier_side,
            b"w": self._site,
            b"h": lambda: self._time(fine=False),
            b"i": lambda: self._time(fine=True),
            b"u": lambda: b"",
        }
        return answers[letter]()

    def _order(self, letter: bytes, rest: bytes) -> bytes:
        if letter in b"rRsSbB":
            pair = pair_from_text(rest)
            if letter in b"bB":
                self._sent_to = (pair.first_deg, pair.second_deg)
                point_at_horizon(self.mechanics, *self._sent_to)
                self._goto = True
            elif self.aligned and letter in b"sS":
                self._sync(self._from_wire(pair.first_deg, pair.second_deg))
            elif self.aligned:
                self._slew(self._from_wire(pair.first_deg, pair.second_deg))
        elif letter == b"T":
            mode = self.handset.mode(rest[0])
            if mode is not Tracking.OFF:
                self.motors.southern = mode is Tracking.EQUATORIAL_SOUTH
            self.motors.taken_back(tracking=mode is not Tracking.OFF)
            self._mode = mode or self._mode
        elif letter == b"W":
            site = site_from_bytes(rest)
            height_m = self.mechanics.believed_site.height_m
            self.mechanics.set_believed_site(Site(site.latitude_deg, site.longitude_deg, height_m))
        else:
            self._set_time(fine_time_from_bytes(rest) if letter == b"I" else time_from_bytes(rest))
        return b""

    @property
    def _tracks(self) -> bool:
        """Whether the hand control itself tracks."""
        return self.mechanics.tracking and self.motors.own is None

    def _slew(self, target: Apparent) -> None:
        # a goto takes the motors back [NexStar P]
        tracking = self._tracks
        mechanics = self.mechanics
        self.motors.taken_back(tracking=tracking)
        if mechanics.believed_altitude_deg(target) < self._lowest_altitude_deg:
            return
        if mechanics.refusal(target) is None and mechanics.slew(target) is None:
            # a goto leaves the tracking mode as it is
            mechanics.tracking = tracking
            self._goto = True

    def _sync(self, place: Apparent) -> None:
        if self._sync_reach_deg is not None:
            off_deg = separation_arcsec(self.mechanics.reported(), place) / 3600.0
            if off_deg > self._sync_reach_deg:
                return
        self.mechanics.sync(place)

    def _pier_side(self) -> bytes:
        """Where the tube looks: W for one that hangs in the east."""
        letter = b"E" if self.mechanics.pier_side() is PierSide.WEST else b"W"
        southern = self.mechanics.believed_site.latitude_deg < 0.0
        if self.handset.mirrors_pier_side and southern:
            return b"W" if letter == b"E" else b"E"
        return letter

    # -- places ----------------------------------------------------------------------------------

    def _pair(self, letter: bytes) -> bytes:
        short = letter.isupper()
        if letter in b"eE":
            place = self.mechanics.reported()
            told = apparent_to_icrs(place) if self._epoch == "icrs" else place
            return pair_to_text(told.ra_deg, told.dec_deg, short=short, coarse=self._coarse)
        az_deg, alt_deg = self._horizon()
        return pair_to_text(az_deg, alt_deg, short=short, coarse=self._coarse)

    def _horizon(self) -> tuple[float, float]:
        az_deg, alt_deg = believed_horizon(self.mechanics)
        if self._sent_to is not None and not (self.mechanics.tracking or self.mechanics.slewing()):
            # at the zenith the azimuth is any number on the sky, but the axes stand where they were sent
            near = Icrs(az_deg, alt_deg), Icrs(self._sent_to[0] % 360.0, self._sent_to[1])
            if separation_arcsec(*near) < _STANDS_ARCSEC:
                return self._sent_to
        return az_deg, alt_deg

    def _from_wire(self, ra_deg: float, dec_deg: float) -> Apparent:
        now = self.mechanics.reported().utc
        if self._epoch == "icrs":
            return icrs_to_apparent(Icrs(ra_deg, dec_deg), now)
        return Apparent(ra_deg, dec_deg, now)

    # -- clock and site, as the mechanics believe them ---------------------------------------------

    def _site(self) -> bytes:
        site = self.mechanics.believed_site
        east_deg = (site.longitude_deg + 180.0) % 360.0 - 180.0
        return site_to_bytes(WireSite(site.latitude_deg, east_deg))

    def _time(self, *, fine: bool) -> bytes:
        utc = self.mechanics.believed_utc().replace(microsecond=0, tzinfo=None)
        local = utc + timedelta(hours=self._zone_h + int(self._daylight_saving))
        zone_h = self._zone_h if fine else float(int(self._zone_h))
        return time_to_bytes(WireTime(local, zone_h, self._daylight_saving), fine=fine)

    def _set_time(self, given: WireTime) -> None:
        self._zone_h, self._daylight_saving = given.zone_h, given.daylight_saving
        self.mechanics.set_believed_utc(given.utc.replace(tzinfo=UTC))


_CELESTRON = {
    "nexstar": AVX,
    # a CGEM before version 5: whole-hour zones, sync and pier side
    "nexstar-4": Handset(Version(4, 21), None, 14, Version(6, 17)),
    # the first hand controls: four digits, no sync, no clock, no pulses
    "nexstar-old": Handset(Version(1, 2)),
    "starsense": Handset(Version(1, 20), STARSENSE, 23, Version(7, 13)),
}
_SYNSCAN = {
    "synscan": Handset(Version(4, 39, 5, synscan=True), None, 1),
    # before syncs and sides of the pier
    "synscan-old": Handset(Version(3, 36, 0, synscan=True), None, 0),
}
SYNC_REACH_DEG = 6.5
"""A SynScan takes no sync further from its model: 6 to 7 degrees [Sky-Watcher's engineer, INDI #614]."""


def make_fake(
    dialect: str,
    mechanics: Mechanics,
    *,
    faults: Iterable[Fault] = (),
    clock: Callable[[], datetime] = utc_now,
    monotonic: Callable[[], float] = time.monotonic,
) -> FakeNexstar:
    """Make a fake of a dialect of `CELESTRON_FAKES` or `SYNSCAN_FAKES`."""
    if dialect in _CELESTRON:
        handset, reach_deg = _CELESTRON[dialect], None
    else:
        handset, reach_deg = _SYNSCAN[dialect], SYNC_REACH_DEG
    return FakeNexstar(
        mechanics,
        handset=handset,
        sync_reach_deg=reach_deg,
        faults=faults,
        clock=clock,
        monotonic=monotonic,
    )


CELESTRON_FAKES = Fakes(
    dialects=tuple(_CELESTRON),
    make=make_fake,
    # goto, sync, guide pulse
    moves=(b"r", b"R", b"b", b"B", b"s", b"S", b"P\x03\x10\x26", b"P\x03\x11\x26"),
    stops=(b"M",),
    machine=Machine(mounting="german"),
)
SYNSCAN_FAKES = replace(CELESTRON_FAKES, dialects=tuple(_SYNSCAN))
