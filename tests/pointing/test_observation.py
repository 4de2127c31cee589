"""Observation files: what is written is read again, and bad lines are named."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.devices import PierSide
from mountnav.errors import BadRequest
from mountnav.pointing.observation import (
    PointingObservation,
    observation_of,
    observation_record,
    read_observations,
    write_observations,
)
from mountnav.sky.coordinates import Air, Apparent, Icrs

UTC0 = datetime(2026, 11, 21, 22, 0, 0, 123456, tzinfo=UTC)
ra, dec = st.floats(0.0, 359.999), st.floats(-90.0, 90.0)
some = st.none() | st.floats(-1e6, 1e6)


@given(ra, dec, ra, dec, st.booleans(), st.sampled_from(PierSide), some, some, st.sampled_from([None, 1, -1]))
def test_what_is_written_is_read_again(ra1, dec1, ra2, dec2, icrs, side, rotation, scale, parity) -> None:
    one = PointingObservation(
        utc=UTC0,
        seen=Icrs(ra1, dec1),
        sigma_arcsec=0.25,
        reading=Icrs(ra2, dec2) if icrs else Apparent(ra2, dec2, UTC0 + timedelta(seconds=1)),
        side=side,
        segment_id="s 1",
        air=Air(930.0, 5.0, 0.7, 0.6),
        rotation_deg=rotation,
        scale_arcsec_px=scale,
        parity=parity,
        model_id="m",
        look_id="l",
        from_side=(1, -1),
    )
    assert observation_of(json.loads(json.dumps(observation_record(one)))) == one


def test_files_are_in_order_of_time_and_may_hold_comments(tmp_path: Path) -> None:
    looks = [
        PointingObservation(UTC0 + timedelta(minutes=m), Icrs(1.0, 2.0), 0.1, Icrs(1.0, 2.0), look_id=str(m))
        for m in (5, 1, 3)
    ]
    path = tmp_path / "looks.jsonl"
    assert write_observations(path, looks) == 3
    path.write_text("# a night\n\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    assert [one.look_id for one in read_observations(path)] == ["1", "3", "5"]


GOOD = {"utc": "2026-11-21T22:00:00Z", "seen": {"ra_deg": 1, "dec_deg": 2}, "sigma_arcsec": 1} | {
    "reading": {"epoch": "apparent", "ra_deg": 1, "dec_deg": 2}
}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"utc": "2026-11-21T22:00:00"}, "time zone"),
        ({"utc": "yesterday"}, "not an instant"),
        ({"utc": None}, "not an instant"),
        ({"seen": {"ra_deg": 1}}, "seen.dec_deg"),
        ({"seen": {"ra_deg": 400, "dec_deg": 0}}, "no place"),
        ({"seen": {"ra_deg": True, "dec_deg": 0}}, "not a number"),
        ({"reading": {"epoch": "B1950", "ra_deg": 1, "dec_deg": 2}}, "B1950"),
        ({"reading": None}, "reading is missing"),
        ({"side": "up"}, "side"),
        ({"parity": 0}, "parity"),
        ({"sigma_arcsec": -1}, "negative"),
        ({"from_side": [2, 0]}, "from_side"),
        ({"air": {"humidity": 1}}, "unknown key in air"),
        ({"colour": 1}, "unknown key colour"),
    ],
)
def test_bad_lines_are_named(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    path = tmp_path / "looks.jsonl"
    path.write_text(json.dumps(GOOD) + "\n" + json.dumps(GOOD | change) + "\n", encoding="utf-8")
    with pytest.raises(BadRequest, match=r"looks\.jsonl, line 2") as caught:
        read_observations(path)
    assert words in str(caught.value)


def test_no_json_and_no_file(tmp_path: Path) -> None:
    path = tmp_path / "looks.jsonl"
    path.write_text("{nonsense\n", encoding="utf-8")
    with pytest.raises(BadRequest, match="line 1: no JSON"):
        read_observations(path)
    with pytest.raises(BadRequest, match="can't read"):
        read_observations(tmp_path / "none.jsonl")
