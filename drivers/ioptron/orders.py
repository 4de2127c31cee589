"""What drivers say to an iOptron mount, understood from the mount's side: a name and its text, or nothing."""

from __future__ import annotations

import re
from dataclasses import dataclass

# of both sets
_BARE = "MountInfo|FW1|FW2|GLS|AG|GMT|GAC|GPC|GAL|GPE|GSR|CM|MP0|MP1|MH|MSH|Q|qR|qD|mn|ms|me|mw"
_WITH_TEXT = (
    r"(?:SPA)(?P<turn>[0-9]{9})|(?:Sd)(?P<angle>[+-][0-9]{8})|SPH(?P<altitude>[0-9]{8})"
    r"|SG(?P<offset>[+-][0-9]{3})|(?:SDS|SHE|ST)(?P<switch>[01])|RT(?P<rate>[0-4])|RG(?P<guide>[0-9]{4})"
    r"|SR(?P<speed>[1-9])|SMT(?P<meridian>[0-9]{3})|SAL(?P<limit>[+-][0-8][0-9])"
    r"|RR(?P<custom>[0-9]{5})"
)
_V3 = (
    r"GEP|GUT|GTR|QAP|MS1|MS2"
    r"|SRA(?P<ra>[0-9]{9})|(?:SLO|SLA)(?P<site>[+-][0-9]{8})|SUT(?P<time>[0-9]{13})"
    # `:M…` is deprecated [IOPTRON310], INDI's later drivers and 1.9.9 guide by `:Z…`
    r"|(?:M[nsew]|Z[SQEC])(?P<pulse>[0-9]{5})"
)
_V2 = (
    # `:GAS#`, `:Gg#`, `:Gt#` are of older firmware, whose driver is indi_ieqlegacy_telescope
    r"V|GEC|GEA|GLT|GAS|Gg|Gt|MS|q"
    r"|Sr(?P<ra>[0-9]{8})|S[gt](?P<site>[+-][0-9]{6})|S[CL](?P<time>[0-9]{6})|M[nsew](?P<pulse>[0-9]{5})"
)
_ORDERS = {
    name: re.compile(f":(?:{_BARE}|{_WITH_TEXT}|{own})#".encode("ascii"))
    for name, own in (("v3", _V3), ("v2", _V2))
}


@dataclass(frozen=True, slots=True)
class Order:
    """One order or question: its letters, and the digits that follow them (empty where none do)."""

    name: str
    text: bytes


def order_from_text(command: bytes, dialect: str = "v3") -> Order | None:
    """Take a whole command apart; None when a mount of this set doesn't know it."""
    match = _ORDERS[dialect].fullmatch(command)
    if match is None:
        return None
    words = command[1:-1]
    texts = [text for text in match.groups() if text is not None]
    text = texts[0] if texts else b""
    return Order(words[: len(words) - len(text)].decode("ascii"), text)
