"""XISF files [XISF 1.0]: the pixels of an image, and its FITS keywords as a header.

A file is a short preamble, a header in XML, and blocks of data that the header points to. Read are images
whose data are attached, plain or packed by zlib, LZ4 or Zstandard, with or without shuffled bytes. The header
comes from strangers: it may hold no document type, so that no entity is ever expanded, its size and depth are
bounded, and nothing is unpacked before its size is known to be that of the image.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.extras import extra
from mountnav.reading.content import Content, stored
from mountnav.reading.fits_headers import MOST_PIXELS, Value, parsed_value
from mountnav.reading.unpacking import check_ratio

if TYPE_CHECKING:
    from collections.abc import Mapping

Pixels = NDArray[np.generic]

_PREAMBLE_BYTES = 16
"""Signature, length of the header, and a reserved word."""
_MOST_HEADER_BYTES = 64 << 20
"""Longest header that is read. One with a plate of splines in it has some MB; doubled, a made one costs twice
as much time and memory."""
_MOST_DEPTH = 32
"""Elements within elements; an image's keywords are at a depth of 3."""
_MOST_ELEMENTS = 200_000
"""Elements of a header; a long processing history has some thousands. Doubled, twice as much time."""
_MOST_BLOCKS = 100_000
"""Parts that a block may be packed in; PixInsight makes one for each GB or each thread."""
_SAMPLES = {"UInt8": "u1", "UInt16": "u2", "UInt32": "u4", "UInt64": "u8", "Float32": "f4", "Float64": "f8"}
"""Kinds of numbers as numpy calls them [XISF 1.0, section 8.5.4.4]; complex ones are no picture."""
_CODECS = {"zlib": "zlib", "lz4": "lz4_raw", "lz4hc": "lz4_raw", "zstd": "zstd"}
"""What packs a block, and what unpacks it, by pyarrow's names except zlib."""
_MOST_CHANNELS = 4
"""Color planes: red, green, blue, and one that tells how opaque it is."""


@dataclass(frozen=True, slots=True)
class XisfImage:
    """An image of the file.

    Attributes
    ----------
    pixels : ndarray, shape (height, width) or (channels, height, width)
        Row 0 is the top row; of more than three channels the first three.
    values, comments : dict
        FITS keywords that came along.
    note : str
        Of other images in the file, where nobody chose this one; else empty.
    """

    pixels: Pixels
    values: dict[str, Value]
    comments: dict[str, str]
    note: str = ""


@dataclass(slots=True)
class _Element:
    """An Image element, and what is in it."""

    attributes: Mapping[str, str]
    keywords: list[Mapping[str, str]] = field(default_factory=list)
    pattern: str = ""


class _Unfit(ValueError):
    """What is wrong with the file, for people."""


def read_xisf(content: Content, label: str, wanted: int | str | None = None) -> XisfImage:
    """Read an image of an XISF file.

    Parameters
    ----------
    content : bytes, bytearray or OnDisk
        The file, in memory or where it lies on disk.
    label : str
        What to call it in messages.
    wanted : int or str, optional
        Number (0 is the first) or id of the image; without it the largest, the first among equals.

    Raises
    ------
    BadFrame
        Damaged, cut short, of an absurd size, of a kind that isn't read, or without such an image.
    """
    try:
        images = _images(content)
        chosen = _chosen(images, wanted)
        pixels = _pixels(content, chosen.attributes, label)
    except EOFError as fault:
        raise _bad(f"cut short: {fault}", label) from fault
    except _Unfit as fault:
        raise _bad(str(fault), label) from fault
    values, comments = _header(chosen)
    others = len(images) - 1
    note = ""
    if wanted is None and others:
        note = f"image {images.index(chosen)} was taken; others in the file: {others}; --hdu chooses"
    return XisfImage(pixels, values, comments, note)


def _bad(what: str, label: str) -> BadFrame:
    return BadFrame(
        f"this XISF file can't be read: {what}",
        device=label,
        advice="copy it again, or save it as FITS",
    )


def _images(content: Content) -> list[_Element]:
    """The header's images, in order."""
    length = int.from_bytes(content[8:12], "little")
    if length > _MOST_HEADER_BYTES:
        raise _Unfit(f"its header claims {length} bytes")
    header = bytes(content[_PREAMBLE_BYTES : _PREAMBLE_BYTES + length])
    if len(header) < length:
        raise _Unfit("it is cut short within its header")
    images = _parsed(header.rstrip(b"\0"))
    if not images:
        raise _Unfit("it holds no image")
    return images


def _parsed(header: bytes) -> list[_Element]:
    images: list[_Element] = []
    path: list[str] = []
    count = 0

    def begin(name: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > _MOST_ELEMENTS or len(path) >= _MOST_DEPTH:
            raise _Unfit("its header has too many elements")
        name = name.rpartition(":")[2]
        path.append(name)
        inside = len(path) > 2 and path[-2] == "Image"
        if name == "Image" and path[:-1] == ["xisf"]:
            images.append(_Element(attributes))
        elif name == "FITSKeyword" and inside:
            images[-1].keywords.append(attributes)
        elif name == "ColorFilterArray" and inside:
            images[-1].pattern = attributes.get("pattern", "")

    def end(_: str) -> None:
        path.pop()

    def doctype(*_: object) -> None:
        raise _Unfit("its header declares a document type, as no camera's program does")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(header, True)
    except expat.ExpatError as fault:
        raise _Unfit(f"its header is not XML: {fault}") from fault
    except (ValueError, LookupError) as fault:  # an encoding that expat asks Python for
        if isinstance(fault, _Unfit):
            raise
        raise _Unfit(f"its header can't be decoded: {fault}") from fault
    return images


def _chosen(images: list[_Element], wanted: int | str | None) -> _Element:
    if wanted is None:
        sizes = [_size_or_none(image) for image in images]
        return images[max(range(len(images)), key=lambda at: (sizes[at], -at))]
    for at, image in enumerate(images):
        if str(wanted).strip() in (str(at), image.attributes.get("id")):
            return image
    there = ", ".join(
        f"{at} {image.attributes.get('id', '')}".strip() for at, image in enumerate(images[:20])
    )
    raise _Unfit(f"there is no image {wanted}; there are: {there}")


def _size_or_none(image: _Element) -> int:
    try:
        width, height, _ = _geometry(image.attributes)
    except _Unfit:
        return 0
    return width * height


def _geometry(attributes: Mapping[str, str]) -> tuple[int, int, int]:
    """Width, height and channels."""
    parts = attributes.get("geometry", "").split(":")
    if not all(part.isascii() and part.isdigit() and len(part) < 10 for part in parts) or len(parts) != 3:
        raise _Unfit(f"an image of the geometry {attributes.get('geometry', '')[:40]!r} is not a picture")
    width, height, channels = map(int, parts)
    if not width or not height or not channels:
        raise _Unfit("the image is empty")
    if width * height > MOST_PIXELS:
        raise _Unfit(f"the image claims {width} × {height} pixels")
    return width, height, channels


def _pixels(content: Content, attributes: Mapping[str, str], label: str) -> Pixels:
    width, height, channels = _geometry(attributes)
    if channels > _MOST_CHANNELS:
        raise _Unfit(f"it has {channels} channels, and is not a picture")
    kind = _SAMPLES.get(attributes.get("sampleFormat", ""))
    if kind is None:
        raise _Unfit(f"samples of the kind {attributes.get('sampleFormat', '')[:20]!r} are not supported")
    order = ">" if attributes.get("byteOrder", "little") == "big" else "<"
    sample = np.dtype(order + kind)
    count = width * height * channels
    values = _block(content, attributes, sample, count, label)
    if attributes.get("pixelStorage", "planar").lower() == "normal":
        planes = np.moveaxis(values.reshape(height, width, channels), 2, 0)
    else:
        planes = values.reshape(channels, height, width)
    native = planes[:3].astype(sample.newbyteorder("="), copy=False)
    return native[0] if channels < 3 else native


def _block(
    content: Content, attributes: Mapping[str, str], sample: np.dtype[np.generic], count: int, label: str
) -> Pixels:
    """The samples that an image points to, unpacked."""
    location = attributes.get("location", "").split(":")
    if location[0] != "attachment" or len(location) != 3:
        raise _Unfit("its data are not attached; only such are read")
    start, length = (_whole(word) for word in location[1:])
    if start + length > len(content):
        raise _Unfit(f"it is cut short: {max(0, len(content) - start)} of {length} bytes of data are there")
    needed = count * sample.itemsize
    if "compression" not in attributes:
        if length < needed:
            raise _Unfit(f"its data have {length} bytes, and {needed} are needed")
        return stored(content, sample, count, start)
    codec, *numbers = attributes["compression"].split(":")
    name, _, shuffled = codec.lower().partition("+")
    sizes = [_whole(word) for word in numbers]
    if name not in _CODECS or shuffled not in ("", "sh") or not sizes or (shuffled and len(sizes) < 2):
        raise _Unfit(f"data packed by {attributes['compression'][:40]!r} are not supported")
    if sizes[0] != needed:
        raise _Unfit(f"its data unpack to {sizes[0]} bytes, and {needed} are needed")
    check_ratio(needed, length, label)
    plain = _unpacked(name, bytes(content[start : start + length]), needed, attributes.get("subblocks", ""))
    if shuffled:
        plain = _in_order(plain, sizes[1])
    return np.frombuffer(plain, sample, count=count)


def _whole(word: str) -> int:
    if not (word.isascii() and word.isdigit() and len(word) < 19):
        raise _Unfit(f"{word[:20]!r} is not a size")
    return int(word)


def _unpacked(name: str, packed: bytes, length: int, parts: str) -> bytes:
    """Unpack a block, in as many parts as it was packed in."""
    if not parts:
        return _part(name, packed, length)
    sizes = [part.split(",") for part in parts.split(":", _MOST_BLOCKS)]
    if any(len(size) != 2 for size in sizes):
        raise _Unfit("its data are packed in parts that can't be told apart")
    at, plain, left = 0, [], length
    for size in sizes:
        shorter, longer = _whole(size[0]), _whole(size[1])
        if longer > left:
            raise _Unfit("its data unpack to more than the image has")
        part = packed[at : at + shorter]
        # what didn't become shorter was left as it was
        plain.append(part[:longer] if shorter >= longer else _part(name, part, longer))
        at, left = at + shorter, left - longer
    if left or at > len(packed):
        raise _Unfit(f"{left or at - len(packed)} bytes of its data are missing")
    return b"".join(plain)


def _part(name: str, packed: bytes, length: int) -> bytes:
    """Unpack to so many bytes, and to no more."""
    if name == "zlib":
        unpacker = zlib.decompressobj()
        try:
            plain = unpacker.decompress(packed, length + 1)
        except zlib.error as fault:
            raise _Unfit(f"its data are damaged: {fault}") from fault
    else:
        # a tenth of a second, and other files do without
        with extra("parquet", f"XISF files packed by {name}", BadFrame):
            import pyarrow as pa

        try:
            plain = pa.Codec(_CODECS[name]).decompress(packed, length, asbytes=True) if length else b""
        except (OSError, ValueError) as fault:
            raise _Unfit(f"its data are damaged: {fault}") from fault
    if len(plain) != length:
        raise _Unfit(f"its data unpack to {len(plain)} bytes and not to {length}")
    return plain


def _in_order(shuffled: bytes, item: int) -> bytes:
    """Undo the shuffling: first bytes of all items come first, then second ones [XISF 1.0, 10.6.2]."""
    if item < 2:
        return shuffled
    items = len(shuffled) // item
    whole = np.frombuffer(shuffled, np.uint8, count=items * item).reshape(item, items)
    return np.ascontiguousarray(whole.T).tobytes() + shuffled[items * item :]


def _header(image: _Element) -> tuple[dict[str, Value], dict[str, str]]:
    """FITS keywords as plain values and comments; a color filter's pattern is one of them."""
    values: dict[str, Value] = {}
    comments: dict[str, str] = {}
    for keyword in image.keywords:
        name = keyword.get("name", "").strip().upper()
        text = keyword.get("value", "").strip()
        value, _ = parsed_value(text)
        if value is None:
            value = text  # some programs leave out the quotes of a string
        if not name or not text or (isinstance(value, float) and not math.isfinite(value)):
            continue
        values[name] = value
        comments.pop(name, None)
        if comment := keyword.get("comment", "").strip():
            comments[name] = comment
    if image.pattern:
        values.setdefault("BAYERPAT", image.pattern)
    return values, comments
