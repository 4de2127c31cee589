"""Times and exposures from headers of every odd form."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from astropy.time import Time
from hypothesis import given
from hypothesis import strategies as st

from mountnav.reading.header_times import exposure_s_from_header, mid_exposure_from_header

Header = dict[str, str | int | float | bool]
NIGHT = datetime(2026, 11, 20, tzinfo=UTC)


@pytest.mark.parametrize(
    ("cards", "expected"),
    [
        ({"DATE-OBS": "2026-11-20T01:02:03", "EXPTIME": 10}, datetime(2026, 11, 20, 1, 2, 8, tzinfo=UTC)),
        ({"DATE-OBS": "2026-11-20 01:02:03Z"}, datetime(2026, 11, 20, 1, 2, 3, tzinfo=UTC)),
        ({"DATE-OBS": "2026-11-20T01:02:03-0700"}, datetime(2026, 11, 20, 8, 2, 3, tzinfo=UTC)),
        ({"DATE-OBS": "2026-11-20T01:02:03.1234567"}, datetime(2026, 11, 20, 1, 2, 3, 123457, tzinfo=UTC)),
        (
            {"DATE-OBS": "2026-11-20", "TIME-OBS": "23:59:59.5"},
            datetime(2026, 11, 20, 23, 59, 59, 500_000, tzinfo=UTC),
        ),
        ({"DATE-OBS": "20/11/95", "UT": " 03:04:05"}, datetime(1995, 11, 20, 3, 4, 5, tzinfo=UTC)),
        ({"DATE-AVG": "2026-11-20T01:00:00", "EXPTIME": 60}, datetime(2026, 11, 20, 1, tzinfo=UTC)),
        ({"MJD-OBS": 60000.5, "EXPTIME": 20}, datetime(2023, 2, 25, 12, 0, 10, tzinfo=UTC)),
        ({"JD": 2460001.0, "EXPTIME": 20}, datetime(2023, 2, 25, 12, 0, 10, tzinfo=UTC)),
        ({"MJD-AVG": 60000.5, "EXPTIME": 20}, datetime(2023, 2, 25, 12, tzinfo=UTC)),
        ({"EXPSTART": 60000.5, "EXPTIME": 20}, datetime(2023, 2, 25, 12, 0, 10, tzinfo=UTC)),
        ({"EXPSTART": 2460001.0, "EXPTIME": 20}, datetime(2023, 2, 25, 12, 0, 10, tzinfo=UTC)),
        ({"DATE-END": "2026-11-20T00:01:00", "EXPTIME": 60}, NIGHT + timedelta(seconds=30)),
        ({"DATE-OBS": "2026-11-20", "MJD-OBS": 60000.5}, datetime(2023, 2, 25, 12, tzinfo=UTC)),
        ({"DATE-OBS": "2026-11-20T00:00:00", "DATE-LOC": "2026-11-20T01:00:00"}, NIGHT),
        ({"DATE-OBS": "2026-11-20T00:00:37", "TIMESYS": "TAI"}, NIGHT),
        ({"DATE-OBS": "2026-11-20T00:00:18", "TIMESYS": "GPS"}, NIGHT),
        ({"DATE-OBS": "2026-11-20T00:00:00", "TIMESYS": "LOCAL"}, None),
        ({"DATE-OBS": "2026-11-20T00:00:00", "EXPTIME": -10}, NIGHT),
        ({"DATE-OBS": "2026-11-20"}, None),
        ({"DATE-OBS": "2026-13-45T00:00:00"}, None),
        ({"DATE-OBS": "1970-01-01T00:00:00"}, None),
        ({"DATE-OBS": "9999-12-31T24:00:00"}, None),
        ({"DATE-OBS": "yesterday"}, None),
        ({"DATE-OBS": 12}, None),
        ({"MJD-OBS": 0.0}, None),
        ({}, None),
    ],
)
def test_mid_exposure_from_odd_forms(cards: Header, expected: datetime | None) -> None:
    assert mid_exposure_from_header(cards) == expected


@pytest.mark.parametrize(
    ("told", "half_exposures"),
    [
        ("UTC start date of observation", 1),
        ("The UTC date and time at the start of the expo", 1),
        ("System Clock:Est. Frame Start", 1),
        ("UT at mid exposure", 0),
        ("System Clock-Frame Grabbed", -1),
        ("UT at end of exposure", -1),
        ("time between start and end", 1),
        ("", 1),
        ("seconds since midnight", 1),
    ],
)
def test_the_comment_tells_start_middle_or_end(told: str, half_exposures: int) -> None:
    cards: Header = {"DATE-OBS": "2026-11-20T00:00:00", "EXPTIME": 60.0}
    expected = NIGHT + timedelta(seconds=30) * half_exposures
    assert mid_exposure_from_header(cards, {"DATE-OBS": told}) == expected


def test_local_time_is_used_only_with_its_offset() -> None:
    local: Header = {"DATE-OBS": "2026-11-20T00:00:00"}
    told = {"DATE-OBS": "Start date & time of observation, LT"}
    assert mid_exposure_from_header(local, told) is None
    assert mid_exposure_from_header(local | {"UT-OBS": "2026-11-20T07:00:00"}, told) == NIGHT + timedelta(
        hours=7
    )
    assert mid_exposure_from_header({"DATE-OBS": "2026-11-20T00:00:00-0700"}, told) == NIGHT + timedelta(
        hours=7
    )


@pytest.mark.long
@given(
    st.datetimes(datetime(1973, 1, 2), datetime(2026, 12, 31)),
    st.sampled_from(["TT", "TAI", "TDB"]),
)
def test_other_time_scales_are_turned_into_utc_as_astropy_does(instant: datetime, scale: str) -> None:
    cards: Header = {"DATE-OBS": instant.isoformat(), "TIMESYS": scale}
    got = mid_exposure_from_header(cards)
    truth = Time(instant.isoformat(), scale=scale.lower()).utc.to_datetime(
        leap_second_strict="silent", timezone=UTC
    )
    assert got is not None
    assert abs((got - truth).total_seconds()) < 0.003 or truth.second == 59  # TDB is within 2 ms of TT


@pytest.mark.parametrize(
    ("cards", "comments", "expected"),
    [
        ({"EXPTIME": 5}, {}, 5.0),
        ({"EXPTIME": "2.5"}, {}, 2.5),
        ({"EXPTIME": "2.5 s"}, {}, 2.5),
        ({"EXPTIME": 0.0}, {}, 0.0),
        ({"EXPTIME": -1}, {}, None),
        ({"EXPTIME": -1, "EXPOSURE": 4}, {}, 4.0),
        ({"EXPTIME": "long"}, {}, None),
        ({"EXPTIME": True}, {}, None),
        ({"EXPTIME": float("nan")}, {}, None),
        ({"EXPTIME": 90000}, {"EXPTIME": "exposure time in ms"}, 90.0),
        ({"EXPTIME": "120 ms"}, {}, 0.12),
        ({"EXPOSURE": 65.0}, {"EXPOSURE": "Observation: Exposure Minutes"}, 3900.0),
        ({"EXPTIME": 30.0}, {"EXPTIME": "[s] Exposure duration"}, 30.0),
        ({"EXPTIME": 30000, "EXPOSURE": 30.0}, {}, 30.0),
        ({"EXPTIME": 30.0, "EXPOSURE": 30000}, {}, 30.0),
        ({"EXPTIME": 5000, "DATE-OBS": "2026-11-20T00:00:00", "DATE-END": "2026-11-20T00:00:05.3"}, {}, 5.0),
        ({"EXPTIME": 5, "DATE-OBS": "2026-11-20T00:00:00", "DATE-END": "2026-11-20T00:00:05.3"}, {}, 5.0),
        ({"EXP": 15.0}, {"EXP": "[s] Sub Exposure Time"}, 15.0),
    ],
)
def test_exposures(cards: Header, comments: dict[str, str], expected: float | None) -> None:
    assert exposure_s_from_header(cards, comments) == expected


KEYS = [
    "DATE-OBS",
    "DATE-AVG",
    "DATE-END",
    "MJD-OBS",
    "JD",
    "EXPTIME",
    "EXPOSURE",
    "UT",
    "TIMESYS",
    "EXPSTART",
]
TEXTS = st.one_of(
    st.text(alphabet="0123456789:-+.TZ /", max_size=25),
    st.sampled_from(
        ["2026-11-20T01:02:03", "9999-12-31T23:59:59", "1900-01-01T00:00:00+2359", "TT", "GPS", "ms", "local"]
    ),
)
ANY = st.one_of(TEXTS, st.floats(), st.integers(), st.booleans(), st.floats(15_000, 100_000))


@pytest.mark.long
@given(st.dictionaries(st.sampled_from(KEYS), ANY), st.dictionaries(st.sampled_from(KEYS), TEXTS))
def test_no_header_raises_or_gives_an_absurd_time(cards: Header, comments: dict[str, str]) -> None:
    utc, exposure_s = mid_exposure_from_header(cards, comments), exposure_s_from_header(cards, comments)
    assert utc is None or (utc.utcoffset() == timedelta(0) and 1899 <= utc.year <= 2100)
    assert exposure_s is None or 0.0 <= exposure_s < 1e6
