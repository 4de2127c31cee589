"""The result files of ASTAP: `.ini` in its order, `.wcs` as lines of text or as a FITS header.

What programs read of them: N.I.N.A. parts each line of the `.ini` at its first equals sign and stops at a
line without one, or at a name that comes twice; StellarSolver wants PLTSOLVD in the first line, and CDELT1
and CROTA1; CCDciel reads the `.wcs` as lines; MountWizzard4 reads it by astropy, which stops at cards that
break the standard. So both hold plain lines only, whatever a file's name or header brings.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from api.solver_commands.image_facts import one_line
from mountnav.sky.wcs_numbers import Value, WcsNumbers

CARD_LENGTH = 80
"""Characters of a card [FITS 4.0, section 3.3.1]."""
_TEXT_LENGTH = 68
"""Characters of a string that fit a card [FITS 4.0, section 4.2.1]; longer ones need CONTINUE, at which
readers have stopped."""
_COMMENT_LENGTH = 72
"""Characters of a comment that fit a card [FITS 4.0, section 4.4.2.4]."""
_ERRORS = {
    2: "Not enough stars.",
    16: "Error reading image file.",
    32: "No star database found.",
    33: "Error reading star database.",
}
"""What ASTAP says with its exit codes."""
_OF_DATA_OR_PLATE = re.compile(
    r"(SIMPLE|XTENSION|EXTNAME|EXTEND|BITPIX|NAXIS\d*|[PG]COUNT|GROUPS|B(SCALE|ZERO)|BLANK|INHERIT|CHECKSUM"
    r"|DATASUM|END|TFIELDS|THEAP|T(TYPE|FORM|UNIT|DIM|NULL|SCAL|ZERO|DISP|BCOL)\d+|Z[A-Z0-9]+"
    r"|WCS.*|RADE[CS].*|LONPOLE|LATPOLE|EQUINOX|EPOCH|(CTYPE|CUNIT|CRVAL|CRPIX|CDELT|CROTA|CRDER|CSYER)\d+.*"
    r"|(CD|PC|PV|PS)\d+_?\d+.*|[AB]P?_(\d+_\d+|ORDER|DMAX)|PLTSOLVD|WARNING|IMAGE[WH]|COMMENT|HISTORY"
    r"|CONTINUE)$"
)
"""Cards of the frame that are left out of the `.wcs`: how data lie, older plates, what is written again."""
_KEYWORD = re.compile(r"[A-Z0-9_-]{1,8}$")
_COMMENTS = {
    "CRPIX1": "X of reference pixel",
    "CRPIX2": "Y of reference pixel",
    "CRVAL1": "RA of reference pixel (deg)",
    "CRVAL2": "DEC of reference pixel (deg)",
    "CDELT1": "X pixel size (deg)",
    "CDELT2": "Y pixel size (deg)",
    "CROTA1": "Image twist of X axis (deg)",
    "CROTA2": "Image twist of Y axis (deg)",
}


def plate_values(cards: Mapping[str, Value], numbers: WcsNumbers) -> dict[str, float]:
    """What ASTAP states of a plate, in its order.

    Parameters
    ----------
    cards : mapping
        Rows counted from the bottom, CRPIX at the center.
    numbers : WcsNumbers
        Of these cards.
    """
    return {
        "CRPIX1": float(cards["CRPIX1"]),
        "CRPIX2": float(cards["CRPIX2"]),
        "CRVAL1": float(cards["CRVAL1"]),
        "CRVAL2": float(cards["CRVAL2"]),
        "CDELT1": numbers.cdelt1_deg,
        "CDELT2": numbers.cdelt2_deg,
        "CROTA1": numbers.crota1_deg,
        "CROTA2": numbers.crota2_deg,
        "CD1_1": float(cards["CD1_1"]),
        "CD1_2": float(cards["CD1_2"]),
        "CD2_1": float(cards["CD2_1"]),
        "CD2_2": float(cards["CD2_2"]),
    }


def ini_text(
    plate: Mapping[str, float] | None,
    *,
    command: str,
    size: tuple[int, int] | None,
    code: int = 0,
    warning: str = "",
) -> str:
    """Write the `.ini`.

    Parameters
    ----------
    plate : mapping or None
        `plate_values`, with SQM, HFD and STARS behind where they were measured; None: not solved.
    command : str
        The whole command line.
    size : (int, int) or None
        Width and height.
    code : int
        The exit code; some have a text.
    """
    lines = [f"PLTSOLVD={'F' if plate is None else 'T'}"]
    lines += [f"{name}={value!r}" for name, value in (plate or {}).items()]
    lines.append(f"CMDLINE={one_line(command)}")
    if size is not None:
        lines.append(f"DIMENSIONS={size[0]} x {size[1]}")
    if plate is None and code in _ERRORS:
        lines.append(f"ERROR={_ERRORS[code]}")
    if warning:
        lines.append(f"WARNING={one_line(warning)}")
    return "\n".join(lines) + "\n"


def wcs_lines(
    cards: Mapping[str, Value],
    plate: Mapping[str, float],
    *,
    header: Mapping[str, Value],
    command: str,
    note: str,
    warning: str = "",
) -> list[str]:
    """The cards of the `.wcs`, each of 80 characters, END last.

    Parameters
    ----------
    cards : mapping
        TAN or TAN-SIP, rows counted from the bottom.
    plate : mapping
        `plate_values` of them.
    header : mapping
        Of the frame; what says nothing of data or plate is kept, in its plain cards.
    command : str
        The whole command line.
    note : str
        How long it took, and how far off the hint was.
    """
    plain: list[tuple[str, Value, str]] = [("SIMPLE", True, ""), ("BITPIX", 8, ""), ("NAXIS", 0, "")]
    plain += [
        (name, value, "")
        for name, value in header.items()
        if _KEYWORD.match(name) and not _OF_DATA_OR_PLATE.match(name) and _fits_a_card(value)
    ]
    plain += [(name, cards[name], "") for name in ("CTYPE1", "CTYPE2", "CUNIT1", "CUNIT2")]
    plain.append(("EQUINOX", 2000.0, "Equinox of coordinates"))
    plain += [(name, value, _COMMENTS.get(name, "CD matrix")) for name, value in plate.items()]
    plain += [(name, value, "") for name, value in cards.items() if re.match(r"[AB]P?_", name)]
    plain += [(name, cards[name], "pixels") for name in ("IMAGEW", "IMAGEH") if name in cards]
    plain.append(("PLTSOLVD", True, "Astrometric solved by mountnav"))
    remarks = [note, f"cmdline: {command}"]
    if warning:
        text = one_line(warning).replace("'", "")
        plain.append(("WARNING", text[:_TEXT_LENGTH].rstrip(), ""))
        if len(text) > _TEXT_LENGTH:
            remarks.append(f"warning: {text}")
    lines = [_card(*entry) for entry in plain]
    for remark in remarks:
        text = one_line(remark)
        lines += [
            ("COMMENT " + text[at : at + _COMMENT_LENGTH]).ljust(CARD_LENGTH)
            for at in range(0, len(text), _COMMENT_LENGTH)
        ]
    return [*lines, "END".ljust(CARD_LENGTH)]


def _fits_a_card(value: Value) -> bool:
    if isinstance(value, str):
        return value == one_line(value) and len(value) + value.count("'") <= _TEXT_LENGTH
    return isinstance(value, bool) or (abs(value) < math.inf and len(repr(value)) <= _TEXT_LENGTH)


def _card(name: str, value: Value, comment: str) -> str:
    """One card [FITS 4.0, section 4.2]. astropy would make it, and take 0.2 s to import."""
    if isinstance(value, bool):
        text = f"{'T' if value else 'F':>20}"
    elif isinstance(value, str):
        quoted = value.replace("'", "''")
        text = f"'{quoted:<8}'"
    else:
        text = f"{value!r:>20}".upper()
    card = f"{name:<8}= {text}"
    if comment and len(card) + 3 + len(comment) <= CARD_LENGTH:
        card += f" / {comment}"
    return card.ljust(CARD_LENGTH)


def as_text(lines: Sequence[str]) -> bytes:
    """The `.wcs` as ASTAP writes it without `-wcs`: a card on a line."""
    return "".join(line.rstrip() + "\n" for line in lines).encode("ascii")


def as_header(lines: Sequence[str]) -> bytes:
    """The `.wcs` as `-wcs` wants it: a FITS header in blocks of 2880 bytes."""
    whole = "".join(lines)
    return (whole + " " * (-len(whole) % 2880)).encode("ascii")
