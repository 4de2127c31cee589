"""The answer of a solve as plain values is what the model describes, to the last field."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from api.solver.solve_answer import solve_answer, unread_answer
from api.solver.solve_record import QualityRecord, SolveRecord, SolveTimes, solve_record
from api.solver.solve_settings import chosen_section, chosen_settings, solve_settings
from mountnav.errors import BadRequest
from mountnav.frames import Hint
from mountnav.measuring.measurements import SkyQuality, StarImages
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Reason, Solution, Times, Verdict
from mountnav.solving.contradictions import contradictions_with

QUALITY = SkyQuality(
    stars=211,
    images=StarImages.WELL_SAMPLED,
    fwhm_px=3.4,
    ellipticity=math.nan,
    elongation_deg=None,
    sky_adu=580.3,
    noise_adu=10.25,
    sky_gradient=0.1,
    limiting_flux_adu=None,
    saturated_share=0.0,
)
SOLUTION = Solution(
    center=Icrs(127.5, -33.25),
    center_sigma_arcsec=0.004,
    scale_arcsec_px=2.07,
    rotation_deg=math.nan,
    parity=-1,
    rms_arcsec=0.02,
    pairs=500,
    rejected=3,
    false_probability=1e-300,
    mode="full/cubic",
    wcs={"WCSAXES": 2, "CTYPE1": "RA---TAN", "CRPIX1": 1528.5},
    center_covariance_arcsec2=np.eye(2),
    identified=None,  # type: ignore[arg-type]
    rejected_by={"K_rej": 3},
    catalog="Tycho-2",
)
SOLVED = Verdict(
    solution=SOLUTION,
    reason=None,
    detail="",
    measured=700,
    times=Times(0.00512345, 0.02, 0.01, 0.035),
    quality=QUALITY,
    contradictions=contradictions_with(Hint(center=Icrs(10.0, 10.0)), SOLUTION.center, 2.07),
    notes=("the date is unknown — ″",),
)
UNSOLVED = replace(
    SOLVED, solution=None, reason=Reason.NO_MATCH, detail="few", numbers={"tried": 5.0, "odds": math.inf}
)


@pytest.mark.parametrize(
    "answer",
    [
        solve_answer("a.fits", SOLVED),
        solve_answer("a.fits", UNSOLVED),
        solve_answer("a.fits", replace(UNSOLVED, quality=None, detail="")),
        unread_answer("ä.fits", "no image"),
    ],
)
def test_the_answer_is_the_record(answer: dict[str, object]) -> None:
    told = json.loads(json.dumps(answer, allow_nan=False))
    record = SolveRecord.model_validate(answer)
    assert told == json.loads(record.model_dump_json())
    assert list(told) == list(SolveRecord.model_fields)
    assert list(told["time_s"]) == list(SolveTimes.model_fields)
    if told["quality"] is not None:
        assert list(told["quality"]) == list(QualityRecord.model_fields)


def test_what_is_no_number_is_null() -> None:
    record = solve_record("a.fits", SOLVED)
    assert record.rotation_deg is None
    assert record.quality is not None
    assert record.quality.ellipticity is None
    assert solve_answer("a.fits", UNSOLVED)["numbers"] == {"tried": 5.0}


@pytest.mark.parametrize("profile", [None, "measured", "paper"])
@pytest.mark.parametrize("budget_s", [None, 3.0])
def test_without_a_file_the_settings_are_those_of_an_empty_one(
    profile: str | None, budget_s: float | None
) -> None:
    short = chosen_settings(config=None, profile=profile, budget_s=budget_s, calibration=None)
    assert short == solve_settings(chosen_section(None, profile, budget_s))
    only = chosen_settings(config=None, profile=profile, budget_s=budget_s, calibration=None, blind="only")
    assert only == replace(short, blind="only")


def test_an_unknown_profile_is_refused() -> None:
    with pytest.raises(BadRequest, match="papr"):
        chosen_settings(config=None, profile="papr", budget_s=None, calibration=None)
