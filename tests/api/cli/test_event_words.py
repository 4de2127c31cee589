"""Events as the command line prints them: a sentence, not the names of fields."""

from __future__ import annotations

import pytest

from api.cli.operate import event_words


@pytest.mark.parametrize(
    ("kind", "data", "words"),
    [
        ("flipped", {"from": "east", "to": "west"}, "changed sides of the pier: east to west"),
        (
            "tactic",
            {"tactic": "another-frame", "why": "too few stars", "frames": 1, "exposure_s": 1.0},
            "looks again (another frame): too few stars",
        ),
        ("slewing", {"ra_deg": 10.0, "dec_deg": -5.0}, "slews to RA 10.0000° Dec -5.0000°"),
        ("solving", {"job_id": "1"}, ""),
        ("dithered", {"step": 2, "telescope": "east"}, "dithered step=2"),
    ],
)
def test_what_is_printed(kind: str, data: dict[str, object], words: str) -> None:
    assert event_words(kind, data) == words
