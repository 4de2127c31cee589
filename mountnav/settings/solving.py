"""`[solving]`: a named profile, and single parameters over it, by the names the code and the docs use."""

from __future__ import annotations

import dataclasses
import difflib
import math
from typing import Any, Literal, Self, TypeVar

from pydantic import Field, TypeAdapter, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from mountnav.errors import BadSettings
from mountnav.identification.settings import IdentificationSettings, PreliminarySettings
from mountnav.measuring.settings import MeasuringSettings
from mountnav.settings.section import Section

T = TypeVar("T", IdentificationSettings, MeasuringSettings, PreliminarySettings)
Values = dict[str, Any]

# made once: each takes some ten milliseconds, and a file of settings asks for all of them again and again
_CHECKED: dict[type[Any], TypeAdapter[Any]] = {
    kind: TypeAdapter(kind) for kind in (IdentificationSettings, MeasuringSettings, PreliminarySettings)
}

_RANGES: dict[str, tuple[float, float]] = {
    # identification: what is searched grows with the counts, and with how finely angles and tiles are parted
    "m_reg": (1, 64),
    "region_cap": (0, 100),
    "n_confirm_measurements": (1, 2000),
    "n_confirm_stars": (1, 2000),
    "k_height": (0, 1),
    "angle_arcmin": (2, 600),
    "match_px": (0, 1000),
    "match_share": (0, 1),
    "v_min_ident": (0, 1),
    "min_share": (0, 1),
    "frame_triangles": (0, 200_000),
    "skew_max": (0, 1),
    "tile_step": (0.1, 10),
    "tile_radius": (0.1, 5),
    "corner_radius": (0.1, 5),
    "outward_fields": (0, 100),
    "outward_max_deg": (0, 180),
    "false_probability_max": (0, 1),
    "min_pairs": (0, 10_000),
    "k_rej": (0, 1000),
    "star_group_fwhm": (0, 100),
    "measurement_group_fwhm": (0, 100),
    "group_magnitudes": (0, 100),
    "floor_px": (0, 100),
    "fragments": (1, 64),
    "fragment_cap": (0, 100),
    "degree_max": (1, 5),
    "cross_validation_gain": (0, 100),
    # preliminary
    "r_rej_px": (0, 10_000),
    "n_min_ack": (0, 1),
    "n_mea_reg": (1, 1000),
    "tries": (1, 10_000),
    "chance_most": (0, 1),
    "confirm_factor": (0, 1000),
    "still_share": (0, 1),
    # measuring: the mesh and the first smoothing cost memory and time by the pixel
    "threshold_sigma": (0, 10_000),
    "max_sources": (1, 100_000),
    "box_px": (4, 65_536),
    "detection_sigma_px": (0, 50),
    "bin_above_px": (0, 1_000_000_000),
    "gain_e_adu": (0, 1_000_000),
}
"""Least and most of each parameter: what lies beyond would cost memory without bound, or has no meaning."""

_MOST_STAGES, _MOST_STAGE_MEASUREMENTS, _MOST_STAGE_STARS = 8, 100, 200
"""Triangles of n stars are n³/6: 1.3 million for 200, 0.2 GB. Doubled, eight times as much."""


class SolvingSettings(Section):
    """`[solving]`: how frames are measured and identified.

    `identification`, `preliminary` and `measuring` hold single parameters over those of the profile; their
    names are the fields of `IdentificationSettings`, `PreliminarySettings` and `MeasuringSettings`. `worker`
    lets the service solve in processes of their own, each of which may hold `memory_mb`: half of the
    computer's memory where it isn't given, at most 4000.
    """

    profile: Literal["measured", "paper"] = "measured"
    budget_s: float = Field(default=30.0, gt=0, le=3600)
    blind: Literal["after", "only", "never"] = "after"
    worker: bool = True
    memory_mb: float | None = Field(default=None, ge=500, le=1_000_000)
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
                else "remove it; `mountnav docs configuration` lists all settings"
            )
            raise PydanticCustomError(
                "no_such_parameter", "there is no such parameter", {"key": (table, name), "fix": fix}
            )
        if isinstance(values[name], int | float):
            _check_range(table, name, values[name])
        if name == "stages":
            _check_stages(table, values[name])
    whole: dict[str, Any] = {name: getattr(named, name) for name in fields} | values
    try:
        checked: T = _CHECKED[type(named)].validate_python(whole)
        return checked
    except ValidationError as error:
        detail = error.errors(include_url=False)[0]
        name = str(detail["loc"][0]) if detail["loc"] else next(iter(values))
        raise _wrong(table, name, str(detail["msg"])) from error
    except BadSettings as error:
        name = next((one for one in values if one in error.what), next(iter(values), ""))
        raise _wrong(table, name, error.what) from error


def _check_range(table: str, name: str, value: float) -> None:
    """Each parameter has a least and a most."""
    if isinstance(value, float) and not math.isfinite(value):
        raise _wrong(table, name, "input should be a finite number")
    least, most = _RANGES.get(name, (0.0, 1e9))
    if value < least:
        raise _wrong(table, name, f"input should be at least {least:g}")
    if value > most:
        raise _wrong(table, name, f"input should be at most {most:g}")


def _check_stages(table: str, stages: Any) -> None:
    """Stages are few, and none so large that its triangles fill the memory; their form is checked later."""
    if not isinstance(stages, list | tuple):
        return
    if len(stages) > _MOST_STAGES:
        raise _wrong(table, "stages", f"there should be at most {_MOST_STAGES}")
    for stage in stages:
        if not isinstance(stage, list | tuple) or len(stage) != 2:
            continue
        for value, most in zip(stage, (_MOST_STAGE_MEASUREMENTS, _MOST_STAGE_STARS), strict=True):
            if isinstance(value, int | float) and not 3 <= value <= most:
                raise _wrong(table, "stages", f"{value} should be at least 3 and at most {most}")


def _wrong(table: str, name: str, what: str) -> PydanticCustomError:
    # braces would be taken for placeholders of the message
    told = what.replace("{", "(").replace("}", ")")
    return PydanticCustomError(
        "wrong_parameter",
        f"{told}",
        {"key": (table, name), "fix": f"change {name}; `mountnav docs identification` explains it"},
    )
