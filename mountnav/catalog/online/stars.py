"""The columns of an answer become stars that can be packed: checked, with an error over time for each."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.online.answer import Roles
from mountnav.catalog.online.request import Circle, Unusable
from mountnav.catalog.online.source import FlagRule, OnlineSource
from mountnav.catalog.packed.error_classes import error_curve, unknown_motion_mas_yr
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.space_motion import unit_vectors
from mountnav.catalog.stars import StarFlag

Array = NDArray[np.float64]
Chosen = NDArray[np.bool_]

LARGEST_SHARE_WITHOUT_PLACE = 0.1
"""Share of an answer's rows without a position up to which these are left out; with more the answer is
refused, since the columns are then others than thought; chosen by hand."""
FARTHEST_DEG = 0.1
"""How far outside the circle a star may be, beside half its radius: boxes are answered as well."""
FAINTEST_MAG, BRIGHTEST_MAG = 40.0, -4.0
"""Magnitudes between which a value is believed: Sirius has -1.5, no survey reaches 40. Others (99.99, -9999)
are taken as unknown."""
_FASTEST_MAS_YR = 20_000.0
"""Proper motions beyond this are taken as unknown, mas/yr: twice Barnard's star's, as `readers.gaia.stars`
has it."""
_BY_DEFAULT_SIGMA_PM_MAS_YR = 5.0
"""Of a table that gives proper motions without errors: that of ground-based catalogs."""
_LEAST_SIGMA_MAS = 0.02
"""Stated position errors below this are raised to it: no catalog of stars is better than Gaia's brightest
(0.02 mas), and a zero would weigh infinitely."""
_SINGLE_PRECISION_MAS = 32.0
"""A right ascension beyond 256° in single precision: steps of 3.05e-5°, evenly wrong by up to half of one."""


@dataclass(frozen=True, slots=True)
class Received:
    """What an answer holds.

    Attributes
    ----------
    without_place, doubled : int
        Rows that were left out.
    """

    columns: CatalogColumns
    without_place: int
    doubled: int


def stars_of(roles: Roles, source: OnlineSource, circle: Circle) -> Received:
    """Make stars of an answer.

    Parameters
    ----------
    circle : Circle
        Where they were asked for.

    Raises
    ------
    Unusable
        Places are impossible, missing, or elsewhere; errors of position are unknown.
    """
    ra, dec = roles.values["ra"], roles.values["dec"]
    placed = np.isfinite(ra) & np.isfinite(dec)
    missing = int(np.count_nonzero(~placed))
    if missing > LARGEST_SHARE_WITHOUT_PLACE * placed.size:
        raise Unusable(f"{missing} of its {placed.size} rows have no position")
    if np.any((ra[placed] < 0.0) | (ra[placed] > 360.0) | (np.abs(dec[placed]) > 90.0)):
        raise Unusable("its positions are not RA and Dec in degrees")
    _require_near(ra[placed], dec[placed], circle)
    stars = _columns(roles, source)
    _, first = np.unique(
        np.column_stack([stars.ra_deg[placed], stars.dec_deg[placed], stars.mag[placed]]),
        axis=0,
        return_index=True,
    )
    kept = np.flatnonzero(placed)[np.sort(first)]
    return Received(only(stars, kept), missing, int(np.count_nonzero(placed)) - kept.size)


def only(stars: CatalogColumns, chosen: NDArray[np.int64] | Chosen) -> CatalogColumns:
    """Some of the stars."""
    parts: dict[str, Any] = {one.name: getattr(stars, one.name) for one in fields(CatalogColumns)}
    cut: dict[str, Any] = {key: None if part is None else part[chosen] for key, part in parts.items()}
    return CatalogColumns(**cut)


def _require_near(ra: Array, dec: Array, circle: Circle) -> None:
    """A server that looks elsewhere, in hours or in another frame, gives itself away here."""
    apart = unit_vectors(ra, dec) - unit_vectors(circle.ra_deg, circle.dec_deg)[:, np.newaxis]
    farthest = 2.0 * np.sin(np.radians(1.5 * circle.radius_deg + FARTHEST_DEG) / 2.0)
    far = np.count_nonzero((apart**2).sum(axis=0) > farthest**2)
    if far:
        raise Unusable(f"{far} of its {ra.size} stars lie outside the circle asked for")


def _columns(roles: Roles, source: OnlineSource) -> CatalogColumns:
    values, known = roles.values, source.known
    count = values["ra"].size
    none = np.full(count, np.nan)
    mag, color, flags = _photometry(roles, source)
    pm_ra, pm_dec = values.get("pm_ra", none).copy(), values.get("pm_dec", none).copy()
    no_motion = ~np.isfinite(pm_ra) | ~np.isfinite(pm_dec)
    if known is not None and known.zero_motion_is_none:
        no_motion |= (pm_ra == 0.0) & (pm_dec == 0.0)
    # nothing moves so fast: a stand-in such as 99999 or a slip of the table
    no_motion |= np.hypot(pm_ra, pm_dec) > _FASTEST_MAS_YR
    pm_ra[no_motion] = pm_dec[no_motion] = np.nan
    flags[no_motion] |= StarFlag.NO_PROPER_MOTION.value
    for rule in known.flags if known is not None else ():
        if rule.column in roles.by_name:
            flags[_warned(rule, roles)] |= rule.flag.value
    return CatalogColumns(
        ra_deg=values["ra"] % 360.0,
        dec_deg=values["dec"],
        pm_ra_cosdec_mas_yr=pm_ra,
        pm_dec_mas_yr=pm_dec,
        mag=mag,
        error_curve=error_curve(
            *_errors(roles, source, mag, no_motion),
        ),
        color_mag=color,
        flags=flags,
    )


def _photometry(roles: Roles, source: OnlineSource) -> tuple[Array, Array, NDArray[np.uint8]]:
    values, known = roles.values, source.known
    none = np.full(values["ra"].size, np.nan)
    mag = values["mag"].copy()
    flags = np.zeros(mag.size, dtype=np.uint8)
    if known is not None and known.is_tycho_photometry and "mag" not in source.columns:
        vt, bt = mag, values.get("color_blue", none)
        # Tycho-2 ReadMe, note 7; where one is missing as in tools/build_tycho2.py
        mag = np.where(np.isnan(bt), vt, np.where(np.isnan(vt), bt - 0.6, vt - 0.090 * (bt - vt)))
        color = 0.850 * (bt - vt)
        flags[np.isnan(bt) | np.isnan(vt)] |= StarFlag.OTHER_BAND.value
    elif "color" in values:
        color = values["color"]
    else:
        color = values.get("color_blue", none) - values.get("color_red", none)
    other = values.get("mag_other", none)
    borrowed = ~np.isfinite(mag) & np.isfinite(other)
    mag[borrowed] = other[borrowed] + (known.other_shift_mag if known is not None else 0.0)
    flags[borrowed] |= StarFlag.OTHER_BAND.value
    unknown = ~((mag >= BRIGHTEST_MAG) & (mag <= FAINTEST_MAG))
    mag[unknown] = known.no_magnitude_mag if known is not None else 30.0
    flags[unknown] |= StarFlag.NO_MAGNITUDE.value
    return mag, np.where(np.abs(color) < 20.0, color, np.nan), flags


def _warned(rule: FlagRule, roles: Roles) -> Chosen:
    values = roles.by_name[rule.column].values
    if rule.test == "has":
        return np.char.find(values.astype(str), str(rule.value)) >= 0
    if values.dtype.kind != "f":
        return np.zeros(values.size, dtype=bool)
    if rule.test == "in":
        return np.isin(values, np.asarray(rule.value))
    assert not isinstance(rule.value, tuple)  # those are of "in"
    limit = float(rule.value)
    return values > limit if rule.test == "above" else values < limit


def _errors(
    roles: Roles, source: OnlineSource, mag: Array, no_motion: Chosen
) -> tuple[tuple[Array, Array], tuple[Array, Array], tuple[Array, Array]]:
    """Sigma at the mean epoch, sigma of the proper motion and mean epoch, each in RA* and Dec."""
    values, known = roles.values, source.known
    none = np.full(mag.size, np.nan)
    stand_in = source.sigma_mas if source.sigma_mas is not None else (known.sigma_mas if known else np.nan)
    added = known.added_sigma_mas if known else 0.0
    added = float(np.hypot(added, _SINGLE_PRECISION_MAS if roles.is_single else 0.0))
    least_pm = known.least_sigma_pm_mas_yr if known else 0.0
    largest = known.no_error_mas if known else np.inf
    together = values.get("e_total", none) / np.sqrt(2.0)
    typical = unknown_motion_mas_yr(mag)
    by_default = known.sigma_pm_mas_yr if known else _BY_DEFAULT_SIGMA_PM_MAS_YR
    sigmas, motions, epochs = [], [], []
    for axis in ("ra", "dec"):
        sigma = values.get(f"e_{axis}", none)
        sigma = np.where((sigma > 0.0) & (sigma < largest), sigma, together)
        sigma = np.where(np.isfinite(sigma), sigma, stand_in)
        if not np.all(np.isfinite(sigma)):
            raise Unusable("the errors of its positions are unknown: set sigma_mas")
        sigmas.append(np.hypot(np.maximum(sigma, _LEAST_SIGMA_MAS), added))
        motion = values.get(f"e_pm_{axis}", none)
        told = (motion > 0.0) & (motion < 5000.0)
        motions.append(
            np.where(
                no_motion,
                np.where(told, np.maximum(motion, typical), typical),
                np.where(told, np.maximum(motion, least_pm), by_default),
            )
        )
        epoch = values.get(f"mean_epoch_{axis}", none)
        epochs.append(np.where((epoch > 1800.0) & (epoch < 2100.0), epoch, roles.epoch_yr))
    return (sigmas[0], sigmas[1]), (motions[0], motions[1]), (epochs[0], epochs[1])
