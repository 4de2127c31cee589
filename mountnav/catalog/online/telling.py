"""How an operator is told where stars came from: the words of `Stars.steps`."""

from __future__ import annotations

from datetime import UTC, datetime

from mountnav.catalog.online.at_hand import AtHand
from mountnav.catalog.online.fetching import Fetched


def tiles_text(count: int) -> str:
    """In words: "1 tile", "3 tiles"."""
    return "1 tile" if count == 1 else f"{count} tiles"


def fetched_text(came: Fetched, host: str) -> str:
    """What was fetched from where; empty if nothing was."""
    if not came.records:
        return ""
    split = f", {tiles_text(came.splits)} too full and split" if came.splits else ""
    return f"{tiles_text(len(came.records))} fetched from {host}{split}"


def cached_text(found: AtHand, is_just_fetched: bool) -> str:
    """Which tiles were taken from the cache, and of which age."""
    today = datetime.now(UTC).date().isoformat()
    parts = []
    for records, what in ((found.stale, "stale "), (found.fresh, "")):
        # a tile of today that was there before is not worth a word beside those that came just now
        told = [record.date for record in records if not (is_just_fetched and record.date == today)]
        if told:
            days = min(told) if min(told) == max(told) else f"{min(told)} to {max(told)}"
            tiles = tiles_text(len(told)).replace(" ", f" {what}", 1)
            parts.append(f"{tiles} of {days} taken" if what else f"{tiles} from the cache of {days}")
    return ", ".join(parts)
