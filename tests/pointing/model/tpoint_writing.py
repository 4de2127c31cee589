"""Observations written as PMFIT and TPOINT have them: what is written is read again."""

from __future__ import annotations

import math

import numpy as np

from mountnav.errors import BadRequest
from mountnav.pointing.model.mechanical import Mechanical
from mountnav.units import DEG_PER_HOUR, sexagesimal_text


def write_pmfit(m: Mechanical, caption: str) -> str:
    """Write observations in PMFIT's format; segments and errors have no place in it."""
    lon, lat = m.seen_angles
    rows = np.degrees(np.stack([lon, lat, m.read_lon_rad, m.read_lat_rad], axis=1))
    lines = [caption.replace("\n", " ") or "mountnav", "E" if m.kind == "equatorial" else "A"]
    lines.append(f"{math.degrees(m.site_latitude_rad):+.6f}")
    lines += [f"{a:11.6f} {b:+11.6f} {c:11.6f} {d:+11.6f}" for a, b, c, d in rows]
    return "\n".join(lines) + "\n"


def write_tpoint_observations(m: Mechanical, caption: str) -> str:
    """Write observations of an equatorial mount in TPOINT's format, as if at sidereal time 0.

    Raises
    ------
    BadRequest
        The mount is alt-azimuth: use PMFIT's format.
    """
    if m.kind != "equatorial":
        raise BadRequest("observations of alt-azimuth mounts are written in PMFIT's format only")
    lon, lat = (np.degrees(one) for one in m.seen_angles)
    read_lon, read_lat = np.degrees(m.read_lon_rad), np.degrees(m.read_lat_rad)
    lines = [caption.replace("\n", " ") or "mountnav", ":EQUAT", ":NODA"]
    lines.append(sexagesimal_text(math.degrees(m.site_latitude_rad), 2, plus="+"))
    for h, d, rh, rd in zip(lon, lat, read_lon, read_lat, strict=True):
        star = f"{sexagesimal_text(-h % 360.0 / DEG_PER_HOUR, 4)} {sexagesimal_text(d, 3, plus='+')}"
        telescope = f"{sexagesimal_text(-rh % 360.0 / DEG_PER_HOUR, 4)} {sexagesimal_text(rd, 3, plus='+')}"
        lines.append(f"{star}  {telescope}  00 00 00.00")
    return "\n".join([*lines, "END"]) + "\n"
