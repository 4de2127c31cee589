"""What is known of how one mount keeps rates: which correction it needs, whether the sky has confirmed it.

A correction is tried once a fault has been named, confirmed by the looks after it, written down and recalled
at a restart; it is withdrawn as soon as looks contradict it, and forgotten by an operator's word.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mountnav.devices import OffsetRates, PierSide
from mountnav.navigation.rates_seen import RateCorrection, RateDoubts

__all__ = ["RATES_KEPT", "RatesKept"]

RATES_KEPT = "rates-kept"
"""Name of these facts among what the journal keeps as learned."""


@dataclass
class RatesKept:
    """What is known of one mount's rates.

    Attributes
    ----------
    mount : str
        Whose; what is written down of another one isn't recalled.
    doubts : RateDoubts
        How steady it is.
    correction : RateCorrection or None
        What it is sent is made right by.
    confirmed : bool
        Whether looks have shown that it comes out right so; else it is on trial.
    words : str
        What is known, for people.
    """

    mount: str
    doubts: RateDoubts = field(default_factory=RateDoubts)
    correction: RateCorrection | None = None
    confirmed: bool = False
    words: str = "no look has shown yet how it keeps rates"

    def sent(self, wanted: OffsetRates, dec_deg: float, side: PierSide) -> OffsetRates:
        """What to send for the mount to keep `wanted`."""
        correction = self.correction
        if correction is None or not correction.holds(side) or wanted.none:
            return wanted
        return correction.sent(wanted, dec_deg)

    def kept(self, sent: OffsetRates, dec_deg: float, side: PierSide) -> OffsetRates:
        """What the mount makes of what it is sent, as far as is known."""
        correction = self.correction
        if correction is None or not correction.holds(side):
            return sent
        return correction.kept(sent, dec_deg)

    def try_on(self, correction: RateCorrection) -> None:
        """Send what a named fault asks for, until looks confirm or contradict it."""
        self.correction, self.confirmed = correction, False
        self.words = f"on trial: {correction.words}"

    def confirm(self) -> None:
        """Looks have shown that rates come out right, as they are sent."""
        if self.correction is not None:
            self.confirmed = True
            self.words = f"confirmed: {self.correction.words}"

    def withdraw(self, why: str) -> None:
        """Send rates as they are again."""
        self.correction, self.confirmed = None, False
        self.words = why

    def as_dict(self) -> dict[str, Any]:
        """As JSON values."""
        correction = None if self.correction is None else self.correction.as_dict()
        return {
            "mount": self.mount,
            "correction": correction,
            "confirmed": self.confirmed,
            "words": self.words,
        }

    def restore(self, data: Mapping[str, Any]) -> None:
        """Take over what `as_dict` gave of this mount, if it was confirmed; else there is none."""
        if data.get("mount") != self.mount:
            return
        given, words = data.get("correction"), data.get("words")
        correction = RateCorrection.of_dict(given) if isinstance(given, Mapping) else None
        if correction is None or data.get("confirmed") is not True:
            self.correction, self.confirmed = None, False
            return
        self.correction, self.confirmed = correction, True
        self.words = words if isinstance(words, str) and words else f"confirmed: {correction.words}"
