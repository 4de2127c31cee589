"""What differs between iOptron's command sets, as one value per set; the language is written against it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from drivers.ioptron.codec.values import MountClock, Pointing, Status
from drivers.wire.command import Command

Heading = Literal["n", "s", "e", "w"]


@dataclass(frozen=True, slots=True)
class CommandSet:
    """The words of one command set.

    Attributes
    ----------
    name : str
        As in ``?dialect=``.
    step_arcsec : float
        Coarsest step of a place on the wire.
    status : Command
        Site and state.
    pointing : Command
        Where it points.
    has_pier_side : bool
        Whether `pointing` reports the side of the pier.
    clock_step_s : float
        By how much its reading may be behind.
    slew : Command
        To the target, in the normal posture.
    set_ra, set_dec : callable
        Take a target's degrees.
    pulse : callable
        ``pulse(heading, duration_ms)``.
    before_clock : tuple of Command
        Said before a clock is set.
    set_clock : callable
        What sets the clock to a UTC.
    set_site : callable
        What sets the site, from latitude and longitude, degrees, north and east positive.
    """

    name: str
    step_arcsec: float
    status: Command[Status]
    pointing: Command[Pointing]
    has_pier_side: bool
    clock: Command[MountClock]
    clock_step_s: float
    slew: Command[bool]
    set_ra: Callable[[float], Command[bool]]
    set_dec: Callable[[float], Command[bool]]
    pulse: Callable[[Heading, int], Command[None]]
    longest_pulse_ms: int
    before_clock: tuple[Command[bool], ...]
    set_clock: Callable[[datetime], tuple[Command[bool], ...]]
    set_site: Callable[[float, float], tuple[Command[bool], ...]]
