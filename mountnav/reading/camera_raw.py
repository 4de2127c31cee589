"""Raw files of cameras (CR2, CR3, NEF, ARW, DNG), by LibRaw: the sensor's own numbers, nothing developed.

LibRaw comes with rawpy, the extra ``mountnav[raw]``. Most of these files are TIFFs with a small preview in
front, which must not be taken for the frame: they are known by what only they have.
"""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.reading.content import Content
from mountnav.reading.fits_headers import MOST_PIXELS, Value

Pixels = NDArray[np.generic]

_DNG_VERSION, _SUB_IFDS, _MAKE = 50706, 330, 271
"""Tags of TIFF: of DNG alone; of images within an image; of the camera's maker [TIFF 6.0; DNG 1.7]."""
_MOST_TAGS = 1000
"""Of a TIFF's first directory; cameras write about 50."""
_TIFF_HEAD_BYTES = 8
"""Byte order, mark and place of the first directory [TIFF 6.0]."""
_TAG_BYTES = 12
"""Of each entry of a directory [TIFF 6.0]."""
_MOST_EXIF_BYTES = 1 << 20
"""Of a file, in which its Exif is looked for; cameras write it in front of the pixels."""
_EXIF_IFD, _EXPOSURE, _TAKEN, _ZONE, _FRACTION = 0x8769, 0x829A, 0x9003, 0x9011, 0x9291
"""Tags of Exif: its directory; seconds of exposure; when it began, its zone, its parts of a second."""


def is_camera_raw(content: Content) -> bool:
    """Tell whether a file is a camera's raw file, by how it begins."""
    head = bytes(content[:16])
    if head[4:12] == b"ftypcrx ":
        return True  # CR3
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(head[:4])
    if order is None or len(head) < _TIFF_HEAD_BYTES:
        return False
    if head[8:10] == b"CR":
        return True  # CR2
    tags = _tags(content, order)
    return _DNG_VERSION in tags or {_SUB_IFDS, _MAKE} <= tags


def _tags(content: Content, order: str) -> set[int]:
    """The tags of a TIFF's first directory."""
    (at,) = struct.unpack(order + "I", bytes(content[4:8]))
    head = bytes(content[at : at + 2])
    if len(head) < 2:
        return set()
    count = min(struct.unpack(order + "H", head)[0], _MOST_TAGS)
    directory = bytes(content[at + 2 : at + 2 + _TAG_BYTES * count])
    return {
        struct.unpack_from(order + "H", directory, place)[0]
        for place in range(0, len(directory) - _TAG_BYTES + 1, _TAG_BYTES)
    }


def read_camera_raw(content: Content, label: str) -> tuple[Pixels, dict[str, Value]]:
    """Read a camera's raw file.

    Parameters
    ----------
    content : bytes, bytearray or OnDisk
        The file, in memory or where it lies on disk.
    label : str
        What to call it in messages.

    Returns
    -------
    pixels : ndarray, shape (height, width)
        The sensor's visible part, row 0 at the top, as the sensor lies: no turning is applied.
    header : dict
        BAYERPAT, SATURATE; EXPTIME and DATE-OBS as far as the file tells them. A time without its zone is
        left out: it may be wrong by a day.

    Raises
    ------
    BadFrame
        rawpy isn't installed, or the file is damaged or of a kind that LibRaw can't read.
    """
    try:
        import rawpy
    except ImportError as missing:
        raise BadFrame(
            "camera raw files are read by rawpy, which is not installed",
            device=label,
            advice="pip install 'mountnav[raw]', or convert the file to FITS or TIFF",
        ) from missing
    packed = bytes(content[:])
    try:
        with rawpy.imread(io.BytesIO(packed)) as raw:
            if raw.sizes.raw_width * raw.sizes.raw_height > MOST_PIXELS:
                raise BadFrame(
                    f"the image claims {raw.sizes.raw_width} × {raw.sizes.raw_height} pixels",
                    device=label,
                    advice=f"more than {MOST_PIXELS} pixels are not supported",
                )
            if raw.raw_type != rawpy.RawType.Flat:
                raise BadFrame(
                    "this raw file holds colors, not the sensor's numbers",
                    device=label,
                    advice="save it as TIFF",
                )
            pixels = np.array(raw.raw_image_visible)
            header = _header(raw)
    except rawpy.LibRawError as fault:
        words = fault.args[0] if fault.args else fault
        text = words.decode("utf-8", "replace") if isinstance(words, bytes) else str(words)
        raise BadFrame(
            f"the raw file is damaged, cut short or of an unknown camera: {text}",
            device=label,
            advice="copy it again, or convert it to FITS or TIFF",
        ) from fault
    except (ValueError, MemoryError, OSError) as fault:
        raise BadFrame(
            f"the raw file can't be read: {fault}", device=label, advice="copy it again"
        ) from fault
    return pixels, header | _exif(packed)


def _header(raw: Any) -> dict[str, Value]:
    header: dict[str, Value] = {}
    pattern, colors = raw.raw_pattern, raw.color_desc.decode("ascii", "replace")
    if pattern is not None and pattern.shape == (2, 2) and pattern.max() < len(colors):
        header["BAYERPAT"] = "".join(colors[number] for number in pattern.ravel())
    if raw.white_level:
        header["SATURATE"] = int(raw.white_level)
    return header


def _exif(packed: bytes) -> dict[str, Value]:
    """Exposure and instant of those that are TIFFs; CR3 keeps them elsewhere."""
    from PIL import Image

    header: dict[str, Value] = {}
    try:
        exif = Image.Exif()
        exif.load(packed[:_MOST_EXIF_BYTES])
        tags = exif.get_ifd(_EXIF_IFD)
        exposure_s = float(tags.get(_EXPOSURE, 0.0))
        if 0.0 < exposure_s < 1e5:
            header["EXPTIME"] = exposure_s
        taken, zone = str(tags.get(_TAKEN, "")), str(tags.get(_ZONE, "")).strip()
        if taken and zone:
            from datetime import UTC, datetime

            fraction = str(tags.get(_FRACTION, "")).strip(" \0")
            text = f"{taken[:19]}.{fraction if fraction.isdecimal() else '0'} {zone.replace('Z', '+00:00')}"
            began = datetime.strptime(text, "%Y:%m:%d %H:%M:%S.%f %z").astimezone(UTC)
            header["DATE-OBS"] = f"{began:%Y-%m-%dT%H:%M:%S.%f}"
    except Exception:  # pillow's parser of tags raises all kinds; the pixels are what is wanted
        return header
    return header
