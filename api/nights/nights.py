"""The nights of the service's telescopes: a runner, with its task, for each that has nights."""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections.abc import Awaitable, Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from datetime import timedelta
from functools import partial
from pathlib import Path

from api.access.security import allowed_file
from api.nights.safety_file import SafetyFile
from api.observatory.observatory import Heard, Observatory
from drivers.folder.watcher import FolderWatcher
from drivers.wire.wire_log import WireEntry, WireLog
from mountnav.catalog.stars import Catalog
from mountnav.clock import Clock, SystemClock
from mountnav.ephemeris import Ephemeris
from mountnav.errors import Busy, DeviceError, JournalFailed, NotFound
from mountnav.files import open_buffered
from mountnav.frames import Frame, Hint
from mountnav.journal.records import Entry, EntryKind, Journal, Unwritten
from mountnav.journal.sql_journal import SqlJournal
from mountnav.navigation.policy import CenteringPolicy
from mountnav.night.daylight import night_name, sun_altitude_deg
from mountnav.night.events import Phase, Word
from mountnav.night.frames_in import FrameAnswer, FramesIn, Receipt
from mountnav.night.memory import remembered
from mountnav.night.parking import NightTelescope, Preempt
from mountnav.night.placing import BySeries, Placing
from mountnav.night.recording import NightRecording
from mountnav.night.session import Listen, NightSession
from mountnav.reading import read_frame
from mountnav.series.results import SeriesSettings
from mountnav.settings.night import NightSettings
from mountnav.settings.observatory import Settings
from mountnav.settings.telescope import TelescopeSettings
from mountnav.sky.coordinates import Icrs, Site
from mountnav.solving.settings import SolveSettings
from mountnav.tasks import fault_words, waited_for

_log = logging.getLogger(__name__)

TICK_S = 5.0
"""Between two ticks of a night and two looks at its safety file, s; chosen by hand. Doubled, rain is noticed
up to 5 s later."""
READY_AGAIN_S = 15.0
"""Between tries to reach a mount that isn't there, s: each may take long, and lists ports. Doubled, a night
goes on that much later once the mount is back."""
CLOCK_STEP_S = 0.5
"""A difference between the machine's clock and the loop's time that counts as a clock that was set, s; NTP
slews less than 0.5 ms in a second. Doubled, a step of 1 s stays in the recording."""
SAFETY_FILE = "safety file"
"""Who says that it is safe or not, where the settings name a file."""
ROWS_READ = 4000
"""Of the journal, to go on where the last life of the service ended."""

Recall = Callable[[str, EntryKind, int], Awaitable[Sequence[Entry]]]


@dataclass(frozen=True, slots=True)
class NightParts:
    """What a runner needs.

    Attributes
    ----------
    listen : callable
        Told of each decision.
    search_radius_deg : float
        How far the mount's belief may be wrong.
    scale_arcsec_px : (float, float) or None
        Between what bounds the scale lies.
    recall : callable or None
        Newest journal rows of a telescope and kind, oldest first.
    wire_log : WireLog or None
        Of the mount, for recordings.
    placing : Placing or None
        Instead of following series.
    ready : callable or None
        Opens the telescope if it is not open; asked again and again while the mount can't be read.
    make_way : callable or None
        Ends what others do with the telescope, where it must be parked because it isn't safe.
    """

    telescope_id: str
    settings: NightSettings
    navigator: NightTelescope
    site: Site
    catalog: Catalog
    solving: SolveSettings
    listen: Listen
    journal: Journal = field(default_factory=Unwritten)
    search_radius_deg: float = 2.0
    scale_arcsec_px: tuple[float, float] | None = None
    recall: Recall | None = None
    wire_log: WireLog | None = None
    recording: NightRecording | None = None
    clock: Clock | None = None
    placing: Placing | None = None
    ready: Callable[[], Awaitable[object]] | None = None
    make_way: Preempt | None = None


class NightRunner:
    """One telescope's nights: watches the folder, takes frames in, lets time pass."""

    def __init__(self, parts: NightParts) -> None:
        self.parts = parts
        self._settings = parts.settings
        self._clock = parts.clock or SystemClock()
        self._frames = FramesIn(parts.settings.frames_waiting)
        self._tasks: list[asyncio.Task[None]] = []
        self._session: NightSession | None = None
        self._unsafe: str | None = None
        """What the safety file was last told to say."""
        self._away = ""
        self._safety_known = asyncio.Event()
        file = parts.settings.safety_file
        self._safety = None if file is None else SafetyFile(file, parts.settings.safety_max_age_s)
        self._mount_facts: dict[str, object] = {}
        self.watcher: FolderWatcher | None = None

    @property
    def session(self) -> NightSession:
        """The session. Raises `Busy` before `start`."""
        if self._session is None:
            raise Busy("the night has not begun to run", device=self.parts.telescope_id)
        return self._session

    @property
    def is_under_way(self) -> bool:
        """Whether frames are corrected, or will be: not while it waits for darkness or was stopped."""
        return self._session is not None and self._session.state.phase in (Phase.CALIBRATING, Phase.FOLLOWING)

    # -- its life -----------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Read what the journal remembers, and begin to run. Nothing is opened and nothing moves."""
        parts = self.parts
        known = None
        if parts.recall is not None:
            known = remembered(await parts.recall(parts.telescope_id, EntryKind.NIGHT, ROWS_READ))
        session = NightSession(
            parts.navigator,
            self._settings.rules,
            self._frames,
            parts.placing or BySeries(parts.catalog, self._hint, self._series()),
            name=parts.telescope_id,
            sun_altitude_deg=lambda utc: sun_altitude_deg(utc, parts.site),
            night_name=lambda utc: night_name(parts.telescope_id, utc, parts.site),
            journal=parts.journal,
            clock=self._clock,
            listen=parts.listen,
            remembered=known,
            recorder=parts.recording,
            make_way=parts.make_way,
        )
        await session.begin()
        self._session = session
        self._record_wire()
        work: list[Callable[[], Awaitable[None]]] = [
            self._watch_safety,
            self._take,
            self._pass_time,
            self._read_mount,
        ]
        if self._settings.folder is not None:
            self.watcher = FolderWatcher(
                self._settings.folder,
                self._settings.pattern,
                self._settings.poll_s,
                clock=self._clock,
                tell=self._told_of_folder,
            )
            await self.watcher.begin()
            work.append(self._watch)
        self._tasks = [waited_for(self._kept(task), f"night {task.__name__}") for task in work]

    async def close(self) -> None:
        """End: a correction under way is ended and written down as such. Twice is fine."""
        tasks, self._tasks = self._tasks, []
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if self.parts.recording is not None:
            await asyncio.to_thread(self.parts.recording.close)

    # -- what the routes ask ------------------------------------------------------------------------------

    def offer_file(
        self, path: Path, digest: str, *, held: bool = False, target: Icrs | Ephemeris | None = None
    ) -> Receipt:
        """Take in a file of this machine; `digest` is its SHA-256. Raises `Busy`."""
        return self._frames.offer(
            str(path),
            digest,
            lambda: read_frame(path, raw=True),
            self._clock.utc(),
            held=held,
            target=target,
        )

    def offer_frame(
        self,
        source: str,
        digest: str,
        read: Callable[[], Frame],
        *,
        held: bool = False,
        target: Icrs | Ephemeris | None = None,
        pixels: bool = True,
    ) -> Receipt:
        """Take in a frame that is read by `read`, in a thread. Raises `Busy`."""
        return self._frames.offer(
            source, digest, read, self._clock.utc(), held=held, target=target, pixels=pixels
        )

    def allowed(self, path: Path) -> Path:
        """The file, if it lies in a folder that frames may be taken from.

        Raises
        ------
        BadRequest
            It doesn't; links out of a folder don't count.
        NotFound
            There is no such file.
        """
        return allowed_file(path, self._settings.folders, telescope_id=self.parts.telescope_id)

    async def result(self, frame_id: str, wait_s: float) -> FrameAnswer:
        """What became of a frame; see `FramesIn.result`."""
        return await self._frames.result(frame_id, wait_s)

    def newest(self, count: int) -> list[FrameAnswer]:
        """The newest frames, newest first."""
        return self._frames.newest(count)

    # -- what runs ----------------------------------------------------------------------------------------

    async def _kept(self, work: Callable[[], Awaitable[None]]) -> None:
        """Keep a task at work: a fault of ours costs one turn, not the night."""
        told = ""
        while True:
            try:
                await work()
            except Exception as fault:
                if (words := fault_words(fault)) != told:
                    told = words
                    _log.exception("%s: the night failed unexpectedly and goes on", self.parts.telescope_id)
                    self.parts.listen("night-fault", {"problem": words})
            await self._clock.sleep(1.0)

    async def _take(self) -> None:
        await self._safety_known.wait()
        while True:
            await self.session.take(await self._frames.next())

    async def _pass_time(self) -> None:
        # nothing is begun before it is known whether it is safe
        await self._safety_known.wait()
        while True:
            await self.session.tick()
            await self._clock.sleep(TICK_S)

    async def _read_mount(self) -> None:
        while True:
            pause_s = self._settings.read_mount_every_s
            if self.session.state.running:
                if await self._is_ready():
                    await self.session.read_mount()
                    self._record_mount()
                else:
                    # each try may take long, and list ports
                    pause_s = max(pause_s, READY_AGAIN_S)
            await self._clock.sleep(pause_s)

    async def _is_ready(self) -> bool:
        """Whether the telescope is open; nobody else opens it at night."""
        if self.parts.ready is None:
            return True
        try:
            await self.parts.ready()
        except DeviceError as error:
            if not self._away:
                self._away = str(error)
                await self.session.say(Word.MOUNT_LOST, str(error))
            return False
        if self._away:
            self._away = ""
            await self.session.say(Word.MOUNT_BACK)
        return True

    def _record_mount(self) -> None:
        """Keep what a tape must know of the mount, once it is known and when it changes."""
        mount, recording = self.parts.navigator.mount, self.parts.recording
        if recording is None:
            return
        facts = {
            "name": getattr(mount, "name", ""),
            "epoch": getattr(mount, "epoch", None),
            "resolution_arcsec": getattr(mount, "resolution_arcsec", None),
            "skills": sorted(getattr(mount, "skills", ())),
        }
        if facts != self._mount_facts:
            self._mount_facts = facts
            recording.keep("mount", self._clock.utc(), facts)

    async def _watch(self) -> None:
        assert self.watcher is not None
        async for new in self.watcher.files():
            # the folder keeps what the queue has no room for
            while self._frames.is_full:
                await self._clock.sleep(self._settings.poll_s)
            self.offer_file(new.path, new.digest)

    async def _watch_safety(self) -> None:
        while True:
            await self._look_at_safety()
            self._safety_known.set()
            await self._clock.sleep(TICK_S)

    async def _look_at_safety(self) -> None:
        if self._safety is None:
            if any(by == SAFETY_FILE for by, _ in self.session.state.unsafe):
                await self.session.say(Word.SAFE, "no safety file is set any more", by=SAFETY_FILE)
            return
        told = await self._safety.look()
        # of an earlier run's word nothing is left when this one has looked
        if told != self._unsafe:
            word = Word.UNSAFE if told else Word.SAFE
            await self.session.say(word, told or f"{self._safety.file.name} says so", by=SAFETY_FILE)
            self._unsafe = told

    # -- parts --------------------------------------------------------------------------------------------

    def _series(self) -> SeriesSettings:
        return SeriesSettings(solving=self.parts.solving, audit_every=self._settings.audit_every)

    def _hint(self, near: Icrs | None) -> Hint | None:
        bounds = self.parts.scale_arcsec_px
        if near is None and bounds is None:
            return None
        low, high = bounds or (None, None)
        return Hint(
            center=near,
            radius_deg=self.parts.search_radius_deg,
            scale_low_arcsec_px=low,
            scale_high_arcsec_px=high,
            center_source="the mount's reading",
            scale_source="the settings",
        )

    def _told_of_folder(self, told: str) -> None:
        _log.warning("%s: %s", self.parts.telescope_id, told)
        self.parts.listen("night-folder", {"told": told})

    def _record_wire(self) -> None:
        """Keep what goes over the mount's line, from its greeting on as far as the ring has it."""
        log, recording = self.parts.wire_log, self.parts.recording
        if log is None or recording is None:
            return

        # one origin for all: messages of one dialogue must never change places
        began = self._clock.utc() - timedelta(seconds=log.now_s())

        def keep(entry: WireEntry) -> None:
            nonlocal began
            off_s = (self._clock.utc() - began).total_seconds() - log.now_s()
            if abs(off_s) > CLOCK_STEP_S:
                # the machine's clock was set
                began += timedelta(seconds=off_s)
            facts = {"dir": entry.way, "hex": entry.data.hex(), "meaning": entry.meaning}
            recording.keep("wire", began + timedelta(seconds=entry.t_s), facts)

        for entry in log.entries():
            keep(entry)
        log.listen(keep)


class Nights:
    """The runners of all telescopes that have nights."""

    def __init__(self, runners: Iterable[NightRunner] = ()) -> None:
        self._runners = {runner.parts.telescope_id: runner for runner in runners}
        self._begun: set[str] = set()

    def of(self, telescope_id: str) -> NightRunner:
        """The runner of a telescope. Raises `NotFound` if it has no nights."""
        if telescope_id not in self._runners:
            raise NotFound(
                "this telescope has no nights", device=telescope_id, advice="set night.enabled = true"
            )
        return self._runners[telescope_id]

    def is_running(self, telescope_id: str) -> bool:
        """Whether a telescope's night is under way."""
        runner = self._runners.get(telescope_id)
        return runner is not None and runner.is_under_way

    def exchange(self, gone: Collection[str], others: Nights) -> list[NightRunner]:
        """Take these out, and others in, which `start` begins; those out are returned, to be closed."""
        out = [self._runners.pop(one) for one in gone if one in self._runners]
        self._begun -= set(gone)
        self._runners |= others._runners
        return out

    async def start(self) -> None:
        """Let all begin to run that don't yet; one that can't is logged, and the others run.

        Raises
        ------
        JournalFailed
            What one of them remembers can't be read, or that it goes on can't be written: to be called again.
        """
        failure: JournalFailed | None = None
        for name, runner in tuple(self._runners.items()):
            if name in self._begun:
                continue
            try:
                await runner.start()
            except JournalFailed as failed:
                failure = failure or failed
                continue
            except Exception:
                _log.exception("%s: its nights could not begin", name)
            self._begun.add(name)
        if failure is not None:
            raise failure

    async def close(self) -> None:
        """End all. Call it before the telescopes are released. Twice is fine."""
        await asyncio.gather(*(runner.close() for runner in self._runners.values()))


def digest_of(path: Path) -> str:
    """SHA-256 of a file's content, hexadecimal. Blocks."""
    with open_buffered(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def nights_of(
    settings: Settings,
    observatory: Observatory,
    catalog: Catalog,
    heard: Heard,
    journal: SqlJournal,
    *,
    make_way: Callable[[str], Awaitable[None]],
) -> Nights:
    """Make the runners; nothing runs before their start.

    Parameters
    ----------
    heard : callable
        ``heard(telescope_id, kind, data)``: told of each decision.
    journal : SqlJournal
        Also tells where the last run of the service ended.
    make_way : callable
        ``make_way(telescope_id)`` ends what others do with a telescope that must be parked now.
    """

    def runner(one: TelescopeSettings) -> NightRunner:
        telescope = observatory.telescope(one.id)
        navigator = telescope.navigator
        wire_log = navigator.mount.wire_log
        return NightRunner(
            NightParts(
                telescope_id=one.id,
                settings=one.night,
                navigator=navigator,
                site=settings.site.site,
                catalog=catalog,
                solving=navigator.solving,
                listen=_listener(heard, one.id),
                journal=telescope.journal,
                search_radius_deg=navigator.policy.search_radius_deg,
                ready=telescope.ready,
                scale_arcsec_px=_scale(navigator.policy),
                recall=journal.recent,
                wire_log=wire_log if isinstance(wire_log, WireLog) else None,
                recording=telescope.recording,
                make_way=partial(make_way, one.id),
            )
        )

    return Nights(runner(telescope) for telescope in settings.telescope if telescope.night.enabled)


def _listener(heard: Heard, telescope_id: str) -> Listen:
    return lambda kind, data: heard(telescope_id, kind, data)


def _scale(policy: CenteringPolicy) -> tuple[float, float] | None:
    scale_arcsec_px = policy.scale_arcsec_px
    if scale_arcsec_px is None:
        return None
    low, high = (scale_arcsec_px * (1.0 + sign * policy.scale_tolerance) for sign in (-1.0, 1.0))
    return low, high
