"""The JSON around each answer: exactly the standard's keys, never one more. No I/O [Alpaca §2]."""

from __future__ import annotations

import json
import math

from api.alpaca.parameters import LARGEST_ID
from api.alpaca.refusals import AlpacaError


class Transactions:
    """Counts the server's transactions: 1, 2, ... and from the largest number of 32 bits back to 1."""

    def __init__(self, last: int = 0) -> None:
        self._last = last

    def next(self) -> int:
        """The next number."""
        self._last = 1 if self._last >= LARGEST_ID else self._last + 1
        return self._last


class _Nothing:
    pass


NOTHING = _Nothing()
"""For answers without a value: those to a PUT."""


def envelope(
    client_transaction: int,
    server_transaction: int,
    value: object = NOTHING,
    error: AlpacaError | None = None,
    *,
    of_device: bool = True,
) -> bytes:
    """An answer as JSON.

    Parameters
    ----------
    client_transaction, server_transaction : int
    value : object
        JSON of it must exist; left out if `NOTHING`.
    error : AlpacaError, optional
    of_device : bool
        Answers of the management have no error.

    Raises
    ------
    ValueError
        NaN or an infinity is among the values: no JSON can hold it.
    """
    answer: dict[str, object] = {} if value is NOTHING else {"Value": value}
    answer |= {"ClientTransactionID": client_transaction, "ServerTransactionID": server_transaction}
    if of_device:
        answer |= {
            "ErrorNumber": 0 if error is None else error.number,
            "ErrorMessage": "" if error is None else error.words or "refused",
        }
    return json.dumps(answer, allow_nan=False).encode()


def turned(angle: float, turn: float) -> float:
    """An angle in [0, turn): ``%`` alone gives `turn` itself for a tiny negative one [§10]."""
    rest = math.fmod(angle, turn)
    if rest < 0.0:
        rest += turn
    return 0.0 if rest >= turn else rest + 0.0


__all__ = ["NOTHING", "Transactions", "envelope", "turned"]
