"""The bytes of Siril's HEALPix catalogs: head, index of cumulative counts, records.

Sources: "Specification for the Siril HEALpixel Catalog Format 1.0.0" (Knagg-Baugh, Cass, Melis, Richard 2025,
Zenodo 14697486, arXiv 2501.12466) and Siril's reader (src/io/healpix/healpix.cpp, local_catalogues.h), whose
structures these are. All numbers are little-endian.

Checked on real bytes, though not on a whole file: the makers' own test of siril_cat_healpix8_astro.dat
prints 158 of its records with their pixels. 29 of them, from all over the sky, were compared: every one lies
in its pixel, which settles the scale (2^31 - 1 is 360 degrees in both coordinates) and the NESTED order; and
every coordinate is a 32-bit float in decimals. The two that Tycho-2 knows well (V 10.3 and 10.5) stand
within 0.08" of its places at J2016.0, and 0.27" and 0.40" off at J2000; their proper motions agree. The
first record is Gaia DR3 4295806720 with its proper motion, G and temperature cut off towards 0. The size of
the file, 1,521,132,640 bytes as others state it, is that of the head, 786,432 counts and 94,874,174 records
of 16 bytes. Chunks of this catalog were never published: their fields are read as the specification says,
and nothing more is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.errors import BadCatalog

HEAD = np.dtype(
    [
        ("title", "S48"),
        ("release", "u1"),
        ("level", "u1"),
        ("kind", "u1"),
        ("chunked", "u1"),
        ("chunk_level", "u1"),
        ("chunk_pixel", "<u4"),
        ("first_pixel", "<u4"),
        ("last_pixel", "<u4"),
        ("spare", "S63"),
    ]
)
"""128 bytes; in the one file that is distributed all after ``kind`` is 0."""
COUNT = np.dtype("<u4")
STAR = np.dtype(
    [
        ("ra", "<i4"),
        ("dec", "<i4"),
        ("pm_ra", "<i2"),
        ("pm_dec", "<i2"),
        ("teff", "<u2"),
        ("mag", "<i2"),
    ]
)
"""Coordinates in `STEP_DEG`, proper motions in mas/yr (that in RA with cos Dec), G in mmag; temperature in K.
Whole numbers, each cut off towards 0."""
STEP_DEG = 360.0 / (2**31 - 1)
"""Degrees in a step of the coordinates: a turn in 31 bits, 0.6 mas."""
RELEASE_EPOCHS_YR = {0: 2015.0, 1: 2015.5, 2: 2016.0, 3: 2016.0}
"""Julian years of the positions, by the number of Gaia's release in the head."""
RELEASES = {0: "DR1", 1: "DR2", 2: "EDR3", 3: "DR3"}
"""Names of these releases."""
ASTROMETRIC = 1
"""Kind of catalog in the head that holds positions, motions and magnitudes: the one that is read."""
_SPECTRA = {2: "sampled", 3: "continuous"}
"""Kinds that hold spectra, which are refused with these words."""
_DEEPEST_LEVEL = 13
"""As in Siril: at deeper ones the index alone has gigabytes."""


@dataclass(frozen=True, slots=True)
class Head:
    """What a head states.

    Attributes
    ----------
    release : int
        Of Gaia: a key of `RELEASES`.
    level : int
        HEALPix level of the index, NESTED.
    chunk : tuple of int or None
        Level and pixel that the file covers; None: the whole sky.
    first_pixel, pixels : int
        Which pixels of the index level it holds.
    """

    title: str
    release: int
    level: int
    chunk: tuple[int, int] | None
    first_pixel: int
    pixels: int

    @property
    def stars_at(self) -> int:
        """Where in the file the records begin."""
        return HEAD.itemsize + self.pixels * COUNT.itemsize


def parse_head(content: bytes, file: str) -> Head:
    """Understand a head.

    Parameters
    ----------
    content : bytes
        The file's first 128 bytes, or fewer if it has no more.
    file : str
        Its name, for errors.

    Raises
    ------
    BadCatalog
        No such head, or one of a catalog of spectra.
    """
    if content[:3] == b"BZh":
        raise BadCatalog(
            "it is still packed (bzip2)", device=file, advice=f"unpack it first: bunzip2 --keep {file}"
        )
    if len(content) < HEAD.itemsize:
        raise malformed_at(file, len(content), f"a head of {HEAD.itemsize} bytes", "the end of the file")
    raw = np.frombuffer(content[: HEAD.itemsize], dtype=HEAD)[0]

    def require(field: str, sound: bool, expected: str) -> None:
        if not sound:
            raise malformed_at(file, _offset(field), expected, str(int(raw[field])))

    title = content[:48].rstrip(b"\0")
    for offset, byte in enumerate(title):
        if not 0x20 <= byte < 0x7F:
            raise malformed_at(file, offset, "a readable title", f"byte 0x{byte:02x}")
    require("release", int(raw["release"]) in RELEASES, "a release of Gaia (0 to 3: DR1 to DR3)")
    level, kind, chunk_level = int(raw["level"]), int(raw["kind"]), int(raw["chunk_level"])
    require("level", 1 <= level <= _DEEPEST_LEVEL, f"a HEALPix level (1 to {_DEEPEST_LEVEL})")
    if kind in _SPECTRA:
        raise BadCatalog(
            f"a catalog of {_SPECTRA[kind]} spectra for color calibration, not of places",
            device=file,
            advice="import Siril's astrometric catalog: siril_cat_healpix8_astro.dat",
        )
    require("kind", kind == ASTROMETRIC, "the kind of catalog (1: astrometric)")
    require("chunked", int(raw["chunked"]) in (0, 1), "0 (whole sky) or 1 (a chunk)")
    pixels = 12 * 4**level
    if not raw["chunked"]:
        return Head(title.decode("ascii"), int(raw["release"]), level, None, 0, pixels)
    require("chunk_level", chunk_level <= level, f"a level of at most {level}")
    chunks = 12 * 4**chunk_level
    pixels //= chunks
    chunk = int(raw["chunk_pixel"])
    require("chunk_pixel", chunk < chunks, f"a pixel below {chunks}")
    first = chunk * pixels
    require("first_pixel", int(raw["first_pixel"]) == first, f"the chunk's first pixel, {first}")
    last = first + pixels - 1
    require("last_pixel", int(raw["last_pixel"]) == last, f"the chunk's last pixel, {last}")
    return Head(title.decode("ascii"), int(raw["release"]), level, (chunk_level, chunk), first, pixels)


def checked_counts(content: NDArray[np.uint8], head: Head, file: str) -> NDArray[np.int64]:
    """The index: how many stars end with each pixel.

    Parameters
    ----------
    content : ndarray of uint8
        The whole file, mapped.

    Returns
    -------
    ndarray of int64, shape (pixels + 1,)
        0, and the cumulative counts.

    Raises
    ------
    BadCatalog
        It is cut short, decreases, or says another size of the file.
    """
    if content.size < head.stars_at:
        raise malformed_at(
            file, content.size, f"an index of {head.pixels} counts", "the end of the file", advice=_COPY_WHOLE
        )
    counts = content[HEAD.itemsize : head.stars_at].view(COUNT).astype(np.int64)
    back = np.flatnonzero(np.diff(counts) < 0)
    if back.size:
        pixel = int(back[0]) + 1
        raise malformed_at(
            file,
            HEAD.itemsize + pixel * COUNT.itemsize,
            f"a count of at least {counts[pixel - 1]}, that of the pixel before",
            str(counts[pixel]),
        )
    total = head.stars_at + int(counts[-1]) * STAR.itemsize
    if content.size != total:
        raise malformed_at(
            file,
            min(content.size, total),
            f"{counts[-1]} stars to byte {total}, as the index says",
            f"{content.size} bytes in all",
            advice=_COPY_WHOLE,
        )
    return np.concatenate(([0], counts))


def _offset(field: str) -> int:
    assert HEAD.fields is not None
    return int(HEAD.fields[field][1])


_COPY_WHOLE = "the file was cut or is damaged: download it again and compare its checksum with Zenodo's"
