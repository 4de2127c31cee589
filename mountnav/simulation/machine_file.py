"""A simulated mount in a file: its build, its errors, where it stands and how its time runs, in one TOML.

::

    [machine]                     # attributes of Machine
    mounting = "german"
    meridian_limits_deg = [10, 10]
    [errors]                      # attributes of PointingErrors
    ih_arcsec = 300
    [site]
    latitude_deg = 48.93
    longitude_deg = 22.27         # east
    height_m = 700
    [air]                         # pressure_hpa = 0: no refraction
    pressure_hpa = 930
    [clock]
    speed = 10.0                  # everything runs ten times faster
    start_utc = 2026-11-21T20:00:00Z
    offset_s = 60.0               # the mount's own clock, minus UTC
    drift_ppm = 20.0
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

from mountnav.clock import utc_now
from mountnav.errors import BadSettings
from mountnav.files import read_text
from mountnav.parsing import toml_of
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.coordinates import Air, Site

_STANDARD_AIR = Air(pressure_hpa=1010.0)
T = TypeVar("T", Machine, PointingErrors)
_CLOCK_KEYS = ("speed", "start_utc", "offset_s", "drift_ppm")


@dataclass(frozen=True, slots=True)
class MachineFile:
    """What such a file says.

    Attributes
    ----------
    site : Site or None
        None when the file has no such table.
    clock_start_utc : datetime or None
        None: now.
    """

    machine: Machine
    errors: PointingErrors
    site: Site | None
    air: Air
    clock_speed: float = 1.0
    clock_start_utc: datetime | None = None

    @classmethod
    def from_toml(cls, path: Path | str) -> MachineFile:
        """Read the file; what it leaves out keeps its default.

        Raises
        ------
        BadSettings
            When the file can't be read, is no TOML, or holds an unknown name or a bad value.
        """
        try:
            tables = toml_of(read_text(Path(path)))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as cause:
            raise BadSettings(f"can't read the machine in {path}: {cause}") from cause
        try:
            return cls._from_tables(tables)
        except BadSettings as cause:
            raise BadSettings(f"{path}: {cause.what}", advice=cause.advice) from cause

    @classmethod
    def _from_tables(cls, tables: dict[str, Any]) -> MachineFile:
        known = ("machine", "errors", "site", "air", "clock")
        _check_names("table", tables, known)
        for name, table in tables.items():
            if not isinstance(table, dict):
                raise BadSettings(f"{name} is not a table", advice=f"write [{name}]")
        build = {
            key: tuple(value) if isinstance(value, list) else value
            for key, value in tables.get("machine", {}).items()
        }
        machine = _made(Machine, "machine", build)
        clock = tables.get("clock", {})
        _check_names("key in [clock]", clock, _CLOCK_KEYS)
        machine = replace(
            machine,
            clock_offset_s=clock.get("offset_s", machine.clock_offset_s),
            clock_drift_ppm=clock.get("drift_ppm", machine.clock_drift_ppm),
        )
        start_utc = clock.get("start_utc")
        if start_utc is not None and not (
            isinstance(start_utc, datetime) and start_utc.utcoffset() is not None
        ):
            raise BadSettings(f"[clock] start_utc = {start_utc} is not UTC", advice="2026-11-21T20:00:00Z")
        speed = _number("clock", "speed", clock.get("speed", 1.0))
        if speed <= 0.0:
            raise BadSettings(f"[clock] speed = {speed}", advice="> 0")
        return cls(
            machine,
            _made(PointingErrors, "errors", tables.get("errors", {})),
            _site(tables["site"]) if "site" in tables else None,
            _air(tables["air"]) if "air" in tables else _STANDARD_AIR,
            speed,
            start_utc,
        )

    def make_mechanics(
        self, *, site: Site | None = None, clock: Callable[[], datetime] = utc_now
    ) -> Mechanics:
        """Make the mount.

        Parameters
        ----------
        site : Site, optional
            Where it stands if the file doesn't say.
        clock : callable
            Aware UTC now.

        Raises
        ------
        BadSettings
            When neither the file nor `site` says where it stands.
        """
        stands = self.site or site
        if stands is None:
            raise BadSettings("the mount has no site", advice="add [site] latitude_deg, longitude_deg")
        return Mechanics(stands, self.air, self.errors, machine=self.machine, clock=clock)


def _check_names(what: str, values: dict[str, Any], known: tuple[str, ...]) -> None:
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise BadSettings(f"unknown {what}: {', '.join(unknown)}", advice=f"allowed: {', '.join(known)}")


def _made(kind: type[T], table: str, values: dict[str, Any]) -> T:
    _check_names(f"key in [{table}]", values, tuple(field.name for field in fields(kind)))
    return kind(**values)


def _number(table: str, name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise BadSettings(f"[{table}] {name} = {value!r} is not a number")
    return float(value)


def _numbers(table: str, kind: type[Site] | type[Air], values: dict[str, Any]) -> dict[str, float]:
    _check_names(f"key in [{table}]", values, tuple(field.name for field in fields(kind)))
    return {name: _number(table, name, value) for name, value in values.items()}


def _site(values: dict[str, Any]) -> Site:
    numbers = _numbers("site", Site, values)
    if not {"latitude_deg", "longitude_deg"} <= set(numbers):
        raise BadSettings("[site] is not complete", advice="latitude_deg and longitude_deg (east)")
    site = Site(**numbers)
    if abs(site.latitude_deg) > 90.0 or abs(site.longitude_deg) > 360.0:
        raise BadSettings(f"[site] {site.latitude_deg}, {site.longitude_deg} is not on Earth")
    return site


def _air(values: dict[str, Any]) -> Air:
    air = Air(**_numbers("air", Air, values))
    if air.pressure_hpa < 0.0 or not 0.0 <= air.relative_humidity <= 1.0 or air.wavelength_um <= 0.0:
        raise BadSettings(
            "the values of [air] are impossible", advice="pressure_hpa >= 0, relative_humidity 0 to 1"
        )
    return air
