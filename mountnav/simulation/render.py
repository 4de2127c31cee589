"""Drawing a true frame: the catalog's stars at the date's places, through the optics, with honest noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from mountnav.catalog.stars import Catalog
from mountnav.frames import Frame, Hint
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.trails import (
    MovingBody,
    SatelliteTrail,
    add_trails,
    centers_during,
    instants_during,
)
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic
from mountnav.units import DEG_PER_HOUR, julian_year, sexagesimal_text

__all__ = ["SimulatedOptics", "draw_frame", "project"]

Array = NDArray[np.float64]
# Magnitude of a star without one. Chosen by hand, an ordinary star of the catalogs.
_UNKNOWN_MAG = 12.0
_BEHIND_RAD = math.radians(120.0)
"""Farther from the axis no lens is drawn: the widest fisheyes see 110°."""
_WINGS_ADU = 0.05  # a star is drawn out to where its profile falls below this


def project(center: Icrs, optics: SimulatedOptics, ra_deg: Array, dec_deg: Array) -> tuple[Array, Array]:
    """Where places fall in the frame.

    Parameters
    ----------
    center : Icrs
        Place of the frame's geometric center, which is the tangent point.
    optics : SimulatedOptics
        Scale, rotation, parity and distortion.
    ra_deg, dec_deg : ndarray, shape (n,)
        ICRS places at the date.

    Returns
    -------
    x_px, y_px : ndarray, shape (n,)
        0-based, (0, 0) the middle of the first pixel, y upwards; NaN for places behind.
    """
    xi, eta = _on_detector(center, optics.projection, ra_deg, dec_deg)
    px = math.radians(optics.scale_arcsec_px / 3600.0)
    s, c = math.sin(math.radians(optics.rotation_deg)), math.cos(math.radians(optics.rotation_deg))
    # +y points to position angle θ: (sin θ, cos θ) in (east, north); +x is at its right hand, where west is
    # when north is up, seen from inside the sphere
    up = (xi * s + eta * c) / px
    right = (-xi * c + eta * s) / px * optics.parity
    stretch = 1.0 + optics.distortion_px2 * (up * up + right * right)
    return (optics.width_px - 1) / 2.0 + right * stretch, (optics.height_px - 1) / 2.0 + up * stretch


def _on_detector(center: Icrs, projection: str, ra_deg: Array, dec_deg: Array) -> tuple[Array, Array]:
    """East and north of the axis, in focal lengths; NaN for what no such lens shows."""
    if projection == "gnomonic":
        return gnomonic(ra_deg, dec_deg, center.ra_deg, center.dec_deg)
    lon, lat = np.radians(ra_deg - center.ra_deg), np.radians(dec_deg)
    sin0, cos0 = math.sin(math.radians(center.dec_deg)), math.cos(math.radians(center.dec_deg))
    east = np.cos(lat) * np.sin(lon)
    north = cos0 * np.sin(lat) - sin0 * np.cos(lat) * np.cos(lon)
    depth = sin0 * np.sin(lat) + cos0 * np.cos(lat) * np.cos(lon)
    across = np.hypot(east, north)
    away = np.arctan2(across, depth)
    r = away
    if projection == "equisolid":
        r = 2.0 * np.sin(0.5 * away)
    elif projection == "stereographic":
        r = 2.0 * np.tan(0.5 * np.minimum(away, _BEHIND_RAD))
    r = np.where(away < _BEHIND_RAD, r, np.nan) / np.maximum(across, 1e-300)
    return r * east, r * north


def draw_frame(
    center: Icrs,
    optics: SimulatedOptics,
    catalog: Catalog,
    *,
    exposure_s: float,
    mid_exposure_utc: datetime,
    seed: int | tuple[int, ...],
    told: Icrs | None = None,
    trails: Sequence[SatelliteTrail] = (),
    drift_arcsec_s: tuple[float, float] = (0.0, 0.0),
    tube: Callable[[datetime], Icrs] | None = None,
    bodies: Sequence[MovingBody] = (),
) -> Frame:
    """Draw what the camera would see.

    Parameters
    ----------
    center : Icrs
        Where the optical axis truly looks at mid-exposure.
    optics : SimulatedOptics
        Telescope and camera.
    catalog : Catalog
        Its stars are drawn at the epoch of `mid_exposure_utc`.
    exposure_s : float
        Exposure time, > 0.
    mid_exposure_utc : datetime
        Aware.
    seed : int or tuple of int
        Of the noise; the same seed draws the same frame.
    told : Icrs, optional
        Place to write in the header as OBJCTRA and OBJCTDEC. The camera itself doesn't know any.
    trails : sequence of SatelliteTrail, optional
        What crosses the frame.
    drift_arcsec_s : (float, float), optional
        Rate of the optical axis during the exposure, east and north: stars are trailed, evenly about their
        places of mid-exposure.

    tube : callable, optional
        ``tube(utc)``: where the optical axis looks during the exposure, instead of an even drift: stars are
        trailed as it moves among them.
    bodies : sequence of MovingBody, optional
        What moves among the stars: each is trailed as it moves in the frame.

    Returns
    -------
    Frame
        uint16 pixels, row 0 at the bottom (FITS order); its hint holds the scale within 5 % and no place.

    Notes
    -----
    Shot noise is drawn as Gaussian. Left out: differential aberration over the field (0.1″ per 20′).
    """
    sigma_px = optics.fwhm_px / math.sqrt(8.0 * math.log(2.0))
    if tube is None:
        centers = centers_during(
            center, drift_arcsec_s, exposure_s, scale_arcsec_px=optics.scale_arcsec_px, sigma_px=sigma_px
        )
    else:
        instants = instants_during(
            tube, mid_exposure_utc, exposure_s, scale_arcsec_px=optics.scale_arcsec_px, sigma_px=sigma_px
        )
        centers = [center] if len(instants) == 1 else [tube(utc) for utc in instants]
    light = _star_light(center, optics, catalog, exposure_s, julian_year(mid_exposure_utc), centers)
    add_trails(light, trails)
    for body in bodies:
        _add_body(light, body, tube or (lambda _: center), optics, exposure_s, mid_exposure_utc)
    light += optics.sky_adu_s * exposure_s
    pixels = _with_noise(light, optics, np.random.Generator(np.random.SFC64(seed)))
    low, high = 0.95 * optics.scale_arcsec_px, 1.05 * optics.scale_arcsec_px
    return Frame(
        pixels=pixels,
        mid_exposure_utc=mid_exposure_utc,
        exposure_s=exposure_s,
        saturation_adu=float(optics.saturation_adu),
        hint=Hint(scale_low_arcsec_px=low, scale_high_arcsec_px=high),
        source=optics.instrument,
        header=_header(optics, exposure_s, mid_exposure_utc, told),
    )


def _star_light(
    center: Icrs,
    optics: SimulatedOptics,
    catalog: Catalog,
    exposure_s: float,
    epoch_yr: float,
    centers: Sequence[Icrs],
) -> NDArray[np.float32]:
    """Starlight in ADU, shape (height, width), shared evenly among the centers of the exposure."""
    # distortion can bring stars in from beyond the corner
    corner_px = math.hypot(optics.width_px, optics.height_px) / 2.0
    radius_deg = optics.half_diagonal_deg * (1.02 + abs(optics.distortion_px2) * corner_px**2)
    stars = catalog.cone(center, radius_deg, epoch_yr=epoch_yr)
    ra, dec, mag = stars.ra_deg, stars.dec_deg, stars.mag
    if optics.faint_stars_deg2 > 0.0:
        from mountnav.simulation.faint_stars import faint_stars  # astropy: dear, and seldom wanted

        more = faint_stars(center, radius_deg, optics.faint_stars_deg2, optics.faint_brightest_mag)
        ra, dec, mag = (np.concatenate(pair) for pair in zip((ra, dec, mag), more, strict=True))
    mag = np.where(np.isfinite(mag), mag, _UNKNOWN_MAG)
    flux = exposure_s * 10.0 ** (0.4 * (optics.zero_point_mag - mag))
    sigma = optics.fwhm_px / math.sqrt(8.0 * math.log(2.0))
    peak = flux / (math.tau * sigma * sigma)
    reach = np.ceil(sigma * np.sqrt(2.0 * np.log(np.maximum(peak / _WINGS_ADU, math.e))) + 1.0)
    light: NDArray[np.float32] = np.zeros((optics.height_px, optics.width_px), dtype=np.float32)
    part = 1.0 / len(centers)
    for place in centers:
        x, y = project(place, optics, ra, dec)
        for size in np.unique(reach[np.isfinite(x)]):
            group = reach == size
            _add_stars(light, x[group], y[group], part * flux[group], sigma, int(size))
    return light


def _add_body(
    light: NDArray[np.float32],
    body: MovingBody,
    tube: Callable[[datetime], Icrs],
    optics: SimulatedOptics,
    exposure_s: float,
    mid_exposure_utc: datetime,
) -> None:
    """Add a body's light, along its way in the frame."""
    sigma = optics.fwhm_px / math.sqrt(8.0 * math.log(2.0))
    instants = instants_during(
        body.path,
        mid_exposure_utc,
        exposure_s,
        scale_arcsec_px=optics.scale_arcsec_px,
        sigma_px=sigma,
        beside=tube,
    )
    flux = exposure_s * 10.0 ** (0.4 * (optics.zero_point_mag - body.mag)) / len(instants)
    peak = flux / (math.tau * sigma * sigma)
    reach = math.ceil(sigma * math.sqrt(2.0 * math.log(max(peak / _WINGS_ADU, math.e))) + 1.0)
    for utc in instants:
        place = body.path(utc)
        x, y = project(tube(utc), optics, np.array([place.ra_deg]), np.array([place.dec_deg]))
        if np.isfinite(x[0]) and np.isfinite(y[0]):
            _add_stars(light, x, y, np.array([flux]), sigma, reach)


def _add_stars(
    light: NDArray[np.float32], x_px: Array, y_px: Array, flux: Array, sigma_px: float, reach_px: int
) -> None:
    """Add Gaussian stars, integrated over each pixel, in stamps of one size; those outside are left out."""
    height, width = light.shape
    inside = (x_px > -reach_px - 1) & (x_px < width + reach_px) & (y_px > -reach_px - 1)
    inside &= y_px < height + reach_px
    x_px, y_px, flux = x_px[inside], y_px[inside], flux[inside]
    near_x, near_y = np.rint(x_px).astype(np.intp), np.rint(y_px).astype(np.intp)
    edges = np.arange(-reach_px, reach_px + 2) - 0.5
    scale = 1.0 / (math.sqrt(2.0) * sigma_px)
    share_x = 0.5 * np.diff(erf((edges + (near_x - x_px)[:, None]) * scale), axis=1)
    share_y = 0.5 * np.diff(erf((edges + (near_y - y_px)[:, None]) * scale), axis=1) * flux[:, None]
    for i in range(x_px.size):
        left, low = near_x[i] - reach_px, near_y[i] - reach_px
        x0, x1 = max(left, 0), min(left + edges.size - 1, width)
        y0, y1 = max(low, 0), min(low + edges.size - 1, height)
        if x0 < x1 and y0 < y1:
            light[y0:y1, x0:x1] += np.outer(
                share_y[i, y0 - low : y1 - low], share_x[i, x0 - left : x1 - left]
            )


def _with_noise(
    light: NDArray[np.float32], optics: SimulatedOptics, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """Bias, shot and read noise, and the converter."""
    noise = rng.standard_normal(light.shape, dtype=np.float32)
    noise *= np.sqrt(light * np.float32(1.0 / optics.gain_e_adu) + np.float32(optics.read_noise_adu**2))
    noise += light
    noise += np.float32(optics.bias_adu + 0.5)  # rounds where the conversion truncates
    np.clip(noise, 0.0, optics.saturation_adu, out=noise)
    return noise.astype(np.uint16)


def _header(
    optics: SimulatedOptics, exposure_s: float, mid_exposure_utc: datetime, told: Icrs | None
) -> dict[str, str | int | float | bool]:
    start = (mid_exposure_utc - timedelta(seconds=exposure_s / 2.0)).astimezone(UTC)
    cards: dict[str, str | int | float | bool] = {
        "DATE-OBS": start.replace(tzinfo=None).isoformat(timespec="microseconds"),
        "EXPTIME": exposure_s,
        "FOCALLEN": round(optics.focal_length_mm, 3),
        "XPIXSZ": optics.pixel_um,
        "YPIXSZ": optics.pixel_um,
        "XBINNING": 1,
        "YBINNING": 1,
        "INSTRUME": optics.instrument,
    }
    if told is not None:
        cards["OBJCTRA"] = sexagesimal_text(told.ra_deg % 360.0 / DEG_PER_HOUR, 2, wrap=24)
        cards["OBJCTDEC"] = sexagesimal_text(told.dec_deg, 1, plus="+")
    return cards
