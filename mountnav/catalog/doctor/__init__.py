"""Whether catalogs suffice for a camera, before the night; and what would help."""

from mountnav.catalog.doctor.counts import FrameSize, Reach, reach_of
from mountnav.catalog.doctor.diagnosis import (
    CameraFacts,
    Check,
    Diagnosis,
    NamedCatalog,
    Verdict,
    advice_for,
    diagnose,
)

__all__ = [
    "CameraFacts",
    "Check",
    "Diagnosis",
    "FrameSize",
    "NamedCatalog",
    "Reach",
    "Verdict",
    "advice_for",
    "diagnose",
    "reach_of",
]
