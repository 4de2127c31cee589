"""A ZWO AM5 on the other end of the cable, as its protocol document says; no real one was recorded.

What it is taken to do: a goto before time and site were set is refused (`e7`), a sync across the meridian too
(`e9`); a park latches, home doesn't [ZWO].
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import cast

from drivers.lx200.codec.angles import dec_from_text, dec_to_text, ra_from_text, ra_to_text
from drivers.lx200.fake.dialect import FakeDialect
from drivers.lx200.fake.site_and_time import Settings
from drivers.wire.command import Unreadable
from mountnav.clock import utc_now
from mountnav.devices import PierSide, TrackingRate
from mountnav.errors import Refusal
from mountnav.simulation.mechanics import Direction, Mechanics
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent

_STANDING = {
    "\x06": b"P",
    "GVP": b"AM5#",
    "GV": b"1.8.2#",
    "GVN": b"1.8.2#",
    "GVT": b"12:00:00#",
    "GVE": b"1.1.0#",
    "GMA": b"0123456789abcdef#",
    "Gc": b"24#",
    "GM": b"Home#",
    "GRl": b"1440#",
    "GTa": b"10+00#",
    "GLC": b"0#",
    "GLH": b"90#",
    "GLL": b"00#",
}
_RATES = {"TQ": TrackingRate.SIDEREAL, "TL": TrackingRate.LUNAR, "TS": TrackingRate.SOLAR}
# lunar before solar, as the Chinese text has it [ZWO :GT#]
_RATE_NUMBERS = {TrackingRate.LUNAR: 1, TrackingRate.SOLAR: 2}
_MOVE_RATES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 20.0, 60.0, 720.0, 1440.0)
"""What the numbers of `:Rn#` mean to the fake, in times sidereal."""
_RATE_NAMES = {"G": 1, "C": 2, "M": 8, "S": 9}
"""Which of them the letters of `:RG#` to `:RS#` choose."""
_SIDES = {PierSide.EAST: b"E#", PierSide.WEST: b"W#", PierSide.UNKNOWN: b"E#"}
_FORMAT, _IN_GOTO, _MOVING, _BELOW, _LIMIT, _UNSET, _OTHER_SIDE = 2, 3, 4, 5, 6, 7, 9
"""Numbers of refusals, as `drivers.lx200.codec.am5.REFUSALS` reads them."""


def _error(number: int) -> bytes:
    return b"e%d#" % number


class Am5Speaker:
    """One command in, its answer out.

    Parameters
    ----------
    mechanics : Mechanics
        Its own clock and site are the mechanics'.
    """

    def __init__(self, mechanics: Mechanics) -> None:
        self.mechanics = mechanics
        self.settings = Settings(mechanics)
        self.guide_rate = 0.5
        self.buzzer = 2
        self._wake(clock_set=mechanics.machine.remembers_clock or mechanics.tracking)

    def _wake(self, *, clock_set: bool) -> None:
        self.settings.date_set = self.settings.time_set = clock_set
        self.target_ra_deg = self.target_dec_deg = 0.0
        self.going = False
        self._move_rate = 9

    def reboot(self) -> None:
        """Forget target and time; a park is kept."""
        self._wake(clock_set=self.mechanics.machine.remembers_clock)

    # -- words -----------------------------------------------------------------------------------

    def say(self, text: str) -> bytes | None:
        """Answer a command, given without its `:` and `#`; None for one it doesn't know."""
        if self.going and not self.mechanics.slewing():
            self.going = False
        if text in _STANDING:
            return _STANDING[text]
        exact = self._exact().get(text)
        if exact is not None:
            return exact()
        if text[:3] == "SBu" and text[3:] in ("0", "1", "2"):
            self.buzzer = int(text[3:])
            return b""
        if text[:2] in ("Sr", "Sd", "St", "Sg", "SG", "SL", "SC"):
            return self._set(text[:2], text[2:])
        told = self.settings.tell(text)
        return self._pattern(text) if told is None else told

    def _exact(self) -> dict[str, Callable[[], bytes]]:
        mechanics = self.mechanics
        return {
            "GR": lambda: ra_to_text(mechanics.reported().ra_deg) + b"#",
            "GD": lambda: dec_to_text(mechanics.reported().dec_deg) + b"#",
            "Gr": lambda: ra_to_text(self.target_ra_deg) + b"#",
            "Gd": lambda: dec_to_text(self.target_dec_deg) + b"#",
            "GU": self._flags,
            "GAT": lambda: b"%d#" % mechanics.tracking,
            "GT": lambda: b"%d#" % _RATE_NUMBERS.get(mechanics.rate, 0),
            "Gm": lambda: b"N#" if mechanics.at_home else _SIDES[mechanics.pier_side()],
            "Gps": lambda: b"%d#" % (2 if mechanics.parked else 1 if mechanics.parking else 0),
            "Gh": lambda: b"1",
            "Ggr": lambda: b"%.2f#" % self.guide_rate,
            "GBu": lambda: b"%d#" % self.buzzer,
            "MS": self._slew,
            "CM": self._sync,
            "Q": self._stop,
            "Te": lambda: self._track(True),
            "Td": lambda: self._track(False),
            "hC": lambda: self._go(mechanics.home),
            "hP": lambda: self._go(mechanics.park),
            "Spu": self._unpark,
            "Sp01": self._set_park,
        }

    def _pattern(self, text: str) -> bytes | None:
        pulse = re.fullmatch(r"Mg([nsew])(\d{1,4})", text)
        if pulse is not None:
            duration_s = min(int(pulse[2]), 3000) / 1000.0
            self.mechanics.pulse(cast("Direction", pulse[1]), self.guide_rate * SIDEREAL_DEG_S, duration_s)
            return b""
        if re.fullmatch(r"M[nsew]", text):
            rate = min(_MOVE_RATES[self._move_rate] * SIDEREAL_DEG_S, self.mechanics.slew_rate_deg_s)
            self.mechanics.move(cast("Direction", text[1]), rate)
            return b""
        if re.fullmatch(r"Q[nsew]", text):
            self.mechanics.stop_move(cast("Direction", text[1]))
            return b""
        rate_name = re.fullmatch(r"R([GCMS]|\d)", text)
        if rate_name is not None:
            self._move_rate = _RATE_NAMES.get(rate_name[1]) or int(rate_name[1])
            return b""
        guide_rate = re.fullmatch(r"Rg(0\.\d{1,2})", text)
        if guide_rate is not None:
            self.guide_rate = float(guide_rate[1])
            return b""
        if text in _RATES:
            self.mechanics.rate = _RATES[text]
            return b""
        # a change of mounting waits for the next start
        return b"" if text in ("AA", "AP") else None

    def _flags(self) -> bytes:
        mechanics = self.mechanics
        letters = (
            ("n", not mechanics.tracking),
            ("N", not self.going and not mechanics.slewing()),
            ("H", mechanics.at_home and not self.going),
            ("T", mechanics.guiding()),
            ("G", True),
        )
        said = "".join(letter for letter, up in letters if up)
        return f"{said}00100000{self._move_rate}0#".encode()

    # -- orders ----------------------------------------------------------------------------------

    def _target(self) -> Apparent:
        return Apparent(self.target_ra_deg, self.target_dec_deg, utc_now())

    def _refusal(self) -> int:
        """Number of what forbids a goto or a sync; 0 is nothing."""
        mechanics, target = self.mechanics, self._target()
        if self.going:
            return _IN_GOTO
        if mechanics.slewing() or mechanics.parked:
            return _MOVING
        if not self.settings.ready:
            return _UNSET
        if mechanics.believed_altitude_deg(target) < 0.0 and mechanics.machine.lowest_altitude_deg is None:
            return _BELOW
        by_refusal = {None: 0, Refusal.BELOW_HORIZON: _BELOW}
        return by_refusal.get(mechanics.refusal(target), _LIMIT)

    def _slew(self) -> bytes:
        refusal = self._refusal()
        if refusal:
            return _error(refusal)
        tracked = self.mechanics.tracking or self.mechanics.at_home
        self.mechanics.slew(self._target())
        if not tracked:
            self.mechanics.tracking = False
        self.going = True
        return b"0"

    def _sync(self) -> bytes:
        refusal = self._refusal()
        if refusal:
            return _error(refusal)
        mechanics = self.mechanics
        side, at_home = mechanics.pier_side(), mechanics.at_home
        wanted = mechanics.destination_side(self._target())
        if not at_home and PierSide.UNKNOWN not in (side, wanted) and side is not wanted:
            return _error(_OTHER_SIDE)
        if mechanics.sync(self._target()) is not None:
            return _error(12)
        if at_home:
            mechanics.tracking = True
        return b"N/A#"

    def _stop(self) -> bytes:
        self.mechanics.stop()
        self.going = False
        return b""

    def _track(self, on: bool) -> bytes:
        if self.mechanics.parked:
            return b"0"
        self.mechanics.tracking = on
        return b"1"

    def _go(self, to_station: Callable[[], object]) -> bytes:
        if not (self.going or self.mechanics.parked):
            to_station()
            self.going = True
        return b""

    def _unpark(self) -> bytes:
        if not self.mechanics.parked:
            return b"0"
        self.mechanics.unpark()
        return b"1"

    def _set_park(self) -> bytes:
        if self.mechanics.slewing():
            return b"9"
        self.mechanics.set_park()
        return b"1"

    def _set(self, what: str, text: str) -> bytes:
        wire = text.encode("latin-1")
        try:
            if what == "Sr":
                self.target_ra_deg = ra_from_text(wire).deg
            elif what == "Sd":
                self.target_dec_deg = dec_from_text(wire).deg
            else:
                self.settings.take(what, text)
        except (Unreadable, ValueError):
            return _error(_FORMAT)
        return b"1"


AM5_FAKE = FakeDialect(
    name="am5",
    speaker=lambda fake: Am5Speaker(fake.mechanics),
    classic_too=lambda text: False,
    matched=b"N/A#",
    denials={"MS": _error(5), "CM": _error(5), "Te": b"0", "Td": b"0", "hR": b"0"},
)
