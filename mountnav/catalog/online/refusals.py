"""Why a source gave no stars: the words that an operator reads in a solution's provenance.

::

    SourceFailed
    ├── NotAnswered      no whole answer came: network, deadline, HTTP status
    ├── Unusable         an answer came that is none, or not one to rely on
    └── Overflow         more stars than one answer may hold: the tile is to be split
"""

from __future__ import annotations

from typing import ClassVar

LONGEST_QUOTE = 160


class SourceFailed(Exception):
    """One request came to nothing; `why` says it in words that follow the source's name."""

    is_servers_fault: ClassVar[bool] = True
    """The server won't do better a moment later: it is left alone for a while."""

    def __init__(self, why: str) -> None:
        self.why = why
        super().__init__(why)


class NotAnswered(SourceFailed):
    """No whole answer came."""


class Unusable(SourceFailed):
    """What came can't be relied on."""


class Overflow(SourceFailed):
    """The answer was cut by the server or by the number of rows asked for."""

    is_servers_fault = False


def quoted(text: str) -> str:
    """Somebody else's words, on one line and not too long.

    Returns
    -------
    str
        Without control characters, at most `LONGEST_QUOTE` characters.
    """
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return line if len(line) <= LONGEST_QUOTE else line[: LONGEST_QUOTE - 1] + "…"
