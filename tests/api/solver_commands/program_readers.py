"""How other programs read the results of plate solvers, told again from their sources: oracles for tests.

Angles and signs are compared through what each program makes of them: one frame must come out alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Seen:
    """What a program believes of a frame after reading a result."""

    ra_deg: float
    dec_deg: float
    scale_arcsec: float
    angle_deg: float
    flipped: bool | None = None


class NotRead(Exception):
    """The program gives up on the file."""


def nina_ini(text: str) -> Seen | None:
    """N.I.N.A. and ASTAP's `.ini`: a dictionary of lines; None: it tells the user that it wasn't solved."""
    said: dict[str, str] = {}
    for line in text.splitlines():
        if not line.strip():
            continue
        key, equals, value = line.partition("=")
        if not equals:
            raise NotRead(f"a line without an equals sign: {line!r}")
        if key in said:
            raise NotRead(f"{key} comes twice")
        said[key] = value
    if said.get("PLTSOLVD") != "T":
        return None
    number = {key: float(said[key]) for key in ("CRVAL1", "CRVAL2", "CRPIX1", "CRPIX2")}
    cd11, cd12, cd21, cd22 = (float(said[key]) for key in ("CD1_1", "CD1_2", "CD2_1", "CD2_2"))
    sign = -1.0 if cd11 * cd22 - cd12 * cd21 < 0 else 1.0
    turned = math.degrees(math.atan2(sign * cd11, cd21)) - 90.0
    mirrored = sign > 0
    rotation = (-turned if mirrored else turned) % 360.0
    return Seen(
        number["CRVAL1"],
        number["CRVAL2"],
        3600.0 * math.hypot(cd12, cd22),
        (540.0 - rotation) % 360.0,
        not mirrored,
    )


def stellarsolver_ini(text: str) -> Seen | None:
    """StellarSolver: the first line must be PLTSOLVD's, and four values must be numbers."""
    lines = text.split("\n")
    if not lines[0]:
        raise NotRead("the result is empty")
    key, _, value = lines[0].partition("=")
    if key != "PLTSOLVD":
        raise NotRead("the first line is another one")
    if value != "T":
        return None
    said = dict(line.split("=", 1) for line in lines[1:] if "=" in line)
    numbers = [float(said[key]) for key in ("CRVAL1", "CRVAL2", "CDELT1", "CROTA1")]
    determinant = float(said["CD1_1"]) * float(said["CD2_2"]) - float(said["CD1_2"]) * float(said["CD2_1"])
    return Seen(numbers[0], numbers[1], 3600.0 * numbers[2], -numbers[3], determinant > 0)


def ccdciel_wcs(content: bytes) -> tuple[list[str], str]:
    """CCDciel: lines of at most 80 characters become cards; lines that begin with WARNING are shown."""
    cards: list[str] = []
    shown = ""
    for line in content.decode("ascii").split("\n"):
        if not line and cards and cards[-1].strip() == "END":
            break
        if len(line) > 80:
            raise NotRead("a line longer than a card")
        cards.append(line.ljust(80))
        if line[:9] == "WARNING =":
            shown += line[9:79].replace("'", "").strip() + " "
    return cards, shown


def nina_apm(text: str) -> Seen | None:
    """N.I.N.A. and PlateSolve2's `.apm`; more fields than these would be taken for decimal commas."""
    lines = text.splitlines()
    first, second = lines[0].split(","), lines[1].split(",")
    if len(first) == 5 or len(second) > 5:
        raise NotRead("taken for decimal commas")
    if int(first[2]) != 1:
        return None
    flipped = float(second[2]) >= 0
    angle = 360.0 - float(second[1]) + (180.0 if flipped else 0.0)
    place = math.degrees(float(first[0])), math.degrees(float(first[1]))
    return Seen(*place, float(second[0]), angle % 360.0, flipped)


def ccdciel_apm(text: str) -> tuple[float, float, tuple[float, float, float, float]] | None:
    """CCDciel and the `.apm`: valid by the length of its third line; gives place and CD matrix."""
    lines = text.splitlines()
    if len(lines[2]) != 20:
        return None
    first, second = lines[0].split(","), lines[1].split(",")
    if len(first) > 3 or len(second) > 5:
        raise NotRead("taken for decimal commas")
    size, angle = float(second[0]) / 3600.0, float(second[1])
    if "-" not in second[2]:
        across = -size
    else:
        across, angle = size, 180.0 - angle
    cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    matrix = (across * cosine, across * sine, -size * sine, size * cosine)
    return math.degrees(float(first[0])), math.degrees(float(first[1])), matrix


def nina_ps3(text: str) -> Seen | None:
    """N.I.N.A. and PlateSolve3's result."""
    lines = text.splitlines()
    if lines[0].lower() != "true":
        return None
    ra, dec = (math.degrees(float(word)) for word in lines[1].split(",")[:2])
    scale, angle = lines[2].split(",")[:2]
    return Seen(ra, dec, 206264.8 / float(scale), float(angle))


def ccdciel_ps3(text: str) -> tuple[float, float, tuple[float, float, float, float]] | None:
    """CCDciel and PlateSolve3's result: signs of the matrix from the fifth line, turned round."""
    lines = text.splitlines()
    if lines[0] != "True":
        return None
    ra, dec = (math.degrees(float(word)) for word in lines[1].split(","))
    scale, angle = (float(word) for word in lines[2].split(","))
    signs = [-math.copysign(1.0, float(word)) for word in lines[4].split(",")]
    if len(signs) > 8:
        raise NotRead("taken for decimal commas")
    size = math.degrees(1.0) / scale
    cosine = abs(size * math.cos(math.radians(180.0 - angle)))
    sine = abs(size * math.sin(math.radians(180.0 - angle)))
    parts = (signs[0] * cosine, signs[1] * sine, signs[2] * sine, signs[3] * cosine)
    return ra, dec, parts


def nina_asps(text: str) -> Seen | None:
    """N.I.N.A. and All Sky Plate Solver's result."""
    lines = text.splitlines()
    if not lines or lines[0] != "OK" or len(lines) < 8:
        return None
    ra, dec, _width, _height, scale, angle = (float(line) for line in lines[1:7])
    return Seen(ra, dec, scale, (angle - 180.0) % 360.0)
