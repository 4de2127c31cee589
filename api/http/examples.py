"""Examples in the description of the interface: each body of an order, and what the main routes answer.

The bodies stand here. The answers are those of a virtual observatory: `python tools/api_examples.py` asks it
and writes `answers.json` beside this file. A test holds each against its model.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

__all__ = ["BODIES", "answers", "give_examples"]

ANSWERS_PATH = Path(__file__).with_name("answers.json")

BODIES: dict[str, dict[str, Any]] = {
    "BusyBody": {"busy": True, "for_s": 300.0},
    "CenterBody": {"target": {"kind": "name", "name": "M31"}, "tolerance_arcsec": 20.0},
    "DitherOrder": {"kind": "dither", "bound": 10.0, "unit": "px", "settle_within": 1.0},
    "FlipBody": {"target": {"kind": "name", "name": "Capella"}},
    "FollowBody": {"target": {"kind": "name", "name": "Moon"}, "duration_s": 3600.0, "look_every_s": 60.0},
    "ForecastBody": {"target": {"kind": "name", "name": "Jupiter"}, "hours": 12.0},
    "HoldOrder": {"kind": "hold", "for_s": 3600.0, "every_s": 20.0},
    "LeaseBody": {"ttl_s": 60.0, "on_expiry": "stop", "note": "the survey, until 03:00"},
    "LookBody": {"exposure_s": 2.0},
    "ExposureBody": {"exposure_s": 2.0},
    "MosaicBody": {
        "target": {"kind": "name", "name": "M31"},
        "across": 3,
        "down": 2,
        "overlap": 0.1,
        "frames": 20,
    },
    "MoveAxisBody": {"axis": "secondary", "rate_deg_s": 0.5, "for_s": 1.0},
    "OffsetBody": {"east_arcsec": 30.0, "north_arcsec": -12.5},
    "OffsetRatesBody": {"ra_arcsec_s": 0.031, "dec_arcsec_s": -0.012, "for_s": 1800.0},
    "RotateBody": {"position_angle_deg": 0.0, "either_way": True},
    "SafetyBody": {"safe": True, "for_s": 120.0},
    "SearchBody": {"target": {"kind": "name", "name": "Capella"}, "radius_deg": 2.0},
    "SlewBody": {"ra_deg": 83.633, "dec_deg": 22.014},
    "TrackingBody": {"on": True, "rate": "sidereal"},
    "WhyBody": {"why": "clouds from the west"},
}
"""By the name of the schema."""


@cache
def answers() -> dict[str, Any]:
    """Answers of a virtual observatory, by the name of their schema; long lists are cut to two."""
    found: dict[str, Any] = json.loads(ANSWERS_PATH.read_text(encoding="utf-8"))
    return found


def give_examples(schema: dict[str, Any]) -> None:
    """Put an example into each schema that has one here.

    Parameters
    ----------
    schema : dict
        The description of the interface, changed in place.
    """
    schemas = schema["components"]["schemas"]
    for name, example in {**answers(), **BODIES}.items():
        if name in schemas:
            schemas[name]["examples"] = [example]
