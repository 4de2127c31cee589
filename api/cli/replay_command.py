"""`mountnav replay`: a recorded night once more, and what is decided otherwise. It has no port at all."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from api.cli.replay_header import settings_of
from api.cli.replay_wire import WireCheck, check_wire
from api.navigators import centering_policy
from api.nights.night_runner import digest_of
from api.solver.solving import solve_settings
from mountnav.catalog.at_hand import open_shelf
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame, BadRequest, BadSettings
from mountnav.frames import Frame, Hint
from mountnav.navigation.navigator import sync_rules
from mountnav.night.placing import BySeries, Placing
from mountnav.night.recorded import Recording, read_recording
from mountnav.night.replaying import Replay, ReplayReport
from mountnav.reading import read_frame
from mountnav.series.results import SeriesSettings
from mountnav.settings.observatory import Settings, TelescopeSettings
from mountnav.sky.coordinates import Icrs


@dataclass(frozen=True, slots=True)
class Played:
    """A replay and how it was done.

    Attributes
    ----------
    report : ReplayReport
    wire : WireCheck or None
        What the real driver makes of the recorded wire; None where it wasn't asked.
    """

    report: ReplayReport
    wire: WireCheck | None


def run(
    file: Path,
    *,
    speed: float,
    solve: bool,
    wire: bool,
    config: Path | None,
    every: bool,
    as_json: bool,
) -> int:
    """Play a recording and print the comparison.

    Parameters
    ----------
    file : Path
    speed : float
        0: as fast as it goes.
    solve : bool
        Identify frames anew where their files are there.
    wire : bool
        Let the mount's driver read the recorded wire, where there is one, and compare the readings. No
        decision hangs on that.
    config : Path or None
        Other settings than the recorded ones.
    every : bool
        Show also what is the same.
    as_json : bool

    Returns
    -------
    int
        0 if everything was decided as it was then, else 1.

    Raises
    ------
    BadRequest
        The file is no recording.
    BadSettings
        The other settings are wrong.
    """
    played = play(read_recording(file), speed=speed, solve=solve, wire=wire, config=config)
    if as_json:
        sys.stdout.write(json.dumps(record(played), indent=1) + "\n")
    else:
        sys.stdout.write(shown(played, every=every))
    return 0 if played.report.same else 1


def play(
    recording: Recording,
    *,
    speed: float = 0.0,
    solve: bool = True,
    wire: bool = True,
    config: Path | None = None,
    catalog: Catalog | None = None,
) -> Played:
    """Play a recording; parameters as of `run`. `catalog` goes before that of the settings."""
    telescope_id = str(recording.header["telescope"])
    settings = _settings(recording, config)
    one = _telescope(settings, telescope_id)
    if not any(line.kind != "wire" for line in recording.lines):
        raise BadRequest("the recording holds nothing", device=str(recording.path))
    anew, problem = _who_identifies(one, settings, catalog) if solve else (None, "")
    replay = Replay(
        recording,
        one.night.rules,
        settings.site.site,
        one.id,
        sync_rules(one.sync.policy, centering_policy(one)),
        other_rules=config is not None,
        anew=anew,
        read=_read,
        speed=speed,
    )
    report = asyncio.run(replay.run())
    if problem:
        report = replace(report, notes=(*report.notes, problem))
    checked = check_wire(_url(recording, one), recording) if wire and recording.has_wire else None
    return Played(report, checked)


def _settings(recording: Recording, config: Path | None) -> Settings:
    if config is not None:
        return Settings.load(config)
    try:
        return settings_of(recording.header)
    except (KeyError, ValueError) as cause:
        raise BadRequest(
            f"this version can't take the recorded settings: {cause}",
            device=str(recording.path),
            advice="give settings with --config",
        ) from cause


def _telescope(settings: Settings, telescope_id: str) -> TelescopeSettings:
    for one in settings.telescope:
        if one.id == telescope_id:
            return one
    raise BadRequest(
        f"these settings have no telescope {telescope_id}", advice="give settings of the recorded telescope"
    )


def _url(recording: Recording, one: TelescopeSettings) -> str:
    """The recorded mount's URL; a fake's is that of its language on a port that is never opened."""
    return f"{one.mount.fake[0]}+serial:///recorded" if one.mount.is_fake else one.mount.url


def _who_identifies(
    one: TelescopeSettings, settings: Settings, catalog: Catalog | None
) -> tuple[Callable[[], Placing] | None, str]:
    """Who identifies frames anew, by the catalogs and masters of the settings; or why nobody can."""
    try:
        anew = partial(_anew, one, settings, open_shelf(settings.catalogs) if catalog is None else catalog)
        anew()
    except (BadSettings, BadRequest, BadFrame) as trouble:
        return None, f"no frame was identified anew: {trouble}"
    return anew, ""


def _anew(one: TelescopeSettings, settings: Settings, catalog: Catalog) -> BySeries:
    """Identify frames as the night did."""
    policy = centering_policy(one)
    solving = solve_settings(settings.solving, calibration=one.calibration)
    scale, off = policy.scale_arcsec_px, policy.scale_tolerance

    def hint(near: Icrs | None) -> Hint | None:
        if near is None and scale is None:
            return None
        return Hint(
            center=near,
            radius_deg=policy.search_radius_deg,
            scale_low_arcsec_px=None if scale is None else scale * (1.0 - off),
            scale_high_arcsec_px=None if scale is None else scale * (1.0 + off),
            center_source="the mount's reading",
            scale_source="the settings",
        )

    return BySeries(catalog, hint, SeriesSettings(solving=solving, audit_every=one.night.audit_every))


def _read(path: Path, digest: str) -> Frame | None:
    """The frame of a file, if it is still the one that was recorded."""
    try:
        return read_frame(path, raw=True) if digest_of(path) == digest else None
    except (OSError, BadFrame):
        return None


def record(played: Played) -> dict[str, Any]:
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
        lines.append(f"wire: {played.wire.told}")
    lines += report.notes
    return "\n".join(lines) + "\n"
