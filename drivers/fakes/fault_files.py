"""Faults in a file: a script and a random part, read with clear errors, and written back from a run.

::

    [random]
    seed = 7
    rate = 0.02
    kinds = ["late", "garble"]

    [[fault]]
    kind = "late"
    on = ":GR"            # or on_hex = "3a4752"
    delay_s = 6.5
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.fakes.faults import KINDS, USUAL_KINDS, Fault, Kind, RandomFaults
from mountnav.errors import BadSettings
from mountnav.files import read_text
from mountnav.parsing import toml_of
from mountnav.settings.explained import line_of

_Hex = Annotated[str | None, Field(pattern=r"^([0-9a-fA-F]{2})*$")]
_Seconds = Annotated[float, Field(ge=0.0)]
_BYTES = ("on", "data")
_NEEDS = {
    "late": ("delay_s",),
    "dribble": ("delay_s",),
    "sync-late": ("delay_s",),
    "black-hole": ("for_s",),
    "reboot": ("for_s",),
}
"""Without these a fault of the kind would be none, or never end."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class _FaultTable(_Table):
    """`[[fault]]`: the attributes of a `Fault`; bytes as text (Latin-1) or in hexadecimal."""

    kind: Kind
    on: str | None = None
    on_hex: _Hex = None
    skip: int = Field(default=0, ge=0)
    times: int = Field(default=1, ge=1)
    delay_s: _Seconds = 0.0
    byte: int | None = Field(default=None, ge=0)
    bit: int = Field(default=6, ge=0, le=7)
    at_s: _Seconds = 0.0
    when_slewing: bool = False
    chance: float = Field(default=1.0, gt=0.0, le=1.0)
    after_s: _Seconds = 0.0
    every_s: _Seconds = 0.0
    for_s: Annotated[float | None, Field(gt=0.0)] = None
    data: str | None = None
    data_hex: _Hex = None
    axis: Literal["ha", "dec"] = "ha"
    stops: int = Field(default=0, ge=0)


class _RandomTable(_Table):
    """`[random]`: what `RandomFaults` takes."""

    seed: int = 0
    rate: float = Field(ge=0.0, le=1.0)
    kinds: Annotated[list[Kind], Field(min_length=1)] = list(USUAL_KINDS)
    on: str | None = None
    on_hex: _Hex = None
    longest_s: float = Field(default=2.0, gt=0.0)


class _File(_Table):
    random: _RandomTable | None = None
    fault: list[_FaultTable] = []


@dataclass(frozen=True, slots=True)
class FaultScript:
    """What a faults file says.

    Attributes
    ----------
    faults : tuple of Fault
    chance : RandomFaults or None
    """

    faults: tuple[Fault, ...] = ()
    chance: RandomFaults | None = None


def read_faults(path: Path | str, *, seed: int | None = None) -> FaultScript:
    """Read a faults file.

    Parameters
    ----------
    path : Path or str
    seed : int, optional
        Instead of the one in the file.

    Raises
    ------
    BadSettings
        If it can't be read or says something that makes no sense: with its line and what is allowed.
    """
    try:
        text = read_text(Path(path))
    except (OSError, UnicodeDecodeError) as cause:
        raise BadSettings(f"the faults can't be read: {cause}", device=str(path)) from cause
    return parse_faults(text, name=str(path), seed=seed)


def parse_faults(text: str, *, name: str = "faults", seed: int | None = None) -> FaultScript:
    """Read faults from TOML text; `name` stands in the messages. Raises `BadSettings`."""
    try:
        data = toml_of(text)
    except tomllib.TOMLDecodeError as cause:
        raise BadSettings(f"this is not TOML: {cause}", device=name) from cause
    try:
        file = _File.model_validate(data)
    except ValidationError as cause:
        detail = cause.errors(include_url=False)[0]
        raise _wrong(
            text, name, detail["loc"], *_told(detail["type"], detail["msg"], detail["loc"])
        ) from cause
    faults = []
    for number, table in enumerate(file.fault):
        _check(table, text, name, number)
        faults.append(_fault(table))
    return FaultScript(tuple(faults), _random(file.random, text, name, seed))


def _check(table: _FaultTable, text: str, name: str, number: int) -> None:
    given = table.model_fields_set
    for key in _BYTES:
        if {key, f"{key}_hex"} <= given:
            raise _wrong(
                text, name, ("fault", number, key), f"{key} and {key}_hex together", "give one of them"
            )
    missing = [key for key in _NEEDS.get(table.kind, ()) if key not in given]
    if missing:
        raise _wrong(
            text,
            name,
            ("fault", number, "kind"),
            f"{table.kind} needs {missing[0]}",
            f"add {missing[0]} = ...",
        )


def _fault(table: _FaultTable) -> Fault:
    values = {key: value for key, value in table.model_dump().items() if key in _PLAIN}
    return Fault(**values, on=_bytes(table.on, table.on_hex), data=_bytes(table.data, table.data_hex))


def _random(table: _RandomTable | None, text: str, name: str, seed: int | None) -> RandomFaults | None:
    if table is None:
        return None
    if table.on is not None and table.on_hex is not None:
        raise _wrong(text, name, ("random", "on"), "on and on_hex together", "give one of them")
    return RandomFaults(
        table.seed if seed is None else seed,
        table.rate,
        table.kinds,
        on=_bytes(table.on, table.on_hex),
        longest_s=table.longest_s,
    )


def _bytes(text: str | None, digits: str | None) -> bytes:
    return bytes.fromhex(digits) if digits is not None else (text or "").encode("latin-1", "replace")


def _told(kind: str, message: str, loc: tuple[str | int, ...]) -> tuple[str, str]:
    key = str(loc[-1]) if loc else ""
    if kind == "extra_forbidden":
        tables: dict[str, type[_Table]] = {"random": _RandomTable, "fault": _FaultTable}
        known = tables.get(str(loc[0]) if len(loc) > 1 else "", _File)
        return "there is no such setting", f"there is: {', '.join(known.model_fields)}"
    if kind == "missing":
        return "it is required, and it is missing", f"add {key} = ..."
    if kind == "literal_error" and key != "axis":
        return "there is no such kind of fault", f"there is: {', '.join(KINDS)}"
    return message[:1].lower() + message[1:], f"change {key}"


def _wrong(text: str, name: str, loc: tuple[str | int, ...], what: str, fix: str) -> BadSettings:
    line = line_of(text, loc)
    dotted = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc).lstrip(".")
    return BadSettings(f"{f'line {line}: ' if line else ''}{dotted}: {what}", device=name, advice=fix)


_DEFAULTS = Fault("lose")
_PLAIN = tuple(field.name for field in fields(Fault) if field.name not in _BYTES)


def faults_as_toml(faults: Iterable[Fault]) -> str:
    """Write faults as a file that `read_faults` understands; bytes as text where they are."""
    return "\n".join(_table_of(fault) for fault in faults)


def _table_of(fault: Fault) -> str:
    lines = ["[[fault]]"]
    for field in fields(Fault):
        value: Any = getattr(fault, field.name)
        if field.name != "kind" and value == getattr(_DEFAULTS, field.name):
            continue
        name = field.name
        if isinstance(value, bytes):
            if all(0x20 <= byte < 0x7F for byte in value):
                value = value.decode("ascii")
            else:
                name, value = f"{name}_hex", value.hex()
        # a string, number or truth value of JSON is one of TOML
        lines.append(f"{name} = {json.dumps(value)}")
    return "\n".join(lines) + "\n"
