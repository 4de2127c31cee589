"""Whether a client of the INDI server is still there, as far as that can be known.

INDI's clients say a thing once: a key is pressed, rates are set. Their connection outlives them where the
network was cut, where they hang, and where an `indiserver` stands between. So a client that has something
going on is asked (`pingRequest`), and what it says, or that it answers, is what shows that it lives.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

__all__ = ["ClientLife"]

_ASKED_IN_VAIN = 4
"""A client that has left so many questions unanswered, and never answered one, knows none: an old program.
Doubled, it writes twice as many complaints into its log."""


class ClientLife:
    """What is known of one client's life. Used from the event loop's thread alone.

    Parameters
    ----------
    ask : callable
        Sends it a question; given its number.
    silence_s : float
        A client that answers questions counts as gone when it has said nothing for so long, s.

    Attributes
    ----------
    through_a_server : bool
        Whether another `indiserver` may stand between: that one answers for whoever is behind it.
    """

    def __init__(self, ask: Callable[[str], None], silence_s: float) -> None:
        self.through_a_server = False
        self._ask = ask
        self._most_silent_s = silence_s
        self._said_s = self._answered_s = asyncio.get_running_loop().time()
        self._asked = 0
        self._answers = False

    def said(self) -> None:
        """It has said something by itself: a question, or an order."""
        self._said_s = asyncio.get_running_loop().time()

    def answered(self) -> None:
        """It has answered a question."""
        self._answers = True
        self._answered_s = asyncio.get_running_loop().time()

    def silent_s(self) -> float:
        """For how long nothing was heard of it, s; and ask again.

        An answer doesn't count where a server may have given it: who set rates through it may be long gone.
        """
        self._question()
        last_s = self._said_s if self.through_a_server else max(self._said_s, self._answered_s)
        return asyncio.get_running_loop().time() - last_s

    def why_gone(self) -> str | None:
        """Why what it holds down has to end; None while it may go on. Asks again."""
        self._question()
        if not self._answers:
            return None  # it has never answered: by this it can't be known
        silence_s = asyncio.get_running_loop().time() - max(self._said_s, self._answered_s)
        late = silence_s > self._most_silent_s
        return f"its client answered nothing for {self._most_silent_s:g} s" if late else None

    def _question(self) -> None:
        if self._answers or self._asked < _ASKED_IN_VAIN:
            self._asked += 1
            self._ask(str(self._asked))
