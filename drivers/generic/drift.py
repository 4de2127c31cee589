"""How a mount moves by itself: at rates beside the sidereal one that it was given, as far as that is known.

Readings of a mount that tracks a comet or a satellite drift. A place is no jump when the mount can have
drifted there at the rates that it has; everything beyond that counts as it always does. Which rates it has is
known when it said so, or when it took an order and can't say. After a lost link, a restart or an answer that
was lost it isn't, and any of the rates in question may be in force until a reading follows one that is known.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

from drivers.generic.coordinates import apart_arcsec
from mountnav.clock import utc_now
from mountnav.devices import OffsetRates, moved_on, offset_speed_arcsec_s
from mountnav.sky.coordinates import Apparent, Icrs

_NO_WAY_ARCSEC = 1e-6
"""A shorter way (arcsec) is none: its square would be rounded to 0. Doubled or halved, nothing shows."""


class Drift:
    """The offset rates of one mount, as its driver knows them.

    Parameters
    ----------
    clock : callable
        Gives the present instant, aware UTC.

    Attributes
    ----------
    known : OffsetRates or None
        Those in force; None where that isn't known.
    ours : bool
        Whether rates that we ordered may be in force: they are ours to end.
    changed_utc : datetime or None
        When they changed last, or may have: an earlier reading was of other rates.
    """

    def __init__(self, clock: Callable[[], datetime] = utc_now) -> None:
        self._clock = clock
        self.known: OffsetRates | None = None
        self.ours = False
        self.changed_utc: datetime | None = None
        self._may: tuple[OffsetRates, ...] = ()

    @property
    def may(self) -> tuple[OffsetRates, ...]:
        """All rates but those of a star that may have been in force since the last reading."""
        return self._may

    @property
    def to_end(self) -> bool:
        """Whether any but those of a star may be in force."""
        return self.ours or (bool(self._may) and (self.known is None or not self.known.none))

    def going_out(self, rates: OffsetRates) -> None:
        """An order goes out: until it is known what came of it both may be in force."""
        self.known, self.ours = None, self.ours or not rates.none
        self._add(rates)

    def settled(self, rates: OffsetRates) -> None:
        """These are in force: it says so, or it took the order and can't say."""
        self.known, self.ours = rates, self.ours and not rates.none
        self._add(rates)

    def found(self, rates: OffsetRates | None) -> None:
        """At connecting it said to have these, set by others; None where it can't say."""
        self.known, self._may = rates, ()
        if rates is not None:
            self._add(rates)

    def unknown(self) -> None:
        """A lost link, a restart, a lost answer: which are in force isn't known any more."""
        self.known = None
        self.changed_utc = self._clock()

    def read(self, utc: datetime) -> None:
        """A reading of `utc` is believed: what was in force only before it counts no more."""
        if self.known is not None and (self.changed_utc is None or utc > self.changed_utc):
            self._may = () if self.known.none else (self.known,)

    def _add(self, rates: OffsetRates) -> None:
        self.changed_utc = self._clock()
        if not rates.none and rates not in self._may:
            # of those before only the fastest: it may have been in force all the time
            fastest = sorted(self._may, key=lambda one: offset_speed_arcsec_s(one, 0.0))[-1:]
            self._may = (*fastest, rates)

    def beyond_arcsec(
        self, before: Apparent | Icrs, after: Apparent | Icrs, elapsed_s: float, span_s: float = 0.0
    ) -> float:
        """How far `after` is from where a mount that was at `before` can have drifted within a time.

        Parameters
        ----------
        elapsed_s : float
            Between the two, at most.
        span_s : float
            How long their questions took: the two coordinates of a place are not of the same instant.
        """
        apart = apart_arcsec(before, after)
        if not self._may:
            return apart
        fastest_arcsec_s = max(offset_speed_arcsec_s(rates, before.dec_deg) for rates in self._may)
        if len(self._may) > 1:
            # some of the time at these, some at those
            return max(0.0, apart - fastest_arcsec_s * (elapsed_s + span_s))
        off = min(apart, _off_the_way_arcsec(before, after, self._may[0], elapsed_s))
        return max(0.0, off - fastest_arcsec_s * span_s)


def _off_the_way_arcsec(
    before: Apparent | Icrs, after: Apparent | Icrs, rates: OffsetRates, elapsed_s: float
) -> float:
    """The distance from the way that a mount goes at some rates: it may have begun late, or ended early."""
    way_arcsec = offset_speed_arcsec_s(rates, before.dec_deg) * elapsed_s
    if way_arcsec <= 0.0:
        return apart_arcsec(before, after)
    end = moved_on(before, rates, elapsed_s)
    gone, left = apart_arcsec(before, after), apart_arcsec(after, end)
    length = apart_arcsec(before, end)
    if length <= _NO_WAY_ARCSEC:
        return gone
    # the foot of the perpendicular, by the three sides: good where the way is short against a radian
    share = (gone * gone + length * length - left * left) / (2.0 * length * length)
    foot = moved_on(before, rates, elapsed_s * min(1.0, max(0.0, share)))
    return min(gone, left, apart_arcsec(foot, after))
