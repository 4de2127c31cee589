"""The packed format on disk: sections, quantization steps, facts, and the header as bytes.

::

    offset  what
    0       magic "MNAVSTAR" (8 bytes)
    8       u32 version: 1 or 2
    12      u32 length of the header text
    16      header text: JSON, UTF-8, padded with spaces to a multiple of 64 (version 2: to 4096)
    ...     sections, each at the offset that `Header.layout` tells (version 2: at multiples of 64):
          2 coarse   u32 (49153)             if nside > 64: as `offsets`, for nside 64
            offsets  u32 (12 nside² + 1)     first star of each NESTED pixel, and the count at the end
          2 tops     u16 (12 nside²)         raw magnitude of the brightest star of each pixel; 65535: none
            classes  f32 (n, 3)              sigma [mas], its mean epoch [yr], sigma pm [mas/yr]
            fast     12 or 20 bytes each     stars too fast for the record (version 2: for the padding)
            stars    15-byte records         sorted by pixel, then by magnitude, then by place
          2 color    i16 (count)             if the catalog has colors: color index, 0.001 mag
          2 flags    u8 (count)              if the catalog has flags: bits of `StarFlag`

What has a 2 before it is in version 2 only. All numbers are little-endian. Positions are ICRS at the header's
``epoch_yr``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadCatalog
from mountnav.parsing import json_of

MAGIC = b"MNAVSTAR"
VERSION = 2
"""The version that is written."""
KNOWN_VERSIONS = (1, 2)
"""Those that are read: the embedded catalog is of version 1."""
PREAMBLE_BYTES = 16
"""Magic (8), version and length of the header (4 each): the form of the file."""
LONGEST_HEADER_BYTES = 65536
"""Version 1: a longer header is a damaged file."""
HEADER_BYTES = 4096
"""Version 2: where the sections start; the header is written last, so its length must be known at first."""
SECTION_ALIGNMENT_BYTES = 64
"""Version 2: sections begin at multiples of it, so that they can be mapped as arrays; a cache line."""
LARGEST_NSIDE = 4096
"""Finest division of a file: 201 million pixels, whose tables alone have 1.2 GB."""
COARSE_NSIDE = 64
"""Where a file's pixels are finer than this, the section ``coarse`` has the first star of each pixel of this
division: cones are looked for there first. Part of the form of the file."""

RA_STEP_DEG = 360.0 / 2**32
"""0.30 mas."""
DEC_STEP_DEG = 90.0 / (2**31 - 1)
"""0.15 mas; both poles can be written."""
PM_STEP_MAS_YR = 0.1
"""The step in which Tycho-2, Hipparcos and UCAC4 give proper motions: nothing is lost."""
MAG_STEP = 0.001
"""Millimagnitudes: finer than any catalog's errors. Part of the form of the file."""
MAG_ZERO = -5.0
"""Magnitude of raw value 0; raw values grow with the magnitude, so that they sort alike."""
COLOR_STEP = 0.001
"""As `MAG_STEP`."""
COLOR_UNKNOWN = -32768
"""Raw value of a star without a color: the least of 16 bits."""
NO_STAR = 65535
"""In the section ``tops``: the pixel is empty."""

PM_UNKNOWN = -32768
"""In both proper motion fields: the catalog has none."""
PM_IN_SIDECAR = -32767
"""In both proper motion fields: look into the section ``fast``."""
LARGEST_PM_RAW = 32766
"""Largest raw proper motion in the section ``stars`` (16 bits less the two codes above); faster stars are in
the section ``fast``."""

STAR = np.dtype(
    [("ra", "<u4"), ("dec", "<i4"), ("pm_ra", "<i2"), ("pm_dec", "<i2"), ("mag", "<u2"), ("error", "u1")]
)
"""One star, 15 bytes, no padding; ``error`` is a row of the section ``classes``."""
FAST_1 = np.dtype([("star", "<u4"), ("pm_ra", "<i4"), ("pm_dec", "<i4")])
FAST_2 = np.dtype([("star", "<u4"), ("ra", "<u4"), ("dec", "<i4"), ("pm_ra", "<i4"), ("pm_dec", "<i4")])
"""With the place, so that all fast stars can be looked at without touching the section ``stars``."""
OFFSET = np.dtype("<u4")
TOP = np.dtype("<u2")
CLASS = np.dtype("<f4")
COLOR = np.dtype("<i2")
FLAG = np.dtype("u1")
MOST_CLASSES = 256
"""As many as a byte can number."""


@dataclass(frozen=True, slots=True)
class Header:
    """What a packed file says about itself.

    Attributes
    ----------
    name, band
        Catalog and magnitude band.
    epoch_yr
        Julian year of the positions.
    nside
        HEALPix resolution, NESTED.
    count, class_count, fast_count
        Rows of the sections ``stars``, ``classes`` and ``fast``.
    fastest_mas_yr
        No proper motion in the file is larger.
    sections_sha256
        Names the file's content. Version 1: hash of everything after the header. Version 2: hash of all the
        other fields, the hashes of the sections among them.
    version
        Of the format.
    slow_mas_yr
        No proper motion is larger outside the section ``fast``: by how much a query must be padded.
        Version 1: `fastest_mas_yr`.
    color_name
        "B-V", "BP-RP"; empty if there is no section ``color``.
    made_from
        One line for people: what was packed, and where it came from. Empty in version 1.
    has_flags
        Whether there is a section ``flags``.
    brightest_mag, faintest_mag
        Of all stars; None in version 1 (see `PackedStore.magnitudes`).
    commonest_mag
        Where the number of stars per 0.1 mag is largest: the catalog thins out beyond. None in version 1.
    section_sha256
        Hash of each section; empty in version 1.
    """

    name: str
    band: str
    epoch_yr: float
    nside: int
    count: int
    class_count: int
    fast_count: int
    fastest_mas_yr: float
    sections_sha256: str
    version: int = 1
    slow_mas_yr: float = 0.0
    color_name: str = ""
    made_from: str = ""
    has_flags: bool = False
    brightest_mag: float | None = None
    faintest_mag: float | None = None
    commonest_mag: float | None = None
    section_sha256: Mapping[str, str] = field(default_factory=dict, hash=False)

    @property
    def pixels(self) -> int:
        """How many pixels the sphere has."""
        return 12 * self.nside**2

    @property
    def fast_dtype(self) -> np.dtype[Any]:
        """Shape of a row of the section ``fast``."""
        return FAST_1 if self.version == 1 else FAST_2

    def layout(self) -> dict[str, tuple[int, int]]:
        """Where each section lies, counted from the end of the header.

        Returns
        -------
        dict
            Section name to (offset, length), bytes; ``end`` holds the total. A section that the file hasn't
            got is missing.
        """
        alignment = 1 if self.version == 1 else SECTION_ALIGNMENT_BYTES
        places: dict[str, tuple[int, int]] = {}
        at = 0
        for section, length in self._lengths().items():
            at += -at % alignment
            places[section] = (at, length)
            at += length
        places["end"] = (at, 0)
        return places

    def _lengths(self) -> dict[str, int]:
        lengths = {
            "offsets": OFFSET.itemsize * (self.pixels + 1),
            "classes": CLASS.itemsize * 3 * self.class_count,
            "fast": self.fast_dtype.itemsize * self.fast_count,
            "stars": STAR.itemsize * self.count,
        }
        if self.version == 1:
            return lengths
        before: dict[str, int] = {}
        if self.nside > COARSE_NSIDE:
            before["coarse"] = OFFSET.itemsize * (12 * COARSE_NSIDE**2 + 1)
        before["offsets"] = lengths.pop("offsets")
        before["tops"] = TOP.itemsize * self.pixels
        lengths = before | lengths
        if self.color_name:
            lengths["color"] = COLOR.itemsize * self.count
        if self.has_flags:
            lengths["flags"] = FLAG.itemsize * self.count
        return lengths


def proper_motions(
    rows: NDArray[np.int64], found: NDArray[np.void], fast: NDArray[np.void]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Decode the proper motions of some stars.

    Parameters
    ----------
    rows : ndarray of int, shape (n,)
        Their numbers in the section ``stars``.
    found : ndarray of STAR, shape (n,)
        Their records.
    fast : ndarray of FAST_1 or FAST_2
        The section of that name.

    Returns
    -------
    pm_ra_cosdec_mas_yr, pm_dec_mas_yr : ndarray, shape (n,)
        0 where the catalog has none.
    unknown : ndarray of bool, shape (n,)
        Where that is.

    Raises
    ------
    BadCatalog
        A star is said to be in ``fast`` and isn't.
    """
    raw_ra, raw_dec = found["pm_ra"], found["pm_dec"]
    unknown = raw_ra == PM_UNKNOWN
    pm_ra = np.where(unknown, 0.0, raw_ra * PM_STEP_MAS_YR)
    pm_dec = np.where(unknown, 0.0, raw_dec * PM_STEP_MAS_YR)
    beside = np.flatnonzero(raw_ra == PM_IN_SIDECAR)
    if beside.size:
        stars = fast["star"]
        at = np.searchsorted(stars, rows[beside])
        if at.max() >= stars.size or not np.array_equal(stars[at], rows[beside]):
            raise BadCatalog(
                "a star's proper motion is missing from the packed catalog", advice="import the catalog again"
            )
        entries = fast[at]
        pm_ra[beside] = entries["pm_ra"] * PM_STEP_MAS_YR
        pm_dec[beside] = entries["pm_dec"] * PM_STEP_MAS_YR
    return pm_ra, pm_dec, unknown


def malformed(file: str, offset: int, expected: str, found: str) -> BadCatalog:
    """Make the error that says where a file stops being a packed catalog.

    Parameters
    ----------
    file : str
        Name of the file.
    offset : int
        Byte at which it goes wrong.
    expected, found : str
        What should be there, and what is.

    Returns
    -------
    BadCatalog
        To be raised by the caller.
    """
    return BadCatalog(
        f"at byte {offset}: expected {expected}, found {found}",
        device=file,
        advice="the file is damaged or not a packed catalog: copy it again, or import or build it again",
    )


_ALIGNMENT_BYTES_1 = 64
"""Version 1 pads its header to a multiple of it. Part of the form of the file."""

_NUMBER = (int, float)
_FIELDS_1: dict[str, type | tuple[type, ...]] = {
    "name": str,
    "band": str,
    "epoch_yr": _NUMBER,
    "nside": int,
    "count": int,
    "class_count": int,
    "fast_count": int,
    "fastest_mas_yr": _NUMBER,
    "sections_sha256": str,
}
_FIELDS_2 = _FIELDS_1 | {
    "slow_mas_yr": _NUMBER,
    "color_name": str,
    "made_from": str,
    "has_flags": bool,
    "brightest_mag": _NUMBER,
    "faintest_mag": _NUMBER,
    "commonest_mag": _NUMBER,
    "section_sha256": dict,
}


def encode_header(header: Header) -> bytes:
    """Preamble and header text, padded to where the sections start.

    Returns
    -------
    bytes
        Always the same bytes for the same header.

    Raises
    ------
    ValueError
        Its texts are too long: version 2 has 4096 bytes for all of it.
    """
    text = _text(_told(header))
    if header.version == 1:
        padding = -(PREAMBLE_BYTES + len(text)) % _ALIGNMENT_BYTES_1
    else:
        padding = HEADER_BYTES - PREAMBLE_BYTES - len(text)
        if padding < 0:
            raise ValueError(f"the header's texts are {-padding} characters too long")
    text += b" " * padding
    return MAGIC + header.version.to_bytes(4, "little") + len(text).to_bytes(4, "little") + text


def named_by_content(header: Header) -> Header:
    """Put in `sections_sha256` of version 2, from all the other fields.

    Parameters
    ----------
    header : Header
        With the hashes of its sections.
    """
    told = _told(header)
    del told["sections_sha256"]
    return replace(header, sections_sha256=hashlib.sha256(_text(told)).hexdigest())


def decode_header(start: bytes, *, file: str) -> tuple[Header, int]:
    """Read the header from the first bytes of a file.

    Parameters
    ----------
    start : bytes
        At least preamble and header text, if the file is whole.
    file : str
        Name for the error message.

    Returns
    -------
    (Header, int)
        The header, and the offset at which the sections start.

    Raises
    ------
    BadCatalog
        The bytes are no packed catalog; tells the offset and what was expected there.
    """
    if len(start) < PREAMBLE_BYTES:
        raise malformed(
            file, len(start), f"{PREAMBLE_BYTES} bytes of preamble", f"the end after {len(start)}"
        )
    if start[:8] != MAGIC:
        raise malformed(file, 0, f"the magic {MAGIC!r}", repr(start[:8]))
    version = int.from_bytes(start[8:12], "little")
    if version not in KNOWN_VERSIONS:
        raise malformed(
            file, 8, f"version {' or '.join(str(v) for v in KNOWN_VERSIONS)}", f"version {version}"
        )
    length = int.from_bytes(start[12:16], "little")
    longest = LONGEST_HEADER_BYTES if version == 1 else HEADER_BYTES - PREAMBLE_BYTES
    if not 0 < length <= longest or (version == 2 and length != longest):
        raise malformed(
            file, 12, f"a header of {1 if version == 1 else longest} to {longest} bytes", f"{length} bytes"
        )
    text = start[PREAMBLE_BYTES : PREAMBLE_BYTES + length]
    if len(text) < length:
        raise malformed(file, PREAMBLE_BYTES + len(text), f"{length} bytes of header", f"{len(text)} bytes")
    try:
        told = json_of(text.decode("utf-8"))
    except UnicodeDecodeError as broken:
        raise malformed(file, PREAMBLE_BYTES + broken.start, "a header in UTF-8", str(broken)) from broken
    except json.JSONDecodeError as broken:
        raise malformed(file, PREAMBLE_BYTES + broken.pos, "a JSON header", str(broken)) from broken
    except (ValueError, RecursionError) as broken:  # a number of 5000 digits, a thousand brackets
        raise malformed(file, PREAMBLE_BYTES, "a JSON header", type(broken).__name__) from broken
    header = _header_of(told, version, file)
    if version == 2 and encode_header(header) != start[: PREAMBLE_BYTES + length]:
        raise malformed(file, PREAMBLE_BYTES, "a header as mountnav writes it", "another spelling")
    return header, PREAMBLE_BYTES + length


def _told(header: Header) -> dict[str, object]:
    wanted = _FIELDS_1 if header.version == 1 else _FIELDS_2
    return {key: value for key, value in asdict(header).items() if key in wanted}


def _text(told: dict[str, object]) -> bytes:
    return json.dumps(told, sort_keys=True, ensure_ascii=True, allow_nan=False).encode("ascii")


def _header_of(told: object, version: int, file: str) -> Header:
    wanted = _FIELDS_1 if version == 1 else _FIELDS_2
    if not isinstance(told, dict) or set(told) != set(wanted):
        found = sorted(told) if isinstance(told, dict) else type(told).__name__
        raise malformed(file, PREAMBLE_BYTES, f"header fields {sorted(wanted)}", str(found))
    for key, kind in wanted.items():
        value = told[key]
        is_wrong_bool = isinstance(value, bool) and kind is not bool
        if is_wrong_bool or not isinstance(value, kind) or (isinstance(value, float) and not isfinite(value)):
            raise malformed(file, PREAMBLE_BYTES, f"{kind} for {key!r}", repr(value))
    if version == 1:
        header = Header(**told, version=1, slow_mas_yr=told["fastest_mas_yr"])
    else:
        header = Header(**told, version=version)
    _require_possible(header, file)
    if version == 2:
        _require_own_hashes(header, file)
    return header


def _require_possible(header: Header, file: str) -> None:
    def require(possible: bool, expected: str, found: object) -> None:
        if not possible:
            raise malformed(file, PREAMBLE_BYTES, expected, str(found))

    nside_is_power = header.nside > 0 and header.nside & (header.nside - 1) == 0
    require(
        nside_is_power and header.nside <= LARGEST_NSIDE,
        f"nside a power of 2 up to {LARGEST_NSIDE}",
        header.nside,
    )
    require(1 <= header.class_count <= MOST_CLASSES, f"1 to {MOST_CLASSES} classes", header.class_count)
    require(0 <= header.fast_count <= header.count < 2**32, "0 <= fast_count <= count < 2**32", header.count)
    require(
        0.0 <= header.fastest_mas_yr < 1e6
        and 0.0 <= header.slow_mas_yr < 1e6
        and 1000.0 < header.epoch_yr < 3000.0,
        "a possible epoch and fastest proper motion",
        (header.epoch_yr, header.fastest_mas_yr, header.slow_mas_yr),
    )


def _require_own_hashes(header: Header, file: str) -> None:
    sections = set(header.layout()) - {"end"}
    hashes = header.section_sha256
    if set(hashes) != sections or not all(isinstance(value, str) for value in hashes.values()):
        raise malformed(
            file, PREAMBLE_BYTES, f"hashes of the sections {sorted(sections)}", str(sorted(hashes))
        )
    expected = named_by_content(header).sections_sha256
    if header.sections_sha256 != expected:
        raise malformed(file, PREAMBLE_BYTES, f"a header of sha256 {expected}", header.sections_sha256)


assert set(_FIELDS_2) | {"version"} == {own.name for own in fields(Header)}
