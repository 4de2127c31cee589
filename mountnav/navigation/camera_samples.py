"""What one solved frame tells of the camera: scale, parity, distortion, and its angle to the mount's axes.

The solved position angle is counted from the pole of ICRS. The camera is fixed to the tube, so its angle is
counted from the direction in which the declination axis turns: north of date at the site, transported in
parallel from where the tube looks to where the mount believes it looks. A mount whose pole is off by ρ then
turns the angle by ρ at most, and not by ρ / cos δ, as long as it was not synced beside the pole.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any, Literal

import numpy as np

from mountnav.devices import PierSide
from mountnav.navigation.reports import Look
from mountnav.sky.chain import icrs_to_hour_angle, icrs_to_observed
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Observed, Site
from mountnav.sky.sphere import (
    displaced,
    half_turn_deg,
    position_angle_deg,
    separation_arcsec,
    turn_deg,
)
from mountnav.solution import Solution

Mounting = Literal["german", "fork", "altaz"]

_TRANSPORTED_DEG = 5.0
"""A mount that is further off than this is lost, and its reading says nothing of its axes."""
_PAIRS_FOR_DISTORTION = 30


@dataclass(frozen=True, slots=True)
class CameraSample:
    """One solve, as `Learned` takes it.

    Attributes
    ----------
    look_id : str
    utc : datetime
    scale_arcsec_px : float
    parity : int
    axis_angle_deg : float
        Position angle of the image's +y axis from the mount's own north (an alt-azimuth mount's zenith).
    cos_latitude : float
        Of the believed place in the mount's frame: what a pole's error is divided by.
    side : PierSide
        As the mount says.
    distortion_px2 : float or None
        Cubic radial: a star at distance r from the center appears at r·(1 + distortion_px2·r²).
    """

    look_id: str
    utc: datetime
    scale_arcsec_px: float
    parity: int
    axis_angle_deg: float
    cos_latitude: float
    side: PierSide = PierSide.UNKNOWN
    distortion_px2: float | None = None


def camera_sample(
    found: Look, site: Site, air: Air, mounting: Mounting | None, *, lost: bool = False
) -> CameraSample:
    """Take from a look what it tells of the camera.

    Parameters
    ----------
    found : Look
    site : Site
    air : Air
    mounting : {"german", "fork", "altaz"} or None
    lost : bool
        The mount doesn't know where it points: its belief is left out.
    """
    angle_deg, cos_latitude = axis_angle_deg(
        found.seen,
        found.seen if lost else found.believed,
        found.solution.rotation_deg,
        found.mid_exposure_utc,
        site,
        air,
        mounting,
    )
    return CameraSample(
        look_id=found.look_id,
        utc=found.mid_exposure_utc,
        scale_arcsec_px=found.solution.scale_arcsec_px,
        parity=found.solution.parity,
        axis_angle_deg=angle_deg,
        cos_latitude=cos_latitude,
        side=found.after.pier_side or PierSide.UNKNOWN,
        distortion_px2=distortion_px2(found.solution),
    )


def axis_angle_deg(
    seen: Icrs,
    believed: Icrs,
    rotation_deg: float,
    utc: datetime,
    site: Site,
    air: Air,
    mounting: Mounting | None,
) -> tuple[float, float]:
    """Angle of the image's +y axis in the mount's own frame, and the cosine of the latitude there.

    Parameters
    ----------
    seen, believed : Icrs
    rotation_deg : float
        Position angle of +y at `seen`, from the ICRS north through east.
    utc : datetime
    site : Site
    air : Air
    mounting : {"german", "fork", "altaz"} or None
        Anything but "altaz" turns about a polar axis.

    Returns
    -------
    angle_deg, cos_latitude : float
        In [0, 360), and [0, 1].
    """
    north = displaced(seen, 0.0, 60.0)
    if mounting == "altaz":
        at, up, there = (icrs_to_observed(place, utc, site, air) for place in (seen, north, believed))
        angle_deg, latitude_deg = _transported(at, up, there, rotation_deg), there.alt_deg
    else:
        here, pole, axis = (icrs_to_hour_angle(place, utc, site, air) for place in (seen, north, believed))
        angle_deg, latitude_deg = _transported(here, pole, axis, rotation_deg), axis.dec_deg
    return turn_deg(angle_deg), max(0.0, math.cos(math.radians(latitude_deg)))


def _transported(
    at: HourAngle | Observed, north: HourAngle | Observed, there: HourAngle | Observed, rotation_deg: float
) -> float:
    """The angle at `at`, counted from this frame's north, carried along the great circle to `there`."""
    assert type(at) is type(north) is type(there)
    angle_deg = rotation_deg + position_angle_deg(at, north)  # type: ignore[type-var]
    apart_arcsec = separation_arcsec(at, there)  # type: ignore[type-var]
    if not 0.01 < apart_arcsec < _TRANSPORTED_DEG * 3600.0:
        return angle_deg
    leaves = position_angle_deg(at, there)  # type: ignore[type-var]
    arrives = position_angle_deg(there, at) + 180.0  # type: ignore[type-var]
    return angle_deg + half_turn_deg(arrives - leaves)


def distortion_px2(solution: Solution) -> float | None:
    """Cubic radial distortion: from the SIP terms, or from the pairs' residuals if the plate has none.

    Returns
    -------
    float or None
        Per square pixel; None when there are too few stars to tell.
    """
    order = solution.wcs.get("A_ORDER", 0)
    if isinstance(order, int) and order >= 3:
        terms = [solution.wcs.get(name, 0.0) for name in ("A_3_0", "A_1_2", "B_2_1", "B_0_3")]
        # SIP leads from where a star appears to where it belongs
        return -sum(float(term) for term in terms) / 4.0
    return _from_residuals(solution)


def _from_residuals(solution: Solution) -> float | None:
    pairs = solution.identified
    used = np.flatnonzero(pairs.used) if len(pairs) else np.zeros(0, dtype=int)
    width, height = solution.wcs.get("IMAGEW"), solution.wcs.get("IMAGEH")
    if used.size < _PAIRS_FOR_DISTORTION or not isinstance(width, int) or not isinstance(height, int):
        return None
    matrix = np.array(
        [[float(solution.wcs[f"CD{row}_{column}"]) for column in (1, 2)] for row in (1, 2)], dtype=float
    )
    off = np.linalg.solve(matrix * 3600.0, np.stack([pairs.dx_arcsec[used], pairs.dy_arcsec[used]]))
    u, v = pairs.x_px[used] - (width - 1) / 2.0, pairs.y_px[used] - (height - 1) / 2.0
    unit = max(width, height) / 2.0
    a, b = u / unit, v / unit
    square = a * a + b * b
    zero, one = np.zeros_like(a), np.ones_like(a)
    # what the plate has taken up of it is linear, so the linear terms are free here
    rows = np.vstack(
        [
            np.column_stack([one, a, b, zero, zero, zero, a * square]),
            np.column_stack([zero, zero, zero, one, a, b, b * square]),
        ]
    )
    fitted = np.linalg.lstsq(rows, np.concatenate([off[0], off[1]]), rcond=None)[0]
    return float(fitted[6]) / unit**3


def sound(sample: CameraSample) -> bool:
    """Whether its values are numbers that a camera can have."""
    return (
        math.isfinite(sample.scale_arcsec_px)
        and sample.scale_arcsec_px > 0.0
        and math.isfinite(sample.axis_angle_deg)
        and sample.parity in (1, -1)
    )


def sample_row(sample: CameraSample) -> dict[str, Any]:
    """Make JSON values of it."""
    return asdict(sample) | {"utc": sample.utc.isoformat(), "side": str(sample.side)}


def samples_of_rows(rows: object) -> list[CameraSample]:
    """Make samples of such values; what can't be read is left out."""
    found = [_sample(row) for row in rows if isinstance(row, Mapping)] if isinstance(rows, list) else []
    return [one for one in found if one is not None and sound(one)]


def _sample(row: Mapping[str, Any]) -> CameraSample | None:
    try:
        bend = row["distortion_px2"]
        return CameraSample(
            look_id=str(row["look_id"]),
            utc=datetime.fromisoformat(row["utc"]),
            scale_arcsec_px=float(row["scale_arcsec_px"]),
            parity=int(row["parity"]),
            axis_angle_deg=float(row["axis_angle_deg"]),
            cos_latitude=float(row["cos_latitude"]),
            side=PierSide(row["side"]),
            distortion_px2=None if bend is None else float(bend),
        )
    except (KeyError, TypeError, ValueError):
        return None


__all__ = [
    "CameraSample",
    "Mounting",
    "axis_angle_deg",
    "camera_sample",
    "distortion_px2",
    "sample_row",
    "samples_of_rows",
    "sound",
]
