"""The family of what an Alpaca server serves: how such a telescope or camera is opened."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

from drivers.family import Family, MountUrl, UrlParts
from mountnav.errors import BadSettings

if TYPE_CHECKING:
    from drivers.alpaca.device import AlpacaDevice
    from drivers.generic.camera import GenericCamera
    from drivers.generic.mount import GenericMount
    from mountnav.devices import MountAxis
    from mountnav.sky.coordinates import Site

_PORTS = {"http": 11111, "https": 443}
"""Where a server is looked for if its URL names no port: what ASCOM Remote listens on, and HTTPS's own."""
_MOUNT_OPTIONS = (
    "connect",
    "connect_s",
    "ca",
    "finds_home",
    "resolution_arcsec",
    "rate_step_arcsec_s",
    "axis_signs",
)
_CAMERA_OPTIONS = (
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


def _open_mount(url: MountUrl, name: str | None, site: Site | None) -> GenericMount:
    from drivers.alpaca.language import TIMING, AlpacaHabits, AlpacaLanguage
    from drivers.generic.options import number_of, read_options, yes_of

    _require_kind(url, "telescope")
    options = read_options(url.options, "alpaca", baud=9600, timeout_s=5.0, timing=TIMING, own=_MOUNT_OPTIONS)
    own = options.own
    habits = AlpacaHabits(
        epoch=options.epoch if "epoch" in url.options else None,
        may_connect=yes_of(own, "connect", default=True),
        finds_home=yes_of(own, "finds_home", default=False),
        resolution_arcsec=number_of(own, "resolution_arcsec", 1.0),
        rate_step_arcsec_s=number_of(own, "rate_step_arcsec_s", 0.0, may_be_zero=True),
        axis_signs=_axis_signs(own),
    )
    language = AlpacaLanguage(
        _device(url, own, options.timeout_s), habits, longest_order_s=options.timing.slew_timeout_s
    )
    return options.mount(language, name=name, site=site)


def _open_camera(url: MountUrl, name: str | None) -> GenericCamera:
    from drivers.alpaca.camera import AlpacaCameraLanguage, CameraHabits
    from drivers.generic.camera import GenericCamera
    from drivers.generic.options import maybe_number_of, number_of, require_known, yes_of

    _require_kind(url, "camera")
    own = url.options
    require_known(own, _CAMERA_OPTIONS, "an alpaca camera")
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


def _axis_signs(own: Mapping[str, str]) -> dict[MountAxis, float]:
    """Read ``axis_signs=mp``: which sign of a speed moves the primary and the secondary axis upwards."""
    text = own.get("axis_signs")
    if text is None:
        return {}
    if not re.fullmatch(r"[mp]{2}", text):
        raise BadSettings(
            f"axis_signs={text} makes no sense",
            advice="two signs, for the primary and the secondary axis: p (plus) or m (minus), such as mp",
        )
    primary, secondary = (-1.0 if sign == "m" else 1.0 for sign in text)
    return {"primary": primary, "secondary": secondary}


def _require_kind(url: MountUrl, kind: str) -> None:
    if not url.device.startswith(f"{kind}/"):
        raise BadSettings(f"{url.device} of {url.line} is no {kind}", advice=f"for example …/{kind}/0")


def _device(url: MountUrl, own: Mapping[str, str], deadline_s: float) -> AlpacaDevice:
    from drivers.alpaca.client import AlpacaClient
    from drivers.alpaca.codec.base import DeviceAddress
    from drivers.alpaca.device import AlpacaDevice
    from drivers.generic.options import number_of
    from drivers.wire.wire_log import WireLog

    kind, _, number = url.device.partition("/")
    where = DeviceAddress(url.line, kind, int(number), url.user, url.password, own.get("ca"))
    return AlpacaDevice(
        AlpacaClient(where, log=WireLog(), deadline_s=deadline_s), connect_s=number_of(own, "connect_s", 30.0)
    )


def _read_url(parts: UrlParts, family: Family) -> MountUrl:
    """Read ``alpaca+http://user:password@host:port/telescope/0``; user, password and port may be left out."""
    if (
        parts.transport in _PORTS
        and parts.host
        and re.fullmatch(r"/(telescope|camera)/[0-9]{1,9}", parts.path)
    ):
        line = f"{parts.transport}://{parts.host}:{parts.port or _PORTS[parts.transport]}"
        return MountUrl(family.name, line, parts.options, parts.path[1:], parts.user, parts.password)
    raise BadSettings(
        f"URL {parts.shown!r} names no device of an Alpaca server",
        advice="for example alpaca+http://host:11111/telescope/0, alpaca+https://user:password@host/camera/0",
    )


FAMILY = Family(
    name="alpaca",
    open_mount=_open_mount,
    open_camera=_open_camera,
    read_url=_read_url,
    usual_port=_PORTS["http"],
    also_called=("ascom",),
)
