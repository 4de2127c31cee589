"""The observatory: each configured telescope put together, connected when possible, let go in the end."""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

from api.observatory.dead_man import MountGuard
from api.observatory.fake_mounts import fake_on_pty, mechanics_of
from api.observatory.last_frame import LastFrame
from api.observatory.navigators import make_navigator
from api.observatory.restart import Restart
from api.replay.recording_header import recording_header
from drivers.fakes.bench import FakeOnPty
from drivers.folder.camera import FolderCamera
from drivers.registry import fake_dialects, open_camera, open_mount, open_rotator
from mountnav.catalog.catalog_set import CatalogSet, DrawnSky
from mountnav.catalog.stars import Catalog
from mountnav.clock import SystemClock
from mountnav.devices import Camera, Mount, Rotator
from mountnav.errors import (
    BadSettings,
    DeviceError,
    DeviceMissing,
    DeviceSilent,
    JournalFailed,
    MountnavError,
    NotFound,
)
from mountnav.journal.records import Journal
from mountnav.journal.sql_journal import SqlJournal
from mountnav.navigation.equipment import Solve
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.reports import TelescopeState
from mountnav.night.daylight import night_name
from mountnav.night.recording import NightRecording, RecordedJournal
from mountnav.settings.aiming import SIMULATED_ROTATOR
from mountnav.settings.explained import line_of
from mountnav.settings.observatory import Settings
from mountnav.settings.telescope import (
    AlpacaCameraSettings,
    FolderCameraSettings,
    IndiCameraSettings,
    SimulatedCameraSettings,
    TelescopeSettings,
)
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.rotator_mechanics import RotatorBehavior, RotatorMechanics

_log = logging.getLogger(__name__)

Heard = Callable[[str, str, dict[str, object]], None]
SolveFor = Callable[[str], Solve]


@dataclass(slots=True)
class Telescope:
    """A telescope of the service: its navigator, and whether its devices are open.

    Attributes
    ----------
    mount_address : str
        For people.
    journal : Journal
        Where all of it is written down.
    restart : Restart
        What an earlier run of the service left in flight.
    bench : FakeOnPty or None
        The fake mount that this service runs itself.
    mechanics : Mechanics or None
        That fake's mechanics: where its tube truly looks. Nothing that steers may ask it.
    recording : NightRecording or None
        Where its nights are kept for `mountnav replay`.
    last_frame : LastFrame or None
        The last frame that was solved, for people to look at.
    dead_man : MountGuard or None
        Ends what goes on by itself at its mount when the service is dead; None for fakes that die with it.
    """

    id: str
    navigator: Navigator
    mount_address: str
    journal: Journal
    restart: Restart
    bench: FakeOnPty | None = None
    mechanics: Mechanics | None = None
    recording: NightRecording | None = None
    last_frame: LastFrame | None = None
    dead_man: MountGuard | None = None
    problem: str | None = None
    is_gone: bool = False
    """Taken out of the service: it is never opened again."""
    is_open: bool = False
    is_taken_up: bool = False
    """What an earlier run left in flight is closed; nothing but a stop and a park is sent before."""
    _opening: asyncio.Lock = field(default_factory=asyncio.Lock)

    async def ready(self, *, even_unwritten: bool = False) -> Navigator:
        """Open the devices if they are not; called before each command, so a lost port is tried again.

        Parameters
        ----------
        even_unwritten : bool
            For stops and parks: a journal that can't be read or written is no hindrance. What an earlier run
            left in flight is closed before the next order, then.

        Raises
        ------
        DeviceError
            They can't be opened; `DeviceMissing` tells which ports exist.
        JournalFailed
            What an earlier run left in flight can't be closed.
        """
        async with self._opening:
            if self.is_gone:
                raise DeviceMissing(
                    "the telescope was taken out of the service, or its settings changed",
                    device=self.id,
                    advice="ask for the telescopes again",
                )
            if not self.is_open:
                await self._hold()
                try:
                    await self.navigator.open()
                except DeviceError as error:
                    self.problem = str(error)
                    self._let_go()
                    raise
                self.is_open, self.is_taken_up = True, False
            if not self.is_taken_up:
                try:
                    await self._take_up()
                except JournalFailed as error:
                    self.problem = str(error)
                    if not even_unwritten:
                        raise
                    return self.navigator
                except BaseException as error:
                    self.is_open = False
                    await self._release()
                    if isinstance(error, DeviceError):
                        self.problem = str(error)
                    raise
                self.is_taken_up = True
            self.problem = None
        return self.navigator

    async def lost(self, error: DeviceError) -> None:
        """Let a link go that failed, so that the next command opens it again.

        A mount that keeps its own link is left alone: it connects again by itself, and is stopped then.
        """
        self.problem = str(error)
        if self.is_open and self.navigator.mount.link is None:
            self.is_open = False
            await self._release()

    async def state(self) -> TelescopeState:
        """What is known now; never raises for device trouble."""
        if not self.is_open:
            return TelescopeState(self.id, False, "idle", None, None, None, None, self.problem)
        state = await self.navigator.state()
        if state.connected:
            # it answers: what kept it away is over, though nobody has ordered anything since
            self.problem = None
        return (
            state
            if state.problem
            else replace(state, problem=self.problem or self.restart.told(self.navigator.mount))
        )

    async def stop(self) -> None:
        """Stop all motion now. Raises `DeviceError` when that could not be sent to the mount."""
        await (await self.ready(even_unwritten=True)).stop()

    async def close(self) -> None:
        """Stop what moves, and release everything. Trouble on the way is logged, the rest still done."""
        if self.is_open:
            try:
                await self.navigator.stop()
            except MountnavError as error:
                _log.error("%s could not be stopped while the service was shutting down: %s", self.id, error)
            await self._release()
        self.is_open = False
        if self.dead_man is not None:
            await self.dead_man.close()
        if self.bench is not None:
            await asyncio.to_thread(self.bench.stop)

    async def _take_up(self) -> None:
        navigator = self.navigator
        await self.restart.at_first_link(navigator.mount, navigator.guard, navigator.rates, navigator.rotator)

    async def _release(self) -> None:
        try:
            await self.navigator.close()
        except DeviceError as error:
            _log.warning("%s: closing: %s", self.id, error)
        self._let_go()

    async def _hold(self) -> None:
        """Have the mount for this service, once no guard of an earlier run is at work with it."""
        if self.dead_man is not None:
            await self.dead_man.hold()

    def _let_go(self) -> None:
        if self.dead_man is not None:
            self.dead_man.release()


class Observatory:
    """All telescopes of the service."""

    def __init__(self, telescopes: Sequence[Telescope]) -> None:
        self._telescopes = {telescope.id: telescope for telescope in telescopes}

    @property
    def telescopes(self) -> list[Telescope]:
        """In the order of the settings."""
        return list(self._telescopes.values())

    def telescope(self, telescope_id: str) -> Telescope:
        """Return the telescope of that id. Raises `NotFound`."""
        if telescope_id not in self._telescopes:
            raise NotFound(
                "there is no telescope of this id",
                advice=f"there is: {', '.join(self._telescopes) or 'none'}",
            )
        return self._telescopes[telescope_id]

    def put(self, telescopes: Sequence[Telescope]) -> list[Telescope]:
        """Have these from now on; those that are no more among them are returned, to be closed.

        From this moment on nothing opens those again.
        """
        gone = [one for one in self.telescopes if all(one is not other for other in telescopes)]
        for one in gone:
            one.is_gone = True
        self._telescopes = {telescope.id: telescope for telescope in telescopes}
        return gone

    async def open(self) -> None:
        """Open all devices side by side; one that is missing is logged and kept for later."""
        await asyncio.gather(*(open_quietly(telescope) for telescope in self.telescopes))

    async def close(self) -> None:
        """Stop and release everything."""
        await asyncio.gather(*(telescope.close() for telescope in self.telescopes))


def build_observatory(
    settings: Settings, catalog: Catalog, heard: Heard, solve: SolveFor, journal: SqlJournal
) -> Observatory:
    """Put the telescopes of the settings together; fakes are started, nothing else is opened.

    Parameters
    ----------
    catalog : Catalog
        For drawing simulated frames.
    heard : callable
        ``heard(telescope_id, kind, data)``: told of each step.
    solve : callable
        ``solve(telescope_id)`` gives the solver of that telescope's looks.
    journal : SqlJournal
        Where all that they do is written down.
    """
    return Observatory(
        [
            build_telescope(telescope, settings, catalog, heard, solve, journal)
            for telescope in settings.telescope
        ]
    )


def link_is_lost(error: BaseException) -> bool:
    """Whether an error means that the port should be opened again."""
    return isinstance(error, DeviceMissing | DeviceSilent)


async def open_quietly(telescope: Telescope) -> None:
    """Open a telescope's devices; one that is missing is logged and kept for later."""
    try:
        await telescope.ready()
    except DeviceError as error:
        _log.warning(
            "%s is not connected, and will be tried again with the next command: %s", telescope.id, error
        )
    except JournalFailed as error:
        _log.warning(
            "%s is connected, and takes nothing but a stop and a park until the journal is back: %s",
            telescope.id,
            error,
        )


def build_telescope(
    one: TelescopeSettings,
    settings: Settings,
    catalog: Catalog,
    heard: Heard,
    solve: SolveFor,
    sql_journal: SqlJournal,
) -> Telescope:
    """Put one telescope together, as `build_observatory` does all."""
    restart = Restart(sql_journal, one.id, outlives=not one.mount.is_fake)
    journal: Journal = sql_journal
    bench: FakeOnPty | None = None
    mechanics: Mechanics | None = None
    url = one.mount.url
    if one.mount.is_fake:
        mechanics = mechanics_of(one, settings)
        if one.mount.mounting is None:
            # ours to know: as its family usually is
            known = one.mount.model_copy(update={"mounting": mechanics.machine.mounting})
            one = one.model_copy(update={"mount": known})
        protocol, dialect = one.mount.fake
        bench = fake_on_pty(protocol, dialect, mechanics)
        url = f"{protocol}+serial://{bench.address}"
    mount: Mount = open_mount(_with_options(url, one), name=one.id, site=settings.site.site)
    dead_man: MountGuard | None = None
    if not one.mount.is_fake and one.following.guard:
        guarded = _with_options(url, one, sets=False)
        dead_man = MountGuard(one.id, guarded, settings.site.site, one.following.on_loss)
        restart.guard = dead_man

    def listen(kind: str, data: dict[str, object]) -> None:
        restart.heard(kind)
        heard(one.id, kind, data)

    recording: NightRecording | None = None
    if one.night.enabled and one.night.record is not None:
        site = settings.site.site
        recording = NightRecording(
            one.night.record,
            recording_header(one, settings),
            lambda utc: night_name(one.id, utc, site),
            keep_days=one.night.record_keep_days,
            max_mb=one.night.record_max_mb,
        )
        journal = RecordedJournal(journal, recording.keep)
    seen = LastFrame(solve(one.id))
    rotator, turns = _rotator(one)
    navigator = make_navigator(
        one,
        settings,
        mount=mount,
        camera=_camera(one, mechanics, catalog, turns, seed=settings.demo.seed if settings.demo else None),
        rotator=rotator,
        catalog=catalog,
        solve=seen,
        listen=listen,
        journal=journal,
        dead_man=dead_man,
    )
    restart.tell = listen
    return Telescope(one.id, navigator, url, journal, restart, bench, mechanics, recording, seen, dead_man)


def require_devices(settings: Settings, file: Path | None = None) -> None:
    """Check what the settings say of mounts and cameras by making them; nothing is opened or started.

    Parameters
    ----------
    file : Path, optional
        Where they stand, for the line in the message.

    Raises
    ------
    BadSettings
        If a URL or an option of it makes no sense.
    """
    for number, one in enumerate(settings.telescope):
        with _told_of(file, number, one, "mount", "url"):
            if one.mount.is_fake:
                protocol, dialect = one.mount.fake
                if dialect is not None and dialect not in (known := fake_dialects(protocol)):
                    raise BadSettings(
                        f"no fake mount of {protocol} speaks the dialect {dialect}",
                        advice=f"there is: {', '.join(known)}",
                    )
            else:
                mount_of(one, settings)
        with _told_of(file, number, one, "limits", "horizon_file"):
            # reads the file of the horizon
            _ = one.limits.limits
        with _told_of(file, number, one, "camera", "url"):
            match one.camera:
                case AlpacaCameraSettings() as camera:
                    open_camera(camera.device_url, name=one.id)
                case IndiCameraSettings(url=url):
                    open_camera(url, name=one.id)
        if one.rotator is not None and one.rotator.url != SIMULATED_ROTATOR:
            with _told_of(file, number, one, "rotator", "url"):
                open_rotator(one.rotator.url, name=one.id)


def mount_of(one: TelescopeSettings, settings: Settings, *, asked_only: bool = False) -> Mount:
    """The driver of a telescope's real mount, not opened.

    Parameters
    ----------
    asked_only : bool
        Opening it sets neither its clock nor its site, whatever the settings say.

    Raises
    ------
    BadSettings
        Its URL or an option of it makes no sense.
    """
    if asked_only:
        asked = re.sub(r"(?<=[?&])set_(clock|site)=[^&#]*&?", "", one.mount.url).rstrip("?&")
        mount = one.mount.model_copy(update={"url": asked, "set_clock": False, "set_site": False})
        one = one.model_copy(update={"mount": mount})
    return open_mount(_with_options(one.mount.url, one), name=one.id, site=settings.site.site)


@contextmanager
def _told_of(file: Path | None, number: int, one: TelescopeSettings, *key: str) -> Iterator[None]:
    """Add where in the settings it stands to what is wrong with a device."""
    try:
        yield
    except BadSettings as error:
        text = "" if file is None else file.read_text(encoding="utf-8")
        line = line_of(text, ("telescope", number, *key))
        where = f"line {line}: " if line else ""
        raise BadSettings(
            f"{where}{'.'.join(('telescope', *key))} of {one.id}: {error.what}",
            device=None if file is None else str(file),
            advice=error.advice,
        ) from error


def _with_options(url: str, one: TelescopeSettings, *, sets: bool = True) -> str:
    """The URL with what the settings say of the mount as its options, unless it says its own.

    `sets`: whether connecting may set its clock and site, where they say so.
    """
    mount = one.mount
    if not sets:
        base, _, query = url.partition("?")
        kept = [
            part for part in query.split("&") if part and not part.startswith(("set_clock=", "set_site="))
        ]
        url = f"{base}?{'&'.join(kept)}" if kept else base
    given = {
        "epoch": mount.epoch,
        "set_clock": "yes" if mount.set_clock and sets else None,
        "set_site": "yes" if mount.set_site and sets else None,
        "trust_on_connect": None if mount.trust_on_connect else "no",
        "swap_sides": _yes_or_no(mount.swap_sides),
        "dtr": _yes_or_no(mount.dtr),
        "rts": _yes_or_no(mount.rts),
        "settle_s": None if mount.settle_s is None else f"{mount.settle_s:g}",
    }
    added = [f"{name}={value}" for name, value in given.items() if value and f"{name}=" not in url]
    return f"{url}{'&' if '?' in url else '?'}{'&'.join(added)}" if added else url


def _yes_or_no(value: bool | None) -> str | None:
    return None if value is None else "yes" if value else "no"


_SIMULATED_DEG_S = 12.0
"""How fast a simulated rotator turns, °/s: four times as fast as usual ones: nobody likes to wait. Doubled,
a demonstration hardly shows it turn."""


def _rotator(one: TelescopeSettings) -> tuple[Rotator | None, RotatorMechanics | None]:
    """What turns the camera; and how, if it is a simulated one."""
    if one.rotator is None:
        return None, None
    name = f"{one.id} rotator"
    if one.rotator.url != SIMULATED_ROTATOR:
        return open_rotator(one.rotator.url, name=name), None
    from drivers.simulated.rotator import simulated_rotator

    clock = SystemClock()
    turns = RotatorMechanics(
        clock, RotatorBehavior(rate_deg_s=_SIMULATED_DEG_S), starts_deg=one.rotator.rules.least_deg + 10.0
    )
    return simulated_rotator(turns, clock, name=name), turns


def _camera(
    one: TelescopeSettings,
    mechanics: Mechanics | None,
    catalog: Catalog,
    turns: RotatorMechanics | None = None,
    *,
    seed: int | None = None,
) -> Camera:
    match one.camera:
        case FolderCameraSettings(path=path, pattern=pattern, timeout_s=timeout_s):
            return FolderCamera(path, pattern, timeout_s)
        case AlpacaCameraSettings() as camera:
            return open_camera(camera.device_url, name=f"{one.id} camera")
        case IndiCameraSettings(url=url):
            return open_camera(url, name=f"{one.id} camera")
        case SimulatedCameraSettings() as optics:
            assert mechanics is not None, "the settings let a simulated camera stand on a fake mount alone"
            # what draws its frames is expensive, and no real telescope needs it
            from drivers.simulated.camera import SimulatedCamera
            from mountnav.simulation.optics import SimulatedOptics

            return SimulatedCamera(
                mechanics.truth,
                SimulatedOptics(**optics.model_dump(exclude={"kind"})),
                DrawnSky(catalog) if isinstance(catalog, CatalogSet) else catalog,
                seed=seed or 0,
                name=f"{one.id} simulated camera",
                tube_angle_deg=_stands(mechanics, turns),
            )


def _stands(mechanics: Mechanics, turns: RotatorMechanics | None) -> Callable[[datetime], float]:
    """How the camera stands on the sky, besides how it is built in."""
    if turns is None:
        return mechanics.tube_angle_deg
    return lambda utc: mechanics.tube_angle_deg(utc) + turns.camera_deg(utc)
