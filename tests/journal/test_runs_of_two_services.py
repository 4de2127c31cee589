"""Two services of one host on one journal: each start is compared with the last one of the same service."""

from __future__ import annotations

import json
from pathlib import Path

from mountnav.journal.reading import Wanted
from mountnav.journal.records import EntryKind
from mountnav.journal.sql_journal import SqlJournal, open_journal


def _started(path: Path, telescope: str, port: int) -> SqlJournal:
    settings = {"service": {"port": port}, "telescope": [{"id": telescope}]}
    return open_journal(path, settings_text=json.dumps(settings, indent=1), inline=True)


def test_another_service_s_start_and_settings_are_not_taken_for_this_one_s(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    north, south = _started(path, "north", 1), _started(path, "south", 2)
    north.close()
    south.close()
    north = _started(path, "north", 3)
    kinds = frozenset({EntryKind.SERVICE, EntryKind.SETTINGS})
    told = north.reader.entries(Wanted(kinds=kinds), limit=50)
    north.close()
    assert not any("killed" in one.what for one in told)
    first, other, changed = (one for one in told if one.kind is EntryKind.SETTINGS)
    assert first.what == other.what == "the configuration is written down"
    assert changed.what == "the configuration has changed"
    assert changed.facts["changes"] == ['-  "port": 1', '+  "port": 3']
