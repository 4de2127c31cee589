"""Motion keys of LX200 apps: ``:Mn#`` moves until ``:Qn#``, as fast as ``:RG#`` ... ``:RS#`` has chosen.

Some apps open a connection for each command, so keys belong to a machine, not to a connection: what it moves
goes on as long as something is heard of it (apps ask for the position once a second), and no longer than the
settings have it. LX200 has no answer to a key, so a refusal is only written down.
"""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass, field

from api.access.callers import Caller
from api.orders.dispatcher import Dispatcher
from api.orders.goto_orders import NotTaken
from api.orders.kept_motions import KeptAxes, ladder
from api.problems import Problem
from mountnav.devices import MountAxis, Skill
from mountnav.settings.faces import Lx200ServerSettings

_log = logging.getLogger(__name__)

_SIDES: dict[str, tuple[MountAxis, float]] = {
    "n": ("secondary", 1.0),
    "s": ("secondary", -1.0),
    "e": ("primary", 1.0),
    "w": ("primary", -1.0),
}
"""Which axis a key moves, and to which side: east is greater right ascension, or azimuth."""
_SPEEDS = "GCMS"
"""Letters of the speeds, from slow to fast: guide, center, find, slew [LX200 :RG#]."""


@dataclass(slots=True)
class Pad:
    """What a machine has chosen, and when it was heard last.

    Attributes
    ----------
    speed : int
        Index of `_SPEEDS`.
    """

    speed: int = 2
    heard_s: float = field(default=0.0)

    def choose(self, letter: str) -> None:
        """``:RG#`` and the like; a letter that is none is left alone."""
        if (found := _SPEEDS.find(letter)) >= 0:
            self.speed = found

    def heard(self) -> None:
        """Something came from it."""
        self.heard_s = asyncio.get_running_loop().time()


class Lx200Keys:
    """Moves one telescope's axes by the keys of all machines."""

    def __init__(self, dispatcher: Dispatcher, telescope_id: str, settings: Lx200ServerSettings) -> None:
        self._mount = dispatcher.telescope(telescope_id).navigator.mount
        self._id = telescope_id
        self._settings = settings
        self._axes = KeptAxes(dispatcher, telescope_id, most_s=settings.move_axis_s, ended=self._ended)

    def moves(self, side: str) -> bool:
        """Whether the key of that side, or its opposite, moves an axis."""
        return _SIDES[side][0] in self._axes.rates_deg_s

    async def press(self, caller: Caller, pad: Pad, side: str) -> None:
        """A key is pressed."""
        axis, sign = _SIDES[side]
        if Skill.MOVE_AXIS not in self._mount.skills:
            return
        most_deg_s = self._mount.following_policy.most_axis_deg_s
        speeds = ladder(self._mount.axis_rates_deg_s.get(axis, ()), most_deg_s)
        if not speeds:
            return

        def lives() -> str | None:
            silence_s = self._settings.silence_s
            silent = asyncio.get_running_loop().time() - pad.heard_s > silence_s
            return f"its machine was silent for {silence_s:g} s" if silent else None

        try:
            await self._axes.move(caller, axis, sign * speeds[pad.speed], lives)
        except NotTaken as refusal:
            _log.warning("%s: the key %s of %s moves nothing: %s", self._id, side, caller.name, refusal)

    async def release(self, caller: Caller, side: str) -> None:
        """It is released: the axis is ended, whichever of its two keys was meant."""
        try:
            await self._axes.end(caller, _SIDES[side][0])
        except NotTaken as refusal:
            _log.error("%s: %s could not be ended, it ends by itself: %s", self._id, side, refusal)

    def stopped(self) -> None:
        """Everything is stopped: no key counts any more."""
        self._axes.forget()

    async def close(self) -> None:
        """End what is moved."""
        await self._axes.close()

    def _ended(self, axis: MountAxis, why: str, problem: Problem | None) -> None:
        _log.warning("%s: the motion of the %s axis by a key has ended: %s", self._id, axis, why)


__all__ = ["Lx200Keys", "Pad"]
