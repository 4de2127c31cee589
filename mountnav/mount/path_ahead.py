"""Where a mount that follows a moving target will come to, held against its limits.

Two paths are looked at: that of the target, up to the end of its rates and then as a star's; and, for the
next minutes, the one on which the rates in force lead on from where the mount stands.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from mountnav.devices import MountReading, OffsetRates, PierSide, from_mount, moved_on, offset_speed_arcsec_s
from mountnav.errors import BadRequest
from mountnav.pointing.limits import Limits, Mounting, Reached
from mountnav.pointing.limits.along import Path, reached_along
from mountnav.pointing.limits.postures import side_by_rule
from mountnav.sky.chain import icrs_to_hour_angle
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.sky.sphere import separation_arcsec

_NEAR_S = 600.0
"""So far ahead slow rates are taken to lead straight on, s. Chosen by hand; the path tells what comes later.
Doubled, each look of the watch costs 2 ms more."""
_LEAST_NEAR_S = 16.0
"""As far at least, s: more than a limit is stopped at before it is reached, and a pause between two looks."""
_STRAIGHT_DEG = 2.0
"""Fast rates are taken to lead straight on for so many degrees: a pass bows. Doubled, a satellite that turns
away from a limit may be stopped before it."""
_OFF_DEG = 5.0
"""A path so far from where the mount stands, °, is not of the target that it follows. Chosen by hand: more
than any pointing error that is trusted. Doubled, a path of something else may pass."""
_IN_THREAD_S = 60.0
"""A longer path is looked at in a thread, s: one of a satellite takes a tenth of a second, and a stop waits
for nothing."""


@dataclass(frozen=True, slots=True)
class _Far:
    """What was found on a path at one time."""

    utc: datetime
    until_utc: datetime
    reached: Reached | None


class PathAhead:
    """The way of one target, as it is followed.

    Parameters
    ----------
    rates : OffsetRates
        In force, or about to be.
    ends_utc : datetime
        Up to when; then it tracks as for a star.
    path : callable, optional
        Where the target will be; None: only where the rates lead.
    before : PathAhead, optional
        What was followed until now: the same path isn't looked at twice.
    """

    def __init__(
        self,
        site: Site,
        air: Air,
        mounting: Mounting | None,
        rates: OffsetRates,
        ends_utc: datetime,
        path: Path | None,
        before: PathAhead | None = None,
    ) -> None:
        self._site, self._air, self._mounting = site, air, mounting
        self.rates, self.ends_utc, self.path = rates, ends_utc, path
        # == : a method is made again each time it is asked for
        known = before is not None and path is not None and before.path == path
        self._far: dict[PierSide | None, _Far] = dict(before._far) if known and before is not None else {}
        self._assumed: PierSide | None = None if before is None else before._assumed
        self._star: Icrs | None = None
        """Where it tracks as for a star after the end, by the path."""

    def _hanging(self, side: PierSide | None, reading: MountReading) -> PierSide | None:
        """The side to reckon with: one that isn't known stays what it usually was when it began to follow."""
        if side in (PierSide.EAST, PierSide.WEST) or self._mounting != "german":
            return side
        if self._assumed is None:
            here = icrs_to_hour_angle(from_mount(reading.place), reading.utc, self._site, self._air)
            self._assumed = side_by_rule(here.ha_deg)
        return self._assumed

    def leads(self, reading: MountReading) -> Path:
        """Where the rates lead from where the mount stands, until they end."""

        def place(utc: datetime) -> Icrs:
            seconds = (min(utc, self.ends_utc) - reading.utc).total_seconds()
            return from_mount(moved_on(reading.place, self.rates, max(seconds, 0.0)))

        return place

    def _as_far_as(self, utc: datetime) -> Icrs:
        assert self.path is not None
        return self.path(min(utc, self.ends_utc))

    async def look_ahead(
        self, limits: Limits, reading: MountReading, sides: Iterable[PierSide | None], utc: datetime
    ) -> tuple[Reached, datetime] | None:
        """What is reached first up to the end, and when; None if nothing is.

        Raises
        ------
        BadRequest
            The path is of something else, doesn't reach as far, or can't be judged.
        """
        path = self.leads(reading)
        if self.path is not None:
            path = self._as_far_as
            off_deg = separation_arcsec(self.path(utc), from_mount(reading.place)) / 3600.0
            if off_deg > _OFF_DEG:
                raise BadRequest(
                    f"the target's path is {off_deg:.1f}° from where the mount stands",
                    advice="slew there first",
                )
            self._star = self.path(self.ends_utc)
        within_s = (self.ends_utc - utc).total_seconds()
        first: tuple[Reached, datetime] | None = None
        for side in dict.fromkeys(self._hanging(side, reading) for side in sides):
            found = await self._looked_at(limits, path, side, utc, within_s)
            if found is not None and (first is None or found[1] < first[1]):
                first = found
        return first

    async def _looked_at(
        self, limits: Limits, path: Path, side: PierSide | None, utc: datetime, within_s: float
    ) -> tuple[Reached, datetime] | None:
        known = self._far.get(side) if self.path is not None else None
        begins = utc if known is None else max(utc, min(known.until_utc, self.ends_utc))
        if known is not None and known.reached is not None:
            at = known.utc + timedelta(seconds=known.reached.after_s)
            if at <= self.ends_utc:
                return known.reached, at
        if known is not None and known.until_utc >= self.ends_utc:
            return None
        left_s = within_s - (begins - utc).total_seconds()

        def look() -> Reached | None:
            return reached_along(
                limits,
                path,
                begins,
                self._site,
                self._air,
                mounting=self._mounting,
                side=side,
                within_s=left_s,
            )

        found = await asyncio.to_thread(look) if left_s > _IN_THREAD_S else look()
        self._far[side] = _Far(begins, self.ends_utc, found)
        return None if found is None else (found, begins + timedelta(seconds=found.after_s))

    def reached(
        self, limits: Limits, reading: MountReading, side: PierSide | None, within_s: float
    ) -> Reached | None:
        """Which limit following from where the mount stands reaches first, and when."""
        side = self._hanging(side, reading)
        speed_deg_s = offset_speed_arcsec_s(self.rates, reading.place.dec_deg) / 3600.0
        near_s = min(_NEAR_S, max(_LEAST_NEAR_S, _STRAIGHT_DEG / max(speed_deg_s, 1e-9)), within_s)
        found = reached_along(
            limits,
            self.leads(reading),
            reading.utc,
            self._site,
            self._air,
            mounting=self._mounting,
            side=side,
            within_s=near_s,
        )
        if found is not None:
            return found
        far = self._far.get(side)
        if far is not None and far.reached is not None:
            after_s = (far.utc - reading.utc).total_seconds() + far.reached.after_s
            return replace(far.reached, after_s=max(after_s, 0.0)) if after_s <= within_s else None
        left_s = max((self.ends_utc - reading.utc).total_seconds(), 0.0)
        if left_s >= within_s:
            return None
        # then it tracks as for a star
        later = limits.reached(
            self._star or self.leads(reading)(self.ends_utc),
            max(self.ends_utc, reading.utc),
            self._site,
            self._air,
            mounting=self._mounting,
            side=side,
            within_s=within_s - left_s,
        )
        return None if later is None else replace(later, after_s=later.after_s + left_s)
