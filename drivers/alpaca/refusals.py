"""What Alpaca's error numbers and a driver's words mean, in our errors; no I/O [Alpaca §3]."""

from __future__ import annotations

import re

from drivers.generic.refusal_words import ADVICE, OF_HORIZON, OF_LIMITS, OF_PARKING
from mountnav.errors import DeviceRefused, Refusal

NOT_IMPLEMENTED = 0x400
INVALID_VALUE = 0x401
VALUE_NOT_SET = 0x402
NOT_CONNECTED = 0x407
PARKED = 0x408
SLAVED = 0x409
INVALID_OPERATION = 0x40B
ACTION_NOT_IMPLEMENTED = 0x40C
CANCELLED = 0x40E
FIRST_OF_DRIVER = 0x500

_NUMBERS = {
    NOT_IMPLEMENTED: Refusal.UNSUPPORTED,
    ACTION_NOT_IMPLEMENTED: Refusal.UNSUPPORTED,
    PARKED: Refusal.PARKED,
    SLAVED: Refusal.BUSY,
}
_WORDS = (
    OF_HORIZON,
    (re.compile(r"not tracking|tracking (is|must)|(enable|requires) tracking", re.I), Refusal.NOT_TRACKING),
    OF_PARKING,
    OF_LIMITS,
    (re.compile(r"not aligned|align(ment)? (is|not)|star sync|initiali[sz]e", re.I), Refusal.NOT_ALIGNED),
    (re.compile(r"busy|in progress|already|is slewing|while slewing|is moving", re.I), Refusal.BUSY),
    (re.compile(r"not support|unsupported|not implemented", re.I), Refusal.UNSUPPORTED),
)  # fmt: skip
_ADVICE = ADVICE | {Refusal.UNSUPPORTED: "its driver has no such thing"}


class AlpacaRefused(DeviceRefused):
    """The device said no, with a number.

    Parameters
    ----------
    what, device, advice, reason
        As of every refusal.
    number : int
        Alpaca's; 0 where HTTP itself said no.
    words : str
        The driver's.
    """

    def __init__(
        self,
        what: str,
        *,
        device: str | None = None,
        advice: str | None = None,
        reason: Refusal = Refusal.OTHER,
        number: int = 0,
        words: str = "",
    ) -> None:
        super().__init__(what, device=device, advice=advice, reason=reason)
        self.number = number
        self.words = words

    @property
    def unsupported(self) -> bool:
        """Whether the device has no such thing at all: HTTP itself says no to members it does not know."""
        return self.reason is Refusal.UNSUPPORTED or not self.number


def reason_of(number: int, words: str) -> Refusal:
    """Which refusal a number and its words mean, as far as they tell."""
    known = _NUMBERS.get(number)
    if known is not None:
        return known
    by_words = next((reason for pattern, reason in _WORDS if pattern.search(words)), None)
    if by_words is not None:
        return by_words
    return Refusal.LIMIT if number == INVALID_VALUE else Refusal.OTHER


def refusal(what: str, number: int, words: str, device: str) -> AlpacaRefused:
    """Make the refusal of an order or a question."""
    words = " ".join(words.split())
    reason = reason_of(number, words)
    return AlpacaRefused(
        f"refused {what}: {words or 'its driver does not say why'} (Alpaca error 0x{number:X})",
        device=device,
        advice=_ADVICE.get(reason, "see what its driver says"),
        reason=reason,
        number=number,
        words=words,
    )
