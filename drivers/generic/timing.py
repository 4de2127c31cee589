"""How a mount is treated in time and by how far it is believed: values that a URL may set."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Timing:
    """Times and limits of belief of one mount.

    Attributes
    ----------
    poll_s : float
        Between two looks at a mount that moves, and between two stops.
    slew_timeout_s : float
        A slew that runs longer is stopped and counts as stalled.
    stall_s : float
        A mount that says it is slewing and stays where it is for so long is stopped and has stalled.
    stop_timeout_s : float
        Within this time after a stop the mount must be at rest.
    start_grace_s : float
        So long after an order a mount that doesn't move yet has not stalled.
    rest_s : float
        So long at rest beside its place a mount has stalled: it may pause on its way.
    sync_wait_s : float
        So long a sync may take to show.
    late_s : float
        Later than that after its answer it counts as late.
    heartbeat_s : float
        An idle mount is read so often; 0 leaves it alone (and a dead one is noticed by the next order only).
    silence_s : float
        A question unanswered for so long is announced as a silent link.
    lost_after_s : float
        A silence of so long counts as a lost link.
    backoff_s, longest_backoff_s : float
        Wait before the first and at most before any later attempt to connect again.
    fastest_deg_s : float
        No mount moves faster (direct drives reach 30).
    acceleration_deg_s2 : float
        What it may gain in speed between two looks.
    resting_arcsec : float
        Further than this from the last reading (and two steps of the wire), that of a resting mount is
        doubted: it is asked again.
    drift_arcsec_s : float
        What a mount at rest may drift: a little more than the sky turns, for tracking switched off.
    near_arcsec : float
        A slew has arrived when it rests so near to its place, or within two steps of the wire if more.
    """

    poll_s: float = 0.5
    slew_timeout_s: float = 300.0
    stall_s: float = 15.0
    stop_timeout_s: float = 20.0
    start_grace_s: float = 3.0
    rest_s: float = 1.5
    sync_wait_s: float = 3.0
    late_s: float = 1.0
    heartbeat_s: float = 0.5
    silence_s: float = 1.2
    lost_after_s: float = 6.0
    backoff_s: float = 0.5
    longest_backoff_s: float = 30.0
    fastest_deg_s: float = 40.0
    acceleration_deg_s2: float = 8.0
    resting_arcsec: float = 5.0
    drift_arcsec_s: float = 20.0
    near_arcsec: float = 30.0
