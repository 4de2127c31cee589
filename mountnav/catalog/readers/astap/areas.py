"""The two divisions of the sky in ASTAP's databases: rings of declination cut into cells of right ascension.

Source: the comments and tables of unit_star_database.pas of ASTAP, and name1476/name290 of the author's own
programs that make the databases (Han Kleijn, MPL-2.0). A file is called ``<database>_RRCC.<areas>``: ring RR
from the south pole, cell CC from right ascension 0, both from 1. A star at the border of two rings is in the
northern one.

- ``.290``: 18 rings; k of the 289 parts of a hemisphere lie beyond an edge, k = 1, 9, 25, ... 225, 289
  (Gringorten and Yepez 1992); ASTAP's solver took such files written by benchmarks/peers/astap_stars.py.
- ``.1476``: 36 rings of 90/17.5 degrees, the polar ones of half that; tests/catalog/test_astap_solves.py has
  ASTAP's solver take such files.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SOUTH_290 = (1, 4, 8, 12, 16, 20, 24, 28, 32)
_SOUTH_1476 = (1, 3, 9, 15, 21, 27, 33, 38, 43, 48, 52, 56, 60, 63, 65, 67, 68, 69)
CELLS: dict[int, tuple[int, ...]] = {
    290: _SOUTH_290 + _SOUTH_290[::-1],
    1476: _SOUTH_1476 + _SOUTH_1476[::-1],
}
"""Cells of each ring, south pole first, for each division."""
_FILE_NAME = re.compile(r"(?P<database>[a-z0-9]+)_(?P<ring>\d\d)(?P<cell>\d\d)\.(?P<areas>290|1476)", re.I)


@cache
def ring_edges_deg(areas: int) -> Array:
    """Declinations between which the rings lie, south pole first; one more than there are rings."""
    if areas == 290:
        south = -np.degrees(np.arcsin(1.0 - np.arange(1, 18, 2) ** 2 / 289.0))
    else:
        south = np.concatenate((90.0 / 17.5 * (np.arange(17) + 0.5) - 90.0, [0.0]))
    return np.concatenate(([-90.0], south, -south[-2::-1], [90.0]))


@dataclass(frozen=True, slots=True)
class Area:
    """A piece of the sky with a file of its own.

    Attributes
    ----------
    database : str
        Which database: "d50".
    areas : int
        Which division: 290 or 1476.
    ring, cell : int
        From 1.
    """

    database: str
    areas: int
    ring: int
    cell: int

    @property
    def label(self) -> str:
        """As in the file's name: "0101"."""
        return f"{self.ring:02d}{self.cell:02d}"

    @property
    def dec_range_deg(self) -> tuple[float, float]:
        """South and north edge."""
        edges = ring_edges_deg(self.areas)
        return float(edges[self.ring - 1]), float(edges[self.ring])

    @property
    def ra_range_deg(self) -> tuple[float, float]:
        """West and east edge, 0 to 360."""
        width = 360.0 / CELLS[self.areas][self.ring - 1]
        return (self.cell - 1) * width, self.cell * width

    def outside(self, ra_deg: Array, dec_deg: Array, slack_deg: float) -> NDArray[np.bool_]:
        """Which places lie outside by more than the slack.

        Parameters
        ----------
        ra_deg, dec_deg : ndarray, shape (n,)
        slack_deg : float
            On the sky.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        south, north = self.dec_range_deg
        west, east = self.ra_range_deg
        half = 0.5 * (east - west)
        from_middle = np.abs((ra_deg - west - half + 180.0) % 360.0 - 180.0)
        cos_dec = np.maximum(np.cos(np.radians(dec_deg)), 1e-9)
        beyond: NDArray[np.bool_] = (
            (dec_deg < south - slack_deg)
            | (dec_deg > north + slack_deg)
            | (np.abs(dec_deg) > 90.0)
            | ((from_middle - half) * cos_dec > slack_deg)
        )
        return beyond


def area_of(path: Path) -> Area | None:
    """The area that a file's name tells.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Area or None
        None if it is no name of such a file, or of an area that doesn't exist.
    """
    match = _FILE_NAME.fullmatch(path.name)
    if match is None:
        return None
    areas, ring, cell = int(match["areas"]), int(match["ring"]), int(match["cell"])
    cells = CELLS[areas]
    if not (1 <= ring <= len(cells) and 1 <= cell <= cells[ring - 1]):
        return None
    return Area(match["database"].lower(), areas, ring, cell)


def all_labels(areas: int) -> list[str]:
    """The labels of all areas of a division, south to north."""
    return [
        f"{ring:02d}{cell:02d}"
        for ring, cells in enumerate(CELLS[areas], start=1)
        for cell in range(1, cells + 1)
    ]
