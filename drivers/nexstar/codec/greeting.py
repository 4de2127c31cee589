"""Which hand control answers: the questions of a greeting, and what is missing without harm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

from drivers.nexstar.codec import base
from drivers.nexstar.codec.dialect import Handset
from drivers.nexstar.codec.passthrough import Axis
from drivers.wire.command import Command

T = TypeVar("T")


class Ask(Protocol):
    """Ask one question, within a deadline."""

    async def __call__(self, command: Command[Any], deadline_s: float | None = None) -> Any:
        """Return the answer; raises `DeviceError`."""
        ...


class AskOptional(Protocol):
    """Ask what may be missing."""

    async def __call__(self, command: Command[T]) -> T | None:
        """Return the answer, or None where it is missing; raises `DeviceError`."""
        ...


@dataclass(frozen=True, slots=True)
class Greeting:
    """What was found.

    Attributes
    ----------
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


async def greet(ask: Ask, maybe: AskOptional, before: Handset) -> Greeting:
    """Ask for version, kind, model, motors and the form of a place.

    Boards that may be absent are not asked: the hand control passes the question on, and never answers.

    Parameters
    ----------
    ask : callable
        What it can't do without.
    maybe : callable
        What it may lack: None then.
    before : Handset
        Who answered last time: what an answer lost now would have said of it still counts.

    Raises
    ------
    DeviceSilent, DeviceGarbled, DeviceMissing
        If nothing on the line speaks NexStar.
    """
    handset = Handset(await ask(base.VERSION))
    if handset.version == before.version and handset.synscan == before.synscan:
        handset = before
    # the kind is reported by all StarSense, whose versions begin again, and by NexStar 5.28 and later [INDI]
    asked_kind = not handset.synscan and (handset.quarter_zones or handset.version.major < 2)
    if handset.variant is None and asked_kind:
        handset = replace(handset, variant=await maybe(base.VARIANT))
    if handset.model is None and handset.tells_model:
        model = base.SYNSCAN_MODEL if handset.synscan else base.MODEL
        handset = replace(handset, model=await maybe(model))
    percent = 50
    if not handset.synscan and handset.tells_pier_side:
        boards = [await maybe(base.device_version(axis)) for axis in (Axis.RA, Axis.DEC)]
        known = [board for board in boards if board is not None]
        if len(known) == len(boards):
            handset = replace(handset, motors=min(known))
    if handset.times_pulses:
        rate = await maybe(base.guide_rate(Axis.RA))
        percent = 50 if rate is None else max(1, min(99, round(rate)))
    return Greeting(handset, handset.short_places, percent, known=True)
