"""The 25 stars of UCAC4 whose proper motion doesn't fit its records: the table u4i/u4hpm.dat of the catalog.

The numbers are the catalog's (USNO, "available free of charge"); they are quoted alike in two public readers,
Project Pluto's ucac4.c (public domain) and Skychart's u4conv. Having them here spares the user a file which
copies of the zone files often lack.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mountnav.catalog.readers.ucac4.record import Ucac4Stars

FAST_STARS: dict[int, tuple[int, int]] = {
    1: (41087, 31413),
    2: (41558, 32586),
    200137: (-37758, 7655),
    200168: (-36004, 9521),
    200169: (-36782, 4818),
    200229: (39624, -25374),
    200400: (65051, -57308),
    200503: (56347, -23377),
    200530: (67682, 13275),
    200895: (-22401, -34203),
    201050: (-7986, 103281),
    201349: (22819, 53694),
    201526: (-5803, -47659),
    201550: (40033, -58151),
    201567: (41683, 32691),
    201633: (-44099, 9416),
    201803: (34222, -15989),
    249921: (-10015, -35427),
    249984: (-9994, -35419),
    268357: (5713, -36943),
    80118783: (32962, 5639),
    93157181: (-22393, -34199),
    106363470: (-37060, -11490),
    110589580: (-38420, -27250),
    113038183: (10990, -51230),
}
"""Unique star number to proper motion in RA* and Dec, 0.1 mas/yr."""


def with_fast_stars(stars: Ucac4Stars) -> Ucac4Stars:
    """Give the fastest stars their proper motions.

    Parameters
    ----------
    stars : Ucac4Stars

    Returns
    -------
    Ucac4Stars
        `pm_elsewhere` stays only where the table has no such star.
    """
    if not stars.pm_elsewhere.any():
        return stars
    pm_ra, pm_dec = stars.pm_ra_cosdec_mas_yr.copy(), stars.pm_dec_mas_yr.copy()
    missing = stars.pm_elsewhere.copy()
    for row in np.flatnonzero(missing):
        found = FAST_STARS.get(int(stars.star_id[row]))
        if found is not None:
            pm_ra[row], pm_dec[row] = 0.1 * found[0], 0.1 * found[1]
            missing[row] = False
    return replace(stars, pm_ra_cosdec_mas_yr=pm_ra, pm_dec_mas_yr=pm_dec, pm_elsewhere=missing)
