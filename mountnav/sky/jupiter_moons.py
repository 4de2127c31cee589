"""Io, Europa, Ganymede and Callisto without an import: the series L1.2, by astronomy-engine.

Against JPL's JUP310 (two days each of 2015 and 2053): Io within 250 km, Europa 170, Ganymede 180, Callisto
560, that is 0.08″, 0.06″, 0.06″ and 0.19″ at opposition. An imported SPK file that has them goes before.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from mountnav.units import AU_KM, J2000_JD

MOONS: Final = ("io", "europa", "ganymede", "callisto")
"""Those that are here, from the planet outward."""
SIGMA_ARCSEC: Final = {"io": 0.08, "europa": 0.06, "ganymede": 0.06, "callisto": 0.2}
"""What they are worth: the worst that was seen against JUP310. Doubled, searches for them are a little
wider."""
_MASSES: Final = {"io": 4.705e-5, "europa": 2.528e-5, "ganymede": 7.805e-5, "callisto": 5.667e-5}
"""Over Jupiter's [JUP310]: the center of Jupiter goes around the system's barycenter by them, by 220 km at
most."""


def from_barycenter_km(name: str, jd_tt: float) -> Any:
    """Place of a moon from the barycenter of Jupiter's system, along the axes of the ICRS, shape (3,).

    Parameters
    ----------
    name : str
        One of `MOONS`.
    jd_tt : float
        Terrestrial time as a Julian date; 2 ms beside TDB, 35 m of Io's way.
    """
    # 0.4 MB of Python, wanted by nobody who doesn't ask for a moon
    import astronomy

    found = astronomy.JupiterMoons(astronomy.Time.FromTerrestrialTime(jd_tt - J2000_JD))
    states = {one: getattr(found, one) for one in MOONS}
    places = {one: np.array((state.x, state.y, state.z)) * AU_KM for one, state in states.items()}
    total = 1.0 + sum(_MASSES.values())
    center = -sum((_MASSES[one] / total * places[one] for one in MOONS), start=np.zeros(3))
    return places[name] + center
