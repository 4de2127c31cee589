"""The files of a solved job: WCS header, new FITS, tables of stars, an annotated picture; and annotations."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from api.nova.submissions import Result
from mountnav.clock import utc_now
from mountnav.sky.named import named_objects
from mountnav.sky.proper_motion import moved_to
from mountnav.sky.sphere import gnomonic
from mountnav.sky.wcs import sip_distorted

if TYPE_CHECKING:
    from mountnav.frames import Frame

__all__ = [
    "annotations_of",
    "axy_table",
    "corr_table",
    "object_names",
    "picture",
    "rdls_table",
]

Array = NDArray[np.float64]

_LONGEST_SIDE_PX = 1200
"""Of the annotated picture, pixels; chosen by hand: it fills a screen. Doubled, four times the size."""
_CIRCLED_MOST = 200
"""Identified stars that are circled, the brightest; more would hide the picture."""
_CIRCLE_PX, _NAMED_CIRCLE_PX = 6, 14
"""Radii of the circles in the picture, pixels; chosen by hand."""
_DARK_SHARE, _BRIGHT_SHARE = 0.6, 0.999
"""Quantiles of the pixels that become black and white; chosen by hand: stars show on a dark sky."""
_BEYOND_DEG = 60.0
"""A place further from the tangent point isn't projected, degrees; the tangent plane ends at 90."""
_STEPS_MOST, _STEP_PX = 20, 0.01
"""The inverse of the distortion is sought in so many steps, to so many pixels: a label needs no more."""
_STRETCH = 0.5
"""Exponent of the stretch of brightness; chosen by hand: the square root shows faint stars."""


@dataclass(frozen=True, slots=True)
class Named:
    """Something with a name in a frame."""

    kind: str
    names: tuple[str, ...]
    x_px: float
    y_px: float
    mag: float | None


def rdls_table(result: Result) -> bytes:
    """RA and Dec of the identified stars, degrees."""
    return _table({"RA": result.ra_deg, "DEC": result.dec_deg}, result, "RDLS")


def axy_table(result: Result) -> bytes:
    """The measured places, the brightest first; 1-based."""
    seen = np.asarray(result.seen_px, dtype=np.float64)
    return _table({"X": seen[:, 0] + 1.0, "Y": seen[:, 1] + 1.0}, result, "XYLS")


def corr_table(result: Result) -> bytes:
    """Measured places beside those of the catalog: pixels 1-based, degrees."""
    x, y = pixels_of(result.cards, result.ra_deg, result.dec_deg)
    ra, dec = _places(result.cards, result.x_px, result.y_px)
    columns = {
        "field_x": result.x_px + 1.0,
        "field_y": result.y_px + 1.0,
        "field_ra": ra,
        "field_dec": dec,
        "index_x": x + 1.0,
        "index_y": y + 1.0,
        "index_ra": result.ra_deg,
        "index_dec": result.dec_deg,
        "FLUX": result.flux,
        "MAG": result.mag,
    }
    return _table(columns, result, "CORR")


def _table(columns: dict[str, Array], result: Result, kind: str) -> bytes:
    from astropy.io import fits

    table = fits.BinTableHDU.from_columns(
        [fits.Column(name=name, format="D", array=values) for name, values in columns.items()]
    )
    primary = fits.PrimaryHDU()
    primary.header["AN_FILE"] = (kind, "what this table is, by astrometry.net's names")
    for name in ("IMAGEW", "IMAGEH"):
        for unit in (primary, table):
            unit.header[name] = (int(result.cards[name]), "[pix] of the frame")
    file = io.BytesIO()
    fits.HDUList([primary, table]).writeto(file)
    return file.getvalue()


def _places(cards: dict[str, Any], x_px: Array, y_px: Array) -> tuple[Array, Array]:
    from mountnav.sky.wcs import places_at_pixels

    return places_at_pixels(cards, x_px, y_px)


def pixels_of(cards: dict[str, Any], ra_deg: Array, dec_deg: Array) -> tuple[Array, Array]:
    """Pixels (0-based) of places; NaN for what is far away, or doesn't come back through the distortion."""
    ra, dec = np.asarray(ra_deg, dtype=float), np.asarray(dec_deg, dtype=float)
    ra0, dec0 = float(cards["CRVAL1"]), float(cards["CRVAL2"])
    near = _separation_deg(ra, dec, ra0, dec0) < _BEYOND_DEG
    x, y = np.full(ra.shape, np.nan), np.full(ra.shape, np.nan)
    if not near.any():
        return x, y
    xi, eta = gnomonic(ra[near], dec[near], ra0, dec0)
    matrix = np.array([[cards["CD1_1"], cards["CD1_2"]], [cards["CD2_1"], cards["CD2_2"]]], dtype=float)
    goal = np.linalg.solve(matrix, np.degrees(np.array([xi, eta])))
    u, v = goal.copy()
    off = np.full(u.shape, math.inf)
    for _ in range(_STEPS_MOST):
        with np.errstate(all="ignore"):
            there = sip_distorted(cards, u, v)
            du, dv = goal[0] - there[0], goal[1] - there[1]
            u, v, off = u + du, v + dv, np.hypot(du, dv)
        if not np.any(off > _STEP_PX):
            break
    sound = off <= _STEP_PX
    x[near] = np.where(sound, u + float(cards["CRPIX1"]) - 1.0, np.nan)
    y[near] = np.where(sound, v + float(cards["CRPIX2"]) - 1.0, np.nan)
    return x, y


def _separation_deg(ra: Array, dec: Array, ra0_deg: float, dec0_deg: float) -> Array:
    ra1, dec1, ra0, dec0 = np.radians(ra), np.radians(dec), math.radians(ra0_deg), math.radians(dec0_deg)
    cosine = np.sin(dec1) * math.sin(dec0) + np.cos(dec1) * math.cos(dec0) * np.cos(ra1 - ra0)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def named_in(result: Result) -> list[Named]:
    """Stars and Messier's objects with a name in the frame, the brightest first.

    Planets aren't told: their places need the time of the exposure.
    """
    fixed = [one for one in named_objects() if one.place is not None]
    utc = utc_now()
    places = [
        moved_to(
            one.place,
            utc,
            epoch_yr=one.epoch_yr,
            pm_ra_cosdec_masyr=one.pm_ra_cosdec_masyr,
            pm_dec_masyr=one.pm_dec_masyr,
            parallax_mas=one.parallax_mas,
        )
        for one in fixed
        if one.place is not None
    ]
    x, y = pixels_of(
        result.cards, np.array([one.ra_deg for one in places]), np.array([one.dec_deg for one in places])
    )
    width, height = int(result.cards["IMAGEW"]), int(result.cards["IMAGEH"])
    found = [
        Named(one.kind, (one.name, *one.aliases[:2]), float(x_px), float(y_px), one.mag)
        for one, x_px, y_px in zip(fixed, x, y, strict=True)
        if -0.5 <= x_px <= width - 0.5 and -0.5 <= y_px <= height - 0.5
    ]
    return sorted(found, key=lambda one: math.inf if one.mag is None else one.mag)


def object_names(result: Result) -> list[str]:
    """Names of what is in the field."""
    return [one.names[0] for one in named_in(result)]


def annotations_of(result: Result) -> list[dict[str, object]]:
    """What stands where in the frame, as nova's own: pixels 1-based, the brightest stars without names too.

    A star that has no name in our catalogs is called by its magnitude.
    """
    told: list[dict[str, object]] = []
    for one in named_in(result):
        kind = "bright" if one.kind == "star" else "messier"
        told.append(_annotation(kind, [name for name in one.names if name], one.x_px, one.y_px, one.mag))
    for star in range(min(_CIRCLED_MOST, result.x_px.size)):
        mag = float(result.mag[star])
        name = f"mag {mag:.1f}" if math.isfinite(mag) else "star"
        told.append(
            _annotation(
                "star",
                [name],
                float(result.x_px[star]),
                float(result.y_px[star]),
                mag if math.isfinite(mag) else None,
            )
        )
    return told


def _annotation(
    kind: str, names: list[str], x_px: float, y_px: float, mag: float | None
) -> dict[str, object]:
    told: dict[str, object] = {
        "type": kind,
        "names": names,
        "pixelx": round(x_px + 1.0, 3),
        "pixely": round(y_px + 1.0, 3),
        "radius": 0.0,
    }
    return told if mag is None else told | {"vmag": round(mag, 3)}


def picture(result: Result, frame: Frame | None, *, rows_from_top: bool) -> bytes:
    """The frame as a PNG, with its identified stars circled and its named objects named.

    Parameters
    ----------
    frame : Frame or None
        None: it isn't kept, or there never was one; stars on black.
    rows_from_top : bool
        The first row is the top one, as in PNG and JPEG; in FITS it is the lowest.
    """
    from PIL import Image, ImageDraw

    width, height = int(result.cards["IMAGEW"]), int(result.cards["IMAGEH"])
    step = max(1, math.ceil(max(width, height) / _LONGEST_SIDE_PX))
    rows, columns = height // step, width // step
    gray = np.zeros((rows, columns), np.uint8) if frame is None else _stretched(frame.pixels, step)
    if not rows_from_top:
        gray = gray[::-1]
    image = Image.fromarray(gray, "L").convert("RGB")
    draw = ImageDraw.Draw(image)

    def at(x_px: float, y_px: float) -> tuple[float, float]:
        row = y_px / step
        return x_px / step, row if rows_from_top else rows - 1 - row

    for star in range(min(_CIRCLED_MOST, result.x_px.size)):
        x, y = at(float(result.x_px[star]), float(result.y_px[star]))
        draw.ellipse((x - _CIRCLE_PX, y - _CIRCLE_PX, x + _CIRCLE_PX, y + _CIRCLE_PX), outline=(0, 190, 0))
    for one in named_in(result):
        x, y = at(one.x_px, one.y_px)
        radius = _NAMED_CIRCLE_PX
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=(255, 190, 0))
        words = one.names[0].encode("latin-1", "replace").decode("latin-1")
        draw.text((x + radius, y - radius), words, fill=(255, 190, 0))
    file = io.BytesIO()
    image.save(file, "PNG")
    return file.getvalue()


def _stretched(pixels: NDArray[Any], step: int) -> NDArray[np.uint8]:
    """The means of blocks of pixels, as brightness on a screen."""
    rows, columns = pixels.shape[0] // step, pixels.shape[1] // step
    blocks = pixels[: rows * step, : columns * step].reshape(rows, step, columns, step)
    plane = blocks.mean(axis=(1, 3), dtype=np.float32)
    sound = plane[np.isfinite(plane)]
    if not sound.size:
        return np.zeros(plane.shape, np.uint8)
    dark, bright = np.quantile(sound, (_DARK_SHARE, _BRIGHT_SHARE))
    part = (np.nan_to_num(plane, nan=float(dark)) - dark) / max(float(bright - dark), 1e-6)
    return np.asarray(255.0 * np.clip(part, 0.0, 1.0) ** _STRETCH, dtype=np.uint8)
