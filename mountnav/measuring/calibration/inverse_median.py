"""The inverse median filter: even brightness for frames that have no flat [S23 §0.1]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.errors import BadFrame, BadRequest
from mountnav.frames import Frame
from mountnav.measuring.calibration.calibration import full_level, keep_full
from mountnav.measuring.calibration.raw_files import FloatImage

Array = NDArray[np.float64]

_LEAST_GROUP = 3
"""Frames from which a median parts what they share from what is each one's own."""
_BAND_ROWS = 256
"""Rows that are worked on together: bounds the memory."""
_CLIP_ROUNDS = 8
"""Rounds at most in which a cell's stars are clipped."""
_CELL_ROUNDS = 6
"""Rounds at most in which cells of sources are left out of the surface."""
_LEAST_CELL_SHARE = 0.25
"""Share of the cells that must have a value."""
_SAME_PLACE_SHARE = 0.3
"""Share of the source cells that lie on the same positions in all frames from which they see the same
field."""
_LEAST_RESPONSE = 0.05
"""Response below which a corner has no light to divide by."""


@dataclass(frozen=True, slots=True)
class InverseMedianSettings:
    """How the large-scale background is estimated.

    Attributes
    ----------
    cells : int
        Mesh cells along the longer side.
    least_cell_px : int
        A cell is no smaller, so that stars never fill it.
    median_cells : int
        Side of the wide median filter, in cells; odd.
    source_sigma : float
        Cells that stand so far above a smooth surface belong to a nebula, a galaxy or a crowd of stars; they
        are filled from the surface instead of being taken for sky.
    """

    cells: int = 40
    least_cell_px: int = 24
    median_cells: int = 5
    source_sigma: float = 3.0


@dataclass(frozen=True, slots=True)
class Mesh:
    """A frame's sky on a coarse mesh.

    Attributes
    ----------
    sky_adu : ndarray, shape (rows, columns)
        Clipped medians of the cells, sources filled in, after the wide median filter.
    sources : ndarray of bool, shape (rows, columns)
        Cells that were filled.
    width_px, height_px : int
        Of the frame.
    """

    sky_adu: Array
    sources: NDArray[np.bool_]
    width_px: int
    height_px: int


@dataclass(frozen=True, slots=True)
class EvenedFrame:
    """A frame with even brightness, and what was taken out.

    Attributes
    ----------
    frame : Frame
        float32; the sky's median level is kept.
    additive_adu : ndarray, shape (rows, columns)
        The gradient that was subtracted, on the mesh; its median is 0.
    response : ndarray, shape (rows, columns)
        What the frame was divided by, on the mesh; its median is 1.
    """

    frame: Frame
    additive_adu: Array
    response: Array


@dataclass(frozen=True, slots=True)
class InverseMedian:
    """The multiplicative part that a group of frames has in common, and how to even out each of them.

    Attributes
    ----------
    response : ndarray, shape (rows, columns)
        On the mesh; median 1. All ones if the zero level isn't known.
    zero_adu : float or None
        Level of a pixel without light.
    frames : int
        How many frames it comes from.
    notes : tuple of str
        What the user should know.
    """

    response: Array
    width_px: int
    height_px: int
    zero_adu: float | None
    frames: int
    notes: tuple[str, ...]
    settings: InverseMedianSettings

    def response_rows(self, first: int, stop: int) -> FloatImage:
        """Return rows of the response in full resolution, shape (stop - first, width)."""
        return _spread(self.response, first, stop, self.width_px, self.height_px)

    def evened(self, frame: Frame) -> EvenedFrame:
        """Even out a frame: subtract its own gradient, divide by the response in common.

        Parameters
        ----------
        frame : Frame
            Of the group's size.

        Raises
        ------
        BadFrame
            It has another size, or hardly any pixels.
        """
        if (frame.width_px, frame.height_px) != (self.width_px, self.height_px):
            raise BadFrame(
                f"it has {frame.width_px} × {frame.height_px} pixels, the group"
                f" {self.width_px} × {self.height_px}",
                device=frame.source,
                advice="even out frames of one camera and binning together",
            )
        mesh = background_mesh(frame, self.settings)
        zero = self.zero_adu or 0.0
        level = float(np.median(mesh.sky_adu))
        rest = mesh.sky_adu - zero - (level - zero) * self.response
        # a nebula is no gradient: only the lowest orders of what is left are taken away
        additive = rest if self.zero_adu is None else _surface(rest, ~mesh.sources, _GRADIENT_TERMS, 3.0)[0]
        additive = additive - np.median(additive)
        full = full_level(frame)
        evened = np.empty(frame.pixels.shape, dtype=np.float32)
        for first in range(0, self.height_px, _BAND_ROWS):
            stop = min(first + _BAND_ROWS, self.height_px)
            raw = frame.pixels[first:stop].astype(np.float32)
            raw -= np.float32(zero) + _spread(additive, first, stop, self.width_px, self.height_px)
            raw /= self.response_rows(first, stop)
            raw += np.float32(zero)
            evened[first:stop] = raw
        saturation = keep_full(evened, frame.pixels, full)
        done = replace(frame, pixels=evened, saturation_adu=saturation)
        return EvenedFrame(done, additive, self.response)


def inverse_median(
    frames: Frame | Sequence[Frame],
    *,
    zero_adu: float | None = None,
    settings: InverseMedianSettings | None = None,
) -> InverseMedian:
    """Estimate how unevenly the optics light the chip, from the sky of the frames themselves.

    See `from_meshes`.

    Parameters
    ----------
    frames : Frame or sequence of Frame
        One frame, or a group of frames of different or shifted fields.
    zero_adu : float, optional
        Level of a pixel without light (bias); 0 for calibrated frames.

    Raises
    ------
    BadRequest
        No frames, or frames of different sizes.
    """
    group = [frames] if isinstance(frames, Frame) else list(frames)
    settings = settings or InverseMedianSettings()
    return from_meshes(
        [background_mesh(frame, settings) for frame in group], zero_adu=zero_adu, settings=settings
    )


def from_meshes(
    meshes: Sequence[Mesh], *, zero_adu: float | None, settings: InverseMedianSettings | None = None
) -> InverseMedian:
    """Part the sky's unevenness into a response in common and each frame's own gradient.

    Vignetting is the same for all frames of a group and scales with the sky; moonlight and glow are each
    frame's own. So the median over the frames of the normalized skies is the response (at least three frames
    of different fields). One frame, or a group that sees the same field, can't tell them apart: there the
    part that is symmetric about the center and falls outwards is taken for vignetting, the rest for gradient.
    Where the zero level isn't known, no share can be known either: all is taken as additive.

    Parameters
    ----------
    zero_adu : float or None
        Level without light; None: not known.

    Raises
    ------
    BadRequest
        No frames, or frames of different sizes, or a sky that isn't above the zero level.
    """
    settings = settings or InverseMedianSettings()
    if not meshes:
        raise BadRequest("the inverse median filter needs at least one frame")
    first = meshes[0]
    if any((mesh.width_px, mesh.height_px) != (first.width_px, first.height_px) for mesh in meshes):
        raise BadRequest(
            "the frames of the group have different sizes", advice="take frames of one camera and binning"
        )
    notes: list[str] = []
    if zero_adu is None:
        notes.append("the zero level is unknown: all unevenness is subtracted, fluxes are not corrected")
        response = np.ones_like(first.sky_adu)
    else:
        shares = np.stack([mesh.sky_adu - zero_adu for mesh in meshes])
        levels = np.median(shares, axis=(1, 2))
        if (levels <= 0).any() or (shares <= _LEAST_RESPONSE * levels[:, None, None]).any():
            raise BadRequest(
                f"the sky isn't everywhere above the zero level of {zero_adu:g} ADU",
                advice="the zero level is too high, or a frame has no sky",
            )
        shares = shares / levels[:, None, None]
        if len(meshes) >= _LEAST_GROUP and not _same_field(meshes):
            response = np.median(shares, axis=0)
        else:
            why = "fewer than three frames" if len(meshes) < _LEAST_GROUP else "the frames see the same field"
            notes.append(f"{why}: only vignetting symmetric about the center is taken out as such")
            known = ~np.any([mesh.sources for mesh in meshes], axis=0)
            response = _symmetric(np.median(shares, axis=0), known)
    response = response / np.median(response)
    return InverseMedian(
        response, first.width_px, first.height_px, zero_adu, len(meshes), tuple(notes), settings
    )


def background_mesh(frame: Frame, settings: InverseMedianSettings | None = None) -> Mesh:
    """Estimate a frame's sky on a coarse mesh, without its sources.

    Raises
    ------
    BadFrame
        Hardly any pixel has a value.
    """
    settings = settings or InverseMedianSettings()
    height, width = frame.pixels.shape
    cell = max(settings.least_cell_px, round(max(height, width) / settings.cells))
    rows, columns = max(3, round(height / cell)), max(3, round(width / cell))
    bottom = np.linspace(0, height, rows + 1).astype(int)
    left = np.linspace(0, width, columns + 1).astype(int)
    sky, spread = np.full((rows, columns), np.nan), np.full((rows, columns), np.nan)
    whole = frame.pixels.dtype.kind in "ui"
    for row in range(rows):
        band = frame.pixels[bottom[row] : bottom[row + 1]].astype(np.float32)
        for column in range(columns):
            values = band[:, left[column] : left[column + 1]].ravel()
            sky[row, column], spread[row, column] = _clipped_median(values, whole)
    if np.count_nonzero(np.isfinite(sky)) < _LEAST_CELL_SHARE * sky.size:
        raise BadFrame(
            "hardly any pixel has a value", device=frame.source, advice="look at how it was processed"
        )
    sources = ~np.isfinite(sky)
    filled, high = _surface(np.where(sources, 0.0, sky), ~sources, _SKY_TERMS, settings.source_sigma)
    sources |= high
    sky = np.where(sources, filled, sky)
    wide = ndimage.median_filter(sky - filled, size=settings.median_cells, mode="nearest") + filled
    return Mesh(wide, sources, width, height)


def _clipped_median(values: FloatImage, whole: bool) -> tuple[float, float]:
    """Median and spread of a cell without its stars; whole numbers are spread over their step first."""
    values = values[np.isfinite(values)]
    if values.size < 16:
        return np.nan, np.nan
    if whole:
        # a fixed pattern, not noise: the same frame gives the same mesh
        values = values + (np.arange(values.size, dtype=np.float32) * np.float32(0.6180339887) % 1.0 - 0.5)
    values = np.sort(values)
    low, high = 0, values.size
    for _ in range(_CLIP_ROUNDS):
        middle = float(values[(low + high) // 2])
        # stars only add: the lower side gives the noise
        sigma = middle - float(values[low + int(0.1587 * (high - low))])
        new = (
            int(np.searchsorted(values, middle - 4.0 * sigma)),
            int(np.searchsorted(values, middle + 2.5 * sigma)),
        )
        if new == (low, high) or new[1] - new[0] < 8:
            break
        low, high = new
    return float(values[(low + high) // 2]), sigma


def _monomials(order: int) -> tuple[tuple[int, int], ...]:
    return tuple((i, j) for i in range(order + 1) for j in range(order + 1 - i))


_GRADIENT_TERMS = _monomials(2)
"""Exponents (x, y) of the surface that a frame's own gradient is: quadratic, so that no nebula fits it."""
_SKY_TERMS = _monomials(4)
"""Exponents of the surface from which sources stand off: of degree 4, which holds vignetting."""


def _surface(
    mesh: Array, known: NDArray[np.bool_], terms: tuple[tuple[int, int], ...], sigma: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Fit a low polynomial to the cells known, robustly; return it and the cells that stand above it."""
    rows, columns = mesh.shape
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    basis = np.stack([x**i * y**j for i, j in terms], axis=-1)
    use = known.copy()
    high = np.zeros(mesh.shape, dtype=bool)
    for _ in range(_CELL_ROUNDS):
        if use.sum() < 2 * len(terms):
            use = known.copy()
            break
        fitted = basis @ np.linalg.lstsq(basis[use], mesh[use], rcond=None)[0]
        rest = mesh - fitted
        spread = 1.4826 * float(np.median(np.abs(rest[use])))
        core = known & (rest > sigma * max(spread, 1e-9))
        # a lone high cell is noise; the rim of a wide source lies below the limit, so patches grow by one
        high = ndimage.binary_dilation(
            ndimage.binary_opening(core, np.ones((2, 2), dtype=bool)), np.ones((3, 3), dtype=bool)
        )
        low = rest < -2.0 * sigma * max(spread, 1e-9)
        new = known & ~high & ~low & ~core
        if (new == use).all():
            break
        use = new
    fitted = basis @ np.linalg.lstsq(basis[use], mesh[use], rcond=None)[0]
    return fitted, high


def _symmetric(mesh: Array, known: NDArray[np.bool_]) -> Array:
    """Fit 1 + a r² + b r⁴ with a free slope, and return the part that is symmetric and falls outwards."""
    rows, columns = mesh.shape
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    aspect = rows / columns
    r2 = (x**2 + (aspect * y) ** 2) / (1.0 + aspect**2)
    basis = np.stack([np.ones_like(x), x, y, r2, r2**2], axis=-1)
    use = known.copy()
    for _ in range(_CELL_ROUNDS):
        terms = np.linalg.lstsq(basis[use], mesh[use], rcond=None)[0]
        rest = mesh - basis @ terms
        limit = 3.0 * 1.4826 * float(np.median(np.abs(rest[use])))
        new = known & (np.abs(rest) <= max(limit, 1e-9))
        if new.sum() < 0.3 * use.size or (new == use).all():
            break
        use = new
    fall = terms[3] * r2 + terms[4] * r2**2
    response = 1.0 + fall / max(float(terms[0]), 1e-9)
    outwards = bool(terms[3] + terms[4] < 0.0) and bool((response > _LEAST_RESPONSE).all())
    return response if outwards else np.ones_like(mesh)


def _same_field(meshes: Sequence[Mesh]) -> bool:
    """Whether sources lie on the same cells in all frames: the group wasn't moved between exposures."""
    masks = np.stack([mesh.sources for mesh in meshes])
    ever = masks.any(axis=0).sum()
    always = masks.all(axis=0).sum()
    return bool(always >= 4 and always > _SAME_PLACE_SHARE * ever)


def _spread(mesh: Array, first: int, stop: int, width_px: int, height_px: int) -> FloatImage:
    """Rows of a mesh in full resolution, by cubic splines through the cells' centers."""
    if mesh.min() == mesh.max():
        return np.full((stop - first, width_px), mesh.flat[0], dtype=np.float32)
    rows, columns = mesh.shape
    y = (np.arange(first, stop) + 0.5) * rows / height_px - 0.5
    x = (np.arange(width_px) + 0.5) * columns / width_px - 0.5
    # separable: first along the columns of the mesh, then along its rows
    tall = _splined(mesh, y)
    return np.ascontiguousarray(_splined(tall.T, x).T, dtype=np.float32)


def _splined(table: Array, positions: Array) -> Array:
    """Spline along the first axis, straight beyond the outermost centers."""
    from scipy.interpolate import CubicSpline

    count = table.shape[0]
    spline = CubicSpline(np.arange(count), table, axis=0, bc_type="natural")
    inside = np.clip(positions, 0.0, count - 1.0)
    values = spline(inside)
    beyond = (positions - inside)[:, None]
    slopes = np.where(beyond < 0, table[1] - table[0], table[-1] - table[-2])
    return np.asarray(values + beyond * slopes)


__all__ = [
    "EvenedFrame",
    "InverseMedian",
    "InverseMedianSettings",
    "Mesh",
    "background_mesh",
    "from_meshes",
    "inverse_median",
]
