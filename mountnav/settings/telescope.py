"""`[[telescope]]`: a mount, the camera on it, and how they are used."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import quote

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from mountnav.settings.aiming import MOST_POINTS, SIMULATED_ROTATOR, PointSettings, RotatorSettings
from mountnav.settings.centering import CenteringSettings
from mountnav.settings.following import FollowingSettings
from mountnav.settings.limits import LimitSettings
from mountnav.settings.model import ModelSettings
from mountnav.settings.night import NightSettings
from mountnav.settings.section import Section, require_unique
from mountnav.settings.sync import SyncSettings

FAKE_SCHEME = "fake+"
LEAST_SUN_CONE_DEG = 5.0
"""Smallest cone around the Sun without a solar filter: nearer than that its light falls into most tubes.
Doubled, Mercury can't be looked at by those who chose to."""
FAKES = ("lx200", "nexstar", "synscan", "ioptron", "skywatcher")
"""Protocols that a fake mount of the service may speak."""


class MountErrorSettings(Section):
    """`[telescope.mount.errors]`: how wrong the fake mount points; the terms of POINTING §5."""

    ih_arcsec: float = 0.0
    id_arcsec: float = 0.0
    ch_arcsec: float = 0.0
    np_arcsec: float = 0.0
    me_arcsec: float = 0.0
    ma_arcsec: float = 0.0
    tf_arcsec: float = 0.0
    backlash_arcsec: float = Field(default=0.0, ge=0)
    periodic_amplitude_arcsec: float = Field(default=0.0, ge=0)
    periodic_period_s: float = Field(default=480.0, gt=0)


class MountSettings(Section):
    """`mount` of a telescope. How fast it slews, and `errors`, are for the fake mount alone."""

    url: str
    epoch: Literal["apparent", "icrs"] | None = None
    set_clock: bool = False
    set_site: bool = False
    trust_on_connect: bool = True
    swap_sides: bool | None = None
    dtr: bool | None = None
    rts: bool | None = None
    settle_s: float | None = Field(default=None, ge=0, le=120)
    mounting: Literal["german", "fork", "altaz"] | None = None
    slew_rate_deg_s: float | None = Field(default=None, gt=0, le=360)
    acceleration_deg_s2: float | None = Field(default=None, gt=0, le=360)
    errors: MountErrorSettings | None = None

    @field_validator("url")
    @classmethod
    def _is_a_url(cls, url: str) -> str:
        """What it names is checked by who opens it: the core knows no drivers."""
        if not re.match(r"[a-z][a-z0-9]*(\+[a-z0-9]+)?://", url):
            path = url if url.startswith("/") else "/dev/ttyUSB0"
            raise PydanticCustomError(
                "no_url",
                "{url} is not a URL of a mount",
                {"url": url, "fix": f'write url = "lx200+serial://{path}" or "lx200+tcp://host:port"'},
            )
        return url

    @property
    def is_fake(self) -> bool:
        """Whether the service starts a fake mount itself."""
        return self.url.startswith(FAKE_SCHEME)

    @property
    def fake(self) -> tuple[str, str | None]:
        """Protocol and dialect of the fake mount: of ``fake+lx200://?dialect=onstep``."""
        protocol, _, rest = self.url.removeprefix(FAKE_SCHEME).partition("://")
        return protocol, rest.removeprefix("?dialect=") or None

    @model_validator(mode="after")
    def _fake_things_need_a_fake(self) -> Self:
        if self.is_fake and not re.fullmatch(rf"fake\+({'|'.join(FAKES)})://(\?dialect=[\w-]+)?", self.url):
            raise PydanticCustomError(
                "unknown_fake",
                "there is no fake mount {url}",
                {
                    "url": self.url,
                    "key": "url",
                    "fix": 'write url = "fake+lx200://", or instead of lx200 '
                    f"{', '.join(FAKES[1:])}; ?dialect= is one of `mountnav fake-mount --list`",
                },
            )
        for key in ("slew_rate_deg_s", "acceleration_deg_s2", "errors"):
            if not self.is_fake and getattr(self, key) is not None:
                raise PydanticCustomError(
                    "fake_only",
                    "{key} is a property of the fake mount, and {url} is a real one",
                    {"key": key, "url": self.url, "fix": f'remove {key}, or set url = "fake+lx200://"'},
                )
        return self


class AlpacaCameraSettings(Section):
    """A camera of an Alpaca server; what is left out stays as it is in the camera."""

    kind: Literal["alpaca"]
    url: str = Field(pattern=r"^alpaca\+https?://")
    binning: int | None = Field(default=None, ge=1, le=16)
    gain: int | str | None = None
    offset: int | str | None = None
    focal_length_mm: float | None = Field(default=None, gt=0, le=100_000)
    download_s: float | None = Field(default=None, gt=0, le=3600)
    width_px: int | None = Field(default=None, ge=16, le=65536)
    height_px: int | None = Field(default=None, ge=16, le=65536)

    @property
    def device_url(self) -> str:
        """The URL with these settings as its options."""
        given = {
            "binning": self.binning,
            "gain": self.gain,
            "offset": self.offset,
            "focal_length_mm": self.focal_length_mm,
            "download_s": self.download_s,
        }
        added = [f"{name}={quote(str(value))}" for name, value in given.items() if value is not None]
        return f"{self.url}{'&' if '?' in self.url else '?'}{'&'.join(added)}" if added else self.url

    @model_validator(mode="after")
    def _said_once(self) -> Self:
        query = self.url.partition("?")[2]
        for name in ("binning", "gain", "offset", "focal_length_mm", "download_s"):
            if getattr(self, name) is not None and f"{name}=" in query:
                raise PydanticCustomError(
                    "said_twice",
                    "{key} is set, and the URL says it too",
                    {"key": name, "fix": f"remove {name} from the URL"},
                )
        return self


class FolderCameraSettings(Section):
    """A camera whose program writes FITS files into a folder."""

    kind: Literal["folder"]
    path: Path
    pattern: str = Field(default="*.fit*", min_length=1)
    timeout_s: float = Field(default=60.0, gt=0, le=3600)
    width_px: int | None = Field(default=None, ge=16, le=65536)
    height_px: int | None = Field(default=None, ge=16, le=65536)


class IndiCameraSettings(Section):
    """A camera of an INDI server."""

    kind: Literal["indi"]
    url: str = Field(pattern=r"^indi://")
    width_px: int | None = Field(default=None, ge=16, le=65536)
    height_px: int | None = Field(default=None, ge=16, le=65536)


class SimulatedCameraSettings(Section):
    """A camera that draws the true sky where the fake mount really points."""

    kind: Literal["simulated"]
    width_px: int = Field(default=1280, ge=64, le=16384)
    height_px: int = Field(default=960, ge=64, le=16384)
    scale_arcsec_px: float = Field(default=2.5, gt=0, le=600)
    rotation_deg: float = Field(default=0.0, ge=-360, le=360)
    parity: Literal[1, -1] = 1
    fwhm_px: float = Field(default=2.8, gt=0.5, le=50)


CameraSettings = Annotated[
    AlpacaCameraSettings | FolderCameraSettings | IndiCameraSettings | SimulatedCameraSettings,
    Field(discriminator="kind"),
]


class TelescopeSettings(Section):
    """`[[telescope]]`: a mount, the camera on it, and how they are used."""

    id: str = Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,39}$")
    name: str | None = Field(default=None, min_length=1, max_length=60, pattern=r"^[^\x00-\x1f<>&\"']+$")
    focal_length_mm: float | None = Field(default=None, gt=0, le=1_000_000)
    aperture_mm: float | None = Field(default=None, gt=0, le=100_000)
    mount: MountSettings
    camera: CameraSettings
    exposure_s: float = Field(default=2.0, gt=0, le=600)
    scale_arcsec_px: float | None = Field(default=None, gt=0, le=600)
    scale_tolerance: float = Field(default=0.05, gt=0, le=0.5)
    limiting_mag: float | None = Field(default=None, gt=0, lt=30)
    calibration: Path | None = None
    centering: CenteringSettings = CenteringSettings()
    limits: LimitSettings = LimitSettings()
    following: FollowingSettings = FollowingSettings()
    sync: SyncSettings = SyncSettings()
    model: ModelSettings = ModelSettings()
    night: NightSettings = NightSettings()
    point: tuple[PointSettings, ...] = Field(default=(), max_length=MOST_POINTS)
    rotator: RotatorSettings | None = None

    @model_validator(mode="after")
    def _points_and_rotator(self) -> Self:
        fix = "give each point a name of its own"
        names = (point.name for point in self.point)
        require_unique(names, "point_twice", "the point {name} stands twice", fix=fix, key="point")
        if self.rotator is None:
            return self
        if any(point.east_arcsec is not None for point in self.point):
            raise PydanticCustomError(
                "turned_offset",
                "another tube's offset is measured in the image, and the rotator turns the image",
                {"key": "rotator", "fix": "remove the point with east_arcsec, or the rotator"},
            )
        simulated = isinstance(self.camera, SimulatedCameraSettings)
        if self.rotator.url == SIMULATED_ROTATOR and not simulated:
            raise PydanticCustomError(
                "simulated_rotator_on_real",
                "a simulated rotator can only turn a simulated camera",
                {"key": "rotator", "fix": "write the rotator's own url, or remove it"},
            )
        return self

    @model_validator(mode="after")
    def _sun_needs_a_filter(self) -> Self:
        if self.limits.sun_cone_deg < LEAST_SUN_CONE_DEG and not (
            self.mount.is_fake or self.limits.solar_filter
        ):
            raise PydanticCustomError(
                "sun_without_filter",
                "sun_cone_deg = {cone} lets the tube of a real mount look at the Sun",
                {
                    "cone": self.limits.sun_cone_deg,
                    "key": "sun_cone_deg",
                    "fix": "say solar_filter = true if a filter is in front of the tube, "
                    f"or set sun_cone_deg to {LEAST_SUN_CONE_DEG:g} or more; 20 is usual",
                },
            )
        return self

    @model_validator(mode="after")
    def _simulated_camera_needs_fake_mount(self) -> Self:
        if isinstance(self.camera, SimulatedCameraSettings) and not self.mount.is_fake:
            raise PydanticCustomError(
                "simulated_on_real",
                "a simulated camera can only look where a fake mount points, and {url} is a real one",
                {
                    "url": self.mount.url,
                    "key": "camera",
                    "fix": 'set mount.url = "fake+lx200://", or camera.kind = "folder"',
                },
            )
        return self
