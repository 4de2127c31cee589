"""Corrections of a mount's rates: on trial, confirmed, withdrawn, recalled; and of whom they are recalled."""

from __future__ import annotations

import json

import pytest

from mountnav.devices import OffsetRates, PierSide
from mountnav.navigation.rates_kept import RatesKept
from mountnav.navigation.rates_seen import RateCorrection, RateFault

WANTED = OffsetRates(0.5, -0.25)
MIRRORED = RateCorrection(RateFault.SIGN_RA, "reversed", side=PierSide.EAST)


def recalled(data: object) -> RatesKept:
    """What a fresh run makes of what was written down."""
    kept = RatesKept("a mount")
    kept.restore(json.loads(json.dumps(data)))
    return kept


def test_a_correction_is_sent_for_the_side_that_it_was_seen_on_alone() -> None:
    rates = RatesKept("a mount")
    assert rates.sent(WANTED, 20.0, PierSide.EAST) == WANTED
    rates.try_on(MIRRORED)
    sent = rates.sent(WANTED, 20.0, PierSide.EAST)
    assert sent == OffsetRates(-0.5, -0.25)
    assert rates.kept(sent, 20.0, PierSide.EAST) == WANTED
    for side in (PierSide.WEST, PierSide.UNKNOWN):
        assert rates.sent(WANTED, 20.0, side) == WANTED
        assert rates.kept(WANTED, 20.0, side) == WANTED
    # none is none, whatever it makes of others
    assert rates.sent(OffsetRates(0.0, 0.0), 20.0, PierSide.EAST) == OffsetRates(0.0, 0.0)


def test_only_a_correction_that_the_sky_confirmed_is_recalled() -> None:
    rates = RatesKept("a mount")
    rates.try_on(MIRRORED)
    assert recalled(rates.as_dict()).correction is None
    rates.confirm()
    again = recalled(rates.as_dict())
    assert (again.correction, again.confirmed, again.words) == (MIRRORED, True, rates.words)
    rates.withdraw("looks contradict it")
    assert (rates.correction, rates.confirmed, rates.words) == (None, False, "looks contradict it")
    assert recalled(rates.as_dict()).correction is None
    # with nothing on trial there is nothing to confirm
    rates.confirm()
    assert (rates.confirmed, rates.words) == (False, "looks contradict it")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mount", "another one"),
        ("confirmed", "yes"),
        ("confirmed", 1),
        ("correction", None),
        ("correction", "sign-ra"),
        ("correction", {}),
        ("correction", MIRRORED.as_dict() | {"fault": "no such fault"}),
        ("correction", MIRRORED.as_dict() | {"fault": str(RateFault.IGNORED)}),
        ("correction", MIRRORED.as_dict() | {"side": "above"}),
        ("correction", MIRRORED.as_dict() | {"swapped": True}),
        ("correction", MIRRORED.as_dict() | {"ra": "tenfold"}),
    ],
)
def test_what_was_written_of_another_mount_or_makes_no_sense_corrects_nothing(
    name: str, value: object
) -> None:
    rates = RatesKept("a mount")
    rates.try_on(MIRRORED)
    rates.confirm()
    assert recalled(rates.as_dict()).correction == MIRRORED
    again = recalled(rates.as_dict() | {name: value})
    assert (again.correction, again.confirmed) == (None, False)
    assert again.sent(WANTED, 20.0, PierSide.EAST) == WANTED


def test_a_correction_without_words_says_what_it_does() -> None:
    rates = RatesKept("a mount")
    rates.try_on(MIRRORED)
    rates.confirm()
    assert recalled(rates.as_dict() | {"words": ""}).words == f"confirmed: {MIRRORED.words}"
