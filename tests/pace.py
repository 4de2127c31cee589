"""How fast this machine is just now: what has to be quick is judged by that, not by a clock alone."""

from __future__ import annotations

import time

_SPUN_S = 0.05
"""CPU time of one look; long enough for a busy machine to take it away."""


def slowness() -> float:
    """How many times longer than its CPU time work takes now; 1 where nobody else works."""
    begun_s, until_s = time.monotonic(), time.thread_time() + _SPUN_S
    while time.thread_time() < until_s:
        pass
    return max(1.0, (time.monotonic() - begun_s) / _SPUN_S)
