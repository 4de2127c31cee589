"""`mountnav calibrate`: build masters from the camera's frames, look at them, put them on a frame."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from api.http.file_names import shown
from mountnav.errors import BadFrame, BadRequest
from mountnav.frames import Frame
from mountnav.measuring.calibration import Calibration, CalibrationPolicy, CalibrationReport
from mountnav.measuring.calibration.building import build
from mountnav.measuring.calibration.camera_setup import Kind, assumptions
from mountnav.measuring.calibration.masters import Master
from mountnav.measuring.calibration.stacking import StackSettings
from mountnav.reading import read_frame


def run_build(
    out: Path,
    *,
    bias: Sequence[str],
    dark: Sequence[str],
    flat: Sequence[str],
    lights: Sequence[str],
    zero_adu: float | None,
    method: str,
    kappa_sigma: float,
    assumed: Sequence[str] = (),
    as_json: bool,
) -> int:
    """Build masters and print what was made; 0.

    Raises
    ------
    BadRequest, BadFrame
        A frame that doesn't belong there; the folder is as before.
    """
    report = build(
        out,
        bias=bias,
        dark=dark,
        flat=flat,
        lights=lights,
        zero_adu=zero_adu,
        settings=StackSettings(method=method, kappa_sigma=kappa_sigma),
        assumed=assumptions(assumed),
    )
    if as_json:
        facts = {
            "folder": str(out),
            "masters": [_facts(one) for one in report.masters],
            "notes": report.notes,
        }
        sys.stdout.write(json.dumps(facts) + "\n")
        return 0
    for master in report.masters:
        sys.stdout.write(_line(master) + "\n")
    for note in report.notes:
        sys.stdout.write(f"note: {note}\n")
    return 0


def run_info(folder: Path, *, as_json: bool) -> int:
    """Print the masters of a folder; 0.

    Raises
    ------
    BadRequest
        No folder, or no masters in it.
    BadFrame
        A master is damaged.
    """
    calibration = Calibration.load(folder)
    if as_json:
        facts = {
            "folder": str(folder),
            "bias_adu": calibration.bias_adu,
            "masters": [_facts(one) for one in calibration.masters],
        }
        sys.stdout.write(json.dumps(facts) + "\n")
        return 0
    for master in calibration.masters:
        sys.stdout.write(_line(master) + "\n")
    return 0


def run_apply(folder: Path, files: Sequence[Path], *, out: Path, other_filter: bool, as_json: bool) -> int:
    """Calibrate frames and write them as FITS of float32; 0 if all were, else 1.

    Raises
    ------
    BadRequest
        No masters, two frames of one name, or an output folder that can't be made.
    """
    calibration = Calibration.load(folder, policy=CalibrationPolicy(other_filter=other_filter))
    names = [_output_name(path) for path in files]
    if len(set(names)) < len(names):
        raise BadRequest(
            "two of the frames have the same name", advice="calibrate them into different folders"
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise BadRequest(f"{out} can't be made: {fault.strerror or fault}") from fault
    failed = 0
    for path, name in zip(files, names, strict=True):
        target = out / name
        try:
            if target.resolve() == path.resolve():
                raise BadFrame(
                    "it would be written over itself", device=path.name, advice="choose another folder"
                )
            frame, report = calibration.applied(read_frame(path, raw=True))
            if not report.steps and not report.healed:
                raise BadFrame(f"nothing was done to it: {'; '.join(report.not_applied)}", device=path.name)
            _write(target, frame, report)
        except BadFrame as error:
            failed += 1
            _show_applied(path, None, str(error), as_json)
            continue
        except OSError as fault:
            raise BadRequest(f"{target} can't be written: {fault.strerror or fault}") from fault
        _show_applied(path, report, str(target), as_json)
    return 1 if failed else 0


def _output_name(path: Path) -> str:
    stem = path.name
    for ending in (".gz", ".bz2", ".fz", ".fits", ".fit", ".fts"):
        if stem.lower().endswith(ending):
            stem = stem[: -len(ending)]
    return f"{stem}.fits"


def _show_applied(path: Path, report: CalibrationReport | None, text: str, as_json: bool) -> None:
    if as_json:
        facts = {"file": shown(path), "out": None if report is None else text}
        facts |= {"reason": text} if report is None else asdict(report)
        sys.stdout.write(json.dumps(facts) + "\n")
    elif report is None:
        sys.stdout.write(f"{path}: {text}\n")
    else:
        done = ", ".join(name for name in (report.bias, report.dark, report.flat) if name)
        sys.stdout.write(
            f"{path} -> {text}: {done}; {report.healed} pixels healed, {report.missing} missing\n"
        )
        for line in (*report.not_applied, *report.warnings):
            sys.stdout.write(f"  {line}\n")


def _write(target: Path, frame: Frame, report: CalibrationReport) -> None:
    """Write a calibrated frame, atomically, with the cards it came with."""
    import warnings

    from astropy.io import fits

    header = fits.Header()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # long keys and strings of the original become HIERARCH or are cut
        for key, value in frame.header.items():
            if key in (
                "SIMPLE",
                "BITPIX",
                "EXTEND",
                "BZERO",
                "BSCALE",
                "BLANK",
                "XTENSION",
                "PCOUNT",
                "GCOUNT",
            ):
                continue
            if key.startswith(("NAXIS", "ZNAXIS")):
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
    if master.kind is not Kind.BAD_PIXELS:
        return None
    return round(float(np.count_nonzero(master.flags()) / master.flags().size), 7)


def _line(master: Master) -> str:
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
