"""What clients of the nova API ask and are answered, as data: JSON of a request, an upload's wishes, replies.

Nothing here does I/O. What strangers send is read in bounds: the length of the JSON, the number of its keys,
each number by itself. What makes no sense is a `NovaError`, whose words go to the client.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from mountnav.errors import BadRequest
from mountnav.frames import Hint
from mountnav.reading.star_lists import MOST_SIDE_PX, ListFormat
from mountnav.sky.coordinates import Icrs
from mountnav.sky.wcs_numbers import Value, wcs_numbers
from mountnav.units import ARCSEC_PER_RAD

__all__ = [
    "Asked",
    "NovaError",
    "calibration",
    "error_reply",
    "hint_of",
    "picture_kind",
    "read_asked",
    "read_request",
    "stars_text",
]

MOST_JSON_BYTES = 2_000_000
"""Longest JSON of a request, bytes: lists of 50,000 stars. Reading it holds the interpreter for some 40 ms;
doubled, twice as long."""
_MOST_KEYS = 200
"""Keys of one request; the longest that is known has 25. Doubled, nothing changes but for nonsense."""
_LONGEST_WORDS = 300
"""Characters of an error's text; chosen by hand, so that strangers get no long echo."""
_LARGEST_SCALE_ARCSEC = 36_000.0
"""Coarsest scale that is believed of a pixel, arcsec: 10°, more than any all-sky camera has. Doubled, nothing
changes but for nonsense."""
_UNKNOWN_RADIUS_DEG = 5.0
"""How far off a center may be that comes without a radius, degrees; chosen by hand. nova itself takes 180°
then, which is no hint at all; what isn't found there is searched for over the whole sky."""
_FULL_FRAME_MM = 36.0
"""Width of the film that `focalmm` is told for [astrometry.net, solve-field's help]: 35 mm film."""
_ARCSEC_DEG, _ARCSEC_ARCMIN = 3600.0, 60.0
"""Arcseconds of a degree and of an arcminute."""
_LINEAR_ORDER = 1
"""A `tweak_order` up to this asks for no distortion terms."""


class NovaError(Exception):
    """A request that is refused in words.

    Parameters
    ----------
    status : int
        Of HTTP. This protocol tells errors with 200; others are for what programs know by number: 404, 413,
        429.
    """

    def __init__(self, words: str, *, status: int = 200) -> None:
        super().__init__(words)
        self.words, self.status = words[:_LONGEST_WORDS], status


@dataclass(frozen=True, slots=True)
class Asked:
    """What an upload's JSON asks.

    Attributes
    ----------
    scale : tuple of (str, float, float) or None
        Unit, lower and upper bound.
    center : Icrs or None
        None: not given.
    radius_deg : float or None
        None: not given.
    width_px, height_px : int or None
        Of the frame that a list of stars is of.
    linear : bool
        No distortion terms are wanted.
    invert : bool
        The stars are dark on a bright sky.
    parity : int
        0, 1, or 2 for both; told in the log, it bounds no search.
    """

    scale: tuple[str, float, float] | None = None
    center: Icrs | None = None
    radius_deg: float | None = None
    width_px: int | None = None
    height_px: int | None = None
    linear: bool = False
    invert: bool = False
    parity: int = 2

    @property
    def stars(self) -> ListFormat:
        """How a list of stars is to be read.

        FITS counts, the first pixel is 1, y along the rows: AstroImageJ's y, which it counts from below, is
        that of the rows of its files, and the WCS goes back into them.
        """
        return ListFormat(width_px=self.width_px, height_px=self.height_px)


def read_request(text: str | bytes) -> dict[str, Any]:
    """Read the JSON of a request.

    Raises
    ------
    NovaError
        It is no object, too long, or holds what JSON doesn't have (NaN).
    """
    if len(text) > MOST_JSON_BYTES:
        raise NovaError(f"the JSON has {len(text)} bytes: {MOST_JSON_BYTES} are the most", status=413)
    try:
        found = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as fault:
        raise NovaError(f"failed to parse JSON: {fault}") from fault
    if not isinstance(found, dict):
        raise NovaError("failed to parse JSON: it is not an object")
    if len(found) > _MOST_KEYS:
        raise NovaError(f"the JSON has {len(found)} keys: {_MOST_KEYS} are the most")
    return found


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not a number")


def read_asked(request: Mapping[str, Any]) -> Asked:
    """Read what an upload asks. Raises `NovaError` for a value that makes no sense, by its name."""
    ra = _number(request, "center_ra", 0.0, 360.0)
    dec = _number(request, "center_dec", -90.0, 90.0)
    if (ra is None) != (dec is None):
        raise NovaError("center_ra and center_dec go together")
    order = _whole(request, "tweak_order", 0, 20)
    parity = _whole(request, "parity", 0, 2)
    return Asked(
        scale=_scale(request),
        center=None if ra is None or dec is None else Icrs(ra % 360.0, dec),
        radius_deg=_number(request, "radius", 0.0, 180.0),
        width_px=_whole(request, "image_width", 1, MOST_SIDE_PX),
        height_px=_whole(request, "image_height", 1, MOST_SIDE_PX),
        linear=order is not None and order <= _LINEAR_ORDER,
        invert=_flag(request, "invert"),
        parity=2 if parity is None else parity,
    )


def _scale(request: Mapping[str, Any]) -> tuple[str, float, float] | None:
    """Unit and bounds of the scale; those that are left out bound nothing."""
    largest = float("1e9")
    kind = request.get("scale_type") or ("ev" if request.get("scale_est") is not None else "ul")
    unit = request.get("scale_units") or "degwidth"
    if unit not in ("arcsecperpix", "arcminwidth", "degwidth", "focalmm"):
        raise NovaError("scale_units is none of arcsecperpix, arcminwidth, degwidth, focalmm")
    if kind == "ev":
        estimate = _number(request, "scale_est", 0.0, largest)
        error_percent = _number(request, "scale_err", 0.0, largest)
        if not estimate or error_percent is None:
            return None
        part = min(error_percent / 100.0, 1.0)
        return unit, estimate * (1.0 - part), estimate * (1.0 + error_percent / 100.0)
    if kind != "ul":
        raise NovaError("scale_type is none of ul, ev")
    lower = _number(request, "scale_lower", -largest, largest)
    upper = _number(request, "scale_upper", 0.0, largest)
    if lower is None and not upper:
        return None
    low, high = max(0.0, lower or 0.0), upper or math.inf
    if low > high:
        raise NovaError("scale_lower is above scale_upper")
    return unit, low, high


def _number(request: Mapping[str, Any], name: str, least: float, greatest: float) -> float | None:
    """A number of the request; clients also send it as text. None for what is left out."""
    value = request.get(name)
    if value is None or value == "":
        return None
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise NovaError(f"{name} is not a number")
    try:
        number = float(value[:_LONGEST_WORDS] if isinstance(value, str) else value)
    except (ValueError, OverflowError) as fault:
        raise NovaError(f"{name} is not a number") from fault
    if not (math.isfinite(number) and least <= number <= greatest):
        raise NovaError(f"{name} = {number:g} is out of range: {least:g} to {greatest:g}")
    return number


def _whole(request: Mapping[str, Any], name: str, least: int, greatest: int) -> int | None:
    number = _number(request, name, least, greatest)
    if number is None:
        return None
    if number != int(number):
        raise NovaError(f"{name} is not a whole number")
    return int(number)


def _flag(request: Mapping[str, Any], name: str) -> bool:
    """Yes or no, as clients write it."""
    value = request.get(name)
    return value in (True, 1) or (isinstance(value, str) and value.lower() in ("1", "y", "yes", "true", "t"))


def hint_of(asked: Asked, width_px: int | None) -> tuple[Hint | None, str]:
    """The hint that an upload gives, and what of it could not be used, in words.

    Parameters
    ----------
    width_px : int or None
        Of the frame, for scales that are told by its width; None where it isn't known before it is read.
    """
    low, high, lost = _bounds_arcsec_px(asked.scale, width_px)
    if asked.center is None and low is None and high is None:
        return None, lost
    hint = Hint(scale_low_arcsec_px=low, scale_high_arcsec_px=high, center=asked.center)
    if asked.center is not None:
        hint = Hint(
            center=asked.center,
            radius_deg=asked.radius_deg or _UNKNOWN_RADIUS_DEG,
            scale_low_arcsec_px=low,
            scale_high_arcsec_px=high,
        )
    return hint, lost


def _bounds_arcsec_px(
    scale: tuple[str, float, float] | None, width_px: int | None
) -> tuple[float | None, float | None, str]:
    if scale is None:
        return None, None, ""
    unit, low, high = scale
    if unit != "arcsecperpix" and width_px is None:
        return None, None, f"the scale in {unit} was not used: the frame's width was not known"
    if unit == "focalmm":
        # the longer the lens, the finer the scale; the field of 36 mm film
        low, high = _film_arcsec(high), _film_arcsec(low)
    factor = {"arcsecperpix": 1.0, "arcminwidth": _ARCSEC_ARCMIN, "degwidth": _ARCSEC_DEG, "focalmm": 1.0}
    pixels = 1.0 if unit == "arcsecperpix" else float(width_px or 1)
    bounds = [bound * factor[unit] / pixels for bound in (low, high)]
    if bounds[0] > _LARGEST_SCALE_ARCSEC:
        raise NovaError(f"a scale of {bounds[0]:g} arcseconds per pixel or more is no camera's")
    lower = bounds[0] if bounds[0] > 0.0 else None
    upper = bounds[1] if math.isfinite(bounds[1]) and bounds[1] <= _LARGEST_SCALE_ARCSEC else None
    return lower, upper, ""


def _film_arcsec(focal_mm: float) -> float:
    """Width of 36 mm film behind a lens, arcsec."""
    if focal_mm <= 0.0:
        return math.inf
    return 2.0 * math.atan(0.5 * _FULL_FRAME_MM / focal_mm) * ARCSEC_PER_RAD


def stars_text(x: object, y: object) -> bytes:
    """Lists of x and y as the text of a star list, the brightest first. Raises `NovaError`."""
    if not isinstance(x, list) or not isinstance(y, list):
        raise NovaError("x and y are lists of numbers; or send a file")
    if len(x) != len(y) or not x:
        raise NovaError(f"x has {len(x)} numbers and y has {len(y)}")
    for name, values in (("x", x), ("y", y)):
        if any(type(value) not in (int, float) for value in values):
            raise NovaError(f"{name} holds what is not a number")
        if not all(-MOST_SIDE_PX < value < MOST_SIDE_PX for value in values):
            raise NovaError(f"{name} holds a number beyond {MOST_SIDE_PX} pixels")
    return "".join(f"{one!r} {other!r}\n" for one, other in zip(x, y, strict=True)).encode("ascii")


def picture_kind(head: bytes) -> Literal["fits", "picture", "other"]:
    """What an upload is by its first bytes, as far as the orientation of its pixels goes."""
    if head[:6] == b"SIMPLE":
        return "fits"
    return "picture" if head[:8] == b"\x89PNG\r\n\x1a\n" or head[:3] == b"\xff\xd8\xff" else "other"


def calibration(cards: Mapping[str, Value], *, picture: bool) -> dict[str, float]:
    """The calibration of a solved job, as nova has it: degrees and arcseconds.

    Parameters
    ----------
    cards : mapping
        Of a solution.
    picture : bool
        A PNG or JPEG, whose rows are counted from the top.
    """
    numbers = wcs_numbers(cards)
    orientation = numbers.orientation_deg
    if picture:
        orientation = (180.0 - orientation) % 360.0
    return {
        "ra": numbers.ra_deg,
        "dec": numbers.dec_deg,
        "width_arcsec": numbers.width_deg * _ARCSEC_DEG,
        "height_arcsec": numbers.height_deg * _ARCSEC_DEG,
        "radius": numbers.radius_deg,
        "pixscale": numbers.pixscale_arcsec,
        "orientation": orientation,
        "parity": float(numbers.determinant_sign),
    }


def error_reply(words: str) -> dict[str, object]:
    """An error. N.I.N.A. reads `subid` before the status, and would show its absence instead of the words."""
    return {"status": "error", "errormessage": words, "subid": None}


def words_of(error: Exception) -> str:
    """What a client is told of an error of ours."""
    return f"{error.what}: {error.advice}" if isinstance(error, BadRequest) and error.advice else str(error)
