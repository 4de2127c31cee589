"""Places as they are shown: in the ICRS, and in the mount's own frame; numbers finite or null."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator

from mountnav.devices import Epoch
from mountnav.navigation.kinds import for_mount
from mountnav.sky.coordinates import Apparent, Icrs


def _finite_or_none(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


Finite = Annotated[float | None, BeforeValidator(_finite_or_none)]


class Place(BaseModel):
    """A place in the sky; `utc` is the date of an apparent one."""

    ra_deg: Finite
    dec_deg: Finite
    frame: Literal["icrs", "jnow-apparent"]
    utc: datetime | None = None


class OffsetView(BaseModel):
    """Seen minus believed, on the sphere."""

    east_arcsec: Finite
    north_arcsec: Finite
    total_arcsec: Finite


def place(where: Icrs | Apparent) -> Place:
    """View of a place."""
    if isinstance(where, Apparent):
        return Place(ra_deg=where.ra_deg, dec_deg=where.dec_deg, frame="jnow-apparent", utc=where.utc)
    return Place(ra_deg=where.ra_deg, dec_deg=where.dec_deg, frame="icrs")


def mount_place(where: Icrs, epoch: Epoch | None, utc: datetime | None) -> Place | None:
    """A place as the mount counts it; None where its frame is not known.

    Parameters
    ----------
    where : Icrs
    epoch : {"apparent", "icrs"} or None
        The mount's.
    utc : datetime or None
        For an apparent place.
    """
    return None if epoch is None or utc is None else place(for_mount(where, epoch, utc))


__all__ = ["Finite", "OffsetView", "Place", "mount_place", "place"]
