"""What an operator set about solving, made into what the solver takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from mountnav.errors import BadRequest
from mountnav.identification.settings import IdentificationSettings
from mountnav.solving.settings import SolveSettings

if TYPE_CHECKING:
    from mountnav.measuring.calibration import Calibration
    from mountnav.settings.solving import SolvingSettings

Blind = Literal["after", "only", "never"]


def solve_settings(section: SolvingSettings, *, calibration: Path | None = None) -> SolveSettings:
    """Make the settings of a solve.

    Parameters
    ----------
    section : SolvingSettings
        `[solving]` of the file, or its defaults.
    calibration : Path, optional
        A folder of masters.

    Raises
    ------
    BadFrame, BadRequest
        The folder holds no usable masters.
    """
    return SolveSettings(
        measuring=section.measuring_settings,
        identification=section.identification_settings,
        budget_s=section.budget_s,
        blind=section.blind,
        calibration=_masters(calibration),
    )


def chosen_section(config: Path | None, profile: str | None, budget_s: float | None) -> SolvingSettings:
    """Make `[solving]` from a command's options; those given go before the file's.

    Raises
    ------
    BadSettings
        The file is wrong.
    BadRequest
        There is no such profile.
    """
    from mountnav.settings.observatory import Settings
    from mountnav.settings.solving import SolvingSettings

    section = SolvingSettings() if config is None else Settings.load_solving(config)
    if profile is not None:
        _require_profile(profile)
        section = section.model_copy(update={"profile": profile})
    if budget_s is not None:
        section = section.model_copy(update={"budget_s": budget_s})
    return section


def chosen_settings(
    *,
    config: Path | None,
    profile: str | None,
    budget_s: float | None,
    calibration: Path | None,
    blind: Blind | None = None,
) -> SolveSettings:
    """Make the settings of a solve from a command's options; those given go before the file's.

    Parameters
    ----------
    config : Path or None
        A settings file, of which `[solving]` counts.
    profile : str or None
        "measured" or "paper".
    calibration : Path or None
        A folder of masters.

    Raises
    ------
    BadSettings
        The file is wrong.
    BadRequest
        There is no such profile.
    """
    if config is None:
        # the defaults need none of the models of the settings file, which are expensive to import
        _require_profile(profile or "measured")
        settings = SolveSettings(
            identification=IdentificationSettings.profile(profile or "measured"),
            calibration=_masters(calibration),
        )
        settings = settings if budget_s is None else replace(settings, budget_s=budget_s)
    else:
        settings = solve_settings(chosen_section(config, profile, budget_s), calibration=calibration)
    return settings if blind is None else replace(settings, blind=blind)


def _require_profile(profile: str) -> None:
    if profile not in ("measured", "paper"):
        raise BadRequest(f"there is no profile {profile!r}", advice="measured or paper")


def _masters(folder: Path | None) -> Calibration | None:
    if folder is None:
        return None
    from mountnav.measuring.calibration import Calibration

    return Calibration.load(folder)
