"""Master flats: of evenly lit frames, or of light frames by the inverse median filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mountnav.errors import BadFrame, BadRequest
from mountnav.frames import Frame
from mountnav.measuring.calibration.bad_pixels import Bad, mark_dead
from mountnav.measuring.calibration.calibration import Calibration
from mountnav.measuring.calibration.facts import CameraFacts, Kind, steps_done
from mountnav.measuring.calibration.inverse_median import InverseMedianSettings, background_mesh, from_meshes
from mountnav.measuring.calibration.masters import Master, MasterFacts
from mountnav.measuring.calibration.noise import gain_e_adu
from mountnav.measuring.calibration.raw_files import FloatImage, RawFile
from mountnav.measuring.calibration.stacking import stack
from mountnav.measuring.calibration.survey import PHASES, is_colored, require_alike, temperature_notes
from mountnav.measuring.calibration.workbench import (
    Workbench,
    common_facts,
    looked_at,
    master_facts,
    median_of,
    row_bands,
    tell_if_few,
)

_SAME_EXPOSURE = 0.01
_DARK_NEAR_C = 10.0
_BAND_ROWS = 256
_LEAST_RESPONSE = 0.05


def build_flats(bench: Workbench, files: Sequence[RawFile]) -> None:
    """Stack flats, each filter apart; BadFrame or BadRequest names a frame that doesn't belong there."""
    bench.notes += require_alike(files, Kind.FLAT)
    groups: dict[str, list[RawFile]] = {}
    for file in files:
        groups.setdefault((file.facts.filter or "").casefold(), []).append(file)
    for key in sorted(groups):
        _build_flat(bench, groups[key])


def _build_flat(bench: Workbench, files: Sequence[RawFile]) -> None:
    facts = common_facts(files)
    what = f"flat of filter {facts.filter}" if facts.filter else "flat"
    biases = bench.fitting(Kind.BIAS, facts)
    bias = biases[0] if biases else None
    darks = bench.fitting(Kind.DARK, facts)
    kept, seen = looked_at(bench, files, Kind.FLAT, None if bias is None else bias.level_adu)
    bench.notes += temperature_notes(kept, Kind.FLAT)
    tell_if_few(bench, kept, what)
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
    bench.kinds_seen |= Bad.DEAD
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


def _near_in_temperature(one: CameraFacts, other: CameraFacts) -> bool:
    if one.temperature_c is None or other.temperature_c is None:
        return True
    return abs(one.temperature_c - other.temperature_c) <= _DARK_NEAR_C


def build_from_lights(bench: Workbench, files: Sequence[RawFile], zero_adu: float | None) -> None:
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
                "the sky of the light frames falls to nothing at a corner",
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
        raise BadFrame("it was divided by a flat already", device=file.name, advice="give raw frames")
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


def _normalize(sheet: FloatImage, facts: CameraFacts, colored: bool) -> None:
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
