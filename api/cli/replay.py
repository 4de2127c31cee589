"""`mountnav replay`: a recorded night decided once more, and what is decided otherwise now."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.cli.options import Json, config_option
from api.cli.output import print_json
from mountnav.errors import BadRequest

if TYPE_CHECKING:
    from api.replay.replaying import Played


def replay(
    file: Annotated[
        Path,
        typer.Argument(help="A recording, as night.record writes them, or a bundle (`report --bundle`)."),
    ],
    speed: Annotated[
        float, typer.Option(min=0, help="Seconds of the night in one of yours; 0: as fast as it goes.")
    ] = 0.0,
    solve: Annotated[
        bool,
        typer.Option("--solve/--no-solve", help="Identify the frames again where their files are there."),
    ] = True,
    wire: Annotated[
        bool,
        typer.Option("--wire/--no-wire", help="Let the driver read the recorded wire as well."),
    ] = True,
    config: Annotated[
        Path | None, config_option("Other settings: what would have been decided by them?")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Also show what was decided the same.")] = False,
    night: Annotated[
        str | None, typer.Option(help="Of a bundle: only this recording, such as east-2026-11-25.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Decide a recorded night once more from what each decision hung on, and compare. Touches no mount.

    Exit code 0 if everything was decided as it was then, 1 if not, 2 if the file is no recording.
    """
    from api.bundle.form import is_bundle
    from api.replay.replaying import play
    from mountnav.night.recording import read_recording

    if is_bundle(file):
        _replay_bundle(file, night, speed, solve, wire, config, every, as_json)
        return
    if night is not None:
        raise BadRequest("--night is for bundles", device=str(file), advice="leave it out")
    played = play(read_recording(file), speed=speed, solve=solve, wire=wire, config=config)
    if as_json:
        print_json(replay_record(played), indent=1)
    else:
        sys.stdout.write(shown(played, every=every))
    raise typer.Exit(0 if played.report.same else 1)


def _replay_bundle(
    file: Path,
    night: str | None,
    speed: float,
    solve: bool,
    wire: bool,
    config: Path | None,
    every: bool,
    as_json: bool,
) -> None:
    """Tell what a bundle holds, and play its recordings."""
    from api.bundle.form import open_bundle
    from api.replay.replaying import play
    from mountnav.night.recording import read_recording

    same = True
    with open_bundle(file) as bundle:
        recordings = {
            name.removesuffix(".jsonl"): path
            for name, path in bundle.recordings.items()
            if night is None or night in (name, name.removesuffix(".jsonl"))
        }
        if not recordings:
            names = ", ".join(bundle.recordings) or "none: night.record was not set, or nothing was recorded"
            raise BadRequest(
                "the bundle holds no such recording of a night",
                device=str(file),
                advice=f"there is: {names}; journal.jsonl and wire/ in it can be read as they are",
            )
        told = {}
        for name, path in recordings.items():
            played = play(read_recording(path), speed=speed, solve=solve, wire=wire, config=config)
            same = same and played.report.same
            if as_json:
                told[name] = replay_record(played)
            else:
                made = bundle.manifest.get("mountnav"), bundle.manifest.get("made_utc")
                sys.stdout.write(_plain(f"{name} (mountnav {made[0]}, bundle of {made[1]})") + "\n")
                sys.stdout.write(shown(played, every=every))
        if as_json:
            print_json({"bundle": bundle.manifest, "recordings": told}, indent=1)
    raise typer.Exit(0 if same else 1)


def _plain(text: str) -> str:
    """For a terminal: names in a bundle are a stranger's."""
    return "".join(letter if letter.isprintable() else "\ufffd" for letter in text[:300])


def replay_record(played: Played) -> dict[str, Any]:
    """A replay as JSON values."""
    report, wire = played.report, played.wire
    return {
        "same": report.same,
        "judged": len(report.rows),
        "not_judged": report.not_judged,
        "frames": report.frames,
        "solved_anew": report.solved_anew,
        "missing": list(report.missing),
        "after_missing": report.after_missing,
        "wire": None if wire is None else asdict(wire),
        "notes": list(report.notes),
        "rows": [
            {
                "utc": row.utc.isoformat(),
                "what": row.what,
                "recorded": row.recorded,
                "replayed": row.replayed,
                "same": row.same,
            }
            for row in report.rows
        ],
    }


def shown(played: Played, *, every: bool) -> str:
    """A replay as a table for people."""
    report = played.report
    rows = [row for row in report.rows if every or not row.same]
    lines = []
    for row in rows:
        mark = " " if row.same else "≠"
        lines.append(f"{mark} {row.utc:%H:%M:%S}  {row.what}")
        if row.same:
            lines.append(f"      {row.recorded}")
        else:
            lines += [f"      then: {row.recorded}", f"      now:  {row.replayed}"]
    others = sum(not row.same for row in report.rows)
    lines.append(
        f"{report.frames} frames, {report.solved_anew} identified again; "
        f"{len(report.rows)} decisions judged, "
        + ("all as they were" if not others else f"{others} otherwise")
    )
    if report.not_judged:
        lines.append(
            f"{report.not_judged} decisions could not be judged: what they depend on was not recorded"
        )
    if report.missing:
        lines.append(f"{len(report.missing)} files are gone or changed: their recorded solutions were taken")
    if report.after_missing:
        lines.append(
            f"{report.after_missing} frames were identified together with those: their recorded solutions "
            "were taken as well"
        )
    if played.wire is not None:
        lines.append(f"wire: {played.wire.text}")
    lines += report.notes
    return "\n".join(lines) + "\n"
