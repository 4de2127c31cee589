"""A night of `benchmarks.year`, the service killed in its midst: nothing is lost, and its report is right."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.year import TELESCOPES, Year, grown


@pytest.mark.long
def test_a_night_with_a_kill_is_told_as_it_was(tmp_path: Path) -> None:
    into = tmp_path / "year.jsonl"
    year = Year(into, 5, 2, verbose=False, only=("kill",))
    year.run(1)
    (night,) = year.nights
    assert night.faults == []
    assert night.events == ["kill"]
    assert night.starts >= 2
    for name in TELESCOPES:
        ends = [one.state for one in night.jobs if one.telescope == name and one.kind == "center"]
        assert ends.count("succeeded") == 2, night.jobs
    assert night.figures["look_rows"] > 4
    assert list(grown(year.nights)) == []
    # it goes on where it ended, and nobody is left
    assert [one.number for one in Year(into, 5, 2, verbose=False).nights] == [0]
    assert year.service.process is None
