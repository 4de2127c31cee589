"""What is wrong with the settings before anything is opened; and, on request, whether the devices answer.

Nothing is moved, synced, set or written. Each thing is looked at by the same code that the service uses, so
that what passes here starts there.
"""

from __future__ import annotations

import os
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from api.access.keys import open_keys
from api.observatory.observatory import mount_of, require_devices
from drivers.registry import open_camera
from mountnav.catalog.catalog_set import open_catalogs
from mountnav.devices import Camera, Mount
from mountnav.errors import BadSettings, MountnavError
from mountnav.files import open_plain
from mountnav.journal.database import connectable, database_url, file_of
from mountnav.settings.observatory import Settings
from mountnav.settings.telescope import (
    AlpacaCameraSettings,
    FolderCameraSettings,
    IndiCameraSettings,
    TelescopeSettings,
)

__all__ = ["Finding", "check_devices", "check_settings"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    about : str
        What it is: ``settings``, ``newton: mount``.
    state : {"right", "doubtful", "wrong"}
        Doubtful: the service starts, and the operator should know.
    what : str
        What was found.
    fix : str
        What to do about it; empty where nothing has to be done.
    """

    about: str
    state: Literal["right", "doubtful", "wrong"]
    what: str
    fix: str = ""


_SQLITE = b"SQLite format 3\0"
"""How a file of SQLite begins, by its file format."""


def check_settings(file: Path) -> tuple[Settings | None, list[Finding]]:
    """Read a settings file whole, and look at all that it names. Opens no device and no port.

    Returns
    -------
    settings : Settings or None
        None where they can't be read.
    """
    try:
        settings = Settings.load(file)
        require_devices(settings, file)
    except BadSettings as error:
        return None, [_wrong(str(file), error)]
    count = len(settings.telescope)
    words = f"{count} telescope{'' if count == 1 else 's'}: {', '.join(one.id for one in settings.telescope)}"
    return settings, [Finding(str(file), "right", words), *_of_the_service(settings), *_of_all(settings)]


def _wrong(about: str, error: MountnavError) -> Finding:
    return Finding(about, "wrong", error.what, error.advice or "")


def _of_the_service(settings: Settings) -> Iterator[Finding]:
    yield from _tried("catalogs", lambda: _catalogs(settings))
    yield from _tried("keys", lambda: _keys(settings))
    yield from _tried("journal", lambda: _journal(settings))
    yield from _ports(settings)


def _tried(about: str, look: Callable[[], Finding]) -> Iterator[Finding]:
    try:
        yield look()
    except MountnavError as error:
        yield _wrong(about, error)


def _catalogs(settings: Settings) -> Finding:
    found = open_catalogs(settings.catalogs.choice())
    return Finding("catalogs", "right", f"they are there: {found.name}")


def _keys(settings: Settings) -> Finding:
    keys = open_keys(settings)
    if not keys.guards:
        return Finding("keys", "right", "none are needed: only this machine reaches the service")
    if not keys.readable():
        return Finding(
            "keys", "doubtful", "none is there yet: nobody can order anything", "mountnav key new NAME"
        )
    return Finding("keys", "right", f"{len(keys.readable())} of them")


def _journal(settings: Settings) -> Finding:
    """Whether a journal's file could be written, and is one; a server isn't asked."""
    url = database_url(settings.journal.where)
    file = file_of(url)
    if file is None:
        # its driver may not be installed
        connectable(url, "read").dispose()
        return Finding("journal", "right", "on a database server, which is not asked here")
    try:
        with open_plain(file) as opened:
            head = opened.read(len(_SQLITE))
    except (FileNotFoundError, PermissionError):
        head = b""  # it is to be made, or can't be written either
    except OSError as error:
        what = f"{file}: {error.strerror or error}"
        return Finding("journal", "wrong", what, "name a file with [journal] url")
    if head and head != _SQLITE:
        fix = "move it away, or name another file with [journal] url"
        return Finding("journal", "wrong", f"{file} is not a journal", fix)
    folder = file.parent
    while not folder.exists():
        folder = folder.parent
    at = file if file.exists() else folder
    if not os.access(at, os.W_OK):
        return Finding("journal", "wrong", f"{at} can't be written", "give it to the service's user, or set "
                       "[journal] url")  # fmt: skip
    return Finding("journal", "right", str(file))


def _ports(settings: Settings) -> Iterator[Finding]:
    """Whether another program holds a port that the service is to listen on."""
    service = settings.service
    wanted = [("service", service.host, service.port)]
    for name in ("indi_server", "lx200_server", "stellarium", "nova"):
        face = getattr(settings, name)
        if face.enabled:
            wanted.append((name, getattr(face, "host", None) or service.host, face.port))
    for name, host, port in wanted:
        if port == 0:
            continue
        if _answers(host, port):
            yield Finding(
                name,
                "doubtful",
                f"something answers on {host}:{port} already",
                "if that is this service, all is well; else choose another port",
            )
        else:
            yield Finding(name, "right", f"{host}:{port} is free")


def _answers(host: str, port: int) -> bool:
    """Whether a connection is taken there; nothing is said."""
    at = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    try:
        with socket.create_connection((at, port), timeout=1.0):
            return True
    except OSError:
        return False


def _of_all(settings: Settings) -> Iterator[Finding]:
    for one in settings.telescope:
        yield from _of_a_telescope(one, settings)


def _of_a_telescope(one: TelescopeSettings, settings: Settings) -> Iterator[Finding]:
    mount = one.mount
    yield Finding(f"{one.id}: mount", "right", "a fake of the service's own" if mount.is_fake else mount.url)
    yield from _tried(f"{one.id}: model", lambda: _model(one, settings))
    folders = [("calibration", one.calibration, True), ("night folder", one.night.folder, one.night.enabled)]
    folders += [("allowed folder", folder, one.night.enabled) for folder in one.night.allowed_folders]
    if isinstance(one.camera, FolderCameraSettings):
        folders.append(("camera", one.camera.path, True))
    for name, folder, used in folders:
        if folder is None or not used:
            continue
        yield _folder(f"{one.id}: {name}", folder)
    if settings.site.latitude_deg == 0.0 and settings.site.longitude_deg == 0.0:
        yield Finding("site", "doubtful", "latitude and longitude are both 0", "set [site]: east is positive")
    if mount.mounting is None and not mount.is_fake:
        yield Finding(
            f"{one.id}: mounting",
            "doubtful",
            "it isn't said how the mount's axes turn: limits reckon with all ways",
            'set mounting = "german", "fork" or "altaz" in [telescope.mount]',
        )


def _model(one: TelescopeSettings, settings: Settings) -> Finding:
    if one.model.file is None:
        return Finding(f"{one.id}: model", "right", "no pointing model")
    one.model.pointing(site=settings.site.site, air=settings.air.air, mounting=one.mount.mounting)
    return Finding(f"{one.id}: model", "right", f"{one.model.file} can be used")


def _folder(about: str, folder: Path) -> Finding:
    if not folder.is_dir():
        return Finding(about, "wrong", f"there is no folder {folder}", "make it, or name another one")
    if not os.access(folder, os.R_OK | os.X_OK):
        return Finding(
            about, "wrong", f"{folder} can't be read", "let the service's user read it, or name another one"
        )
    return Finding(about, "right", str(folder))


async def check_devices(settings: Settings) -> AsyncIterator[Finding]:
    """Open each mount and each camera, tell what answers, and close it. Moves, syncs and sets nothing."""
    for one in settings.telescope:
        if one.mount.is_fake:
            yield Finding(f"{one.id}: mount", "right", "a fake: the service starts it itself")
        else:
            mount = mount_of(one, settings, asked_only=True)
            yield await _opened(f"{one.id}: mount", mount, _of_a_mount)
        camera: Camera | None = None
        match one.camera:
            case AlpacaCameraSettings() as alpaca:
                camera = open_camera(alpaca.device_url, name=f"{one.id} camera")
            case IndiCameraSettings(url=url):
                camera = open_camera(url, name=f"{one.id} camera")
        if camera is not None:
            yield await _opened(f"{one.id}: camera", camera, lambda found: found.name)


def _of_a_mount(mount: Mount) -> str:
    report = getattr(mount, "report", None)
    if report is None:
        return mount.name
    troubles = "; ".join(report.problems)
    return f"{report.identity}{'. ' + troubles if troubles else ''}"


async def _opened(about: str, device: Mount | Camera, words: Callable[..., str]) -> Finding:
    try:
        await device.open()
        try:
            said = words(device)
        finally:
            await device.close()
    except MountnavError as error:
        return _wrong(about, error)
    report = getattr(device, "report", None)
    doubtful = report is not None and bool(report.problems)
    fix = "see mountnav site-time, or correct the mount" if doubtful else ""
    return Finding(about, "doubtful" if doubtful else "right", said, fix)
