"""How a German mount on a Sky-Watcher controller is driven: values that its URL may set."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SkywatcherSettings:
    """Limits and rates that the controller doesn't know.

    Attributes
    ----------
    past_meridian_deg : float
        So far the counterweight may be driven above the horizontal by a slew, to keep the side.
    tracking_past_deg : float
        So far it may rise by tracking; then tracking is stopped.
    lowest_altitude_deg : float
        No slew goes below.
    guide_rate : float
        Of guide pulses, in sidereal rates, below 1.
    near_arcsec : float
        A slew is refined until it is so near.
    goto_deg_s, goto_deg_s2 : float
        Rate and acceleration of the board's own gotos, as far as known: a target is met where it will be.
    settle_s : float
        So long after the last stop tracking is begun again; longer than the pause between two stops of one.
    """

    past_meridian_deg: float = 1.0
    tracking_past_deg: float = 10.0
    lowest_altitude_deg: float = 0.0
    guide_rate: float = 0.5
    near_arcsec: float = 0.7
    goto_deg_s: float = 3.4
    goto_deg_s2: float = 2.2
    settle_s: float = 1.2
