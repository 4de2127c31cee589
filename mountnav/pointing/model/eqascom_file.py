"""Alignment points of EQASCOM (``ALIGN.ini``), read as observations.

A section ``[alignment_presetN]`` holds a preset: ``NAME``, ``STAR_COUNT``, and ``Star1``, ``Star2``, ...
Each star has seven values, with a semicolon after each: time of the PC; right ascension (hours) and
declination (degrees) of the star; the counts of both motors at which a perfect mount would look there; the
counts at which they stood. Numbers and times are written as the PC's language has them, so that a comma may
stand for the decimal point.

Both counts are 8388608 where the counterweight is down and the declination axis at 0°; the tube looks at
the pole a quarter of a turn further. The counts differ between the sides of the pier, as the angles of the
axes do. The file tells neither the latitude, which the caller must know, nor how many counts a turn has. For
the declination axis that follows from the stars' declinations; that the other axis has the same number is
checked by the times.
"""

from __future__ import annotations

import math
import re

import numpy as np

from mountnav.errors import BadRequest
from mountnav.units import DEG_PER_HOUR

__all__ = ["is_eqascom_alignment", "read_eqascom_alignment"]

_ZERO_COUNT = 0x800000
"""Count of both axes from which EQASCOM counts [EQMOD EQMath.bas]."""
_LEAST_COUNTS, _MOST_COUNTS = 1e5, 1e9
"""Counts of a turn lie between these: real mounts have 1 to 30 millions."""
_COUNT_TOLERANCE = 2.0
"""So many counts may a target's differ from its declination: they are rounded to whole ones."""
_MOST_COUNT = 2.0**31
"""Largest amount of a count: EQASCOM keeps them in 32 bits."""
_CLOCK_TOLERANCE_DEG = 3.0
"""So far may sidereal times disagree, by counts and by the PC's clock, degrees: a degree is a day between two
points. Gears that differ disagree by ten times that. Doubled, gears that differ by a tenth pass."""
_SIDEREAL = 1.00273791
"""Sidereal hours in an hour."""
_MOST_STARS = 1000
"""EQASCOM keeps no more [EQASCOM manual]."""
_SECTION = re.compile(r"\s*\[alignment_preset(\d{1,4})\]\s*", re.IGNORECASE)
_BEGINS = re.compile(r"\[alignment_preset\d", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?\d{1,20}(?:[.,]\d{0,20})?(?:[eE][+-]?\d{1,3})?", re.ASCII)
_TIME = re.compile(r"(\d{1,2})[:.](\d\d)[:.](\d\d)(?:\s*([AP])\.?M\b)?", re.ASCII | re.IGNORECASE)
_DAY_H = 24.0


def is_eqascom_alignment(text: str) -> bool:
    """Whether a file's text has a section of alignment points."""
    return _BEGINS.search(text) is not None


def read_eqascom_alignment(text: str, latitude_deg: float, *, name: str = "file") -> list[list[float]]:
    """Read the points of the one preset that has some.

    Parameters
    ----------
    text : str
    latitude_deg : float
        Of the mount: south of the equator its axes count the other way round.
    name : str
        Stands in the messages.

    Returns
    -------
    list of [float, float, float, float]
        Mechanical hour angle and declination, where the star was and where the axes stood, degrees.

    Raises
    ------
    BadRequest
        A point makes no sense, several presets have points, or the counts don't fit the declinations.
    """
    stars = _stars(text, name)
    times_h, ra_h, dec_deg, *counts = np.array(stars).T
    target_ra, target_dec, read_ra, read_dec = (axis - _ZERO_COUNT for axis in counts)
    south = latitude_deg < 0.0
    turn = _counts_of_a_turn(target_dec, dec_deg, south, name)

    def mechanical(ra_count: np.ndarray, dec_count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # at count 0 the counterweight is down: the hour angle of a tube that looks east or west
        way = -1.0 if south else 1.0
        lon = way * 360.0 * ra_count / turn + 90.0
        lat = 360.0 * dec_count / turn
        return lon % 360.0, -lat if south else 180.0 - lat

    lon, lat = mechanical(target_ra, target_dec)
    beyond = np.cos(np.radians(lat)) < 0.0
    sidereal_deg = DEG_PER_HOUR * (ra_h - _SIDEREAL * times_h) + lon + 180.0 * beyond
    # the PC's zone and the longitude are one constant, whatever they are
    mean = np.exp(1j * np.radians(sidereal_deg)).mean()
    apart_deg = np.abs(np.angle(np.exp(1j * np.radians(sidereal_deg)) * np.conj(mean), deg=True))
    if abs(mean) == 0.0 or not (apart_deg < _CLOCK_TOLERANCE_DEG).all():
        raise BadRequest(
            f"{name}: the hour angles by the counts don't fit the times of the points",
            advice="points of one night are read, of a mount whose axes have the same number of counts",
        )
    read_lon, read_lat = mechanical(read_ra, read_dec)
    points = zip(lon, lat, read_lon, read_lat, strict=True)
    return [[float(angle_deg) for angle_deg in point] for point in points]


def _stars(text: str, name: str) -> list[list[float]]:
    """Seven numbers of each point: time of day in hours, then as they stand there."""
    presets: dict[str, dict[str, str]] = {}
    values: dict[str, str] = {}
    for line in text.splitlines():
        section = _SECTION.fullmatch(line)
        if section is not None:
            values = presets.setdefault(section[1], {})
        elif line.lstrip().startswith("["):
            values = {}
        elif "=" in line:
            key, _, value = line.partition("=")
            values[key.strip().lower()] = value.strip()
    held = {
        number: one for number, one in presets.items() if one.get("star_count", "").strip("0 ") not in ("",)
    }
    if not held:
        raise BadRequest(f"{name} holds no observations")
    if len(held) > 1:
        named = ", ".join(f"{number} ({one.get('name', '')[:40]})" for number, one in held.items())
        raise BadRequest(
            f"{name} holds {len(held)} presets with points: {named}",
            advice="leave the section of one in a copy of the file",
        )
    ((number, preset),) = held.items()
    told = preset["star_count"]
    if not re.fullmatch(r"\d{1,4}", told, re.ASCII) or int(told) > _MOST_STARS:
        raise BadRequest(f"{name}, preset {number}: {told!r} points")
    return [
        _star(preset.get(f"star{star}", ""), f"{name}, preset {number}, point {star}")
        for star in range(1, int(told) + 1)
    ]


def _star(text: str, about: str) -> list[float]:
    parts = [part.strip() for part in text.split(";")]
    if len(parts) < 7 or any(parts[7:]):
        raise BadRequest(f"{about}: {text[:80]!r} is not seven values, each followed by a semicolon")
    most = (_DAY_H, 90.0, *([_MOST_COUNT] * 4))
    return [
        _time_h(parts[0], about),
        *(_number(part, limit, about) for part, limit in zip(parts[1:7], most, strict=True)),
    ]


def _time_h(text: str, about: str) -> float:
    """The time of day in a time of any language; midnight may be left out, as Visual Basic does."""
    found = list(_TIME.finditer(text))
    if not found and re.fullmatch(r"[\d./ -]{6,12}", text, re.ASCII):
        return 0.0
    if not found:
        raise BadRequest(f"{about}: {text[:40]!r} is no time")
    hour, minute, second, half = found[-1].groups()
    hours = int(hour) % 12 + (12 if half.upper() == "P" else 0) if half else int(hour)
    if hours >= _DAY_H or int(minute) > 59 or int(second) > 59:
        raise BadRequest(f"{about}: {text[:40]!r} is no time")
    return hours + int(minute) / 60.0 + int(second) / 3600.0


def _number(text: str, most: float, about: str) -> float:
    value = float(text.replace(",", ".")) if _NUMBER.fullmatch(text) else math.nan
    if not abs(value) <= most:
        raise BadRequest(f"{about}: {text[:40]!r} is not a number within ±{most:g}")
    return value


def _counts_of_a_turn(counts: np.ndarray, dec_deg: np.ndarray, south: bool, name: str) -> float:
    """How many counts a turn of the declination axis has: the one number with which all targets agree."""
    one_side = -dec_deg if south else dec_deg
    other_side = 180.0 - one_side
    clearest = int(np.argmax(np.abs(counts)))
    agree = set()
    for angle_deg in (one_side[clearest], other_side[clearest]):
        turn = round(360.0 * counts[clearest] / angle_deg) if angle_deg else 0
        if not _LEAST_COUNTS < turn < _MOST_COUNTS:
            continue
        off = np.minimum(np.abs(counts - turn * one_side / 360.0), np.abs(counts - turn * other_side / 360.0))
        if (off < _COUNT_TOLERANCE).all():
            agree.add(turn)
    if len(agree) != 1:
        raise BadRequest(
            f"{name}: the counts of the declination axis "
            + ("fit" if agree else "don't fit")
            + (" more than one number of counts a turn" if agree else " the declinations of the points"),
            advice="points of three declinations and more are needed, and a latitude below 0 on the "
            "southern half of the Earth",
        )
    return float(agree.pop())
