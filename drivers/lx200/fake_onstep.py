"""An OnStepX on the other end of the cable: what it believes, allows and refuses, as its source has it.

It speaks for a `drivers.lx200.fake.FakeLx200`: one command in, its answer out. Motion is the mechanics'.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import cast

from drivers.lx200.angles import dec_from_text, ra_from_text
from drivers.lx200.fake_dialect import FakeDialect
from drivers.lx200.fake_onstep_motion import IS_PARKED, OK, SLEW_ERROR, OnStepMotion
from drivers.lx200.fake_onstep_settings import Settings
from drivers.lx200.fake_onstep_status import HZ, SIDE_LETTERS, bits, flags
from drivers.lx200.fake_onstep_words import SILENT, STANDING, TAKEN
from drivers.lx200.fine_angles import degrees_to_fine_text, ra_to_fine_text
from drivers.wire.command import Unreadable
from mountnav.devices import PierSide, TrackingRate
from mountnav.simulation.mechanics import Direction, Mechanics
from mountnav.sky.turning import SIDEREAL_DEG_S

_RATE_LETTERS = {
    "Q": TrackingRate.SIDEREAL,
    "L": TrackingRate.LUNAR,
    "S": TrackingRate.SOLAR,
    "K": TrackingRate.KING,
}
# times sidereal; the fastest two are half and all of the slew rate
_MOVE_RATES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 20.0, 48.0)
_RATE_NAMES = {"G": 2, "C": 5, "M": 6, "F": 7, "S": 8}
_PULSE_RATE_DEG_S = 0.5 * SIDEREAL_DEG_S
# what :GE# tells of orders that were done, and of values that make no sense [ONSTEP CommandError]
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
        rate = re.fullmatch(r"R([GCMFS0-9])", text)
        if rate is not None:
            self._move_rate = _RATE_NAMES[rate[1]] if rate[1] in _RATE_NAMES else int(rate[1])
            return b""
        if re.fullmatch(r"T[QLSK]", text):
            self.mechanics.rate = _RATE_LETTERS[text[1]]
            return b""
        return None

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
        return b"%.5f#" % HZ.get(self.mechanics.rate, HZ[TrackingRate.SIDEREAL])

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
        self.mechanics.track_at(SIDEREAL_DEG_S * hz / HZ[TrackingRate.SIDEREAL])


ONSTEP_FAKE = FakeDialect(
    name="onstep",
    speaker=lambda fake: OnStepSpeaker(fake.mechanics),
    classic_too=lambda text: False,
    matched=b"N/A#",
    denials={"MS": b"1", "CM": b"E1#", "Te": b"0", "Td": b"0", "hP": b"0", "hR": b"0", "hQ": b"0"},
)
