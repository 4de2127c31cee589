"""Whether the service is ready, and if not, why not. Asks no device."""

from __future__ import annotations

from dataclasses import dataclass

from api.service import Service
from mountnav.sky.iers import iers_status


@dataclass(frozen=True, slots=True)
class Readiness:
    """What stands against taking orders, and what else is wrong.

    Attributes
    ----------
    why_not : tuple of str
        Nothing: it is ready.
    concerns : tuple of str
        What an operator should look into besides.
    """

    why_not: tuple[str, ...]
    concerns: tuple[str, ...]

    @property
    def ready(self) -> bool:
        """Whether orders are taken and can be carried out."""
        return not self.why_not

    @property
    def well(self) -> bool:
        """Whether there is nothing to look into."""
        return not self.why_not and not self.concerns


def readiness(service: Service) -> Readiness:
    """Look at what is known."""
    why_not: list[str] = []
    concerns: list[str] = []
    if (problem := service.remembering.problem) is not None:
        why_not.append(f"journal: {problem}")
    solver = service.solver.state
    if solver.startswith("failed"):
        why_not.append(f"solver: {solver}")
    elif solver == "starting":
        why_not.append("solver: it is starting")
    telescopes = service.observatory.telescopes
    missing = [one for one in telescopes if not one.is_open]
    # one of several that is missing costs the others nothing
    to = why_not if telescopes and len(missing) == len(telescopes) else concerns
    to.extend(f"{one.id}: not connected" + (f": {one.problem}" if one.problem else "") for one in missing)
    told = {one.id: one.problem or one.taking_up.fault for one in telescopes if one.is_open}
    concerns.extend(f"{one}: {words}" for one, words in told.items() if words)
    for one in telescopes:
        if one.is_open and (words := one.navigator.mount.contradiction) is not None:
            concerns.append(f"{one.id}: mount and settings contradict each other, nothing is slewed: {words}")
    warning = iers_status().warning
    if warning is not None:
        concerns.append(f"Earth rotation: {warning}")
    for name, door in service.doors.states.items():
        if door.problem is not None:
            concerns.append(f"{name}: {door.problem}")
    return Readiness(tuple(why_not), tuple(concerns))


__all__ = ["Readiness", "readiness"]
