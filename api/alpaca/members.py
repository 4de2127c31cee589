"""All members of ITelescopeV4, by verb and name."""

from __future__ import annotations

from api.alpaca import (
    members_abilities,
    members_common,
    members_parking,
    members_reading,
    members_site,
    members_slewing,
    members_tracking,
)
from api.alpaca.member import Member

MEMBERS: dict[tuple[str, str], Member] = {
    (member.verb, member.name): member
    for room in (
        members_common,
        members_abilities,
        members_reading,
        members_site,
        members_slewing,
        members_parking,
        members_tracking,
    )
    for member in room.MEMBERS
}
NAMES = frozenset(name for _, name in MEMBERS)

__all__ = ["MEMBERS", "NAMES"]
