"""How many syncs a night and a target had: from noon to noon of the site, also after a restart."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from mountnav.navigation.doubts import Counts
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.sphere import separation_arcsec


def night_of(utc: datetime, site: Site) -> str:
    """The date on which the night began, by mean solar time of the site: 2026-11-21 until the next noon."""
    local = utc.astimezone(UTC) + timedelta(hours=site.longitude_deg / 15.0 - 12.0)
    return local.date().isoformat()


@dataclass(frozen=True, slots=True)
class _Counted:
    night: str
    target: str | None
    place: Icrs


class SyncCounts:
    """Counts committed syncs of the present night.

    Parameters
    ----------
    site : Site
    same_target_deg : float
        Targets without a name are told apart by their place.
    """

    def __init__(self, site: Site, same_target_deg: float) -> None:
        self._site = site
        self._same_target_deg = same_target_deg
        self._counted: list[_Counted] = []

    def add(self, utc: datetime, target: str | None, place: Icrs) -> None:
        """Count one; those of other nights are forgotten."""
        night = night_of(utc, self._site)
        self._counted = [one for one in self._counted if one.night == night]
        self._counted.append(_Counted(night, target, place))

    def at(self, utc: datetime, target: str | None, place: Icrs) -> Counts:
        """How many there were in the night of `utc`, and for a target."""
        night = night_of(utc, self._site)
        tonight = [one for one in self._counted if one.night == night]
        return Counts(len(tonight), sum(self._same(one, target, place) for one in tonight))

    def _same(self, one: _Counted, target: str | None, place: Icrs) -> bool:
        if one.target is not None and target is not None:
            return one.target == target
        return separation_arcsec(one.place, place) <= self._same_target_deg * 3600.0


__all__ = ["SyncCounts", "night_of"]
