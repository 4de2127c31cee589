"""A night whose journal can't be read yet doesn't begin without it: that is told, and done when it can be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from api.nights.nights import NightRunner, Nights
from mountnav.errors import Busy, JournalFailed
from mountnav.journal.records import Entry, EntryKind
from tests.api.nights.night_site import night_toml, served


@pytest.mark.long
async def test_what_a_night_remembers_is_read_once_more_when_it_could_not_be(tmp_path: Path) -> None:
    folder, record, safety = tmp_path / "frames", tmp_path / "recordings", tmp_path / "safety.txt"
    (folder / "elsewhere").mkdir(parents=True)
    safety.write_text("safe")
    asked: list[str] = []

    async def recall(telescope_id: str, _kind: EntryKind, _count: int) -> list[Entry]:
        asked.append(telescope_id)
        if asked.count(telescope_id) == 1:
            raise JournalFailed("the disk doesn't answer", device="journal")
        return []

    async with served(night_toml(folder, record, safety), folder, record, safety) as site:
        parts = replace(site.app.state.service.nights.of("east").parts, recording=None)
        runners = [
            NightRunner(replace(parts, telescope_id="first", recall=recall)),
            NightRunner(replace(parts, telescope_id="second")),
        ]
        nights = Nights(runners)
        try:
            with pytest.raises(JournalFailed, match="doesn't answer"):
                await nights.start()
            with pytest.raises(Busy):
                _ = nights.of("first").session
            begun = nights.of("second").session
            await nights.start()
            assert asked == ["first", "first"]
            assert nights.of("first").session is not None
            # what has begun isn't begun again
            assert nights.of("second").session is begun
        finally:
            await nights.close()
