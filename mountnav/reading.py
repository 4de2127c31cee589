"""Files and uploads become Frames here, in file order; what is no image becomes a BadFrame with advice."""

from __future__ import annotations

import bz2
import gzip
import io
import warnings
import zlib
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.io.fits.verify import VerifyWarning
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from mountnav.bayer import is_mosaic, without_mosaic
from mountnav.errors import BadFrame
from mountnav.frames import Frame
from mountnav.header_hints import hint_from_header
from mountnav.header_times import exposure_s_from_header, mid_exposure_from_header

Card = str | int | float | bool
Pixels = NDArray[np.generic]

#: More pixels than any camera on a telescope has; guards against decompression bombs.
MOST_PIXELS = 300_000_000
_MOST_BYTES = 2_500_000_000
_SMALLEST_SIDE_PX = 16
_SIDE_PLANES = ("mask", "weight", "wht", "err", "dq", "flags", "variance", "ivar", "bpm")
_SATURATION_CARDS = ("SATURATE", "SATLEVEL", "SATURATI", "SATUR")


def read_frame(source: Path | bytes, *, name: str | None = None) -> Frame:
    """Read one image file or upload.

    FITS (integers and floats, scaled, tile-compressed, several extensions, three color planes), plain or in
    gzip or bzip2, and whatever pillow reads (PNG, JPEG, TIFF, BMP). Pixels stay in file order, never flipped:
    row 0 is FITS row 1, or the top row of the other formats. Color becomes the mean of the planes; a raw
    Bayer mosaic is smoothed so that pixel coordinates stay the same (`mountnav.bayer`).

    Parameters
    ----------
    source : Path or bytes
        A file, or an upload's content.
    name : str, optional
        What to call the frame; the file's name if left out.

    Returns
    -------
    Frame
        With mid-exposure UTC, exposure, saturation level and hint as far as the header tells them.

    Raises
    ------
    BadFrame
        Not readable, empty, cut short, no image inside, or of an absurd size.
    """
    if isinstance(source, Path):
        label = name or source.name
        try:
            content = source.read_bytes()
        except OSError as fault:
            raise BadFrame(
                f"the file can't be read: {fault.strerror or fault}",
                device=label,
                advice="check the path and the rights on it",
            ) from fault
    else:
        label = name or "upload"
        content = source
    if not content:
        raise BadFrame(
            "the file is empty",
            device=label,
            advice="the camera may still be writing it, or the disk is full",
        )
    content = _unpacked(content, label)
    if content[:6] == b"SIMPLE":
        return _from_fits(content, label)
    return _from_picture(content, label)


def _unpacked(content: bytes, label: str) -> bytes:
    """Take the gzip or bzip2 wrapping off, if there is one."""
    if content[:2] != b"\x1f\x8b" and content[:3] != b"BZh":
        return content
    stream = io.BytesIO(content)
    try:
        with gzip.GzipFile(fileobj=stream) if content[:1] == b"\x1f" else bz2.BZ2File(stream) as packed:
            plain = packed.read(_MOST_BYTES + 1)
    except (OSError, EOFError, zlib.error) as fault:
        raise BadFrame(
            f"the compressed file is damaged or cut short: {fault}",
            device=label,
            advice="copy it again, or wait until it is written completely",
        ) from fault
    if len(plain) > _MOST_BYTES:
        raise BadFrame("the file unpacks to an absurd size", device=label, advice="send a single image")
    if not plain:
        raise BadFrame("the compressed file is empty", device=label, advice="copy it again")
    return plain


def _from_fits(content: bytes, label: str) -> Frame:
    with warnings.catch_warnings():
        # Cards that break the standard are common and harmless here; truncation is checked below, by size.
        warnings.simplefilter("ignore", VerifyWarning)
        warnings.filterwarnings("ignore", message=".*(truncated|non-ASCII|non-standard|Invalid|Unexpected).*")
        try:
            with fits.open(io.BytesIO(content), memmap=False, mode="readonly") as hdus:
                hdu = _image_hdu(hdus, label)
                _check_whole(hdu, len(content), label)
                header = _plain_cards(hdus[0].header)
                if hdu is not hdus[0]:
                    header = {key: value for key, value in header.items() if not _describes_pixels(key)}
                    header |= _plain_cards(hdu.header)
                pixels = hdu.data
        except (OSError, ValueError, TypeError, KeyError, IndexError, fits.VerifyError, zlib.error) as fault:
            raise BadFrame(
                f"this FITS file can't be read: {fault}",
                device=label,
                advice="it may be damaged or cut short; try it with `fitsverify`",
            ) from fault
    if pixels is None:
        raise BadFrame("the FITS file holds no pixels", device=label, advice="send the image, not its header")
    return _frame(_one_plane(np.asarray(pixels), label), header, label)


def _image_hdu(hdus: fits.HDUList, label: str) -> fits.PrimaryHDU:
    """Return the largest image, science planes before masks and weights; the first among equals."""
    best: fits.PrimaryHDU = None
    best_rank = (-1, -1)
    for hdu in hdus:
        if not hdu.is_image or hdu.header.get("NAXIS", 0) < 2:
            continue
        shape = hdu.shape
        aside = any(word in hdu.name.lower() for word in _SIDE_PLANES)
        rank = (0 if aside else 1, int(np.prod(shape[-2:], dtype=np.int64)))
        if rank > best_rank:
            best, best_rank = hdu, rank
    if best is None:
        raise BadFrame(
            "the FITS file holds no image, only headers or tables",
            device=label,
            advice="send the exposure itself; star lists and tables can't be solved",
        )
    planes = int(np.prod(best.shape[:-2], dtype=np.int64))
    if best_rank[1] * planes > MOST_PIXELS:
        raise BadFrame(
            f"the image claims {best.shape[-1]} × {best.shape[-2]} pixels in {planes} planes",
            device=label,
            advice=f"more than {MOST_PIXELS} pixels are not read",
        )
    return best


def _check_whole(hdu: fits.PrimaryHDU, length: int, label: str) -> None:
    """Refuse an image whose data unit reaches beyond the end of the file."""
    if isinstance(hdu, fits.CompImageHDU):
        return  # a cut tile raises when it is unpacked
    bytes_each = abs(int(hdu.header["BITPIX"])) // 8
    wanted = hdu.fileinfo()["datLoc"] + bytes_each * int(np.prod(hdu.shape, dtype=np.int64))
    if wanted > length:
        raise BadFrame(
            f"the FITS file is cut short: {length} of {wanted} bytes are there",
            device=label,
            advice="copy it again, or wait until the camera has written it completely",
        )


def _describes_pixels(key: str) -> bool:
    """Tell whether a primary header's card is about its own (absent) pixels, not about the exposure."""
    return key in ("SIMPLE", "BITPIX", "EXTEND", "BZERO", "BSCALE", "BLANK") or key.startswith("NAXIS")


def _plain_cards(header: fits.Header) -> dict[str, Card]:
    cards: dict[str, Card] = {}
    for card in header.cards:
        try:
            key, value = card.keyword, card.value
        except fits.VerifyError:
            continue  # unparsable: as good as absent
        if key and key not in ("COMMENT", "HISTORY") and isinstance(value, (str, int, float, bool)):
            cards[str(key)] = value
    return cards


def _one_plane(pixels: Pixels, label: str) -> Pixels:
    """Bring color planes and idle axes down to shape (height, width)."""
    while pixels.ndim > 2 and pixels.shape[0] == 1:
        pixels = pixels[0]
    if pixels.ndim == 3 and pixels.shape[0] in (2, 3, 4):
        return np.asarray(pixels[:3].mean(axis=0, dtype=np.float32))
    if pixels.ndim == 3 and pixels.shape[2] in (1, 2, 3, 4):
        return np.asarray(pixels[..., :3].mean(axis=2, dtype=np.float32))
    if pixels.ndim != 2:
        raise BadFrame(
            f"the data have the shape {' × '.join(map(str, pixels.shape))}",
            device=label,
            advice="send one image: two axes, or three with up to four color planes",
        )
    return pixels


def _from_picture(content: bytes, label: str) -> Frame:
    with warnings.catch_warnings():
        # pillow's own bomb warning starts lower than our limit, which is checked below
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        warnings.filterwarnings("ignore", module="PIL")
        try:
            with Image.open(io.BytesIO(content)) as picture:
                if picture.width * picture.height > MOST_PIXELS:
                    raise BadFrame(
                        f"the picture has {picture.width} × {picture.height} pixels",
                        device=label,
                        advice=f"more than {MOST_PIXELS} are not read",
                    )
                pixels = _picture_pixels(picture)
        except UnidentifiedImageError as fault:
            raise BadFrame(
                "this is no image of a kind that can be read",
                device=label,
                advice="send FITS (also .fz, .gz), PNG, JPEG, TIFF or BMP; convert camera raw files first",
            ) from fault
        except Image.DecompressionBombError as fault:
            raise BadFrame(
                "the picture claims an absurd size",
                device=label,
                advice=f"more than {MOST_PIXELS} pixels are not read",
            ) from fault
        except (OSError, ValueError, SyntaxError, EOFError, zlib.error) as fault:
            raise BadFrame(
                f"the picture is damaged or cut short: {fault}",
                device=label,
                advice="copy it again, or wait until it is written completely",
            ) from fault
    return _frame(pixels, {}, label)


def _picture_pixels(picture: Image.Image) -> Pixels:
    if picture.mode in ("L", "I", "F") or picture.mode.startswith("I;16"):
        return np.array(picture)
    if picture.mode in ("1", "LA"):
        return np.array(picture.convert("L"))
    color = np.asarray(picture if picture.mode == "RGB" else picture.convert("RGB"))
    mean = color.mean(axis=2, dtype=np.float32)
    same = bool((color[..., 0] == color[..., 1]).all() and (color[..., 0] == color[..., 2]).all())
    return np.array(color[..., 0]) if same else mean


def _frame(pixels: Pixels, header: dict[str, Card], label: str) -> Frame:
    if pixels.dtype.kind not in "uif":
        raise BadFrame(
            f"pixels of the type {pixels.dtype} are no brightness", device=label, advice="send numbers"
        )
    height, width = pixels.shape
    if min(height, width) < _SMALLEST_SIDE_PX:
        raise BadFrame(
            f"the image has only {width} × {height} pixels",
            device=label,
            advice=f"at least {_SMALLEST_SIDE_PX} on each side are needed",
        )
    pixels = np.ascontiguousarray(pixels, dtype=pixels.dtype.newbyteorder("="))
    saturation_adu = _saturation_card(header)
    if is_mosaic(pixels, header):
        pixels = without_mosaic(pixels)
    return Frame(
        pixels=pixels,
        mid_exposure_utc=mid_exposure_from_header(header),
        exposure_s=exposure_s_from_header(header),
        saturation_adu=saturation_adu,
        hint=hint_from_header(header, width, height),
        source=label,
        header=header,
    )


def _saturation_card(header: dict[str, Card]) -> float | None:
    for key in _SATURATION_CARDS:
        value = header.get(key)
        if isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value < 1e10:
            return float(value)
    return None
