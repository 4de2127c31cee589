"""Positions in a mount's own kind of coordinates: distances, and no mixing of two kinds."""

from __future__ import annotations

import math

from mountnav.devices import Epoch
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec


def apart_arcsec(a: Apparent | Icrs, b: Apparent | Icrs) -> float:
    """Angular distance of two positions, which must be of the same kind: both apparent or both ICRS."""
    return separation_arcsec(Icrs(a.ra_deg, a.dec_deg), Icrs(b.ra_deg, b.dec_deg))


def check_kind(place: Apparent | Icrs, epoch: Epoch, *, device: str) -> None:
    """Raise `BadRequest` for a position of another kind than the mount speaks, or outside the sphere."""
    if isinstance(place, Icrs) != (epoch == "icrs"):
        raise BadRequest(
            f"{type(place).__name__} given to a mount that speaks {epoch} coordinates",
            device=device,
            advice="convert it first",
        )
    if not (math.isfinite(place.ra_deg) and abs(place.dec_deg) <= 90.0):
        raise BadRequest(
            f"right ascension {place.ra_deg}°, declination {place.dec_deg}° are no place",
            device=device,
            advice="declinations go from -90° to 90°",
        )
