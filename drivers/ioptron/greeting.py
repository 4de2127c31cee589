"""How a command set is told from another: `:GLS#` is in both, and its length differs. No wire, no clock."""

from __future__ import annotations

from drivers.ioptron import values, values_v2
from drivers.ioptron.codec import V3
from drivers.ioptron.codec_v2 import V2
from drivers.ioptron.replies import signed_text
from drivers.ioptron.words import Words
from drivers.wire.command import Command

DIALECTS: dict[str, Words] = {words.name: words for words in (V3, V2)}


def _words(text: bytes) -> Words:
    if len(text) == 23:
        values.status_from_text(text)
        return V3
    values_v2.status_from_text(text)
    return V2


GREETING: Command[Words] = Command(
    b":GLS#", "site and status, in the words of either set", signed_text((19, 23), _words)
)
