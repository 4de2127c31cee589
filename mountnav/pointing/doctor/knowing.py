"""What a pointing model tells the doctor beforehand: the mount's geometry, and how well it repeats."""

from __future__ import annotations

import math

from mountnav.pointing.doctor.priors import Geometry
from mountnav.pointing.model.model import PointingModel

_TERMS = {
    "equatorial": {"CH": 0, "NP": 1, "ME": 2, "MA": 3, "TF": 4, "TX": 5},
    "altaz": {"CA": 0, "NPAE": 1, "AN": 2, "AW": 3, "TF": 4, "TX": 5},
}
# the doctor has one set of rotations for both kinds of mounts: the equatorial ones
_SENSES = {"CA": -1.0, "NPAE": -1.0, "AW": -1.0}
_UNSAID = (30.0, 20.0, 60.0, 60.0, 30.0, 35.0)
_LEAST_ARCSEC = 10.0
_SIDES = 4.0


def geometry_of(model: PointingModel) -> tuple[tuple[Geometry, ...], float]:
    """Make priors of a model in force.

    Parameters
    ----------
    model : PointingModel
        What it holds beyond the six terms of geometry only widens them.

    Returns
    -------
    geometry : tuple of Geometry
    noise_arcsec : float
        Scatter of single looks on the sky.
    """
    noise = max(math.sqrt(2.0) * model.scatter_arcsec, model.sky_rms_arcsec or 0.0, 5.0)
    # terms that no rotation stands for act like errors of the geometry
    others = [
        value
        for name, value in zip(model.terms, model.coefficients_arcsec, strict=True)
        if name not in _TERMS[model.kind] and name not in ("IH", "ID", "IA", "IE")
    ]
    spare = math.sqrt(sum(one**2 for one in others))
    values, sigmas = [0.0, 0.0, 0.0, 0.0, 0.0, 12.5], list(_UNSAID)
    for name, value, sigma in zip(model.terms, model.coefficients_arcsec, model.sigma_arcsec, strict=True):
        at = _TERMS[model.kind].get(name)
        if at is not None:
            values[at] = _SENSES.get(name, 1.0) * value
            sigmas[at] = math.hypot(max(sigma, _LEAST_ARCSEC), spare)
    v, s = values, sigmas
    return (
        Geometry(
            (v[0], v[1], v[2], v[3], v[4], v[5]),
            (s[0], s[1], s[2], s[3], s[4], s[5]),
            _SIDES * max(noise, 15.0),
        ),
    ), noise
