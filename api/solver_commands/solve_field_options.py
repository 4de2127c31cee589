"""The options of `solve-field`: astrometry.net's whole table, and what of it matters here."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from typing import Literal

from api.solver_commands.getopt_long import Option, Parted, parted
from mountnav.errors import BadRequest
from mountnav.frames import Hint
from mountnav.reading.star_lists import ListFormat
from mountnav.sky.coordinates import Icrs
from mountnav.sky.typed_coordinates import read_dec_deg, read_ra_deg

__all__ = ["OPTIONS", "USAGE", "Wanted", "options_wanted"]

_FLAGS = (
    ("help", "h"), ("version", ""), ("verbose", "v"), ("batch", "("), ("files-on-stdin", "f"),
    ("no-plots", "p"),
    ("use-wget", "G"), ("overwrite", "O"), ("continue", "K"), ("skip-solved", "J"), ("fits-image", ""),
    ("just-augment", "@"), ("temp-axy", ""), ("timestamp", ""), ("no-delete-temp", "7"),
    ("use-source-extractor", "^"), ("resort", "r"), ("invert", ";"), ("no-background-subtraction", "]"),
    ("no-remove-lines", "9"), ("no-verify-uniformize", ""), ("no-verify-dedup", ""), ("tag-all", "<"),
    ("dont-augment", "A"), ("no-verify", "y"), ("guess-scale", "g"), ("crpix-center", ">"), ("no-tweak", "T"),
    ("sort-ascending", "a"),
    # of older and newer versions, and of derivatives of it
    ("no-fits2fits", ""), ("use-sextractor", ""), ("force-ppm", ""), ("no-tempfiles", ""),
)  # fmt: skip
_VALUES = (
    ("dir", "D"), ("out", "o"), ("backend-config", "b"), ("config", ""), ("index-dir", ""),
    ("index-file", ""), ("plot-scale", ""), ("plot-bg", ""), ("new-fits", "N"), ("kmz", "Z"), ("scamp", "i"),
    ("scamp-config", "n"),
    ("index-xyls", "U"), ("axy", ""), ("scale-low", "L"), ("scale-high", "H"), ("scale-units", "u"),
    ("parity", "8"), ("code-tolerance", "c"), ("pixel-error", "E"), ("quad-size-min", "q"),
    ("quad-size-max", "Q"), ("odds-to-tune-up", ""), ("odds-to-solve", "["), ("odds-to-reject", "#"),
    ("odds-to-stop-looking", "%"), ("source-extractor-config", "&"), ("source-extractor-path", "*"),
    ("sextractor-config", ""), ("sextractor-path", ""), ("ra", "3"), ("dec", "4"), ("radius", "5"),
    ("depth", "d"), ("objs", "|"), ("cpulimit", "l"), ("extension", "6"), ("downsample", "z"), ("sigma", "{"),
    ("nsigma", ""), ("uniformize", ":"), ("cancel", "C"), ("solved", "S"), ("solved-in", "I"), ("match", "M"),
    ("rdls", "R"), ("sort-rdls", ""), ("tag", "}"), ("scamp-ref", "j"), ("corr", "B"), ("wcs", "W"),
    ("pnm", "P"), ("keep-xylist", "k"), ("verify", "V"), ("verify-ext", ""), ("crpix-x", "/"),
    ("crpix-y", "\\"), ("tweak-order", "t"), ("predistort", ""), ("xscale", ""), ("temp-dir", "m"),
    ("fields", "F"), ("width", "w"), ("height", "e"), ("x-column", "X"), ("y-column", "Y"),
    ("sort-column", "s"),
)  # fmt: skip
OPTIONS = (
    *(Option(name, letter) for name, letter in _FLAGS),
    *(Option(name, letter, "needed") for name, letter in _VALUES),
)
"""All of them, long and short."""

USAGE = """Usage: solve-field [options] [<image-file> ...] [<star-list> ...]

Finds out where images, or lists of stars, lie in the sky. The options are those of astrometry.net's
solve-field; these have an effect:
  -h --help, --version
  -D --dir DIR, -o --out BASE          where output files go, and what they are called
  -O --overwrite, -K --continue, -J --skip-solved
  -N --new-fits, -W --wcs, -S --solved, -M --match, -R --rdls, -B --corr, -U --index-xyls, --axy FILE
                                       names of output files; "none" for no such file
  --temp-axy, -k --keep-xylist FILE, -C --cancel FILE, -f --files-on-stdin, --just-augment
  -3 --ra, -4 --dec (degrees or H:M:S, D:M:S), -5 --radius DEGREES
  -L --scale-low, -H --scale-high, -u --scale-units degwidth|arcminwidth|arcsecperpix|focalmm
  -g --guess-scale, -8 --parity pos|neg, -l --cpulimit SECONDS, -T --no-tweak, -t --tweak-order N
  -w --width, -e --height, -X --x-column, -Y --y-column, -s --sort-column, -a --sort-ascending
All others are accepted and ignored. No plots are made.
"""

ROOMY_RADIUS_DEG = 15.0
"""How far off a place without --radius may be, degrees. chosen by hand: a mount that is farther off was
never aligned. Doubled, the search beside the place takes longer before the whole sky
is searched."""
SLACK = 0.01
"""By what part a scale may lie outside of what was asked: the bounds are of the scale in the middle or across
the whole field, and people round. chosen by hand; doubled, nothing that is found becomes wrong."""
_FILM_WIDTH_MM = 36.0
"""Width of a frame of 35-mm film."""
_LEADING_NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
Unit = Literal["degrees", "arcminutes", "arcsec", "film"]
_UNITS: dict[str, Unit] = {
    "degwidth": "degrees", "degw": "degrees", "dw": "degrees",
    "arcminwidth": "arcminutes", "amw": "arcminutes", "aw": "arcminutes",
    "arcsecperpix": "arcsec", "app": "arcsec", "focalmm": "film",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a call of `solve-field` asks of each of its files.

    Attributes
    ----------
    center : Icrs or None
        Where to look.
    radius_deg : float or None
        How far from there the frame's center is believed to be.
    scale_low, scale_high : float or None
        In `unit`.
    parity : int
        +1 or -1 where only the sky as seen, or only the mirrored one, is wanted; 0 for both.
    header_hints : bool
        What the file's header says may help: as a hint, never as a bound.
    cpu_limit_s : float or None
        None: no limit.
    sip : bool
        Terms of higher order are wanted in the WCS.
    stars : ListFormat
        How to read a list of stars.
    """

    center: Icrs | None = None
    radius_deg: float | None = None
    scale_low: float | None = None
    scale_high: float | None = None
    unit: Unit = "degrees"
    parity: int = 0
    header_hints: bool = False
    cpu_limit_s: float | None = None
    sip: bool = True
    stars: ListFormat = field(default_factory=ListFormat)

    def scale_arcsec_px(self, width_px: int) -> tuple[float | None, float | None]:
        """Bounds of the scale for a frame of this width."""
        low, high = self.scale_low, self.scale_high
        if self.unit == "arcsec":
            return low, high
        if self.unit == "film":
            # the original takes half the angle that a lens of this length has; here either is within bounds
            half = [
                None if mm is None else math.degrees(math.atan(_FILM_WIDTH_MM / 2.0 / mm))
                for mm in (high, low)
            ]
            low, high = half[0], None if half[1] is None else 2.0 * half[1]
        per_px = (60.0 if self.unit == "arcminutes" else 3600.0) / width_px
        return None if low is None else low * per_px, None if high is None else high * per_px

    @property
    def asks_width(self) -> bool:
        """Whether the bounds of the scale depend on the frame's width."""
        return self.unit != "arcsec" and (self.scale_low is not None or self.scale_high is not None)

    def hint(self, width_px: int) -> Hint | None:
        """What a solve is told."""
        low, high = self.scale_arcsec_px(width_px)
        hint = Hint(scale_low_arcsec_px=low, scale_high_arcsec_px=high)
        if self.center is not None:
            radius = ROOMY_RADIUS_DEG if self.radius_deg is None else self.radius_deg
            hint = replace(hint, center=self.center, radius_deg=min(max(radius, 1e-3), 180.0))
        return None if hint == Hint() else hint


def options_wanted(arguments: list[str]) -> tuple[Parted, Wanted]:
    """Read a command line.

    Raises
    ------
    UnknownOption
        As of `parted`.
    BadRequest
        A value makes no sense.
    """
    asked = parted(arguments, OPTIONS)
    ra, dec, radius = asked.last("ra"), asked.last("dec"), asked.last("radius")
    # as in the original, half a place is none
    center = None if ra is None or dec is None else Icrs(_ra_deg(ra), _dec_deg(dec))
    low, high = (_positive(asked.last(name)) for name in ("scale-low", "scale-high"))
    if low is not None and high is not None and low > high:
        raise BadRequest("--scale-low is above --scale-high", advice="swap them")
    units = asked.last("scale-units") or "degwidth"
    unit = _UNITS.get(units.lower())
    if unit is None:
        raise BadRequest(
            f"unknown scale units {units!r}", advice="degwidth, arcminwidth, arcsecperpix, focalmm"
        )
    parity = asked.last("parity")
    if parity not in (None, "pos", "neg"):
        raise BadRequest(f"unknown parity {parity!r}", advice="pos or neg")
    order = asked.last("tweak-order")
    width, height = (int(_number(asked.last(name)) or 0) or None for name in ("width", "height"))
    wanted = Wanted(
        center=center,
        radius_deg=None if radius is None or center is None else _radius_deg(radius),
        scale_low=low,
        scale_high=high,
        unit=unit,
        parity={"pos": 1, "neg": -1}.get(parity or "", 0),
        header_hints=asked.given("guess-scale"),
        cpu_limit_s=_positive(asked.last("cpulimit")),
        sip=not asked.given("no-tweak") and not (order is not None and _number(order) == 1.0),
        stars=ListFormat(
            x_column=asked.last("x-column"),
            y_column=asked.last("y-column"),
            sort_column=asked.last("sort-column"),
            ascending=True if asked.given("sort-ascending") else None,
            width_px=width,
            height_px=height,
        ),
    )
    return asked, wanted


def _number(text: str | None) -> float | None:
    """As C's `atof`: what the text begins with, else 0."""
    if text is None:
        return None
    match = _LEADING_NUMBER.match(text)
    value = float(match[0]) if match else 0.0
    return value if math.isfinite(value) else 0.0


def _positive(text: str | None) -> float | None:
    """A number above 0; None as if it weren't given for all else, as in the original."""
    value = _number(text)
    return value if value is not None and value > 0.0 else None


def _radius_deg(text: str) -> float | None:
    value = _number(text)
    return value if value is not None and value >= 0.0 and _LEADING_NUMBER.match(text) else None


def _ra_deg(text: str) -> float:
    """A right ascension: a single number is degrees, several are hours, as in the original.

    Beyond the original the typed forms of `mountnav.sky.typed_coordinates` are read (``5h32m``,
    ``05 32 48``). That refuses numbers out of range, which the original takes modulo 360: so plain numbers
    are read here.
    """
    plain = _plain(text)
    return read_ra_deg(text) % 360.0 if plain is None else plain % 360.0


def _dec_deg(text: str) -> float:
    plain = _plain(text)
    if plain is None:
        return read_dec_deg(text)
    if not -90.0 <= plain <= 90.0:
        raise BadRequest(f"a declination of {plain:g} degrees", advice="from -90 to 90")
    return plain


def _plain(text: str) -> float | None:
    match = _LEADING_NUMBER.fullmatch(text.strip())
    if match is None:
        return None
    value = float(match[0])
    if not math.isfinite(value):
        raise BadRequest(f"{text} is not an angle", advice="give degrees")
    return value
