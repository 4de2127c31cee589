"""Making a model: fit on most of the points, judge by the rest, and fit on all what was found good."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mountnav.errors import ModelRefused
from mountnav.pointing.model.acceptance import LEAST_FRESH, Judgement, judge
from mountnav.pointing.model.fit import MAX_SIGMA_ARCSEC, Fit, fit
from mountnav.pointing.model.mechanical import Mechanical
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.model.planning import HELD_OUT
from mountnav.pointing.model.terms import HIGHEST_HARMONIC

MIN_POINTS = 8
_LEAST_HELD_OUT = 3


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A model, and whether it may be used.

    Attributes
    ----------
    fit : Fit
        Of all points, with the terms that the first part chose.
    judged : Judgement
        Of the fit of the first part, by points it had not seen.
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
        Points to judge by; one in five of `m`, spread over the order in which they come, if not given and if
        enough are left.
    fresh : Mechanical, optional
        Taken since; fewer than three are left out of account.
    seed : int
        Of the choice of the held-out points.

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
    training = m
    if held_out is None:
        out = _one_in_five(len(m), seed)
        if np.sum(out) >= _LEAST_HELD_OUT and len(m) - np.sum(out) >= min_points:
            training, held_out = m.chosen(~out), m.chosen(out)
    found = fit(training, terms, highest_harmonic=highest_harmonic, max_sigma_arcsec=max_sigma_arcsec)
    judged = judge(
        found,
        old=old,
        held_out=held_out,
        fresh=fresh if fresh is not None and len(fresh) >= LEAST_FRESH else None,
    )
    if training is m and held_out is None:
        return Made(found, judged)
    whole = m if held_out is None or training is not m else together(m, held_out)
    final = fit(
        whole, found.geometry_terms, highest_harmonic=highest_harmonic, max_sigma_arcsec=max_sigma_arcsec
    )
    return Made(final, judged)


def _one_in_five(count: int, seed: int) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    rng = np.random.default_rng(seed)
    out = np.zeros(count, dtype=np.bool_)
    for start in range(0, count, round(1.0 / HELD_OUT)):
        block = min(round(1.0 / HELD_OUT), count - start)
        if block >= 3:
            out[start + int(rng.integers(block))] = True
    return out


def together(one: Mechanical, other: Mechanical) -> Mechanical:
    """Both observations of one telescope, segments of the same name as one."""
    ids = tuple(dict.fromkeys((*one.segment_ids, *other.segment_ids)))
    number = np.array([ids.index(key) for key in other.segment_ids], dtype=np.int64)
    first = np.array([ids.index(key) for key in one.segment_ids], dtype=np.int64)
    return Mechanical(
        one.kind,
        one.site_latitude_rad,
        np.concatenate([one.seen, other.seen]),
        np.concatenate([one.beyond, other.beyond]),
        np.concatenate([one.read_lon_rad, other.read_lon_rad]),
        np.concatenate([one.read_lat_rad, other.read_lat_rad]),
        np.concatenate([one.sigma_arcsec, other.sigma_arcsec]),
        np.concatenate([first[one.segment], number[other.segment]]),
        ids,
    )
