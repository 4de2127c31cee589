"""What a night is allowed to do: the numbers that its rules go by."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class NightRules:
    """What is allowed; each as in `mountnav.settings.night.NightSettings`."""

    correct_by: str = "nothing"
    correct_when_off_by_arcsec: float = 30.0
    max_correction_arcsec: float = 1800.0
    max_corrections_per_hour: int = 6
    max_corrections_per_night: int = 40
    agree_arcsec: float = 10.0
    frames_that_agree: int = 2
    evidence_max_age_s: float = 900.0
    quiet_s: float = 10.0
    settle_s: float = 2.0
    calibration_frames: int = 3
    scale_agrees: float = 0.005
    rotation_agrees_deg: float = 1.0
    begin_sun_below_deg: float = -12.0
    end_sun_above_deg: float = -10.0
    pause_after_unsolved: int = 5
    when_unsafe: str = "pause"
    park_at_end: bool = False
    resume: bool = True

    @property
    def moves(self) -> bool:
        """Whether a correction moves the tube."""
        return self.correct_by in ("offset", "model")
