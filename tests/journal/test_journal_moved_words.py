"""Orders of what goes on by itself, as the journal tells them to people."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from mountnav.journal.records import CommandRecord, Order
from mountnav.journal.restart import named


@pytest.mark.parametrize(
    ("order", "facts", "words"),
    [
        (
            "move-axis",
            {"axis": "primary", "rate_deg_s": -0.2, "for_s": 1.0},
            "the primary axis moved on at -0.2°/s",
        ),
        ("move-axis", {"axis": "secondary", "rate_deg_s": 0.0}, "an end of the secondary axis"),
        ("move-axis", {}, "a move-axis"),
        (
            "offset-rates",
            {"ra_arcsec_s": 0.031, "dec_arcsec_s": -0.012},
            "offset rates of +0.031″/s in RA and -0.012″/s in Dec",
        ),
        ("offset-rates", {"ra_arcsec_s": 0.0, "dec_arcsec_s": 0.0}, "an end of the offset rates"),
        ("offset-rates", {"ra_arcsec_s": "nan"}, "an order of offset rates"),
    ],
)
def test_they_are_told_with_their_numbers(order: Order, facts: dict[str, object], words: str) -> None:
    record = CommandRecord("c-1", "east", datetime(2026, 11, 26, tzinfo=UTC), order, "s-1", facts=facts)
    assert named(record) == words
