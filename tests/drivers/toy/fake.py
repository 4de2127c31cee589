"""A toy that isn't there: the other end of its cable, over the mechanics of a telescope."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import datetime

from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from drivers.family import Fakes
from mountnav.errors import Refusal
from mountnav.simulation.mechanics import Machine, Mechanics
from mountnav.sky.coordinates import Apparent
from tests.drivers.toy.codec import Where, where_to_text


class FakeToy(WireFake):
    """Answers like a toy; faults, late answers and broken lines come with `WireFake`."""

    IDENTITY = (b"who",)

    def cut(self, buffer: bytes) -> tuple[bytes | None, bytes]:
        command, newline, rest = buffer.partition(b"\n")
        return (command, rest) if newline else (None, buffer)

    def carry_out(self, command: bytes) -> bytes | None:
        word, *numbers = command.decode("latin-1").split(" ")
        match word, numbers:
            case "who", []:
                return b"toy 1.0\n"
            case "where", []:
                place = self.mechanics.reported()
                where = Where(place.ra_deg, place.dec_deg, self.mechanics.slewing(), self.mechanics.tracking)
                return f"{where_to_text(where)}\n".encode()
            case "goto", [ra, dec]:
                place = self._place(ra, dec)
                # the mechanics go anywhere: what a careful controller refuses is asked first
                return self._answer(self.mechanics.refusal(place) or self.mechanics.slew(place))
            case "sync", [ra, dec]:
                return self._answer(self.mechanics.sync(self._place(ra, dec)))
            case "stop", []:
                self.mechanics.stop()
                return b""
        return None

    def deaf_reply(self, command: bytes) -> bytes:
        return b"" if command == b"stop" else b"ok\n"

    def denial(self, command: bytes) -> bytes | None:
        return b"no not now\n" if command[:4] in (b"goto", b"sync") else None

    def _place(self, ra: str, dec: str) -> Apparent:
        return Apparent(float(ra), float(dec), self._clock())

    def _answer(self, refusal: Refusal | None) -> bytes:
        return b"ok\n" if refusal is None else f"no {refusal.value.replace('-', ' ')}\n".encode()


def _make(
    dialect: str,
    mechanics: Mechanics,
    *,
    faults: Iterable[Fault],
    clock: Callable[[], datetime],
    monotonic: Callable[[], float],
) -> FakeToy:
    return FakeToy(mechanics, faults=faults, clock=clock, monotonic=monotonic)


FAKES = Fakes(
    dialects=("toy",),
    make=_make,
    moves=(b"goto", b"sync"),
    stops=(b"stop",),
    machine=Machine(lowest_altitude_deg=0.0),
)
