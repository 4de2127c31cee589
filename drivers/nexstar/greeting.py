"""Finding out which hand control answers: a few questions, none of which changes anything."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

from drivers.nexstar import codec
from drivers.nexstar.handsets import Handset
from drivers.nexstar.passthrough import Axis
from drivers.wire.command import Command

T = TypeVar("T")


class Ask(Protocol):
    """Ask one question, within a deadline."""

    async def __call__(self, command: Command[Any], deadline_s: float | None = None) -> Any:
        """Return the answer; raises `DeviceError`."""
        ...


class Maybe(Protocol):
    """Ask what may be missing."""

    async def __call__(self, command: Command[T]) -> T | None:
        """Return the answer, or None where it is missing; raises `DeviceError`."""
        ...


@dataclass(frozen=True, slots=True)
class Greeting:
    """What was found.

    Attributes
    ----------
    handset : Handset
    short : bool
        Whether places come in four digits only.
    pulse_percent : int
        At which part of the sidereal rate the mount is set to guide.
    known : bool
        False before anyone answered.
    """

    handset: Handset
    short: bool
    pulse_percent: int = 50
    known: bool = False


async def greet(ask: Ask, maybe: Maybe, before: Handset) -> Greeting:
    """Ask for version, kind, model, motors and the form of a place.

    Boards that may be absent are not asked: the hand control passes the question on, and never answers.

    Parameters
    ----------
    ask : callable
        What it can't do without.
    maybe : callable
        What it may lack: None then.
    before : Handset
        Who answered last time: what an answer lost now would have told of it still counts.

    Raises
    ------
    DeviceSilent, DeviceGarbled, DeviceMissing
        If nothing on the line speaks NexStar.
    """
    handset = Handset(await ask(codec.VERSION))
    if handset.version == before.version and handset.synscan == before.synscan:
        handset = before
    # the kind is told by all StarSense, whose versions begin anew, and by NexStar 5.28 and later [INDI]
    asked_kind = not handset.synscan and (handset.quarter_zones or handset.version.major < 2)
    if handset.variant is None and asked_kind:
        handset = replace(handset, variant=await maybe(codec.VARIANT))
    if handset.model is None and handset.tells_model:
        model = codec.SYNSCAN_MODEL if handset.synscan else codec.MODEL
        handset = replace(handset, model=await maybe(model))
    percent = 50
    if not handset.synscan and handset.tells_pier_side:
        boards = [await maybe(codec.device_version(axis)) for axis in (Axis.RA, Axis.DEC)]
        known = [board for board in boards if board is not None]
        if len(known) == len(boards):
            handset = replace(handset, motors=min(known))
    if handset.times_pulses:
        rate = await maybe(codec.guide_rate(Axis.RA))
        percent = 50 if rate is None else max(1, min(99, round(rate)))
    return Greeting(handset, handset.short_places, percent, known=True)
