"""Making a model: fit on all looks, and judge it by targets that had no part in fits made the same way.

One target in five is left out in turn, with all its looks on both sides of a sync, and terms are chosen anew
without it: what is judged is the way to the model, not only its figures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mountnav.errors import ModelRefused
from mountnav.pointing.model.acceptance import (
    LEAST_FRESH,
    HeldOut,
    Judgement,
    check_old,
    held_out_by,
    judge,
)
from mountnav.pointing.model.fit import MAX_SIGMA_ARCSEC, Fit, fit
from mountnav.pointing.model.mechanical import Mechanical
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.model.planning import HELD_OUT
from mountnav.pointing.model.terms import HIGHEST_HARMONIC

MIN_POINTS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A model, and whether it may be used.

    Attributes
    ----------
    fit : Fit
        Of all looks.
    judged : Judgement
        Of it, and of fits made the same way by targets that they had not seen.
    """

    fit: Fit
    judged: Judgement


def make(
    m: Mechanical,
    *,
    terms: Sequence[str] | Literal["auto"] = "auto",
    highest_harmonic: int = HIGHEST_HARMONIC,
    max_sigma_arcsec: float = MAX_SIGMA_ARCSEC,
    min_points: int = MIN_POINTS,
    old: PointingModel | None = None,
    held_out: Mechanical | None = None,
    fresh: Mechanical | None = None,
    seed: int = 0,
) -> Made:
    """Make a model of observations and judge it.

    Parameters
    ----------
    m : Mechanical
    terms, highest_harmonic, max_sigma_arcsec
        See `fit.fit`.
    min_points : int
        Fewer make no model.
    old : PointingModel, optional
        That it has to be better than.
    held_out : Mechanical, optional
        Looks to judge by, set apart when they were taken; if there are none, the targets of `m` in turn.
    fresh : Mechanical, optional
        Taken since; fewer than three are left out of account.
    seed : int
        Of the parts that are held out in turn.

    Returns
    -------
    Made

    Raises
    ------
    ModelRefused
        Too few points, or they don't determine the terms.
    """
    if len(m) < min_points:
        raise ModelRefused(
            f"{len(m)} points are too few for a model", advice=f"at least {min_points}: take more looks"
        )
    check_old(old, m)

    def fitted(looks: Mechanical, names: Sequence[str] | Literal["auto"]) -> Fit:
        return fit(looks, names, highest_harmonic=highest_harmonic, max_sigma_arcsec=max_sigma_arcsec)

    enough = fresh if fresh is not None and len(fresh) >= LEAST_FRESH else None
    if held_out is not None and len(held_out):
        first = fitted(m, terms)
        final = fitted(together(m, held_out), first.geometry_terms)
        return Made(final, judge(final, old=old, held_out=held_out_by(first, held_out, old), fresh=enough))
    final = fitted(m, terms)
    out = held_out_in_turn(m, lambda looks: fitted(looks, terms), old, min_points=min_points, seed=seed)
    return Made(final, judge(final, old=old, held_out=out, fresh=enough))


def held_out_in_turn(
    m: Mechanical,
    fitted: Callable[[Mechanical], Fit],
    old: PointingModel | None,
    *,
    min_points: int = MIN_POINTS,
    seed: int = 0,
) -> HeldOut | None:
    """Predict each target by a fit that it had no part in; None if too few looks would be left for the fits.

    Parameters
    ----------
    m : Mechanical
    fitted : callable
        Makes the fit of a part of the looks; where it refuses, what was there predicts.
    old : PointingModel or None
    min_points : int
        Of a fit.
    seed : int
        Of the parts.
    """
    targets = np.unique(m.targets)
    parts = round(1.0 / HELD_OUT)
    part_of = np.random.default_rng(seed).permutation(len(targets)) % parts
    part = part_of[np.searchsorted(targets, m.targets)]
    counts = np.bincount(part, minlength=parts)
    if len(m) - int(np.max(counts)) < min_points:
        return None
    found: list[HeldOut] = []
    for one in range(parts):
        known, asked = m.chosen(part != one), m.chosen(part == one)
        if not len(asked):
            continue
        try:
            found.append(held_out_by(fitted(known), asked, old))
        except ModelRefused:
            continue
    if not found:
        return None
    return HeldOut(np.concatenate([one.new for one in found]), np.concatenate([one.old for one in found]))


def together(one: Mechanical, other: Mechanical) -> Mechanical:
    """Both observations of one telescope, segments of the same name as one."""
    ids = tuple(dict.fromkeys((*one.segment_ids, *other.segment_ids)))
    number = np.array([ids.index(key) for key in other.segment_ids], dtype=np.int64)
    first = np.array([ids.index(key) for key in one.segment_ids], dtype=np.int64)
    after = other.targets + (int(np.max(one.targets)) + 1 if len(one) else 0)
    return replace(
        one,
        seen=np.concatenate([one.seen, other.seen]),
        beyond=np.concatenate([one.beyond, other.beyond]),
        read_lon_rad=np.concatenate([one.read_lon_rad, other.read_lon_rad]),
        read_lat_rad=np.concatenate([one.read_lat_rad, other.read_lat_rad]),
        sigma_arcsec=np.concatenate([one.sigma_arcsec, other.sigma_arcsec]),
        segment=np.concatenate([first[one.segment], number[other.segment]]),
        segment_ids=ids,
        target=np.concatenate([one.targets, after]),
        sense=np.concatenate([one.senses, other.senses]),
    )
