"""Master bias and master dark: the zero of every pixel, and what it gathers without light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mountnav.errors import BadFrame
from mountnav.measuring.calibration.bad_pixels import HOT_SIGMA, Bad, mark_hot, mark_noisy
from mountnav.measuring.calibration.facts import Kind
from mountnav.measuring.calibration.noise import read_noise_adu
from mountnav.measuring.calibration.raw_files import RawFile
from mountnav.measuring.calibration.stacking import LEAST_FOR_NOISY, stack
from mountnav.measuring.calibration.survey import require_alike, require_one_level, temperature_notes
from mountnav.measuring.calibration.workbench import (
    Workbench,
    at_one_level,
    common_facts,
    looked_at,
    master_facts,
    median_of,
    row_bands,
    tell_if_few,
)

_SAME_EXPOSURE = 0.01
_TEMPERATURE_GAP_C = 5.0


def build_bias(bench: Workbench, files: Sequence[RawFile]) -> None:
    """Stack bias frames; raises BadFrame or BadRequest naming the frame that doesn't belong there."""
    kept, seen = looked_at(bench, files, Kind.BIAS, None)
    require_one_level(kept, seen, Kind.BIAS)
    bench.notes += temperature_notes(kept, Kind.BIAS)
    tell_if_few(bench, kept, "bias")
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
        bench.kinds_seen |= Bad.NOISY
        bench.flags.append(
            lambda bad: mark_noisy(bad, np.memmap(scatter_path, dtype=">f4", mode="r", shape=shape))
        )


def build_darks(bench: Workbench, files: Sequence[RawFile]) -> None:
    """Stack darks, each exposure and temperature apart, and turn them into ADU per second if a bias fits.

    Raises BadFrame or BadRequest naming the frame that doesn't belong there.
    """
    bench.notes += require_alike(files, Kind.DARK)
    without = next((file for file in files if not file.facts.exposure_s), None)
    if without is not None:
        raise BadFrame(
            "its header tells no exposure time, or zero",
            device=without.name,
            advice="a dark needs EXPTIME; a frame of no exposure is a bias (--bias)",
        )
    groups = _dark_groups(files)
    for group in groups:
        _build_dark(bench, group)


def _build_dark(bench: Workbench, files: Sequence[RawFile]) -> None:
    facts = common_facts(files)
    exposure = facts.exposure_s or 1.0
    what = f"dark of {exposure:g} s"
    biases = bench.fitting(Kind.BIAS, facts)
    bias = biases[0] if biases else None
    kept, seen = looked_at(bench, files, Kind.DARK, None if bias is None else bias.level_adu)
    require_one_level(kept, seen, Kind.DARK)
    bench.notes += temperature_notes(kept, Kind.DARK)
    tell_if_few(bench, kept, what)
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
    bench.kinds_seen |= Bad.HOT
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
