"""The doctor of catalogs: whether the stars at hand suffice for a camera, before the night."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mountnav.catalog.doctor.advice import advice_for, remedies_among, sentences
from mountnav.catalog.doctor.counts import Counted, FrameSize, counted, modeled
from mountnav.catalog.doctor.findings import CameraFacts, Check, Diagnosis, Verdict, verdict_of
from mountnav.catalog.doctor.known import OBTAINABLE, Known
from mountnav.catalog.doctor.places import (
    PLACES,
    Places,
    Reach,
    plane_places,
    pole_places,
    reach_of,
    spread_places,
)
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.stars import Catalog

__all__ = [
    "CameraFacts",
    "Check",
    "Diagnosis",
    "FrameSize",
    "Reach",
    "Shelved",
    "Verdict",
    "advice_for",
    "diagnose",
    "reach_of",
]


@dataclass(frozen=True, slots=True)
class Shelved:
    """A catalog on this machine, under the name that commands know it by."""

    slug: str
    catalog: Catalog


def diagnose(
    camera: CameraFacts, reach: Reach, stores: Sequence[Shelved], *, epoch_yr: float, fields: int = PLACES
) -> Diagnosis:
    """Judge the catalogs on this machine for a camera.

    Parameters
    ----------
    camera : CameraFacts
    reach : Reach
        Percentages are of this part of the sky.
    stores : sequence of Shelved
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
    places, pole, plane = spread_places(reach, fields), pole_places(reach), plane_places(reach)
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
    # UCAC4 and USNO-B1.0 are the same whoever imports them; of the others there are deeper and shallower ones
    had = {kind for one in stores if (kind := _kind(one.catalog)) in ("ucac4", "usno-b1")}
    others = _modeled_checks(camera.frame, places, pole, plane, had)
    remedies = remedies_among(others)
    advice = sentences(camera, camera.frame, remedies, places, reach)
    return Diagnosis(camera, reach, tuple(here), together, verdict, remedies, advice)


def _modeled_checks(
    frame: FrameSize, places: Places, pole: Places, plane: Places, here: set[str]
) -> list[Check]:
    """All obtainable catalogs that are not here, after the model of the Galaxy."""
    checks = []
    for known in OBTAINABLE:
        if known.kind in here or not known.has_magnitudes:
            continue
        found = modeled(known.faintest_mag, known.densest_deg2, frame, places, pole, plane)
        checks.append(_check(known.name, known.kind, found, stars=known.stars, known=known))
    return checks


def _check(
    name: str, slug: str, found: Counted, *, stars: int, is_here: bool = False, known: Known | None = None
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
    size = getattr(catalog, "__len__", None)
    return int(size()) if size is not None else 0


def _kind(catalog: Catalog) -> str:
    """The kind of import that a whole-sky catalog came from, or nothing."""
    if not isinstance(catalog, PackedStore) or catalog.sky_share() < 0.99:
        return ""
    return catalog.header.made_from.split(":", 1)[0]
