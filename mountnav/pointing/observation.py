"""Pointing observations: where the tube truly looked and what the mount believed; and their JSON lines.

The file has one observation a line, absolute values, units in the names. A line, here broken up::

    {"utc": "2026-11-21T22:00:00.000000Z",
     "seen": {"ra_deg": 83.6331, "dec_deg": 22.0145}, "sigma_arcsec": 0.4,
     "reading": {"epoch": "apparent", "ra_deg": 84.0412, "dec_deg": 22.0301},
     "side": "east", "segment_id": "s1",
     "air": {"pressure_hpa": 930.0, "temperature_c": 5.0, "relative_humidity": 0.7, "wavelength_um": 0.6},
     "rotation_deg": 12.3, "scale_arcsec_px": 1.21, "parity": 1,
     "model_id": null, "look_id": "l17", "from_side": [1, -1]}

`utc`, `seen` and `reading` are required; the rest has the defaults of `PointingObservation`. A reading of
date refers to the observation's time unless it has a ``utc`` of its own. Empty lines and lines that begin
with
``#`` are skipped.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from io import TextIOWrapper
from pathlib import Path

from mountnav.devices import PierSide
from mountnav.errors import BadRequest
from mountnav.files import open_buffered
from mountnav.parsing import json_of
from mountnav.sky.coordinates import Air, Apparent, Icrs


@dataclass(frozen=True, slots=True)
class PointingObservation:
    """A solved frame against the mount's reading, as models, doctor and drift report take it.

    Attributes
    ----------
    utc : datetime
        Mid-exposure.
    seen : Icrs
        Solved place.
    sigma_arcsec : float
        Its one-sigma error per coordinate, the mount's resolution and repeatability not included.
    reading : Apparent or Icrs
        What the mount said, moved to mid-exposure, in its own kind of coordinates.
    side : PierSide
        As the mount says, `UNKNOWN` if it doesn't.
    segment_id : str
        Readings of one segment share their zero points.
    rotation_deg, scale_arcsec_px : float or None
        Of the frame.
    parity : int or None
        +1 as the sky is seen, -1 mirrored.
    model_id : str or None
        Pointing model that was in force (applied before the slew; the reading is raw all the same).
    from_side : (int, int)
        Sense (+1, -1, 0 unknown) of the last motion of the hour angle and the declination axis: backlash.
    """

    utc: datetime
    seen: Icrs
    sigma_arcsec: float
    reading: Apparent | Icrs
    side: PierSide = PierSide.UNKNOWN
    segment_id: str = ""
    air: Air = field(default_factory=Air)
    rotation_deg: float | None = None
    scale_arcsec_px: float | None = None
    parity: int | None = None
    model_id: str | None = None
    look_id: str = ""
    from_side: tuple[int, int] = (0, 0)


_AIR_KEYS = ("pressure_hpa", "temperature_c", "relative_humidity", "wavelength_um")
_KEYS = frozenset(one.name for one in fields(PointingObservation))


def observation_record(observation: PointingObservation) -> dict[str, object]:
    """Make the JSON object of one observation; plain values only."""
    reading = observation.reading
    place: dict[str, object] = {"epoch": "apparent" if isinstance(reading, Apparent) else "icrs"}
    place |= {"ra_deg": reading.ra_deg, "dec_deg": reading.dec_deg}
    if isinstance(reading, Apparent) and reading.utc != observation.utc:
        place["utc"] = _told(reading.utc)
    return {
        "utc": _told(observation.utc),
        "seen": {"ra_deg": observation.seen.ra_deg, "dec_deg": observation.seen.dec_deg},
        "sigma_arcsec": observation.sigma_arcsec,
        "reading": place,
        "side": str(observation.side),
        "segment_id": observation.segment_id,
        "air": {key: getattr(observation.air, key) for key in _AIR_KEYS},
        "rotation_deg": observation.rotation_deg,
        "scale_arcsec_px": observation.scale_arcsec_px,
        "parity": observation.parity,
        "model_id": observation.model_id,
        "look_id": observation.look_id,
        "from_side": list(observation.from_side),
    }


def observation_of(record: Mapping[str, object]) -> PointingObservation:
    """Inverse of `observation_record`.

    Raises
    ------
    BadRequest
        Something is missing, unknown, no number, out of range or without a time zone.
    """
    unknown = sorted(set(record) - _KEYS)
    if unknown:
        raise BadRequest(f"unknown key {', '.join(unknown)}", advice=f"known are {', '.join(sorted(_KEYS))}")
    utc = _instant(record.get("utc"), "utc")
    seen, reading = _mapping(record.get("seen"), "seen"), _mapping(record.get("reading"), "reading")
    ra_deg, dec_deg = _place(reading, "reading")
    place: Apparent | Icrs
    match reading.get("epoch"):
        case "apparent":
            own = reading.get("utc")
            place = Apparent(ra_deg, dec_deg, utc if own is None else _instant(own, "reading.utc"))
        case "icrs":
            place = Icrs(ra_deg, dec_deg)
        case other:
            raise BadRequest(f"reading.epoch = {other!r}", advice="apparent (JNow) or icrs (J2000)")
    sigma_arcsec = _number(record.get("sigma_arcsec", 0.0), "sigma_arcsec")
    if sigma_arcsec < 0.0:
        raise BadRequest(f"sigma_arcsec = {sigma_arcsec} is negative")
    air = _mapping(record.get("air") or {}, "air")
    if set(air) - set(_AIR_KEYS):
        raise BadRequest(f"unknown key in air: {sorted(air)}", advice=f"known are {', '.join(_AIR_KEYS)}")
    try:
        side = PierSide(str(record.get("side") or "unknown"))
    except ValueError as cause:
        raise BadRequest(f"side = {record.get('side')!r}", advice="east, west or unknown") from cause
    return PointingObservation(
        utc=utc,
        seen=Icrs(*_place(seen, "seen")),
        sigma_arcsec=sigma_arcsec,
        reading=place,
        side=side,
        segment_id=str(record.get("segment_id") or ""),
        air=Air(**{key: _number(value, f"air.{key}") for key, value in air.items()}),
        rotation_deg=_optional(record, "rotation_deg"),
        scale_arcsec_px=_optional(record, "scale_arcsec_px"),
        parity=_parity(record.get("parity")),
        model_id=None if record.get("model_id") is None else str(record["model_id"]),
        look_id=str(record.get("look_id") or ""),
        from_side=_senses(record.get("from_side", (0, 0))),
    )


def write_observations(path: Path, observations: Iterable[PointingObservation]) -> int:
    """Write a file of observations again; the number of lines comes back."""
    lines = [json.dumps(observation_record(one), allow_nan=False) for one in observations]
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    return len(lines)


def read_observations(path: Path) -> list[PointingObservation]:
    """Read a file of observations, in order of time.

    Raises
    ------
    BadRequest
        The file can't be read, or a line of it is no observation; tells which.
    """
    try:
        with TextIOWrapper(open_buffered(path), encoding="utf-8-sig") as lines:
            return sorted(_lines(lines, path.name), key=lambda one: one.utc)
    except (OSError, UnicodeDecodeError) as cause:
        raise BadRequest(f"can't read the observations in {path.name}: {cause}") from cause


def _lines(lines: Iterable[str], name: str) -> Iterator[PointingObservation]:
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        try:
            record = json_of(text)
        except json.JSONDecodeError as cause:
            raise BadRequest(f"{name}, line {number}: no JSON: {cause.msg}") from cause
        try:
            yield observation_of(_mapping(record, "the line"))
        except BadRequest as cause:
            raise BadRequest(f"{name}, line {number}: {cause.what}", advice=cause.advice) from cause


def _told(utc: datetime) -> str:
    return utc.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def _mapping(value: object, name: str) -> Mapping[str, object]:
    if not isinstance(value, Mapping):
        raise BadRequest(f"{name} is missing or no object")
    return value


def _number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise BadRequest(f"{name} = {value!r} is not a number")
    return float(value)


def _optional(record: Mapping[str, object], key: str) -> float | None:
    value = record.get(key)
    return None if value is None else _number(value, key)


def _place(record: Mapping[str, object], name: str) -> tuple[float, float]:
    ra_deg = _number(record.get("ra_deg"), f"{name}.ra_deg")
    dec_deg = _number(record.get("dec_deg"), f"{name}.dec_deg")
    if not (0.0 <= ra_deg <= 360.0 and -90.0 <= dec_deg <= 90.0):
        raise BadRequest(f"{name} = {ra_deg}, {dec_deg} is no place", advice="deg: 0 to 360, -90 to 90")
    return ra_deg, dec_deg


def _instant(value: object, name: str) -> datetime:
    try:
        utc = datetime.fromisoformat(str(value))
    except ValueError as cause:
        raise BadRequest(f"{name} = {value!r} is not an instant", advice="2026-11-21T22:00:00Z") from cause
    if utc.utcoffset() is None:
        raise BadRequest(f"{name} = {value!r} doesn't say its time zone", advice="give UTC: ...Z")
    return utc.astimezone(UTC)


def _parity(value: object) -> int | None:
    if value is None:
        return None
    if value not in (1, -1) or isinstance(value, bool):
        raise BadRequest(f"parity = {value!r}", advice="1 not mirrored, -1 mirrored")
    return 1 if value == 1 else -1


def _senses(value: object) -> tuple[int, int]:
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(one in (-1, 0, 1) for one in value):
        raise BadRequest(f"from_side = {value!r}", advice="two of -1, 0, 1")
    return int(value[0]), int(value[1])
