"""How the camera was set, as a header states it, and whether two frames were taken alike."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from mountnav.errors import BadRequest
from mountnav.reading.header_times import exposure_s_from_header

Card = str | int | float | bool
Header = Mapping[str, Card]

_PATTERN_CARDS = ("BAYERPAT", "BAYRPAT", "CFA_PAT", "CFATYPE", "COLORTYP")
_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
_TEMPERATURE_CARDS = ("CCD-TEMP", "CCDTEMP", "CCD_TEMP", "DET-TEMP", "SET-TEMP")
_READOUT_CARDS = ("READOUTM", "READMODE", "RDMODE")
_OFFSET_CARDS = ("OFFSET", "BLKLEVEL")
_KIND_CARDS = ("IMAGETYP", "IMAGETYPE", "OBSTYPE", "FRAME", "PICTTYPE")
_MASTER_CARD = "MNMASTER"
_NO_FILTER = ("", "none", "no filter", "n/a", "unknown")
#: Cards of other programs that a calibrated frame carries, and which step each stands for.
_DONE_CARDS = {
    "B": ("BIASCORR", "BIASCOR", "ZEROCOR"),
    "D": ("DARKCORR", "DARKCOR"),
    "F": ("FLATCORR", "FLATCOR"),
}
_NOT_DONE = ("", "f", "false", "no", "0", "omit", "skipped", "none")


class Kind(StrEnum):
    """What a frame was taken as."""

    BIAS = "bias"
    DARK = "dark"
    FLAT = "flat"
    LIGHT = "light"
    BAD_PIXELS = "bad pixels"


@dataclass(frozen=True, slots=True)
class CameraSetup:
    """How a frame was taken. None means that the header doesn't say.

    Attributes
    ----------
    binning : tuple of int or None
        Along x and y.
    gain, offset, gain_e_adu : float or None
        The camera's settings of gain and offset, in its own units, and electrons per ADU (EGAIN).
    readout, pattern, instrument : str or None
        Readout mode, Bayer pattern, camera.
    left_px, top_px : int or None
        First column and row of the window that was read out.
    """

    width_px: int
    height_px: int
    binning: tuple[int, int] | None = None
    gain: float | None = None
    offset: float | None = None
    gain_e_adu: float | None = None
    readout: str | None = None
    pattern: str | None = None
    instrument: str | None = None
    left_px: int | None = None
    top_px: int | None = None
    filter: str | None = None
    exposure_s: float | None = None
    temperature_c: float | None = None
    kind: Kind | None = None


def setup_from_header(header: Header, width_px: int, height_px: int) -> CameraSetup:
    """Read what a header says of the camera.

    Parameters
    ----------
    width_px, height_px : int
        Of the pixels themselves.
    """
    return CameraSetup(
        width_px=width_px,
        height_px=height_px,
        binning=_binning(header),
        gain=_number(header, ("GAIN",)),
        offset=_number(header, _OFFSET_CARDS),
        gain_e_adu=_number(header, ("EGAIN",)),
        readout=_text(header, _READOUT_CARDS),
        pattern=pattern_from_header(header),
        instrument=_text(header, ("INSTRUME",)),
        left_px=_whole(header, "XORGSUBF"),
        top_px=_whole(header, "YORGSUBF"),
        filter=_filter(header),
        exposure_s=exposure_s_from_header(dict(header)),
        temperature_c=_number(header, _TEMPERATURE_CARDS),
        kind=kind_from_header(header),
    )


def kind_from_header(header: Header) -> Kind | None:
    """Return what the header calls the frame; None if it doesn't, or in words not known."""
    words = next((str(header[key]).lower() for key in _KIND_CARDS if isinstance(header.get(key), str)), "")
    for kind, signs in (
        (Kind.BIAS, ("bias", "zero", "offset")),
        (Kind.FLAT, ("flat",)),
        (Kind.DARK, ("dark",)),
        (Kind.LIGHT, ("light", "object", "science")),
    ):
        if any(sign in words for sign in signs):
            return kind
    return None


def is_master(header: Header) -> bool:
    """Whether a frame is itself a stack: ours, or called a master by the program that made it."""
    return _MASTER_CARD in header or any("master" in str(header.get(key, "")).lower() for key in _KIND_CARDS)


def pattern_from_header(header: Header) -> str | None:
    """Return the Bayer pattern with its offsets, or None."""
    for key in _PATTERN_CARDS:
        name = str(header.get(key, "")).strip().upper()
        if name in _PATTERNS:
            shift = [_whole(header, card) or 0 for card in ("XBAYROFF", "YBAYROFF")]
            return name if not any(shift) else f"{name}+{shift[0] % 2}+{shift[1] % 2}"
    return None


def steps_done(header: Header) -> str:
    """Which steps a header says were done already, as letters: B(ias), D(ark), F(lat).

    ``CALSTAT`` (MaxIm and its followers, and ourselves), the cards of IRAF and its followers, and the word
    "calibrated" in the frame's type. A dark that was subtracted took the bias with it.
    """
    status = str(header.get("CALSTAT", "")).upper()
    done = {letter for letter in "BDF" if letter in status}
    for letter, cards in _DONE_CARDS.items():
        if any(key in header and str(header[key]).strip().lower() not in _NOT_DONE for key in cards):
            done.add(letter)
    if any("calibrated" in str(header.get(key, "")).lower() for key in _KIND_CARDS):
        done |= set("BDF")
    if "D" in done:
        done.add("B")
    return "".join(sorted(done))


def zero_left_adu(header: Header) -> float | None:
    """Return the level of a pixel without light in a frame that was calibrated elsewhere; None for a raw one.

    Programs that keep the pixels positive leave an offset in them and state it in ``PEDESTAL`` (some as what
    was added, some as what is to be added back).
    """
    if "B" not in steps_done(header):
        return None
    return abs(_number(header, ("PEDESTAL",)) or 0.0)


def same_filter(one: str | None, other: str | None) -> bool:
    """Whether two filter names mean the same; a name that isn't known is the same as no other name."""
    return (one or "").casefold() == (other or "").casefold()


def difference(one: CameraSetup, other: CameraSetup) -> str | None:
    """Tell how the camera was set otherwise in `one` than in `other`; None if alike as far as known.

    Filter, exposure and temperature are not looked at.
    """
    if (one.width_px, one.height_px) != (other.width_px, other.height_px):
        return f"it has {one.width_px} × {one.height_px} pixels, not {other.width_px} × {other.height_px}"
    if one.binning and other.binning and one.binning != other.binning:
        return "its binning is {}×{}, not {}×{}".format(*one.binning, *other.binning)
    for name, mine, theirs in (
        ("gain", one.gain, other.gain),
        ("offset", one.offset, other.offset),
        ("gain (EGAIN)", one.gain_e_adu, other.gain_e_adu),
    ):
        if (
            mine is not None
            and theirs is not None
            and abs(mine - theirs) > 0.01 * max(abs(mine), abs(theirs))
        ):
            return f"its {name} is {mine:g}, not {theirs:g}"
    for name, text, their_text in (
        ("readout mode", one.readout, other.readout),
        ("color pattern", one.pattern, other.pattern),
        ("camera", one.instrument, other.instrument),
    ):
        if text is not None and their_text is not None and text.casefold() != their_text.casefold():
            return f"its {name} is “{text}”, not “{their_text}”"
    for name, start, their_start in (
        ("first column", one.left_px, other.left_px),
        ("first row", one.top_px, other.top_px),
    ):
        if start is not None and their_start is not None and start != their_start:
            return f"its {name} is {start} of the chip, not {their_start}"
    return None


ASSUMABLE: Mapping[str, str] = {
    "gain": "gain",
    "offset": "offset",
    "egain": "gain_e_adu",
    "readout": "readout",
    "camera": "instrument",
    "binning": "binning",
}
"""What may be assumed of frames whose headers don't say it: its name for users, and its field."""
_FIRST_PIXEL = {"first column": "left_px", "first row": "top_px", "color pattern": "pattern"}


def assumptions(said: Sequence[str]) -> dict[str, float | str | tuple[int, int]]:
    """Read `gain=200`, `readout=Slow`, `binning=2` as fields of `CameraSetup`.

    Raises
    ------
    BadRequest
        Another name, or a value that makes no sense for it.
    """
    fields: dict[str, float | str | tuple[int, int]] = {}
    for one in said:
        name, _, text = one.partition("=")
        text = text.strip()
        value: float | str | tuple[int, int] = text
        try:
            if name == "binning":
                value = _binning({"CCDSUM": text.replace("x", " ")}) or (int(text), int(text))
            elif name in ("gain", "offset", "egain"):
                value = float(text)
        except ValueError:
            text = ""
        if name not in ASSUMABLE or not text or (isinstance(value, float) and not math.isfinite(value)):
            raise BadRequest(
                f"--assume {one!r} can't be used",
                advice=f"NAME=VALUE, for example gain=200; the names are {', '.join(ASSUMABLE)}",
            )
        fields[ASSUMABLE[name]] = value
    return fields


def assuming(facts: CameraSetup, assumed: Mapping[str, float | str | tuple[int, int]]) -> CameraSetup:
    """The facts, and where the header is silent what is assumed."""
    silent: dict[str, Any] = {
        field: value for field, value in assumed.items() if getattr(facts, field) is None
    }
    return replace(facts, **silent)


def unknown_beside_known(one: CameraSetup, other: CameraSetup) -> tuple[str, str, bool] | None:
    """What one of two headers says and the other doesn't.

    Returns
    -------
    name : str
        What it is, as users call it.
    value : str
        The one that is known.
    of_other : bool
        Whether `other` says it, and `one` doesn't.
    """
    for name, field in (*ASSUMABLE.items(), *_FIRST_PIXEL.items()):
        mine, theirs = getattr(one, field), getattr(other, field)
        if (mine is None) != (theirs is None):
            known = theirs if mine is None else mine
            return name, "×".join(map(str, known)) if isinstance(known, tuple) else str(known), mine is None
    return None


def _binning(header: Header) -> tuple[int, int] | None:
    x = _number(header, ("XBINNING", "BINNING", "BINX"))
    y = _number(header, ("YBINNING", "BINY"))
    if x is not None and 1 <= x <= 64:
        return int(x), int(y if y is not None and 1 <= y <= 64 else x)
    match = re.fullmatch(r"\s*(\d+)[ x,]+(\d+)\s*", str(header.get("CCDSUM", header.get("BINNING", ""))))
    return (int(match[1]), int(match[2])) if match else None


def _filter(header: Header) -> str | None:
    value = header.get("FILTER", header.get("FILTNAM"))
    name = str(value).strip() if isinstance(value, (str, int)) and not isinstance(value, bool) else ""
    return None if name.lower() in _NO_FILTER else name


def _number(header: Header, keys: tuple[str, ...]) -> float | None:
    for key in keys:
        value = header.get(key)
        if isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e9:
            return float(value)
    return None


def _whole(header: Header, key: str) -> int | None:
    value = _number(header, (key,))
    return None if value is None else round(value)


def _text(header: Header, keys: tuple[str, ...]) -> str | None:
    for key in keys:
        value = header.get(key)
        if isinstance(value, str) and value.strip():
            return value.strip()
    return None
