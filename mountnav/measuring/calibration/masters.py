"""Masters as FITS files: float32 pixels, and cards that say how they were made."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.measuring.calibration.camera_setup import CameraSetup, Card, Kind, difference, setup_from_header
from mountnav.measuring.calibration.raw_files import FloatImage
from mountnav.version import version

_BLOCK_BYTES = 2880
"""Length of a FITS block, bytes (FITS standard 4.0, section 3.1)."""
_COPY_BYTES = 1 << 22
"""Bytes that are copied at once: bounds the memory."""
_PIXELS_DTYPE = {Kind.BAD_PIXELS: ("u1", 8)}
"""Type of the pixels on disk and BITPIX, of maps of flags ..."""
_FLOAT = (">f4", -32)
"""... and of all other masters: half of what doubles need, and finer than any stack's noise."""
_MOST_LISTED = 200
"""Files of a stack that are listed in the header: it stays readable."""


@dataclass(frozen=True, slots=True)
class Master:
    """A stack of calibration frames; the pixels stay on disk until asked for.

    Attributes
    ----------
    facts : CameraSetup
        Settings the frames were taken with; exposure and temperature are their means.
    frames : int
        How many were stacked.
    zero_free : bool
        The bias was taken out. A dark with the bias in it serves only lights of its own exposure.
    unit : str
        "ADU", "ADU/s", "response" or "flags".
    level_adu : float or None
        Median of the bias; of the dark as it is stored; of the flats' light.
    noise_adu : float or None
        Noise of a pixel in a single frame of the stack.
    read_noise_adu, gain_e_adu : float or None
        Measured from pairs of frames.
    rejected_share : float
        Share of the values that were clipped.
    from_lights : bool
        A flat made of light frames by the inverse median filter.
    colored : bool
        A flat whose four color phases were normalized each on its own.
    start_byte : int
        Where the pixels begin.
    stamp : tuple of int
        Number, length and time of the file: shows if it was replaced since.
    """

    path: Path
    kind: Kind
    facts: CameraSetup
    frames: int
    zero_free: bool
    unit: str
    level_adu: float | None
    noise_adu: float | None
    read_noise_adu: float | None
    gain_e_adu: float | None
    rejected_share: float
    from_lights: bool
    colored: bool
    start_byte: int
    stamp: tuple[int, int, int]

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name

    def pixels(self) -> FloatImage:
        """Map the pixels, shape (height, width); read-only, big-endian float32."""
        if self.kind is Kind.BAD_PIXELS:
            raise ValueError("a bad-pixel map has flags, no pixels")
        path, start, shape = self._place()
        return np.memmap(path, dtype=_FLOAT[0], mode="r", offset=start, shape=shape)

    def flags(self) -> NDArray[np.uint8]:
        """Map a bad-pixel map, shape (height, width), read-only; see `bad_pixels.Bad`."""
        if self.kind is not Kind.BAD_PIXELS:
            raise ValueError(f"a master {self.kind} has pixels, no flags")
        path, start, shape = self._place()
        return np.memmap(path, dtype=np.uint8, mode="r", offset=start, shape=shape)

    def _place(self) -> tuple[Path, int, tuple[int, int]]:
        """Tell where the pixels lie; a file that was replaced since (a new build) is looked at again."""
        now: Master | None = self
        if not self.path.is_file() or _stamp(self.path) != self.stamp:
            now = read_master(self.path)
        if now is None or now.kind is not self.kind or difference(now.facts, self.facts) is not None:
            raise BadFrame(
                "the master is gone or was replaced by another", device=self.name, advice="build it again"
            )
        return now.path, now.start_byte, (self.facts.height_px, self.facts.width_px)


def _stamp(path: Path) -> tuple[int, int, int]:
    about = path.stat()
    return about.st_ino, about.st_size, about.st_mtime_ns


@dataclass(frozen=True, slots=True)
class MasterFacts:
    """What a new master's header shall say; see `Master` for the meaning."""

    kind: Kind
    facts: CameraSetup
    files: tuple[str, ...]
    zero_free: bool
    unit: str
    method: str = ""
    level_adu: float | None = None
    noise_adu: float | None = None
    read_noise_adu: float | None = None
    gain_e_adu: float | None = None
    rejected_share: float = 0.0
    from_lights: bool = False
    colored: bool = False
    corrected_by: tuple[str, ...] = ()
    coldest_c: float | None = None
    warmest_c: float | None = None


def write_master(path: Path, numbers: Path, about: MasterFacts) -> None:
    """Write a master: header first, then the numbers from a scratch file, then the padding.

    Parameters
    ----------
    path : Path
        Written under a temporary name and renamed, so that a half-written master is never seen.
    numbers : Path
        Big-endian float32 (bytes for a bad-pixel map), row by row.
    """
    part = path.with_name(f".{path.name}.part")
    length = 0
    with part.open("wb") as out:
        out.write(_header(about).tostring(sep="", endcard=True, padding=True).encode("ascii"))
        with numbers.open("rb") as source:
            while block := source.read(_COPY_BYTES):
                out.write(block)
                length += len(block)
        out.write(b"\0" * (-length % _BLOCK_BYTES))
        out.flush()
        os.fsync(out.fileno())
    part.replace(path)


def read_master(path: Path) -> Master | None:
    """Return a master by its header; None if the file is none of ours.

    Raises
    ------
    BadFrame
        One of ours, and damaged.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with fits.open(path, memmap=True, mode="readonly") as hdus:
                header, info = hdus[0].header, hdus[0].fileinfo()
                cards: dict[str, Card] = {
                    str(key): value
                    for key, value in header.items()
                    if key and isinstance(value, (str, int, float))
                }
                start = int(info["datLoc"])
        except FileNotFoundError:
            return None  # replaced just now
        except (OSError, ValueError, KeyError, IndexError, fits.VerifyError) as fault:
            if path.name.partition("_")[0] not in {str(kind.value) for kind in Kind}:
                return None
            raise BadFrame(
                f"the file has a master's name, but can't be read: {fault}",
                device=str(path),
                advice="build it again, or take it out of the folder",
            ) from fault
    if "MNMASTER" not in cards:
        return None
    try:
        kind = Kind(str(cards["MNMASTER"]))
        width, height = int(cards["NAXIS1"]), int(cards["NAXIS2"])
        bits = _PIXELS_DTYPE.get(kind, _FLOAT)[1]
        if int(cards["BITPIX"]) != bits or path.stat().st_size < start + width * height * abs(bits) // 8:
            raise ValueError("it is cut short")
        return Master(
            path=path,
            kind=kind,
            facts=setup_from_header(cards, width, height),
            frames=int(cards["NCOMBINE"]),
            zero_free=bool(cards["MNZEROFR"]),
            unit=str(cards["BUNIT"]),
            level_adu=_number(cards, "MNLEVEL"),
            noise_adu=_number(cards, "MNNOISE"),
            read_noise_adu=_number(cards, "MNRDNOIS"),
            gain_e_adu=_number(cards, "MNGAIN"),
            rejected_share=_number(cards, "MNREJECT") or 0.0,
            from_lights=bool(cards.get("MNLIGHTS", False)),
            colored=bool(cards.get("MNCOLOR", False)),
            start_byte=start,
            stamp=_stamp(path),
        )
    except (KeyError, ValueError, TypeError) as fault:
        raise BadFrame(
            f"this master is damaged: {fault}", device=path.name, advice="build it again, or remove it"
        ) from fault


def master_name(about: MasterFacts) -> str:
    """Return the file name a master gets: the same for masters that replace each other."""
    facts = about.facts
    parts = [about.kind.replace(" ", "_"), f"{facts.width_px}x{facts.height_px}"]
    if facts.binning and facts.binning != (1, 1):
        parts.append("bin{}x{}".format(*facts.binning))
    if facts.gain is not None:
        parts.append(f"gain{facts.gain:g}")
    if facts.readout:
        parts.append(facts.readout)
    if about.kind is Kind.DARK:
        parts.append(f"{facts.exposure_s:g}s")
        if facts.temperature_c is not None:
            parts.append(f"{facts.temperature_c:.0f}C")
    if about.kind is Kind.FLAT:
        parts.append(facts.filter or "nofilter")
        if about.from_lights:
            parts.append("from_lights")
    name = "_".join(parts)
    return "".join(sign if sign.isalnum() or sign in "._-+" else "-" for sign in name) + ".fits"


def _number(cards: dict[str, Card], key: str) -> float | None:
    value = cards.get(key)
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def _header(about: MasterFacts) -> fits.Header:
    facts = about.facts
    header = fits.Header()
    cards: list[tuple[str, Card | None, str]] = [
        ("SIMPLE", True, ""),
        ("BITPIX", _PIXELS_DTYPE.get(about.kind, _FLOAT)[1], ""),
        ("NAXIS", 2, ""),
        ("NAXIS1", facts.width_px, ""),
        ("NAXIS2", facts.height_px, ""),
        ("MNMASTER", about.kind.value, "mountnav master of this kind"),
        ("IMAGETYP", f"Master {about.kind.value.title()}", ""),
        ("BUNIT", about.unit, ""),
        ("NCOMBINE", len(about.files), "frames stacked"),
        ("MNZEROFR", about.zero_free, "bias is taken out"),
        ("MNMETHOD", about.method or None, "how they were stacked"),
        ("MNREJECT", round(about.rejected_share, 7), "share of values clipped"),
        ("MNLEVEL", _rounded(about.level_adu), "median level"),
        ("MNNOISE", _rounded(about.noise_adu), "[adu] noise of a pixel in one frame"),
        ("MNRDNOIS", _rounded(about.read_noise_adu), "[adu] measured read noise"),
        ("MNGAIN", _rounded(about.gain_e_adu), "[e/adu] measured gain"),
        ("MNLIGHTS", True if about.from_lights else None, "made of light frames"),
        ("MNCOLOR", True if about.colored else None, "each color phase has median 1"),
        ("EXPTIME", facts.exposure_s, "[s]"),
        ("CCD-TEMP", _rounded(facts.temperature_c), "[C] mean"),
        ("MNCOLD", about.coldest_c, "[C] coldest frame"),
        ("MNWARM", about.warmest_c, "[C] warmest frame"),
        ("FILTER", facts.filter, ""),
        ("XBINNING", facts.binning[0] if facts.binning else None, ""),
        ("YBINNING", facts.binning[1] if facts.binning else None, ""),
        ("GAIN", facts.gain, "camera's setting"),
        ("OFFSET", facts.offset, "camera's setting"),
        ("EGAIN", facts.gain_e_adu, "[e/adu] as the frames' headers say"),
        ("READOUTM", facts.readout, ""),
        ("INSTRUME", facts.instrument, ""),
        ("XORGSUBF", facts.left_px, ""),
        ("YORGSUBF", facts.top_px, ""),
        ("CREATOR", f"mountnav {version()}", ""),
    ]
    if facts.pattern:
        name, *shifts = facts.pattern.split("+")
        cards.append(("BAYERPAT", name, ""))
        cards += [
            (card, int(shift), "") for card, shift in zip(("XBAYROFF", "YBAYROFF"), shifts, strict=False)
        ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a camera's name may be longer than a card
        for key, value, comment in cards:
            if value is not None:
                header[key] = (_ascii(value) if isinstance(value, str) else value, comment)
        for text in about.corrected_by:
            header.add_history(_ascii(f"corrected by {text}"))
        for file in about.files[:_MOST_LISTED]:
            header.add_history(_ascii(file))
        if len(about.files) > _MOST_LISTED:
            header.add_history(f"and {len(about.files) - _MOST_LISTED} more")
    return header


def _rounded(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(f"{value:.7g}")


def _ascii(text: str) -> str:
    return text.encode("ascii", "replace").decode()
