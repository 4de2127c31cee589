"""What an operator may set: one TOML file, every unit in the name, nothing unknown let through."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from mountnav.errors import BadSettings
from mountnav.files import read_text
from mountnav.parsing import toml_of
from mountnav.settings.alpaca_camera import AlpacaCameraSettings
from mountnav.settings.catalogs import CatalogsSettings
from mountnav.settings.centering import CenteringSettings
from mountnav.settings.demo import DemoSettings
from mountnav.settings.explained import explain, syntax_fault
from mountnav.settings.faces import (
    AlpacaSettings,
    IndiServerSettings,
    Lx200ServerSettings,
    StellariumSettings,
)
from mountnav.settings.journal import JournalSettings
from mountnav.settings.limits import LimitSettings
from mountnav.settings.model import ModelSettings
from mountnav.settings.night import NightSettings
from mountnav.settings.section import Section
from mountnav.settings.service import ServiceSettings
from mountnav.settings.solving import SolvingSettings
from mountnav.settings.sync import SyncSettings
from mountnav.sky.coordinates import Air, Site

FAKE_SCHEME = "fake+"
FAKES = ("lx200", "nexstar", "synscan", "ioptron", "skywatcher")
"""Protocols that a fake mount of the service may speak."""


class SiteSettings(Section):
    """`[site]`: where the telescope stands; longitude EAST positive."""

    latitude_deg: float = Field(ge=-90, le=90)
    longitude_deg: float = Field(ge=-180, le=180)
    height_m: float = Field(default=0.0, ge=-500, le=9000)
    dut1_s: Annotated[float | None, Field(ge=-0.9, le=0.9)] = None

    @property
    def site(self) -> Site:
        """As the sky room takes it."""
        return Site(self.latitude_deg, self.longitude_deg, self.height_m)


class AirSettings(Section):
    """`[air]`: the air at the telescope, for refraction. Pressure is the station's, not the sea level's."""

    pressure_hpa: float = Field(default=1010.0, ge=0, le=1100)
    temperature_c: float = Field(default=10.0, ge=-90, le=60)
    relative_humidity: float = Field(default=0.5, ge=0, le=1)

    @property
    def air(self) -> Air:
        """As the sky room takes it."""
        return Air(self.pressure_hpa, self.temperature_c, self.relative_humidity)


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
                "{url} is no URL of a mount",
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
    sync: SyncSettings = SyncSettings()
    model: ModelSettings = ModelSettings()
    night: NightSettings = NightSettings()

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


class _SolvingAlone(Section):
    """A file of which only `[solving]` matters; what else it holds is for others."""

    model_config = ConfigDict(extra="ignore")

    solving: SolvingSettings = SolvingSettings()


class _CatalogsAlone(Section):
    """A file of which only `[catalogs]` matters; what else it holds is for others."""

    model_config = ConfigDict(extra="ignore")

    catalogs: CatalogsSettings = CatalogsSettings()


class Settings(Section):
    """The whole file."""

    service: ServiceSettings = ServiceSettings()
    site: SiteSettings
    air: AirSettings = AirSettings()
    solving: SolvingSettings = SolvingSettings()
    catalogs: CatalogsSettings = CatalogsSettings()
    journal: JournalSettings = JournalSettings()
    alpaca: AlpacaSettings = AlpacaSettings()
    indi_server: IndiServerSettings = IndiServerSettings()
    lx200_server: Lx200ServerSettings = Lx200ServerSettings()
    stellarium: StellariumSettings = StellariumSettings()
    demo: DemoSettings | None = None
    telescope: tuple[TelescopeSettings, ...]

    @field_validator("telescope")
    @classmethod
    def _ids_differ(cls, telescopes: tuple[TelescopeSettings, ...]) -> tuple[TelescopeSettings, ...]:
        if not telescopes:
            raise PydanticCustomError(
                "no_telescope", "there is no telescope", {"fix": "add a [[telescope]] table"}
            )
        seen: set[str] = set()
        for telescope in telescopes:
            if telescope.id in seen:
                raise PydanticCustomError(
                    "id_twice",
                    "two telescopes have the id {id}",
                    {"id": telescope.id, "fix": "give each [[telescope]] an id of its own"},
                )
            seen.add(telescope.id)
        return telescopes

    @model_validator(mode="after")
    def _virtual_time_has_no_hardware(self) -> Self:
        if self.demo is not None:
            self.demo.require_no_hardware(self.telescope)
        return self

    @model_validator(mode="after")
    def _faces_show_what_is_there(self) -> Self:
        ids = {one.id for one in self.telescope}
        for name in ("lx200_server", "stellarium"):
            wanted = getattr(self, name).telescope
            if wanted is not None and wanted not in ids:
                raise PydanticCustomError(
                    "no_such_telescope",
                    "{name}.telescope = {wanted} is none of the telescopes",
                    {
                        "name": name,
                        "wanted": repr(wanted),
                        "key": "telescope",
                        "fix": "name one that is there",
                    },
                )
        return self

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a settings file.

        Raises
        ------
        BadSettings
            With the file, the line, the field, what is wrong, and the fix.
        """
        return cls.parse(_text(path), name=str(path))

    @classmethod
    def load_solving(cls, path: Path) -> SolvingSettings:
        """Read `[solving]` of a settings file that may hold nothing else.

        Raises
        ------
        BadSettings
            As `load`, of that table alone.
        """
        text, name = _text(path), str(path)
        data = _parsed(text, name)
        try:
            return _SolvingAlone.model_validate(data).solving
        except ValidationError as error:
            raise explain(error, name, text, data, known=_known_keys()) from error

    @classmethod
    def load_catalogs(cls, path: Path) -> CatalogsSettings:
        """Read `[catalogs]` of a settings file that may hold nothing else.

        Raises
        ------
        BadSettings
            As `load`, of that table alone.
        """
        text, name = _text(path), str(path)
        data = _parsed(text, name)
        try:
            return _CatalogsAlone.model_validate(data).catalogs
        except ValidationError as error:
            raise explain(error, name, text, data, known=_known_keys()) from error

    @classmethod
    def parse(cls, text: str, *, name: str = "settings") -> Self:
        """Read settings from TOML text; `name` stands in the messages. Raises `BadSettings`."""
        data = _parsed(text, name)
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            raise explain(error, name, text, data, known=_known_keys()) from error


def _text(path: Path) -> str:
    try:
        return read_text(Path(path))
    except OSError as error:
        raise BadSettings(
            f"the settings file can't be read: {error.strerror}",
            device=str(path),
            advice="give its path with --config; deploy/observatory.toml is an example",
        ) from error
    except UnicodeDecodeError as error:
        raise BadSettings(
            f"the settings file is not UTF-8 text (byte {error.start})",
            device=str(path),
            advice="save it as UTF-8",
        ) from error


def _parsed(text: str, name: str) -> dict[str, Any]:
    try:
        return toml_of(text)
    except tomllib.TOMLDecodeError as error:
        raise syntax_fault(name, text, error) from error


def _known_keys() -> frozenset[str]:
    """The names of all fields of all tables, however deep."""
    keys: set[str] = set()
    waiting: list[object] = [Settings]
    seen: set[object] = set()
    while waiting:
        kind = waiting.pop()
        if kind in seen:
            continue
        seen.add(kind)
        if isinstance(kind, type) and issubclass(kind, Section):
            keys.update(kind.model_fields)
            waiting.extend(field.annotation for field in kind.model_fields.values())
        else:
            waiting.extend(get_args(kind))
    return frozenset(keys)
