"""The commands by their names. What a command needs is imported when it runs."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from api.solver_commands.host import Command

_COMMANDS = {
    "astap": "astap:run",
    "astap_cli": "astap:run",
    "solve-field": "solve_field:run",
    "wcsinfo": "wcsinfo:run",
    "image2xy": "image2xy:run",
    "PlateSolve2": "platesolve:run_platesolve2",
    "PlateSolve3": "platesolve:run_platesolve3",
    "PlateSolver": "asps:run",
    "watney-solve": "watney:run",
}
"""Name as it is called, and the function in this folder. PlateSolver is the program of the All Sky Plate
Solver (ASPS)."""

NAMES = tuple(_COMMANDS)
"""All names."""

_BY_LOWER = {name.lower(): name for name in NAMES}


def known_name(name: str) -> str | None:
    """The command's name as we write it; None if there is none. Case doesn't matter, as on other systems."""
    return _BY_LOWER.get(name.lower())


def command(name: str) -> Command:
    """The command of a name in `NAMES`."""
    module, _, function = _COMMANDS[name].partition(":")
    found: Command = getattr(import_module(f"api.solver_commands.{module}"), function)
    return found
