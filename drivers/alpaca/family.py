"""Telescopes and cameras of an Alpaca server from the options of their URLs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from drivers.alpaca.camera import AlpacaCameraLanguage, CameraHabits
from drivers.alpaca.client import AlpacaClient
from drivers.alpaca.codec.base import DeviceAddress
from drivers.alpaca.device import AlpacaDevice
from drivers.alpaca.language import AlpacaHabits, AlpacaLanguage
from drivers.generic.camera import GenericCamera
from drivers.generic.options import Timing, maybe_number_of, number_of, read_options, require_known, yes_of
from drivers.wire.wire_log import WireLog
from mountnav.errors import BadSettings

if TYPE_CHECKING:
    from drivers.generic.mount import GenericMount
    from drivers.registry import MountUrl
    from mountnav.sky.coordinates import Site

TIMING = Timing(
    start_grace_s=4.0,
    rest_s=2.5,
    sync_wait_s=6.0,
    late_s=3.5,
    heartbeat_s=1.0,
    silence_s=3.0,
    lost_after_s=9.0,
)
"""Servers answer from what they read up to a second ago, and those far away take up to two seconds for it."""
MOUNT_OPTIONS = ("connect", "connect_s", "ca", "finds_home", "resolution_arcsec")
CAMERA_OPTIONS = (
    "connect",
    "connect_s",
    "ca",
    "timeout_s",
    "binning",
    "gain",
    "offset",
    "focal_length_mm",
    "download_s",
    "poll_s",
    "clock_tolerance_s",
)


def mount_from(url: MountUrl, name: str | None, site: Site | None = None) -> GenericMount:
    """Make the mount; nothing is opened yet.

    Raises
    ------
    BadSettings
        If the URL names no telescope, an option is unknown or its value makes no sense.
    """
    _require_kind(url, "telescope")
    options = read_options(url.options, "alpaca", baud=9600, timeout_s=5.0, timing=TIMING, own=MOUNT_OPTIONS)
    own = options.own
    habits = AlpacaHabits(
        epoch=options.epoch if "epoch" in url.options else None,
        may_connect=yes_of(own, "connect", default=True),
        finds_home=yes_of(own, "finds_home", default=False),
        resolution_arcsec=number_of(own, "resolution_arcsec", 1.0),
    )
    language = AlpacaLanguage(
        _device(url, own, options.timeout_s), habits, longest_order_s=options.timing.slew_timeout_s
    )
    return options.mount(language, name=name, site=site)


def camera_from(url: MountUrl, name: str | None) -> GenericCamera:
    """Make the camera; nothing is opened yet.

    Raises
    ------
    BadSettings
        If the URL names no camera, an option is unknown or its value makes no sense.
    """
    _require_kind(url, "camera")
    own = url.options
    require_known(own, CAMERA_OPTIONS, "an alpaca camera")
    habits = CameraHabits(
        may_connect=yes_of(own, "connect", default=True),
        binning=round(number_of(own, "binning", 1.0)) if "binning" in own else None,
        gain=own.get("gain"),
        offset=own.get("offset"),
        focal_length_mm=maybe_number_of(own, "focal_length_mm"),
        download_s=number_of(own, "download_s", 60.0),
        poll_s=number_of(own, "poll_s", 0.25),
        clock_tolerance_s=number_of(own, "clock_tolerance_s", 1.0),
    )
    device = _device(url, own, number_of(own, "timeout_s", 5.0))
    return GenericCamera(AlpacaCameraLanguage(device, name=name, habits=habits))


def _require_kind(url: MountUrl, kind: str) -> None:
    if not url.device.startswith(f"{kind}/"):
        raise BadSettings(f"{url.device} of {url.line} is no {kind}", advice=f"for example …/{kind}/0")


def _device(url: MountUrl, own: Mapping[str, str], deadline_s: float) -> AlpacaDevice:
    kind, _, number = url.device.partition("/")
    where = DeviceAddress(url.line, kind, int(number), url.user, url.password, own.get("ca"))
    return AlpacaDevice(
        AlpacaClient(where, log=WireLog(), deadline_s=deadline_s), connect_s=number_of(own, "connect_s", 30.0)
    )
