"""All members of ITelescopeV4, by verb and name."""

from __future__ import annotations

from api.alpaca.member import Member
from api.alpaca.members_abilities import MEMBERS as ABILITIES
from api.alpaca.members_common import MEMBERS as COMMON
from api.alpaca.members_parking import MEMBERS as PARKING
from api.alpaca.members_reading import MEMBERS as READING
from api.alpaca.members_site import MEMBERS as SITE
from api.alpaca.members_slewing import MEMBERS as SLEWING
from api.alpaca.members_tracking import MEMBERS as TRACKING

MEMBERS: dict[tuple[str, str], Member] = {
    (member.verb, member.name): member
    for member in (*COMMON, *ABILITIES, *READING, *SITE, *SLEWING, *PARKING, *TRACKING)
}
"""By verb and name."""
NAMES = frozenset(name for _, name in MEMBERS)

__all__ = ["MEMBERS", "NAMES"]
