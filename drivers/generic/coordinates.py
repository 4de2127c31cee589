"""Places in a mount's own kind of coordinates: how far apart they are, and that nobody mixes two kinds."""

from __future__ import annotations

import math

from mountnav.devices import Epoch
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec


def apart_arcsec(a: Apparent | Icrs, b: Apparent | Icrs) -> float:
    """Return the distance of two places that are of one kind by construction."""
    return separation_arcsec(Icrs(a.ra_deg, a.dec_deg), Icrs(b.ra_deg, b.dec_deg))


def check_kind(place: Apparent | Icrs, epoch: Epoch, *, device: str) -> None:
    """Refuse a place of another kind than the mount speaks, and one that is no place.

    Raises
    ------
    BadRequest
        If it is.
    """
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
