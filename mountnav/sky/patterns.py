"""Places round a center, exact on the sphere: panels of mosaics, offsets of patterns, steps of spirals.

A pattern is laid out in a frame of its own: its center on that frame's equator, its meridians upwards along
the pattern's position angle. So nothing is special at the pole, or where right ascension begins again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import turn_deg

__all__ = ["MOST_PANELS", "Panel", "Pattern", "mosaic", "offsets", "spiral"]

MOST_PANELS = 400
"""So many panels, or offsets, has a pattern at most. Doubled, a mistyped one keeps a telescope for two nights
longer."""
WIDEST_DEG = 40.0
"""A pattern is no wider than this, °: further from its middle its panels are turned against each other by
degrees. Doubled, a mosaic of the whole sky is laid out with gaps at its corners."""

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Panel:
    """One place of a pattern.

    Attributes
    ----------
    number : int
        From 1, in the order in which they are visited.
    column, row : int
        From 1, from the left and from above as the pattern is drawn; 0 of a pattern that is no grid.
    position_angle_deg : float
        Of the pattern's own upward direction there: so each panel's image must stand to fit to the others.
    """

    number: int
    column: int
    row: int
    place: Icrs
    position_angle_deg: float


class Pattern:
    """A pattern's own frame.

    Parameters
    ----------
    position_angle_deg : float
        Of its upward direction at the center.
    """

    def __init__(self, center: Icrs, position_angle_deg: float) -> None:
        outward, east, north = _directions(center)
        angle = math.radians(position_angle_deg)
        self._outward = outward
        self._up: Vector = math.cos(angle) * north + math.sin(angle) * east
        # seen as the sky is, with up at the top, the left is a right angle further from north through east
        self._left: Vector = -math.sin(angle) * north + math.cos(angle) * east

    def at(self, right_deg: float, up_deg: float) -> tuple[Icrs, float]:
        """The place so far to the right along the pattern's equator and then upwards; and its upward angle.

        Returns
        -------
        position_angle_deg : float
            Of the pattern's meridian there.
        """
        x, y = math.radians(-right_deg), math.radians(up_deg)
        along: Vector = math.cos(x) * self._outward + math.sin(x) * self._left
        point: Vector = math.cos(y) * along + math.sin(y) * self._up
        upward: Vector = -math.sin(y) * along + math.cos(y) * self._up
        place = _icrs(point)
        _, east, north = _directions(place)
        return place, turn_deg(math.degrees(math.atan2(float(upward @ east), float(upward @ north))))


def _directions(place: Icrs) -> tuple[Vector, Vector, Vector]:
    """Unit vectors outwards, east and north; at a pole the north that its right ascension says."""
    ra, dec = math.radians(place.ra_deg), math.radians(place.dec_deg)
    outward = np.array([math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec)])
    east = np.array([-math.sin(ra), math.cos(ra), 0.0])
    north = np.array([-math.sin(dec) * math.cos(ra), -math.sin(dec) * math.sin(ra), math.cos(dec)])
    return outward, east, north


def _icrs(point: Vector) -> Icrs:
    x, y, z = (float(part) for part in point)
    return Icrs(turn_deg(math.degrees(math.atan2(y, x))), math.degrees(math.atan2(z, math.hypot(x, y))))


def mosaic(
    center: Icrs,
    *,
    across: int,
    down: int,
    width_deg: float,
    height_deg: float,
    overlap: float = 0.1,
    position_angle_deg: float = 0.0,
    snake: bool = True,
) -> tuple[Panel, ...]:
    """The panels of a mosaic, row by row from above.

    Parameters
    ----------
    across, down : int
        Panels in a row, and rows.
    width_deg, height_deg : float
        Of one panel.
    overlap : float
        Of two neighbors, as a share of a panel: the least that it is anywhere in the mosaic's middle rows;
        towards its upper and lower edge rows come closer.
    position_angle_deg : float
        Of the mosaic's upward direction.
    snake : bool
        Every other row backwards, so that each panel is beside the one before.

    Raises
    ------
    BadRequest
        Numbers that make no mosaic, or one that is too large.
    """
    if across < 1 or down < 1 or across * down > MOST_PANELS:
        raise BadRequest(f"{across} × {down} panels", advice=f"at least 1, at most {MOST_PANELS} in all")
    if not (math.isfinite(width_deg) and math.isfinite(height_deg) and width_deg > 0.0 < height_deg):
        raise BadRequest(f"a field of {width_deg}° × {height_deg}°", advice="both above 0")
    if not 0.0 <= overlap <= 0.9:
        raise BadRequest(f"an overlap of {overlap}", advice="a share of the field, 0 to 0.9")
    step_x, step_y = width_deg * (1.0 - overlap), height_deg * (1.0 - overlap)
    if max((across - 1) * step_x + width_deg, (down - 1) * step_y + height_deg) > WIDEST_DEG:
        raise BadRequest(
            f"a mosaic of {(across - 1) * step_x + width_deg:.1f}° × {(down - 1) * step_y + height_deg:.1f}°",
            advice=f"at most {WIDEST_DEG:g}° wide: divide it",
        )
    pattern, panels = Pattern(center, position_angle_deg), list[Panel]()
    for row in range(down):
        columns = range(across)
        for column in reversed(columns) if snake and row % 2 else columns:
            place, angle_deg = pattern.at(
                (column - (across - 1) / 2.0) * step_x, ((down - 1) / 2.0 - row) * step_y
            )
            panels.append(Panel(len(panels) + 1, column + 1, row + 1, place, angle_deg))
    return tuple(panels)


def offsets(
    center: Icrs, steps_arcsec: Sequence[tuple[float, float]], position_angle_deg: float = 0.0
) -> tuple[Panel, ...]:
    """The places of a pattern of offsets, each from the center, to the right and upwards in seconds of arc.

    Raises
    ------
    BadRequest
        None, too many, or too far.
    """
    if not 1 <= len(steps_arcsec) <= MOST_PANELS:
        raise BadRequest(f"{len(steps_arcsec)} offsets", advice=f"1 to {MOST_PANELS}")
    most = WIDEST_DEG / 2.0 * 3600.0
    for step in steps_arcsec:
        if not all(math.isfinite(value) and abs(value) <= most for value in step):
            raise BadRequest(f"an offset of {step}″", advice=f"at most {most:.0f}″ each")
    pattern = Pattern(center, position_angle_deg)
    return tuple(
        Panel(number, 0, 0, *pattern.at(right / 3600.0, up / 3600.0))
        for number, (right, up) in enumerate(steps_arcsec, 1)
    )


def spiral(center: Icrs, step_deg: float, radius_deg: float) -> Iterator[Icrs]:
    """Places round the center by a square spiral, the center first, until all within the radius were given.

    Parameters
    ----------
    step_deg : float
        Between two neighbors, and between two windings.
    """
    pattern = Pattern(center, 0.0)
    most = math.ceil(radius_deg / step_deg)
    for x, y in _square_spiral(most):
        if math.hypot(x, y) * step_deg <= radius_deg + 1e-9:
            yield pattern.at(x * step_deg, y * step_deg)[0]


def _square_spiral(most: int) -> Iterator[tuple[int, int]]:
    x = y = 0
    yield x, y
    dx, dy, length = 1, 0, 1
    while True:
        for _ in range(2):
            for _ in range(length):
                x, y = x + dx, y + dy
                if max(abs(x), abs(y)) > most:
                    return
                yield x, y
            dx, dy = -dy, dx
        length += 1
