"""What a job brought is remembered without the stars of its looks, and shown as before."""

from __future__ import annotations

import gc
from dataclasses import fields, replace
from typing import Any

import numpy as np

from api.orders.job_views import result_view
from api.orders.jobs import Jobs
from api.orders.lean_results import without_stars
from mountnav.clock import utc_now
from mountnav.devices import MountReading, SyncOutcome
from mountnav.navigation.reports import FrameLook, Look, RecoverReport, SyncReport
from mountnav.sky.coordinates import Icrs
from mountnav.solution import IdentifiedPairs
from tests.api.orders.job_work import ended
from tests.navigation.sync_rig import look_of, no_pairs, solution_at

_STARS = 2000


def _rich() -> Look:
    """A look at a field of many stars."""
    read, now = MountReading(Icrs(10.1, 20.1), utc_now()), utc_now()
    look = look_of(Icrs(10.0, 20.0), read, read, now, solution_at(Icrs(10.0, 20.0), 30.0), "look")
    columns: dict[str, Any] = {
        one.name: np.ones(_STARS, dtype=getattr(no_pairs(), one.name).dtype)
        for one in fields(IdentifiedPairs)
        if isinstance(getattr(no_pairs(), one.name), np.ndarray)
    }
    pairs = replace(no_pairs(), **columns)
    solution = replace(look.solution, identified=pairs)
    verdict = replace(look.verdict, solution=solution, seen_px=np.ones((1000, 2), dtype=np.float32))
    return replace(look, solution=solution, verdict=verdict)


def _bytes_of_arrays(whole: object) -> int:
    """All arrays that it leads to."""
    seen: dict[int, object] = {}
    left = [whole]
    while left:
        one = left.pop()
        if id(one) in seen or isinstance(one, type) or (type(one).__module__ == "builtins" and callable(one)):
            continue
        seen[id(one)] = one
        left += gc.get_referents(one)
    return sum(one.nbytes for one in seen.values() if isinstance(one, np.ndarray))


async def test_a_job_that_is_over_holds_no_stars(jobs: Jobs) -> None:
    look = _rich()
    assert _bytes_of_arrays(look) > 200_000

    async def work() -> object:
        return RecoverReport(
            SyncOutcome.SEEN,
            look,
            look,
            1.0,
            45.0,
            44.0,
            Icrs(10.0, 20.0),
            read_back_miss_arcsec=1.0,
            elapsed_s=9.0,
        )

    job = await ended(jobs.start("recover", "east", {}, work))
    assert _bytes_of_arrays(job.result) < 200
    # it is shown as it was brought, and who took the look has it whole
    assert result_view(job.result) == result_view(await work())
    assert len(look.solution.identified) == _STARS


def test_what_stands_in_two_places_does_so_afterwards_and_what_has_no_look_is_itself() -> None:
    look = _rich()
    bare = without_stars(
        (FrameLook(look), [SyncReport(SyncOutcome.SEEN, look, Icrs(1.0, 2.0), 3.0)], "and", {})
    )
    assert isinstance(bare, tuple)
    framed, (report,), *others = bare
    assert framed.look is report.look
    assert framed.look.solution is framed.look.verdict.solution
    assert framed.look.solution.pairs == look.solution.pairs
    assert framed.look.verdict.seen_px.shape == (0, 2)
    assert others == ["and", {}]
    for kept in (None, {"kind": "slew"}, "there", Icrs(1.0, 2.0), (1, [2])):
        assert without_stars(kept) is kept
