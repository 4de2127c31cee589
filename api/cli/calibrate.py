"""`mountnav calibrate`: build masters from the camera's frames, look at them, put them on a frame."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.options import Json, ManyValues
from api.cli.output import print_json, refusing_os_errors
from mountnav.errors import BadFrame, BadRequest
from mountnav.files import require_replaceable

if TYPE_CHECKING:
    from mountnav.frames import Frame
    from mountnav.measuring.calibration import Calibration, CalibrationReport
    from mountnav.measuring.calibration.masters import Master

calibrate_app = typer.Typer(help="Master bias, dark and flat frames.", no_args_is_help=True)
_CARDS_OF_THE_ARRAY = frozenset(
    ("SIMPLE", "BITPIX", "EXTEND", "BZERO", "BSCALE", "BLANK", "XTENSION", "PCOUNT", "GCOUNT")
)
"""FITS cards that describe the array as it was stored: the calibrated one is stored otherwise."""


@calibrate_app.command("build", cls=ManyValues)
def calibrate_build(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the masters; made if it isn't there.")],
    bias: Annotated[
        list[str] | None, typer.Option(metavar="F...", help="Bias frames: files, folders, patterns.")
    ] = None,
    dark: Annotated[list[str] | None, typer.Option(metavar="F...", help="Dark frames.")] = None,
    flat: Annotated[
        list[str] | None, typer.Option(metavar="F...", help="Flats, of one or more filters.")
    ] = None,
    flat_from_lights: Annotated[
        list[str] | None,
        typer.Option(
            metavar="F...", help="Frames of several fields, made a flat by the inverse median filter."
        ),
    ] = None,
    zero: Annotated[
        float | None,
        typer.Option(help="ADU of a pixel without light, for --flat-from-lights without a bias."),
    ] = None,
    method: Annotated[
        str, typer.Option(help="What the values left after clipping become: mean or median.")
    ] = "mean",
    kappa: Annotated[float, typer.Option(help="Clip values beyond this many sigma.")] = 5.0,
    assume: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="For frames whose headers don't say it: gain, offset, egain, readout, camera, binning.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Build masters from stacks of frames. All of them or, if a frame doesn't belong there, none."""
    from mountnav.measuring.calibration.building import build
    from mountnav.measuring.calibration.camera_setup import assumptions
    from mountnav.measuring.calibration.stacking import StackSettings

    report = build(
        out,
        bias=bias or (),
        dark=dark or (),
        flat=flat or (),
        lights=flat_from_lights or (),
        zero_adu=zero,
        settings=StackSettings(method=method, kappa_sigma=kappa),
        assumed=assumptions(assume or ()),
    )
    if as_json:
        masters = [_facts(master) for master in report.masters]
        print_json({"folder": str(out), "masters": masters, "notes": report.notes})
        return
    for master in report.masters:
        typer.echo(_line(master))
    for note in report.notes:
        typer.echo(f"note: {note}")


@calibrate_app.command("info")
def calibrate_info(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of masters.")], as_json: Json = False
) -> None:
    """Show which masters a folder holds."""
    from mountnav.measuring.calibration import Calibration

    calibration = Calibration.load(folder)
    if as_json:
        masters = [_facts(master) for master in calibration.masters]
        print_json({"folder": str(folder), "bias_adu": calibration.bias_adu, "masters": masters})
        return
    for master in calibration.masters:
        typer.echo(_line(master))


@calibrate_app.command("apply")
def calibrate_apply(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of masters.")],
    frames: Annotated[list[Path], typer.Argument(metavar="FRAME...", help="Raw frames.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the calibrated frames.")],
    other_filter: Annotated[
        bool,
        typer.Option("--other-filter", help="Use a flat of another filter if there is none of the frame's."),
    ] = False,
    as_json: Json = False,
) -> None:
    """Calibrate frames and write them as FITS. Exit code 1 if some could not be."""
    from mountnav.measuring.calibration import Calibration, CalibrationPolicy

    calibration = Calibration.load(folder, policy=CalibrationPolicy(other_filter=other_filter))
    names = [_output_name(path) for path in frames]
    if len(set(names)) < len(names):
        raise BadRequest(
            "two of the frames have the same name", advice="calibrate them into different folders"
        )
    with refusing_os_errors(f"{out} can't be made"):
        out.mkdir(parents=True, exist_ok=True)
    failed = 0
    for path, name in zip(frames, names, strict=True):
        target = out / name
        try:
            with refusing_os_errors(f"{target} can't be written"):
                report = _apply(calibration, path, target)
        except BadFrame as error:
            failed += 1
            _print_applied(path, None, str(error), as_json)
        else:
            _print_applied(path, report, str(target), as_json)
    raise typer.Exit(1 if failed else 0)


def _apply(calibration: Calibration, path: Path, target: Path) -> CalibrationReport:
    """Calibrate a frame and write it. Raises `BadFrame` where nothing can be done to it, and `OSError`."""
    from mountnav.reading import read_frame

    if target.resolve() == path.resolve():
        raise BadFrame("it would be written over itself", device=path.name, advice="choose another folder")
    frame, report = calibration.applied(read_frame(path, raw=True))
    if not report.steps and not report.healed:
        raise BadFrame(f"nothing was done to it: {'; '.join(report.not_applied)}", device=path.name)
    _write(target, frame, report)
    return report


def _output_name(path: Path) -> str:
    """The frame's name with .fits in place of its endings."""
    stem = path.name
    for ending in (".gz", ".bz2", ".fz", ".fits", ".fit", ".fts"):
        if stem.lower().endswith(ending):
            stem = stem[: -len(ending)]
    return f"{stem}.fits"


def _print_applied(path: Path, report: CalibrationReport | None, text: str, as_json: bool) -> None:
    """What became of a frame: `text` is the file that was written, or why there is none."""
    from api.http.file_names import shown

    if as_json:
        facts = {"file": shown(path), "out": None if report is None else text}
        facts |= {"reason": text} if report is None else asdict(report)
        print_json(facts)
    elif report is None:
        typer.echo(f"{path}: {text}")
    else:
        done = ", ".join(name for name in (report.bias, report.dark, report.flat) if name)
        typer.echo(f"{path} -> {text}: {done}; {report.healed} pixels healed, {report.missing} missing")
        for line in (*report.not_applied, *report.warnings):
            typer.echo(f"  {line}")


def _write(target: Path, frame: Frame, report: CalibrationReport) -> None:
    """Write a calibrated frame, atomically, with the cards it came with."""
    import warnings

    import numpy as np
    from astropy.io import fits

    header = fits.Header()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # long keys and strings of the original become HIERARCH or are cut
        for key, value in frame.header.items():
            if key in _CARDS_OF_THE_ARRAY or key.startswith(("NAXIS", "ZNAXIS")):
                continue
            try:
                header[key] = value
            except ValueError:
                continue
        if frame.saturation_adu is not None:
            header["SATURATE"] = round(frame.saturation_adu, 3)
        for line in (*report.not_applied, *report.warnings):
            header.add_history(line.encode("ascii", "replace").decode())
        hdu = fits.PrimaryHDU(np.ascontiguousarray(frame.pixels, dtype=np.float32), header)
        part = target.with_name(f".{target.name}.part")
        require_replaceable(target)
        try:
            hdu.writeto(part, overwrite=True, output_verify="silentfix+ignore")
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)


def _facts(master: Master) -> dict[str, object]:
    facts = master.facts
    return {
        "file": master.name,
        "kind": master.kind.value,
        "width_px": facts.width_px,
        "height_px": facts.height_px,
        "binning": facts.binning,
        "gain_setting": facts.gain,
        "filter": facts.filter,
        "exposure_s": facts.exposure_s,
        "temperature_c": facts.temperature_c,
        "frames": master.frames,
        "unit": master.unit,
        "level": master.level_adu,
        "rejected_share": master.rejected_share,
        "read_noise_adu": master.read_noise_adu,
        "gain_e_adu": master.gain_e_adu,
        "zero_free": master.zero_free,
        "from_lights": master.from_lights,
        "bad_share": _bad_share(master),
    }


def _bad_share(master: Master) -> float | None:
    """The share of bad pixels, of a map of them."""
    import numpy as np

    from mountnav.measuring.calibration.camera_setup import Kind

    if master.kind is not Kind.BAD_PIXELS:
        return None
    return round(float(np.count_nonzero(master.flags()) / master.flags().size), 7)


def _line(master: Master) -> str:
    """A master for people."""
    from mountnav.measuring.calibration.camera_setup import Kind

    facts = master.facts
    words = [f"{master.name}:", f"{master.frames} frame{'s' if master.frames != 1 else ''},"]
    if master.kind is Kind.BAD_PIXELS:
        share = _bad_share(master) or 0.0
        words = [
            f"{master.name}:",
            f"{share * facts.width_px * facts.height_px:.0f} pixels ({100 * share:.3f} %)",
        ]
        return " ".join(words)
    parts = []
    if master.level_adu is not None:
        unit = "ADU" if master.unit == "response" else master.unit
        parts.append(f"{'light' if master.unit == 'response' else 'level'} {master.level_adu:.4g} {unit}")
    if facts.temperature_c is not None:
        parts.append(f"{facts.temperature_c:.1f} °C")
    if master.frames > 1 and not master.from_lights:
        parts.append(f"{100 * master.rejected_share:.3f} % clipped")
    if master.read_noise_adu is not None and master.kind is Kind.BIAS:
        parts.append(f"read noise {master.read_noise_adu:.2f} ADU")
    if master.gain_e_adu is not None:
        parts.append(f"gain {master.gain_e_adu:.3f} e/ADU")
    words.append(", ".join(parts))
    if master.kind is Kind.DARK and not master.zero_free:
        words.append("(bias still in it)")
    return " ".join(words)
