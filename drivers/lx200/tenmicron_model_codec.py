"""How a 10micron is told a pointing model: places it believed, and places that were seen there [10MICRON].

This is the right way to feed its model; a sync only shifts it. Nothing here was tried on a real mount.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from drivers.lx200.fine_angles import degrees_to_fine_text, ra_to_fine_text
from drivers.lx200.replies import of_text
from drivers.wire.command import Command, Unreadable
from mountnav.devices import PierSide


def _valid(wire: bytes) -> bool:
    if wire not in (b"V", b"E"):
        raise Unreadable(f"{wire!r} is neither V nor E")
    return wire == b"V"


def _points(wire: bytes) -> int | None:
    if wire == b"E":
        return None
    if re.fullmatch(rb"\d{1,3}", wire) is None:
        raise Unreadable(f"{wire!r} is no number of points")
    return int(wire)


BEGIN_MODEL: Command[bool] = Command(b":newalig#", "begin of a model", of_text(_valid), False)
END_MODEL: Command[bool] = Command(b":endalig#", "end of a model", of_text(_valid), False)


@dataclass(frozen=True, slots=True)
class ModelPoint:
    """One place where the mount believed to point, and where it was seen to point.

    Attributes
    ----------
    mount_ra_deg, mount_dec_deg : float
        As it reported, of date.
    pier_side : PierSide
        East or west.
    seen_ra_deg, seen_dec_deg : float
        As solved, of date.
    sidereal_deg : float
        Local sidereal time of the frame.
    """

    mount_ra_deg: float
    mount_dec_deg: float
    pier_side: PierSide
    seen_ra_deg: float
    seen_dec_deg: float
    sidereal_deg: float


def add_to_model(point: ModelPoint) -> Command[int | None]:
    """Add a point to a model begun; answers how many it has now, or None when it refused the point.

    Raises
    ------
    ValueError
        If the side of the pier isn't known.
    """
    if point.pier_side not in (PierSide.EAST, PierSide.WEST):
        raise ValueError("a point of a model needs its side of the pier")
    side = b"E" if point.pier_side is PierSide.EAST else b"W"

    def dec(deg: float) -> bytes:
        return degrees_to_fine_text(deg, 1, separator=b":")

    fields = (
        ra_to_fine_text(point.mount_ra_deg, 2),
        dec(point.mount_dec_deg),
        side,
        ra_to_fine_text(point.seen_ra_deg, 2),
        dec(point.seen_dec_deg),
        ra_to_fine_text(point.sidereal_deg, 2),
    )
    return Command(b":newalpt" + b",".join(fields) + b"#", "point of a model", of_text(_points), False)
