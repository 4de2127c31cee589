"""From the name of a protocol to a fake that speaks it: the one place that knows which fakes exist."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from datetime import datetime
from typing import Protocol, cast

from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from mountnav.errors import BadRequest
from mountnav.simulation.mechanics import Machine, Mechanics

_OWN = {
    "lx200": "drivers.lx200.faking",
    "nexstar": "drivers.nexstar.faking",
    "synscan": "drivers.nexstar.faking_synscan",
    "ioptron": "drivers.ioptron.faking",
    "skywatcher": "drivers.skywatcher.faking",
}


class Faking(Protocol):
    """What the module `faking` of a family offers."""

    DIALECTS: tuple[str, ...]
    """What its fakes can speak; the first is usual. A `MACHINE` beside it tells how such mounts are built."""

    def fake_from(
        self,
        dialect: str | None,
        mechanics: Mechanics,
        faults: Iterable[Fault],
        clock: Callable[[], datetime],
        monotonic: Callable[[], float],
    ) -> WireFake:
        """Make a fake."""
        ...


def protocols() -> list[str]:
    """Protocols that fakes speak."""
    return list(_OWN)


def dialects(protocol: str) -> tuple[str, ...]:
    """List the dialects of a protocol, the usual one first. Raises `BadRequest` if there is no such."""
    return _faking(protocol).DIALECTS


def machine(protocol: str) -> Machine:
    """How mounts of a protocol are usually built, as far as their family says. Raises `BadRequest`."""
    built: Machine = getattr(_faking(protocol), "MACHINE", Machine())
    return built


def make_fake(
    protocol: str,
    dialect: str | None,
    mechanics: Mechanics,
    *,
    faults: Iterable[Fault] = (),
    clock: Callable[[], datetime],
    monotonic: Callable[[], float],
) -> WireFake:
    """Make a fake.

    Parameters
    ----------
    protocol : str
        See `protocols`.
    dialect : str or None
        See `dialects`; the usual one if None.
    mechanics : Mechanics
        What moves behind it.
    faults : iterable of Fault
    clock, monotonic : callable
        Its own clock (aware UTC), and the seconds of its timers.

    Raises
    ------
    BadRequest
        If there is no such protocol or dialect; with what there is.
    """
    faking = _faking(protocol)
    if dialect is not None and dialect not in faking.DIALECTS:
        raise BadRequest(
            f"no fake speaks the {protocol} dialect {dialect}",
            advice=f"there is: {', '.join(faking.DIALECTS)}",
        )
    return faking.fake_from(dialect, mechanics, faults, clock, monotonic)


def _faking(protocol: str) -> Faking:
    if protocol not in _OWN:
        raise BadRequest(f"there is no fake that speaks {protocol}", advice=f"there is: {', '.join(_OWN)}")
    return cast("Faking", importlib.import_module(_OWN[protocol]))
