"""`mountnav replay`: a recorded night decided once more, and what is decided otherwise now."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.cli.options import Json, config_option
from api.cli.output import print_json

if TYPE_CHECKING:
    from api.replay.replaying import Played


def replay(
    file: Annotated[Path, typer.Argument(help="A recording, as night.record writes them.")],
    speed: Annotated[
        float, typer.Option(min=0, help="Seconds of the night in one of yours; 0: as fast as it goes.")
    ] = 0.0,
    solve: Annotated[
        bool, typer.Option("--solve/--no-solve", help="Identify the frames anew where their files are there.")
    ] = True,
    wire: Annotated[
        bool,
        typer.Option("--wire/--no-wire", help="Let the driver read the recorded wire as well."),
    ] = True,
    config: Annotated[
        Path | None, config_option("Other settings: what would have been decided by them?")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Also show what was decided the same.")] = False,
    as_json: Json = False,
) -> None:
    """Decide a recorded night once more from what each decision hung on, and compare. Touches no mount.

    Exit code 0 if everything was decided as it was then, 1 if not, 2 if the file is no recording.
    """
    from api.replay.replaying import play
    from mountnav.night.recording import read_recording

    played = play(read_recording(file), speed=speed, solve=solve, wire=wire, config=config)
    if as_json:
        print_json(replay_record(played), indent=1)
    else:
        sys.stdout.write(shown(played, every=every))
    raise typer.Exit(0 if played.report.same else 1)


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
        f"{report.frames} frames, {report.solved_anew} identified anew; {len(report.rows)} decisions judged, "
        + ("all as they were" if not others else f"{others} otherwise")
    )
    if report.not_judged:
        lines.append(f"{report.not_judged} decisions could not be judged: what they hang on is not recorded")
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
