"""How an LX200 mount is treated: epoch, times and the limits of belief, as values."""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.exchange import Patience
from mountnav.navigation.devices import Epoch


@dataclass(frozen=True, slots=True)
class Lx200Habits:
    """How an LX200 mount is treated.

    Attributes
    ----------
    epoch : {"apparent", "icrs"}
        Kind of coordinates; the protocol says none, JNow is the convention [LX200 Epoch].
    patience : Patience
        For one question.
    poll_s : float
        Between two looks at a running slew.
    slew_timeout_s : float
        A slew that runs longer is stopped and counts as stalled.
    stop_timeout_s : float
        Within this time after a stop the mount must be at rest.
    start_grace_s : float
        So long after the order a mount that doesn't move yet has not stalled.
    fastest_deg_s : float
        No mount moves faster (direct drives reach 30); further off than that, a reading is doubted.
    resting_arcsec : float
        Further than this from the last reading, that of a resting mount is doubted.
    drift_arcsec_s : float
        What a mount at rest may drift: a little more than the sky turns, for tracking switched off.
    """

    epoch: Epoch = "apparent"
    patience: Patience = field(default_factory=Patience)
    poll_s: float = 0.5
    slew_timeout_s: float = 300.0
    stop_timeout_s: float = 20.0
    start_grace_s: float = 3.0
    fastest_deg_s: float = 40.0
    resting_arcsec: float = 120.0
    drift_arcsec_s: float = 20.0
