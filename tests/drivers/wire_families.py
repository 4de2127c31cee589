"""The families that the common fuzz drives, and what it must know of each."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from drivers.ioptron.language import IoptronLanguage
from drivers.lx200.codec.greeting import dialect_named
from drivers.lx200.language import Lx200Language
from drivers.nexstar.language import NexstarLanguage
from drivers.registry import fake_machine, fakes
from drivers.skywatcher.language import SkywatcherLanguage
from mountnav.simulation.mechanics import Machine
from tests.drivers.wire_fuzz import HERE, Family

_MOTORS = Machine(mounting="german", starts_at="home", tracks_at_start=False)


def _aligned(fake: Any) -> None:
    fake.aligned = True


def family(protocol: str, dialect: str | None = None) -> Family:
    """A family as the fuzz takes it; the dialect is the fake's, the driver finds it out."""
    other = fakes(protocol)
    made = Family(protocol, dialect, Lx200Language, other.moves, other.stops, machine=fake_machine(protocol))
    match protocol:
        case "nexstar":
            return replace(made, language=NexstarLanguage, recover=_aligned, reads_rates=False)
        case "synscan":
            return replace(made, language=lambda link: NexstarLanguage(link, epoch="icrs"), recover=_aligned)
        case "ioptron":
            return replace(made, language=IoptronLanguage)
        case "skywatcher":
            return replace(
                made, language=lambda link: SkywatcherLanguage(link, HERE), machine=_MOTORS, syncs=False
            )
    return made


def told_dialect(protocol: str, dialect: str) -> Family:
    """As `family`, the driver being told the dialect."""
    return replace(
        family(protocol, dialect), language=lambda link: Lx200Language(link, dialect_named(dialect))
    )
