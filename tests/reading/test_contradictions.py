"""Contradictions between hints, and of hints with what was solved: told in plain words, never for nothing."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.frames import Hint
from mountnav.reading.header_hints import hint_from_header
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced
from mountnav.solving.contradictions import contradictions_of_hints, contradictions_with

HEADER = Hint(Icrs(83.82, -5.39), 2.0, 1.89, 2.31, "OBJCTRA and OBJCTDEC", "FOCALLEN and XPIXSZ")


def test_a_scale_twice_too_large_asks_for_the_binning() -> None:
    (told,) = contradictions_with(HEADER, Icrs(83.9, -5.4), 1.05)
    assert str(told) == (
        "scale: FOCALLEN and XPIXSZ says 2.1 ″/px (1.89 to 2.31), found 1.05 ″/px: "
        "is XPIXSZ multiplied by the binning?"
    )


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        (4.2, "does XPIXSZ leave out a binning of 2"),
        (6.3, "does XPIXSZ leave out a binning of 3"),
        (2.63, "is the focal length 0.798 times what the header says"),
    ],
)
def test_other_wrong_scales(scale: float, words: str) -> None:
    (told,) = contradictions_with(HEADER, Icrs(83.9, -5.4), scale)
    assert words in told.found


@pytest.mark.parametrize(
    ("center", "found", "words"),
    [
        (Icrs(5.588, -5.39), Icrs(83.82, -5.39), "in hours, not degrees"),
        (Icrs(83.82, 5.39), Icrs(83.82, -5.39), "sign of the declination"),
        (Icrs(83.82, -5.39), Icrs(85.82, -1.39), "4.47° off"),
    ],
)
def test_wrong_centers(center: Icrs, found: Icrs, words: str) -> None:
    (told,) = contradictions_with(replace(HEADER, center=center), found, 2.1)
    assert told.about == "center"
    assert told.source == "OBJCTRA and OBJCTDEC"
    assert words in told.found
    assert "within 2°" in told.said


@given(
    east=st.floats(-1.3, 1.3),
    north=st.floats(-1.3, 1.3),
    scale=st.floats(1.9, 2.3),
    ra=st.floats(0, 360),
    dec=st.floats(-89, 89),
)
def test_a_true_hint_is_never_contradicted(
    east: float, north: float, scale: float, ra: float, dec: float
) -> None:
    hint = replace(HEADER, center=Icrs(ra, dec))
    assert contradictions_with(hint, displaced(Icrs(ra, dec), 3600 * east, 3600 * north), scale) == ()
    assert contradictions_with(Hint(), Icrs(ra, dec), scale) == ()
    assert contradictions_of_hints(hint, None) == ()
    assert contradictions_of_hints(hint, Hint()) == ()


def test_the_caller_goes_before_the_header_and_the_header_is_reported() -> None:
    given_hint = Hint(Icrs(10.0, 41.0), 1.0, 3.0, 4.0)
    told = contradictions_of_hints(HEADER, given_hint)
    assert [one.about for one in told] == ["center", "scale"]
    assert all("by caller" in one.found for one in told)
    assert [one.source for one in told] == ["OBJCTRA and OBJCTDEC", "FOCALLEN and XPIXSZ"]
    assert contradictions_of_hints(HEADER, Hint(scale_low_arcsec_px=2.2)) == ()
    (only,) = contradictions_of_hints(HEADER, Hint(scale_low_arcsec_px=2.4))
    assert "at least 2.4 ″/px by caller" in only.found
    (only,) = contradictions_of_hints(HEADER, Hint(scale_high_arcsec_px=1.0))
    assert "at most 1 ″/px by caller" in only.found


def test_a_doubt_about_one_card_is_no_contradiction() -> None:
    hint = hint_from_header(
        {"FOCALLEN": 1000.0, "XPIXSZ": 9.0, "XBINNING": 2, "RA": 5.588, "DEC": -5.39}, 100, 100
    )
    assert len(hint.alternatives) == 3
    assert contradictions_of_hints(hint) == ()
