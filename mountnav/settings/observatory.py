"""What an operator may set: one TOML file, every unit in the name, nothing unknown let through."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar, get_args

from pydantic import ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from mountnav.errors import BadSettings
from mountnav.files import read_text
from mountnav.parsing import toml_of
from mountnav.settings.catalogs import CatalogsSettings
from mountnav.settings.demo import DemoSettings
from mountnav.settings.ephemerides import EphemeridesSettings
from mountnav.settings.explained import explain, syntax_fault
from mountnav.settings.faces import (
    AlpacaSettings,
    IndiServerSettings,
    Lx200ServerSettings,
    NovaSettings,
    SolverCommandsSettings,
    StellariumSettings,
)
from mountnav.settings.journal import JournalSettings
from mountnav.settings.report import ReportSettings
from mountnav.settings.section import Section, require_unique
from mountnav.settings.service import ServiceSettings
from mountnav.settings.solver import SolverSettings
from mountnav.settings.solving import SolvingSettings
from mountnav.settings.telescope import TelescopeSettings
from mountnav.settings.traces import TracesSettings
from mountnav.sky.coordinates import Air, Site


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


class _SolvingAlone(Section):
    """A file of which only `[solving]` matters; what else it holds is for others."""

    model_config = ConfigDict(extra="ignore")

    solving: SolvingSettings = SolvingSettings()


class _CatalogsAlone(Section):
    """A file of which only `[catalogs]` matters; what else it holds is for others."""

    model_config = ConfigDict(extra="ignore")

    catalogs: CatalogsSettings = CatalogsSettings()


class _EphemeridesAlone(Section):
    """A file of which only `[ephemerides]` and the site matter; what else it holds is for others."""

    model_config = ConfigDict(extra="ignore")

    site: SiteSettings | None = None
    air: AirSettings = AirSettings()
    ephemerides: EphemeridesSettings = EphemeridesSettings()


_SERIAL = re.compile(r"[a-z0-9]+\+serial://([^?]+)")
"""A URL of a mount on a serial line, and the line."""


class Settings(Section):
    """The whole file."""

    service: ServiceSettings = ServiceSettings()
    site: SiteSettings
    air: AirSettings = AirSettings()
    solving: SolvingSettings = SolvingSettings()
    solver: SolverSettings = SolverSettings()
    catalogs: CatalogsSettings = CatalogsSettings()
    ephemerides: EphemeridesSettings = EphemeridesSettings()
    journal: JournalSettings = JournalSettings()
    report: ReportSettings = ReportSettings()
    traces: TracesSettings = TracesSettings()
    alpaca: AlpacaSettings = AlpacaSettings()
    indi_server: IndiServerSettings = IndiServerSettings()
    lx200_server: Lx200ServerSettings = Lx200ServerSettings()
    stellarium: StellariumSettings = StellariumSettings()
    solver_commands: SolverCommandsSettings = SolverCommandsSettings()
    nova: NovaSettings = NovaSettings()
    demo: DemoSettings | None = None
    telescope: tuple[TelescopeSettings, ...]

    @field_validator("telescope")
    @classmethod
    def _ids_differ(cls, telescopes: tuple[TelescopeSettings, ...]) -> tuple[TelescopeSettings, ...]:
        if not telescopes:
            raise PydanticCustomError(
                "no_telescope", "there is no telescope", {"fix": "add a [[telescope]] table"}
            )
        fix = "give each [[telescope]] an id of its own"
        require_unique(
            (one.id for one in telescopes), "id_twice", "two telescopes have the id {name}", fix=fix
        )
        return telescopes

    @model_validator(mode="after")
    def _virtual_time_has_no_hardware(self) -> Self:
        if self.demo is not None:
            self.demo.require_no_hardware(self.telescope)
        return self

    @model_validator(mode="after")
    def _a_serial_line_has_one_mount(self) -> Self:
        taken: dict[str, str] = {}
        for number, one in enumerate(self.telescope):
            line = _SERIAL.match(one.mount.url)
            if line is None:
                continue
            other = taken.setdefault(line[1], one.id)
            if other != one.id:
                raise PydanticCustomError(
                    "serial_line_twice",
                    "the mounts of {one} and {other} are both on {line}",
                    {
                        "one": one.id,
                        "other": other,
                        "line": line[1],
                        "key": ("telescope", number, "mount"),
                        "fix": "give each mount a line of its own",
                    },
                )
        return self

    @model_validator(mode="after")
    def _engines_are_processes(self) -> Self:
        if self.solver.engine != "process" and not self.solving.worker:
            raise PydanticCustomError(
                "engine_without_processes",
                "solver.engine = {engine} solves in processes, and solving.worker = false wants none",
                {"engine": repr(self.solver.engine), "key": "engine", "fix": "remove one of the two"},
            )
        return self

    @model_validator(mode="after")
    def _faces_show_what_is_there(self) -> Self:
        ids = {one.id for one in self.telescope}
        for name in ("lx200_server", "stellarium"):
            wanted = getattr(self, name).telescope
            if wanted is not None and wanted not in ids:
                raise PydanticCustomError(
                    "no_such_telescope",
                    "{name}.telescope = {wanted} is not one of the telescopes",
                    {
                        "name": name,
                        "wanted": repr(wanted),
                        "key": "telescope",
                        "fix": "name an existing one",
                    },
                )
        for wanted in self.indi_server.telescopes:
            if wanted not in ids:
                raise PydanticCustomError(
                    "no_such_telescope",
                    "indi_server.telescopes names {wanted}, which is not one of the telescopes",
                    {"wanted": repr(wanted), "key": "telescopes", "fix": "name existing ones"},
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
        return _read(_SolvingAlone, _text(path), str(path)).solving

    @classmethod
    def load_catalogs(cls, path: Path) -> CatalogsSettings:
        """Read `[catalogs]` of a settings file that may hold nothing else.

        Raises
        ------
        BadSettings
            As `load`, of that table alone.
        """
        return _read(_CatalogsAlone, _text(path), str(path)).catalogs

    @classmethod
    def load_ephemerides(cls, path: Path) -> tuple[EphemeridesSettings, Site | None, Air]:
        """Read `[ephemerides]`, `[site]` and `[air]` of a settings file that may hold nothing else.

        Raises
        ------
        BadSettings
            As `load`, of those tables alone.
        """
        read = _read(_EphemeridesAlone, _text(path), str(path))
        return read.ephemerides, None if read.site is None else read.site.site, read.air.air

    @classmethod
    def parse(cls, text: str, *, name: str = "settings") -> Self:
        """Read settings from TOML text; `name` stands in the messages. Raises `BadSettings`."""
        return _read(cls, text, name)


_Read = TypeVar("_Read", bound=Section)


def _read(section: type[_Read], text: str, name: str) -> _Read:
    data = _parsed(text, name)
    try:
        return section.model_validate(data)
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
