"""The image that all stars of a frame share, drawn once for many places of a star within its pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.star_shape import Bell

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

_PHASES = 8
# three-point Gauss-Legendre rule over a pixel
_NODES = np.float32(np.sqrt(0.6) / 2.0) * np.array([-1.0, 0.0, 1.0], dtype=np.float32)
_NODE_WEIGHTS = np.array([5.0, 8.0, 5.0], dtype=np.float32) / np.float32(18.0)


@dataclass(frozen=True, slots=True)
class StarShape:
    """A bell and its p, q, r; see `profile.fit_profiles`.

    Attributes
    ----------
    bell : Bell
    p, q, r : float
        Of Q = p u² + 2 q u v + r v².
    """

    bell: Bell
    p: float
    q: float
    r: float

    @property
    def area_px2(self) -> float:
        """Flux of a star of unit amplitude."""
        return float(self.bell.volume / np.sqrt(self.p * self.r - self.q**2))

    def seen(self) -> tuple[float, float, float]:
        """Return p, q, r as wide as the star looks, the pixels' own width included."""
        if not self.bell.integrated:
            return self.p, self.q, self.r
        wide = np.linalg.inv(np.array([[self.p, self.q], [self.q, self.r]])) + np.eye(2) / 12.0
        inverse = np.linalg.inv(wide)
        return float(inverse[0, 0]), float(inverse[0, 1]), float(inverse[1, 1])


def drawn(shape: StarShape, u: Pixels, v: Pixels) -> Pixels:
    """A star of unit amplitude at offsets from its place, and its slopes as the place moves.

    Parameters
    ----------
    shape : StarShape
    u, v : ndarray of float32, shape (n, pixels)
        Offsets of pixels' middles.

    Returns
    -------
    ndarray of float32, shape (n, 3, pixels)
        Value, slope by x, slope by y; integrated over the pixels if the shape's bell is.
    """
    out = np.zeros((u.shape[0], 3, u.shape[1]), dtype=np.float32)
    for a, b, weight in _points(shape, u, v):
        value, slope, along_x, along_y = _bell(shape, a, b, weight)
        out[:, 0] += value
        out[:, 1] += slope * along_x
        out[:, 2] += slope * along_y
    return out


def drawn_with_shape(shape: StarShape, u: Pixels, v: Pixels, wing_step: float) -> Pixels:
    """The same with the slopes by p, q, r and wing behind, shape (n, 7, pixels)."""
    out = np.zeros((u.shape[0], 7, u.shape[1]), dtype=np.float32)
    fatter = replace(shape.bell, wing=shape.bell.wing + wing_step)
    for a, b, weight in _points(shape, u, v):
        value, slope, along_x, along_y = _bell(shape, a, b, weight)
        wide = fatter.of(along_x * a + along_y * b)[0] * weight
        out[:, 0] += value
        out[:, 1] += slope * along_x
        out[:, 2] += slope * along_y
        slope *= np.float32(-0.5)
        by_a = slope * a
        out[:, 3] += by_a * a
        out[:, 4] += np.float32(2.0) * by_a * b
        out[:, 5] += slope * b * b
        out[:, 6] += (wide - value) * np.float32(1.0 / wing_step)
    return out


def _points(shape: StarShape, u: Pixels, v: Pixels) -> Iterator[tuple[Pixels, Pixels, np.float32]]:
    """Where in the pixels the bell is looked at, and with what weights."""
    if not shape.bell.integrated:
        yield u, v, np.float32(1.0)
        return
    for dy, weight_y in zip(_NODES, _NODE_WEIGHTS, strict=True):
        for dx, weight_x in zip(_NODES, _NODE_WEIGHTS, strict=True):
            yield u + dx, v + dy, weight_x * weight_y


def _bell(
    shape: StarShape, u: Pixels, v: Pixels, weight: np.float32
) -> tuple[Pixels, Pixels, Pixels, Pixels]:
    p, q, r = np.float32(shape.p), np.float32(shape.q), np.float32(shape.r)
    along_x, along_y = p * u + q * v, q * u + r * v
    value, slope = (part.astype(np.float32, copy=False) for part in shape.bell.of(along_x * u + along_y * v))
    return np.float32(weight) * value, np.float32(weight) * slope, along_x, along_y


@dataclass(frozen=True, slots=True)
class StarImage:
    """Drawings of a star on a disc of pixels, for places on a grid within the middle pixel.

    Attributes
    ----------
    shape : StarShape
    dx, dy : ndarray of int, shape (pixels,)
        The disc.
    drawings : ndarray of float32, shape (phases², 3, pixels)
        Value and slopes of a star of unit amplitude.
    """

    shape: StarShape
    dx: NDArray[np.intp]
    dy: NDArray[np.intp]
    drawings: Pixels

    @classmethod
    def of(cls, shape: StarShape, half_px: int) -> StarImage:
        """Draw a star on discs of a radius."""
        steps = np.arange(-half_px, half_px + 1)
        dy, dx = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
        disc = np.hypot(dx, dy) <= half_px + 0.5
        dx, dy = dx[disc], dy[disc]
        phase = ((np.arange(_PHASES) + 0.5) / _PHASES - 0.5).astype(np.float32)
        u = dx.astype(np.float32) - phase[:, None]
        v = dy.astype(np.float32) - phase[:, None]
        return cls(shape, dx, dy, drawn(shape, np.tile(u, (_PHASES, 1)), np.repeat(v, _PHASES, axis=0)))

    def near(self, x: Array, y: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """The drawing nearest to places in the middle pixel, each (n,) in [-0.5, 0.5], and where it is."""
        column, row = (np.clip(np.floor((w + 0.5) * _PHASES), 0, _PHASES - 1).astype(np.intp) for w in (x, y))
        return row * _PHASES + column, (column + 0.5) / _PHASES - 0.5, (row + 0.5) / _PHASES - 0.5
