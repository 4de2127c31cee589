"""A chunk is in the store as a whole or not at all; what is there is accounted for, and damage is seen."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.archive.accounting import chunks_with, status_of, taken_out, verify
from mountnav.archive.differences import differences
from mountnav.archive.folder import Folder, RunFolder
from mountnav.archive.recipe import Recipe, begin_run, recipe_in
from mountnav.archive.report import as_html, reported
from mountnav.archive.store import chunk_written, claimed
from mountnav.archive.tables import COST_TABLE, write_table
from mountnav.archive.work_list import Chunk, Entry, WorkList, add_batch, numbered
from mountnav.errors import BadRequest, BadSettings, NotFound, ResultsDiffer
from mountnav.solution import Reason
from tests.archive.made import RECIPE, archive, finished, result_of, written


def tree(folder: Path) -> dict[str, bytes]:
    """All files below a folder, and what they hold."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_list_gives_back_what_was_put_in_and_each_batch_goes_on_counting(tmp_path: Path) -> None:
    folder, _ = archive(tmp_path / "a", frames=7, chunk_frames=3)
    add_batch(folder, [Entry("s3://b/x.fits", "2"), Entry("/y.fits", "SCI")], priority=5)
    work = WorkList.open(folder)
    entries = list(numbered(work.chunks))
    assert [entry.number for entry in entries] == list(range(9))
    assert [chunk.frames for chunk in work.chunks] == [3, 3, 1, 2]
    assert [entry.hdu for entry in entries[-2:]] == [2, "SCI"]
    assert entries[0].hint is None
    assert entries[1].hint is not None
    assert entries[1].hint.center is not None
    assert (entries[1].hint.center.ra_deg, entries[1].hint.radius_deg) == (1.0, 2.0)
    assert [chunk.number for chunk in work.in_order()] == [3, 0, 1, 2]


def test_a_list_with_any_byte_changed_is_damaged_and_one_of_an_older_version_is_read(tmp_path: Path) -> None:
    folder, run = archive(tmp_path / "a")
    finished(folder, run)
    chunk = WorkList.open(folder).chunks[0]
    whole = chunk.path.read_bytes()
    for at in range(0, len(whole), 97):  # also what no reader of Parquet checks
        chunk.path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        with pytest.raises(BadRequest, match="is damaged"):
            chunk.entries()
    assert verify(folder, run).trouble_count == 1
    chunk.path.write_bytes(whole)
    batch = chunk.path.with_name("batch.json")
    told = json.loads(batch.read_text())
    batch.write_text(json.dumps(told | {"sha256": told["sha256"][:-1]}))
    with pytest.raises(BadRequest, match="another number of hashes"):
        WorkList.open(folder)
    del told["sha256"]
    batch.write_text(json.dumps(told))
    assert verify(folder, run).troubles == []


@given(count=st.integers(0, 40), of=st.integers(1, 50), first=st.sampled_from([0, 1]))
def test_each_chunk_is_one_workers(count: int, of: int, first: int) -> None:
    work = WorkList(tuple(Chunk(number, Path("x"), 1, number % 3) for number in range(count)))
    parts = [chunk.number for which in range(first, of + first) for chunk in work.part(which, of)]
    assert sorted(parts) == list(range(count))


def test_a_batch_that_ends_in_a_fault_adds_nothing(tmp_path: Path) -> None:
    folder, _ = archive(tmp_path / "a")

    def broken():
        yield Entry("/one.fits")
        raise KeyboardInterrupt

    before = tree(folder.path)
    with pytest.raises(KeyboardInterrupt):
        add_batch(folder, broken())
    with pytest.raises(BadRequest, match="no frame"):
        add_batch(folder, [])
    assert tree(folder.path) == before


def _half_written(run: RunFolder, chunk: Chunk, fault: BaseException) -> None:
    with chunk_written(run, chunk, RECIPE) as writer:
        writer.add(result_of(chunk.entries()[0]))
        raise fault


def test_a_chunk_that_ends_in_a_fault_leaves_nothing(tmp_path: Path) -> None:
    folder, run = archive(tmp_path / "a")
    chunk = WorkList.open(folder).chunks[0]
    for fault in (KeyboardInterrupt(), OSError(28, "No space left on device")):
        with pytest.raises((KeyboardInterrupt, OSError)):
            _half_written(run, chunk, fault)
        assert not run.done()
        assert not any(run.making.iterdir())
    with (
        pytest.raises(RuntimeError, match="has 3 frames, 1 came"),
        chunk_written(run, chunk, RECIPE) as writer,
    ):
        writer.add(result_of(chunk.entries()[0]))
    assert not run.done()


def test_the_same_results_are_the_same_bytes_and_a_second_worker_does_no_harm(tmp_path: Path) -> None:
    one, other = archive(tmp_path / "a"), archive(tmp_path / "b")
    finished(*one)
    for number in (2, 1, 0):
        finished(*other, only=number)
    assert tree(one[1].chunks) == tree(other[1].chunks)
    before = tree(one[1].chunks)
    finished(*one)  # each chunk is there already
    assert tree(one[1].chunks) == before
    assert not any(one[1].making.iterdir())
    with pytest.raises(ResultsDiffer):
        written(one[1], WorkList.open(one[0]).chunks[0], reason=Reason.CHANCE)
    assert tree(one[1].chunks) == before


def test_how_far_a_search_came_in_its_time_is_not_written(tmp_path: Path) -> None:
    found = []
    for name, detail in (("a", "30 s spent on 17 hypotheses"), ("b", "30 s spent on 19 hypotheses")):
        folder, run = archive(tmp_path / name, frames=1)
        chunk = WorkList.open(folder).chunks[0]
        result = result_of(chunk.entries()[0], Reason.TIMED_OUT)
        assert result.verdict is not None
        with chunk_written(run, chunk, RECIPE) as writer:
            writer.add(replace(result, verdict=replace(result.verdict, detail=detail)))
        found.append(tree(run.chunks))
    assert found[0] == found[1]


def test_a_claimed_chunk_is_nobody_elses_and_what_a_dead_worker_left_goes(tmp_path: Path) -> None:
    folder, run = archive(tmp_path / "a")
    chunk = WorkList.open(folder).chunks[0]
    left = run.making / "0000000-dead"
    left.mkdir()
    (left / "frames.parquet").write_bytes(b"half")
    with claimed(run, chunk) as ours, claimed(run, chunk) as theirs:
        assert (ours, theirs) == (True, False)
        assert not left.exists()
        assert status_of(folder, run).making == (0,)
        written(run, chunk)
    with claimed(run, chunk) as again:
        assert not again
    assert not any(run.making.iterdir())


def test_all_is_accounted_for(tmp_path: Path) -> None:
    folder, run = archive(tmp_path / "a", frames=7)
    finished(folder, run, only=0)
    partly = status_of(folder, run)
    assert (partly.done_chunks, partly.counts.frames, partly.complete) == (1, 3, False)
    assert verify(folder, run).missing_chunks == 2
    finished(folder, run)
    status = status_of(folder, run)
    counts = status.counts
    assert status.complete
    assert (counts.frames, counts.solved, counts.refused, counts.set_aside) == (7, 0, 6, 1)
    audit = verify(folder, run)
    assert audit.troubles == []
    assert audit.counts == counts
    assert sum(audit.machines.values()) == 3
    rows = pq.read_table(run.chunk(1) / "refusals.parquet").to_pylist()
    assert [row["reason_code"] for row in rows] == ["UNREAD", "HUNG", "NO_MATCH"]
    assert [row["set_aside"] for row in rows] == [False, True, False]


def test_verify_tells_chunks_that_were_computed_by_other_kernels(tmp_path: Path) -> None:
    """The same computer and libraries, another environment: the last digits differ, and it says why."""
    folder, run = archive(tmp_path / "a", frames=6)
    said = []
    for chosen in ("Haswell", "Nehalem"):
        told = subprocess.run(
            [
                sys.executable,
                "-c",
                "import numpy, mountnav.archive.store as s; print(s.machine()['kernels'])",
            ],
            env=os.environ | {"OPENBLAS_CORETYPE": chosen},
            capture_output=True,
            text=True,
            check=False,
        )
        if told.returncode:
            pytest.skip("numpy computes by no OpenBLAS here")
        said.append(told.stdout.strip())
    assert said == ["Haswell", "Nehalem"]
    finished(folder, run)
    for number, kernels in enumerate(said):
        run.cost(number).unlink()
        write_table(run.cost(number), COST_TABLE, [], {"processor": "P", "kernels": kernels})
    audit = verify(folder, run)
    assert audit.troubles == []
    assert sorted(audit.machines) == [f"P: , kernels of {kernels}" for kernels in said]


def _flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def _edit(path: Path) -> None:
    told = json.loads(path.read_text())
    told["refused"] += 1
    path.write_text(json.dumps(told))


@pytest.mark.long
@pytest.mark.parametrize(
    ("damage", "seen"),
    [
        (lambda chunk: _flip(chunk / "frames.parquet"), "frames.parquet is damaged"),
        (lambda chunk: _flip(chunk / "refusals.parquet"), "refusals.parquet is damaged"),
        (lambda chunk: (chunk / "solutions.parquet").unlink(), "it holds"),
        (lambda chunk: (chunk / "more.parquet").write_bytes(b""), "it holds"),
        (lambda chunk: _edit(chunk / "chunk.json"), "counts"),
        (lambda chunk: (chunk / "chunk.json").write_text("{"), "can't be read"),
        (lambda chunk: (chunk / "chunk.json").write_text("{}"), "recipe"),
        (lambda chunk: chunk.rename(chunk.with_name("chunk=0000007")), "not in the work list"),
    ],
)
def test_damage_is_seen(tmp_path: Path, damage: Callable[[Path], object], seen: str) -> None:
    folder, run = archive(tmp_path / "a")
    finished(folder, run)
    damage(run.chunk(1))
    audit = verify(folder, run)
    assert audit.trouble_count == 1
    assert seen in audit.troubles[0]


def test_another_chunks_results_are_no_results(tmp_path: Path) -> None:
    folder, run = archive(tmp_path / "a", frames=6)
    finished(folder, run)
    first, second = tree(run.chunk(0)), tree(run.chunk(1))
    assert first != second
    for name, content in first.items():
        (run.chunk(1) / name).write_bytes(content)
    assert verify(folder, run).trouble_count >= 3  # whole, but of other frames


def test_a_run_is_its_recipe(tmp_path: Path) -> None:
    folder, run = archive(tmp_path / "a")
    assert begin_run(folder, RECIPE) == (run, False)
    other = Recipe(RECIPE.decides | {"pairs": True}, {})
    assert begin_run(folder, other)[1]
    assert len(folder.runs()) == 2
    with pytest.raises(BadSettings, match="pairs is true here, false there"):
        recipe_in(run).require_same(other)
    path = run.path / "recipe.json"
    path.write_text(path.read_text().replace("30.0", "31.0"))
    with pytest.raises(BadRequest, match="was changed"):
        recipe_in(run)
    with pytest.raises(NotFound):
        folder.run("zz")


def test_no_folder_that_holds_something_becomes_an_archive(tmp_path: Path) -> None:
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / "thesis.tex").write_text("")
    with pytest.raises(BadRequest, match="not empty"):
        Folder.make(tmp_path / "x", 3)
    with pytest.raises(NotFound):
        Folder.open(tmp_path / "x")
    folder, _ = archive(tmp_path / "a")
    path = folder.path / "archive.json"
    path.write_text(path.read_text().replace('"version": 1', '"version": 2'))
    with pytest.raises(BadRequest, match="version 2"):
        Folder.open(folder.path)


def test_chunks_are_done_again_for_their_reasons_alone(tmp_path: Path) -> None:
    folder, run = archive(tmp_path / "a", frames=7)
    finished(folder, run)
    before = tree(run.chunks)
    found = chunks_with(folder, run, {"UNREAD"})
    assert (found.chunks, found.frames) == ([1], 1)
    taken_out(run, found.chunks)
    assert run.done() == {0, 2}
    assert not any(run.making.iterdir())
    finished(folder, run)
    assert tree(run.chunks) == before


def test_two_runs_are_compared(tmp_path: Path) -> None:
    folder, run = archive(tmp_path / "a", frames=7)
    finished(folder, run)
    other = Recipe(RECIPE.decides | {"mountnav": "1"}, {})
    newer: RunFolder = begin_run(folder, other)[0]
    finished(folder, newer, other, only=0)
    finished(folder, newer, other, only=2)
    found = differences(folder, run, newer)
    assert (found.compared, found.same_refused, found.not_both, found.same) == (4, 4, 3, False)
    written(newer, WorkList.open(folder).chunks[1], other, Reason.CHANCE)
    found = differences(folder, run, newer)
    assert (found.compared, found.not_both, found.counts["other_reason"]) == (7, 0, 1)
    assert "5 /frames/5.fits: NO_MATCH -> CHANCE" in found.words()


def test_the_report_counts_and_escapes(tmp_path: Path) -> None:
    folder, run = archive(tmp_path / "a", frames=7)
    finished(folder, run)
    found = reported(folder, run)
    assert found.counts.frames == 7
    assert found.reasons == {"NO_MATCH": 5, "UNREAD": 1, "HUNG": 1}
    assert found.instruments["a <b>camera</b>"].frames == 5
    assert found.instruments[""].frames == 2
    assert sum(found.contradictions.values()) == 5
    assert found.costed == 7
    page = as_html(found)
    assert "a &lt;b&gt;camera&lt;/b&gt;" in page
    assert "<b>camera" not in page
    assert "/frames/4.fits" in page
