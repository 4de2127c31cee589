"""What an operator may set: one TOML file, every unit in the name, nothing unknown let through."""

from __future__ import annotations

import ipaddress
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from mountnav.errors import BadSettings
from mountnav.settings_faults import explain, syntax_fault
from mountnav.settings_section import Section
from mountnav.settings_solving import SolvingSettings
from mountnav.sky.coordinates import Air, Site

FAKE_SCHEME = "fake+"


class ServiceSettings(Section):
    """`[service]`: where the API listens and who may use it."""

    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    api_token_sha256: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$")
    max_upload_mb: float = Field(default=256.0, gt=0, le=4096)
    events_kept: int = Field(default=1000, ge=10, le=100_000)
    jobs_kept: int = Field(default=1000, ge=10, le=100_000)

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the service."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @model_validator(mode="after")
    def _wide_needs_token(self) -> Self:
        if not self.is_loopback and self.api_token_sha256 is None:
            raise PydanticCustomError(
                "wide_without_token",
                "binding {host} lets other machines move the telescope, and no API token is set",
                {
                    "host": self.host,
                    "key": "host",
                    "fix": 'set host = "127.0.0.1", or set api_token_sha256 to the output of '
                    "`printf %s YOUR-TOKEN | sha256sum`",
                },
            )
        return self


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
    """`mount` of a telescope. `slew_rate_deg_s` and `errors` are for the fake mount alone."""

    url: str = Field(pattern=r"^[a-z][a-z0-9]*(\+[a-z0-9]+)?://")
    epoch: Literal["apparent", "icrs"] = "apparent"
    slew_rate_deg_s: float | None = Field(default=None, gt=0, le=360)
    errors: MountErrorSettings | None = None

    @property
    def is_fake(self) -> bool:
        """Whether the service starts a fake mount itself."""
        return self.url.startswith(FAKE_SCHEME)

    @model_validator(mode="after")
    def _fake_things_need_a_fake(self) -> Self:
        if self.is_fake and self.url != "fake+lx200://":
            raise PydanticCustomError(
                "unknown_fake",
                "there is no fake mount {url}",
                {"url": self.url, "key": "url", "fix": 'write url = "fake+lx200://"'},
            )
        for key in ("slew_rate_deg_s", "errors"):
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


class SimulatedCameraSettings(Section):
    """A camera that draws the true sky where the fake mount really points."""

    kind: Literal["simulated"]
    width_px: int = Field(default=1280, ge=64, le=16384)
    height_px: int = Field(default=960, ge=64, le=16384)
    scale_arcsec_px: float = Field(default=2.5, gt=0, le=600)
    rotation_deg: float = Field(default=0.0, ge=-360, le=360)
    parity: Literal[1, -1] = 1
    fwhm_px: float = Field(default=2.8, gt=0.5, le=50)


CameraSettings = Annotated[FolderCameraSettings | SimulatedCameraSettings, Field(discriminator="kind")]


class CenteringSettings(Section):
    """`centering` of a telescope: when a centering is done, and when it gives up."""

    tolerance_arcsec: float = Field(default=30.0, gt=0, le=3600)
    max_tries: int = Field(default=5, ge=1, le=50)
    timeout_s: float = Field(default=300.0, gt=0, le=7200)
    max_sync_arcsec: float = Field(default=7200.0, gt=0, le=180 * 3600)
    settle_s: float = Field(default=1.0, ge=0, le=120)


class LimitSettings(Section):
    """`limits` of a telescope: where it may point."""

    min_altitude_deg: float = Field(default=15.0, ge=-90, le=90)


class TelescopeSettings(Section):
    """`[[telescope]]`: a mount, the camera on it, and how they are used."""

    id: str = Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,39}$")
    mount: MountSettings
    camera: CameraSettings
    exposure_s: float = Field(default=2.0, gt=0, le=600)
    scale_arcsec_px: float | None = Field(default=None, gt=0, le=600)
    scale_tolerance: float = Field(default=0.05, gt=0, le=0.5)
    calibration: Path | None = None
    centering: CenteringSettings = CenteringSettings()
    limits: LimitSettings = LimitSettings()

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


class Settings(Section):
    """The whole file."""

    service: ServiceSettings = ServiceSettings()
    site: SiteSettings
    air: AirSettings = AirSettings()
    solving: SolvingSettings = SolvingSettings()
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
    def parse(cls, text: str, *, name: str = "settings") -> Self:
        """Read settings from TOML text; `name` stands in the messages. Raises `BadSettings`."""
        data = _parsed(text, name)
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            raise explain(error, name, text, data, known=_known_keys()) from error


def _text(path: Path) -> str:
    try:
        return Path(path).read_text(encoding="utf-8")
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
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise syntax_fault(name, text, error) from error


def _known_keys() -> frozenset[str]:
    sections = (
        Settings,
        ServiceSettings,
        SiteSettings,
        AirSettings,
        SolvingSettings,
        TelescopeSettings,
        MountSettings,
        MountErrorSettings,
        FolderCameraSettings,
        SimulatedCameraSettings,
        CenteringSettings,
        LimitSettings,
    )
    return frozenset(key for section in sections for key in section.model_fields)
