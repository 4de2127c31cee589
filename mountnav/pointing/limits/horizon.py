"""The horizon of a site: a polygon of azimuths and altitudes, below which the tube sees walls and trees.

Read from the text that Stellarium ("polygonal" landscapes), N.I.N.A. and KStars use: an azimuth and an
altitude per line, in degrees, azimuth from north through east; what follows a ``#`` is a comment.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadSettings
from mountnav.files import read_text

Floats = NDArray[np.float64]

# Bins of azimuth in the tables of the highest horizon.
_BINS = 3600
# Width of a bin, degrees: 0.1, so much more of the horizon than asked may count.
_BIN_DEG = 360.0 / _BINS
# Tables of runs of 1, 2, 4, ... 2048 bins: two runs of the longest cover the whole turn, 3600.
_LEVELS = 12


@dataclass(frozen=True, slots=True)
class Horizon:
    """Altitudes of the visible horizon, straight lines (in azimuth and altitude) between the points.

    Attributes
    ----------
    points_deg : tuple of (float, float)
        Azimuth and altitude, by azimuth; two points of one azimuth are a wall's edge. The line from the last
        one goes on to the first one.
    name : str
        Where it comes from, for messages.

    Raises
    ------
    BadSettings
        Fewer than two points, or values that are no azimuths or altitudes.
    """

    points_deg: tuple[tuple[float, float], ...]
    name: str = "horizon"
    _az_deg: Floats = field(init=False, repr=False, compare=False)
    _alt_deg: Floats = field(init=False, repr=False, compare=False)
    _highest: tuple[Floats, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if len(self.points_deg) < 2:
            raise BadSettings(
                f"{self.name}: {len(self.points_deg)} point(s) make no horizon",
                advice="give azimuth and altitude of at least two points",
            )
        for az_deg, alt_deg in self.points_deg:
            if not (-360.0 <= az_deg <= 360.0 and -90.0 <= alt_deg <= 90.0):
                raise BadSettings(
                    f"{self.name}: azimuth {az_deg}°, altitude {alt_deg}° is not a point of a horizon",
                    advice="azimuth 0 to 360 (north through east) first, then altitude -90 to 90",
                )
        points = _by_azimuth(self.points_deg)
        object.__setattr__(self, "points_deg", points)
        az, alt = (np.array(column, dtype=np.float64) for column in zip(*points, strict=True))
        az = np.concatenate((az - 360.0, az, az + 360.0))
        object.__setattr__(self, "_az_deg", az)
        object.__setattr__(self, "_alt_deg", np.tile(alt, 3))
        object.__setattr__(self, "_highest", self._tables())

    @classmethod
    def read(cls, path: Path) -> Horizon:
        """Read a horizon file.

        Raises
        ------
        BadSettings
            It can't be read, or a line of it is no azimuth and altitude; tells the line.
        """
        try:
            text = read_text(path)
        except (OSError, UnicodeDecodeError) as error:
            raise BadSettings(
                f"the horizon file can't be read: {error}",
                device=str(path),
                advice="a text file with azimuth and altitude per line; limits.horizon_file gives its path",
            ) from error
        return cls.parse(text, name=str(path))

    @classmethod
    def parse(cls, text: str, *, name: str = "horizon") -> Horizon:
        """Read a horizon from text: azimuth and altitude per line, parted by blanks, a comma or a semicolon.

        Raises
        ------
        BadSettings
            A line is no azimuth and altitude; tells which.
        """
        points: list[tuple[float, float]] = []
        for number, line in enumerate(text.splitlines(), start=1):
            words = line.partition("#")[0].replace("°", " ").strip()
            if not words:
                continue
            try:
                az_deg, alt_deg = (float(word) for word in re.split(r"[\s,;]+", words))
            except ValueError as error:
                raise BadSettings(
                    f"{name}, line {number}: {line.strip()!r} is not an azimuth and altitude",
                    advice='write two numbers in degrees, with a decimal point, such as "123.5 17.0"',
                ) from error
            if not (math.isfinite(az_deg) and math.isfinite(alt_deg)):
                raise BadSettings(f"{name}, line {number}: {line.strip()!r} is not a point of a horizon")
            points.append((az_deg, alt_deg))
        return cls(tuple(points), name)

    @property
    def highest_deg(self) -> float:
        """Altitude of its highest point."""
        return float(self._alt_deg.max())

    def altitude_at(self, az_deg: float) -> float:
        """Altitude of the horizon in a direction; on a wall's edge the higher one."""
        return float(self.altitudes(np.array([az_deg]))[0])

    def altitudes(self, az_deg: Floats) -> Floats:
        """As `altitude_at`, of many azimuths."""
        az = np.mod(az_deg, 360.0)
        # the last point at or before, and the first at or after: of a wall's edge both are asked
        after = np.searchsorted(self._az_deg, az, side="left")
        before = np.searchsorted(self._az_deg, az, side="right") - 1
        on_edge = before >= after
        low, high = np.minimum(before, after), np.maximum(before, after)
        width = self._az_deg[high] - self._az_deg[low]
        share = np.where(width > 0.0, (az - self._az_deg[low]) / np.where(width > 0.0, width, 1.0), 0.0)
        line = self._alt_deg[low] + share * (self._alt_deg[high] - self._alt_deg[low])
        return np.asarray(np.where(on_edge, np.maximum(self._alt_deg[low], self._alt_deg[high]), line))

    def highest_near(self, az_deg: Floats, reach_deg: Floats) -> Floats:
        """Highest point of the horizon within `reach_deg` of each azimuth, or a little (0.1°) more than that.

        So nothing on the horizon is too thin to be seen by a path that is looked at in steps.

        Parameters
        ----------
        az_deg, reach_deg : ndarray, shape (n,)
            From north over east, and how far to each side.

        Returns
        -------
        ndarray, shape (n,)
            Altitude, degrees.
        """
        reach = np.minimum(reach_deg, 180.0)
        first = np.floor((np.mod(az_deg, 360.0) - reach) / _BIN_DEG).astype(np.int64) + _BINS
        last = np.floor((np.mod(az_deg, 360.0) + reach) / _BIN_DEG).astype(np.int64) + _BINS
        level = np.floor(np.log2(last - first + 1)).astype(np.int64)
        level = np.minimum(level, _LEVELS - 1)
        tables = np.stack(self._highest)
        second = np.maximum(last - (1 << level) + 1, first)
        return np.asarray(np.maximum(tables[level, first], tables[level, second]))

    def _tables(self) -> tuple[Floats, ...]:
        """Highest altitudes of runs of 1, 2, 4, ... bins from each bin on, over three turns."""
        edges = np.linspace(0.0, 360.0, _BINS + 1)
        at_edges = self.altitudes(edges)
        bins = np.maximum(at_edges[:-1], at_edges[1:])
        for az_deg, alt_deg in self.points_deg:
            index = int(az_deg / _BIN_DEG) % _BINS
            bins[index] = max(bins[index], alt_deg)
        tables = [np.tile(bins, 3)]
        for level in range(1, _LEVELS):
            shorter, step = tables[-1], 1 << (level - 1)
            tables.append(np.maximum(shorter, np.concatenate((shorter[step:], np.full(step, -90.0)))))
        return tuple(tables)


def _by_azimuth(points: Iterable[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Sort by azimuth; points of one azimuth keep the order in which the polygon runs."""
    turned = [(az if az == 360.0 else az % 360.0, alt) for az, alt in points]
    azimuths = [az for az, _ in turned]
    steps = np.diff([*azimuths, azimuths[0]])
    if np.count_nonzero(steps < 0.0) > np.count_nonzero(steps > 0.0):
        turned.reverse()
        steps = -steps[::-1]
        steps = np.concatenate((steps[1:], steps[:1]))
    # a wall at which the list begins and ends must not be torn
    first = int(np.argmin(steps)) + 1
    return tuple(sorted([*turned[first:], *turned[:first]], key=lambda point: point[0]))
