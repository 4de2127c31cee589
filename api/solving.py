"""What an operator set about solving, made into what the solver takes."""

from __future__ import annotations

from pathlib import Path

from mountnav.errors import BadRequest
from mountnav.measuring.calibration import Calibration
from mountnav.settings import Settings
from mountnav.settings_solving import SolvingSettings
from mountnav.solve import SolveSettings


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
        calibration=None if calibration is None else Calibration.load(calibration),
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
    section = SolvingSettings() if config is None else Settings.load_solving(config)
    if profile is not None:
        if profile not in ("measured", "paper"):
            raise BadRequest(f"there is no profile {profile!r}", advice="measured or paper")
        section = section.model_copy(update={"profile": profile})
    if budget_s is not None:
        section = section.model_copy(update={"budget_s": budget_s})
    return section


def chosen_settings(
    *, config: Path | None, profile: str | None, budget_s: float | None, calibration: Path | None
) -> SolveSettings:
    """Make the settings of a solve from a command's options; those given go before the file's.

    Raises
    ------
    BadSettings
        The file is wrong.
    BadRequest
        There is no such profile.
    """
    return solve_settings(chosen_section(config, profile, budget_s), calibration=calibration)
