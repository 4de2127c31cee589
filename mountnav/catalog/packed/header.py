"""The header of a packed file as bytes: written in one way only, and read with suspicion."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, fields, replace
from math import isfinite

from mountnav.catalog.packed.format import (
    HEADER_BYTES,
    KNOWN_VERSIONS,
    LARGEST_NSIDE,
    LONGEST_HEADER_BYTES,
    MAGIC,
    MOST_CLASSES,
    PREAMBLE_BYTES,
    Header,
    malformed,
)
from mountnav.parsing import json_of

_ALIGNMENT_BYTES_1 = 64

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
