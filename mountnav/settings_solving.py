"""`[solving]`: a named profile, and single parameters over it, by the names the code and the docs use."""

from __future__ import annotations

import dataclasses
import difflib
import math
from typing import Any, Literal, Self, TypeVar

from pydantic import Field, TypeAdapter, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from mountnav.errors import BadSettings
from mountnav.identification.preliminary_settings import PreliminarySettings
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.settings import MeasuringSettings
from mountnav.settings_section import Section

T = TypeVar("T", IdentificationSettings, MeasuringSettings, PreliminarySettings)
Values = dict[str, Any]

_SHARES = frozenset(
    {"min_share", "v_min_ident", "match_share", "skew_max", "n_min_ack", "chance_most", "still_share"}
)
_AT_LEAST_ONE = frozenset({"m_reg", "n_mea_reg", "tries", "fragments", "max_sources", "degree_max", "box_px"})


class SolvingSettings(Section):
    """`[solving]`: how frames are measured and identified.

    `identification`, `preliminary` and `measuring` hold single parameters over those of the profile; their
    names are the fields of `IdentificationSettings`, `PreliminarySettings` and `MeasuringSettings`. `worker`
    lets the service solve in a process of its own.
    """

    profile: Literal["measured", "paper"] = "measured"
    budget_s: float = Field(default=30.0, gt=0, le=3600)
    blind: Literal["after", "only", "never"] = "after"
    worker: bool = True
    identification: Values = Field(default_factory=dict)
    preliminary: Values = Field(default_factory=dict)
    measuring: Values = Field(default_factory=dict)

    @model_validator(mode="after")
    def _parameters_exist(self) -> Self:
        # made once here, so that a wrong value is told when the file is read and not in the night
        _ = self.identification_settings, self.preliminary_settings, self.measuring_settings
        return self

    @property
    def identification_settings(self) -> IdentificationSettings:
        """The profile's parameters with the single ones over them."""
        return _over(IdentificationSettings.profile(self.profile), self.identification, "identification")

    @property
    def preliminary_settings(self) -> PreliminarySettings:
        """The same for shifts within a series."""
        named = PreliminarySettings() if self.profile == "paper" else PreliminarySettings.measured()
        return _over(named, self.preliminary, "preliminary")

    @property
    def measuring_settings(self) -> MeasuringSettings:
        """The parameters of measuring."""
        return _over(MeasuringSettings(), self.measuring, "measuring")


def _over(named: T, values: Values, table: str) -> T:
    """Lay single values over a dataclass, each checked for its name and type."""
    fields = {field.name for field in dataclasses.fields(named)}
    for name in values:
        if name not in fields:
            close = difflib.get_close_matches(name, sorted(fields), n=1, cutoff=0.5)
            fix = (
                f"did you mean {close[0]}?"
                if close
                else "remove it; docs/configuration.md lists all settings"
            )
            raise PydanticCustomError(
                "no_such_parameter", "there is no such parameter", {"key": (table, name), "fix": fix}
            )
        if isinstance(values[name], int | float):
            _check_range(table, name, float(values[name]))
    whole: dict[str, Any] = {name: getattr(named, name) for name in fields} | values
    try:
        return TypeAdapter(type(named)).validate_python(whole)
    except ValidationError as error:
        detail = error.errors(include_url=False)[0]
        name = str(detail["loc"][0]) if detail["loc"] else next(iter(values))
        raise _wrong(table, name, str(detail["msg"])) from error
    except BadSettings as error:
        name = next((one for one in values if one in error.what), next(iter(values), ""))
        raise _wrong(table, name, error.what) from error


def _check_range(table: str, name: str, value: float) -> None:
    """No parameter is negative; counts start at 1 and shares end at 1."""
    if not math.isfinite(value):
        raise _wrong(table, name, "input should be a finite number")
    least = 1.0 if name in _AT_LEAST_ONE else 0.0
    if value < least:
        raise _wrong(table, name, f"input should be at least {least:g}")
    if name in _SHARES and value > 1.0:
        raise _wrong(table, name, "input should be at most 1")


def _wrong(table: str, name: str, what: str) -> PydanticCustomError:
    # braces would be taken for placeholders of the message
    told = what.replace("{", "(").replace("}", ")")
    return PydanticCustomError(
        "wrong_parameter", f"{told}", {"key": (table, name), "fix": f"change {name}; docs/identification.md"}
    )
