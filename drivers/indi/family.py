"""The family of what an `indiserver` serves: how such a mount or camera is opened."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from drivers.family import Family, MountUrl, UrlParts
from mountnav.errors import BadSettings

if TYPE_CHECKING:
    from drivers.generic.camera import GenericCamera
    from drivers.generic.mount import GenericMount
    from drivers.generic.rotator import GenericRotator
    from drivers.indi.device import IndiDevice
    from mountnav.sky.coordinates import Site

PORT = 7624
"""What `indiserver` listens on if nothing else is said."""
_MOUNT_OPTIONS = (
    "connect",
    "resolution_arcsec",
    "connect_s",
    "server_silent_s",
    "rate_step_arcsec_s",
    "slew_rates_deg_s",
)
_MOST_SPEEDS = 32
"""So many speeds may be stated: drivers have at most 11 switches for them. Doubled, nothing shows."""
_FASTEST_DEG_S = 40.0
"""No mount moves faster by hand, °/s: a larger number is of another unit. As `Timing.fastest_deg_s`."""
_CAMERA_OPTIONS = (
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


def _open_mount(url: MountUrl, name: str | None, site: Site | None) -> GenericMount:
    from drivers.generic.options import number_of, read_options, yes_of
    from drivers.indi.language import TIMING, IndiHabits, IndiLanguage

    options = read_options(url.options, "indi", baud=9600, timeout_s=8.0, timing=TIMING, own=_MOUNT_OPTIONS)
    own = options.own
    device = _device(url, own, options.timeout_s)
    habits = IndiHabits(
        epoch=options.epoch if "epoch" in url.options else None,
        may_connect=yes_of(own, "connect", default=True),
        resolution_arcsec=number_of(own, "resolution_arcsec", 1.0),
        rate_step_arcsec_s=number_of(own, "rate_step_arcsec_s", 0.0, may_be_zero=True),
        speeds_deg_s=_speeds(own),
    )
    return options.mount(IndiLanguage(device, habits), name=name, site=site)


def _speeds(own: Mapping[str, str]) -> tuple[float, ...]:
    """Read ``slew_rates_deg_s=0.004,0.5,2``: speeds of motion by hand, slowest first as a rule."""
    text = own.get("slew_rates_deg_s")
    if text is None:
        return ()
    try:
        speeds = tuple(float(one) for one in text.split(","))
    except ValueError:
        speeds = (-1.0,)
    if len(speeds) > _MOST_SPEEDS or not all(0.0 < speed <= _FASTEST_DEG_S for speed in speeds):
        raise BadSettings(
            f"slew_rates_deg_s={text:.60} makes no sense",
            advice="the speeds of its switches TELESCOPE_SLEW_RATE from the first, °/s: 0.004,0.5,2.5",
        )
    return speeds


def _open_camera(url: MountUrl, name: str | None) -> GenericCamera:
    from drivers.generic.camera import GenericCamera
    from drivers.generic.options import maybe_number_of, number_of, require_known, yes_of
    from drivers.indi.camera import CameraHabits, IndiCameraLanguage

    own = url.options
    require_known(own, _CAMERA_OPTIONS, "an indi camera")
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


_ROTATOR_OPTIONS = ("connect", "connect_s", "timeout_s", "server_silent_s", "step_deg", "turn_timeout_s")


def _open_rotator(url: MountUrl, name: str | None) -> GenericRotator:
    from drivers.generic.options import number_of, require_known, yes_of
    from drivers.generic.rotator import USUAL_STEP_DEG, GenericRotator, RotatorTiming
    from drivers.indi.rotator import IndiRotatorLanguage, RotatorHabits

    own = url.options
    require_known(own, _ROTATOR_OPTIONS, "an indi rotator")
    habits = RotatorHabits(
        may_connect=yes_of(own, "connect", default=True),
        step_deg=number_of(own, "step_deg", USUAL_STEP_DEG, most=10.0),
    )
    device = _device(url, own, number_of(own, "timeout_s", 8.0))
    timing = RotatorTiming(turn_timeout_s=number_of(own, "turn_timeout_s", 600.0, most=7200.0))
    return GenericRotator(IndiRotatorLanguage(device, name=name, habits=habits), timing=timing)


def _device(url: MountUrl, own: Mapping[str, str], deadline_s: float) -> IndiDevice:
    from drivers.generic.options import number_of
    from drivers.indi.client import IndiClient, Pulse
    from drivers.indi.device import IndiDevice
    from drivers.wire.wire_log import WireLog

    place = urlsplit(f"//{url.line}")
    silent_s = number_of(own, "server_silent_s", 1.9)
    pulse = Pulse(ping_s=min(0.4, silent_s / 4.0), silent_s=silent_s)
    client = IndiClient(
        place.hostname or "localhost", place.port or PORT, url.device, log=WireLog(), pulse=pulse
    )
    return IndiDevice(client, url.device, deadline_s=deadline_s, connect_s=number_of(own, "connect_s", 30.0))


def _read_url(parts: UrlParts, family: Family) -> MountUrl:
    """Read ``indi://host:port/device``; the port may be left out."""
    parts.require_no_user()
    port = parts.port or family.usual_port
    if not parts.transport and parts.host and not parts.bare:
        device = unquote(parts.path.lstrip("/"))
        return MountUrl(parts.driver, f"{parts.host}:{port}", parts.options, device)
    device = parts.path if not parts.bare else "/Telescope%20Simulator"
    raise parts.wrong(
        "names no device of a server", f"write {parts.driver}://{parts.host or 'host'}:{port}{device}"
    )


FAMILY = Family(
    name="indi",
    open_mount=_open_mount,
    open_camera=_open_camera,
    open_rotator=_open_rotator,
    read_url=_read_url,
    usual_port=PORT,
)
