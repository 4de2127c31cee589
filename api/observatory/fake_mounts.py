"""The fake mounts of the service: their mechanics, and their wires in the time that this process lives in."""

from __future__ import annotations

from drivers.fakes.bench import FakeOnPty
from drivers.fakes.bench.thread import InFastTime
from drivers.registry import fake_machine, make_fake
from mountnav.clock import seconds, utc_now, virtual_time
from mountnav.settings.observatory import Settings
from mountnav.settings.telescope import MountErrorSettings, TelescopeSettings
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors

FAKE_SLEW_RATE_DEG_S = 4.0
"""Slew rate of a fake mount where the settings name none, deg/s; that of usual small mounts. Halved, every
simulated slew takes twice as long."""
GERMAN = Machine(mounting="german", meridian_limits_deg=(10.0, 10.0))
"""How a fake mount is built that is German by its settings, or by its family where they don't say: it changes
sides, 10° past the meridian at most."""
_COMMANDS_KEPT = 4_000
"""Commands that a fake of the service remembers; chosen by hand: some ten minutes of one that is read three
times a second, for who debugs it. Doubled, each fake holds some 200 kB more once it has run for hours."""


def mechanics_of(one: TelescopeSettings, settings: Settings) -> Mechanics:
    """Make what moves behind the fake mount of a telescope."""
    errors = one.mount.errors or MountErrorSettings()
    mounting = one.mount.mounting or fake_machine(one.mount.fake[0]).mounting
    return Mechanics(
        settings.site.site,
        settings.air.air,
        PointingErrors(**errors.model_dump()),
        machine=GERMAN if mounting == "german" else None,
        slew_rate_deg_s=one.mount.slew_rate_deg_s or FAKE_SLEW_RATE_DEG_S,
        acceleration_deg_s2=one.mount.acceleration_deg_s2,
    )


def fake_on_pty(protocol: str, dialect: str | None, mechanics: Mechanics) -> FakeOnPty:
    """Put a fake on a pseudo-terminal and start it, in this process's time: sky, motors and timers alike.

    Raises
    ------
    BadRequest
        If there is no such protocol or dialect.
    """
    fake = make_fake(protocol, dialect, mechanics, clock=utc_now, monotonic=seconds)
    for record in (fake.heard, fake.obeyed, fake.unknown):
        record.keep(_COMMANDS_KEPT)
    return FakeOnPty(fake if virtual_time() is None else InFastTime(fake)).start()
