"""The packed form on disk: header, sections and steps. Writer and reader agree here and nowhere else.

::

    offset  what
    0       magic "MNAVSTAR" (8 bytes)
    8       u32 version
    12      u32 length of the header text
    16      header text: JSON, UTF-8, padded with spaces so that the sections start at a multiple of 64
    ...     sections, each at the offset the header names:
            offsets  u32 (12 nside² + 1)     first star of each NESTED pixel, and the count at the end
            classes  f32 (n, 3)              sigma [mas], its mean epoch [yr], sigma pm [mas/yr]
            fast     (u32, i32, i32) each    proper motions too fast for the record: star, RA*, Dec
            stars    15-byte records         sorted by pixel, then by magnitude, then by place

All numbers are little-endian. Positions are ICRS at the header's ``epoch_yr``.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadSettings

MAGIC = b"MNAVSTAR"
VERSION = 1
PREAMBLE_BYTES = 16
ALIGNMENT_BYTES = 64
LONGEST_HEADER_BYTES = 65536
LARGEST_NSIDE = 4096

RA_STEP_DEG = 360.0 / 2**32
"""0.30 mas."""
DEC_STEP_DEG = 90.0 / (2**31 - 1)
"""0.15 mas; both poles can be written."""
PM_STEP_MAS_YR = 0.1
"""The step in which Tycho-2, Hipparcos and UCAC4 give proper motions: nothing is lost."""
MAG_STEP = 0.001
MAG_ZERO = -5.0
"""Magnitude of raw value 0; raw values grow with the magnitude, so that they sort alike."""

PM_UNKNOWN = -32768
"""In both proper motion fields: the catalog has none."""
PM_IN_SIDECAR = -32767
"""In both proper motion fields: look into the section ``fast``."""
LARGEST_PM_RAW = 32766

STAR = np.dtype(
    [("ra", "<u4"), ("dec", "<i4"), ("pm_ra", "<i2"), ("pm_dec", "<i2"), ("mag", "<u2"), ("error", "u1")]
)
"""One star, 15 bytes, no padding; ``error`` is a row of the section ``classes``."""
FAST = np.dtype([("star", "<u4"), ("pm_ra", "<i4"), ("pm_dec", "<i4")])
OFFSET = np.dtype("<u4")
CLASS = np.dtype("<f4")
MOST_CLASSES = 256


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
        The largest proper motion in the file: by how much a query must be padded.
    sections_sha256
        Hash of everything after the header.
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

    def layout(self) -> dict[str, tuple[int, int]]:
        """Where each section lies, counted from the end of the header.

        Returns
        -------
        dict
            Section name to (offset, length), bytes; ``end`` holds the total.
        """
        lengths = {
            "offsets": OFFSET.itemsize * (12 * self.nside**2 + 1),
            "classes": CLASS.itemsize * 3 * self.class_count,
            "fast": FAST.itemsize * self.fast_count,
            "stars": STAR.itemsize * self.count,
        }
        places: dict[str, tuple[int, int]] = {}
        at = 0
        for section, length in lengths.items():
            places[section] = (at, length)
            at += length
        places["end"] = (at, 0)
        return places


def encode_header(header: Header) -> bytes:
    """Preamble and header text, padded to the alignment.

    Returns
    -------
    bytes
        Always the same bytes for the same header.
    """
    text = json.dumps(asdict(header), sort_keys=True, ensure_ascii=True).encode("ascii")
    padding = -(PREAMBLE_BYTES + len(text)) % ALIGNMENT_BYTES
    text += b" " * padding
    return MAGIC + VERSION.to_bytes(4, "little") + len(text).to_bytes(4, "little") + text


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
    BadSettings
        The bytes are no packed catalog; tells the offset and what was expected there.
    """
    if len(start) < PREAMBLE_BYTES:
        raise malformed(
            file, len(start), f"{PREAMBLE_BYTES} bytes of preamble", f"the end after {len(start)}"
        )
    if start[:8] != MAGIC:
        raise malformed(file, 0, f"the magic {MAGIC!r}", repr(start[:8]))
    version = int.from_bytes(start[8:12], "little")
    if version != VERSION:
        raise malformed(file, 8, f"version {VERSION}", f"version {version}")
    length = int.from_bytes(start[12:16], "little")
    if not 0 < length <= LONGEST_HEADER_BYTES:
        raise malformed(file, 12, f"a header of 1 to {LONGEST_HEADER_BYTES} bytes", f"{length} bytes")
    text = start[PREAMBLE_BYTES : PREAMBLE_BYTES + length]
    if len(text) < length:
        raise malformed(file, PREAMBLE_BYTES, f"{length} bytes of header", f"{len(text)} bytes")
    try:
        fields = json.loads(text.decode("utf-8"))
    except ValueError as broken:
        raise malformed(file, PREAMBLE_BYTES, "a JSON header", str(broken)) from broken
    return _header_of(fields, file), PREAMBLE_BYTES + length


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
    fast : ndarray of FAST
        The section of that name.

    Returns
    -------
    pm_ra_cosdec_mas_yr, pm_dec_mas_yr : ndarray, shape (n,)
        0 where the catalog has none.
    unknown : ndarray of bool, shape (n,)
        Where that is.
    """
    raw_ra, raw_dec = found["pm_ra"], found["pm_dec"]
    unknown = raw_ra == PM_UNKNOWN
    pm_ra = np.where(unknown, 0.0, raw_ra * PM_STEP_MAS_YR)
    pm_dec = np.where(unknown, 0.0, raw_dec * PM_STEP_MAS_YR)
    beside = np.flatnonzero(raw_ra == PM_IN_SIDECAR)
    if beside.size:
        entries = fast[np.searchsorted(fast["star"], rows[beside])]
        pm_ra[beside] = entries["pm_ra"] * PM_STEP_MAS_YR
        pm_dec[beside] = entries["pm_dec"] * PM_STEP_MAS_YR
    return pm_ra, pm_dec, unknown


def malformed(file: str, offset: int, expected: str, found: str) -> BadSettings:
    """Make the error that tells where a file stops being a packed catalog.

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
    BadSettings
        To be raised by the caller.
    """
    return BadSettings(
        f"at byte {offset}: expected {expected}, found {found}",
        device=file,
        advice="the file is damaged or no packed catalog: copy it again, or rebuild it (tools/README.md)",
    )


def _header_of(fields: object, file: str) -> Header:
    wanted: dict[str, type | tuple[type, ...]] = {
        "name": str,
        "band": str,
        "epoch_yr": (int, float),
        "nside": int,
        "count": int,
        "class_count": int,
        "fast_count": int,
        "fastest_mas_yr": (int, float),
        "sections_sha256": str,
    }
    if not isinstance(fields, dict) or set(fields) != set(wanted):
        found = sorted(fields) if isinstance(fields, dict) else type(fields).__name__
        raise malformed(file, PREAMBLE_BYTES, f"header fields {sorted(wanted)}", str(found))
    for key, kind in wanted.items():
        value = fields[key]
        if isinstance(value, bool) or not isinstance(value, kind):
            raise malformed(file, PREAMBLE_BYTES, f"{kind} for {key!r}", repr(value))
    header = Header(**fields)
    nside_is_power = header.nside > 0 and header.nside & (header.nside - 1) == 0
    if not nside_is_power or header.nside > LARGEST_NSIDE:
        raise malformed(file, PREAMBLE_BYTES, f"nside a power of 2 up to {LARGEST_NSIDE}", str(header.nside))
    if not 1 <= header.class_count <= MOST_CLASSES:
        raise malformed(file, PREAMBLE_BYTES, f"1 to {MOST_CLASSES} classes", str(header.class_count))
    if not (0 <= header.fast_count <= header.count < 2**32):
        raise malformed(file, PREAMBLE_BYTES, "0 <= fast_count <= count < 2**32", str(header.count))
    if not (0.0 <= header.fastest_mas_yr < 1e6 and 1000.0 < header.epoch_yr < 3000.0):
        raise malformed(file, PREAMBLE_BYTES, "a possible epoch and fastest proper motion", str(fields))
    return header
