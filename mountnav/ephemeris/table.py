"""Ephemeris tables: places at times, interpolated with an estimate of the error, never extrapolated.

A table of a near body is made for one observer. With a distance in it the parallax is taken off each row and
put on again for the telescope: tables of the Earth's center serve everywhere, and the daily turn of the
observer isn't interpolated. Without a distance a table serves only where it was made for.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from mountnav.ephemeris.ephemeris import require_within
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.observer import direction, earth_barycentric_km, site_geocentric_km
from mountnav.sky.sphere import separation_arcsec
from mountnav.units import ARCSEC_PER_RAD, AU_KM, LIGHT_KM_S

Vector = NDArray[np.float64]

MOST_ROWS: Final = 20_000
"""Rows of a table at most: two weeks by the minute. Doubled, reading one takes twice as long."""
LEAST_ROWS: Final = 4
"""Fewer rows allow no estimate of the error."""
_NODES: Final = 6
"""Rows that a place is interpolated from: fifth degree. Doubled, rounding errors of the rows grow."""
_SAME_PLACE_KM: Final = 0.3
"""An observer who is nearer than this to the table's is at its place: at the distance of the space station
2.5′ in the worst case, of a minor planet nothing. Doubled, twice as much."""
_LONGEST_STEP_S: Final = 2.5 * 3600.0
"""Longest step of a table for a place on the ground that tells no distance: in it the daily parallax of a
near body is no parabola any more, and from a step of a day on it can't be seen at all. Doubled, near bodies
are off by arcseconds."""
_MOST_ERROR_DEG: Final = 1.0
"""A place whose interpolation is less certain than this is refused. Doubled, a wild guess is offered."""

_SLIP_TIMES: Final = 20.0
"""How many times farther off than its neighbors disagree: of the next constant."""
_SLIP_ARCSEC: Final = 5.0
"""A row is taken for a slip (a wrong digit, a row of something else) if it lies so many times farther off the
way of its neighbors than these disagree, and at least that far. Halved, a table whose last digits are rough
may be refused."""

Observer = Literal["geocenter", "here"] | Site
"""Whom a table is for: the Earth's center, wherever it is used, or a place on the ground."""


@dataclass(frozen=True, slots=True)
class TableRow:
    """A place at a time.

    Attributes
    ----------
    utc : datetime
        Aware.
    place : Icrs
        Astrometric, for the table's observer.
    distance_au : float or None
        From the table's observer.
    sigma_arcsec : float
        As the table tells it; 0 if it doesn't.
    """

    utc: datetime
    place: Icrs
    distance_au: float | None = None
    sigma_arcsec: float = 0.0


@dataclass(frozen=True, slots=True)
class Table:
    """A target by a table, as an `Ephemeris`.

    Attributes
    ----------
    rows : tuple of TableRow
        In the order of their times; all with a distance, or none.
    rounding_arcsec : float
        What the last digit of the places is worth.

    Raises
    ------
    BadRequest
        Too few or too many rows, times that don't grow, steps too long for what the table tells, or a row
        that lies beside the way of all others.
    """

    name: str
    rows: tuple[TableRow, ...]
    observer: Observer
    rounding_arcsec: float = 0.0
    begins_utc: datetime = field(init=False)
    ends_utc: datetime = field(init=False)
    _times_s: tuple[float, ...] = field(init=False, repr=False, compare=False)
    _vectors: tuple[Vector, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse what is no table; take the observer's parallax off."""
        rows = self.rows
        if not LEAST_ROWS <= len(rows) <= MOST_ROWS:
            raise BadRequest(f"{self.name}: a table has {LEAST_ROWS} to {MOST_ROWS} rows, not {len(rows)}")
        for number, (before, after) in enumerate(pairwise(rows), 2):
            if not before.utc < after.utc:
                raise BadRequest(f"{self.name}: row {number} is no later than the one before it")
        told = sum(row.distance_au is not None for row in rows)
        if told not in (0, len(rows)):
            raise BadRequest(f"{self.name}: {len(rows) - told} of {len(rows)} rows have no distance")
        begin = rows[0].utc
        times_s = tuple((row.utc - begin).total_seconds() for row in rows)
        longest_s = max(after - before for before, after in pairwise(times_s))
        if not told and self.observer != "geocenter" and longest_s > _LONGEST_STEP_S:
            raise BadRequest(
                f"{self.name}: with a step of {longest_s / 3600.0:.1f} h and no distance "
                "the daily parallax can't be separated from the motion",
                advice=f"make the step {_LONGEST_STEP_S / 3600.0:g} h or less, or add the distance "
                "(quantity 20 of Horizons)",
            )
        object.__setattr__(self, "begins_utc", begin)
        object.__setattr__(self, "ends_utc", rows[-1].utc)
        object.__setattr__(self, "_times_s", times_s)
        vectors = []
        for row in rows:
            vector = _unit(row.place)
            if row.distance_au is not None:
                vector = vector * (row.distance_au * AU_KM)
                if isinstance(self.observer, Site):
                    here = site_geocentric_km(row.utc, self.observer)[0]
                    vector = vector + here + _while_light_comes(row.utc, vector, vector + here)
            vectors.append(vector)
        object.__setattr__(self, "_vectors", tuple(vectors))
        self._require_no_slip()

    @property
    def has_distance(self) -> bool:
        """Whether it tells how far the target is."""
        return self.rows[0].distance_au is not None

    def icrs(self, utc: datetime, site: Site) -> Icrs:
        """Where it stands.

        Raises
        ------
        BadRequest
            Outside of the table; the table is for another observer and tells no distance; or its step is too
            coarse here.
        """
        require_within(self.name, utc, self.begins_utc, self.ends_utc)
        self._require_observer(utc, site)
        error = self._error_arcsec(utc)
        if error > _MOST_ERROR_DEG * 3600.0:
            raise BadRequest(
                f"the table of {self.name} is too coarse here: between its rows it is uncertain by "
                f"{error / 3600.0:.1f}°",
                advice="make it with a shorter step",
            )
        vector = self._interpolated(utc, _NODES)
        if self.has_distance and self.observer != "here":
            here = site_geocentric_km(utc, site)[0]
            seen = vector - here
            vector = seen + _while_light_comes(utc, vector, seen, self._moves_km_s(utc))
        return direction(vector)

    def sigma_arcsec(self, utc: datetime) -> float:
        """Of what the table tells, of its rounding, and of the interpolation."""
        require_within(self.name, utc, self.begins_utc, self.ends_utc)
        row = self._row(utc)
        told = max(self.rows[row].sigma_arcsec, self.rows[row + 1].sigma_arcsec)
        # a rounded number is anywhere within its last digit
        return math.hypot(told, self.rounding_arcsec / math.sqrt(12.0), self._error_arcsec(utc))

    def _require_no_slip(self) -> None:
        """Refuse a row that its neighbors contradict, where they agree among each other.

        Where the table is too coarse for its motion they don't, and nothing is said of any row.
        """
        count = len(self._times_s)
        if count <= _NODES:
            return
        times_s, vectors = np.array(self._times_s), np.array(self._vectors)
        rows = np.arange(count)
        first = np.clip(rows - _NODES // 2, 0, count - _NODES - 1)
        near = first[:, None] + np.arange(_NODES + 1)
        others = near[near != rows[:, None]].reshape(count, _NODES)
        # the nearest four of the six
        order = np.argsort(np.abs(others - rows[:, None]), axis=1, kind="stable")
        fewer = np.take_along_axis(others, order[:, : _NODES - 2], axis=1)
        fine, coarse = (_units(_predicted(times_s, vectors, nodes)) for nodes in (others, fewer))
        off = ARCSEC_PER_RAD * np.linalg.norm(_units(vectors) - fine, axis=1)
        apart = ARCSEC_PER_RAD * np.linalg.norm(fine - coarse, axis=1)
        bound = np.maximum(_SLIP_TIMES * np.maximum(apart, self.rounding_arcsec), _SLIP_ARCSEC)
        worst = int(np.argmax(off / bound))
        if off[worst] > bound[worst]:
            raise BadRequest(
                f"{self.name}: row {worst + 1} ({self.rows[worst].utc:%Y-%m-%d %H:%M} UTC) lies "
                f"{off[worst] / 3600.0:.3g}° beside the way of the rows around it",
                advice="a wrong digit, or a row of something else: correct it, or leave it out",
            )

    def _require_observer(self, utc: datetime, site: Site) -> None:
        if self.has_distance or self.observer == "here":
            return
        here = site_geocentric_km(utc, site)[0]
        there = site_geocentric_km(utc, self.observer)[0] if isinstance(self.observer, Site) else np.zeros(3)
        apart_km = float(np.linalg.norm(here - there))
        if apart_km > _SAME_PLACE_KM:
            of_au, of_moon = apart_km / AU_KM * ARCSEC_PER_RAD, math.degrees(apart_km / 384_400.0)
            raise BadRequest(
                f"the table of {self.name} is for "
                + (
                    "the Earth's center"
                    if self.observer == "geocenter"
                    else f"a place {apart_km:.0f} km from here"
                )
                + f" and gives no distance: from here a body 1 au away stands {of_au:.1f}″ elsewhere, "
                f"one at the Moon's distance {of_moon:.2f}°",
                advice="make it for your coordinates, or with the distance (quantity 20 of Horizons)",
            )

    def _row(self, utc: datetime) -> int:
        since_s = (utc - self.begins_utc).total_seconds()
        return min(max(bisect_right(self._times_s, since_s) - 1, 0), len(self._times_s) - 2)

    def _interpolated(self, utc: datetime, nodes: int) -> Vector:
        since_s = (utc - self.begins_utc).total_seconds()
        count = min(nodes, len(self._times_s))
        row = self._row(utc)
        first = min(max(row - count // 2 + 1, 0), len(self._times_s) - count)
        return _lagrange(self._times_s[first : first + count], self._vectors[first : first + count], since_s)

    def _moves_km_s(self, utc: datetime) -> Vector:
        """How the target moves beside the Earth."""
        begin = max(utc - _ASIDE, self.begins_utc)
        end = min(utc + _ASIDE, self.ends_utc)
        way = self._interpolated(end, _NODES) - self._interpolated(begin, _NODES)
        return way / (end - begin).total_seconds()

    def _error_arcsec(self, utc: datetime) -> float:
        """How much the places differ that are drawn through all nodes, and through two fewer.

        Halfway between two rows, too: at a row both go through it, however wrong it is.
        """
        row = self._row(utc)
        middle = self.rows[row].utc + (self.rows[row + 1].utc - self.rows[row].utc) / 2
        return max(self._drawn_apart_arcsec(utc), self._drawn_apart_arcsec(middle))

    def _drawn_apart_arcsec(self, utc: datetime) -> float:
        fine, coarse = self._interpolated(utc, _NODES), self._interpolated(utc, _coarser(len(self.rows)))
        return separation_arcsec(direction(fine), direction(coarse))


_ASIDE: Final = timedelta(seconds=1)
"""Half the time over which the motion is differenced."""


def _while_light_comes(
    utc: datetime, before: Vector, after: Vector, beside_km_s: Vector | None = None
) -> Vector:
    """How much further a target went in the difference of two light times, km: 0.4″ of the Moon.

    Light of a nearer observer left later, and the target goes around the Sun with the Earth meanwhile.
    """
    earlier_s = float(np.linalg.norm(before) - np.linalg.norm(after)) / LIGHT_KM_S
    moves = earth_barycentric_km(utc)[1]
    return (moves if beside_km_s is None else moves + beside_km_s) * earlier_s


def _coarser(rows: int) -> int:
    return max(min(_NODES, rows) - 2, 2)


def _unit(place: Icrs) -> Vector:
    ra, dec = math.radians(place.ra_deg), math.radians(place.dec_deg)
    return np.array([math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec)])


def _lagrange(times_s: Sequence[float], vectors: Sequence[Vector], at_s: float) -> Vector:
    """The polynomial through some vectors, at a time."""
    total = np.zeros(3)
    for row, (time_s, vector) in enumerate(zip(times_s, vectors, strict=True)):
        weight = 1.0
        for other, other_s in enumerate(times_s):
            if other != row:
                weight *= (at_s - other_s) / (time_s - other_s)
        total = total + vector * weight
    return total


def _units(vectors: Vector) -> Vector:
    """Their directions: how far the target is may be rounded coarsely."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def _predicted(times_s: Vector, vectors: Vector, nodes: NDArray[np.intp]) -> Vector:
    """Where each row would be by the polynomial through other rows, whose numbers `nodes` has."""
    at_s, count = times_s, nodes.shape[1]
    total = np.zeros_like(vectors)
    for one in range(count):
        weight = np.ones(len(at_s))
        for other in range(count):
            if other != one:
                other_s = times_s[nodes[:, other]]
                weight *= (at_s - other_s) / (times_s[nodes[:, one]] - other_s)
        total += vectors[nodes[:, one]] * weight[:, None]
    return total
