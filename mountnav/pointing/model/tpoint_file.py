"""Files of other pointing software: observations (PMFIT, TPOINT), coefficients (TPOINT's ``.mod``).

PMFIT: caption; ``E`` or ``A``; latitude; lines of where the telescope looked and where its axes stood, in
degrees: hour angle and declination, or azimuth and elevation.

TPOINT observations, of equatorial mounts: caption; options, each with a colon (``:EQUAT``, ``:NODA``);
latitude as degrees, minutes, seconds; lines of the star's right ascension and declination, the telescope's,
and the sidereal time; ``END``. Both places are taken to be of one kind, with no refraction between them: that
is how programs that write such files for a mount on the sky of date do it.

TPOINT coefficients: caption; a line of method, number of observations, sky RMS and two refraction constants;
a line for each term of name, coefficient and sigma in arcseconds, ``=`` before fixed ones; ``END``.

EQMod's alignment points, of INDI's driver and of EQASCOM, have files of their own here.

The two declinations, and elevations, are mechanical: beyond ±90° where the tube looks through the pole.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from mountnav.errors import BadRequest
from mountnav.files import MOST_RECORD_BYTES, read_bytes
from mountnav.pointing.model.eqascom_file import is_eqascom_alignment, read_eqascom_alignment
from mountnav.pointing.model.eqmod_file import is_eqmod_alignment, read_eqmod_alignment
from mountnav.pointing.model.mechanical import Mechanical
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.model.rigorous import direction, wrapped
from mountnav.pointing.model.terms import ALTAZ, EQUATORIAL, ZERO_POINTS, Array, Kind, term
from mountnav.units import DEG_PER_HOUR

_NUMBER = re.compile(r"[+-]?(?:\d+\.\d*|\.\d+|\d+)")
_COEFFICIENT = re.compile(r"\s*([=&]*)\s*([A-Z][A-Z0-9]*)\s+(\S+)(?:\s+(\S+))?\s*")
_MOST_ANGLE_DEG = 1000.0
"""Largest angle, in its amount: readings beyond the pole and hour angles over a day stay below it."""
_SIGMA_UNTOLD_ARCSEC = 1.0
"""Of observations in these files, which tell none: all count the same."""


def _observations(kind: Kind, latitude_deg: float, rows: Array) -> Mechanical:
    """Rows of seen and read angles, mechanical, deg."""
    seen_lon, seen_lat, read_lon, read_lat = np.radians(rows).T
    n = len(rows)
    return Mechanical(
        kind=kind,
        site_latitude_rad=math.radians(latitude_deg),
        seen=direction(seen_lon, seen_lat),
        beyond=np.abs(wrapped(seen_lat)) > np.pi / 2.0,
        read_lon_rad=wrapped(read_lon),
        read_lat_rad=read_lat,
        sigma_arcsec=np.full(n, _SIGMA_UNTOLD_ARCSEC),
        segment=np.zeros(n, dtype=np.int64),
        segment_ids=("file",),
    )


def read_observations_file(
    path: Path, *, name: str | None = None, latitude_deg: float | None = None
) -> Mechanical:
    """Read a file of observations, as `read_observations_text` does.

    Parameters
    ----------
    path : Path
    name : str, optional
        Stands in the messages; the path if left out.
    latitude_deg : float, optional

    Raises
    ------
    OSError
    UnicodeDecodeError
        It is no text.
    BadRequest
        It is none of them; with the line.
    """
    content = read_bytes(path, MOST_RECORD_BYTES)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        # EQASCOM writes in the PC's own letters, which stand in the names of presets alone
        text = content.decode("latin-1")
        if not is_eqascom_alignment(text):
            raise
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    return read_observations_text(text, name=str(path) if name is None else name, latitude_deg=latitude_deg)


def read_observations_text(text: str, *, name: str = "file", latitude_deg: float | None = None) -> Mechanical:
    """Read observations: of PMFIT, of TPOINT, of INDI's EQMod driver or of EQASCOM, whichever it is.

    Parameters
    ----------
    name : str
        Stands in the messages.
    latitude_deg : float, optional
        Of the mount, for a file of EQASCOM, which tells none; the others bring theirs.

    Raises
    ------
    BadRequest
        It is none of them; with the line.
    """
    if is_eqmod_alignment(text):
        return read_eqmod_alignment(text, name=name)
    if is_eqascom_alignment(text):
        if latitude_deg is None:
            raise BadRequest(
                f"{name} doesn't say where the mount stands",
                advice="give the settings with --config, or --site LATITUDE LONGITUDE (east positive)",
            )
        rows = read_eqascom_alignment(text, latitude_deg, name=name)
        return _observations("equatorial", latitude_deg, np.array(rows))
    lines = text.splitlines()
    if len(lines) > 1 and lines[1].strip() in ("E", "A"):
        return _pmfit(lines, name)
    if any(line.strip().startswith(":") for line in lines[1:]):
        return _tpoint(lines, name)
    raise BadRequest(
        f"{name} is not a file of PMFIT, TPOINT, INDI's EQMod driver or EQASCOM",
        advice="the second line is E or A (PMFIT), or an option such as :EQUAT (TPOINT); "
        "EQMod's begins with <aligndata>, EQASCOM's has a section [alignment_preset0]",
    )


def _pmfit(lines: list[str], name: str) -> Mechanical:
    kind: Kind = "equatorial" if lines[1].strip() == "E" else "altaz"
    try:
        latitude_deg = float(lines[2])
    except (IndexError, ValueError) as cause:
        raise BadRequest(f"{name}, line 3: no latitude") from cause
    rows = []
    for number, line in enumerate(lines[3:], start=4):
        if not line.strip():
            continue
        # fixed columns: a sign may follow the number before at once
        values = _NUMBER.findall(line)
        if len(values) != 4 or _NUMBER.sub("", line).strip():
            raise BadRequest(f"{name}, line {number}: {line.strip()!r} is not four angles")
        rows.append([float(one) for one in values])
    return _checked(kind, latitude_deg, rows, name)


def _checked(kind: Kind, latitude_deg: float, rows: list[list[float]], name: str) -> Mechanical:
    if not rows:
        raise BadRequest(f"{name} holds no observations")
    if not -90.0 <= latitude_deg <= 90.0:
        raise BadRequest(f"{name}: a latitude of {latitude_deg}°")
    angles_deg = np.array(rows)
    # numbers of hundreds of digits are infinite, and TPOINT's triples may say nan
    beyond = ~(np.abs(angles_deg) <= _MOST_ANGLE_DEG).all(axis=1)
    if beyond.any():
        number = int(np.argmax(beyond)) + 1
        raise BadRequest(f"{name}: observation {number} of {len(rows)} has an impossible angle")
    return _observations(kind, latitude_deg, angles_deg)


def _sexagesimal(parts: list[str]) -> float:
    """Degrees or hours of a signed triple; the sign of -0 counts."""
    whole, minutes, seconds = parts
    value = abs(float(whole)) + float(minutes) / 60.0 + float(seconds) / 3600.0
    return -value if whole.startswith("-") else value


def _tpoint(lines: list[str], name: str) -> Mechanical:
    latitude_deg: float | None = None
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        said = line.split("!")[0].strip()
        if not said:
            continue
        if said.upper() == "END":
            break
        if said.startswith(":"):
            if said.upper() not in (":EQUAT", ":NODA", ":ALLSKY"):
                raise BadRequest(
                    f"{name}, line {number}: the option {said} isn't understood",
                    advice=":EQUAT, :NODA, :ALLSKY are; PMFIT's format holds alt-azimuth mounts",
                )
            continue
        parts = said.split()
        try:
            if latitude_deg is None:
                latitude_deg = _sexagesimal(parts[:3])
                continue
            if len(parts) not in (14, 15):
                raise ValueError(f"{len(parts)} numbers")
            star, telescope = parts[:6], parts[6:12]
            sidereal = [*parts[12:], "0"][:3]
            lst_deg = DEG_PER_HOUR * _sexagesimal(sidereal)
            rows.append(
                [
                    lst_deg - DEG_PER_HOUR * _sexagesimal(star[:3]),
                    _sexagesimal(star[3:]),
                    lst_deg - DEG_PER_HOUR * _sexagesimal(telescope[:3]),
                    _sexagesimal(telescope[3:]),
                ]
            )
        except ValueError as cause:
            raise BadRequest(
                f"{name}, line {number}: {said!r} is not an observation",
                advice="star h m s d m s, telescope h m s d m s, sidereal time h m (s)",
            ) from cause
    if latitude_deg is None:
        raise BadRequest(f"{name} gives no latitude")
    return _checked("equatorial", latitude_deg, rows, name)


@dataclass(frozen=True, slots=True)
class Coefficients:
    """What a file of coefficients holds.

    Attributes
    ----------
    kind : {"equatorial", "altaz"}
        By the names of its terms.
    values_arcsec, sigma_arcsec : dict
        By term.
    n : int
        Observations it was made of.
    """

    caption: str
    kind: Kind
    values_arcsec: dict[str, float]
    sigma_arcsec: dict[str, float]
    n: int
    sky_rms_arcsec: float


def read_coefficients(text: str, *, name: str = "file") -> Coefficients:
    """Read a TPOINT file of coefficients.

    Raises
    ------
    BadRequest
        It is none, or holds terms that aren't known; all of them are named.
    """
    if is_eqmod_alignment(text) or is_eqascom_alignment(text):
        raise BadRequest(
            f"{name} holds alignment points, no coefficients",
            advice="fit a model to them: `mountnav model fit`",
        )
    lines = text.splitlines()
    head = lines[1].split() if len(lines) > 1 else []
    try:
        n, rms = int(head[1]), float(head[2])
    except (IndexError, ValueError) as cause:
        raise BadRequest(
            f"{name}, line 2: no method, number of observations and RMS", advice="such as: T 39 5.78 0.0 0.0"
        ) from cause
    values: dict[str, float] = {}
    sigmas: dict[str, float] = {}
    for number, line in enumerate(lines[2:], start=3):
        if not line.strip():
            continue
        if line.strip().upper() == "END":
            break
        read = _COEFFICIENT.fullmatch(line)
        try:
            if read is None or read[2] in values:
                raise ValueError(line)
            values[read[2]] = float(read[3])
            sigmas[read[2]] = float(read[4]) if read[4] is not None else 0.0
        except ValueError as cause:
            raise BadRequest(
                f"{name}, line {number}: {line.strip()!r} is not a term, or a term twice"
            ) from cause
    kind: Kind = "altaz" if any(one in ALTAZ and one not in EQUATORIAL for one in values) else "equatorial"
    unknown = [one for one in values if not _known(kind, one)]
    if unknown or not values:
        raise BadRequest(
            f"{name} holds terms that are not known here: {', '.join(unknown) or 'none at all'}",
            advice="fit a new model to the observations: `mountnav model fit`",
        )
    return Coefficients(lines[0].strip(), kind, values, sigmas, n, rms)


def _known(kind: Kind, name: str) -> bool:
    try:
        term(kind, name)
    except BadRequest:
        return False
    return True


def write_coefficients(model: PointingModel) -> str:
    """Write a model as a TPOINT file of coefficients; correlations have no place in it."""
    rms = model.sky_rms_arcsec if model.sky_rms_arcsec is not None else math.sqrt(2.0) * model.scatter_arcsec
    caption = f"{model.telescope or 'mountnav'} {model.made_utc:%Y-%m-%d} {model.id}"
    lines = [caption, f"T {model.n_used:4d} {rms:10.4f} {0.0:9.4f} {0.0:9.4f}"]
    told = zip(model.terms, model.coefficients_arcsec, model.sigma_arcsec, strict=True)
    lines += [f"  {name:<8s} {value:+12.4f} {sigma:11.5f}" for name, value, sigma in told]
    return "\n".join([*lines, "END"]) + "\n"


def model_from(
    read: Coefficients,
    *,
    model_id: str,
    site_latitude_deg: float,
    made_utc: datetime,
    does_refraction: bool = False,
    telescope: str = "",
) -> PointingModel:
    """Make a model of imported coefficients; their correlations are not known and taken to be none."""
    first: Iterable[str] = ZERO_POINTS[read.kind]
    terms = (*first, *(name for name in read.values_arcsec if name not in ZERO_POINTS[read.kind]))
    sigma = np.array([read.sigma_arcsec.get(name, 0.0) for name in terms])
    return PointingModel(
        id=model_id,
        kind=read.kind,
        site_latitude_deg=site_latitude_deg,
        does_refraction=does_refraction,
        terms=terms,
        coefficients_arcsec=tuple(read.values_arcsec.get(name, 0.0) for name in terms),
        sigma_arcsec=tuple(sigma.tolist()),
        covariance_arcsec2=tuple(tuple(row) for row in np.diag(sigma**2).tolist()),
        scatter_arcsec=read.sky_rms_arcsec / math.sqrt(2.0),
        made_utc=made_utc,
        n=read.n,
        n_used=read.n,
        sky_rms_arcsec=read.sky_rms_arcsec,
        telescope=telescope,
        source=read.caption,
        notes=("imported: the correlations of its coefficients are not known",),
    )
