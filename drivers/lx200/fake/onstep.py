"""An OnStepX on the other end of the cable: what it believes, allows and refuses, as its source has it.

It speaks for a `drivers.lx200.fake.base.FakeLx200`: one command in, its answer out. Motion is the mechanics'.

Shapes as its source has them [ONSTEP], of a controller without focuser, rotator, weather and features.

Orders return the code of what forbids them, as `:GE#` reports it; 0 is nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import cast

from drivers.lx200.codec.angles import dec_from_text, degrees_to_fine_text, ra_from_text, ra_to_fine_text
from drivers.lx200.codec.onstep import Status
from drivers.lx200.fake.dialect import FakeDialect
from drivers.lx200.fake.site_and_time import Settings
from drivers.wire.command import Unreadable
from mountnav.clock import utc_now
from mountnav.devices import TRACKING_DEG_S, PierSide, TrackingRate
from mountnav.errors import Refusal
from mountnav.simulation.mechanics import Direction, Mechanics
from mountnav.sky.coordinates import SIDEREAL_DEG_S, SOLAR_TO_SIDEREAL, Apparent

STANDING: dict[str, bytes] = {
    "GVP": b"On-Step#",
    "GVN": b"10.28b#",
    "GVD": b"Jul 14 2026#",
    "GVT": b"07:36:40#",
    "GVM": b"On-Step 10.28b#",
    # focusers, rotator, auxiliary features: none
    "FA": b"0",
    "fA": b"0",
    **{f"F{number}A": b"0" for number in range(1, 10)},
    "GX98": b"N#",
    "GXY0": b"00000000#",
    # backlash (arcsec), pulse guide rate, automatic flip, preferred side, meridian limits (min)
    "%BD": b"0#",
    "%BR": b"0#",
    "GX90": b"0.50#",
    "GX95": b"0#",
    "GX96": b"B#",
    "GXE9": b"60#",
    "GXEA": b"60#",
    # temperature, pressure, humidity, dew point, its own temperature
    "GX9A": b"10.0#",
    "GX9B": b"1013.2#",
    "GX9C": b"50.0#",
    "GX9E": b"0.1#",
    "GX9F": b"35.0#",
    # drivers of the two motors: no flag up
    "GXU1": b"#",
    "GXU2": b"#",
    # six alignment stars at most, none in progress; altitude and azimuth of the polar axis
    "A?": b"600#",
    "GX02": b"0#",
    "GX03": b"0#",
    "$QZ?": b"I#",
    "Gc": b"24#",
    "GM": b"None#",
    "GN": b"None#",
    "GO": b"None#",
    "GP": b"None#",
    "W?": b"0#",
    "h?": b"0,0,0#",
}
"""Words and their answers."""

SILENT: frozenset[str] = frozenset({"U", "B+", "B-", "$QZ+", "$QZ-", "$QZ/", "$QZZ", "$QZ!"})
"""Words that are taken without an answer and change nothing here."""

TAKEN: frozenset[str] = frozenset(
    {"Tr", "Tn", "To", "T1", "T2", "SX95,0", "SX95,1", "SX96,E", "SX96,W", "SX96,B"}
)
"""Words that are answered by a bare 1 and change nothing here."""


HZ = {
    TrackingRate.SIDEREAL: 60.16427,
    TrackingRate.LUNAR: 57.9,
    TrackingRate.SOLAR: 60.0,
    TrackingRate.KING: 60.136,
}
"""Tracking rates as frequencies [ONSTEP :GT#]."""
SIDE_LETTERS = {PierSide.EAST: b"E", PierSide.WEST: b"W", PierSide.UNKNOWN: b"N"}
_SIDE_FLAGS = {PierSide.EAST: "T", PierSide.WEST: "W", PierSide.UNKNOWN: "o"}
_SIDE_BITS = {PierSide.EAST: 0x20, PierSide.WEST: 0x40, PierSide.UNKNOWN: 0x10}
"""Bits of `:Gu#` for the side of the pier [ONSTEP]."""
_RATE_FLAGS = {TrackingRate.LUNAR: "(", TrackingRate.SOLAR: "O", TrackingRate.KING: "k"}
_RATE_BITS = {TrackingRate.LUNAR: 1, TrackingRate.SOLAR: 2, TrackingRate.KING: 3}
"""Bits of `:Gu#` for the tracking rate [ONSTEP]."""
_MOUNTING_BITS = {"E": 1, "K": 2, "L": 4, "A": 8}
"""Bits of `:Gu#` for the mounting: German, fork, altalt, altazimuth [ONSTEP]."""
_PULSE_RATE = 1
"""The number of the pulse rate in the status: half sidereal [ONSTEP :GU#]."""


def _park_state(status: Status) -> int:
    return 2 if status.parked else 1 if status.parking else 3 if status.park_failed else 0


def flags(status: Status, mounting: str, move_rate: int) -> bytes:
    """Text of `:GU#`; `mounting` is its letter, `move_rate` the number of the selected rate."""
    letters = (
        ("n", not status.tracking),
        ("N", not status.slewing),
        ("pIPF"[_park_state(status)], True),
        ("H", status.at_home),
        ("h", status.homing),
        ("G", status.guiding),
        (_RATE_FLAGS.get(status.rate, ""), True),
    )
    said = "".join(letter for letter, up in letters if up)
    error = chr(ord("0") + status.error)
    return f"{said}{mounting}{_SIDE_FLAGS[status.pier_side]}{_PULSE_RATE}{move_rate}{error}#".encode()


def bits(status: Status, mounting: str, move_rate: int) -> bytes:
    """Bytes of `:Gu#`."""
    numbers = (
        (not status.tracking) | (not status.slewing) << 1 | status.guiding << 3,
        _RATE_BITS.get(status.rate, 0),
        status.at_home | status.homing << 5,
        _MOUNTING_BITS[mounting] | _SIDE_BITS[status.pier_side],
        0,
        _park_state(status),
        _PULSE_RATE,
        move_rate,
        status.error,
    )
    return bytes(0x80 | int(number) for number in numbers) + b"#"


_MOST_OFFSET = 1800.0
"""Of rates beside the tracking rate, arcseconds per sidereal second: greater ones are taken for this one
[ONSTEP :SXTR]."""
LOWEST_DEG = -10.0
"""Its horizon limit where the machine has none [ONSTEP LIMIT_ALTITUDE_MIN]."""
OK, IS_PARKED, PARK_FAILED, NOT_PARKED = 0, 9, 10, 11
"""Numbers of OnStep's command errors, as `:GE#` reports them [ONSTEP CommandError]."""
SLEW_ERROR = 14
"""The codes after it are the digits of `:MS#` [ONSTEP CommandError]."""
_BELOW, _PARKED, _IN_GOTO, _LIMIT, _IN_MOTION, _UNSPECIFIED = (
    SLEW_ERROR + digit for digit in (1, 4, 5, 6, 8, 9)
)


class OnStepMotion:
    """Its orders to move, and its state.

    Attributes
    ----------
    going : bool
        A goto runs, also to park or home.
    moved : bool
        A key was pressed or a stop ordered, and the axes don't rest yet; tracking that begins is no motion.
    """

    def __init__(self, mechanics: Mechanics, settings: Settings) -> None:
        self._mechanics = mechanics
        self._settings = settings
        self.forget()

    def forget(self) -> None:
        """Forget what a reboot forgets."""
        self.target_ra_deg = self.target_dec_deg = 0.0
        self.going = self.moved = self._tracked = False
        self._first_goto = True
        self.rate = TrackingRate.SIDEREAL
        self._base_deg_s = SIDEREAL_DEG_S
        self._offsets = {"R": 0.0, "D": 0.0}

    # -- state -----------------------------------------------------------------------------------

    def arrive(self) -> None:
        """Notice that a goto has come to its end."""
        if (self.going or self.moved) and not self._mechanics.slewing():
            if self.going and self._mechanics.at_home:
                self._first_goto = True
                # at home it begins again [ONSTEP Home::reset]
                self.follow(TrackingRate.SIDEREAL)
                self._offsets = {"R": 0.0, "D": 0.0}
                self._retrack()
            self.going = self.moved = False

    def status(self) -> Status:
        """Look at it, as `:GU#` would say."""
        mechanics = self._mechanics
        side = mechanics.pier_side()
        # at home there is no side, and a fork's is east [ONSTEP Mount::update]
        if mechanics.at_home:
            side = PierSide.UNKNOWN
        elif side is PierSide.UNKNOWN:
            side = PierSide.EAST
        return Status(
            tracking=mechanics.tracking,
            slewing=self.going,
            parked=mechanics.parked,
            parking=mechanics.parking,
            park_failed=False,
            at_home=mechanics.at_home and not self.going,
            homing=mechanics.homing and self.going,
            guiding=mechanics.guiding(),
            pier_side=side,
            rate=self.rate,
            error=self._error(),
        )

    def _error(self) -> int:
        mechanics = self._mechanics
        if not mechanics.at_limit:
            return 0
        below = mechanics.believed_altitude_deg(mechanics.reported()) < self._lowest_deg() + 0.1
        return 2 if below else 7

    def _lowest_deg(self) -> float:
        lowest_deg = self._mechanics.machine.lowest_altitude_deg
        return LOWEST_DEG if lowest_deg is None else lowest_deg

    # -- rates -----------------------------------------------------------------------------------

    def follow(self, rate: TrackingRate, base_deg_s: float | None = None) -> None:
        """Track at a rate of its own; what is beside that stays."""
        self.rate, self._base_deg_s = rate, base_deg_s or TRACKING_DEG_S[rate]
        self._retrack()

    def offset(self, axis: str, rate: float) -> None:
        """Track so fast beside that: ″ per sidereal second, at most 1800 [ONSTEP :SXTR :SXTD]."""
        self._offsets[axis] = max(-_MOST_OFFSET, min(_MOST_OFFSET, rate))
        self._retrack()

    def offset_read_back(self, axis: str) -> float:
        """What it says of that."""
        # a fault may have dropped them
        return 0.0 if self._mechanics.beside_arcsec_s == (0.0, 0.0) else self._offsets[axis]

    def _retrack(self) -> None:
        mechanics = self._mechanics
        ra, dec = (self._offsets[axis] * SOLAR_TO_SIDEREAL / 3600.0 for axis in ("R", "D"))
        if ra == dec == 0.0 and self._base_deg_s == TRACKING_DEG_S.get(self.rate):
            mechanics.rate = self.rate
        else:
            mechanics.track_at(self._base_deg_s - ra, dec)

    # -- goto, flip, sync ------------------------------------------------------------------------

    def _target(self) -> Apparent:
        return Apparent(self.target_ra_deg, self.target_dec_deg, utc_now())

    def _busy(self) -> int:
        """What forbids a goto or a sync whatever the place [ONSTEP Goto::validate]."""
        if self._mechanics.parked:
            return _PARKED
        if self.going:
            return _IN_GOTO
        if self.moved or self._mechanics.guiding():
            return _IN_MOTION
        return OK if self._settings.ready else _LIMIT

    def _unreachable(self, side: PierSide | None = None) -> int:
        target = self._target()
        if self._mechanics.believed_altitude_deg(target) < self._lowest_deg():
            return _BELOW
        refusal = self._mechanics.refusal(target, side)
        return {None: OK, Refusal.BELOW_HORIZON: _BELOW, Refusal.LIMIT: _LIMIT}.get(refusal, _UNSPECIFIED)

    def slew(self, side: PierSide | None = None) -> int:
        """Set out for the target."""
        busy = self._busy()
        if busy == _IN_GOTO:
            # refused, and the goto that runs ends [ONSTEP Goto::request]
            self.stop()
        error = busy or self._unreachable(side)
        if error == OK:
            tracked = self._mechanics.tracking
            self._mechanics.slew(self._target(), side)
            if not (tracked or self._first_goto):
                self._mechanics.tracking = False
            self._first_goto, self.going = False, True
        return error

    def flip(self, side: PierSide | None) -> int:
        """Set out for the present place on a side, the other one if None."""
        here, present = self._mechanics.reported(), self._mechanics.pier_side()
        if present is PierSide.UNKNOWN:
            return _UNSPECIFIED
        self.target_ra_deg, self.target_dec_deg = here.ra_deg, here.dec_deg
        return self.slew(side or (PierSide.WEST if present is PierSide.EAST else PierSide.EAST))

    def destination(self) -> PierSide:
        """Side on which it would look at the target, unknown if it would not."""
        if self._unreachable() != OK:
            return PierSide.UNKNOWN
        side = self._mechanics.destination_side(self._target())
        return PierSide.EAST if side is PierSide.UNKNOWN else side

    def sync(self) -> int:
        """Take the target for where it points: on the present side, except at home."""
        mechanics = self._mechanics
        at_home, side = mechanics.at_home, mechanics.pier_side()
        error = self._busy() or self._unreachable(None if at_home or side is PierSide.UNKNOWN else side)
        if error != OK:
            return error
        if mechanics.sync(self._target()) is not None:
            return _UNSPECIFIED
        if at_home:
            mechanics.tracking = True
        return OK

    def stop(self) -> None:
        """End all motion."""
        station = self._mechanics.parking or self._mechanics.homing
        self._mechanics.stop()
        if station and self.going:
            # an ended park or home tracks again if it did before [ONSTEP requestAborted]
            self._mechanics.tracking = self._tracked
        self.going, self.moved = False, True

    # -- park and home ---------------------------------------------------------------------------

    def park(self) -> int:
        """Set out for the park position."""
        if self._mechanics.parked:
            return OK
        error = PARK_FAILED if self._mechanics.parking else self._busy()
        if error == OK:
            self._go(self._mechanics.park)
        return error

    def unpark(self) -> int:
        """Track again; at home it may, too."""
        if not self._mechanics.parked and not self._mechanics.at_home:
            return NOT_PARKED
        if not self._settings.ready:
            return IS_PARKED
        self._mechanics.unpark()
        self._mechanics.tracking = True
        self._first_goto = False
        return OK

    def home(self) -> None:
        """Set out for home."""
        if self._busy() == OK:
            self._go(self._mechanics.home)

    def set_park(self) -> int:
        """Take the present place for the park position."""
        busy = self._busy()
        if busy == _PARKED:
            return IS_PARKED
        if busy in (_IN_GOTO, _IN_MOTION):
            return busy
        self._mechanics.set_park()
        return OK

    def _go(self, to_station: Callable[[], object]) -> None:
        self._tracked = self._mechanics.tracking
        to_station()
        self.going = True


_RATE_LETTERS = {
    "Q": TrackingRate.SIDEREAL,
    "L": TrackingRate.LUNAR,
    "S": TrackingRate.SOLAR,
    "K": TrackingRate.KING,
}
# times sidereal; the fastest two are half and all of the slew rate
_MOVE_RATES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 20.0, 48.0)
_RATE_NAMES = {"G": 2, "C": 5, "M": 6, "F": 7, "S": 8}
"""Which number of `:Rn#` the letters choose [ONSTEP]."""
_PULSE_RATE_DEG_S = 0.5 * SIDEREAL_DEG_S
"""What `_PULSE_RATE` stands for."""
# what :GE# reports of orders that were done, and of values that make no sense [ONSTEP CommandError]
_YES, _OUT_OF_RANGE = 25, 4


class OnStepSpeaker:
    """One command in, its answer out.

    Parameters
    ----------
    mechanics : Mechanics
        Its own clock and site are the mechanics'.
    """

    def __init__(self, mechanics: Mechanics) -> None:
        self.mechanics = mechanics
        self.settings = Settings(mechanics)
        self.motion = OnStepMotion(mechanics, self.settings)
        self.last_error = OK
        self._wake(clock_set=mechanics.machine.remembers_clock or mechanics.tracking)

    def _wake(self, *, clock_set: bool) -> None:
        self.settings.date_set = self.settings.time_set = clock_set
        self.motion.forget()
        self._move_rate = 2

    def reboot(self) -> None:
        """Forget targets and states; the clock too, unless the machine has one of its own."""
        self._wake(clock_set=self.mechanics.machine.remembers_clock)

    # -- words -----------------------------------------------------------------------------------

    def say(self, text: str) -> bytes | None:
        """Answer a command, given without its `:` and `#`; None for one it doesn't know."""
        self.motion.arrive()
        if text == "GE":
            answer, self.last_error = b"%02d#" % self.last_error, OK
            return answer
        self.last_error = OK
        return self._answer(text)

    def _answer(self, text: str) -> bytes | None:
        for words in (STANDING, SILENT, TAKEN):
            if text in words:
                return STANDING.get(text, b"" if text in SILENT else b"1")
        exact = self._exact().get(text)
        if exact is not None:
            return exact()
        if text[:2] in ("Sr", "Sd", "St", "Sg", "SG", "SL", "SC", "ST"):
            return self._set(text[:2], text[2:])
        value = self._value(text)
        return self._pattern(text) if value is None else value

    def _exact(self) -> dict[str, Callable[[], bytes]]:
        motion = self.motion
        return {
            "\x06": lambda: b"P",
            "GU": lambda: flags(motion.status(), self._mounting(), self._move_rate),
            "Gu": lambda: bits(motion.status(), self._mounting(), self._move_rate),
            "Gm": lambda: SIDE_LETTERS[motion.status().pier_side] + b"#",
            "D": lambda: b"\x7f#" if motion.going else b"#",
            "GT": self._rate_text,
            "MS": lambda: self._numbered(motion.slew()),
            "MN": lambda: self._numbered(motion.flip(None)),
            "MNe": lambda: self._numbered(motion.flip(PierSide.EAST)),
            "MNw": lambda: self._numbered(motion.flip(PierSide.WEST)),
            "MD": lambda: {PierSide.EAST: b"0", PierSide.WEST: b"1"}.get(motion.destination(), b"2"),
            "CM": self._sync,
            "CS": lambda: self._sync()[:0],
            "Q": lambda: self._silently(motion.stop),
            "Te": lambda: self._yes_or_no(self._track(True)),
            "Td": lambda: self._yes_or_no(self._track(False)),
            "hP": lambda: self._yes_or_no(motion.park(), _YES),
            "hR": lambda: self._yes_or_no(motion.unpark(), _YES),
            "hC": lambda: self._silently(motion.home),
            "hQ": lambda: self._yes_or_no(motion.set_park()),
            "GX89": lambda: b"0" if self.settings.ready else b"1",
        }

    def _value(self, text: str) -> bytes | None:
        """Numbers of position, target, site and time; fine ones by an `H`."""
        name, fine = text[:2], text[2:] == "H"
        here = self.mechanics.reported()
        if text in ("GR", "GRH", "Gr", "GrH"):
            ra_deg = here.ra_deg if name == "GR" else self.motion.target_ra_deg
            return ra_to_fine_text(ra_deg, 4 if fine else 0) + b"#"
        if text in ("GD", "GDH", "Gd", "GdH"):
            dec_deg = here.dec_deg if name == "GD" else self.motion.target_dec_deg
            return degrees_to_fine_text(dec_deg, 3 if fine else 0) + b"#"
        return self.settings.tell(text)

    def _pattern(self, text: str) -> bytes | None:
        pulse = re.fullmatch(r"M([gG])([nsew])(\d{1,5})", text)
        if pulse is not None:
            duration_s = int(pulse[3]) / 1000.0
            done = self.mechanics.pulse(cast("Direction", pulse[2]), _PULSE_RATE_DEG_S, duration_s)
            return b"" if pulse[1] == "g" else b"%d" % done
        if re.fullmatch(r"M[nsew]", text):
            if not self.motion.going:
                self.mechanics.move(cast("Direction", text[1]), self._move_deg_s())
                self.motion.moved = True
            return b""
        if re.fullmatch(r"Q[nsew]", text):
            self.mechanics.stop_move(cast("Direction", text[1]))
            return b""
        offset = re.fullmatch(r"SXT([RD]),(.*)", text)
        if offset is not None:
            return self._set_offset(offset[1], offset[2])
        offset = re.fullmatch(r"GXT([RD])", text)
        if offset is not None:
            return b"%.8f#" % self.motion.offset_read_back(offset[1])
        rate = re.fullmatch(r"R([GCMFS0-9])", text)
        if rate is not None:
            self._move_rate = _RATE_NAMES[rate[1]] if rate[1] in _RATE_NAMES else int(rate[1])
            return b""
        if re.fullmatch(r"T[QLSK]", text):
            self.motion.follow(_RATE_LETTERS[text[1]])
            return b""
        return None

    def _set_offset(self, axis: str, text: str) -> bytes:
        """Take a number as `strtod` does: what is none counts as 0 [ONSTEP :SXTR]."""
        try:
            rate = float(text)
        except ValueError:
            rate = 0.0
        self.motion.offset(axis, rate if math.isfinite(rate) else 0.0)
        return b"1"

    # -- answers ---------------------------------------------------------------------------------

    def _yes_or_no(self, error: int, yes: int = OK) -> bytes:
        self.last_error = error or yes
        return b"0" if error else b"1"

    def _numbered(self, error: int) -> bytes:
        self.last_error = error
        return b"%d" % (error - SLEW_ERROR if error else 0)

    def _sync(self) -> bytes:
        error = self.last_error = self.motion.sync()
        return b"E%d#" % (error - SLEW_ERROR) if error else b"N/A#"

    @staticmethod
    def _silently(do: Callable[[], object]) -> bytes:
        do()
        return b""

    def _track(self, on: bool) -> int:
        if on and self.mechanics.parked:
            return IS_PARKED
        self.mechanics.tracking = on
        return OK

    def _mounting(self) -> str:
        return "E" if self.mechanics.machine.mounting == "german" else "K"

    def _rate_text(self) -> bytes:
        if not self.mechanics.tracking:
            return b"0#"
        return b"%.5f#" % HZ.get(self.motion.rate, HZ[TrackingRate.SIDEREAL])

    def _move_deg_s(self) -> float:
        if self._move_rate < len(_MOVE_RATES):
            return _MOVE_RATES[self._move_rate] * SIDEREAL_DEG_S
        return self.mechanics.slew_rate_deg_s / (2.0 if self._move_rate == 8 else 1.0)

    # -- setting ---------------------------------------------------------------------------------

    def _set(self, what: str, text: str) -> bytes:
        wire = text.encode("latin-1")
        try:
            if what == "Sr":
                self.motion.target_ra_deg = ra_from_text(wire).deg
            elif what == "Sd":
                self.motion.target_dec_deg = dec_from_text(wire).deg
            elif what == "ST":
                self._track_at(float(wire))
            else:
                self.settings.take(what, text)
        except (Unreadable, ValueError):
            self.last_error = _OUT_OF_RANGE
            return b"0"
        return b"1"

    def _track_at(self, hz: float) -> None:
        if not 30.0 <= hz < 90.0:
            raise ValueError(f"{hz} Hz can't be tracked at")
        self.motion.follow(TrackingRate.CUSTOM, SIDEREAL_DEG_S * hz / HZ[TrackingRate.SIDEREAL])


ONSTEP_FAKE = FakeDialect(
    name="onstep",
    speaker=lambda fake: OnStepSpeaker(fake.mechanics),
    classic_too=lambda text: False,
    matched=b"N/A#",
    denials={"MS": b"1", "CM": b"E1#", "Te": b"0", "Td": b"0", "hP": b"0", "hR": b"0", "hQ": b"0"},
)
