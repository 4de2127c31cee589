"""Master bias, darks and flats built from stacks of frames, or flats from light frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadFrame, BadRequest
from mountnav.frames import Frame
from mountnav.measuring.calibration.bad_pixels import HOT_SIGMA, BadPixel, mark_dead, mark_hot, mark_noisy
from mountnav.measuring.calibration.calibration import Calibration
from mountnav.measuring.calibration.camera_setup import CameraSetup, Kind, difference, steps_done
from mountnav.measuring.calibration.inspection import (
    PHASES,
    Inspection,
    inspect_frame,
    is_colored,
    require_alike,
    require_kind,
    require_one_level,
    temperature_notes,
    without_repeats,
)
from mountnav.measuring.calibration.inverse_median import InverseMedianSettings, background_mesh, from_meshes
from mountnav.measuring.calibration.masters import Master, MasterFacts, master_name, read_master, write_master
from mountnav.measuring.calibration.raw_files import FloatImage, RawFile
from mountnav.measuring.calibration.stacking import (
    LEAST_FOR_NOISY,
    Stacked,
    StackSettings,
    gain_e_adu,
    read_noise_adu,
    stack,
)

T = TypeVar("T")

_BAND_ROWS = 256
"""Rows that are worked on together: bounds the memory."""
_MEDIAN_SAMPLE = 16_000_000
"""Pixels at most whose median is taken: bounds the memory, and is sure to 0.03 % of the scatter."""


@dataclass(slots=True)
class BuildContext:
    """What a build has on its table: scratch files, masters done so far, notes."""

    out: Path
    scratch: Path
    settings: StackSettings
    older: tuple[Master, ...]
    ready: list[Master] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    flags: list[Callable[[NDArray[np.uint8]], None]] = field(default_factory=list)
    kinds_seen: BadPixel = field(default_factory=lambda: BadPixel(0))
    read_noise: float | None = None
    gain: float | None = None

    def sheet(self, name: str, facts: CameraSetup, dtype: str = ">f4") -> tuple[Path, FloatImage]:
        """Give a new array on disk, shape (height, width)."""
        path = self.scratch / f"{name}.sheet"
        shape = (facts.height_px, facts.width_px)
        return path, np.memmap(path, dtype=dtype, mode="w+", shape=shape)

    def finish(self, numbers: Path, about: MasterFacts) -> Master:
        """Write a master beside the scratch files; it moves to its place when all are done."""
        folder = self.scratch / "masters"
        folder.mkdir(exist_ok=True)
        path = folder / master_name(about)
        write_master(path, numbers, about)
        master = read_master(path)
        if master is None:
            raise BadFrame(
                "the master just written can't be read", device=path.name, advice="is the disk full?"
            )
        self.ready = [one for one in self.ready if one.path != path] + [master]
        return master

    def fitting(self, kind: Kind, facts: CameraSetup) -> list[Master]:
        """Masters of this build first, then older ones of the folder, that fit the camera's settings."""
        return [
            one
            for one in (*reversed(self.ready), *self.older)
            if one.kind is kind and difference(facts, one.facts) is None
        ]


def inspected_frames(
    bench: BuildContext, files: Sequence[RawFile], kind: Kind, zero_adu: float | None
) -> tuple[list[RawFile], list[Inspection]]:
    """Look at all frames of a stack, refuse what doesn't belong there, and leave copies out."""
    bench.notes += require_alike(files, kind)
    seen = [inspect_frame(file) for file in files]
    for file, one in zip(files, seen, strict=True):
        require_kind(file, one, kind, zero_adu)
    kept_files, kept, notes = without_repeats(files, seen)
    bench.notes += notes
    return kept_files, kept


def note_if_few(bench: BuildContext, files: Sequence[RawFile], what: str) -> None:
    """Note that a stack of one or two frames is a poor one."""
    if len(files) == 1:
        bench.notes.append(f"{what} from one frame: its noise goes into every frame, cosmic rays stay in it")
    elif len(files) == 2:
        bench.notes.append(f"{what} from two frames: five or more are better")


def master_facts(
    kind: Kind,
    facts: CameraSetup,
    files: Sequence[RawFile],
    done: Stacked,
    seen: Sequence[Inspection],
    bench: BuildContext,
) -> MasterFacts:
    """Tell of a stack what all kinds of masters have in common; unit and level are still to be filled in."""
    temperatures = [file.facts.temperature_c for file in files if file.facts.temperature_c is not None]
    method = f"clipped {bench.settings.method}, {bench.settings.kappa_sigma:g} sigma"
    return MasterFacts(
        kind=kind,
        facts=facts,
        files=tuple(file.name for file in files),
        zero_free=False,
        unit="ADU",
        method="single frame" if len(files) == 1 else method,
        read_noise_adu=bench.read_noise,
        rejected_share=done.rejected_share,
        coldest_c=min(temperatures, default=None),
        warmest_c=max(temperatures, default=None),
    )


def at_one_level(seen: Sequence[Inspection]) -> Callable[[int, int, FloatImage], FloatImage]:
    """Bring frames whose zero drifts to their mean level, so that the drift isn't taken for outliers."""
    levels = np.array([one.level_adu for one in seen])
    shifts = (np.sort(levels).mean() - levels).astype(np.float32)

    def prepare(number: int, first: int, pixels: FloatImage) -> FloatImage:
        pixels += shifts[number]
        return pixels

    return prepare


def common_facts(files: Sequence[RawFile]) -> CameraSetup:
    """Settings of a stack: what any of its headers states, mean exposure and temperature."""
    first = files[0].facts
    every = [file.facts for file in files]
    exposures = sorted(file.facts.exposure_s for file in files if file.facts.exposure_s is not None)
    temperatures = sorted(file.facts.temperature_c for file in files if file.facts.temperature_c is not None)
    return replace(
        first,
        binning=_told(one.binning for one in every),
        gain=_told(one.gain for one in every),
        offset=_told(one.offset for one in every),
        gain_e_adu=_told(one.gain_e_adu for one in every),
        readout=_told(one.readout for one in every),
        pattern=_told(one.pattern for one in every),
        instrument=_told(one.instrument for one in every),
        filter=_told(one.filter for one in every),
        exposure_s=float(np.mean(exposures)) if exposures else None,
        temperature_c=round(float(np.mean(temperatures)), 2) if temperatures else None,
        kind=None,
    )


def _told(values: Iterable[T | None]) -> T | None:
    return next((value for value in values if value is not None), None)


def row_bands(facts: CameraSetup) -> list[slice]:
    """Give the frame's rows in bands that are worked on one after the other."""
    height = facts.height_px
    return [slice(first, min(first + _BAND_ROWS, height)) for first in range(0, height, _BAND_ROWS)]


def median_of(sheet: FloatImage) -> float:
    """Return the median of the finite pixels, of a part of the rows in a large frame."""
    step = 1 + (sheet.size - 1) // _MEDIAN_SAMPLE
    rows = np.asarray(sheet[::step], dtype=np.float32)
    finite = rows[np.isfinite(rows)]
    return float(np.median(finite)) if finite.size else float("nan")


_SAME_EXPOSURE = 0.01
"""Relative difference up to which two exposure times are the same: shutters and rounded cards differ by
less."""
_TEMPERATURE_GAP_C = 5.0
"""A gap of this many degrees parts darks of one exposure: dark current doubles every 6° or so."""


def build_bias(bench: BuildContext, files: Sequence[RawFile]) -> None:
    """Stack bias frames; raises BadFrame or BadRequest naming the frame that doesn't belong there."""
    kept, seen = inspected_frames(bench, files, Kind.BIAS, None)
    require_one_level(kept, seen, Kind.BIAS)
    bench.notes += temperature_notes(kept, Kind.BIAS)
    note_if_few(bench, kept, "bias")
    facts = common_facts(kept)
    numbers, sheet = bench.sheet("bias", facts)
    scatter_path, scatter = bench.sheet("scatter", facts)
    done = stack(kept, sheet, settings=bench.settings, prepare=at_one_level(seen), scatter=scatter)
    bench.read_noise = read_noise_adu(kept)
    bench.finish(
        numbers,
        replace(
            master_facts(Kind.BIAS, facts, kept, done, seen, bench),
            unit="ADU",
            level_adu=median_of(sheet),
            noise_adu=bench.read_noise or float(np.median([one.noise_adu for one in seen])),
        ),
    )
    del scatter
    if len(kept) >= LEAST_FOR_NOISY:
        shape = (facts.height_px, facts.width_px)
        bench.kinds_seen |= BadPixel.NOISY
        bench.flags.append(
            lambda bad: mark_noisy(bad, np.memmap(scatter_path, dtype=">f4", mode="r", shape=shape))
        )


def build_darks(bench: BuildContext, files: Sequence[RawFile]) -> None:
    """Stack darks, each exposure and temperature apart, and turn them into ADU per second if a bias fits.

    Raises BadFrame or BadRequest naming the frame that doesn't belong there.
    """
    bench.notes += require_alike(files, Kind.DARK)
    without = next((file for file in files if not file.facts.exposure_s), None)
    if without is not None:
        raise BadFrame(
            "its header gives no exposure time, or zero",
            device=without.name,
            advice="a dark needs EXPTIME; a frame of no exposure is a bias (--bias)",
        )
    groups = _dark_groups(files)
    for group in groups:
        _build_dark(bench, group)


def _build_dark(bench: BuildContext, files: Sequence[RawFile]) -> None:
    facts = common_facts(files)
    exposure = facts.exposure_s or 1.0
    what = f"dark of {exposure:g} s"
    biases = bench.fitting(Kind.BIAS, facts)
    bias = biases[0] if biases else None
    kept, seen = inspected_frames(bench, files, Kind.DARK, None if bias is None else bias.level_adu)
    require_one_level(kept, seen, Kind.DARK)
    bench.notes += temperature_notes(kept, Kind.DARK)
    note_if_few(bench, kept, what)
    number = len(bench.ready)
    numbers, sheet = bench.sheet(f"dark{number}", facts)
    done = stack(kept, sheet, settings=bench.settings, prepare=at_one_level(seen))
    noise = read_noise_adu(kept) or float(np.median([one.noise_adu for one in seen]))
    if bias is None:
        bench.notes.append(
            f"{what}: no bias is given, so it serves only frames of {exposure:g} s and can't be scaled"
        )
    else:
        zero = bias.pixels()
        for rows in row_bands(facts):
            sheet[rows] = (sheet[rows] - zero[rows]) / np.float32(exposure)
    level = median_of(sheet)
    if bias is not None and level * exposure < -3.0 * noise / np.sqrt(len(kept)) - 2.0:
        bench.notes.append(
            f"{what} lies {-level * exposure:.1f} ADU below the bias: do they belong together?"
        )
    bench.finish(
        numbers,
        replace(
            master_facts(Kind.DARK, facts, kept, done, seen, bench),
            zero_free=bias is not None,
            unit="ADU" if bias is None else "ADU/s",
            level_adu=level,
            noise_adu=noise,
            corrected_by=() if bias is None else (bias.name,),
        ),
    )
    least = HOT_SIGMA * noise / (1.0 if bias is None else exposure)
    bench.kinds_seen |= BadPixel.HOT
    shape = (facts.height_px, facts.width_px)
    bench.flags.append(
        lambda bad: mark_hot(bad, np.memmap(numbers, dtype=">f4", mode="r", shape=shape), least)
    )


def _dark_groups(files: Sequence[RawFile]) -> list[list[RawFile]]:
    """Part darks by exposure (1 %) and by gaps in temperature (5°)."""
    ordered = sorted(files, key=lambda file: (file.facts.exposure_s or 0.0, file.name))
    by_exposure: list[list[RawFile]] = []
    for file in ordered:
        last = by_exposure[-1][0].facts.exposure_s if by_exposure else None
        if last is not None and (file.facts.exposure_s or 0.0) <= (1.0 + _SAME_EXPOSURE) * last:
            by_exposure[-1].append(file)
        else:
            by_exposure.append([file])
    groups: list[list[RawFile]] = []
    for some in by_exposure:
        known = sorted(
            (file for file in some if file.facts.temperature_c is not None),
            key=lambda file: (file.facts.temperature_c or 0.0, file.name),
        )
        unknown = [file for file in some if file.facts.temperature_c is None]
        parts: list[list[RawFile]] = []
        for file in known:
            last = parts[-1][-1].facts.temperature_c if parts else None
            if last is not None and (file.facts.temperature_c or 0.0) - last <= _TEMPERATURE_GAP_C:
                parts[-1].append(file)
            else:
                parts.append([file])
        if unknown and parts:
            parts[0] += unknown
        elif unknown:
            parts = [unknown]
        groups += [sorted(part, key=lambda file: (file.name, str(file.path))) for part in parts]
    return groups


_DARK_NEAR_C = 10.0
"""A dark serves a flat up to this many degrees apart: flats are short and bright, so that its error hardly
counts."""
_LEAST_RESPONSE = 0.05
"""Response below which a corner has no light to divide by."""


def build_flats(bench: BuildContext, files: Sequence[RawFile]) -> None:
    """Stack flats, each filter apart; BadFrame or BadRequest names a frame that doesn't belong there."""
    bench.notes += require_alike(files, Kind.FLAT)
    groups: dict[str, list[RawFile]] = {}
    for file in files:
        groups.setdefault((file.facts.filter or "").casefold(), []).append(file)
    for key in sorted(groups):
        _build_flat(bench, groups[key])


def _build_flat(bench: BuildContext, files: Sequence[RawFile]) -> None:
    facts = common_facts(files)
    what = f"flat of filter {facts.filter}" if facts.filter else "flat"
    biases = bench.fitting(Kind.BIAS, facts)
    bias = biases[0] if biases else None
    darks = bench.fitting(Kind.DARK, facts)
    kept, seen = inspected_frames(bench, files, Kind.FLAT, None if bias is None else bias.level_adu)
    bench.notes += temperature_notes(kept, Kind.FLAT)
    note_if_few(bench, kept, what)
    zeros = [_zero_of_flat(file, bias, darks) for file in kept]
    if any(zero.master is None for zero in zeros):
        bench.notes.append(f"{what}: no bias fits, so the flat is too even; build it again with --bias")
    colored = is_colored(kept, seen)
    factors = []
    for zero, one in zip(zeros, seen, strict=True):
        levels = np.array(one.phase_levels_adu) - zero.level_adu
        if not colored:
            levels = np.full(4, one.level_adu - zero.level_adu)
        factors.append((1.0 / levels).astype(np.float32))

    def prepare(number: int, first: int, pixels: FloatImage) -> FloatImage:
        zeros[number].subtract(first, pixels)
        for (row, column), factor in zip(PHASES, factors[number], strict=True):
            pixels[(row - first) % 2 :: 2, column::2] *= factor
        return pixels

    number = len(bench.ready)
    numbers, sheet = bench.sheet(f"flat{number}", facts)
    done = stack(kept, sheet, settings=bench.settings, prepare=prepare)
    _normalize(sheet, facts, colored)
    light = [one.level_adu - zero.level_adu for one, zero in zip(seen, zeros, strict=True)]
    if bias is not None:
        noise = bench.read_noise or bias.read_noise_adu or bias.noise_adu or 0.0
        bench.gain = gain_e_adu(kept, bias.level_adu or 0.0, noise)
    bench.finish(
        numbers,
        replace(
            master_facts(Kind.FLAT, facts, kept, done, seen, bench),
            zero_free=all(zero.master is not None for zero in zeros),
            unit="response",
            level_adu=float(np.median(light)),
            noise_adu=float(np.median([one.noise_adu for one in seen])),
            gain_e_adu=bench.gain,
            colored=colored,
            corrected_by=tuple(sorted({name for zero in zeros for name in zero.names()})),
        ),
    )
    bench.kinds_seen |= BadPixel.DEAD
    shape = (facts.height_px, facts.width_px)
    bench.flags.append(lambda bad: mark_dead(bad, np.memmap(numbers, dtype=">f4", mode="r", shape=shape)))


@dataclass(frozen=True, slots=True)
class _Zero:
    """What a flat shows without light: a bias and a scaled dark, or a dark of its own exposure."""

    master: Master | None
    dark: Master | None
    exposure_s: float

    @property
    def level_adu(self) -> float:
        """Median of what is subtracted."""
        level = 0.0 if self.master is None else self.master.level_adu or 0.0
        return level + (0.0 if self.dark is None else self.exposure_s * (self.dark.level_adu or 0.0))

    def names(self) -> list[str]:
        """Files used."""
        return [one.name for one in (self.master, self.dark) if one is not None]

    def subtract(self, first: int, pixels: FloatImage) -> None:
        """Take it off a band, in place."""
        rows = slice(first, first + pixels.shape[0])
        if self.master is not None:
            pixels -= self.master.pixels()[rows]
        if self.dark is not None:
            pixels -= np.float32(self.exposure_s) * self.dark.pixels()[rows]


def _zero_of_flat(file: RawFile, bias: Master | None, darks: Sequence[Master]) -> _Zero:
    exposure = file.facts.exposure_s or 0.0
    for dark in darks:  # a flat-dark that holds the bias is the best there is
        if (
            not dark.zero_free
            and exposure > 0
            and abs((dark.facts.exposure_s or 0.0) - exposure) <= _SAME_EXPOSURE * exposure
        ):
            return _Zero(dark, None, exposure)
    free = [dark for dark in darks if dark.zero_free and _near_in_temperature(file.facts, dark.facts)]
    if bias is None or not free:
        return _Zero(bias, None, exposure)
    longest = max(free, key=lambda dark: dark.facts.exposure_s or 0.0)
    return _Zero(bias, longest, exposure)


def _near_in_temperature(one: CameraSetup, other: CameraSetup) -> bool:
    if one.temperature_c is None or other.temperature_c is None:
        return True
    return abs(one.temperature_c - other.temperature_c) <= _DARK_NEAR_C


def build_from_lights(bench: BuildContext, files: Sequence[RawFile], zero_adu: float | None) -> None:
    """Make a flat of light frames, each filter apart, by the inverse median filter.

    Bias and dark are taken off as far as they fit; `zero_adu` is for frames without them.
    """
    bench.notes += require_alike(files, Kind.LIGHT)
    groups: dict[str, list[RawFile]] = {}
    for file in files:
        groups.setdefault((file.facts.filter or "").casefold(), []).append(file)
    for key in sorted(groups):
        group = groups[key]
        facts = common_facts(group)
        settings = InverseMedianSettings()
        zeros = (*bench.fitting(Kind.BIAS, facts), *bench.fitting(Kind.DARK, facts))
        meshes, used = [], set[str]()
        for file in group:
            frame, names = _without_zero(file, Calibration(bench.out, zeros), zero_adu)
            used.update(names)
            meshes.append(background_mesh(frame, settings))
        found = from_meshes(meshes, zero_adu=0.0, settings=settings)
        bench.notes += found.notes
        numbers, sheet = bench.sheet(f"lights{len(bench.ready)}", facts)
        for rows in row_bands(facts):
            sheet[rows] = found.response_rows(rows.start, rows.stop)
        if float(sheet.min()) < _LEAST_RESPONSE:
            raise BadFrame(
                "the sky of the light frames falls to zero at a corner",
                device=group[0].name,
                advice="use real flats, or check the zero level",
            )
        _normalize(sheet, facts, False)
        bench.finish(
            numbers,
            MasterFacts(
                kind=Kind.FLAT,
                facts=facts,
                files=tuple(file.name for file in group),
                zero_free=True,
                unit="response",
                method="inverse median filter",
                level_adu=float(np.median([np.median(mesh.sky_adu) for mesh in meshes])),
                from_lights=True,
                corrected_by=tuple(sorted(used)),
            ),
        )


def _without_zero(
    file: RawFile, calibration: Calibration, zero_adu: float | None
) -> tuple[Frame, tuple[str, ...]]:
    """Take what is no light off a light frame, by masters as far as they fit; give their names too."""
    if "F" in steps_done(file.header):
        raise BadFrame("it was already divided by a flat", device=file.name, advice="give raw frames")
    raw = Frame(
        pixels=file.rows(0, file.facts.height_px),
        source=file.name,
        header=file.header,
        mosaic=file.facts.pattern is not None,  # untouched, so masters may go on it
    )
    frame, done = calibration.applied(raw)
    zero = done.zero_adu if done.zero_adu is not None else zero_adu
    if zero is None:
        raise BadRequest(
            "light frames make a flat only if the level of a pixel without light is known",
            device=file.name,
            advice="give --bias too, or --zero ADU",
        )
    pixels = np.asarray(frame.pixels, dtype=np.float32) - np.float32(zero)
    return replace(frame, pixels=pixels), tuple(name for name in (done.bias, done.dark) if name)


def _normalize(sheet: FloatImage, facts: CameraSetup, colored: bool) -> None:
    """Divide a flat by its median, each color phase by its own if it is of a mosaic, in place."""
    if not colored:
        middle = np.float32(median_of(sheet))
        for rows in row_bands(facts):
            sheet[rows] = sheet[rows] / middle
        return
    for row, column in PHASES:
        part = sheet[row::2, column::2]
        middle = np.float32(median_of(part))
        for first in range(0, part.shape[0], _BAND_ROWS):
            part[first : first + _BAND_ROWS] = part[first : first + _BAND_ROWS] / middle
