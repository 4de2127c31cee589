"""Whether catalogs suffice for a camera, before the night; and what would help."""

from mountnav.catalog.doctor.advice import advice_for
from mountnav.catalog.doctor.counts import FrameSize
from mountnav.catalog.doctor.diagnosis import Shelved, diagnose
from mountnav.catalog.doctor.findings import CameraFacts, Check, Diagnosis, Verdict
from mountnav.catalog.doctor.places import Reach, reach_of

__all__ = [
    "CameraFacts",
    "Check",
    "Diagnosis",
    "FrameSize",
    "Reach",
    "Shelved",
    "Verdict",
    "advice_for",
    "diagnose",
    "reach_of",
]
