"""What a build has on its table, and the steps that all kinds of masters share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.measuring.calibration.bad_pixels import Bad
from mountnav.measuring.calibration.facts import CameraFacts, Kind, difference
from mountnav.measuring.calibration.masters import Master, MasterFacts, master_name, read_master, write_master
from mountnav.measuring.calibration.raw_files import FloatImage, RawFile
from mountnav.measuring.calibration.stacking import Stacked, StackSettings
from mountnav.measuring.calibration.survey import Survey, require_alike, require_kind, survey, without_repeats

T = TypeVar("T")

_BAND_ROWS = 256
_MEDIAN_SAMPLE = 16_000_000


@dataclass(slots=True)
class Workbench:
    """What a build has on its table: scratch files, masters done so far, notes."""

    out: Path
    scratch: Path
    settings: StackSettings
    older: tuple[Master, ...]
    ready: list[Master] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    flags: list[Callable[[NDArray[np.uint8]], None]] = field(default_factory=list)
    kinds_seen: Bad = field(default_factory=lambda: Bad(0))
    read_noise: float | None = None
    gain: float | None = None

    def sheet(self, name: str, facts: CameraFacts, dtype: str = ">f4") -> tuple[Path, FloatImage]:
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

    def fitting(self, kind: Kind, facts: CameraFacts) -> list[Master]:
        """Masters of this build first, then older ones of the folder, that fit the camera's settings."""
        return [
            one
            for one in (*reversed(self.ready), *self.older)
            if one.kind is kind and difference(facts, one.facts) is None
        ]


def looked_at(
    bench: Workbench, files: Sequence[RawFile], kind: Kind, zero_adu: float | None
) -> tuple[list[RawFile], list[Survey]]:
    """Look at all frames of a stack, refuse what doesn't belong there, and leave copies out."""
    bench.notes += require_alike(files, kind)
    seen = [survey(file) for file in files]
    for file, one in zip(files, seen, strict=True):
        require_kind(file, one, kind, zero_adu)
    kept_files, kept, notes = without_repeats(files, seen)
    bench.notes += notes
    return kept_files, kept


def tell_if_few(bench: Workbench, files: Sequence[RawFile], what: str) -> None:
    """Note that a stack of one or two frames is a poor one."""
    if len(files) == 1:
        bench.notes.append(f"{what} from one frame: its noise goes into every frame, cosmic rays stay in it")
    elif len(files) == 2:
        bench.notes.append(f"{what} from two frames: five or more are better")


def master_facts(
    kind: Kind,
    facts: CameraFacts,
    files: Sequence[RawFile],
    done: Stacked,
    seen: Sequence[Survey],
    bench: Workbench,
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


def at_one_level(seen: Sequence[Survey]) -> Callable[[int, int, FloatImage], FloatImage]:
    """Bring frames whose zero drifts to their mean level, so that the drift isn't taken for outliers."""
    levels = np.array([one.level_adu for one in seen])
    shifts = (np.sort(levels).mean() - levels).astype(np.float32)

    def prepare(number: int, first: int, pixels: FloatImage) -> FloatImage:
        pixels += shifts[number]
        return pixels

    return prepare


def common_facts(files: Sequence[RawFile]) -> CameraFacts:
    """Settings of a stack: what any of its headers tells, mean exposure and temperature."""
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


def row_bands(facts: CameraFacts) -> list[slice]:
    """Give the frame's rows in bands that are worked on one after the other."""
    height = facts.height_px
    return [slice(first, min(first + _BAND_ROWS, height)) for first in range(0, height, _BAND_ROWS)]


def median_of(sheet: FloatImage) -> float:
    """Return the median of the finite pixels, of a part of the rows in a large frame."""
    step = 1 + (sheet.size - 1) // _MEDIAN_SAMPLE
    rows = np.asarray(sheet[::step], dtype=np.float32)
    finite = rows[np.isfinite(rows)]
    return float(np.median(finite)) if finite.size else float("nan")
