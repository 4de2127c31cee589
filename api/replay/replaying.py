"""A recorded night decided once more, and its wire read by the real driver."""

from __future__ import annotations

import asyncio
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path

from api.nights.nights import digest_of
from api.observatory.navigators import centering_policy
from api.replay.recording_header import recorded_settings
from api.solver.solve_settings import solve_settings
from drivers.generic.coordinates import apart_arcsec
from drivers.generic.mount import GenericMount
from drivers.generic.serial_language import SerialLanguage
from drivers.registry import open_mount
from mountnav.catalog.catalog_set import CatalogSet, open_catalogs
from mountnav.catalog.stars import Catalog
from mountnav.devices import MountReading
from mountnav.errors import BadFrame, BadRequest, BadSettings, DeviceError
from mountnav.frames import Frame, Hint
from mountnav.identification.blind.cache import installed_index
from mountnav.navigation.equipment import sync_rules
from mountnav.night.placing import BySeries, Placing
from mountnav.night.recording import Line, Recording, reading_of
from mountnav.night.replaying import Replay, ReplayReport
from mountnav.reading import read_frame
from mountnav.series.results import SeriesSettings
from mountnav.settings.observatory import Settings
from mountnav.settings.telescope import TelescopeSettings
from mountnav.simulation.virtual_time import VirtualClock, for_all_modules, run_virtually
from mountnav.sky.coordinates import Icrs

SWAPPED = timedelta(milliseconds=20)
"""An answer that is written down before its question is so much older at most: two threads write."""
GREETING = timedelta(minutes=2)
"""A driver's greeting and its first looks take no longer than this of virtual time."""
NEAR_ARCSEC = 15.0
"""An answer of a reading may be of the second before or after it: so much the sky turns in one."""
_ASKED, _SAID = "driver->mount", "mount->driver"
SETTLED = ("lx200", "nexstar", "synscan", "ioptron")
"""Families whose answers tell a place by themselves; others reckon it with the present time."""


@dataclass(slots=True)
class Turns:
    """What was answered to one question, and when it was asked; in the order of time."""

    utc: list[datetime] = field(default_factory=list)
    answers: list[bytes] = field(default_factory=list)

    def answered(self) -> Turns:
        """Without those that got none, if others did: silence isn't played."""
        kept = [(utc, answer) for utc, answer in zip(self.utc, self.answers, strict=True) if answer]
        return Turns([utc for utc, _ in kept], [answer for _, answer in kept]) if kept else self

    def at(self, utc: datetime) -> bytes:
        """The last answer until then; before the first the first."""
        return self.answers[max(bisect_right(self.utc, utc) - 1, 0)]


def turns_of(recording: Recording) -> dict[bytes, Turns]:
    """The recorded dialogue by question: what went out in one go, and all that came until the next.

    Two threads write down what goes over a line: an answer may stand before its question. So what comes when
    the last question has its answer, right before a question that got none, is that one's.
    """
    turns: dict[bytes, Turns] = {}
    last: Turns | None = None
    lines = [line for line in recording.of("wire") if line.facts["hex"]]
    for at, line in enumerate(lines):
        data = bytes.fromhex(line.facts["hex"])
        if line.facts["dir"] == _ASKED:
            early = _before_its_question(lines, at)
            if early and last is not None:
                last.answers[-1] = last.answers[-1].removesuffix(early)
            assert line.utc is not None
            last = turns.setdefault(data, Turns())
            last.utc.append(line.utc)
            last.answers.append(early)
        elif last is not None:
            last.answers[-1] += data
    return {question: answers.answered() for question, answers in turns.items()}


def _before_its_question(lines: list[Line], at: int) -> bytes:
    """The answer to a question that was written down right before it; mostly there is none."""
    if at < 2 or [line.facts["dir"] for line in lines[at - 2 : at]] != [_SAID, _SAID]:
        return b""
    if at + 1 < len(lines) and lines[at + 1].facts["dir"] == _SAID:
        return b""
    asked, said = lines[at].utc, lines[at - 1].utc
    if asked is None or said is None or asked - said > SWAPPED:
        return b""
    return bytes.fromhex(lines[at - 1].facts["hex"])


class TapeLine:
    """A `drivers.wire.line.ByteLine` that has no other end but a recording.

    It answers each question as the recording did last before the clock's time.
    """

    def __init__(self, turns: dict[bytes, Turns], clock: VirtualClock) -> None:
        self._turns = turns
        self._clock = clock
        self._came = bytearray()
        self._news = asyncio.Event()
        self._open = False

    @property
    def address(self) -> str:
        """For messages."""
        return "recording"

    @property
    def usable(self) -> bool:
        """Whether it is open."""
        return self._open

    async def open(self) -> None:
        """Open it."""
        self._came.clear()
        self._open = True

    async def close(self) -> None:
        """Close it."""
        self._open = False

    async def write(self, data: bytes) -> None:
        """Ask; the answer takes no time, so that the replay never runs late."""
        found = self._turns.get(data)
        if found is None:
            # it was never asked in the recording: nothing answers it
            return
        answer = found.at(self._clock.utc())
        await asyncio.sleep(0)
        self._came += answer
        self._news.set()

    async def write_now(self, data: bytes) -> None:
        """As `write`: nothing moves that would have to be stopped."""
        await self.write(data)

    async def read(self, timeout_s: float) -> bytes:
        """What came, or comes within the time."""
        if not self._came:
            try:
                async with asyncio.timeout(max(timeout_s, 0.0)):
                    await self._news.wait()
            except TimeoutError:
                pass
        return self.drain()

    def drain(self) -> bytes:
        """What has come so far."""
        came = bytes(self._came)
        self._came.clear()
        self._news.clear()
        return came

    async def lost(self) -> str:
        """Never."""
        await asyncio.Event().wait()
        return ""


@dataclass(frozen=True, slots=True)
class WireCheck:
    """What the real driver makes of a recorded wire, beside the recorded readings.

    Attributes
    ----------
    problem : str
        Why it could not be played; empty if it was.
    readings : int
        Recorded readings.
    alike : int
        So many that the driver reads as it did then, within a step of the mount and what it moves meanwhile.
    unanswered : int
        So many that the recorded wire had no answer for.
    """

    problem: str = ""
    readings: int = 0
    alike: int = 0
    unanswered: int = 0

    @property
    def text(self) -> str:
        """For people."""
        if self.problem:
            return self.problem
        text = f"through its driver {self.alike} of {self.readings} readings are as they were"
        return text + (f"; {self.unanswered} had no answer" if self.unanswered else "")


def check_wire(url: str, recording: Recording) -> WireCheck:
    """Let the real driver read the recorded wire at the times of the recorded readings. Opens no port.

    Parameters
    ----------
    url : str
        The mount's, for its driver and options.
    """
    readings = [reading_of(line.facts["reading"]) for line in recording.of("reading")]
    if not readings:
        return WireCheck("no reading was recorded")
    clock = VirtualClock(min(reading.utc for reading in readings) - GREETING)
    with for_all_modules(clock):
        return run_virtually(_checked(url, recording, readings, clock), clock)


async def _checked(
    url: str, recording: Recording, readings: list[MountReading], clock: VirtualClock
) -> WireCheck:
    family = url.partition("://")[0].partition("+")[0]
    mount = open_mount(url) if family in SETTLED else None
    if not isinstance(mount, GenericMount) or not isinstance(mount.language, SerialLanguage):
        return WireCheck(f"the wire of {family} is not read again: its answers alone don't give a place")
    mount.language.take_line(TapeLine(turns_of(recording), clock))
    alike = unanswered = 0
    try:
        await mount.open()
        for then in readings:
            await clock.sleep(max(0.0, (then.utc - clock.utc()).total_seconds()))
            try:
                now = await mount.reading()
            except DeviceError:
                unanswered += 1
                continue
            alike += apart_arcsec(then.place, now.place) <= NEAR_ARCSEC + mount.resolution_arcsec
    except DeviceError as error:
        return WireCheck(f"the recorded wire doesn't greet: {error}")
    finally:
        await mount.close()
    return WireCheck("", len(readings), alike, unanswered)


@dataclass(frozen=True, slots=True)
class Played:
    """A replay and how it was done.

    Attributes
    ----------
    wire : WireCheck or None
        What the real driver makes of the recorded wire; None where it wasn't asked.
    """

    report: ReplayReport
    wire: WireCheck | None


def play(
    recording: Recording,
    *,
    speed: float = 0.0,
    solve: bool = True,
    wire: bool = True,
    config: Path | None = None,
    catalog: Catalog | None = None,
) -> Played:
    """Decide a recorded night once more. Nothing goes over a port.

    Parameters
    ----------
    speed : float
        Seconds of the night in one second; 0: as fast as it goes.
    solve : bool
        Identify frames again where their files are there.
    wire : bool
        Let the mount's driver read the recorded wire, where there is one, and compare the readings. No
        decision hangs on that.
    config : Path or None
        Other settings than the recorded ones.
    catalog : Catalog, optional
        Instead of that of the settings.

    Raises
    ------
    BadRequest
        The recording holds nothing, or settings that this version can't take.
    BadSettings
        The other settings are wrong.
    """
    telescope_id = str(recording.header["telescope"])
    settings = _settings(recording, config)
    telescope = _telescope(settings, telescope_id)
    if not any(line.kind != "wire" for line in recording.lines):
        raise BadRequest("the recording holds nothing", device=str(recording.path))
    identify, problem = _identifier(telescope, settings, catalog) if solve else (None, "")
    replay = Replay(
        recording,
        telescope.night.rules,
        settings.site.site,
        telescope.id,
        sync_rules(telescope.sync.policy, centering_policy(telescope)),
        other_rules=config is not None,
        anew=identify,
        read=_read,
        speed=speed,
    )
    report = asyncio.run(replay.run())
    if problem:
        report = replace(report, notes=(*report.notes, problem))
    checked = check_wire(_url(recording, telescope), recording) if wire and recording.has_wire else None
    return Played(report, checked)


def _settings(recording: Recording, config: Path | None) -> Settings:
    if config is not None:
        return Settings.load(config)
    try:
        return recorded_settings(recording.header)
    except (KeyError, ValueError) as cause:
        raise BadRequest(
            f"this version can't take the recorded settings: {cause}",
            device=str(recording.path),
            advice="give settings with --config",
        ) from cause


def _telescope(settings: Settings, telescope_id: str) -> TelescopeSettings:
    for telescope in settings.telescope:
        if telescope.id == telescope_id:
            return telescope
    raise BadRequest(
        f"these settings have no telescope {telescope_id}", advice="give settings of the recorded telescope"
    )


def _url(recording: Recording, telescope: TelescopeSettings) -> str:
    """The recorded mount's URL; a fake's is that of its language on a port that is never opened."""
    mount = telescope.mount
    return f"{mount.fake[0]}+serial:///recorded" if mount.is_fake else mount.url


def _identifier(
    telescope: TelescopeSettings, settings: Settings, catalog: Catalog | None
) -> tuple[Callable[[], Placing] | None, str]:
    """What identifies frames again, by the catalogs and masters of the settings; or why they can't be."""
    try:
        shelf = open_catalogs(settings.catalogs.choice()) if catalog is None else catalog
        identify = partial(_by_series, telescope, settings, shelf)
        identify()  # masters that can't be read are found here
    except (BadSettings, BadRequest, BadFrame) as trouble:
        return None, f"no frame was identified again: {trouble}"
    return identify, ""


def _by_series(telescope: TelescopeSettings, settings: Settings, catalog: Catalog) -> BySeries:
    """Identify frames as the night did."""
    policy = centering_policy(telescope)
    solving = solve_settings(settings.solving, calibration=telescope.calibration)
    if solving.blind != "never" and isinstance(catalog, CatalogSet):
        solving = replace(solving, index=installed_index(catalog.indexed))  # as the night had it
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

    return BySeries(catalog, hint, SeriesSettings(solving=solving, audit_every=telescope.night.audit_every))


def _read(path: Path, digest: str) -> Frame | None:
    """The frame of a file, if it is still the one that was recorded."""
    try:
        return read_frame(path, raw=True) if digest_of(path) == digest else None
    except (OSError, BadFrame):
        return None
