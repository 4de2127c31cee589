"""The pointing model of a fake 10micron: its points are kept and counted, its pointing stays as it is."""

from __future__ import annotations

import re

from drivers.lx200.angles import dec_from_text, ra_from_text
from drivers.lx200.tenmicron_model_codec import ModelPoint
from drivers.wire.command import Unreadable
from mountnav.devices import PierSide

MOST_POINTS = 100
FEWEST_POINTS = 3
_SIDES = {b"E": PierSide.EAST, b"W": PierSide.WEST}


def point_from_text(wire: bytes) -> ModelPoint:
    """Understand ``MRA,MDEC,side,PRA,PDEC,LST`` [10MICRON :newalpt#].

    Raises
    ------
    Unreadable
        If it is no such text.
    """
    fields = wire.split(b",")
    if len(fields) != 6 or fields[2] not in _SIDES:
        raise Unreadable(f"{wire!r} is no point of a model")
    return ModelPoint(
        ra_from_text(fields[0]).deg,
        _dec(fields[1]),
        _SIDES[fields[2]],
        ra_from_text(fields[3]).deg,
        _dec(fields[4]),
        ra_from_text(fields[5]).deg,
    )


def _dec(field: bytes) -> float:
    # INDI's driver leaves out the plus
    return dec_from_text(field if field[:1] in b"+-" else b"+" + field).deg


class FakeModel:
    """The model in force, and the one that is being entered.

    Attributes
    ----------
    points : list of ModelPoint
        Of the model in force.
    entered : list of ModelPoint or None
        Since `newalig`; None when none is being entered.
    """

    def __init__(self) -> None:
        self.points: list[ModelPoint] = []
        self.entered: list[ModelPoint] | None = None
        self.saved: dict[str, list[ModelPoint]] = {}

    def say(self, text: str) -> bytes | None:
        """Answer a command of the model; None for any other."""
        if text == "newalig":
            self.entered = []
            return b"V#"
        if text.startswith("newalpt"):
            return self._add(text[7:].encode("latin-1"))
        if text == "endalig":
            return self._end()
        if text == "delalig":
            self.points = []
            return b"#"
        if text == "getalst":
            return b"%d#" % len(self.points)
        if text == "modelcnt":
            return b"%03d#" % len(self.saved)
        return self._saving(text)

    def _add(self, wire: bytes) -> bytes:
        if self.entered is None or len(self.entered) >= MOST_POINTS:
            return b"E#"
        try:
            self.entered.append(point_from_text(wire))
        except Unreadable:
            return b"E#"
        return b"%03d#" % len(self.entered)

    def _end(self) -> bytes:
        entered, self.entered = self.entered, None
        if entered is None or len(entered) < FEWEST_POINTS:
            return b"E#"
        self.points = entered
        return b"V#"

    def _saving(self, text: str) -> bytes | None:
        match = re.fullmatch(r"model(sv|ld|del)0(\S{1,15})", text)
        if match is None:
            return None
        what, name = match[1], match[2]
        if what == "sv":
            self.saved[name] = list(self.points)
            return b"1#"
        if name not in self.saved:
            return b"0#"
        if what == "ld":
            self.points = list(self.saved[name])
        else:
            del self.saved[name]
        return b"1#"
