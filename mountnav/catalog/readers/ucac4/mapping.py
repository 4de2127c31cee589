"""What of UCAC4 goes into a packed catalog: which magnitude, which color, which warning."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.ucac4.record import Ucac4Stars
from mountnav.catalog.stars import StarFlag

Array = NDArray[np.float64]
Chosen = NDArray[np.bool_]

UNRESOLVED_MOTION_MAS_YR = 3276.7
"""A star that is too fast for the record, and not in the table of these."""
NO_MAGNITUDE_MAG = 20.0
"""The catalog's own stand-in."""
SATURATED_MAG = 10.0
"""Of stars without a usable image: brighter ones are overexposed, fainter ones have some other problem."""
SURE_COLOR_MAG = 0.2
"""A color with a larger error is none."""
UCAC_MINUS = {"r": 0.13, "V": -0.10, "g": -0.44, "i": 0.32, "B": -0.84, "J": 1.29}
"""Median of aperture magnitude less another, mag 10 to 16, in CDS's sample of 1000. The order is
that of the scatter: r 0.06 mag, J 0.27."""
_APASS = {"B": 0, "V": 1, "g": 2, "r": 3, "i": 4}


def columns_of(stars: Ucac4Stars) -> CatalogColumns:
    """Choose what the packed form holds.

    Parameters
    ----------
    stars : Ucac4Stars
        With the proper motions of the fastest stars.

    Returns
    -------
    CatalogColumns
        Band "UCAC" (579-642 nm), color B-V.
    """
    mag, mag_flags = magnitudes(stars)
    spread = np.where(stars.pm_elsewhere, UNRESOLVED_MOTION_MAS_YR, 0.0)
    return CatalogColumns(
        ra_deg=stars.ra_deg,
        dec_deg=stars.dec_deg,
        pm_ra_cosdec_mas_yr=stars.pm_ra_cosdec_mas_yr,
        pm_dec_mas_yr=stars.pm_dec_mas_yr,
        mag=mag,
        # without a proper motion sigma grows by the catalog's own 50 mas/yr, as in the errors it prints
        error_curve=error_curve(
            (np.maximum(stars.sigma_ra_mas, 1.0), np.maximum(stars.sigma_dec_mas, 1.0)),
            (
                np.maximum(stars.sigma_pm_ra_mas_yr, spread),
                np.maximum(stars.sigma_pm_dec_mas_yr, spread),
            ),
            (stars.epoch_ra_yr, stars.epoch_dec_yr),
        ),
        color_mag=colors(stars),
        flags=(mag_flags | warnings(stars)).astype(np.uint8),
    )


def magnitudes(stars: Ucac4Stars) -> tuple[Array, NDArray[np.uint8]]:
    """Magnitude in UCAC's band, and what is to be said of it.

    The aperture magnitude: against APASS r and color it scatters by 0.04 to 0.12 mag at magnitudes 12 to 16,
    the fit magnitude by 0.10 to 0.19 (CDS's sample). The fit magnitude stands in. Overexposed stars and those
    without any take another band's, brought to this one by its median difference.

    Parameters
    ----------
    stars : Ucac4Stars

    Returns
    -------
    mag : ndarray, shape (n,)
        Finite.
    flags : ndarray of uint8, shape (n,)
        NO_MAGNITUDE, OTHER_BAND, STAND_IN.
    """
    own = np.where(np.isnan(stars.aperture_mag), stars.fit_mag, stars.aperture_mag)
    overexposed = (stars.object_type == 1) | ((stars.images_used == 0) & (own < SATURATED_MAG))
    other = np.full(len(stars), np.nan)
    johnson = dict(zip("BV", johnson_magnitudes(stars), strict=True))
    for band, offset in UCAC_MINUS.items():
        if band in johnson:
            instead = johnson[band]
        elif band == "J":
            instead = stars.jhk_mag[:, 0]
        else:
            instead = stars.apass_mag[:, _APASS[band]]
        other = np.where(np.isnan(other), instead + offset, other)
    replaced = np.isnan(own) | (overexposed & np.isfinite(other))
    mag = np.where(replaced, other, own)
    nothing = np.isnan(mag)
    flags = np.where(
        nothing,
        int(StarFlag.NO_MAGNITUDE),
        # what an overexposed image gave is of no use for photometry even where nothing better is known
        np.where(replaced | overexposed, int(StarFlag.OTHER_BAND), 0),
    )
    fitted = np.isnan(stars.aperture_mag) & ~replaced & ~nothing
    flags = flags | np.where(fitted, int(StarFlag.STAND_IN), 0)
    return np.where(nothing, NO_MAGNITUDE_MAG, mag), flags.astype(np.uint8)


def johnson_magnitudes(stars: Ucac4Stars) -> tuple[Array, Array]:
    """B and V; Tycho's BT and VT brought to Johnson's system [readme_u4 note 13; CATALOGS, Formats §1].

    Parameters
    ----------
    stars : Ucac4Stars

    Returns
    -------
    b, v : ndarray, shape (n,)
        NaN where unknown; a B that would need the other's system to be told apart is NaN.
    """
    b, v = stars.apass_mag[:, 0], stars.apass_mag[:, 1]
    tycho_b, tycho_v = stars.tycho_magnitudes.T
    both = tycho_b & tycho_v
    color = np.where(both, b - v, 0.0)
    johnson_v = np.where(both, v - 0.090 * color, v)
    johnson_b = np.where(both, johnson_v + 0.850 * color, np.where(tycho_b, np.nan, b))
    return johnson_b, johnson_v


def colors(stars: Ucac4Stars) -> Array:
    """B-V, from one system, with an error of at most 0.2.

    Parameters
    ----------
    stars : Ucac4Stars

    Returns
    -------
    ndarray, shape (n,)
        NaN where unknown.
    """
    b, v = johnson_magnitudes(stars)
    mixed = stars.tycho_magnitudes[:, 0] != stars.tycho_magnitudes[:, 1]
    sigma = np.nan_to_num(np.hypot(stars.apass_sigma[:, 0], stars.apass_sigma[:, 1]), nan=0.0)
    return np.where(mixed | (sigma > SURE_COLOR_MAG), np.nan, b - v)


def warnings(stars: Ucac4Stars) -> NDArray[np.uint8]:
    """What the catalog warns of, but for magnitudes; bits of `StarFlag`.

    Parameters
    ----------
    stars : Ucac4Stars

    Returns
    -------
    ndarray of uint8, shape (n,)
    """
    kind = stars.object_type
    strange = (kind == 2) | (kind == 8) | (kind == 9)
    unconfirmed = (stars.twomass_key == 0) & (stars.tycho_source == 0)
    galaxy_flag, source_flag = stars.yale // 10, stars.yale % 10
    extended = (stars.leda > 0) | (stars.twomass_extended > 0)
    extended |= (galaxy_flag == 1) | (galaxy_flag == 2) | (source_flag == 5) | (source_flag == 6)
    flags = np.zeros(len(stars), dtype=np.uint8)
    flags[np.isnan(stars.pm_dec_mas_yr)] |= int(StarFlag.NO_PROPER_MOTION)
    flags[strange | unconfirmed] |= int(StarFlag.DOUBTFUL)
    flags[stars.double > 0] |= int(StarFlag.DOUBLE)
    flags[extended] |= int(StarFlag.EXTENDED)
    return flags
