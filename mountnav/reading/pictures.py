"""Pictures (PNG, JPEG, TIFF, BMP, PGM) become brightness here, top row first, with all the bits they have.

pillow knows forty more kinds, some of which start other programs (Ghostscript for EPS): none but these five
is opened, whatever its name says.

pillow keeps only the upper byte of 16-bit color. Since its unpackers pick one byte out of two, the picture is
decoded a second time with the other byte order named, which gives the lower one.
"""

from __future__ import annotations

import io
import warnings
import zlib

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from mountnav.errors import BadFrame
from mountnav.reading.fits_headers import MOST_PIXELS
from mountnav.reading.unpacking import check_ratio

Pixels = NDArray[np.generic]

# pillow warns from 90 megapixels on, and a warning can't be silenced for one thread alone.
Image.MAX_IMAGE_PIXELS = MOST_PIXELS
# what it finds odd about a file (tags of TIFF, most of all) helps nobody who reads the service's log
warnings.filterwarnings("ignore", module=r"PIL\.")

FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "PPM")
"""Kinds of pictures that are read, as pillow calls them; each more is a decoder more that strangers reach."""


def read_picture(content: bytes, label: str) -> Pixels:
    """Decode a picture.

    An orientation tag (EXIF) is not applied: pixels stay where the file has them. Color becomes the mean of
    red, green and blue; transparency is left out of account; of several pages the first is read.

    Parameters
    ----------
    label : str
        What to call it in messages.

    Returns
    -------
    ndarray, shape (height, width)
        Row 0 is the top row.

    Raises
    ------
    BadFrame
        Of no known kind, damaged, cut short, or of an absurd size.
    """
    try:
        with Image.open(io.BytesIO(content), formats=FORMATS) as picture:
            if picture.width * picture.height > MOST_PIXELS:
                raise _too_large(f"the picture has {picture.width} × {picture.height} pixels", label)
            depth = len(picture.getbands()) * (4 if picture.mode in ("I", "F") else 2)
            check_ratio(picture.width * picture.height * depth, len(content), label)
            rawmode = _rawmode(picture)
            upper = np.array(_plain_mode(picture))
        if rawmode.startswith(("RGB;16", "RGBA;16", "RGBX;16", "LA;16")):
            return _brightness(_with_lower_byte(upper, content, rawmode))
        return _brightness(upper)
    except UnidentifiedImageError as fault:
        raise BadFrame(
            "this is not an image of a kind that can be read",
            device=label,
            advice="send FITS (also .fz, .gz), XISF, PNG, JPEG, TIFF, BMP or a camera's raw file",
        ) from fault
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as fault:
        raise _too_large("the picture claims an absurd size", label) from fault
    except (
        OSError,
        ValueError,
        SyntaxError,
        EOFError,
        TypeError,
        OverflowError,
        zlib.error,
        Warning,
    ) as fault:
        raise BadFrame(
            f"the picture is damaged or cut short: {fault}",
            device=label,
            advice="copy it again, or wait until it is written completely",
        ) from fault


def _too_large(what: str, label: str) -> BadFrame:
    return BadFrame(what, device=label, advice=f"more than {MOST_PIXELS} pixels are not supported")


def _rawmode(picture: Image.Image) -> str:
    """How the file stores a pixel, as pillow calls it; empty where it doesn't say."""
    tiles = getattr(picture, "tile", [])
    if not tiles:
        return ""
    arguments = tiles[0].args
    first = arguments[0] if isinstance(arguments, tuple) and arguments else arguments
    return first if isinstance(first, str) else ""


def _plain_mode(picture: Image.Image) -> Image.Image:
    """Bring palettes, black and white, and print colors down to gray or red, green, blue."""
    if picture.mode in ("L", "I", "F", "RGB", "RGBA", "LA") or picture.mode.startswith("I;16"):
        picture.load()
        return picture
    return picture.convert("L" if picture.mode in ("1", "La") else "RGB")


def _with_lower_byte(upper: Pixels, content: bytes, rawmode: str) -> Pixels:
    """Add the lower byte of 16-bit color, shape (height, width, channels)."""
    with Image.open(io.BytesIO(content), formats=FORMATS) as again:
        if rawmode.startswith("LA;16"):
            # four bytes a pixel: upper and lower byte of the gray, then of the transparency
            again._mode = "RGBA"
            other = "RGBA"
        else:
            other = rawmode[:-1] + ("L" if rawmode.endswith("B") else "B")
            if rawmode.endswith("N"):
                other = rawmode[:-1] + ("B" if np.little_endian else "L")
        again.tile = [
            tile._replace(args=(other, *tile.args[1:]) if isinstance(tile.args, tuple) else other)
            for tile in again.tile
        ]
        both = np.array(again)
    if rawmode.startswith("LA;16"):
        return np.asarray(both[..., :1].astype(np.uint16) * 256 + both[..., 1:2])
    return np.asarray(upper.astype(np.uint16) * 256 + both)


def _brightness(pixels: Pixels) -> Pixels:
    """Bring color down to one plane; equal channels keep their whole numbers."""
    if pixels.ndim == 2:
        return pixels
    if pixels.shape[2] < 3:
        return pixels[..., 0]
    first = pixels[..., 0]
    if bool((first == pixels[..., 1]).all() and (first == pixels[..., 2]).all()):
        return first
    return np.asarray(pixels[..., :3].mean(axis=2, dtype=np.float32))
