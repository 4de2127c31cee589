"""`wcsinfo`: what a WCS says of its frame, a key and a value on each line, by astrometry.net's formulas."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import FileIO
from itertools import pairwise
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from numpy.typing import NDArray

from api.solver_commands.getopt_long import Option, UnknownOption, parted
from mountnav.errors import BadFrame
from mountnav.reading.content import OnDisk
from mountnav.reading.fits_headers import Value, walk
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic, separation_arcsec
from mountnav.sky.wcs import places_at_pixels

if TYPE_CHECKING:
    from api.solver_commands.host import Host, Solver

__all__ = ["FieldWcs", "dms", "field_wcs", "hms", "run"]

Array = NDArray[np.float64]

ERROR_CODE = 255
"""Exit code of the original for all errors."""
BOUNDARY_STEP_PX = 10.0
"""Distance of the places on the frame's edge that bounds in right ascension and declination are taken from;
the original's."""
_USAGE = """Usage: wcsinfo [options] <wcs-file>
    [-e <extension>]: read from this FITS extension; the first by default
    [-W <width>]: width of the frame, pixels
    [-H <height>]: height of the frame, pixels
"""
_OPTIONS = (
    Option("extension", "e", "needed"),
    Option("width", "W", "needed"),
    Option("height", "H", "needed"),
    Option("help", "h"),
)


@dataclass(frozen=True, slots=True)
class FieldWcs:
    """A TAN or TAN-SIP plate with the size of its frame.

    Attributes
    ----------
    cards : mapping
        CTYPE, CRPIX, CRVAL, CD, and SIP terms if any.
    """

    cards: Mapping[str, str | int | float]
    width_px: float
    height_px: float

    def number(self, name: str) -> float:
        """One of the cards."""
        return float(self.cards[name])

    @property
    def determinant(self) -> float:
        """Of the CD matrix, square degrees; negative for the ordinary sky."""
        cd11, cd12, cd21, cd22 = (self.number(f"CD{i}_{j}") for i in (1, 2) for j in (1, 2))
        return cd11 * cd22 - cd12 * cd21

    @property
    def parity(self) -> int:
        """Its sign."""
        return 1 if self.determinant >= 0.0 else -1

    @property
    def scale_arcsec_px(self) -> float:
        """sqrt(|det CD|)."""
        return 3600.0 * math.sqrt(abs(self.determinant))

    @property
    def orientation_deg(self) -> float:
        """Position angle of up at the reference pixel, east of north."""
        sign = self.parity
        up = sign * self.number("CD1_1") + self.number("CD2_2")
        across = sign * self.number("CD2_1") - self.number("CD1_2")
        return -math.degrees(math.atan2(across, up))

    def places(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Right ascension and declination, degrees, of pixels that count from 1."""
        return places_at_pixels(self.cards, x - 1.0, y - 1.0)

    @property
    def center(self) -> Icrs:
        """The place of the frame's middle."""
        ra, dec = self.places(np.array([0.5 + 0.5 * self.width_px]), np.array([0.5 + 0.5 * self.height_px]))
        return Icrs(float(ra[0]), float(dec[0]))

    @property
    def size(self) -> tuple[float, float, str]:
        """Width and height through the frame's middle, and their unit: degrees, arcminutes or arcseconds."""
        wide, high = 0.5 + self.width_px, 0.5 + self.height_px
        middle_x, middle_y = 0.5 * (0.5 + wide), 0.5 * (0.5 + high)
        width = self._length_arcsec((0.5, middle_x, wide), (middle_y,) * 3)
        height = self._length_arcsec((middle_x,) * 3, (0.5, middle_y, high))
        if min(width, height) < 60.0:
            return width, height, "arcseconds"
        if min(width, height) < 3600.0:
            return width / 60.0, height / 60.0, "arcminutes"
        return width / 3600.0, height / 3600.0, "degrees"

    def _length_arcsec(self, x: Sequence[float], y: Sequence[float]) -> float:
        ra, dec = self.places(np.array(x), np.array(y))
        places = [Icrs(float(one), float(other)) for one, other in zip(ra, dec, strict=True)]
        return sum(separation_arcsec(one, other) for one, other in pairwise(places))

    def bounds_deg(self) -> tuple[float, float, float, float]:
        """Least and greatest right ascension (continued beyond 0 and 360) and declination in the frame."""
        x, y = self._edge()
        center = self.center
        ra, dec = self.places(x, y)
        ra = np.where(ra - center.ra_deg > 180.0, ra - 360.0, ra)
        ra = np.where(center.ra_deg - ra > 180.0, ra + 360.0, ra)
        ra_low, ra_high = min(float(ra.min()), center.ra_deg), max(float(ra.max()), center.ra_deg)
        dec_low, dec_high = min(float(dec.min()), center.dec_deg), max(float(dec.max()), center.dec_deg)
        if self._holds_pole(90.0):
            ra_low, ra_high, dec_high = 0.0, 360.0, 90.0
        if self._holds_pole(-90.0):
            ra_low, ra_high, dec_low = 0.0, 360.0, -90.0
        return ra_low, ra_high, dec_low, dec_high

    def _edge(self) -> tuple[Array, Array]:
        """Places along the frame's four sides."""
        right, top = 0.5 + self.width_px, 0.5 + self.height_px
        along_x = np.minimum(0.5 + BOUNDARY_STEP_PX * np.arange(math.ceil(self.width_px / 10.0)), right)
        along_y = np.minimum(0.5 + BOUNDARY_STEP_PX * np.arange(math.ceil(self.height_px / 10.0)), top)
        x = [along_x, np.full(along_y.size, right), right + 0.5 - along_x, np.full(along_y.size, 0.5)]
        y = [np.full(along_x.size, 0.5), along_y, np.full(along_x.size, top), top + 0.5 - along_y]
        return np.concatenate(x), np.concatenate(y)

    def _holds_pole(self, dec_deg: float) -> bool:
        xi, eta = gnomonic(np.zeros(1), np.array([dec_deg]), self.number("CRVAL1"), self.number("CRVAL2"))
        matrix = np.array([[self.number(f"CD{i}_{j}") for j in (1, 2)] for i in (1, 2)])
        if not np.isfinite(xi).all() or not self.determinant:
            return False
        u, v = np.linalg.solve(matrix, np.degrees([float(np.asarray(xi)[0]), float(np.asarray(eta)[0])]))
        out = [u, v]
        for at, letter in enumerate(("AP", "BP")):
            order = int(self.cards.get(f"{letter}_ORDER", 0))
            out[at] += sum(
                float(self.cards.get(f"{letter}_{i}_{j}", 0.0)) * u**i * v**j
                for i in range(order + 1)
                for j in range(order + 1 - i)
            )
        x, y = out[0] + self.number("CRPIX1"), out[1] + self.number("CRPIX2")
        return bool(1.0 <= x <= self.width_px and 1.0 <= y <= self.height_px)


def field_wcs(cards: Mapping[str, Value], width_px: float = 0.0, height_px: float = 0.0) -> FieldWcs:
    """Make a plate of FITS cards.

    Parameters
    ----------
    cards : mapping
        CD, or CDELT with PC or CROTA2; axes in either order.
    width_px, height_px : float
        Of the frame, where IMAGEW and IMAGEH are not to be asked.

    Raises
    ------
    BadFrame
        No TAN or TAN-SIP WCS, or no size.
    """
    kinds = [str(cards.get(f"CTYPE{axis}", "")).strip() for axis in (1, 2)]
    swapped = kinds[0].startswith("DEC-")
    if swapped:
        kinds = kinds[::-1]
    if kinds[0] not in ("RA---TAN", "RA---TAN-SIP") or not kinds[1].startswith("DEC--TAN"):
        raise BadFrame(
            f"CTYPE1 is {cards.get('CTYPE1')!r}",
            advice="a WCS of the kind RA---TAN or RA---TAN-SIP is needed",
        )
    lon, lat = (2, 1) if swapped else (1, 2)
    found: dict[str, str | int | float] = {
        name: value
        for name, value in cards.items()
        if not isinstance(value, bool) and (name[:2] in ("A_", "B_") or name[:3] in ("AP_", "BP_"))
    }
    found |= {"CTYPE1": kinds[0], "CTYPE2": kinds[1]}
    found |= {f"CRPIX{axis}": _needed(cards, f"CRPIX{axis}") for axis in (1, 2)}
    found |= {"CRVAL1": _needed(cards, f"CRVAL{lon}"), "CRVAL2": _needed(cards, f"CRVAL{lat}")}
    for row, axis in ((1, lon), (2, lat)):
        for column in (1, 2):
            found[f"CD{row}_{column}"] = _matrix_entry(cards, axis, column)
    width = width_px or _first(cards, "IMAGEW", "ZNAXIS1", "NAXIS1")
    height = height_px or _first(cards, "IMAGEH", "ZNAXIS2", "NAXIS2")
    if not (width > 0.0 and height > 0.0):
        raise BadFrame("there are no cards IMAGEW and IMAGEH", advice="give the frame's size by -W and -H")
    if not all(math.isfinite(value) for value in found.values() if isinstance(value, int | float)):
        raise BadFrame("the WCS has numbers that aren't finite", advice="solve the frame again")
    return FieldWcs(found, width, height)


def _matrix_entry(cards: Mapping[str, Value], axis: int, column: int) -> float:
    """Of the CD matrix, degrees per pixel; as [FITS 4.0, section 8] has it where it is told otherwise."""
    if any(f"CD{i}_{j}" in cards for i in (1, 2) for j in (1, 2)):
        return _needed(cards, f"CD{axis}_{column}")
    step = _needed(cards, f"CDELT{axis}")
    if any(f"PC{i}_{j}" in cards for i in (1, 2) for j in (1, 2)):
        default = 1.0 if axis == column else 0.0
        return step * (_needed(cards, f"PC{axis}_{column}") if f"PC{axis}_{column}" in cards else default)
    turn = math.radians(_needed(cards, "CROTA2") if "CROTA2" in cards else 0.0)
    if axis == column:
        return step * math.cos(turn)
    other = _needed(cards, f"CDELT{column}")
    return -other * math.sin(turn) if axis == 1 else other * math.sin(turn)


def _needed(cards: Mapping[str, Value], name: str) -> float:
    value = cards.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadFrame(f"the WCS has no card {name}", advice="solve the frame again")
    return float(value)


def _first(cards: Mapping[str, Value], *names: str) -> float:
    for name in names:
        value = cards.get(name)
        if isinstance(value, int | float) and not isinstance(value, bool) and value:
            return float(value)
    return 0.0


def hms(ra_deg: float) -> tuple[int, int, float]:
    """Hours, minutes and seconds."""
    hours = ra_deg % 360.0 / 15.0
    minutes = (hours - math.floor(hours)) * 60.0
    return math.floor(hours), math.floor(minutes), (minutes - math.floor(minutes)) * 60.0


def dms(dec_deg: float) -> tuple[int, int, int, float]:
    """Sign, degrees, minutes and seconds."""
    size = abs(dec_deg)
    minutes = (size - math.floor(size)) * 60.0
    sign = 1 if dec_deg >= 0.0 else -1
    return sign, math.floor(size), math.floor(minutes), (minutes - math.floor(minutes)) * 60.0


def hms_text(ra_deg: float) -> str:
    """As ``05:32:47.988``."""
    return _text(*hms(ra_deg))


def dms_text(dec_deg: float) -> str:
    """As ``+21:24:00.342``."""
    sign, *parts = dms(dec_deg)
    return ("+" if sign > 0 else "-") + _text(*parts)


def _text(first: float, minutes: float, seconds: float) -> str:
    """Rounded to a thousandth of a second, carried on."""
    thousandths = round(seconds * 1000.0)
    minutes, thousandths = minutes + thousandths // 60_000, thousandths % 60_000
    first, minutes = first + minutes // 60, minutes % 60
    return f"{first:02.0f}:{minutes:02.0f}:{thousandths // 1000:02d}.{thousandths % 1000:03d}"


def _mercator_x(ra_deg: float) -> float:
    turns = ra_deg / 360.0
    return turns if 0.0 <= turns <= 1.0 else turns % 1.0


def _mercator_y(dec_deg: float) -> float:
    return 0.5 + math.asinh(math.tan(math.radians(dec_deg))) / (2.0 * math.pi)


def lines(wcs: FieldWcs) -> list[tuple[str, str]]:
    """All keys with their values, in the original's order and formats."""
    center, scale = wcs.center, wcs.scale_arcsec_px
    tangent_ra, tangent_dec = wcs.number("CRVAL1"), wcs.number("CRVAL2")
    turn = math.atan(math.tan(math.radians(center.ra_deg - tangent_ra)) * math.sin(math.radians(tangent_dec)))
    hours, ra_minutes, ra_seconds = hms(center.ra_deg)
    sign, degrees, dec_minutes, dec_seconds = dms(center.dec_deg)
    width, height, unit = wcs.size
    ra_low, ra_high, dec_low, dec_high = wcs.bounds_deg()
    x_low, x_high = _mercator_x(ra_high), _mercator_x(ra_low)
    y_low, y_high = _mercator_y(dec_high), _mercator_y(dec_low)
    reach = max(abs(x_low - x_high), abs(y_low - y_high))
    area = wcs.width_px * scale / 3600.0 * (wcs.height_px * scale / 3600.0)

    def precise(value: float) -> str:
        return f"{value:.12g}"

    return [
        ("crpix0", precise(wcs.number("CRPIX1"))),
        ("crpix1", precise(wcs.number("CRPIX2"))),
        ("crval0", precise(tangent_ra)),
        ("crval1", precise(tangent_dec)),
        ("ra_tangent", precise(tangent_ra)),
        ("dec_tangent", precise(tangent_dec)),
        ("pixx_tangent", precise(wcs.number("CRPIX1"))),
        ("pixy_tangent", precise(wcs.number("CRPIX2"))),
        ("imagew", precise(wcs.width_px)),
        ("imageh", precise(wcs.height_px)),
        ("cd11", precise(wcs.number("CD1_1"))),
        ("cd12", precise(wcs.number("CD1_2"))),
        ("cd21", precise(wcs.number("CD2_1"))),
        ("cd22", precise(wcs.number("CD2_2"))),
        ("det", precise(wcs.determinant)),
        ("parity", f"{wcs.parity}"),
        ("pixscale", precise(scale)),
        ("orientation", f"{wcs.orientation_deg:.8g}"),
        ("ra_center", precise(center.ra_deg)),
        ("dec_center", precise(center.dec_deg)),
        ("orientation_center", f"{wcs.orientation_deg + math.degrees(turn):.8g}"),
        ("ra_center_h", f"{hours}"),
        ("ra_center_m", f"{ra_minutes}"),
        ("ra_center_s", precise(ra_seconds)),
        ("dec_center_sign", f"{sign}"),
        ("dec_center_d", f"{degrees}"),
        ("dec_center_m", f"{dec_minutes}"),
        ("dec_center_s", precise(dec_seconds)),
        ("ra_center_hms", hms_text(center.ra_deg)),
        ("dec_center_dms", dms_text(center.dec_deg)),
        ("ra_center_merc", f"{_mercator_x(center.ra_deg):.8g}"),
        ("dec_center_merc", f"{_mercator_y(center.dec_deg):.8g}"),
        ("fieldarea", f"{area:g}"),
        ("fieldw", f"{width:.4g}"),
        ("fieldh", f"{height:.4g}"),
        ("fieldunits", unit),
        ("decmin", f"{dec_low:g}"),
        ("decmax", f"{dec_high:g}"),
        ("ramin", f"{ra_low:g}"),
        ("ramax", f"{ra_high:g}"),
        ("ra_min_merc", f"{x_low:g}"),
        ("ra_max_merc", f"{x_high:g}"),
        ("dec_min_merc", f"{y_low:g}"),
        ("dec_max_merc", f"{y_high:g}"),
        ("merc_diff", f"{reach:g}"),
        ("merczoom", f"{-math.floor(math.log2(reach)) if reach > 0.0 else 0}"),
    ]


def cards_of(file: BinaryIO, label: str, extension: int = 0) -> dict[str, Value]:
    """The cards of one header of a FITS file. Raises `BadFrame`."""
    content = OnDisk(FileIO(file.fileno(), "rb", closefd=False))
    if content[:6] != b"SIMPLE":
        raise BadFrame("it is not a FITS file", device=label, advice="give the .wcs file of a solved frame")
    hdus = walk(content, label)
    if not 0 <= extension < len(hdus):
        raise BadFrame(f"there is no extension {extension}", device=label, advice=f"it has {len(hdus)}")
    return hdus[extension].cards.values


def run(arguments: list[str], host: Host, solver: Solver) -> int:
    """Print what a WCS says.

    Returns
    -------
    int
        0, or 255 where there is no such WCS.
    """
    try:
        asked = parted(arguments, _OPTIONS)
    except UnknownOption as fault:
        host.err(f"wcsinfo: {fault}\n")
        host.out(_USAGE)
        return ERROR_CODE
    if asked.given("help") or len(asked.files) != 1:
        host.out(_USAGE)
        return ERROR_CODE
    name = asked.files[0]
    try:
        numbers = [float(asked.last(option) or 0) for option in ("extension", "width", "height")]
        with host.open(name) as file:
            cards = cards_of(file, name, int(numbers[0]))
        wcs = field_wcs(cards, numbers[1], numbers[2])
        text = "".join(f"{key} {value}\n" for key, value in lines(wcs))
    except (BadFrame, OSError, ValueError, OverflowError, ZeroDivisionError) as fault:
        host.err(f"wcsinfo: failed to read a WCS from {name}: {fault}\n")
        return ERROR_CODE
    host.out(text)
    return 0
