"""`mountnav solve` where there is no index yet: how the budget is shared before and after it is built."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from api.batch.inputs import FrameFile
from api.cli.solve import FileSolver
from mountnav.catalog.catalog_set import open_catalogs
from mountnav.errors import BadSettings
from mountnav.frames import Hint
from mountnav.solution import Reason, Times, Verdict
from mountnav.solving.settings import SolveSettings

SPENT_S = 3.0


@pytest.mark.parametrize(
    ("reason", "built", "budgets"),
    [
        (Reason.TIMED_OUT, True, [5.0, 7.0, 10.0]),
        (Reason.NO_MATCH, False, [5.0, 10.0]),
        (Reason.TIMED_OUT, False, [5.0, 10.0, 10.0]),
        (Reason.BAD_FRAME, True, [5.0, 5.0]),
    ],
)
def test_the_first_frame_that_needs_it_keeps_to_its_budget(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    reason: Reason,
    built: bool,
    budgets: list[float],
) -> None:
    asked: list[float] = []

    def solved(
        source: object, catalog: object, hint: Hint | None, *, settings: SolveSettings, **rest: object
    ) -> Verdict:
        asked.append(settings.budget_s)
        return Verdict(None, reason, "nothing there", 0, Times(identify_s=SPENT_S, total_s=SPENT_S))

    def index(catalog: object) -> object:
        if not built:
            raise BadSettings("no room", device="the cache", advice="make some")
        return object()

    monkeypatch.setenv("MOUNTNAV_CACHE", str(tmp_path))
    monkeypatch.setattr("mountnav.solving.solve.solve_file", solved)
    monkeypatch.setattr("api.cli.solve.open_or_build_index", index)
    files = [tmp_path / "one.fits", tmp_path / "two.fits"]
    settings = replace(SolveSettings(), budget_s=10.0)
    solver = FileSolver(open_catalogs(), None, None, settings)
    outcomes = [solver.outcome(FrameFile(file)) for file in files]
    assert not any(one.solved for one in outcomes)
    assert asked == budgets
    assert str([one.answer() for one in outcomes]).count(
        "the whole sky was not searched: the cache: no room"
    ) == (0 if built else 2)
