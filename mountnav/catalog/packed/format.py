"""The packed form on disk: sections, steps and facts. Writer and reader agree here and nowhere else.

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

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadCatalog

MAGIC = b"MNAVSTAR"
VERSION = 2
KNOWN_VERSIONS = (1, 2)
PREAMBLE_BYTES = 16
LONGEST_HEADER_BYTES = 65536
HEADER_BYTES = 4096
"""Version 2: where the sections start; the header is written last, so its length must be known at first."""
SECTION_ALIGNMENT_BYTES = 64
LARGEST_NSIDE = 4096
COARSE_NSIDE = 64

RA_STEP_DEG = 360.0 / 2**32
"""0.30 mas."""
DEC_STEP_DEG = 90.0 / (2**31 - 1)
"""0.15 mas; both poles can be written."""
PM_STEP_MAS_YR = 0.1
"""The step in which Tycho-2, Hipparcos and UCAC4 give proper motions: nothing is lost."""
MAG_STEP = 0.001
MAG_ZERO = -5.0
"""Magnitude of raw value 0; raw values grow with the magnitude, so that they sort alike."""
COLOR_STEP = 0.001
COLOR_UNKNOWN = -32768
NO_STAR = 65535
"""In the section ``tops``: the pixel is empty."""

PM_UNKNOWN = -32768
"""In both proper motion fields: the catalog has none."""
PM_IN_SIDECAR = -32767
"""In both proper motion fields: look into the section ``fast``."""
LARGEST_PM_RAW = 32766

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
    BadCatalog
        To be raised by the caller.
    """
    return BadCatalog(
        f"at byte {offset}: expected {expected}, found {found}",
        device=file,
        advice="the file is damaged or no packed catalog: copy it again, or import or build it anew",
    )
