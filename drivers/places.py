"""Places in a mount's own kind of coordinates: how far apart they are, and that nobody mixes two kinds."""

from __future__ import annotations

from mountnav.errors import BadRequest
from mountnav.navigation.devices import Epoch
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec


def apart_arcsec(a: Apparent | Icrs, b: Apparent | Icrs) -> float:
    """Return the distance of two places that are of one kind by construction."""
    return separation_arcsec(Icrs(a.ra_deg, a.dec_deg), Icrs(b.ra_deg, b.dec_deg))


def check_kind(place: Apparent | Icrs, epoch: Epoch, *, device: str) -> None:
    """Refuse a place of another kind than the mount speaks.

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
