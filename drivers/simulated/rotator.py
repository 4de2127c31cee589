"""A rotator without hardware, as a language over its mechanics: for tests, demonstrations and the proofs."""

from __future__ import annotations

from drivers.generic.rotator import GenericRotator, RotatorTiming, Told
from drivers.wire.wire_log import WireLog
from mountnav.clock import Clock
from mountnav.simulation.rotator_mechanics import RotatorMechanics

__all__ = ["SimulatedRotatorLanguage", "simulated_rotator"]


class SimulatedRotatorLanguage:
    """A `drivers.generic.rotator.RotatorLanguage` that asks its mechanics."""

    def __init__(self, mechanics: RotatorMechanics, name: str = "simulated rotator") -> None:
        self.mechanics = mechanics
        self._name = name
        self._log = WireLog()
        self.usable = False
        self.reversed: bool | None = None

    @property
    def name(self) -> str:
        """Name, for messages."""
        return self._name

    @property
    def log(self) -> WireLog:
        """Empty: there is no wire."""
        return self._log

    @property
    def step_deg(self) -> float:
        """Its coarsest step."""
        return self.mechanics.behavior.step_deg

    async def open(self) -> None:
        """Be there."""
        self.usable = True

    async def close(self) -> None:
        """Be gone."""
        self.usable = False

    async def read(self) -> Told:
        """Its count, and whether it turns."""
        return Told(self.mechanics.count_deg, self.mechanics.moving)

    async def order(self, mechanical_deg: float) -> None:
        """Begin to turn."""
        self.mechanics.turn(mechanical_deg)

    async def send_stop(self) -> None:
        """Stop."""
        self.mechanics.stop()


def simulated_rotator(
    mechanics: RotatorMechanics, clock: Clock, *, name: str = "simulated rotator"
) -> GenericRotator:
    """A whole rotator over mechanics, in their clock's time."""
    return GenericRotator(SimulatedRotatorLanguage(mechanics, name), timing=RotatorTiming(), clock=clock)
