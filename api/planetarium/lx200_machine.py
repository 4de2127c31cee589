"""What an LX200 app has set, half by half: a target is a pair, and a half that was refused leaves none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Literal

from api.orders.targets import ApparentTarget
from api.planetarium.lx200_words import app_declination, app_right_ascension
from drivers.lx200.angles import dec_from_text, ra_from_text
from drivers.wire.command import Unreadable
from mountnav.sky.coordinates import utc_now

Half = Literal["r", "d"]
_READERS: dict[Half, Callable[[bytes], float]] = {
    "r": lambda wire: ra_from_text(app_right_ascension(wire)).deg,
    "d": lambda wire: dec_from_text(app_declination(wire)).deg,
}
_TOGETHER = timedelta(seconds=30)
"""Halves that were set further apart are of two targets: a place between them was never meant."""


@dataclass(frozen=True, slots=True)
class _Set:
    deg: float
    utc: datetime


class Aim:
    """A target, of date.

    Parameters
    ----------
    lives : timedelta or None
        How long it counts; None: until another one is set, as on a real mount.
    """

    def __init__(self, lives: timedelta | None = None) -> None:
        self._lives = lives
        self._halves: dict[Half, _Set] = {}

    def set(self, half: Half, wire: bytes) -> None:
        """Take ``:Sr`` or ``:Sd``.

        Raises
        ------
        Unreadable
            It is none; what was set of that half before is forgotten, or an app that doesn't look at the
            answer would be sent to one target's right ascension and another's declination.
        """
        self._halves.pop(half, None)
        self._halves[half] = _Set(_READERS[half](wire), utc_now())

    def target(self) -> ApparentTarget | None:
        """Both halves, if they are of one target that counts still."""
        ra, dec = self._halves.get("r"), self._halves.get("d")
        if ra is None or dec is None or abs(ra.utc - dec.utc) > _TOGETHER:
            return None
        if self._lives is not None and utc_now() - min(ra.utc, dec.utc) > self._lives:
            return None
        return ApparentTarget(ra_deg=ra.deg % 360.0, dec_deg=dec.deg)


@dataclass(slots=True)
class Machine:
    """What is kept for the programs of one machine: some open a connection for each command.

    Attributes
    ----------
    aim : Aim
    hours_to_utc : float or None
        Its zone, as told.
    """

    aim: Aim = field(default_factory=lambda: Aim(_TOGETHER))
    hours_to_utc: float | None = None


@dataclass(slots=True)
class Aims:
    """The target of one connection: its own, else its machine's."""

    machine: Machine
    own: Aim = field(default_factory=Aim)
    spoiled: bool = False
    """A half was refused: another program's target is not what was meant."""

    def set(self, half: Half, wire: bytes) -> None:
        """Take ``:Sr`` or ``:Sd``. Raises `Unreadable`; then there is no target."""
        refused: Unreadable | None = None
        for aim in (self.own, self.machine.aim):
            try:
                aim.set(half, wire)
            except Unreadable as error:
                refused = error
        if refused is not None:
            self.spoiled = True
            raise refused
        self.spoiled = self.spoiled and self.own.target() is None

    def target(self) -> ApparentTarget | None:
        """Where this connection wants to go."""
        own = self.own.target()
        return own if own is not None or self.spoiled else self.machine.aim.target()


__all__ = ["Aim", "Aims", "Half", "Machine"]
