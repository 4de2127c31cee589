"""Refusals: what a driver's words for one mean in any protocol, what to do about it, and our own; no I/O."""

from __future__ import annotations

import re

from mountnav.devices import OffsetRates
from mountnav.errors import DeviceRefused, Refusal

Meaning = tuple[re.Pattern[str], Refusal]
"""A pattern for a driver's words, and the reason that they stand for."""

OF_HORIZON: Meaning = (re.compile(r"horizon|altitude", re.I), Refusal.BELOW_HORIZON)
OF_PARKING: Meaning = (re.compile(r"unpark|\bparked\b", re.I), Refusal.PARKED)
OF_LIMITS: Meaning = (
    re.compile(r"limit|meridian|out ?side|out of range|over ?head|zenith", re.I),
    Refusal.LIMIT,
)

ADVICE = {
    Refusal.BELOW_HORIZON: "choose a higher target, or check clock and site of the mount",
    Refusal.PARKED: "unpark it first",
    Refusal.LIMIT: "choose another target, or look at the limits in its driver",
    Refusal.NOT_ALIGNED: "align or initialize it in its own way first",
    Refusal.NOT_TRACKING: "switch tracking on first",
    Refusal.BUSY: "wait for it, or stop it",
}
"""What an operator can do about a refusal, by its reason."""


def untrusted(what: str, why: str, *, device: str) -> DeviceRefused:
    """The driver's own refusal of an order that goes by a position which is not trusted."""
    return DeviceRefused(
        f"{what} refused: its position can't be trusted ({why})",
        device=device,
        advice="order first light if it was just set up, else recover: both look at the sky; or let "
        "it find its home",
        reason=Refusal.UNTRUSTED,
    )


def parked(what: str, *, device: str) -> DeviceRefused:
    """The driver's own refusal of a slew while parked: many mounts would move and stay "parked"."""
    return DeviceRefused(
        f"{what} refused: it is parked",
        device=device,
        advice=ADVICE[Refusal.PARKED],
        reason=Refusal.PARKED,
    )


def rates_text(rates: OffsetRates) -> str:
    """Offset rates in words, for messages."""
    return f"{rates.ra_arcsec_s:+.4f}″/s in right ascension, {rates.dec_arcsec_s:+.4f}″/s in declination"
