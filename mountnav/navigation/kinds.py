"""Between ICRS and the kind of coordinates a mount speaks; the only place where navigation converts."""

from __future__ import annotations

from datetime import datetime

from mountnav.devices import Epoch
from mountnav.sky.chain import apparent_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Apparent, Icrs


def for_mount(place: Icrs, epoch: Epoch, utc: datetime) -> Apparent | Icrs:
    """`place` as a mount of `epoch` wants it: no refraction, apparent of date or ICRS [POINTING §3.4]."""
    return place if epoch == "icrs" else icrs_to_apparent(place, utc)


def from_mount(place: Apparent | Icrs) -> Icrs:
    """A mount's reading as ICRS."""
    return place if isinstance(place, Icrs) else apparent_to_icrs(place)
