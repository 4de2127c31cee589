"""The other end of an LX200 cable: bytes in, bytes out, over the mechanics of a telescope that points wrong.

It speaks the classic dialect as recorded between the real INDI drivers and a mount [LX200]; what a classic
doesn't know it answers with silence, as real ones do. It does no I/O: `drivers.bench` puts it on a wire.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from datetime import datetime, timedelta
from typing import cast

from drivers.command import Unreadable
from drivers.lx200.angles import (
    dec_from_text,
    dec_to_text,
    longitude_from_text,
    longitude_to_text,
    ra_from_text,
    ra_to_text,
)
from drivers.lx200.faults import Fault
from mountnav.simulation.mechanics import Direction, Mechanics
from mountnav.sky.coordinates import Apparent, utc_now

_ACK = 0x06
_LONGEST_COMMAND = 40
_GUIDE_RATE_DEG_S = 15.0 / 3600.0
_RATES_DEG_S = {"G": _GUIDE_RATE_DEG_S, "C": 16 * _GUIDE_RATE_DEG_S, "M": 1.0}
_TRACKING_HZ = {"Q": b"60.1", "L": b"57.9", "S": b"60.0", "M": b"60.1"}
_PRODUCT = {"P": b"LX200 Classic", "N": b"3.37", "D": b"Nov 21 2026", "T": b"12:00:00", "F": b"ETX 3.37"}
_UTC_OFFSET = re.compile(r"([+-]?\d{1,2})(?:\.(\d)|:(\d{2}))?")


class FakeLx200:
    """A classic LX200 on the wire.

    Parameters
    ----------
    mechanics : Mechanics
        What moves, and what it believes of itself.
    short : bool
        Whether it starts in the short format (``HH:MM.T``).
    lowest_altitude_deg : float
        Targets below are refused as under the horizon.
    faults : iterable of Fault
        What goes wrong; may be changed while it runs.
    clock : callable
        Aware UTC of the mount's own clock.
    monotonic : callable
        Seconds, for late answers and timed pulses.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        *,
        short: bool = False,
        lowest_altitude_deg: float = 0.0,
        faults: Iterable[Fault] = (),
        clock: Callable[[], datetime] = utc_now,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self.mechanics = mechanics
        self.faults = list(faults)
        self.unknown: list[bytes] = []
        self.heard: list[bytes] = []
        self._short = short
        self._lowest_altitude_deg = lowest_altitude_deg
        self._clock = clock
        self._monotonic = monotonic
        self._buffer = b""
        self._late: list[tuple[float, bytes]] = []
        self._pulses: list[tuple[float, Direction]] = []
        self._high_precision_pointing = False
        self._target_ra_deg: float | None = None
        self._target_dec_deg: float | None = None
        self._rate_deg_s = mechanics.slew_rate_deg_s
        self._tracking_hz = b"60.1"
        self._longitude_deg = mechanics.site.longitude_deg
        self._latitude_deg = mechanics.site.latitude_deg
        self._hours_to_utc = 0.0
        self._clock_wrong = timedelta(0)

    def feed(self, data: bytes) -> bytes:
        """Take bytes from the driver and return what the mount says now (also answers that were late)."""
        self._end_pulses()
        self._buffer += data
        answers = self._due()
        for command in self._commands():
            answers += self._answer(command)
        return answers

    def due_in_s(self) -> float | None:
        """Seconds until `feed` has something to do without new bytes; None when there is nothing."""
        dues = [due for due, _ in self._late] + [due for due, _ in self._pulses]
        return max(0.0, min(dues) - self._monotonic()) if dues else None

    # -- the wire --------------------------------------------------------------------------------

    def _commands(self) -> Iterable[bytes]:
        """Cut the buffer into commands; a lone `#` and noise between commands are nothing [LX200 link]."""
        while self._buffer:
            if self._buffer[0] == _ACK:
                self._buffer = self._buffer[1:]
                yield bytes([_ACK])
            elif self._buffer[0] != ord(":"):
                self._buffer = self._buffer[1:]
            else:
                end = self._buffer.find(b"#")
                if end < 0:
                    if len(self._buffer) > _LONGEST_COMMAND:
                        self._buffer = self._buffer[1:]
                        continue
                    return
                command, self._buffer = self._buffer[: end + 1], self._buffer[end + 1 :]
                yield command

    def _answer(self, command: bytes) -> bytes:
        self.heard.append(command)
        # all count, the first that strikes is the one that happens
        fault = next(iter([fault for fault in self.faults if fault.strikes(command)]), None)
        if fault is not None and fault.kind == "deaf":
            return self._sent(self._deaf(command), 0.0)
        reply = self._carry_out(command)
        if fault is not None and reply:
            return self._sent(fault.spoil(reply), fault.delay_s if fault.kind == "late" else 0.0)
        return self._sent(reply, 0.0)

    def _sent(self, reply: bytes, delay_s: float) -> bytes:
        """Send now or later; answers never overtake each other."""
        if not reply:
            return b""
        if not self._late and delay_s <= 0:
            return reply
        earliest = self._late[-1][0] if self._late else 0.0
        self._late.append((max(earliest, self._monotonic() + delay_s), reply))
        return b""

    def _due(self) -> bytes:
        now = self._monotonic()
        ready = b"".join(reply for due, reply in self._late if due <= now)
        self._late = [(due, reply) for due, reply in self._late if due > now]
        return ready

    def _end_pulses(self) -> None:
        now = self._monotonic()
        for due, direction in self._pulses:
            if due <= now:
                self.mechanics.stop_move(direction)
        self._pulses = [pulse for pulse in self._pulses if pulse[0] > now]

    # -- the meaning -----------------------------------------------------------------------------

    def _deaf(self, command: bytes) -> bytes:
        return {b":CM#": _MATCHED, b":MS#": b"0"}.get(command, b"1" if command[1:2] == b"S" else b"")

    def _carry_out(self, command: bytes) -> bytes:
        if command == bytes([_ACK]):
            return b"P"
        text = command[1:-1].decode("latin-1")
        try:
            reply = self._known(text)
        except (Unreadable, ValueError):
            return b"0"
        if reply is None:
            self.unknown.append(command)
            return b""
        return reply

    def _known(self, text: str) -> bytes | None:
        """Carry out one command and return its reply; None when a classic doesn't know it."""
        if text[:2] in ("Sr", "Sd", "St", "Sg", "SG", "SL", "SC"):
            return self._set(text[:2], text[2:].strip())
        if text[:1] == "G":
            return self._get(text[1:])
        if text[:1] == "M":
            return self._move(text[1:])
        if text[:1] == "Q" and text[1:] in ("", "n", "s", "e", "w"):
            if text[1:]:
                self.mechanics.stop_move(cast("Direction", text[1:]))
            else:
                self.mechanics.stop()
            return b""
        if text[:1] == "R" and text[1:] in ("G", "C", "M", "S"):
            self._rate_deg_s = _RATES_DEG_S.get(text[1:], self.mechanics.slew_rate_deg_s)
            return b""
        if text[:1] == "T" and text[1:] in _TRACKING_HZ:
            self._tracking_hz = _TRACKING_HZ[text[1:]]
            return b""
        return self._other(text)

    def _other(self, text: str) -> bytes | None:
        if text == "D":
            return b"\x7f#" if self.mechanics.slewing() else b"#"
        if text == "CM":
            target = self._target()
            if target is not None:
                self.mechanics.sync(target)
            return _MATCHED
        if text == "U":
            self._short = not self._short
            return b""
        if text == "P":
            self._high_precision_pointing = not self._high_precision_pointing
            return b"HIGH PRECISION" if self._high_precision_pointing else b"LOW  PRECISION"
        # the alignment mode is taken without an answer; these mechanics stay polar
        return b"" if text in ("AP", "AA", "AL") else None

    def _target(self) -> Apparent | None:
        if self._target_ra_deg is None or self._target_dec_deg is None:
            return None
        return Apparent(self._target_ra_deg, self._target_dec_deg, utc_now())

    def _move(self, what: str) -> bytes | None:
        if what == "S":
            target = self._target()
            if target is None:
                return b"1No object.#"
            if self.mechanics.believed_altitude_deg(target) < self._lowest_altitude_deg:
                return b"1Object below horizon.#"
            self.mechanics.slew(target)
            return b"0"
        pulse = re.fullmatch(r"g([nsew])(\d{1,5})", what)
        if pulse is not None:
            direction = cast("Direction", pulse[1])
            self.mechanics.move(direction, _GUIDE_RATE_DEG_S / 2)
            self._pulses.append((self._monotonic() + int(pulse[2]) / 1000.0, direction))
            return b""
        if what in ("n", "s", "e", "w"):
            self.mechanics.move(cast("Direction", what), self._rate_deg_s)
            return b""
        return None

    def _get(self, what: str) -> bytes | None:
        if what in ("R", "D"):
            place = self.mechanics.reported()
            if what == "R":
                return ra_to_text(place.ra_deg, short=self._short) + b"#"
            return dec_to_text(place.dec_deg, short=self._short) + b"#"
        if what[:1] == "V" and what[1:] in _PRODUCT:
            return _PRODUCT[what[1:]] + b"#"
        local = self._clock() + self._clock_wrong - timedelta(hours=self._hours_to_utc)
        answers: dict[str, Callable[[], bytes]] = {
            "r": lambda: ra_to_text(self._target_ra_deg or 0.0, short=self._short),
            "d": lambda: dec_to_text(self._target_dec_deg or 0.0, short=self._short),
            "t": lambda: dec_to_text(self._latitude_deg, short=True),
            "g": lambda: longitude_to_text(self._longitude_deg),
            "T": lambda: self._tracking_hz,
            "c": lambda: b"24",
            "M": lambda: b"Home",
            "G": lambda: b"%+03d" % round(self._hours_to_utc),
            "L": lambda: local.strftime("%H:%M:%S").encode(),
            "C": lambda: local.strftime("%m/%d/%y").encode(),
        }
        return answers[what]() + b"#" if what in answers else None

    def _set(self, what: str, text: str) -> bytes:
        """Take a value; raises `ValueError` (answered `0`) where it makes no sense."""
        wire = text.encode("latin-1")
        if what == "Sr":
            self._target_ra_deg = ra_from_text(wire).deg
        elif what == "Sd":
            self._target_dec_deg = dec_from_text(wire).deg
        elif what == "St":
            self._latitude_deg = dec_from_text(wire).deg
        elif what == "Sg":
            self._longitude_deg = longitude_from_text(wire)
        elif what == "SG":
            # hours ADDED to local time to get UTC: the opposite of an ISO offset [LX200 :SG#]
            match = _UTC_OFFSET.fullmatch(text)
            if match is None:
                raise Unreadable(f"{text!r} is no UTC offset")
            part = int(match[2] or 0) / 10 + int(match[3] or 0) / 60
            self._hours_to_utc = int(match[1]) + (-part if text.startswith("-") else part)
        else:
            return self._set_clock(what, text)
        return b"1"

    def _set_clock(self, what: str, text: str) -> bytes:
        """Set the mount's own clock; the mechanics keep theirs."""
        offset = timedelta(hours=self._hours_to_utc)
        local = self._clock() + self._clock_wrong - offset
        given = datetime.strptime(text, "%H:%M:%S" if what == "SL" else "%m/%d/%y")
        if what == "SL":
            wanted = local.replace(hour=given.hour, minute=given.minute, second=given.second)
            self._clock_wrong += wanted - local
            return b"1"
        self._clock_wrong += local.replace(year=given.year, month=given.month, day=given.day) - local
        return b"1Updating        Planetary Data#" + b" " * 30 + b"#"


_MATCHED = b"Coordinates     matched.        #"
