"""The observatory: each configured telescope put together, connected when possible, let go in the end."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from api.solving import solve_settings
from drivers.bench import FakeOnPty
from drivers.folder.camera import FolderCamera
from drivers.lx200.fake import FakeLx200
from drivers.registry import open_mount
from mountnav.catalog.stars import Catalog
from mountnav.errors import DeviceError, DeviceMissing, DeviceSilent, MountnavError, Unknown
from mountnav.navigation.devices import Camera, Mount
from mountnav.navigation.looking import Solve
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.reports import TelescopeState
from mountnav.settings import (
    FolderCameraSettings,
    MountErrorSettings,
    Settings,
    SimulatedCameraSettings,
    TelescopeSettings,
)
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors

_log = logging.getLogger(__name__)

Heard = Callable[[str, str, dict[str, object]], None]

FAKE_SLEW_RATE_DEG_S = 4.0


@dataclass(slots=True)
class Telescope:
    """A telescope of the service: its navigator, and whether its devices are open.

    Attributes
    ----------
    id : str
    navigator : Navigator
    mount_address : str
        For people.
    bench : FakeOnPty or None
        The fake mount that this service runs itself.
    mechanics : Mechanics or None
        That fake's mechanics: where its tube truly looks. Nothing that steers may ask it.
    """

    id: str
    navigator: Navigator
    mount_address: str
    bench: FakeOnPty | None = None
    mechanics: Mechanics | None = None
    problem: str | None = None
    is_open: bool = False
    _opening: asyncio.Lock = field(default_factory=asyncio.Lock)

    async def ready(self) -> Navigator:
        """Open the devices if they are not; called before each command, so a lost port is tried again.

        Raises
        ------
        DeviceError
            They can't be opened; `DeviceMissing` tells which ports exist.
        """
        async with self._opening:
            if not self.is_open:
                try:
                    await self.navigator.open()
                except DeviceError as error:
                    self.problem = str(error)
                    raise
                self.is_open, self.problem = True, None
        return self.navigator

    async def lost(self, error: DeviceError) -> None:
        """Let a link go that failed, so that the next command opens it anew."""
        self.problem = str(error)
        if self.is_open:
            self.is_open = False
            await self._release()

    async def state(self) -> TelescopeState:
        """What is known now; never raises for device trouble."""
        if not self.is_open:
            return TelescopeState(self.id, False, "idle", None, None, None, None, self.problem)
        state = await self.navigator.state()
        return state if state.problem else replace(state, problem=self.problem)

    async def stop(self) -> None:
        """Stop all motion now. Raises `DeviceError` when that could not be told to the mount."""
        await (await self.ready()).stop()

    async def close(self) -> None:
        """Stop what moves, and release everything. Trouble on the way is logged, the rest still done."""
        if self.is_open:
            try:
                await self.navigator.stop()
            except MountnavError as error:
                _log.error("%s could not be stopped on the way down: %s", self.id, error)
            await self._release()
        self.is_open = False
        if self.bench is not None:
            await asyncio.to_thread(self.bench.stop)

    async def _release(self) -> None:
        try:
            await self.navigator.close()
        except DeviceError as error:
            _log.warning("%s: closing: %s", self.id, error)


class Observatory:
    """All telescopes of the service.

    Parameters
    ----------
    telescopes : sequence of Telescope
    """

    def __init__(self, telescopes: Sequence[Telescope]) -> None:
        self._telescopes = {telescope.id: telescope for telescope in telescopes}

    @property
    def telescopes(self) -> list[Telescope]:
        """In the order of the settings."""
        return list(self._telescopes.values())

    def telescope(self, telescope_id: str) -> Telescope:
        """Return the telescope of that id. Raises `Unknown`."""
        if telescope_id not in self._telescopes:
            raise Unknown(
                "there is no telescope of this id",
                advice=f"there is: {', '.join(self._telescopes) or 'none'}",
            )
        return self._telescopes[telescope_id]

    async def open(self) -> None:
        """Open all devices side by side; one that is missing is logged and kept for later."""
        await asyncio.gather(*(_open_quietly(telescope) for telescope in self.telescopes))

    async def close(self) -> None:
        """Stop and release everything."""
        await asyncio.gather(*(telescope.close() for telescope in self.telescopes))


def build_observatory(settings: Settings, catalog: Catalog, heard: Heard, solve: Solve) -> Observatory:
    """Put the telescopes of the settings together; fakes are started, nothing else is opened.

    Parameters
    ----------
    settings : Settings
    catalog : Catalog
        For drawing simulated frames.
    heard : callable
        ``heard(telescope_id, kind, data)``: told of each step.
    solve : Solve
        For all telescopes.
    """
    return Observatory([_build(one, settings, catalog, heard, solve) for one in settings.telescope])


def link_is_lost(error: BaseException) -> bool:
    """Whether an error means that the port should be opened anew."""
    return isinstance(error, DeviceMissing | DeviceSilent)


async def _open_quietly(telescope: Telescope) -> None:
    try:
        await telescope.ready()
    except DeviceError as error:
        _log.warning(
            "%s is not connected, and will be tried again with the next command: %s", telescope.id, error
        )


def _build(
    one: TelescopeSettings, settings: Settings, catalog: Catalog, heard: Heard, solve: Solve
) -> Telescope:
    bench: FakeOnPty | None = None
    mechanics: Mechanics | None = None
    url = one.mount.url
    if one.mount.is_fake:
        mechanics = _mechanics(one, settings)
        bench = FakeOnPty(FakeLx200(mechanics)).start()
        url = f"lx200+serial://{bench.address}"
    mount: Mount = open_mount(_with_epoch(url, one), name=one.id)
    navigator = Navigator(
        name=one.id,
        mount=mount,
        camera=_camera(one, mechanics, catalog),
        catalog=catalog,
        site=settings.site.site,
        air=settings.air.air,
        policy=_policy(one),
        listen=lambda kind, data: heard(one.id, kind, data),
        solving=solve_settings(settings.solving, calibration=one.calibration),
        solve=solve,
    )
    return Telescope(one.id, navigator, url, bench, mechanics)


def _with_epoch(url: str, one: TelescopeSettings) -> str:
    """The URL with the configured epoch as its option, unless it says its own."""
    if "epoch=" in url:
        return url
    return f"{url}{'&' if '?' in url else '?'}epoch={one.mount.epoch}"


def _mechanics(one: TelescopeSettings, settings: Settings) -> Mechanics:
    errors = one.mount.errors or MountErrorSettings()
    return Mechanics(
        settings.site.site,
        settings.air.air,
        PointingErrors(**errors.model_dump()),
        slew_rate_deg_s=one.mount.slew_rate_deg_s or FAKE_SLEW_RATE_DEG_S,
    )


def _camera(one: TelescopeSettings, mechanics: Mechanics | None, catalog: Catalog) -> Camera:
    match one.camera:
        case FolderCameraSettings(path=path, pattern=pattern, timeout_s=timeout_s):
            return FolderCamera(path, pattern, timeout_s)
        case SimulatedCameraSettings() as optics:
            assert mechanics is not None, "the settings let a simulated camera stand on a fake mount alone"
            # what draws its frames is dear, and no real telescope needs it
            from drivers.simulated.camera import SimulatedCamera
            from mountnav.simulation.optics import SimulatedOptics

            return SimulatedCamera(
                mechanics.truth,
                SimulatedOptics(**optics.model_dump(exclude={"kind"})),
                catalog,
                name=f"{one.id} simulated camera",
            )


def _policy(one: TelescopeSettings) -> CenteringPolicy:
    scale_arcsec_px = one.scale_arcsec_px
    if scale_arcsec_px is None and isinstance(one.camera, SimulatedCameraSettings):
        scale_arcsec_px = one.camera.scale_arcsec_px
    return CenteringPolicy(
        exposure_s=one.exposure_s,
        tolerance_arcsec=one.centering.tolerance_arcsec,
        max_tries=one.centering.max_tries,
        timeout_s=one.centering.timeout_s,
        max_sync_arcsec=one.centering.max_sync_arcsec,
        settle_s=one.centering.settle_s,
        min_altitude_deg=one.limits.min_altitude_deg,
        scale_arcsec_px=scale_arcsec_px,
        scale_tolerance=one.scale_tolerance,
    )
