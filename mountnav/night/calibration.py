"""The frames that open a session: do their plates agree? [S23: at least three frames of a series]."""

from __future__ import annotations

import math
from statistics import median

from mountnav.night.states import PlateSeen


def plates_agree(
    one: PlateSeen, other: PlateSeen, *, scale_agrees: float, rotation_agrees_deg: float, turned: bool
) -> bool:
    """Tell whether two frames are of one telescope and camera.

    Parameters
    ----------
    one, other : PlateSeen
    scale_agrees : float
        How near, as a share.
    rotation_agrees_deg : float
    turned : bool
        Whether half a turn counts as none: the tube may have gone to the other side of the pier.

    Returns
    -------
    bool
        False as well for another parity or another size: a flip turns an image, it never mirrors it.
    """
    if one.parity != other.parity or one.size != other.size:
        return False
    if abs(one.scale_arcsec_px / other.scale_arcsec_px - 1.0) > scale_agrees:
        return False
    apart = abs(math.remainder(one.rotation_deg - other.rotation_deg, 360.0))
    if turned:
        apart = min(apart, 180.0 - apart)
    return apart <= rotation_agrees_deg


def agreed_plate(
    plates: tuple[PlateSeen, ...], count: int, *, scale_agrees: float, rotation_agrees_deg: float
) -> tuple[tuple[PlateSeen, ...], PlateSeen | None]:
    """Take the newest plates that agree with each other.

    Parameters
    ----------
    plates : tuple of PlateSeen
        In the order of their frames.
    count : int
        How many must agree.
    scale_agrees, rotation_agrees_deg : float
        As in `plates_agree`; half a turn counts.

    Returns
    -------
    kept : tuple of PlateSeen
        Those that go on counting: the newest run of plates that agree pair by pair.
    agreed : PlateSeen or None
        Their median, once there are `count`.
    """
    kept: tuple[PlateSeen, ...] = ()
    for plate in reversed(plates):
        if not all(
            plates_agree(
                plate,
                other,
                scale_agrees=scale_agrees,
                rotation_agrees_deg=rotation_agrees_deg,
                turned=True,
            )
            for other in kept
        ):
            break
        kept = (plate, *kept)
    if len(kept) < count:
        return kept, None
    newest = kept[-1]
    scale = median(one.scale_arcsec_px for one in kept)
    return kept, PlateSeen(scale, newest.rotation_deg, newest.parity, newest.size)
