"""Mounts and cameras of an `indiserver` from the options of their URLs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from drivers.generic.camera import GenericCamera
from drivers.generic.options import Timing, maybe_number_of, number_of, read_options, require_known, yes_of
from drivers.indi.camera import CameraHabits, IndiCameraLanguage
from drivers.indi.client import PORT, IndiClient, Pulse
from drivers.indi.device import IndiDevice
from drivers.indi.language import IndiHabits, IndiLanguage
from drivers.wire.wire_log import WireLog

if TYPE_CHECKING:
    from drivers.generic.mount import GenericMount
    from drivers.registry import MountUrl
    from mountnav.sky.coordinates import Site

TIMING = Timing(start_grace_s=4.0, rest_s=2.5, sync_wait_s=6.0, late_s=3.5)
"""A driver looks at its mount once a second, and two looks make a reading that is believed."""
MOUNT_OPTIONS = ("connect", "resolution_arcsec", "connect_s", "server_silent_s")
CAMERA_OPTIONS = (
    "connect",
    "connect_s",
    "timeout_s",
    "server_silent_s",
    "mount",
    "binning",
    "focal_length_mm",
    "download_s",
    "chip",
)


def mount_from(url: MountUrl, name: str | None, site: Site | None = None) -> GenericMount:
    """Make the mount; nothing is opened yet.

    Raises
    ------
    BadSettings
        If an option is unknown or its value makes no sense.
    """
    options = read_options(url.options, "indi", baud=9600, timeout_s=8.0, timing=TIMING, own=MOUNT_OPTIONS)
    own = options.own
    device = _device(url, own, options.timeout_s)
    habits = IndiHabits(
        epoch=options.epoch if "epoch" in url.options else None,
        may_connect=yes_of(own, "connect", default=True),
        resolution_arcsec=number_of(own, "resolution_arcsec", 1.0),
    )
    return options.mount(IndiLanguage(device, habits), name=name, site=site)


def camera_from(url: MountUrl, name: str | None) -> GenericCamera:
    """Make the camera; nothing is opened yet.

    Raises
    ------
    BadSettings
        If an option is unknown or its value makes no sense.
    """
    own = url.options
    require_known(own, CAMERA_OPTIONS, "an indi camera")
    habits = CameraHabits(
        may_connect=yes_of(own, "connect", default=True),
        mount=own.get("mount"),
        binning=round(number_of(own, "binning", 1.0)) if "binning" in own else None,
        focal_length_mm=maybe_number_of(own, "focal_length_mm"),
        download_s=number_of(own, "download_s", 60.0),
        chip=own.get("chip", "CCD1"),
    )
    device = _device(url, own, number_of(own, "timeout_s", 8.0))
    return GenericCamera(IndiCameraLanguage(device, name=name, habits=habits))


def _device(url: MountUrl, own: Mapping[str, str], deadline_s: float) -> IndiDevice:
    place = urlsplit(f"//{url.line}")
    silent_s = number_of(own, "server_silent_s", 1.9)
    pulse = Pulse(ping_s=min(0.4, silent_s / 4.0), silent_s=silent_s)
    client = IndiClient(
        place.hostname or "localhost", place.port or PORT, url.device, log=WireLog(), pulse=pulse
    )
    return IndiDevice(client, url.device, deadline_s=deadline_s, connect_s=number_of(own, "connect_s", 30.0))
