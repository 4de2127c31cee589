"""Quads and their codes: four stars recognized by shape alone, whatever the scale, rotation and parity.

The widest pair of the four is A and B. In the frame where A is 0 and B is 1 the other two are the complex
numbers c and d, within a lens of width 1 and height √3. Three things are left to choose, and are chosen alike
for the sky and for a frame: A and B are exchanged (z → 1 − z) if Re c + Re d > 1; C and D if Re c > Re d; and
the quad is seen from behind (z → conj z) if Im c < 0: a mirrored frame has the same code as any other.
Compare Lang et al. 2010, AJ 139, 1782, §2.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]

_PAIRS = np.array(list(combinations(range(4), 2)))
"""The six pairs of a quad's stars, any of which may be the widest."""
_ORDERS = np.array([[a, b, *(c for c in range(4) if c not in (a, b))] for a, b in _PAIRS])
"""For each of these pairs the order A, B, and the other two."""


def codes(place: Complex) -> tuple[Array, Index]:
    """Codes of quads given as complex numbers.

    Parameters
    ----------
    place : ndarray of complex, shape (n, 4)
        The four corners in any order, in a plane.

    Returns
    -------
    code : ndarray, shape (n, 4)
        Re c, Im c, Re d, Im d; NaN if all four coincide.
    order : ndarray of int, shape (n, 4)
        Which corner is A, B, C, D.
    """
    p = [place[:, k] for k in range(4)]
    square = np.stack([(p[a] - p[b]).real ** 2 + (p[a] - p[b]).imag ** 2 for a, b in _PAIRS])
    order = _ORDERS[np.argmax(square, axis=0)]
    a, b, c, d = np.take_along_axis(place, order, axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / (b - a)
        c, d = (c - a) * inverse, (d - a) * inverse
    turned = c.real + d.real > 1.0
    c, d = np.where(turned, 1.0 - c, c), np.where(turned, 1.0 - d, d)
    order[turned, :2] = order[turned, 1::-1]
    crossed = c.real > d.real
    c, d = np.where(crossed, d, c), np.where(crossed, c, d)
    order[crossed, 2:] = order[crossed, :1:-1]
    sign = np.where(c.imag < 0.0, -1.0, 1.0)
    return np.stack((c.real, sign * c.imag, d.real, sign * d.imag), axis=1), order


def flattened(vectors: Array) -> Complex:
    """Quads on the sphere laid on the plane that touches it at each quad's middle.

    Parameters
    ----------
    vectors : ndarray, shape (n, 4, 3)
        Unit vectors.

    Returns
    -------
    ndarray of complex, shape (n, 4)
        In units of the sphere's radius. How each plane is turned is arbitrary: a code doesn't depend on it.
    """
    middle = vectors.sum(axis=1)
    middle /= np.sqrt((middle**2).sum(axis=1))[:, None]
    x, y, z = middle.T
    # a plane's axes without a singular place [Duff et al. 2017, JCGT 6(1)]
    sign = np.where(z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack((1.0 + sign * x * x * a, sign * b, -sign * x), axis=1)
    second = np.stack((b, sign + y * y * a, -y), axis=1)
    depth = np.einsum("nkc,nc->nk", vectors, middle)
    xi = np.einsum("nkc,nc->nk", vectors, first) / depth
    eta = np.einsum("nkc,nc->nk", vectors, second) / depth
    flat: Complex = xi + 1j * eta
    return flat


@lru_cache(maxsize=64)
def all_quads(count: int, *, since: int = 0) -> Index:
    """All sets of four among the first `count` that hold one of number `since` or later.

    Returns
    -------
    ndarray of int, shape (n, 4)
        Rising within a row; rows with small numbers first. Remembered: not to be written to.
    """
    fours = [(*three, last) for last in range(max(3, since), count) for three in combinations(range(last), 3)]
    quads = np.array(fours, dtype=np.int64).reshape(-1, 4)
    quads.flags.writeable = False
    return quads


CODE_FLOOR = 4e-4
"""Least tolerance of a code: the frame's tangent plane isn't the quad's, and lenses bend."""


@dataclass(frozen=True, slots=True)
class QuadQuery:
    """One round of the search: which quads of the frame, and how exactly their codes have to fit.

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


QUAD_QUERIES = (
    QuadQuery(0, 10),
    QuadQuery(10, 14),
    QuadQuery(14, 18),
    QuadQuery(0, 14, error_px=2.0, tolerance=8e-3),
    QuadQuery(0, 14, error_px=2.0, tolerance=8e-3, side_deg=24.0),
    QuadQuery(0, 14, error_px=2.0, tolerance=8e-3, side_deg=38.0),
    QuadQuery(18, 24),
    QuadQuery(0, 60, neighbors=9),
    QuadQuery(0, 40, neighbors=14),
    QuadQuery(0, 40, error_px=1.5, tolerance=8e-3, neighbors=9, side_deg=32.0),
    QuadQuery(0, 150, neighbors=8),
)
"""Rounds of a search, the cheap and likely first: the 10, 14, 18 and 24 brightest measurements; between them,
looser ones for bent lenses (2 px), and frames taken as 24° and 38° wide; then quads of neighbors, for lists
with many false sources. Chosen by hand on star lists of the real sky and on real frames:
docs/explanation/blind.md has what each order finds."""


def frame_quads(query: QuadQuery, z: Complex) -> Index:
    """Quads of a round.

    Parameters
    ----------
    z : ndarray of complex, shape (n,)
        Chosen measurements, brightest first.

    Returns
    -------
    ndarray of int, shape (k, 4)
        Indices of the sources.
    """
    count = min(query.count, z.size)
    if count < 4 or count <= query.since:
        return np.zeros((0, 4), dtype=np.int64)
    if not query.neighbors or query.neighbors >= count - 1:
        return all_quads(count, since=query.since)[: query.most]
    at = np.column_stack((z.real, z.imag))[:count]
    near = np.asarray(cKDTree(at).query(at, k=query.neighbors + 1)[1])
    near[:, 0] = np.arange(count)
    chosen = np.array([(0, *three) for three in combinations(range(1, query.neighbors + 1), 3)])
    quads = np.sort(near[:, chosen].reshape(-1, 4), axis=1)
    key = ((quads[:, 3] * count + quads[:, 2]) * count + quads[:, 1]) * count + quads[:, 0]
    _, first = np.unique(key, return_index=True)
    kept: Index = quads[first[: query.most]].astype(np.int64)
    return kept


def frame_codes(
    query: QuadQuery, z: Complex, quads: Index, center: complex, focal_px: float | None
) -> tuple[Array, Index, Array]:
    """Codes of a frame's quads and how far they may be off.

    Parameters
    ----------
    z : ndarray of complex, shape (n,)
        Measurements, x + iy in pixels.
    quads : ndarray of int, shape (k, 4)
        Indices of the sources.
    center : complex
        The frame's center.
    focal_px : float or None
        Focal length in pixels; None: the frame is taken as flat.

    Returns
    -------
    code : ndarray, shape (m, 4)
        Of the quads that may be searched for.
    corners : ndarray of int, shape (m, 4)
        Measurements A, B, C, D of those quads that are large enough.
    tolerance : ndarray, shape (m,)
        In units of the code.
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
        tolerance = np.maximum(query.error_px / length, CODE_FLOOR)
    good = np.flatnonzero((tolerance <= query.tolerance) & np.isfinite(code).all(axis=1))
    return code[good], corners[good], tolerance[good]
