"""Preliminary identification of a frame against the catalog, when only the center is unknown [S23 §2.1]."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.catalog_set import suited
from mountnav.catalog.star_counts import stars_round
from mountnav.catalog.stars import Catalog
from mountnav.identification.plate import Plate
from mountnav.identification.preliminary import Preliminary, find_shift
from mountnav.identification.settings import PreliminarySettings
from mountnav.identification.shift import Sources, make_sources, sources_of
from mountnav.measuring.measurements import Measurements
from mountnav.series.shift import MovedPlate, icrs_at_pixels, move_plate, pixels_at_icrs
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]

MARGIN_SHARE = 0.5
"""Stars are taken from beyond the frame's edges by this share of its sides: the largest shift."""
STARS_PER_MEASUREMENT = 1.5
FEWEST_STARS = 60


@dataclass(frozen=True, slots=True)
class PlacedByCatalog:
    """A frame placed by its shift against projected stars.

    Attributes
    ----------
    preliminary : Preliminary
        Of the last pass.
    move : MovedPlate or None
        The plate at the frame's place; None unless found.
    """

    preliminary: Preliminary
    move: MovedPlate | None


def place_by_catalog(
    measurements: Measurements,
    plate: Plate,
    center: Icrs,
    catalog: Catalog,
    *,
    epoch_yr: float,
    settings: PreliminarySettings | None = None,
) -> PlacedByCatalog:
    """Find a frame's center when its scale, rotation and distortion are known.

    Stars are projected into the pixels of a frame at the assumed center, and the shift between measurements
    and stars is found as between two frames. A second pass projects about the center that was found.

    Parameters
    ----------
    plate : Plate
        Of a solved frame of this telescope and camera (`mountnav.identification.wcs.plate_from_cards`).
    center : Icrs
        Assumed center; wrong by less than half a frame.
    epoch_yr : float
        Julian year of the frame.
    settings : PreliminarySettings, optional
        The measured profile if left out: with R_rej = 20 px and 70 % no catalog matches a frame.
    """
    settings = settings or PreliminarySettings.measured()
    frame = sources_of(measurements, settings)
    for last in (False, True):
        here = replace(plate, tangent=center)
        stars, ra, dec = _projected(here, measurements, frame, catalog, epoch_yr, settings)
        got = find_shift(frame, stars, settings, same_chip=False)
        pairing = got.pairing
        if pairing is None:
            break
        if last:
            x, y = frame.x_px[pairing.first], frame.y_px[pairing.first]
            sky = ra[pairing.second], dec[pairing.second]
            return PlacedByCatalog(got, move_plate(here, *sky, x, y, pairing.weight))
        x = np.array([plate.center_x_px - pairing.dx_px])
        y = np.array([plate.center_y_px - pairing.dy_px])
        found_ra, found_dec = icrs_at_pixels(here, x, y)
        center = Icrs(float(found_ra[0]), float(found_dec[0]))
    return PlacedByCatalog(got, None)


def _projected(
    plate: Plate,
    measurements: Measurements,
    frame: Sources,
    catalog: Catalog,
    epoch_yr: float,
    settings: PreliminarySettings,
) -> tuple[Sources, Array, Array]:
    """Stars in the frame's pixels, with a margin about it; their right ascensions and declinations."""
    width, height = measurements.width_px, measurements.height_px
    wide, high = MARGIN_SHARE * width, MARGIN_SHARE * height
    extent = 1.0 + 2.0 * MARGIN_SHARE
    radius_deg = 0.5 * extent * math.hypot(width, height) * plate.scale_arcsec_px() / 3600.0
    count = max(FEWEST_STARS, STARS_PER_MEASUREMENT * frame.x_px.size) * extent**2
    catalog = suited(catalog, plate.tangent, math.pi * radius_deg**2, epoch_yr=epoch_yr)
    stars = stars_round(catalog, plate.tangent, radius_deg, int(count), epoch_yr=epoch_yr)
    x, y = pixels_at_icrs(plate, stars.ra_deg, stars.dec_deg)
    box = (-0.5 - wide, -0.5 - high, width - 0.5 + wide, height - 0.5 + high)
    inside = np.flatnonzero((x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3]))
    inside = inside[: int(count)]
    sigma = np.where(np.isfinite(stars.sigma_arcsec), stars.sigma_arcsec, 1.0) / plate.scale_arcsec_px()
    # regions of the frame's own size, so that both lists are spread alike
    regions = max(1, round(settings.m_reg * extent))
    sources = make_sources(x[inside], y[inside], sigma[inside], inside, box, replace(settings, m_reg=regions))
    return sources, stars.ra_deg[inside], stars.dec_deg[inside]
