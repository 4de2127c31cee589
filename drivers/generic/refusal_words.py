"""What drivers' words and reasons of a refusal mean in any protocol, and what to do about it; no I/O."""

from __future__ import annotations

import re

from mountnav.errors import Refusal

Meaning = tuple[re.Pattern[str], Refusal]

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
"""Where its driver's words are all there is, one is to see what these say."""
