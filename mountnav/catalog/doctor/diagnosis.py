"""The diagnosis: whether the catalogs suffice for a camera before the night, and what would help."""

from __future__ import annotations

import math
from collections.abc import Sequence, Sized
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.catalog_set import CatalogSet
from mountnav.catalog.doctor.counts import (
    SAMPLE_FIELDS,
    WANTED_STARS,
    Counted,
    FrameSize,
    Reach,
    SampleFields,
    counted,
    failing_near,
    modeled,
    plane_fields,
    pole_fields,
    reach_of,
    spread_fields,
)
from mountnav.catalog.doctor.obtainable import ONLINE, ObtainableCatalog, in_size, obtainable_catalogs
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.readers import CATALOGS
from mountnav.catalog.star_counts import density_deg2
from mountnav.catalog.stars import Catalog
from mountnav.clock import utc_now
from mountnav.sky.coordinates import Icrs
from mountnav.units import SKY_DEG2, julian_year

__all__ = [
    "CameraFacts",
    "Check",
    "Diagnosis",
    "FrameSize",
    "NamedCatalog",
    "Reach",
    "Verdict",
    "advice_for",
    "diagnose",
    "reach_of",
]


SUFFICIENT = 0.01
"""A catalog suffices when fewer of the fields fail."""
MARGINAL = 0.10
"""Up to here it is marginal: a second try some fields away helps."""


class Verdict(StrEnum):
    """Whether the catalogs suffice for a camera."""

    SUFFICES = "suffices"
    MARGINAL = "marginal"
    INSUFFICIENT = "insufficient"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class CameraFacts:
    """A camera of the settings, as far as it is known.

    Attributes
    ----------
    telescope : str
        Id in the settings.
    frame : FrameSize or None
        None when size or scale can't be told.
    width_px, height_px : int or None
        None: not known.
    scale_arcsec_px : float or None
        None: not known.
    size_from, scale_from, depth_from : str
        Where each comes from, for people.
    problem : str or None
        What is missing, and what to set.
    """

    telescope: str
    frame: FrameSize | None
    width_px: int | None = None
    height_px: int | None = None
    scale_arcsec_px: float | None = None
    size_from: str = ""
    scale_from: str = ""
    depth_from: str = ""
    depth_is_estimate: bool = False
    problem: str | None = None


@dataclass(frozen=True, slots=True)
class Check:
    """A catalog against a camera.

    Attributes
    ----------
    is_here : bool
        Its stars were counted; else they are the model's.
    stars : int
        In the whole catalog.
    pole, median, plane : float
        Stars per frame near the galactic pole, in the median over the reachable sky, near the plane. NaN
        where the catalog or the telescope reaches none of it.
    fails_share : float
        Of the reachable sky: fields that would not be solved, what the catalog has no sky for included.
    uncovered_share : float
        Of the reachable sky: what the catalog has no sky for.
    places : int
        Number of fields that were looked at.
    """

    name: str
    slug: str
    is_here: bool
    stars: int
    pole: float
    median: float
    plane: float
    fails_share: float
    uncovered_share: float
    places: int
    known: ObtainableCatalog | None = None

    @property
    def verdict(self) -> Verdict:
        """By the share of fields that fail."""
        return verdict_of(self.fails_share)


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What the doctor says of a camera.

    Attributes
    ----------
    reach : Reach
        The sky that counts.
    here : tuple of Check
        Each catalog on this machine, the best first.
    together : float
        Share of the reachable fields that fail with the best of these for each; NaN if the camera is unknown.
    verdict : Verdict
        Of all of these together.
    remedies : tuple of Check
        Catalogs that would suffice: the smallest, then the most precise if it is another. If none would, the
        one that comes nearest.
    advice : tuple of str
        What to do, one sentence each; empty if nothing need be done.
    """

    camera: CameraFacts
    reach: Reach
    here: tuple[Check, ...]
    together: float
    verdict: Verdict
    remedies: tuple[Check, ...]
    advice: tuple[str, ...]


def verdict_of(fails_share: float) -> Verdict:
    """Judge a share of failing fields."""
    if math.isnan(fails_share):
        return Verdict.UNKNOWN
    if fails_share < SUFFICIENT:
        return Verdict.SUFFICES
    return Verdict.MARGINAL if fails_share < MARGINAL else Verdict.INSUFFICIENT


Array = NDArray[np.float64]

DEEPEST_MAG = 20.5
"""What the deepest catalogs hold completely."""
_MOST_GAIN_MAG = 3.0
"""Nobody exposes 250 times as long."""
_WORTH_WAITING = 0.7
"""Exposing longer is recommended if it lowers the share of failing fields by this factor."""
_AS_GOOD = 0.005
"""Catalogs whose shares of failing fields differ by less are equally good."""
_BORDER_DEG = 4.0
"""A catalog that was cut out isn't trusted near its border: two to three degrees [coverage.py]."""
_WORTH_CUTTING = 0.9
"""A telescope that reaches less of the sky is told to import only that."""
_FIELDS_ABOUT = 4.0
"""Stars about a frame are counted in a circle of so many fields; chosen: their mean is then known to about
half of the scatter of one field. Doubled, the advice after a failed frame reads twice as many stars."""
_LEAST_ABOUT_DEG = 0.2
"""Radius of that circle at least, degrees: a smaller one holds too few stars of any catalog to count; chosen
by hand."""
_MEDIAN_TO_MEAN = 0.7
"""Star density in the median of the sky over its mean, about; it serves for frames whose position is unknown.
The origin isn't recorded. Doubled, such a frame is believed to hold twice as many stars."""
_EPOCH_YR = 2026.0
"""Of counts for advice: a star more or less by proper motion changes no advice."""


def remedies_among(checks: Sequence[Check]) -> tuple[Check, ...]:
    """Choose what to recommend.

    Parameters
    ----------
    checks : sequence of Check
        Of catalogs that can be had.

    Returns
    -------
    tuple of Check
        The smallest that suffices, and the most precise that does if it is another. If none suffices, the
        same of those that come nearest.
    """
    had = [one for one in checks if one.known is not None]
    if not had:
        return ()
    least = min(one.fails_share for one in had)
    good = [one for one in had if one.fails_share < max(SUFFICIENT, least + _AS_GOOD)]
    smallest = min(good, key=_size_gb)
    finest = min(good, key=lambda one: (_sigma(one), _size_gb(one)))
    return (smallest,) if finest is smallest else (smallest, finest)


def sentences(
    camera: CameraFacts, frame: FrameSize, remedies: Sequence[Check], places: SampleFields, reach: Reach
) -> tuple[str, ...]:
    """Put the advice in words.

    Parameters
    ----------
    remedies : sequence of Check
        From `remedies_among`.
    places : SampleFields
        Of the reachable sky.
    reach : Reach
        The same as declinations.
    """
    told: list[str] = []
    suffices = bool(remedies) and remedies[0].fails_share < SUFFICIENT
    if not suffices:
        told.append(f"no catalog suffices for {frame} to magnitude {frame.depth_mag:.1f}")
        told.extend(_otherwise(frame, places))
    least = "the smallest that suffices" if suffices else "the smallest of those that come nearest"
    labels = (least, "the most precise of them") if len(remedies) > 1 else ("get",)
    told.extend(_recipe(label, one, reach) for label, one in zip(labels, remedies, strict=False))
    if remedies:
        told.append(ONLINE)
    if camera.depth_is_estimate:
        told.append("the depth is an estimate: set limiting_mag to the faintest star that your frames show")
    return tuple(told)


FEWEST_WORTH = 4.0
"""A catalog with fewer stars in a field than this isn't worth fetching for it."""
NEARLY = 0.8
"""A catalog with this share of the stars that the richest holds is as good, if it is smaller."""


def advice_for(
    field_width_deg: float,
    field_height_deg: float,
    depth_mag: float,
    center: Icrs | None,
    stores: Sequence[Catalog],
) -> str:
    """Say at night why a field is too narrow for the catalogs on this machine, and what would help.

    Parameters
    ----------
    depth_mag : float
        Faintest star that the camera measures.
    center : Icrs or None
        Where the frame is believed to be; without it the answer is for the median of the sky.
    stores : sequence of Catalog
        What is on this machine; each is asked for one small cone.

    Returns
    -------
    str
        One or two sentences; some milliseconds.
    """
    frame = FrameSize(field_width_deg, field_height_deg, depth_mag)
    found = [(one.name, _about(one, frame, center)) for one in stores]
    here = "here" if center is not None else "in the median of the sky"
    if found:
        name, number = max(found, key=lambda pair: pair[1])
        if float(failing_near(number)) < SUFFICIENT:
            return f"{name} holds about {number:.0f} stars in a field of {frame} {here}, which is enough"
        told = (
            f"{name} holds about {number:.1f} stars on average in a field of {frame} {here}, and at least "
            f"{WANTED_STARS} are wanted in each"
        )
    else:
        told = f"there is no catalog for a field of {frame} {here}"
    best = _smallest_known(frame, center)
    if best is None:
        nearest = _nearest_known(frame, center)
        most = _expected(frame, nearest.faintest_mag, nearest.densest_deg2, center)
        if most < FEWEST_WORTH:
            return (
                f"{told}; to magnitude {depth_mag:.1f} no catalog has more than {most:.1f}: "
                f"expose longer, or solve through a wider camera on the same mount"
            )
        return (
            f"{told}. None is sure to suffice to magnitude {depth_mag:.1f}; {nearest.name} comes nearest, "
            f"with about {most:.1f} ({_sizes(nearest)}): {nearest.command}; expose longer as well"
        )
    number = _expected(frame, best.faintest_mag, best.densest_deg2, center)
    return (
        f"{told}. {best.name} holds about {number:.0f} ({_sizes(best)}): {best.command}; "
        f"mountnav catalog doctor says where to get it"
    )


def _recipe(label: str, check: Check, reach: Reach) -> str:
    known = check.known
    assert known is not None, "remedies are known catalogs"
    options, share = "", 1.0
    if reach.sky_share < _WORTH_CUTTING:
        low = max(math.floor(reach.low_dec_deg - _BORDER_DEG), -90)
        high = min(math.ceil(reach.high_dec_deg + _BORDER_DEG), 90)
        options, share = f" --dec-range {low} {high}", Reach(low, high).sky_share
    return (
        f"{label}: {known.name} ({_sizes(known, share)}) from "
        f"{known.obtained}; then: {known.command}{options}"
    )


def _otherwise(frame: FrameSize, places: SampleFields) -> list[str]:
    """What helps where no catalog does: more light, or more sky."""
    told = []
    deeper, fails = _depth_that_does(frame, places)
    if fails < _WORTH_WAITING * _fails(places, frame.depth_mag, frame.area_deg2):
        gained = deeper - frame.depth_mag
        # against the sky's noise the depth grows by 1.25 log t, against the camera's by 2.5 log t
        least, most = 10.0 ** (gained / 2.5), 10.0 ** (gained / 1.25)
        left = "fewer than 1 %" if fails < SUFFICIENT else f"{100.0 * fails:.0f} %"
        told.append(
            f"expose longer: with a catalog that deep, stars to magnitude {deeper:.1f} ({least:.0f} to "
            f"{most:.0f} times the exposure) leave {left} of the fields to fail"
        )
    side = _widening_that_does(frame, places)
    if side is not None:
        told.append(
            f"or solve through a wider camera or a finder on the same mount: {frame.width_deg * side:.2g}° × "
            f"{frame.height_deg * side:.2g}° would do at this depth"
        )
    return told


def _depth_that_does(frame: FrameSize, places: SampleFields) -> tuple[float, float]:
    """The least depth that suffices, or the most that can be gained; and the share that fails then."""
    deepest = max(frame.depth_mag, min(frame.depth_mag + _MOST_GAIN_MAG, DEEPEST_MAG))
    for depth in np.arange(math.ceil(frame.depth_mag * 2.0) / 2.0, deepest, 0.5):
        fails = _fails(places, float(depth), frame.area_deg2)
        if fails < SUFFICIENT:
            return float(depth), fails
    return deepest, _fails(places, deepest, frame.area_deg2)


def _widening_that_does(frame: FrameSize, places: SampleFields) -> float | None:
    depth = min(frame.depth_mag, DEEPEST_MAG)
    for side in np.geomspace(1.1, 100.0, 60):
        if _fails(places, depth, frame.area_deg2 * float(side) ** 2) < SUFFICIENT:
            return float(side)
    return None


def _fails(places: SampleFields, depth_mag: float, area_deg2: float) -> float:
    few = places.only(slice(0, 600))
    return float(failing_near(density_deg2(few.ra_deg, few.dec_deg, depth_mag) * area_deg2).mean())


def _smallest_known(frame: FrameSize, center: Icrs | None) -> ObtainableCatalog | None:
    """The smallest catalog with which a field here is solved."""
    for known in sorted(obtainable_catalogs(), key=lambda one: one.installed_gb):
        if not known.has_magnitudes:
            continue
        number = _expected(frame, known.faintest_mag, known.densest_deg2, center)
        if float(failing_near(number)) < SUFFICIENT:
            return known
    return None


def _nearest_known(frame: FrameSize, center: Icrs | None) -> ObtainableCatalog:
    """The smallest of the catalogs that hold nearly as many stars here as any does."""
    held = {
        one: _expected(frame, one.faintest_mag, one.densest_deg2, center)
        for one in obtainable_catalogs()
        if one.has_magnitudes
    }
    most = max(held.values())
    return min((one for one in held if held[one] >= NEARLY * most), key=lambda one: one.installed_gb)


def _expected(
    frame: FrameSize, faintest_mag: float, densest_deg2: float | None, center: Icrs | None
) -> float:
    """Stars per frame by the model."""
    depth = min(frame.depth_mag, faintest_mag)
    if center is None:
        places = _coarse_sky()
        density = float(np.median(density_deg2(places.ra_deg, places.dec_deg, depth)))
    else:
        density = float(density_deg2(center.ra_deg, center.dec_deg, depth))
    return (density if densest_deg2 is None else min(density, densest_deg2)) * frame.area_deg2


def _about(catalog: Catalog, frame: FrameSize, center: Icrs | None) -> float:
    """Stars per frame that a catalog on this machine holds, from some fields' worth of sky."""
    if center is None:
        share = catalog.sky_share() if isinstance(catalog, PackedStore) else 1.0
        return _MEDIAN_TO_MEAN * _number(catalog) / (SKY_DEG2 * max(share, 1e-6)) * frame.area_deg2
    radius_deg = min(max(math.sqrt(_FIELDS_ABOUT * frame.area_deg2 / math.pi), _LEAST_ABOUT_DEG), 20.0)
    stars = catalog.cone(center, radius_deg, epoch_yr=_EPOCH_YR, mag_limit=frame.depth_mag)
    return len(stars) * frame.area_deg2 / (math.pi * radius_deg**2)


@lru_cache(maxsize=1)
def _coarse_sky() -> SampleFields:
    return spread_fields(Reach(), 300, 300)


def _size_gb(check: Check) -> float:
    return check.known.installed_gb if check.known is not None else math.inf


def _sigma(check: Check) -> float:
    return check.known.sigma_arcsec if check.known is not None else math.inf


def _sizes(known: ObtainableCatalog, share: float = 1.0) -> str:
    return f"{in_size(known.download_gb)} to fetch, {in_size(known.installed_gb * share)} on disk"


@dataclass(frozen=True, slots=True)
class NamedCatalog:
    """A catalog on this machine, under the name that commands know it by."""

    slug: str
    catalog: Catalog


def diagnose(
    camera: CameraFacts,
    reach: Reach,
    stores: Sequence[NamedCatalog],
    *,
    epoch_yr: float,
    fields: int = SAMPLE_FIELDS,
) -> Diagnosis:
    """Judge the catalogs on this machine for a camera.

    Parameters
    ----------
    reach : Reach
        Percentages are of this part of the sky.
    stores : sequence of NamedCatalog
        Their stars are counted: about a second of CPU each.
    epoch_yr : float
        Julian year of the night.
    fields : int
        How many are laid over the reachable sky.

    Returns
    -------
    Diagnosis
        With the verdict UNKNOWN and what to set, if size or scale of the camera are not known.
    """
    if camera.frame is None:
        problem = camera.problem or "the camera's field is not known"
        return Diagnosis(camera, reach, (), math.nan, Verdict.UNKNOWN, (), (problem,))
    places, pole, plane = spread_fields(reach, fields), pole_fields(reach), plane_fields(reach)
    fails = np.ones(len(places))
    here = []
    for one in stores:
        found = counted(one.catalog, camera.frame, places, pole, plane, epoch_yr=epoch_yr)
        fails = np.minimum(fails, found.fails)
        here.append(_check(one.catalog.name, one.slug, found, stars=_number(one.catalog), is_here=True))
    here.sort(key=lambda check: check.fails_share)
    together = float(fails.mean())
    verdict = verdict_of(together)
    if verdict is Verdict.SUFFICES:
        return Diagnosis(camera, reach, tuple(here), together, verdict, (), ())
    kinds = {_kind(one.catalog) for one in stores}
    had = {kind for kind in kinds if kind in CATALOGS and CATALOGS[kind].is_one_catalog}
    others = _modeled_checks(camera.frame, places, pole, plane, had)
    remedies = remedies_among(others)
    advice = sentences(camera, camera.frame, remedies, places, reach)
    return Diagnosis(camera, reach, tuple(here), together, verdict, remedies, advice)


def _modeled_checks(
    frame: FrameSize, places: SampleFields, pole: SampleFields, plane: SampleFields, here: set[str]
) -> list[Check]:
    """All obtainable catalogs that are not here, after the model of the Galaxy."""
    checks = []
    for known in obtainable_catalogs():
        if known.kind in here or not known.has_magnitudes:
            continue
        found = modeled(known.faintest_mag, known.densest_deg2, frame, places, pole, plane)
        checks.append(_check(known.name, known.kind, found, stars=known.stars, known=known))
    return checks


def _check(
    name: str,
    slug: str,
    found: Counted,
    *,
    stars: int,
    is_here: bool = False,
    known: ObtainableCatalog | None = None,
) -> Check:
    return Check(
        name,
        slug,
        is_here,
        stars,
        found.pole,
        found.median,
        found.plane,
        float(found.fails.mean()),
        float(1.0 - found.covered.mean()),
        found.looked_at,
        known,
    )


def _number(catalog: Catalog) -> int:
    """How many stars a catalog holds; 0 if it can't say."""
    return len(catalog) if isinstance(catalog, Sized) else 0


def _kind(catalog: Catalog) -> str:
    """The kind of import that a whole-sky catalog came from, or nothing."""
    if not isinstance(catalog, PackedStore) or catalog.sky_share() < 0.99:
        return ""
    return catalog.header.made_from.split(":", 1)[0]


def named_catalogs(catalog: Catalog) -> tuple[NamedCatalog, ...]:
    """The catalogs on this machine that a solver with this catalog asks.

    Parameters
    ----------
    catalog : Catalog
        A `CatalogSet`, or a single catalog.

    Returns
    -------
    tuple of NamedCatalog
        What is asked over a network is not among them: its stars can't be counted beforehand.
    """
    here = catalog.installed if isinstance(catalog, CatalogSet) else (catalog,)
    return tuple(NamedCatalog(_slug(one), one) for one in here)


def julian_year_now() -> float:
    """The year to count stars for: proper motion matters little, and a tenth of a year nothing."""
    return round(julian_year(utc_now()), 1)


def _slug(catalog: Catalog) -> str:
    return catalog.path.stem if isinstance(catalog, PackedStore) else catalog.name
