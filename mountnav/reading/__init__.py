"""Files, uploads and arrays become Frames here, in file order; what is no image becomes a BadFrame."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.files import open_plain
from mountnav.frames import Frame, StarList
from mountnav.reading.bayer import is_mosaic, without_mosaic
from mountnav.reading.camera_raw import is_camera_raw, read_camera_raw
from mountnav.reading.content import Content, OnDisk
from mountnav.reading.fits_headers import Value
from mountnav.reading.fits_images import read_fits
from mountnav.reading.header_hints import hint_from_header
from mountnav.reading.header_times import exposure_s_from_header, mid_exposure_from_header, number
from mountnav.reading.star_lists import ListFormat, is_star_list, read_star_list, star_list_of
from mountnav.reading.unpacking import unpacked

Pixels = NDArray[np.generic]

_SMALLEST_SIDE_PX = 16
"""A smaller picture is refused: no background can be measured on it; chosen by hand."""
_SATURATION_CARDS = ("SATURATE", "SATLEVEL", "SATURATI", "SATUR")
_ROWS_AT_ONCE = 256
"""Rows that are looked at together for values that are no numbers; chosen by hand, to keep memory small."""
_LARGEST_ADU = 1e15
"""A pixel beyond is no brightness: no converter has 50 bits. Squares of less fit in 32-bit floats, also when
a million of them are summed; doubled, nothing changes but for nonsense."""

__all__ = ["ListFormat", "demosaiced", "frame_from_array", "read_frame", "read_source", "star_list_of"]


def read_frame(
    source: Path | bytes, *, name: str | None = None, hdu: int | str | None = None, raw: bool = False
) -> Frame:
    """Read one image file or upload.

    FITS (integers and floats, scaled, tile-compressed, several extensions, three color planes), plain or in
    gzip or bzip2; XISF; PNG, JPEG, TIFF, BMP; and raw files of cameras, where rawpy is installed. Pixels
    stay in file order, never flipped: row 0 is FITS row 1, or the top row of the other formats. Color
    becomes the mean of the planes; a raw Bayer mosaic is smoothed so that pixel coordinates stay the same
    (`mountnav.reading.bayer`). Infinite pixels become NaN.

    Safe to call in several threads at once.

    Parameters
    ----------
    source : Path or bytes
        A file, or an upload's content.
    name : str, optional
        What to call the frame; the file's name if left out.
    hdu : int or str, optional
        Which FITS extension holds the image, by number (0 is the primary) or by EXTNAME; of an XISF file
        which image, by number or id. Chosen if left out.
    raw : bool
        Leave a mosaic as it is (`Frame.mosaic` tells), for masters to be applied; `demosaiced` does the rest.

    Returns
    -------
    Frame
        With mid-exposure UTC, exposure, saturation level and hint as far as the header tells them.

    Raises
    ------
    BadFrame
        Not readable, empty, cut short, no image inside, or of an absurd size.
    """
    if not isinstance(source, Path):
        frame = _read(source, name or "upload", hdu)
        return frame if raw else demosaiced(frame)
    label = name or source.name
    try:
        with open_plain(source) as file:
            frame = _read(OnDisk(file), label, hdu)
    except OSError as fault:
        raise BadFrame(
            f"the file can't be read: {fault.strerror or fault}",
            device=label,
            advice="check the path and the rights on it; pipes and devices are not supported",
        ) from fault
    return frame if raw else demosaiced(frame)


def read_source(
    source: Path | bytes,
    *,
    name: str | None = None,
    hdu: int | str | None = None,
    raw: bool = False,
    stars: ListFormat | None = None,
) -> Frame | StarList:
    """Read an image, or a list of stars: its content tells which it is.

    Parameters
    ----------
    source, name, hdu, raw
        As for `read_frame`.
    stars : ListFormat, optional
        How a list is to be read.

    Raises
    ------
    BadFrame
        Neither an image nor a list of stars.
    """
    label = name or (source.name if isinstance(source, Path) else "upload")
    if not isinstance(source, Path):
        if is_star_list(source):
            return read_star_list(source, label, stars)
    else:
        with suppress(OSError), open_plain(source) as file:  # what can't be opened is told below
            content = OnDisk(file)
            if is_star_list(content):
                return read_star_list(content, label, stars)
    return read_frame(source, name=name, hdu=hdu, raw=raw)


def frame_from_array(
    pixels: Pixels,
    header: Mapping[str, Value] | None = None,
    *,
    name: str = "array",
    raw: bool = False,
) -> Frame:
    """Make a frame of pixels that are in memory already, as `read_frame` makes one of a file.

    Parameters
    ----------
    pixels : ndarray
        Shape (height, width), or three color planes as (3, height, width) or (height, width, 3). Masked
        pixels become NaN. The array itself is never changed, and not copied where that isn't needed.
    header : mapping, optional
        FITS cards, for the time, the exposure, the saturation level and the hint.
    name : str
        What to call the frame.
    raw : bool
        As for `read_frame`.

    Raises
    ------
    BadFrame
        No image by shape, size or type.
    """
    plane, own = np.asarray(pixels), False
    if np.ma.is_masked(pixels):
        if plane.dtype.kind in "iu":
            plane = plane.astype(np.float32 if plane.dtype.itemsize <= 2 else np.float64)
        elif plane.dtype.kind == "f":
            plane = plane.copy()
        if plane.dtype.kind == "f":  # all else is refused below
            plane[np.ma.getmaskarray(pixels)], own = np.nan, True
    frame = _frame(plane, dict(header or {}), {}, name, own=own)
    return frame if raw else demosaiced(frame)


def demosaiced(frame: Frame) -> Frame:
    """Smooth a frame that is a raw Bayer mosaic; any other is returned as it is, so that twice is as once.

    Parameters
    ----------
    frame : Frame
        As `read_frame` with ``raw=True`` gives it, calibrated or not.

    Returns
    -------
    Frame
        `Frame.mosaic` is False, the pixels are float32 if they were a mosaic; places stay the same.
    """
    if not frame.mosaic:
        return frame
    return replace(frame, pixels=without_mosaic(frame.pixels), mosaic=False)


def _read(content: Content, label: str, hdu: int | str | None) -> Frame:
    if not content:
        raise BadFrame(
            "the file is empty",
            device=label,
            advice="the camera may still be writing it, or the disk is full",
        )
    content = unpacked(content, label)
    if content[:6] == b"SIMPLE":
        image = read_fits(content, label, hdu)
        frame = _frame(image.pixels, image.values, image.comments, label, own=True)
        return replace(frame, notes=(image.note,)) if image.note else frame
    if content[:8] == b"XISF0100":
        from mountnav.reading.xisf import read_xisf

        found = read_xisf(content, label, hdu)
        frame = _frame(found.pixels, found.values, found.comments, label, own=not isinstance(content, bytes))
        return replace(frame, notes=(found.note,)) if found.note else frame
    if hdu not in (None, 0):
        raise BadFrame(
            f"there is no extension {hdu}: this is not a FITS file",
            device=label,
            advice="leave the choice out",
        )
    if is_camera_raw(content):
        pixels, header = read_camera_raw(content, label)
        return _frame(pixels, header, {}, label, own=True)
    from mountnav.reading.pictures import read_picture

    return _frame(read_picture(bytes(content[:]), label), {}, {}, label, own=True)


def _frame(
    pixels: Pixels, header: dict[str, Value], comments: dict[str, str], label: str, *, own: bool
) -> Frame:
    """Make the frame; `own` pixels belong to nobody else and may be changed."""
    if pixels.dtype.kind not in "uif":
        raise BadFrame(
            f"pixels of the type {pixels.dtype} are not numbers",
            device=label,
            advice="send integer or float pixels",
        )
    plane = _one_plane(pixels, label)
    height, width = plane.shape
    if min(height, width) < _SMALLEST_SIDE_PX:
        raise BadFrame(
            f"the image has only {width} × {height} pixels",
            device=label,
            advice=f"at least {_SMALLEST_SIDE_PX} on each side are needed",
        )
    kind = plane.dtype.newbyteorder("=")
    if kind.kind == "f" and kind.itemsize not in (4, 8):
        kind = np.dtype(np.float32 if kind.itemsize < 4 else np.float64)
    plane = np.ascontiguousarray(plane, dtype=kind)
    plane = _without_absurd(plane, own=own or not np.shares_memory(plane, pixels), label=label)
    return Frame(
        pixels=plane,
        mid_exposure_utc=mid_exposure_from_header(header, comments),
        exposure_s=exposure_s_from_header(header, comments),
        saturation_adu=_saturation_card(header, comments),
        hint=hint_from_header(header, width, height, comments),
        source=label,
        header=header,
        mosaic=is_mosaic(plane, header),
    )


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


def _without_absurd(plane: Pixels, *, own: bool, label: str) -> Pixels:
    """Make infinite and absurd pixels NaN, and refuse a frame that has no others."""
    if plane.dtype.kind != "f":
        return plane
    some = False
    for at in range(0, plane.shape[0], _ROWS_AT_ONCE):
        rows = plane[at : at + _ROWS_AT_ONCE]
        absurd = np.abs(rows) > _LARGEST_ADU
        if absurd.any():
            if not own:
                plane, own = plane.copy(), True
                rows = plane[at : at + _ROWS_AT_ONCE]
            rows[absurd] = np.nan
        some = some or bool(np.isfinite(rows).any())
    if not some:
        raise BadFrame(
            "no pixel of the image has a value",
            device=label,
            advice="all are NaN, infinite or absurd; send another frame",
        )
    return plane


def _saturation_card(header: Mapping[str, Value], comments: Mapping[str, str]) -> float | None:
    """Return the level from which a pixel is saturated; DATAMAX only where its comment says so."""
    keys = [*_SATURATION_CARDS]
    if re.search(r"saturat", comments.get("DATAMAX", ""), re.I):
        keys.append("DATAMAX")
    for key in keys:
        value = number(header.get(key))
        if value is not None and 0.0 < value < 1e10:
            return value
    return None
