"""`mountnav replay`: a recorded night once more, and what is decided otherwise. It has no port at all."""

from __future__ import annotations

import json
import sys
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

from api.catalogs import chosen_shelf
from api.navigators import make_navigator
from api.night_runner import digest_of
from api.replay_header import settings_of
from api.replay_wire import WireReader
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame, BadRequest, Cancelled
from mountnav.frames import Frame, Hint
from mountnav.journal.records import Journal
from mountnav.navigation.devices import Mount, MountReading, Skill
from mountnav.navigation.navigator import Navigator
from mountnav.night.placing import BySeries
from mountnav.night.recorded import Recording, read_recording, reading_of, syncs_of_night
from mountnav.night.replaying import Replay, ReplayReport
from mountnav.night.tape import TapeMount
from mountnav.reading import read_frame
from mountnav.series.results import SeriesSettings
from mountnav.settings import Settings, TelescopeSettings
from mountnav.simulation.virtual_time import VirtualClock, for_all_modules, run_virtually
from mountnav.sky.coordinates import Icrs

GREETING = timedelta(minutes=2)


class NoCamera:
    """Nothing is exposed in a replay."""

    @property
    def name(self) -> str:
        """For messages."""
        return "no camera"

    async def open(self) -> None:
        """Nothing to open."""

    async def close(self) -> None:
        """Nothing to close."""

    async def expose(self, exposure_s: float) -> Frame:
        """Refuse. Raises `Cancelled`."""
        raise Cancelled("a replay exposes nothing", device=self.name)

    async def abort(self) -> None:
        """Nothing to end."""


@dataclass(frozen=True, slots=True)
class Played:
    """A replay and how it was done.

    Attributes
    ----------
    report : ReplayReport
    wire : str
        What read the mount: "the recorded wire, through the driver", or why not.
    unanswered : int
        Readings that the recorded wire had no answer for.
    """

    report: ReplayReport
    wire: str
    unanswered: int


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
        Read the mount through its driver and the recorded wire, where there is one.
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
    first = next((line.utc for line in recording.lines if line.kind != "wire" and line.utc is not None), None)
    if first is None:
        raise BadRequest("the recording holds nothing", device=str(recording.path))
    # the driver's greeting takes its time before the first line
    clock = VirtualClock(first - GREETING)
    shelf: Catalog = chosen_shelf(config, None) if catalog is None else catalog
    with for_all_modules(clock):
        return run_virtually(_played(recording, settings, one, clock, shelf, speed, solve, wire), clock)


async def _played(
    recording: Recording,
    settings: Settings,
    one: TelescopeSettings,
    clock: VirtualClock,
    catalog: Catalog,
    speed: float,
    solve: bool,
    wire: bool,
) -> Played:
    reader = WireReader(_url(recording, one), recording, clock)
    told = "the recorded readings"
    ask = None
    if wire and recording.has_wire:
        ask = await reader.open()
        told = "the recorded wire, through its driver" if ask is not None else reader.problem
    tape = _tape(recording, clock, ask)

    def made(mount: Mount, journal: Journal, clock: VirtualClock) -> Navigator:
        return make_navigator(
            one,
            settings,
            mount=mount,
            camera=NoCamera(),
            catalog=catalog,
            solve=None,
            listen=lambda kind, data: None,
            journal=journal,
            clock=clock,
        )

    replay = Replay(
        recording,
        one.night.rules,
        settings.site.site,
        one.id,
        tape,
        made,
        clock,
        anew=_anew(one, settings, catalog) if solve else None,
        read=_read,
        speed=speed,
    )
    try:
        return Played(await replay.run(), told, tape.unanswered)
    finally:
        await reader.close()


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
    if one.mount.is_fake:
        return f"{one.mount.fake[0]}+serial:///recorded"
    return one.mount.url


def _tape(
    recording: Recording, clock: VirtualClock, ask: Callable[[], Awaitable[MountReading]] | None
) -> TapeMount:
    mounts = [line.facts for line in recording.of("mount")]
    told: dict[str, Any] = mounts[-1] if mounts else {}
    return TapeMount(
        str(told.get("name") or recording.header["telescope"]),
        [reading_of(line.facts["reading"]) for line in recording.of("reading")],
        syncs_of_night(recording),
        clock,
        epoch="icrs" if told.get("epoch") == "icrs" else "apparent",
        resolution_arcsec=float(told.get("resolution_arcsec") or 1.0),
        skills=frozenset(Skill(one) for one in told.get("skills", ())),
        ask=ask,
    )


def _anew(one: TelescopeSettings, settings: Settings, catalog: Catalog) -> BySeries:
    """Identify frames as the night did."""
    from api.navigators import centering_policy
    from api.solving import solve_settings

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
    report = played.report
    return {
        "same": report.same,
        "frames": report.frames,
        "solved_anew": report.solved_anew,
        "missing": list(report.missing),
        "mount": played.wire,
        "unanswered": played.unanswered,
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
        f"{report.frames} frames, {report.solved_anew} identified anew; {len(report.rows)} decisions, "
        + ("all as they were" if not others else f"{others} otherwise")
    )
    lines.append(f"mount: {played.wire}")
    if played.unanswered:
        lines.append(
            f"{played.unanswered} readings were not in the recorded wire: the recorded readings were taken"
        )
    if report.missing:
        lines.append(f"{len(report.missing)} files are gone or changed: their recorded solutions were taken")
    lines += report.notes
    return "\n".join(lines) + "\n"
