"""The inspection of each frame of a stack: its level, its noise, and whether it is what it is said to be."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.errors import BadFrame, BadRequest
from mountnav.measuring.calibration.camera_setup import (
    ASSUMABLE,
    Kind,
    difference,
    is_master,
    unknown_beside_known,
)
from mountnav.measuring.calibration.raw_files import FloatImage, RawFile

_BANDS = 16
"""Bands of rows that are looked at, spread over the frame."""
_BAND_ROWS = 64
"""Rows of each."""
_STAR_SIGMA = 8.0
"""Rise of a patch over the scatter of all from which it may be a star."""
_NEIGHBOR_SHARE = 0.2
"""A star's four neighbors have this share of its pixel's light on the mean: hot pixels have none."""
_LEAST_NEIGHBOR_SHARE = 0.06
"""And each of them this: a cosmic ray's track lights two of them only."""
_LOCAL_CELL = 16
"""Side of the cells whose medians are the local level, px: wider than stars."""
_STARS = 12
"""Patches from which a frame shows stars ..."""
_STARS_PER_MPX = 6.0
"""... and per megapixel: cosmic rays of a long dark look like some."""
_MOST_SATURATED = 0.001
"""Share of saturated pixels above which a frame can't serve as a flat."""
_MOST_FULL = 0.9
"""Median over the saturation level above which a flat is no longer linear."""
_LEAST_FLAT_SNR = 10.0
"""Light over the noise per pixel below which a flat is too faint: ten such frames leave 3 % of noise."""
_MOST_DARK_SHARE = 0.5
"""Median over the saturation level above which a bias or dark has seen light."""
_LONGEST_BIAS_S = 2.0
"""A bias of a longer exposure is a dark, s: some cameras state their least exposure."""
_TEMPERATURE_SPREAD_C = 3.0
"""Spread of a stack's temperatures that is noted, degrees."""
_ODD_LEVEL_SIGMA = 5.0
"""A frame of a stack is odd if its level differs by so many noises of a pixel ..."""
_ODD_LEVEL_SPREADS = 10.0
"""... so many scatters of the stack's levels ..."""
_ODD_LEVEL_SHARE = 0.02
"""... and this share of the level: all three, so that steady stacks and drifting ones both pass."""
#: What a flat of one even color has: each of the four phases of a 2 × 2 block on its own.
PHASES = tuple((row, column) for row in (0, 1) for column in (0, 1))


@dataclass(frozen=True, slots=True)
class Inspection:
    """What the inspection of a frame showed.

    Attributes
    ----------
    level_adu : float
        Median.
    phase_levels_adu : tuple of float
        Medians of the pixels of even rows and columns, even rows and odd columns, and so on (`PHASES`).
    noise_adu : float
        Of one pixel, from differences of neighbors of the same color.
    stars : int
        Patches with a star's shape (no hot pixels, hardly any cosmic rays).
    mpx : float
        Megapixels looked at.
    fingerprint : int
        The same for the same pixels.
    """

    level_adu: float
    phase_levels_adu: tuple[float, ...]
    noise_adu: float
    saturated_share: float
    stars: int
    mpx: float
    fingerprint: int

    @property
    def starry(self) -> bool:
        """Whether it shows more stars than cosmic rays could imitate."""
        return self.stars >= max(_STARS, _STARS_PER_MPX * self.mpx)


def inspect_frame(file: RawFile) -> Inspection:
    """Look at bands of rows, all of a frame of up to 1024 rows.

    Raises
    ------
    BadFrame
        Hardly any pixel has a value.
    """
    height = file.facts.height_px
    count = min(_BANDS, max(1, height // _BAND_ROWS))
    rows = min(_BAND_ROWS, height) if count < height // _BAND_ROWS else height // count
    starts = np.linspace(0, height - rows, count).astype(int) // 2 * 2
    bands = [file.rows(int(start), int(start) + rows // 2 * 2) for start in starts]
    whole = np.concatenate(bands)
    finite = np.isfinite(whole)
    if np.count_nonzero(finite) < 0.5 * whole.size:
        raise BadFrame("hardly any pixel has a value", device=file.name, advice="leave it out")
    steps = np.concatenate([(band[:, 2:] - band[:, :-2]).ravel() for band in bands])
    noise = 1.4826 * float(np.nanmedian(np.abs(steps - np.nanmedian(steps)))) / np.sqrt(2.0)
    phases = tuple(float(np.nanmedian(whole[row::2, column::2])) for row, column in PHASES)
    return Inspection(
        level_adu=float(np.nanmedian(whole)),
        phase_levels_adu=phases,
        noise_adu=max(noise, 0.3 * abs(file.scale) if file.dtype[-2] != "f" else 1e-6),
        saturated_share=float(np.count_nonzero(whole >= 0.995 * file.full_adu) / whole.size),
        stars=sum(_stars(band, np.ptp(phases) > 0.02 * abs(max(phases))) for band in bands),
        mpx=whole.size / 1e6,
        fingerprint=zlib.crc32(whole.tobytes()),
    )


def _stars(band: FloatImage, colored: bool) -> int:
    """Count the patches with a star's shape; shadows of dust count against them.

    The rim of a dust shadow rises above its surroundings too, but no more often than it falls below them.
    """
    pixels: FloatImage = np.where(np.isfinite(band), band, np.nanmedian(band)).astype(np.float32)
    if colored:  # whole color blocks have no pattern
        pixels = np.stack([pixels[row::2, column::2] for row, column in PHASES]).mean(axis=0)
    if min(pixels.shape) < 16:
        return 0
    local = _smooth_level(pixels)
    return max(0, _bumps(pixels, local) - 2 * _bumps(-pixels, -local))


def _smooth_level(pixels: FloatImage) -> FloatImage:
    """Medians of small cells, joined straight: a bright pixel must not cast a dark ring, as a mean would."""
    rows, columns = (max(1, length // _LOCAL_CELL) for length in pixels.shape)
    cut = pixels[: rows * _LOCAL_CELL, : columns * _LOCAL_CELL]
    cells = cut.reshape(rows, _LOCAL_CELL, columns, _LOCAL_CELL).swapaxes(1, 2).reshape(rows, columns, -1)
    y = (np.arange(pixels.shape[0]) + 0.5) / _LOCAL_CELL - 0.5
    x = (np.arange(pixels.shape[1]) + 0.5) / _LOCAL_CELL - 0.5
    return np.asarray(_joined(_joined(np.median(cells, axis=2), y).T, x).T, dtype=np.float32)


def _joined(table: NDArray[np.floating], positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Straight lines along the first axis, drawn out beyond its ends."""
    if table.shape[0] == 1:
        return np.repeat(np.asarray(table, dtype=np.float64), positions.size, axis=0)
    first = np.clip(np.floor(positions).astype(int), 0, table.shape[0] - 2)
    share = (positions - first)[:, None]
    return np.asarray(table[first] * (1.0 - share) + table[first + 1] * share)


def _bumps(pixels: FloatImage, local: FloatImage) -> int:
    """Count the patches that rise above their surroundings and share their light with all four neighbors."""
    rise = ndimage.uniform_filter(pixels, 3, mode="mirror") - local
    spread = 1.4826 * float(np.median(np.abs(rise)))
    peaks = (rise > _STAR_SIGMA * max(spread, 1e-6)) & (
        rise == ndimage.maximum_filter(rise, 7, mode="mirror")
    )
    peaks[:2], peaks[-2:], peaks[:, :2], peaks[:, -2:] = False, False, False, False
    y, x = np.nonzero(peaks)
    if y.size == 0:
        return 0
    # the brightest pixel of the 3 × 3 is the center; a hot pixel's neighbors are dark
    offsets = [(j, i) for j in (-1, 0, 1) for i in (-1, 0, 1)]
    around = np.stack([pixels[y + j, x + i] for j, i in offsets])
    best = np.argmax(around, axis=0)
    y, x = y + np.array(offsets)[best, 0], x + np.array(offsets)[best, 1]
    center = pixels[y, x] - local[y, x]
    neighbors = np.stack([pixels[y + j, x + i] - local[y, x] for j, i in ((-1, 0), (1, 0), (0, -1), (0, 1))])
    like_star = neighbors.mean(axis=0) > _NEIGHBOR_SHARE * center
    like_star &= neighbors.min(axis=0) > _LEAST_NEIGHBOR_SHARE * center
    return int(np.count_nonzero(like_star))


def require_alike(files: Sequence[RawFile], kind: Kind) -> list[str]:
    """Refuse frames that were not taken alike, or whose headers call them something else.

    Returns
    -------
    list of str
        Warnings.

    Raises
    ------
    BadRequest
        Two frames differ in size, binning, gain, readout mode, color pattern or camera.
    BadFrame
        A frame is a master already, or of another kind by its header.
    """
    notes: list[str] = []
    lights = []
    usual = _usual(files)
    for file in files:
        if is_master(file.header):
            raise BadFrame(
                "is a master already, no single frame",
                device=file.name,
                advice="give the camera's own frames, or put our masters in the folder as they are",
            )
        said = file.facts.kind
        if said is Kind.LIGHT and kind is not Kind.LIGHT:
            lights.append(file.name)
        elif said is not None and said is not kind:
            raise BadFrame(
                f"its header calls it a {said}, but it was given as a {kind}",
                device=file.name,
                advice=f"leave it out, or give it with --{said}",
            )
        if what := difference(file.facts, usual.facts):
            raise BadRequest(
                f"{what}, as {usual.name}",
                device=file.name,
                advice="stack only frames taken with the same settings; build the others apart",
            )
    require_all_known(files)
    if lights:
        notes.append(
            f"{len(lights)} of the {kind} frames are called light frames by their headers ({lights[0]})"
        )
    return notes


def require_all_known(files: Sequence[RawFile]) -> None:
    """Refuse a stack of which some headers state a setting of the camera and others don't.

    The others may have been taken with another one, and the master would claim what only some of them said.

    Raises
    ------
    BadRequest
        It names the setting, how many headers lack it, and how to state it for them.
    """
    for file in files[1:]:
        found = unknown_beside_known(files[0].facts, file.facts)
        if found is None:
            continue
        name, value, of_other = found
        knowing, silent = (file, files[0]) if of_other else (files[0], file)
        field = ASSUMABLE.get(name)
        count = sum(field is not None and getattr(one.facts, field) is None for one in files) or 1
        raise BadRequest(
            f"its header doesn't give its {name}, as {count} of the {len(files)} frames"
            f" ({knowing.name} says {value})",
            device=silent.name,
            advice=f"if it is the same say so: --assume {name}={value.replace('×', 'x')}"
            if field is not None
            else "stack only frames whose headers tell the same things",
        )


def _usual(files: Sequence[RawFile]) -> RawFile:
    """Return the frame that most others agree with, so that the odd one is named and not the others."""
    if all(difference(file.facts, files[0].facts) is None for file in files):
        return files[0]
    return max(files, key=lambda one: sum(difference(one.facts, other.facts) is None for other in files))


def require_kind(file: RawFile, seen: Inspection, kind: Kind, zero_adu: float | None) -> None:
    """Refuse a frame whose pixels show that it is of another kind.

    Parameters
    ----------
    kind : Kind
        What it is given as.
    zero_adu : float or None
        Level of the bias, if known.

    Raises
    ------
    BadFrame
        A bias or dark with light or stars, a flat that is saturated, too faint or has stars.
    """
    full = file.full_adu
    if kind in (Kind.BIAS, Kind.DARK):
        exposure = file.facts.exposure_s
        if kind is Kind.BIAS and exposure is not None and exposure > _LONGEST_BIAS_S:
            raise BadFrame(
                f"a bias of {exposure:g} s exposure is a dark", device=file.name, advice="give it with --dark"
            )
        if np.isfinite(full) and seen.level_adu > _MOST_DARK_SHARE * full:
            raise BadFrame(
                f"half of its pixels lie above {seen.level_adu:.0f} ADU: this {kind} has seen light",
                device=file.name,
                advice="cover the telescope and take it again",
            )
        if seen.starry:
            raise BadFrame(
                f"it shows {seen.stars} stars: this is no {kind}",
                device=file.name,
                advice="was the shutter open? leave it out",
            )
        return
    if kind is not Kind.FLAT:
        return
    if seen.saturated_share > _MOST_SATURATED or (np.isfinite(full) and seen.level_adu > _MOST_FULL * full):
        raise BadFrame(
            f"{100 * seen.saturated_share:.1f} % of its pixels are saturated, the median is"
            f" {seen.level_adu:.0f} ADU: it can't serve as a flat",
            device=file.name,
            advice="expose flats to about half of the full scale",
        )
    signal = seen.level_adu - (zero_adu if zero_adu is not None else 0.0)
    if signal < _LEAST_FLAT_SNR * seen.noise_adu:
        raise BadFrame(
            f"it holds only {signal:.0f} ADU of light with a noise of {seen.noise_adu:.1f}: too faint",
            device=file.name,
            advice="expose flats to about half of the full scale",
        )
    if seen.starry:
        raise BadFrame(
            f"it shows {seen.stars} stars: they would leave holes in the flat",
            device=file.name,
            advice="leave it out, or use --flat-from-lights",
        )


def require_one_level(files: Sequence[RawFile], seen: Sequence[Inspection], kind: Kind) -> None:
    """Refuse a bias or dark that stands off from the rest of its stack.

    Raises
    ------
    BadFrame
        Its level differs from the middle one by more than five times a pixel's noise, ten times the levels'
        own scatter, and 2 %.
    """
    if len(files) < 3:
        return
    levels = np.array([one.level_adu for one in seen])
    middle = float(np.median(levels))
    spread = 1.4826 * float(np.median(np.abs(levels - middle)))
    noise = float(np.median([one.noise_adu for one in seen]))
    limit = max(_ODD_LEVEL_SIGMA * noise, _ODD_LEVEL_SPREADS * spread, _ODD_LEVEL_SHARE * abs(middle))
    for file, level in zip(files, levels, strict=True):
        if abs(level - middle) > limit:
            raise BadFrame(
                f"its level is {level:.0f} ADU, the other {kind} frames have {middle:.0f}",
                device=file.name,
                advice="light leak, or another setting? leave the frame out",
            )


def temperature_notes(files: Sequence[RawFile], kind: Kind) -> list[str]:
    """Warn of frames of one stack taken at temperatures more than 3° apart."""
    known = [(file.facts.temperature_c, file.name) for file in files if file.facts.temperature_c is not None]
    if len(known) < 2:
        return []
    (low, cold), (high, warm) = min(known), max(known)
    if high - low <= _TEMPERATURE_SPREAD_C:
        return []
    return [f"{kind} frames were taken at {low:.1f} °C ({cold}) to {high:.1f} °C ({warm})"]


def without_repeats(
    files: Sequence[RawFile], seen: Sequence[Inspection]
) -> tuple[list[RawFile], list[Inspection], list[str]]:
    """Drop copies of the same frame: they would make the noise look smaller than it is."""
    first: dict[int, RawFile] = {}
    kept_files, kept, notes = [], [], []
    for file, one in zip(files, seen, strict=True):
        if one.fingerprint in first:
            notes.append(f"{file.name} is a copy of {first[one.fingerprint].name}: left out")
            continue
        first[one.fingerprint] = file
        kept_files.append(file)
        kept.append(one)
    return kept_files, kept, notes


def is_colored(files: Sequence[RawFile], seen: Sequence[Inspection]) -> bool:
    """Whether flats are of a color mosaic: by card, or by levels that stand apart in all of them."""
    if any(file.facts.pattern for file in files):
        return True
    stands_apart = 0
    for one in seen:
        levels: NDArray[np.float64] = np.array(one.phase_levels_adu)
        stands_apart += bool(np.ptp(levels) > 0.05 * one.level_adu)
    return stands_apart == len(seen)
