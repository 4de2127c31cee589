"""Whatever looks there are, however absurd: the doctor answers in plain finite values."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.devices import PierSide
from mountnav.pointing.doctor import diagnose
from mountnav.pointing.drift import drift_report
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site

START = datetime(2026, 11, 21, 20, tzinfo=UTC)


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 9),
    st.sampled_from([None, "german", "fork", "altaz"]),
    st.sampled_from([-90.0, -33.0, 0.0, 48.0, 90.0]),
    st.sampled_from(["far", "near", "same", "pole"]),
)
def test_any_looks_get_an_answer(seed: int, count: int, mounting: Any, latitude: float, how: str) -> None:
    rng = np.random.default_rng(seed)
    looks = []
    for number in range(count):
        utc = START + timedelta(minutes=float(rng.uniform(0.0, 300.0)) if how != "same" else 0.0)
        ra, dec = float(rng.uniform(0.0, 360.0)), float(rng.uniform(-90.0, 90.0))
        if how == "same":
            ra, dec = 10.0, 20.0
        if how == "pole":
            dec = float(rng.choice([-1.0, 1.0])) * float(rng.choice([90.0, 89.9999, 89.5]))
        off = {"far": rng.normal(0.0, 60.0, 2), "near": rng.normal(0.0, 0.1, 2)}.get(how, np.zeros(2))
        read = float((ra + off[0]) % 360.0), float(np.clip(dec + off[1], -90.0, 90.0))
        looks.append(
            PointingObservation(
                utc=utc,
                seen=Icrs(ra, dec),
                sigma_arcsec=float(rng.choice([0.0, 0.5, 100.0])),
                reading=Apparent(*read, utc),
                side=list(PierSide)[int(rng.integers(3))],
                segment_id=str(int(rng.integers(2))),
                air=Air(float(rng.choice([0.0, 950.0]))),
                rotation_deg=None if rng.uniform() < 0.3 else float(rng.uniform(0.0, 360.0)),
                parity=[None, 1, -1][int(rng.integers(3))],
                look_id=str(number),
            )
        )
    site = Site(latitude, 0.0)
    said = diagnose(looks, site=site, believed_epoch="apparent", mounting=mounting, synced_on=looks[:1])
    assert json.dumps(said.as_dict(), allow_nan=False)
    assert said.words
    if how == "far" and count >= 6:
        assert said.healthy is not True
    assert json.dumps(drift_report(looks, site=site, slew_ends=[START]).as_dict(), allow_nan=False)
