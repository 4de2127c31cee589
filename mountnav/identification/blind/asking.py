"""Which quads of a frame are asked for, in what order, and how exactly they have to fit."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.identification.blind.patterns import all_quads, codes, flattened

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]

FLOOR = 4e-4
"""No code is asked for more exactly: the frame's tangent plane isn't the quad's, and lenses bend."""


@dataclass(frozen=True, slots=True)
class Ask:
    """One round of questions.

    Attributes
    ----------
    since, count : int
        Quads of the `count` brightest measurements that hold one of number `since` or later.
    error_px : float
        How far a measurement may be off.
    tolerance : float
        Most that a code may differ; smaller quads, whose codes may be off by more, are left out.
    side_deg : float
        The frame's shorter side is taken to be so wide, where the scale is not known: a wide frame's
        quads are laid on the sphere first. 0: the frame is taken as flat.
    neighbors : int
        Only quads of a measurement and three of its so many nearest among the `count` brightest; 0: all.
    most : int
        No more quads than that; those of the brightest.
    """

    since: int
    count: int
    error_px: float = 0.7
    tolerance: float = 4e-3
    side_deg: float = 0.0
    neighbors: int = 0
    most: int = 12000


ASKS = (
    Ask(0, 10),
    Ask(10, 14),
    Ask(14, 18),
    Ask(0, 14, error_px=2.0, tolerance=8e-3),
    Ask(0, 14, error_px=2.0, tolerance=8e-3, side_deg=24.0),
    Ask(0, 14, error_px=2.0, tolerance=8e-3, side_deg=38.0),
    Ask(18, 24),
    Ask(0, 60, neighbors=9),
    Ask(0, 40, neighbors=14),
    Ask(0, 40, error_px=1.5, tolerance=8e-3, neighbors=9, side_deg=32.0),
    Ask(0, 150, neighbors=8),
)


def frame_quads(ask: Ask, z: Complex) -> Index:
    """Quads of a round.

    Parameters
    ----------
    ask : Ask
    z : ndarray of complex, shape (n,)
        Chosen measurements, brightest first.

    Returns
    -------
    ndarray of int, shape (k, 4)
    """
    count = min(ask.count, z.size)
    if count < 4 or count <= ask.since:
        return np.zeros((0, 4), dtype=np.int64)
    if not ask.neighbors or ask.neighbors >= count - 1:
        return all_quads(count, since=ask.since)[: ask.most]
    at = np.column_stack((z.real, z.imag))[:count]
    near = np.asarray(cKDTree(at).query(at, k=ask.neighbors + 1)[1])
    near[:, 0] = np.arange(count)
    chosen = np.array([(0, *three) for three in combinations(range(1, ask.neighbors + 1), 3)])
    quads = np.sort(near[:, chosen].reshape(-1, 4), axis=1)
    key = ((quads[:, 3] * count + quads[:, 2]) * count + quads[:, 1]) * count + quads[:, 0]
    _, first = np.unique(key, return_index=True)
    kept: Index = quads[first[: ask.most]].astype(np.int64)
    return kept


def frame_codes(
    ask: Ask, z: Complex, quads: Index, center: complex, focal_px: float | None
) -> tuple[Array, Index, Array]:
    """Codes of a frame's quads and how far they may be off.

    Parameters
    ----------
    ask : Ask
    z : ndarray of complex, shape (n,)
        Measurements, x + iy in pixels.
    quads : ndarray of int, shape (k, 4)
    center : complex
        The frame's center.
    focal_px : float or None
        Focal length in pixels; None: the frame is taken as flat.

    Returns
    -------
    code : ndarray, shape (m, 4)
    corners : ndarray of int, shape (m, 4)
        Measurements A, B, C, D of those quads that are large enough.
    tolerance : ndarray, shape (m,)
    """
    corner = z[quads]
    if focal_px is None:
        code, order = codes(corner)
    else:
        away = (z - center) / focal_px
        vectors = np.stack((away.real, away.imag, np.ones(z.size)), axis=1)
        vectors /= np.sqrt((vectors**2).sum(axis=1))[:, None]
        code, order = codes(flattened(vectors[quads]))
    corners = np.take_along_axis(quads, order, axis=1)
    length = np.abs(z[corners[:, 1]] - z[corners[:, 0]])
    with np.errstate(divide="ignore"):
        tolerance = np.maximum(ask.error_px / length, FLOOR)
    good = np.flatnonzero((tolerance <= ask.tolerance) & np.isfinite(code).all(axis=1))
    return code[good], corners[good], tolerance[good]
