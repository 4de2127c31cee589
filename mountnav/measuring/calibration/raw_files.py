"""Calibration frames on disk, read a band of rows at a time, whatever they are packed in."""

from __future__ import annotations

import bz2
import gzip
import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.io.fits.verify import VerifyWarning
from numpy.typing import NDArray

from mountnav.errors import BadFrame, BadRequest
from mountnav.files import open_plain
from mountnav.measuring.calibration.camera_setup import CameraSetup, Card, setup_from_header
from mountnav.reading.content import OnDisk
from mountnav.reading.fits_headers import check_size, walk
from mountnav.reading.fits_images import unpacked_tiles
from mountnav.reading.unpacking import check_ratio

FloatImage = NDArray[np.float32]

_ENDINGS = (
    ".fits",
    ".fit",
    ".fts",
    ".fz",
    ".fits.gz",
    ".fit.gz",
    ".fts.gz",
    ".fits.bz2",
    ".fit.bz2",
    ".fts.bz2",
)
_SATURATION_CARDS = ("SATURATE", "SATLEVEL", "SATURATI", "SATUR")
_SMALLEST_SIDE_PX = 16
"""Smaller frames can't be calibration frames, px: headers of other things."""
_UNSIGNED = {8: 0.0, 16: 32768.0, 32: 2147483648.0}
"""BZERO by which FITS stores unsigned integers, by their number of bits (FITS standard 4.0, section
5.2.5)."""


@dataclass(frozen=True, slots=True)
class RawFile:
    """One frame whose pixels stay on disk until they are asked for.

    Attributes
    ----------
    path : Path
        As the user gave it.
    full_adu : float
        Level from which a pixel counts as saturated by header or type; infinity if neither states it.
    data_path, start_byte, dtype, zero, scale
        Where the numbers lie, and how they become ADU.
    """

    path: Path
    facts: CameraSetup
    header: dict[str, Card]
    full_adu: float
    data_path: Path
    start_byte: int
    dtype: str
    zero: float
    scale: float
    blank: int | None

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name

    def rows(self, first: int, stop: int) -> FloatImage:
        """Read rows `first` to `stop` (not included), shape (stop - first, width), in ADU; NaN: missing."""
        width = self.facts.width_px
        dtype = np.dtype(self.dtype)
        count = (stop - first) * width
        try:
            numbers = np.fromfile(
                self.data_path,
                dtype=dtype,
                count=count,
                offset=self.start_byte + first * width * dtype.itemsize,
            )
        except OSError as fault:
            raise BadFrame(f"can't be read: {fault.strerror or fault}", device=self.name) from fault
        if numbers.size < count:
            raise BadFrame(
                "the FITS file is cut short", device=self.name, advice="copy it again, or leave it out"
            )
        pixels = numbers.astype(np.float32)
        if self.blank is not None:
            pixels[numbers == self.blank] = np.nan
        if self.scale != 1.0:
            pixels *= np.float32(self.scale)
        if self.zero != 0.0:
            pixels += np.float32(self.zero)
        return pixels.reshape(stop - first, width)


def listed_files(given: Sequence[Path | str]) -> list[Path]:
    """Return the FITS files that files, folders and patterns name, each once, in order of their names.

    Parameters
    ----------
    given : sequence of Path or str
        A folder means the FITS files in it (not below it); ``*``, ``?`` and ``[`` make a pattern.

    Raises
    ------
    BadRequest
        A path is not there, or names no FITS file.
    """
    found: dict[Path, Path] = {}
    for entry in map(Path, given):
        if entry.is_dir():
            some = [path for path in entry.iterdir() if path.is_file() and _is_fits_name(path)]
        elif entry.is_file():
            some = [entry]
        elif any(sign in entry.name for sign in "*?["):
            some = [path for path in entry.parent.glob(entry.name) if path.is_file() and _is_fits_name(path)]
        else:
            raise BadRequest(f"{entry} is not there", advice="give FITS files, folders or patterns")
        if not some:
            raise BadRequest(
                f"{entry} holds no FITS file", advice="*.fits, *.fit, *.fts, also .fz, .gz, .bz2"
            )
        for path in some:
            found.setdefault(path.resolve(), path)
    return sorted(found.values(), key=lambda path: (path.name, str(path)))


def open_raw(path: Path, scratch: Path) -> RawFile:
    """Look into a FITS file; compressed ones are unpacked into the scratch folder.

    Parameters
    ----------
    scratch : Path
        An existing folder for unpacked copies; its maker removes it.

    Raises
    ------
    BadFrame
        No FITS image of one plane, damaged, or cut short.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", VerifyWarning)
        warnings.filterwarnings("ignore", message=".*(truncated|non-ASCII|non-standard|Invalid|Unexpected).*")
        try:
            return _opened(path, scratch)
        except (OSError, EOFError, ValueError, TypeError, KeyError, fits.VerifyError, zlib.error) as fault:
            raise BadFrame(
                f"this file can't be read as FITS: {fault}",
                device=path.name,
                advice="calibration frames must be FITS; leave this one out if it is damaged",
            ) from fault


def _opened(path: Path, scratch: Path) -> RawFile:
    plain = _unpacked(path, scratch)
    with fits.open(plain, memmap=True, mode="readonly", do_not_scale_image_data=True) as hdus:
        hdu = _image(hdus, path.name)
        header = _cards(hdus[0].header) | _cards(hdu.header)
        zero, scale = float(hdu.header.get("BZERO", 0.0)), float(hdu.header.get("BSCALE", 1.0))
        blank = hdu.header.get("BLANK")
        height, width = hdu.shape[-2:]
        if isinstance(hdu, fits.CompImageHDU):
            # numbers with their scaling kept apart, so that the copy is no larger than the camera's own
            numbers = _unpacked_numbers(plain, hdus.index(hdu), path.name).reshape(height, width)
            data_path, start = scratch / f"{len(list(scratch.iterdir()))}.raw", 0
            numbers.tofile(data_path)
            dtype, bits = (
                numbers.dtype.str,
                numbers.dtype.itemsize * 8 * (-1 if numbers.dtype.kind == "f" else 1),
            )
            if numbers.dtype.kind == "f":
                zero, scale = 0.0, 1.0
        else:
            bits = int(hdu.header["BITPIX"])
            dtype = {8: "u1", 16: ">i2", 32: ">i4", 64: ">i8", -32: ">f4", -64: ">f8"}[bits]
            data_path, start = plain, int(hdu.fileinfo()["datLoc"])
            if start + abs(bits) // 8 * width * height > data_path.stat().st_size:
                raise BadFrame(
                    "the FITS file is cut short", device=path.name, advice="copy it again, or leave it out"
                )
    if min(width, height) < _SMALLEST_SIDE_PX:
        raise BadFrame(f"the image has only {width} × {height} pixels", device=path.name)
    return RawFile(
        path=path,
        facts=setup_from_header(header, int(width), int(height)),
        header=header,
        full_adu=_full(header, bits, zero, scale),
        data_path=data_path,
        start_byte=start,
        dtype=dtype,
        zero=zero,
        scale=scale,
        blank=blank if isinstance(blank, int) and bits > 0 else None,
    )


def _unpacked(path: Path, scratch: Path) -> Path:
    with open_plain(path) as file:
        start = file.read(3)
    if start[:2] != b"\x1f\x8b" and start != b"BZh":
        return path
    plain = scratch / f"{len(list(scratch.iterdir()))}.fits"
    with path.open("rb") as file, plain.open("wb") as out:
        packed = gzip.GzipFile(fileobj=file) if start[:2] == b"\x1f\x8b" else bz2.BZ2File(file)
        length, size = 0, path.stat().st_size
        with packed:
            while piece := packed.read(1 << 20):
                length += len(piece)
                check_ratio(length, size, path.name)
                out.write(piece)
    return plain


def _unpacked_numbers(plain: Path, number: int, label: str) -> NDArray[np.generic]:
    """Unpack the tiles behind the bounds that hold for everybody's frames."""
    with plain.open("rb", buffering=0) as file:
        content = OnDisk(file)
        found = walk(content, label)
        if number >= len(found) or not found[number].tiled:
            raise BadFrame("its header does not describe its compressed image", device=label)
        check_size(found[number], label)
        return np.ascontiguousarray(unpacked_tiles(content, found[number], label))


def _image(hdus: fits.HDUList, label: str) -> fits.PrimaryHDU:
    images = [hdu for hdu in hdus if hdu.is_image and hdu.header.get("NAXIS", 0) >= 2]
    if not images:
        raise BadFrame("the FITS file holds no image", device=label, advice="leave it out")
    best = max(images, key=lambda hdu: int(np.prod(hdu.shape[-2:])))
    if int(np.prod(best.shape[:-2], dtype=np.int64)) != 1:
        raise BadFrame(
            f"the image has {best.shape[0]} planes: its colors were already interpolated",
            device=label,
            advice="calibrate with the camera's raw frames",
        )
    return best


def _cards(header: fits.Header) -> dict[str, Card]:
    cards: dict[str, Card] = {}
    for card in header.cards:
        try:
            key, value = card.keyword, card.value
        except fits.VerifyError:
            continue
        if key and key not in ("COMMENT", "HISTORY") and isinstance(value, (str, int, float, bool)):
            cards[str(key)] = value
    return cards


def _full(header: dict[str, Card], bits: int, zero: float, scale: float) -> float:
    """Level of saturation by card, or by the type's greatest number."""
    card = next(
        (
            float(value)
            for key in _SATURATION_CARDS
            if isinstance(value := header.get(key), (int, float))
            and not isinstance(value, bool)
            and value > 0
        ),
        np.inf,
    )
    if bits not in _UNSIGNED or scale != 1.0 or bits == 32:
        return card
    top = 2.0**bits - 1.0 if zero == _UNSIGNED[bits] else 2.0 ** (bits - 1) - 1.0 + zero
    return min(card, top)


def _is_fits_name(path: Path) -> bool:
    return path.name.lower().endswith(_ENDINGS) and not path.name.startswith(".")
