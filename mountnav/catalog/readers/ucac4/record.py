"""A star of UCAC4: 78 bytes in, numbers with units out [CATALOGS, Formats §3; readme_u4 §5a].

The 25 stars of UCAC4 whose proper motion doesn't fit its records: the table u4i/u4hpm.dat of the catalog.

The numbers are the catalog's (USNO, "available free of charge"); they are quoted alike in two public readers,
Project Pluto's ucac4.c (public domain) and Skychart's u4conv. Having them here spares the user a file which
copies of the zone files often lack.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.readers.zone_files import Records

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

RECORD: np.dtype[np.void] = np.dtype(
    [
        ("ra", "<i4"),
        ("spd", "<i4"),
        ("fit_mag", "<i2"),
        ("aperture_mag", "<i2"),
        ("mag_sigma", "u1"),
        ("object_type", "u1"),
        ("double", "u1"),
        ("sigma_ra", "i1"),
        ("sigma_dec", "i1"),
        ("images", "u1"),
        ("images_used", "u1"),
        ("catalogs", "u1"),
        ("epoch_ra", "<u2"),
        ("epoch_dec", "<u2"),
        ("pm_ra", "<i2"),
        ("pm_dec", "<i2"),
        ("sigma_pm_ra", "i1"),
        ("sigma_pm_dec", "i1"),
        ("twomass_key", "<u4"),
        ("jhk_mag", "<i2", 3),
        ("jhk_flags", "u1", 3),
        ("jhk_sigma", "u1", 3),
        ("apass_mag", "<i2", 5),
        ("apass_sigma", "i1", 5),
        ("yale", "u1"),
        ("matches", "<u4"),
        ("leda", "u1"),
        ("twomass_extended", "u1"),
        ("star_id", "<u4"),
        ("ucac2_zone", "<u2"),
        ("ucac2_number", "<u4"),
    ]
)
"""The bytes as they lie in the file. Magnitudes are signed: the readme says I*2."""

NO_MAG = 20000
"""The catalog's code for a magnitude that isn't there, mmag [readme_u4 §5a]."""
NO_SIGMA = 99
"""The catalog's code for the error of such a magnitude, 0.01 mag."""
BIASED = 128
"""Errors are stored as signed bytes of the value less 128."""
LARGE_SIGMAS_PM = {251: 275, 252: 325, 253: 375, 254: 450, 255: 500}
"""Codes of large proper motion errors, 0.1 mas/yr; 255 says "no data", for which the catalog writes 500."""
NO_PM_DATA = 255
"""Code of a proper motion error that isn't there."""
PM_ELSEWHERE = 32767
"""The proper motion doesn't fit the field: see `FAST_STARS`."""


@dataclass(frozen=True, slots=True)
class Ucac4Stars:
    """Stars as UCAC4 describes them; each array has shape (n,) unless said.

    Attributes
    ----------
    ra_deg, dec_deg
        ICRS, epoch J2000.0.
    fit_mag, aperture_mag, mag_sigma
        UCAC's own band, 579-642 nm; NaN where there is none.
    object_type
        0 good, 1 near overexposed, 2 perhaps a streak, 3 of a list of fast stars, 4 data from that list,
        5 poor proper motion: position at the epoch of the CCD images, 6 data from FK6, Hipparcos or Tycho-2,
        7 added from these, 8 fast and not in PPMXL, 9 fast and otherwise in PPMXL.
    double
        0 single; tens: 1, 2 component, 3 blended; ones: type of the image's profile.
    sigma_ra_mas, sigma_dec_mas
        At the central epochs; 255 is "255 or more".
    images, images_used, catalogs
        CCD images, those without a problem, and catalogs behind the proper motion.
    epoch_ra_yr, epoch_dec_yr
        Central epochs.
    pm_ra_cosdec_mas_yr, pm_dec_mas_yr
        NaN in both where there is none.
    pm_elsewhere
        Bool: too fast for the record.
    sigma_pm_ra_mas_yr, sigma_pm_dec_mas_yr
        50 where the catalog has no data.
    twomass_key
        0: not in 2MASS.
    jhk_mag, jhk_flags, jhk_sigma
        Shape (n, 3). Magnitudes NaN where there are none; flags are contamination · 10 + quality.
    apass_mag, apass_sigma
        Shape (n, 5): B, V, g, r, i. NaN where there are none; a negative sigma is that of one observation.
        The B and V of stars with `tycho_source` may be Tycho's BT and VT: see `tycho_magnitudes`.
    yale
        Galaxy flag · 10 + source flag of the Yale Southern Proper Motion data.
    matches
        Nine decimal digits, see `tycho_source` for the first.
    leda, twomass_extended
        0, or the size of a galaxy or extended source.
    """

    ra_deg: Array
    dec_deg: Array
    fit_mag: Array
    aperture_mag: Array
    mag_sigma: Array
    object_type: Whole
    double: Whole
    sigma_ra_mas: Array
    sigma_dec_mas: Array
    images: Whole
    images_used: Whole
    catalogs: Whole
    epoch_ra_yr: Array
    epoch_dec_yr: Array
    pm_ra_cosdec_mas_yr: Array
    pm_dec_mas_yr: Array
    pm_elsewhere: NDArray[np.bool_]
    sigma_pm_ra_mas_yr: Array
    sigma_pm_dec_mas_yr: Array
    twomass_key: Whole
    jhk_mag: Array
    jhk_flags: Whole
    jhk_sigma: Array
    apass_mag: Array
    apass_sigma: Array
    yale: Whole
    matches: Whole
    leda: Whole
    twomass_extended: Whole
    star_id: Whole
    ucac2_zone: Whole
    ucac2_number: Whole

    def __len__(self) -> int:
        return int(self.ra_deg.size)

    @property
    def tycho_source(self) -> Whole:
        """First digit of `matches`: 0 is no Hipparcos or Tycho-2 star; shape (n,)."""
        return np.asarray(self.matches // 10**8)

    @property
    def tycho_magnitudes(self) -> NDArray[np.bool_]:
        """Whether B and V are Tycho's BT and VT; shape (n, 2).

        The readme (note 13) marks these by an error of 0; the zone files have 99 there. Faint APASS
        stars may have an error of 0 too, so the star must be Tycho's.
        """
        sigma = self.apass_sigma[:, :2]
        of_tycho = (self.tycho_source > 0)[:, None]
        return np.asarray(of_tycho & np.isfinite(self.apass_mag[:, :2]) & (np.isnan(sigma) | (sigma == 0.0)))


def decoded(records: Records) -> Ucac4Stars:
    """Turn records into numbers with units.

    Parameters
    ----------
    records : ndarray of RECORD, shape (n,)
        As the file has them.

    Returns
    -------
    Ucac4Stars
        Proper motions of the fastest stars are NaN, with `pm_elsewhere`.
    """
    r = records
    elsewhere = (r["pm_ra"] == PM_ELSEWHERE) | (r["pm_dec"] == PM_ELSEWHERE)
    code_ra, code_dec = (r[name].astype(np.int64) + BIASED for name in ("sigma_pm_ra", "sigma_pm_dec"))
    # a proper motion may be 0: only the error tells that there is none
    none = (r["pm_ra"] == 0) & (r["pm_dec"] == 0) & ((code_ra == NO_PM_DATA) | (code_dec == NO_PM_DATA))
    unknown = none | elsewhere
    return Ucac4Stars(
        ra_deg=r["ra"] / 3.6e6,
        dec_deg=r["spd"] / 3.6e6 - 90.0,
        fit_mag=_mag(r["fit_mag"]),
        aperture_mag=_mag(r["aperture_mag"]),
        mag_sigma=_sigma(r["mag_sigma"]),
        object_type=_whole(r["object_type"]),
        double=_whole(r["double"]),
        sigma_ra_mas=r["sigma_ra"].astype(np.float64) + BIASED,
        sigma_dec_mas=r["sigma_dec"].astype(np.float64) + BIASED,
        images=_whole(r["images"]),
        images_used=_whole(r["images_used"]),
        catalogs=_whole(r["catalogs"]),
        epoch_ra_yr=1900.0 + 0.01 * r["epoch_ra"],
        epoch_dec_yr=1900.0 + 0.01 * r["epoch_dec"],
        pm_ra_cosdec_mas_yr=np.where(unknown, np.nan, 0.1 * r["pm_ra"]),
        pm_dec_mas_yr=np.where(unknown, np.nan, 0.1 * r["pm_dec"]),
        pm_elsewhere=elsewhere,
        sigma_pm_ra_mas_yr=_sigma_pm(code_ra),
        sigma_pm_dec_mas_yr=_sigma_pm(code_dec),
        twomass_key=_whole(r["twomass_key"]),
        jhk_mag=_mag(r["jhk_mag"]),
        jhk_flags=_whole(r["jhk_flags"]),
        jhk_sigma=_sigma(r["jhk_sigma"]),
        apass_mag=_mag(r["apass_mag"]),
        apass_sigma=_sigma(r["apass_sigma"]),
        yale=_whole(r["yale"]),
        matches=_whole(r["matches"]),
        leda=_whole(r["leda"]),
        twomass_extended=_whole(r["twomass_extended"]),
        star_id=_whole(r["star_id"]),
        ucac2_zone=_whole(r["ucac2_zone"]),
        ucac2_number=_whole(r["ucac2_number"]),
    )


def _whole(field: NDArray[np.generic]) -> Whole:
    return field.astype(np.int64)


def _mag(field: NDArray[np.generic]) -> Array:
    mmag = field.astype(np.float64)
    return np.where(mmag >= NO_MAG, np.nan, 0.001 * mmag)


def _sigma(field: NDArray[np.generic]) -> Array:
    hundredths = field.astype(np.float64)
    return np.where(hundredths == NO_SIGMA, np.nan, 0.01 * hundredths)


def _sigma_pm(code: Whole) -> Array:
    tenths = np.arange(256)
    for large, value in LARGE_SIGMAS_PM.items():
        tenths[large] = value
    return np.asarray(0.1 * tenths[code], dtype=np.float64)


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
