"""Self-diagnosis from looks: epoch, clock, longitude, hemisphere, mirror, pier side, slips; with odds."""

from mountnav.pointing.doctor.diagnose import ENOUGH, diagnose
from mountnav.pointing.doctor.findings import CERTAIN, HARMLESS, Diagnosis, Finding, Illness, Measured
from mountnav.pointing.doctor.priors import ORDINARY, Geometry, known, within

__all__ = [
    "CERTAIN",
    "ENOUGH",
    "HARMLESS",
    "ORDINARY",
    "Diagnosis",
    "Finding",
    "Geometry",
    "Illness",
    "Measured",
    "diagnose",
    "known",
    "within",
]
