"""What an order came to, in INDI's words; and what can be told of an order by looking at it. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime

from api.indi_server.vectors import Vector
from drivers.indi.codec import Ordered, State
from mountnav.sky.coordinates import Site

_SAME_TIME_S = 5.0
_SAME_PLACE_DEG = 0.02


@dataclass(frozen=True, slots=True)
class Answer:
    """What an order came to, for the client that gave it.

    Attributes
    ----------
    name : str
        The property.
    state : State or None
        Instead of the property's own; None: as it is now.
    words : str
    """

    name: str
    state: State | None = None
    words: str = ""

    @classmethod
    def refused(cls, name: str, words: str) -> Answer:
        """It is not done, and why."""
        return cls(name, State.ALERT, f"[ERROR] {words}")


def chosen_switch(ordered: Ordered, shown: Vector) -> str | None:
    """The one switch that a client turns on; None if it turns none on.

    Raises
    ------
    ValueError
        More than one, or one that isn't there.
    """
    known = {one.name for one in shown.members}
    strange = sorted(set(ordered.values) - known)
    if strange:
        raise ValueError(f"{ordered.name} has no {', '.join(strange)}, but {', '.join(sorted(known))}")
    on = [name for name, value in ordered.values.items() if value is True]
    if len(on) > 1:
        raise ValueError(f"{ordered.name} takes one switch, not {', '.join(on)}")
    return on[0] if on else None


def number_of(ordered: Ordered, element: str) -> float:
    """A finite number of an order. Raises `ValueError`."""
    value = ordered.values.get(element)
    if not isinstance(value, float) or not math.isfinite(value):
        raise ValueError(f"{ordered.name} needs a number for {element}")
    return value


def site_answer(ordered: Ordered, site: Site) -> Answer:
    """Compare the site that a client tells with ours; it is never taken."""
    latitude_deg, longitude_deg = number_of(ordered, "LAT"), number_of(ordered, "LONG")
    off_deg = max(
        abs(latitude_deg - site.latitude_deg),
        abs((longitude_deg - site.longitude_deg + 180.0) % 360.0 - 180.0),
    )
    if off_deg <= _SAME_PLACE_DEG:
        return Answer(ordered.name, State.OK, "[INFO] the site is that of the service's settings")
    return Answer.refused(
        ordered.name,
        f"the site stays as in the service's settings (latitude {site.latitude_deg:.4f}°, longitude "
        f"{site.longitude_deg:.4f}° east): told {off_deg:.2f}° from there; which one is wrong?",
    )


def time_answer(ordered: Ordered, now: datetime) -> Answer:
    """Compare the time that a client tells with ours; it is never taken.

    Raises
    ------
    ValueError
        It is none.
    """
    told = datetime.fromisoformat(f"{str(ordered.values.get('UTC', '')).strip().rstrip('Z')}+00:00")
    off_s = (told - now).total_seconds()
    if abs(off_s) <= _SAME_TIME_S:
        return Answer(ordered.name, State.OK, "[INFO] the service's clock says so too")
    return Answer.refused(
        ordered.name,
        f"the service keeps its own machine's time: told {off_s:+.0f} s from it; which one is wrong?",
    )


__all__ = ["Answer", "chosen_switch", "number_of", "site_answer", "time_answer"]
