"""Catalog stars as astropy tables."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING

from mountnav.catalog.stars import Catalog
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs

if TYPE_CHECKING:
    from astropy.coordinates import SkyCoord
    from astropy.table import Table
    from astropy.time import Time


def cone(
    center: SkyCoord | Icrs,
    radius_deg: float,
    *,
    at: datetime | Time | float | None = None,
    mag_limit: float | None = None,
    catalog: Catalog | None = None,
) -> Table:
    """List the stars within a radius, brightest first, moved to an epoch by their proper motions.

    Parameters
    ----------
    center : SkyCoord or Icrs
        Middle of the circle.
    radius_deg : float
        At most 90.
    at : datetime, Time or float, optional
        The epoch of the positions, as an instant or a Julian year; now by default.
    mag_limit : float, optional
        Only stars as bright as this or brighter, in the catalog's own band; default: all.
    catalog : Catalog, optional
        Instead of the embedded Tycho-2.

    Returns
    -------
    Table
        Columns `ra`, `dec` (deg), `sigma` (arcsec per coordinate), `mag`, `color`, `pm_ra_cosdec`, `pm_dec`
        (mas/yr); `meta` has `epoch`, `catalog`, `band`.

    Raises
    ------
    BadRequest
        The radius makes no sense.
    """
    from astropy import units as u
    from astropy.table import Table

    from mountnav.catalog.embedded import embedded_catalog
    from mountnav.clock import utc_now
    from mountnav.units import julian_year

    if not 0 < radius_deg <= 90:
        raise BadRequest(f"radius_deg is {radius_deg}", advice="give degrees between 0 and 90")
    if not isinstance(center, Icrs):
        icrs = center.icrs
        center = Icrs(float(icrs.ra.deg), float(icrs.dec.deg))
    if at is None:
        epoch_yr = julian_year(utc_now())
    elif isinstance(at, datetime):
        epoch_yr = julian_year(at)
    elif isinstance(at, (int, float)):
        epoch_yr = float(at)
    else:
        epoch_yr = float(at.jyear)
    whose: Catalog = embedded_catalog() if catalog is None else catalog
    stars = whose.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)
    table = Table(
        {
            "ra": stars.ra_deg * u.deg,
            "dec": stars.dec_deg * u.deg,
            "sigma": stars.sigma_arcsec * u.arcsec,
            "mag": stars.mag * u.mag,
            "color": stars.color_mag * u.mag,
            "pm_ra_cosdec": stars.pm_ra_cosdec_mas_yr * u.mas / u.yr,
            "pm_dec": stars.pm_dec_mas_yr * u.mas / u.yr,
        }
    )
    table.meta.update(epoch=epoch_yr, catalog=stars.source, band=stars.band, color=stars.color_name)
    return table
