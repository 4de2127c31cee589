"""Looks at one target are one point of a fit: they share what the telescope is off by there.

Eight looks at a star agree with each other to a second of arc, and are all wrong by the same play of the
gears, the same turn of the worm, the same bend of the tube. Taken for eight points they outvote the others,
and what is far from them counts as a gross error. So the looks of a visit (one target, one segment, hardly
moved) are averaged; how far visits scatter is seen from visits. For errors common to a visit that is
generalized least squares: an average loses nothing but what the looks of one visit say about the geometry by
themselves, which is nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mountnav.pointing.model.mechanical import Bools, Mechanical, Numbers
from mountnav.pointing.model.rigorous import direction, wrapped
from mountnav.pointing.model.terms import Array
from mountnav.units import RAD_PER_ARCSEC

RAYLEIGH_MEDIAN = 1.1774
"""Median of a Rayleigh distribution, in its sigmas."""
_SPAN_RAD = np.radians(2.0)
"""Axes that were tracked farther are somewhere else: eight minutes of tracking."""
_APART_ARCSEC = 120.0
"""Looks of one target that differ by more are not of one mind, before anything is known of their scatter."""
_LEAST_APART_ARCSEC = 5.0
"""And however little they scatter: seeing and wind part looks of one target by so much."""
_GROSS = 4.685
"""In sigmas; as Tukey's biweight has it."""


@dataclass(frozen=True, slots=True, eq=False)
class Visits:
    """Looks, and the points that they make.

    Attributes
    ----------
    looks, points : Mechanical
        Each point at the mean place of its looks; its sigma is what its looks alone say.
    of : ndarray of int, shape (n,)
        Which point each look belongs to.
    scatter_arcsec : float
        Of looks within a visit, per coordinate, besides their sigma.
    """

    looks: Mechanical
    points: Mechanical
    of: Numbers
    scatter_arcsec: float

    def told(self, used: Bools) -> Bools:
        """Of the points, for the looks."""
        return np.asarray(used[self.of])


def visits(m: Mechanical, residuals_arcsec: Array | None = None) -> Visits:
    """Gather looks into points.

    Parameters
    ----------
    residuals_arcsec : ndarray, shape (n, 2), optional
        Against a model, near enough: they tell how looks of a visit scatter, and which is a gross error among
        its like. A look that disagrees becomes a point of its own.
    """
    group = _groups(m)
    lon, lat = m.seen_angles
    off = np.stack([wrapped(lon - m.read_lon_rad), wrapped(lat - m.read_lat_rad)], axis=1)
    scatter = 0.0
    if len(np.unique(group)) < len(m):
        if residuals_arcsec is None:
            apart = (
                _deviations(off * np.stack([np.cos(lat), np.ones_like(lat)], axis=1), group) / RAD_PER_ARCSEC
            )
            lonely = apart > _APART_ARCSEC
        else:
            apart = _deviations(residuals_arcsec, group)
            count = np.bincount(group)[group]
            shared = count > 1
            # a mean follows its looks: of two looks each shows half of the variance only
            freed = apart[shared] * np.sqrt(count[shared] / (count[shared] - 1.0))
            scale = float(np.median(freed)) / RAYLEIGH_MEDIAN
            scatter = float(np.sqrt(max(scale**2 - float(np.median(m.sigma_arcsec[shared] ** 2)), 0.0)))
            lonely = apart > max(_GROSS * scale, _LEAST_APART_ARCSEC)
        group = np.where(lonely, np.max(group) + 1 + np.arange(len(m)), group)
    kept, first, of = np.unique(group, return_index=True, return_inverse=True)
    # in the order of their first looks
    order = np.argsort(first, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(kept))
    of = rank[of].astype(np.int64)
    if len(kept) == len(m):
        return Visits(m, m, of, scatter)
    return Visits(m, _averaged(m, off, of, first[order], scatter), of, scatter)


def _groups(m: Mechanical) -> Numbers:
    """Number the visits: one target, one segment, one posture, and axes that hardly moved."""
    key = np.stack([m.segment, m.targets, m.beyond.astype(np.int64)], axis=1)
    group = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    if len(np.unique(group)) == len(m):
        return group
    axes = direction(m.read_lon_rad, m.read_lat_rad)
    more = int(np.max(group)) + 1
    for one in np.unique(group):
        looks = np.flatnonzero(group == one)
        first = looks[0]
        for look in looks[1:]:
            if float(np.linalg.norm(axes[look] - axes[first])) > _SPAN_RAD:
                first, more = look, more + 1
            if first != looks[0]:
                group[look] = more
    return group


def _deviations(values: Array, group: Numbers) -> Array:
    """Distance of each look from the median of its group."""
    middle = np.empty_like(values)
    for one in np.unique(group):
        mine = group == one
        middle[mine] = np.median(values[mine], axis=0)
    return np.asarray(np.hypot(*(values - middle).T))


def _averaged(m: Mechanical, off: Array, of: Numbers, first: Numbers, scatter_arcsec: float) -> Mechanical:
    count = len(first)
    weight = 1.0 / np.maximum(m.sigma_arcsec**2 + scatter_arcsec**2, 1e-6)
    total = np.bincount(of, weight, count)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(of, weight * values, count) / total)

    lon = m.read_lon_rad[first] + mean(wrapped(m.read_lon_rad - m.read_lon_rad[first][of]))
    lat = mean(m.read_lat_rad)
    off_lon = off[first, 0] + mean(wrapped(off[:, 0] - off[first, 0][of]))
    return replace(
        m,
        seen=direction(lon + off_lon, lat + mean(off[:, 1])),
        beyond=m.beyond[first],
        read_lon_rad=lon,
        read_lat_rad=lat,
        sigma_arcsec=np.sqrt(1.0 / total),
        segment=m.segment[first],
        target=m.targets[first],
        sense=np.stack([mean(m.senses[:, 0]), mean(m.senses[:, 1])], axis=1),
    )
