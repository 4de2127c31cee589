"""Who orders something, by which face, and what that caller may."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum


class Role(StrEnum):
    """What a caller may do. `solve` and `view` stand side by side; each later role includes all before it."""

    SOLVE = "solve"
    """Have images solved, and nothing else: such a key goes to a program that needs a plate solver, and sees
    no telescope."""
    VIEW = "view"
    """Read everything, change nothing."""
    OPERATE = "operate"
    """Give orders to telescopes, and send frames."""
    CONFIGURE = "configure"
    """Also what stands against the guards: trust a mount, break a lease."""

    def includes(self, other: Role) -> bool:
        """Whether this role may do what `other` may."""
        return other in _INCLUDED[self]


_INCLUDED = {
    Role.SOLVE: frozenset({Role.SOLVE}),
    Role.VIEW: frozenset({Role.VIEW}),
    Role.OPERATE: frozenset({Role.SOLVE, Role.VIEW, Role.OPERATE}),
    Role.CONFIGURE: frozenset(Role),
}
"""What each role may do of the others; a partial order, since neither of `solve` and `view` has the other."""


class Face(StrEnum):
    """By which face a caller came."""

    REST = "rest"
    ALPACA = "alpaca"
    INDI = "indi"
    LX200 = "lx200"
    STELLARIUM = "stellarium"
    NOVA = "nova"
    SERVICE = "service"
    """The service itself: the end of a lease, rain."""


@dataclass(frozen=True, slots=True)
class Caller:
    """Who orders.

    Attributes
    ----------
    name : str
        The API key's name; ``this machine`` where no keys are configured; or what the face calls its client.
    address : str
        Where it came from, for the audit.
    lease_id : str or None
        The secret of the lease that it holds.
    telescopes : frozenset of str or None
        Those that it may see and order; None: all.
    key_ends_utc : datetime or None
        When its key ends; None: never, or it has none.
    """

    name: str
    role: Role
    face: Face
    address: str = ""
    lease_id: str | None = None
    telescopes: frozenset[str] | None = None
    key_ends_utc: datetime | None = None

    def reaches(self, telescope_id: object) -> bool:
        """Whether it may see this telescope, and order of it what its role may."""
        return self.telescopes is None or telescope_id in self.telescopes


__all__ = ["Caller", "Face", "Role"]
