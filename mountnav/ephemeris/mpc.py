"""Orbital elements as the Minor Planet Center publishes them.

One-line elements of minor planets (MPCORB.DAT and its parts), of comets (CometEls.txt), and the JSON forms of
both (mpcorb_extended.json, cometels.json) and of the MPC's own orbits (mpc_orb.json). A field that is no
number, or a line that is cut off, is refused with its place.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from datetime import date
from typing import Any, Final

from mountnav.ephemeris.elements import OrbitElements, by_mean_anomaly
from mountnav.errors import BadRequest
from mountnav.units import MJD_ZERO_JD

_ORDINAL_ZERO_JD: Final = 1721424.5
"""Julian date of Python's day 0."""
_DIGITS: Final = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz"
"""The MPC's digits of packed numbers, 62 of them."""
_CENTURIES: Final = {"I": 18, "J": 19, "K": 20, "L": 21}
"""First letter of packed years."""
MOST_NAME: Final = 80
"""Letters of a name that are kept. Doubled, messages are longer."""
SHORTEST_ORBIT_LINE: Final = 103
"""Letters of a line of MPCORB that its elements take; what follows may be cut off."""
SHORTEST_COMET_LINE: Final = 79
"""The same of a line of CometEls."""


def _float(text: str, what: str, at: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or not re.fullmatch(r"\s*[+-]?[0-9]*\.?[0-9]*\s*", text):
        raise BadRequest(f"{at}: {text.strip()[:20]!r} is not a number of {what}")
    return value


def julian_date(year: int, month: int, day: float) -> float:
    """Julian date of a calendar day with its fraction. Raises ValueError."""
    whole = math.floor(day)
    return date(year, month, 1).toordinal() + whole - 1 + _ORDINAL_ZERO_JD + (day - whole)


def packed_epoch_jd(text: str) -> float:
    """Julian date of a packed day, such as K239D: 2023-09-13. Raises BadRequest."""
    match = re.fullmatch(r"([IJKL])([0-9]{2})([1-9A-C])([1-9A-V])", text)
    if match is None:
        raise BadRequest(f"{text!r} is not a packed day such as K239D")
    year = _CENTURIES[match[1]] * 100 + int(match[2])
    month, day = _DIGITS.index(match[3]), _DIGITS.index(match[4])
    try:
        return date(year, month, day).toordinal() + _ORDINAL_ZERO_JD
    except ValueError as wrong:
        raise BadRequest(f"{text!r} is a packed day that no month has") from wrong


def unpacked(text: str) -> str:
    """A packed designation as people write it: ``00433`` is 433, ``K10A03B`` is 2010 AB3.

    Raises
    ------
    BadRequest
        It is none.
    """
    text = text.strip()
    if re.fullmatch(r"[0-9A-Za-z][0-9]{4}", text):
        return str(_DIGITS.index(text[0]) * 10_000 + int(text[1:]))
    if re.fullmatch(r"~[0-9A-Za-z]{4}", text):
        number = 0
        for one in text[1:]:
            number = number * 62 + _DIGITS.index(one)
        return str(number + 620_000)
    if re.fullmatch(r"(PL|T[123])S[0-9]{4}", text):
        return f"{text[3:]} {text[0]}-{text[1]}"
    if re.fullmatch(r"[IJKL][0-9]{2}[A-HJ-Y][0-9A-Za-z][0-9][A-HJ-Za-z]", text):
        return _provisional(text)
    if extended := re.fullmatch(r"_([0-9A-Z])([A-HJ-Y])([0-9A-Za-z]{4})", text):
        # from the 15,500th of a half-month on
        number = 0
        for one in extended[3]:
            number = number * 62 + _DIGITS.index(one)
        number += 15_500
        letters = "ABCDEFGHJKLMNOPQRSTUVWXYZ"
        year = 2000 + _DIGITS.index(extended[1])
        return f"{year} {extended[2]}{letters[number % 25]}{number // 25}"
    raise BadRequest(f"{text!r} is not a packed designation")


def _provisional(text: str) -> str:
    year = _CENTURIES[text[0]] * 100 + int(text[1:3])
    cycle = _DIGITS.index(text[4]) * 10 + int(text[5])
    return f"{year} {text[3]}{text[6]}{cycle or ''}"


def _uncertainty(text: str) -> int | None:
    """U as a digit; letters say that there is none that can be trusted."""
    text = text.strip()
    return int(text) if re.fullmatch(r"[0-9]", text) else None


def read_orbit_line(line: str, at: str = "the line") -> OrbitElements:
    """A line of MPCORB.DAT: a minor planet's elements by mean anomaly.

    Raises
    ------
    BadRequest
        Cut off, or a field that is none.
    """
    if len(line) < SHORTEST_ORBIT_LINE:
        raise BadRequest(
            f"{at} has {len(line)} letters; elements of the MPC have {SHORTEST_ORBIT_LINE} at least"
        )
    try:
        designation = unpacked(line[0:7])
    except BadRequest as wrong:
        raise BadRequest(f"{at}: {wrong.what}") from wrong
    try:
        epoch_jd = packed_epoch_jd(line[20:25])
    except BadRequest as wrong:
        raise BadRequest(f"{at}: {wrong.what}") from wrong
    e = _float(line[70:79], "the eccentricity", at)
    a = _float(line[92:103], "the semi-major axis", at)
    anomaly = _float(line[26:35], "the mean anomaly", at)
    readable = line[166:194].strip()
    name, aliases = _named(readable, designation)
    try:
        q, tp = by_mean_anomaly(a, e, anomaly, epoch_jd)
    except BadRequest as wrong:
        raise BadRequest(f"{at}: {wrong.what}") from wrong
    return OrbitElements(
        name=name,
        aliases=aliases,
        epoch_jd=epoch_jd,
        q_au=q,
        eccentricity=e,
        inclination_deg=_float(line[59:68], "the inclination", at),
        node_deg=_float(line[48:57], "the node", at),
        peri_deg=_float(line[37:46], "the argument of perihelion", at),
        perihelion_jd=tp,
        uncertainty=_uncertainty(line[105:106]),
    )


def _named(readable: str, designation: str) -> tuple[str, tuple[str, ...]]:
    """Name and aliases: of "(433) Eros" the name "433 Eros", the aliases "433", "Eros", "(433)"."""
    if numbered := re.fullmatch(r"\(\s*([0-9]+)\)\s*(.*)", readable):
        number, name = numbered[1], numbered[2].strip()[:MOST_NAME]
        return (f"{number} {name}".strip(), tuple(one for one in (number, name) if one))
    if readable:
        return readable[:MOST_NAME], (designation,) if designation != readable else ()
    return designation, ()


def read_comet_line(line: str, at: str = "the line") -> OrbitElements:
    """A line of CometEls.txt: a comet's elements by perihelion.

    Raises
    ------
    BadRequest
        Cut off, or a field that is none.
    """
    if len(line) < SHORTEST_COMET_LINE:
        raise BadRequest(
            f"{at} has {len(line)} letters; a comet's elements have {SHORTEST_COMET_LINE} at least"
        )
    name = line[102:158].strip()[:MOST_NAME]
    number, kind, provisional = line[0:4].strip(), line[4:5].strip(), line[5:12].strip()
    perihelion_jd = _comet_day(line[14:18], line[19:21], line[22:29], f"{at}: perihelion")
    epoch = line[81:89]
    # no epoch: elements without perturbations, good about the perihelion
    epoch_jd = (
        _comet_day(epoch[0:4], epoch[4:6], epoch[6:8], f"{at}: epoch") if epoch.strip() else perihelion_jd
    )
    aliases = []
    if number and kind:
        aliases.append(f"{number.lstrip('0')}{kind}")
    if provisional and kind:
        try:
            aliases.append(f"{kind}/{_comet_designation(provisional)}")
        except BadRequest:
            aliases.append(provisional)
    # C/2023 A3 (Tsuchinshan-ATLAS) and 1P/Halley
    for form in (r"([0-9]+[PDCXAI])/(.+)", r"([CPDXAI]/[^(]+?)\s*\((.+)\)"):
        if found := re.fullmatch(form, name):
            aliases.append(found[1])
            if form.startswith("([0-9]"):
                aliases.append(found[2])
    return OrbitElements(
        name=name or (aliases[0] if aliases else "a comet"),
        aliases=tuple(dict.fromkeys(one for one in aliases if one and one != name)),
        epoch_jd=epoch_jd,
        q_au=_float(line[30:39], "the perihelion distance", at),
        eccentricity=_float(line[41:49], "the eccentricity", at),
        inclination_deg=_float(line[71:79], "the inclination", at),
        node_deg=_float(line[61:69], "the node", at),
        peri_deg=_float(line[51:59], "the argument of perihelion", at),
        perihelion_jd=perihelion_jd,
        comet=True,
    )


def _comet_designation(text: str) -> str:
    """A comet's packed provisional designation: ``K23A030`` is 2023 A3. Raises BadRequest."""
    match = re.fullmatch(r"([IJKL])([0-9]{2})([A-HJ-Y])([0-9A-Za-z])([0-9])([0-9A-Za-z])", text)
    if match is None:
        raise BadRequest(f"{text!r} is not a packed designation of a comet")
    year = _CENTURIES[match[1]] * 100 + int(match[2])
    cycle = _DIGITS.index(match[4]) * 10 + int(match[5])
    if match[6].isupper():  # of a body that was first taken for a minor planet
        return f"{year} {match[3]}{match[6]}{cycle or ''}"
    fragment = "" if match[6] == "0" else f"-{match[6].upper()}"
    return f"{year} {match[3]}{cycle}{fragment}"


def _comet_day(year: str, month: str, day: str, at: str) -> float:
    try:
        number = _float(day, "the day", at)
        if not 1.0 <= number < 32.0:
            raise ValueError
        return julian_date(int(year), int(month), number)
    except ValueError as wrong:
        raise BadRequest(f"{at} {year}-{month}-{day} is not a day") from wrong


def mpc_lines(lines: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Number and text of each line that holds elements: no empty line, no remark, no header of MPCORB.DAT."""
    # MPCORB begins with pages of text that end in a line of dashes
    in_header = False
    for number, raw in enumerate(lines, 1):
        line = raw.rstrip("\r\n")
        if number == 1 and line.startswith("MINOR PLANET CENTER ORBIT DATABASE"):
            in_header = True
        if in_header:
            in_header = not line.startswith("-----")
        elif line.strip() and not line.startswith("#"):
            yield number, line


def read_mpc_line(line: str, at: str) -> OrbitElements:
    """Elements of a minor planet or of a comet; `at` is where the line stands. Raises `BadRequest`."""
    return read_comet_line(line, at) if looks_like_comet(line) else read_orbit_line(line, at)


def read_mpc_lines(lines: Iterable[str]) -> Iterator[OrbitElements]:
    """Elements of many lines, minor planets and comets mixed. Raises `BadRequest`; it tells the line."""
    return (read_mpc_line(line, f"line {number}") for number, line in mpc_lines(lines))


def looks_like_comet(line: str) -> bool:
    """Whether a line has a comet's perihelion where CometEls has it."""
    return re.match(r".{4}[CPDXAI].{8} [ 0-9-]{4} [ 0-9]{2} [ 0-9]{2}\.[0-9]{1,4} ", line) is not None


# -- JSON ----------------------------------------------------------------------------------------------------


def read_mpc_json(record: Mapping[str, Any], at: str = "the record") -> OrbitElements:
    """A record of mpcorb_extended.json or cometels.json, or an orbit of the MPC's own form (mpc_orb.json).

    Raises
    ------
    BadRequest
        A field that is missing or none.
    """
    if "COM" in record or "CAR" in record:
        return _mpc_orb(record, at)
    if "Perihelion_dist" in record or "Year_of_perihelion" in record:
        return _comet_record(record, at)
    if "Epoch" in record and "M" in record:
        return _orbit_record(record, at)
    raise BadRequest(
        f"{at} is not a record of the MPC: it has {', '.join(map(str, list(record)[:8]))}",
        advice="mpcorb_extended.json, cometels.json and mpc_orb.json are read",
    )


def _number(record: Mapping[str, Any], key: str, at: str) -> float:
    value = record.get(key)
    if isinstance(value, str):
        return _float(value, key, at)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise BadRequest(f"{at}: {key} is {value!r}, no number")
    return float(value)


def _words(record: Mapping[str, Any], key: str) -> str:
    value = record.get(key)
    return value.strip()[:MOST_NAME] if isinstance(value, str) else ""


def _orbit_record(record: Mapping[str, Any], at: str) -> OrbitElements:
    epoch_jd = _number(record, "Epoch", at)
    e = _number(record, "e", at)
    q, tp = by_mean_anomaly(_number(record, "a", at), e, _number(record, "M", at), epoch_jd)
    number = _words(record, "Number").strip("()")
    proper, designation = _words(record, "Name"), _words(record, "Principal_desig")
    name = f"{number} {proper or designation}".strip() if number else proper or designation
    others = record.get("Other_desigs")
    aliases = [number, proper, designation, *(others if isinstance(others, list) else [])][:24]
    u = record.get("U")
    return OrbitElements(
        name=name or "a minor planet",
        aliases=tuple(
            dict.fromkeys(one[:MOST_NAME] for one in aliases if isinstance(one, str) and one and one != name)
        ),
        epoch_jd=epoch_jd,
        q_au=q,
        eccentricity=e,
        inclination_deg=_number(record, "i", at),
        node_deg=_number(record, "Node", at),
        peri_deg=_number(record, "Peri", at),
        perihelion_jd=tp,
        uncertainty=_uncertainty(str(u)) if isinstance(u, str | int) and not isinstance(u, bool) else None,
    )


def _comet_record(record: Mapping[str, Any], at: str) -> OrbitElements:
    def day(prefix: str, suffix: str) -> float:
        year, month = (_number(record, f"{part}{suffix}", at) for part in (f"{prefix}Year", f"{prefix}Month"))
        number = _number(record, f"{prefix}Day{suffix}", at)
        if not (year.is_integer() and month.is_integer() and 1.0 <= number < 32.0):
            raise BadRequest(f"{at}: {year:g}-{month:g}-{number:g} is not a day")
        try:
            return julian_date(int(year), int(month), number)
        except (ValueError, OverflowError) as wrong:
            raise BadRequest(f"{at}: {year:g}-{month:g}-{number:g} is not a day") from wrong

    perihelion_jd = day("", "_of_perihelion")
    has_epoch = record.get("Epoch_year") not in (None, "")
    if has_epoch:
        year, month, number = (_number(record, f"Epoch_{one}", at) for one in ("year", "month", "day"))
        try:
            epoch_jd = julian_date(int(year), int(month), number)
        except (ValueError, OverflowError) as wrong:
            raise BadRequest(f"{at}: {year:g}-{month:g}-{number:g} is not a day") from wrong
    else:
        epoch_jd = perihelion_jd
    name = _words(record, "Designation_and_name")
    aliases = []
    if found := re.fullmatch(r"([0-9]+[PDCXAI])/(.+)|([CPDXAI]/[^(]+?)\s*\((?:.+)\)", name):
        aliases = [one for one in found.groups() if one]
    return OrbitElements(
        name=name or "a comet",
        aliases=tuple(aliases),
        epoch_jd=epoch_jd,
        q_au=_number(record, "Perihelion_dist", at),
        eccentricity=_number(record, "e", at),
        inclination_deg=_number(record, "i", at),
        node_deg=_number(record, "Node", at),
        peri_deg=_number(record, "Peri", at),
        perihelion_jd=perihelion_jd,
        comet=True,
    )


def _mpc_orb(record: Mapping[str, Any], at: str) -> OrbitElements:
    """mpc_orb.json: cometary elements with their names beside their values."""
    com = record.get("COM")
    epoch = record.get("epoch_data")
    if not isinstance(com, Mapping) or not isinstance(epoch, Mapping):
        raise BadRequest(f"{at}: an orbit of the MPC has COM and epoch_data")
    names, values = com.get("coefficient_names"), com.get("coefficient_values")
    if not isinstance(names, list) or not isinstance(values, list) or len(names) > len(values):
        raise BadRequest(f"{at}: COM has no coefficient_names with as many coefficient_values")
    told = {str(name): value for name, value in zip(names, values, strict=False)}
    if epoch.get("timesystem") not in ("TDT", "TT", "TDB"):
        raise BadRequest(f"{at}: the epoch is {epoch.get('timesystem')!r}, not TT or TDB")
    epoch_jd = _number(epoch, "epoch", at) + MJD_ZERO_JD
    designations = record.get("designation_data")
    titles = designations if isinstance(designations, Mapping) else {}
    name = _words(titles, "unpacked_primary_provisional_designation") or _words(titles, "name")
    number = _words(titles, "permid")
    proper = _words(titles, "iau_name")
    full = f"{number} {proper or name}".strip() if number else proper or name
    return OrbitElements(
        name=full or "a minor planet",
        aliases=tuple(dict.fromkeys(one for one in (number, proper, name) if one and one != full)),
        epoch_jd=epoch_jd,
        q_au=_number(told, "q", at),
        eccentricity=_number(told, "e", at),
        inclination_deg=_number(told, "i", at),
        node_deg=_number(told, "node", at),
        peri_deg=_number(told, "argperi", at),
        perihelion_jd=_number(told, "peri_time", at) + MJD_ZERO_JD,
        uncertainty=_quality(record),
    )


def _quality(record: Mapping[str, Any]) -> int | None:
    fit = record.get("orbit_fit_statistics")
    u = fit.get("U_param") if isinstance(fit, Mapping) else None
    return _uncertainty(str(u)) if isinstance(u, str | int) and not isinstance(u, bool) else None
