"""How a mount follows the sky, from looks: drift, periodic error, jumps, settling, polar axis with advice."""

from mountnav.pointing.drift.report import drift_report
from mountnav.pointing.drift.values import (
    DriftReport,
    Jump,
    PeriodicError,
    PolarAlignment,
    PolarError,
    Rates,
    Settling,
    Stretch,
)

__all__ = [
    "DriftReport",
    "Jump",
    "PeriodicError",
    "PolarAlignment",
    "PolarError",
    "Rates",
    "Settling",
    "Stretch",
    "drift_report",
]
