"""Colors beside a packed file of version 1: ``<stem>.colors``, one byte a star in the order of the file.

::

    offset  what
    0       magic "MNAVCOLR" (8 bytes)
    8       u32 version
    12      u32 length of the header text
    16      header text: JSON, padded with spaces to a multiple of 64: catalog_sha256 (whose stars),
            color_name, count, zero_mag, step_mag, colors_sha256, sha256 (of all the other fields)
    ...     u8 (count)  color index = zero_mag + raw × step_mag; 255: unknown

The embedded catalog stays as it is for as long as its stars do: colors that came later lie beside it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.packed.format import Header
from mountnav.errors import BadCatalog, BadSettings
from mountnav.files import open_buffered
from mountnav.parsing import json_of

Array = NDArray[np.float64]
Facts = dict[str, str | int | float]

COLORS_SUFFIX = ".colors"
MAGIC = b"MNAVCOLR"
VERSION = 1
"""Of the form of the file; another is refused."""
UNKNOWN = 255
"""Byte of a star without a color; the others count steps."""
_PREAMBLE_BYTES = 16
"""Magic (8), version and length of the header (4 each): the form of the file."""
_ALIGNMENT_BYTES = 64
"""The colors begin at a multiple of it: the form of the file."""
_LONGEST_HEADER_BYTES = 4096
"""A longer header is a damaged file; chosen by hand, well above what is written."""
_ADVICE = "reinstall mountnav, build the file again (tools/README.md), or remove it and have no colors"


@dataclass(frozen=True, slots=True)
class CompanionColors:
    """Colors of the stars of one packed file, mapped.

    Attributes
    ----------
    color_name
        "B-V".
    zero_mag, step_mag
        Color index of raw value 0, and of the step to the next.
    raw
        Shape (count,).
    colors_sha256
        Of `raw`, by the header.
    """

    path: Path
    color_name: str
    zero_mag: float
    step_mag: float
    raw: NDArray[np.uint8]
    colors_sha256: str

    @classmethod
    def beside(cls, catalog: Path, header: Header) -> CompanionColors | None:
        """Open the colors that lie beside a packed file.

        Parameters
        ----------
        catalog : Path
            The packed file.
        header : Header
            Its header.

        Returns
        -------
        CompanionColors or None
            None if there are none.

        Raises
        ------
        BadCatalog
            They are malformed, or another file's.
        BadSettings
            They can't be read.
        """
        path = catalog.with_suffix(COLORS_SUFFIX)
        try:
            with open_buffered(path) as file:
                start = file.read(_PREAMBLE_BYTES + _LONGEST_HEADER_BYTES)
            told, begin = _decoded(start, path)
            size, expected = path.stat().st_size, begin + header.count
            if told["catalog_sha256"] != header.sections_sha256 or told["count"] != header.count:
                raise _malformed(
                    path,
                    _PREAMBLE_BYTES,
                    f"colors of the {header.count} stars {header.sections_sha256}",
                    f"{told['count']} of {told['catalog_sha256']}",
                )
            if size != expected:
                raise _malformed(path, min(size, expected), f"{expected} bytes in all", f"{size}")
            raw = np.memmap(path, dtype=np.uint8, mode="r", offset=begin).view(np.ndarray)
        except FileNotFoundError:
            return None
        except OSError as refused:
            raise BadSettings(
                f"can't be opened: {refused.strerror}", device=str(path), advice=_ADVICE
            ) from refused
        return cls(
            path,
            str(told["color_name"]),
            float(told["zero_mag"]),
            float(told["step_mag"]),
            raw,
            str(told["colors_sha256"]),
        )

    def colors(self, rows: NDArray[np.int64]) -> Array:
        """Color indices of stars by their row, NaN where unknown; shape (n,)."""
        raw = self.raw[rows]
        return np.where(raw == UNKNOWN, np.nan, raw * self.step_mag + self.zero_mag)

    def verify(self) -> None:
        """Compare the hash of all colors.

        Raises
        ------
        BadCatalog
            It differs.
        """
        found = hashlib.sha256(self.raw.tobytes()).hexdigest()
        if found != self.colors_sha256:
            begin = self.path.stat().st_size - self.raw.size
            raise _malformed(self.path, begin, f"colors of sha256 {self.colors_sha256}", found)


def write_companion(
    catalog: Path, header: Header, color_mag: Array, *, color_name: str, zero_mag: float, step_mag: float
) -> Path:
    """Write the colors of a packed file beside it.

    Parameters
    ----------
    catalog : Path
        The packed file.
    header : Header
        Its header.
    color_mag : ndarray, shape (count,)
        In the order of the file; NaN where unknown. What has no place in a byte becomes unknown.
    zero_mag, step_mag : float
        Color index of raw value 0, and of the step to the next.

    Returns
    -------
    Path
        What was written.
    """
    steps = np.rint((color_mag - zero_mag) / step_mag)
    with np.errstate(invalid="ignore"):
        fits = (steps >= 0) & (steps < UNKNOWN)
    raw = np.where(fits, steps, UNKNOWN).astype(np.uint8)
    told: Facts = {
        "catalog_sha256": header.sections_sha256,
        "color_name": color_name,
        "count": int(raw.size),
        "colors_sha256": hashlib.sha256(raw.tobytes()).hexdigest(),
        "step_mag": step_mag,
        "zero_mag": zero_mag,
    }
    text = _text(told | {"sha256": hashlib.sha256(_text(told)).hexdigest()})
    text += b" " * (-(_PREAMBLE_BYTES + len(text)) % _ALIGNMENT_BYTES)
    path = catalog.with_suffix(COLORS_SUFFIX)
    part = path.with_name(path.name + ".part")
    with part.open("wb") as out:
        out.write(MAGIC + VERSION.to_bytes(4, "little") + len(text).to_bytes(4, "little") + text)
        out.write(raw.tobytes())
    part.replace(path)
    return path


def _text(told: Facts) -> bytes:
    return json.dumps(told, sort_keys=True).encode("ascii")


def _decoded(start: bytes, path: Path) -> tuple[Facts, int]:
    if start[:8] != MAGIC:
        raise _malformed(path, 0, f"the magic {MAGIC!r}", repr(start[:8]))
    version, length = (int.from_bytes(start[at : at + 4], "little") for at in (8, 12))
    if version != VERSION:
        raise _malformed(path, 8, f"version {VERSION}", f"version {version}")
    text = start[_PREAMBLE_BYTES : _PREAMBLE_BYTES + length]
    if not 0 < length <= _LONGEST_HEADER_BYTES or len(text) < length:
        raise _malformed(path, 12, f"a header of 1 to {_LONGEST_HEADER_BYTES} bytes", f"{length} bytes")
    try:
        told = json_of(text.decode("ascii"))
    except (ValueError, RecursionError) as broken:
        raise _malformed(path, _PREAMBLE_BYTES, "a JSON header", type(broken).__name__) from broken
    wanted: dict[str, type | tuple[type, ...]] = {
        "catalog_sha256": str,
        "color_name": str,
        "count": int,
        "colors_sha256": str,
        "sha256": str,
        "step_mag": (int, float),
        "zero_mag": (int, float),
    }
    sound = isinstance(told, dict) and set(told) == set(wanted)
    if not sound or not all(isinstance(told[key], kind) for key, kind in wanted.items()):
        raise _malformed(path, _PREAMBLE_BYTES, f"header fields {sorted(wanted)}", repr(told)[:200])
    if not (isfinite(told["zero_mag"]) and 0 < told["step_mag"] < 1):
        raise _malformed(path, _PREAMBLE_BYTES, "a possible scale of colors", repr(told)[:200])
    expected = hashlib.sha256(_text({key: told[key] for key in told if key != "sha256"})).hexdigest()
    if told["sha256"] != expected or text.rstrip(b" ") != _text(told):
        raise _malformed(path, _PREAMBLE_BYTES, f"a header of sha256 {expected}", str(told["sha256"]))
    return told, _PREAMBLE_BYTES + length


def _malformed(path: Path, offset: int, expected: str, found: str) -> BadCatalog:
    return malformed_at(str(path), offset, expected, found, advice=_ADVICE)
