"""The doctor: from a night's looks to what is wrong with the mount, in words with numbers.

Four questions, each with its own odds: is the image mirrored, does the seen sky stand above the ground, does
the tube hang where the mount says, do places and readings fit together. "Healthy" and "unknown" stand among
the answers; nothing is called an illness unless healthy has become less probable than one in two hundred.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mountnav.devices import Epoch
from mountnav.errors import BadRequest
from mountnav.pointing.doctor.evidence import Fit, zeros_of
from mountnav.pointing.doctor.facts import Facts, facts_of
from mountnav.pointing.doctor.findings import HARMLESS, Diagnosis, Finding, Illness, Mounting
from mountnav.pointing.doctor.hypotheses import Shape, shapes, turns, zero_points
from mountnav.pointing.doctor.priors import (
    ALARM,
    ORDINARY,
    SUSPICION,
    ZERO_SIGMA_DEG,
    Geometry,
    noise_weights,
)
from mountnav.pointing.doctor.sky_checks import check_sides, check_sky, mirror_findings
from mountnav.pointing.doctor.wording import Case, shape_finding, side_finding, turn_finding
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Apparent, Site

ENOUGH = 4
"""Looks from which on each illness shows, as the benchmark has measured."""


def diagnose(
    observations: Sequence[PointingObservation],
    *,
    site: Site,
    believed_epoch: Epoch,
    expected_parity: int | None = None,
    mounting: Mounting | None = None,
    rotator: bool = False,
    geometry: tuple[Geometry, ...] = ORDINARY,
    zero_sigma_deg: float = ZERO_SIGMA_DEG,
    noise_arcsec: float | None = None,
    synced_on: Sequence[PointingObservation] | None = None,
    sign_confirmed: bool = False,
) -> Diagnosis:
    """Tell what the looks of a night say about the mount.

    Parameters
    ----------
    observations : sequence of PointingObservation
        In any order. What each tells is computed once and remembered, so that asking again after every look
        of a night is cheap.
    site : Site
        As configured.
    believed_epoch : {"apparent", "icrs"}
        What the mount is believed to speak; observations of the other kind (from before a change of the
        configuration) don't count.
    expected_parity : int, optional
        +1 or -1, as learned or configured.
    rotator : bool
        The camera may turn by itself: image angles say nothing.
    geometry : tuple of Geometry
        What the mount may be like: `priors.ORDINARY`, `priors.within` or `priors.known` (a model in force).
    zero_sigma_deg : float
        How well a healthy mount's zero points are known: 1.5° for home marks, less with a home sensor.
    noise_arcsec : float, optional
        Repeatability of the mount (on the sky), where earlier nights or a model have told it.
    synced_on : sequence of PointingObservation, optional
        All syncs: the place seen and the reading after it, in the segment that it began. They are no looks of
        their own, but tie that segment's zero points. None: it isn't known what was synced.
    sign_confirmed : bool
        Somebody else (the mount) has told the same longitude as the `site`: looks that would stand above the
        ground at the other sign as well say nothing against it.

    Raises
    ------
    BadRequest
        An instant is naive or outside 1972 to 2099, or `expected_parity` is neither 1 nor -1.
    """
    if expected_parity not in (None, 1, -1):
        raise BadRequest(f"expected_parity = {expected_parity}", advice="1 not mirrored, -1 mirrored")
    kind = believed_epoch == "apparent"
    counted = tuple(
        sorted(
            (one for one in observations if isinstance(one.reading, Apparent) is kind),
            key=lambda one: one.utc,
        )
    )
    if not counted:
        return Diagnosis((), (), None, False, 0, "No look to judge by.")
    altaz = mounting == "altaz"
    facts = facts_of(counted, site, altaz=altaz)
    told = mirror_findings(counted, expected_parity)
    sides = check_sides(facts, rotator=rotator, equatorial=not altaz)
    sky = check_sky(facts, site, altaz=altaz, swapped=sides.swapped, sign_confirmed=sign_confirmed)
    if sky.finding is not None:
        # all that rests on hour angles is about another sky
        return _summed_up([*told, sky.finding], len(counted))
    if sky.suspicion is not None:
        told.append(sky.suspicion)
        sides = replace(sides, swapped=False, probability_wrong=0.0, beyond=facts.west)
    case = Case(facts, site, believed_epoch, sides, mounting)
    if (finding := side_finding(case)) is not None:
        told.append(finding)
    fitted, beyond = facts, sides.beyond
    if synced_on:
        fitted, beyond = _with_syncs(counted, synced_on, facts, beyond, site, altaz)
    synced = None if synced_on is None else {one.segment_id for one in synced_on}
    weights = noise_weights(noise_arcsec)
    fit = Fit(fitted, geometry, beyond, weights, use_turns=sides.rotations_agree)
    weighed = shapes(fitted, fit, zeros_of(fitted), equatorial=not altaz, site=site)
    case = replace(case, facts=fitted, sides=replace(sides, beyond=beyond))
    told += _of_shapes(case, fit, weighed)
    best = max(weighed, key=lambda one: one.log_weight)
    placed = best if best.fitted is not None else weighed[0]
    assert placed.fitted is not None
    # where the axes count the other way, or nothing fits, zero points mean nothing
    if not altaz and best.illness not in (Illness.HEMISPHERE, Illness.UNKNOWN):
        points = zero_points(placed.fitted, fitted.segments)
        told += turn_finding(case, turns(points, site.longitude_deg, zero_sigma_deg, synced), points)
    return _summed_up(told, len(counted), sign=None if sky.sign_excluded else site.longitude_deg)


def _with_syncs(
    counted: tuple[PointingObservation, ...],
    synced_on: Sequence[PointingObservation],
    facts: Facts,
    beyond: NDArray[np.bool_],
    site: Site,
    altaz: bool,
) -> tuple[Facts, NDArray[np.bool_]]:
    """Looks and syncs together, in order of time; a sync's side is that of the look before it."""
    segments = set(facts.segments)
    ties = [replace(one, rotation_deg=None, parity=None) for one in synced_on if one.segment_id in segments]
    merged = sorted([*counted, *ties], key=lambda one: one.utc)
    numbers = {id(one): number for number, one in enumerate(counted)}
    sides, last = [], bool(beyond[0])
    for one in merged:
        last = bool(beyond[numbers[id(one)]]) if id(one) in numbers else last
        sides.append(last)
    return facts_of(tuple(merged), site, altaz=altaz), np.array(sides)


def _of_shapes(case: Case, fit: Fit, weighed: list[Shape]) -> list[Finding]:
    logs = np.array([one.log_weight for one in weighed])
    shares = np.exp(logs - np.logaddexp.reduce(logs))
    by_illness: dict[Illness | None, float] = {}
    for one, share in zip(weighed, shares, strict=True):
        by_illness[one.illness] = by_illness.get(one.illness, 0.0) + float(share)
    healthy = by_illness.pop(None)
    if healthy >= SUSPICION:
        return []
    illness = max(by_illness, key=lambda one: by_illness[one])
    best = max((one for one in weighed if one.illness is illness), key=lambda one: one.log_weight)
    rivals = tuple(one for one, share in by_illness.items() if one and one is not illness and share > 0.05)
    return [shape_finding(case, fit, best, by_illness[illness], healthy, rivals)]


def _summed_up(told: list[Finding], looks: int, *, sign: float | None = None) -> Diagnosis:
    """The whole; with the longitude, if its sign can't be told by these looks."""

    def sure(one: Finding) -> bool:
        # two causes that fit alike are no finding
        return one.odds_against_healthy * ALARM >= 1.0 and one.probability > 0.5

    findings = tuple(sorted((one for one in told if sure(one)), key=lambda one: -one.probability))
    suspicions = tuple(sorted((one for one in told if not sure(one)), key=lambda one: -one.probability))
    ill = [one for one in findings if one.what not in HARMLESS]
    enough = looks >= ENOUGH
    healthy = False if ill else (True if enough and not suspicions and sign is None else None)
    words = [one.words for one in findings]
    words += [f"Not sure yet: {one.words}" for one in suspicions]
    if not words:
        words = [
            f"{looks} looks show nothing wrong."
            if enough
            else f"{looks} look{'s' if looks > 1 else ''} show nothing wrong; {ENOUGH} are needed to be sure."
        ]
    if enough and not ill and sign is not None:
        words.append(
            f"They would stand as well at longitude {-sign:.3f}° (east): is {sign:.3f}° its right sign? A "
            "look low in the east or west tells, or a mount that says the same."
        )
    return Diagnosis(findings, suspicions, healthy, enough, looks, " ".join(words))
