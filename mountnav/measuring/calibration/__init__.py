"""Calibration: masters built of bias, dark and flat frames, and the inverse median filter [S23 §0.1]."""

from mountnav.measuring.calibration.calibration import Calibration, CalibrationPolicy, CalibrationReport

__all__ = ["Calibration", "CalibrationPolicy", "CalibrationReport"]
