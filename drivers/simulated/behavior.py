"""How a simulated mount behaves on its interface: steps, delays, what it reports and refuses."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

from mountnav.devices import Epoch
from mountnav.errors import BadSettings
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import turn_deg

_FINEST_ARCSEC = 0.1
"""The resolution of a mount without steps: what the finest protocols carry. Doubled or halved, tests of fine
syncs see other tolerances."""


@dataclass(frozen=True, slots=True)
class MountBehavior:
    """What may differ from mount to mount besides the mechanics; what syncs do is `Mechanics.sync_behavior`.

    Attributes
    ----------
    epoch : {"apparent", "icrs"}
        Kind of coordinates it speaks.
    ra_step_arcsec, dec_step_arcsec : float
        Steps of commanded and reported positions, >= 0, in right ascension itself (15: one second of time)
        and in declination; 0: none.
    refuses : bool
        Whether it refuses slews below its horizon and beyond its limits (`Mechanics.refusal`); else it goes.
    tells_motion : bool
        Whether it reports that it slews, tracks or is parked.
    tells_side : bool
        Whether it reports on which side of the pier the tube hangs.
    tells_destination : bool
        Whether it says on which side the tube will hang after a slew.
    side_swapped : bool
        Whether it reports the wrong side.
    takes_rates, moves_axes : bool
        Whether it takes offset rates, and can have its axes moved by hand.
    tells_rates : bool
        Whether it says which offset rates it has.
    most_rate_arcsec_s : float
        The largest offset rate that it takes, on either axis.
    latency_s : float
        Time that a question and its answer take.
    silence_s : float
        How long an answer is waited for.
    lost_after_s : float
        A silence of so long counts as a lost link.
    again_s : float
        Time between two attempts to open a lost link.
    poll_s, stall_s, rest_s, near_arcsec, sync_wait_s, late_s : float
        As in `drivers.generic.options.Timing`.

    Raises
    ------
    BadSettings
        If a number is negative or not finite.
    """

    epoch: Epoch = "apparent"
    ra_step_arcsec: float = 0.0
    dec_step_arcsec: float = 0.0
    refuses: bool = True
    tells_motion: bool = True
    tells_side: bool = True
    tells_destination: bool = True
    side_swapped: bool = False
    takes_rates: bool = True
    moves_axes: bool = True
    tells_rates: bool = True
    most_rate_arcsec_s: float = 7200.0
    latency_s: float = 0.02
    silence_s: float = 1.5
    lost_after_s: float = 6.0
    again_s: float = 4.0
    poll_s: float = 0.5
    stall_s: float = 15.0
    rest_s: float = 1.5
    near_arcsec: float = 30.0
    sync_wait_s: float = 3.0
    late_s: float = 1.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not (math.isfinite(value) and value >= 0.0):
                raise BadSettings(f"simulated mount: {field.name} = {value}", advice=">= 0")
        if self.epoch not in ("apparent", "icrs"):
            raise BadSettings(f"simulated mount: epoch = {self.epoch!r}", advice="apparent or icrs")

    @property
    def resolution_arcsec(self) -> float:
        """Coarsest step."""
        return max(self.ra_step_arcsec, self.dec_step_arcsec, _FINEST_ARCSEC)

    def in_steps(self, place: Apparent) -> Apparent:
        """A position rounded to the steps of the wire."""
        ra_deg, dec_deg = _rounded(place.ra_deg, self.ra_step_arcsec), place.dec_deg
        return replace(
            place,
            ra_deg=turn_deg(ra_deg),
            dec_deg=max(-90.0, min(90.0, _rounded(dec_deg, self.dec_step_arcsec))),
        )

    def icrs_in_steps(self, place: Icrs) -> Icrs:
        """As `in_steps`, for a mount that speaks ICRS."""
        ra_deg, dec_deg = _rounded(place.ra_deg, self.ra_step_arcsec), place.dec_deg
        return Icrs(turn_deg(ra_deg), max(-90.0, min(90.0, _rounded(dec_deg, self.dec_step_arcsec))))


def _rounded(angle_deg: float, step_arcsec: float) -> float:
    if step_arcsec <= 0.0:
        return angle_deg
    return round(angle_deg * 3600.0 / step_arcsec) * step_arcsec / 3600.0
