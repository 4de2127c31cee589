"""What is refused over Alpaca, and by which number; our own problems as such errors. No I/O [Alpaca §3]."""

from __future__ import annotations

from enum import IntEnum

from api.problems import Problem


class Number(IntEnum):
    """The error numbers of the standard."""

    OK = 0x0
    NOT_IMPLEMENTED = 0x400
    INVALID_VALUE = 0x401
    VALUE_NOT_SET = 0x402
    NOT_CONNECTED = 0x407
    PARKED = 0x408
    INVALID_OPERATION = 0x40B
    ACTION_NOT_IMPLEMENTED = 0x40C
    CANCELLED = 0x40E
    DEVICE = 0x500
    """From here on numbers are the driver's own."""
    LAST = 0xFFF


class AlpacaError(Exception):
    """A request that was understood and is refused: HTTP 200 with a number and words.

    Parameters
    ----------
    number : int
        See `Number`; 0x500 to 0xFFF are our own.
    words : str
        For people, never empty.
    """

    def __init__(self, number: int, words: str) -> None:
        super().__init__(words)
        self.number = int(number)
        self.words = words


class NotTaken(AlpacaError):
    """Refused before anything was ordered of the core: nobody else has written it down."""

    @property
    def slug(self) -> str:
        """For the audit."""
        return Number(self.number).name.lower().replace("_", "-")


_OF_SLUG: dict[str, int] = {
    "busy": Number.INVALID_OPERATION,
    "leased": Number.INVALID_OPERATION,
    "lease-lost": Number.INVALID_OPERATION,
    "role-too-low": Number.INVALID_OPERATION,
    "closing": Number.INVALID_OPERATION,
    "outside-limits": Number.INVALID_OPERATION,
    "sync-refused": Number.INVALID_OPERATION,
    "offset-too-large": Number.INVALID_OPERATION,
    "model-refused": Number.INVALID_OPERATION,
    "bad-request": Number.INVALID_VALUE,
    "cancelled": Number.CANCELLED,
    "device-error": 0x500,
    "device-missing": 0x501,
    "device-silent": 0x502,
    "device-garbled": 0x503,
    "device-refused": 0x504,
    "sync-ignored": 0x505,
    "journal-failed": 0x506,
    "target-not-reached": 0x507,
    "interrupted": 0x508,
    "refused-but-done": 0x50B,
    "sync-elsewhere": 0x50C,
    "internal": 0x5FF,
}
_OTHER = 0x5FE
"""Our problems without a number of their own; the standard leaves 0x500 to 0xFFF to drivers [Alpaca §3]."""
_FAILED = 0x50A
"""A member failed for a reason that has no problem; as above."""

_OF_REFUSAL: dict[str, int] = {
    "parked": Number.PARKED,
    "unsupported": Number.NOT_IMPLEMENTED,
    "below-horizon": Number.INVALID_OPERATION,
    "limit": Number.INVALID_OPERATION,
    "busy": Number.INVALID_OPERATION,
    "untrusted": Number.INVALID_OPERATION,
    "site-or-time": Number.INVALID_OPERATION,
    "not-aligned": Number.INVALID_OPERATION,
    "not-tracking": Number.INVALID_OPERATION,
}
_ADVICE = {"busy": "wait for its end, or stop it with AbortSlew"}
"""Where what is advised goes by another face."""
_NEVER_REACHED = frozenset({"declination", "unreachable"})
"""Limits that no waiting moves: such a place is an invalid value, and not only one for now."""


def error_of(found: Problem) -> AlpacaError:
    """One of our problems as an Alpaca error: what was asked is refused for it."""
    slug = found.type.rpartition(":")[2]
    number = _OF_SLUG.get(slug, _OTHER)
    reasons = set(found.reasons or ())
    if slug == "outside-limits" and reasons & _NEVER_REACHED:
        number = Number.INVALID_VALUE
    elif slug == "device-refused":
        number = next(
            (_OF_REFUSAL[reason] for reason in found.reasons or () if reason in _OF_REFUSAL), number
        )
    return AlpacaError(number, words_of(found))


def failure_of(found: Problem) -> AlpacaError:
    """A problem that something ended with that had begun: a number of the driver's own, or cancelled [§5]."""
    error = error_of(found)
    if error.number >= Number.DEVICE or error.number == Number.CANCELLED:
        return error
    return AlpacaError(_FAILED, error.words)


def words_of(found: Problem) -> str:
    """A problem in one line."""
    text = f"{found.device}: {found.detail}" if found.device else found.detail
    advice = _ADVICE.get(found.type.rpartition(":")[2], found.advice)
    return f"{text} ({advice})" if advice else text


def not_implemented(what: str, why: str) -> NotTaken:
    """It can't do that, or is not let."""
    found = why or "this mount can't, or it can't be asked"
    return NotTaken(Number.NOT_IMPLEMENTED, f"{what} is not implemented: {found}")


def invalid_value(name: str, value: object, wanted: str) -> NotTaken:
    """A value out of its range."""
    return NotTaken(Number.INVALID_VALUE, f"{name} = {value} is not valid: {wanted}")


def invalid_operation(words: str) -> NotTaken:
    """Not now."""
    return NotTaken(Number.INVALID_OPERATION, words)


def not_set(name: str) -> NotTaken:
    """Read before it was written."""
    return NotTaken(Number.VALUE_NOT_SET, f"{name} has not been set yet")


def not_connected(name: str, why: str | None = None) -> NotTaken:
    """Connect first."""
    return NotTaken(Number.NOT_CONNECTED, f"{name} is not connected" + (f": {why}" if why else ""))


def parked(what: str) -> NotTaken:
    """Unpark first."""
    return NotTaken(Number.PARKED, f"{what} is not possible while the telescope is parked: unpark it first")


__all__ = [
    "AlpacaError",
    "NotTaken",
    "Number",
    "error_of",
    "failure_of",
    "invalid_operation",
    "invalid_value",
    "not_connected",
    "not_implemented",
    "not_set",
    "parked",
    "words_of",
]
