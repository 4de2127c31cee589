"""Stacks of bias, dark and flat frames become a folder of masters, all of it or nothing."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadRequest
from mountnav.measuring.calibration.bad_pixels import MOST_BAD, BadPixel
from mountnav.measuring.calibration.bias_dark_flat import (
    BuildContext,
    build_bias,
    build_darks,
    build_flats,
    build_from_lights,
)
from mountnav.measuring.calibration.calibration import masters_in
from mountnav.measuring.calibration.camera_setup import Kind, assuming, difference
from mountnav.measuring.calibration.inspection import require_all_known
from mountnav.measuring.calibration.masters import Master, MasterFacts
from mountnav.measuring.calibration.raw_files import RawFile, listed_files, open_raw
from mountnav.measuring.calibration.stacking import StackSettings

_KINDS = (Kind.BIAS, Kind.DARK, Kind.FLAT, Kind.LIGHT)


@dataclass(frozen=True, slots=True)
class BuildReport:
    """What was built.

    Attributes
    ----------
    masters : tuple of Master
        The new ones.
    notes : tuple of str
        What the user should know.
    """

    folder: Path
    masters: tuple[Master, ...]
    notes: tuple[str, ...]


def build(
    out: Path,
    *,
    bias: Sequence[Path | str] = (),
    dark: Sequence[Path | str] = (),
    flat: Sequence[Path | str] = (),
    lights: Sequence[Path | str] = (),
    zero_adu: float | None = None,
    settings: StackSettings | None = None,
    assumed: Mapping[str, float | str | tuple[int, int]] | None = None,
) -> BuildReport:
    """Build masters and put them in a folder.

    A bias of an earlier build in the same folder serves new darks and flats. Masters of the same kind, size,
    exposure and filter are replaced, others stay. If anything goes wrong, the folder is as before.

    Parameters
    ----------
    out : Path
        Folder; made if it isn't there.
    bias, dark, flat, lights : sequence of Path or str
        Files, folders or patterns. `lights` make a flat by the inverse median filter.
    zero_adu : float, optional
        Level of a pixel without light, for `lights` without a bias.
    assumed : mapping, optional
        Settings of the camera for frames whose headers don't state them, see
        `mountnav.measuring.calibration.camera_setup.assumptions`.

    Raises
    ------
    BadRequest
        Nothing to build from, frames taken with different settings, a folder that can't be written.
    BadFrame
        A file is no FITS image, is of the wrong kind, saturated or too faint; its name is the device.
    """
    settings = settings or StackSettings()
    if settings.method not in ("mean", "median") or not 1.5 <= settings.kappa_sigma <= 100.0:
        raise BadRequest(
            f"stacking by {settings.method!r} with κ = {settings.kappa_sigma:g} is not possible",
            advice="mean or median, κ from 1.5 to 100",
        )
    listed = {kind: listed_files(some) for kind, some in zip(_KINDS, (bias, dark, flat, lights), strict=True)}
    if not any(listed.values()):
        raise BadRequest(
            "there is nothing to build from", advice="give --bias, --dark, --flat or --flat-from-lights"
        )
    was_there = out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=".build-", dir=out))
    except OSError as fault:
        raise BadRequest(
            f"{out} can't be written: {fault.strerror or fault}", advice="choose another folder"
        ) from fault
    try:
        unpacked = scratch / "unpacked"
        unpacked.mkdir()
        bench = BuildContext(out, scratch, settings, masters_in(out))
        opened = {
            kind: [_with_assumed(open_raw(path, unpacked), assumed or {}) for path in paths]
            for kind, paths in listed.items()
        }
        _require_one_camera(opened)
        if opened[Kind.BIAS]:
            build_bias(bench, opened[Kind.BIAS])
        if opened[Kind.DARK]:
            build_darks(bench, opened[Kind.DARK])
        if opened[Kind.FLAT]:
            build_flats(bench, opened[Kind.FLAT])
        if opened[Kind.LIGHT]:
            build_from_lights(bench, opened[Kind.LIGHT], zero_adu)
        _build_bad_pixels(bench)
        for master in bench.ready:
            master.path.replace(out / master.name)
        done = tuple(replace(master, path=out / master.name) for master in bench.ready)
        return BuildReport(out, done, tuple(dict.fromkeys(bench.notes)))
    except OSError as fault:
        raise BadRequest(
            f"{out} can't be written: {fault.strerror or fault}", advice="is the disk full?"
        ) from fault
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
        if not was_there and not any(out.iterdir()):
            out.rmdir()


def _with_assumed(file: RawFile, assumed: Mapping[str, float | str | tuple[int, int]]) -> RawFile:
    return replace(file, facts=assuming(file.facts, assumed))


def _require_one_camera(opened: dict[Kind, list[RawFile]]) -> None:
    """Frames of different kinds of one build must fit together as well."""
    first: RawFile | None = None
    for files in opened.values():
        for file in files[:1]:
            if first is not None and (what := difference(file.facts, first.facts)):
                raise BadRequest(
                    f"{what}, as {first.name}", device=file.name, advice="build for each camera setting apart"
                )
            first = first or file
    require_all_known([files[0] for files in opened.values() if files])


def _build_bad_pixels(bench: BuildContext) -> None:
    if not bench.flags:
        return
    facts = bench.ready[0].facts
    numbers, sheet = bench.sheet("bad", facts, "u1")
    bad: NDArray[np.uint8] = np.asarray(sheet)
    used = [one.name for one in bench.ready if not one.from_lights]
    for older in bench.older:
        if older.kind is Kind.BAD_PIXELS and difference(facts, older.facts) is None:
            keep = ~np.uint8(bench.kinds_seen)
            bad[:] = older.flags() & keep
            used.append(older.name)
            break
    for mark in bench.flags:
        mark(bad)
    share = float(np.count_nonzero(bad) / bad.size)
    if share > MOST_BAD:
        bench.notes.append(f"{100 * share:.1f} % of the pixels look bad: no bad-pixel map is made")
        return
    plain = replace(facts, exposure_s=None, temperature_c=None, filter=None)
    counts = {kind.name: int(np.count_nonzero(bad & np.uint8(kind))) for kind in BadPixel}
    bench.notes.append(
        f"bad pixels: {counts['HOT']} hot, {counts['DEAD']} dead, {counts['NOISY']} noisy"
        f" ({100 * share:.3f} %)"
    )
    bench.finish(
        numbers,
        MasterFacts(
            kind=Kind.BAD_PIXELS,
            facts=plain,
            files=tuple(used),
            zero_free=True,
            unit="flags",
            method="",
            read_noise_adu=bench.read_noise,
            gain_e_adu=bench.gain,
        ),
    )
