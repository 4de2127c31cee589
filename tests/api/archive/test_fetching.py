"""Frames from this machine and from a server, and tables that name them."""

from __future__ import annotations

import errno
import functools
import hashlib
import os
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from fsspec import AbstractFileSystem
from fsspec.registry import register_implementation

from api.archive.chosen import prepared_for
from api.archive.fetching import MOST_FETCHED_BYTES, Fetched, fetched
from api.archive.listing import listed_frames
from api.archive.solving import _OWN_FAULTS, ChunkSolver
from mountnav.archive.folder import Folder
from mountnav.archive.tables import read_rows
from mountnav.archive.work_list import Entry, WorkList
from mountnav.errors import BadRequest
from mountnav.solution import Verdict
from tests.api.archive.conftest import SOLVING
from tests.api.command_here import run_here

CONTENT = bytes(range(256)) * 40_000


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *told: object) -> None:
        pass

    def do_GET(self) -> None:
        if self.path.startswith("/never"):
            self.server.asked.wait(20.0)  # type: ignore[attr-defined]
        elif self.path.startswith("/answer-"):
            self.send_error(int(self.path[8:11]))
        elif self.path.startswith("/circle"):
            self.send_response(302)
            self.send_header("Location", self.path)
            self.end_headers()
        else:
            super().do_GET()


class _Closed(AbstractFileSystem):  # type: ignore[misc]
    """A store whose credentials have expired, as s3fs tells it."""

    protocol = "closed"

    def _open(self, path: str, *args: object, **more: object) -> object:
        raise PermissionError("The provided token has expired.")


def test_a_store_that_refuses_is_the_storage_s_fault_and_no_frame_s() -> None:
    register_implementation("closed", _Closed, clobber=True)
    with pytest.raises(OSError, match="credentials missing or expired") as told:
        fetched("closed://archive/frame.fits", 5.0)
    # so many in a row end the chunk, instead of an archive full of frames that can't be read
    assert told.value.errno not in _OWN_FAULTS


@contextmanager
def _serving(folder: Path) -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Quiet, directory=str(folder)))
    server.asked = threading.Event()  # type: ignore[attr-defined]
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.asked.set()  # type: ignore[attr-defined]
    server.shutdown()
    server.server_close()


@pytest.fixture
def served(tmp_path: Path) -> Iterator[str]:
    """A server of a folder with a frame."""
    (tmp_path / "a.fits").write_bytes(CONTENT)
    with _serving(tmp_path) as address:
        yield address


def test_a_frame_comes_from_a_server_as_from_the_disk(served: str, tmp_path: Path) -> None:
    for name in (f"{served}/a.fits", str(tmp_path / "a.fits")):
        found = fetched(name, 20.0)
        with found.file as file:
            assert (found.size_bytes, file.read()) == (len(CONTENT), CONTENT)
            assert found.sha256 == hashlib.sha256(CONTENT).hexdigest()


def test_what_is_not_there_or_never_comes_is_told_apart(served: str) -> None:
    with pytest.raises(OSError) as told:
        fetched(f"{served}/none.fits", 20.0)
    assert told.value.errno == errno.ENOENT
    with pytest.raises(OSError) as told:
        fetched(f"{served}/never.fits", 0.3)
    assert told.value.errno not in (errno.ENOENT, errno.EACCES)
    with pytest.raises(BadRequest):
        fetched("nonsense://x/y.fits", 1.0)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("answer-500.fits", "the server answers 500 Internal Server Error"),
        ("answer-429.fits", "the server answers 429 Too Many Requests"),
        ("answer-403.fits?signed=SECRET", "the server answers 403 Forbidden"),
        ("never.fits", "no answer came within 0.3 s"),
        ("circle.fits?signed=SECRET", "TooManyRedirects"),
    ],
)
def test_what_a_server_did_is_told_in_words_and_never_what_a_url_has_signed(
    served: str, name: str, words: str
) -> None:
    with pytest.raises(OSError) as told:
        fetched(f"{served}/{name}", 0.3 if "never" in name else 20.0)
    assert words in str(told.value.strerror)
    assert "SECRET" not in str(told.value)


def test_a_file_longer_than_any_image_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with open(tmp_path / "long.fits", "wb") as file:
        file.truncate(MOST_FETCHED_BYTES + 1)
    with pytest.raises(OSError) as told:
        fetched(str(tmp_path / "long.fits"), 20.0)
    assert told.value.errno == errno.EFBIG


def test_a_file_that_is_written_to_after_it_was_hashed_shows_it(tmp_path: Path) -> None:
    path = tmp_path / "a.xy"
    path.write_bytes(CONTENT)
    found = fetched(str(path), 20.0)
    with found.file:
        assert found.unchanged()
        path.chmod(0o600)  # that is no other content
        assert found.unchanged()
        with open(path, "r+b") as other:
            other.write(b"other")
        os.utime(path, ns=(found.state[1] + 1, found.state[1] + 1))  # the clock of files may stand still
        assert not found.unchanged()


class _Disturbed(ChunkSolver):
    """Somebody writes to one of the frames each time that it was read, until he is done."""

    written: Path
    times = 0

    async def _tried(self, entry: Entry, opened: Fetched) -> tuple[Verdict | None, str, str]:
        if Path(entry.file) == self.written and self.times:
            self.times -= 1
            self._write()
        return await super()._tried(entry, opened)

    def _write(self) -> None:
        with open(self.written, "a") as file:
            file.write("\n")


@pytest.mark.long
@pytest.mark.parametrize(("times", "outcome"), [(1, "solved"), (2, "refused")])
async def test_a_frame_that_is_being_written_is_solved_as_it_is_in_the_end_or_not_at_all(
    lists: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, times: int, outcome: str
) -> None:
    monkeypatch.setattr("api.archive.solving.PAUSE_S", 0.0)
    head, *rows = lists.read_text().splitlines()[:3]
    for row in rows:
        shutil.copy(lists.parent / row.split(",")[0], tmp_path)
    table = tmp_path / "t.csv"
    table.write_text("\n".join([head, *(row.removeprefix("lists/") for row in rows)]) + "\n")
    made = run_here("archive", "init", tmp_path / "archive", "--frames", table, *SOLVING)
    assert made.returncode == 0, made.stderr
    folder = Folder.open(tmp_path / "archive")
    run, chunk = folder.run(None), WorkList.open(folder).chunks[0]
    solver = _Disturbed(prepared_for(run), None)
    solver.written, solver.times = tmp_path / "000000.xy", times
    try:
        assert await solver.chunk(run, chunk, lambda _: None)
    finally:
        await solver.close()
    first, second = read_rows(run.chunk(0) / "frames.parquet")
    assert (first["outcome"], second["outcome"]) == (outcome, "solved")
    if outcome == "solved":
        assert first["sha256"] == hashlib.sha256(solver.written.read_bytes()).hexdigest()
    else:
        (refusal,) = read_rows(run.chunk(0) / "refusals.parquet")
        assert refusal["reason_code"] == "UNREAD"
        assert "being written" in str(refusal["reason"])


def test_all_extensions_of_a_tables_frames_are_meant_by_all(tmp_path: Path) -> None:
    images = [fits.ImageHDU(np.zeros((20, 20), np.int16)) for _ in range(2)]
    fits.HDUList([fits.PrimaryHDU(), *images]).writeto(tmp_path / "two.fits")
    table = tmp_path / "t.csv"
    table.write_text("file,extension,ra_deg,dec_deg\ntwo.fits,,10,20\ntwo.fits,2,10,20\n")
    found = list(listed_frames([str(table)], "all"))
    assert [entry.extension for entry in found] == ["1", "2", "2"]
    assert all(entry.hint is not None for entry in found)
    table.write_text("file\nhttps://host/two.fits\n")
    with pytest.raises(BadRequest, match="extensions of a URL"):
        list(listed_frames([str(table)], "all"))


def test_tables_and_lists_name_frames_with_hints(tmp_path: Path) -> None:
    (tmp_path / "a.fits").write_bytes(b"12345")
    table = tmp_path / "t.ecsv"
    table.write_text(
        "# %ECSV 1.0\nfile,extension,ra_deg,dec_deg,scale_arcsec_px,observer\n"
        'a.fits,2,10.5,-3,2.0,me\n"s3://b/c, d.fits",,,,,\n'
    )
    (tmp_path / "l.txt").write_text(f"{tmp_path}/a.fits\r\n\nhttps://h/x.fits\n")
    one, other, third, fourth = listed_frames([str(table), str(tmp_path / "l.txt")], "1")
    assert (one.file, one.extension, one.size_bytes) == (str(tmp_path / "a.fits"), "2", 5)
    assert one.hint is not None
    assert one.hint.center is not None
    assert (one.hint.center.ra_deg, one.hint.scale_low_arcsec_px) == (10.5, 1.9)
    assert (other.file, other.extension, other.hint) == ("s3://b/c, d.fits", "1", None)
    assert (third.file, fourth.file) == (str(tmp_path / "a.fits"), "https://h/x.fits")


@pytest.mark.parametrize(
    "content",
    ["name\na\n", "file,ra_deg\na,1\n", "file,ra_deg,dec_deg\na,1,95\n", "file,ra_deg,dec_deg\na,x,y\n"],
)
def test_a_row_that_makes_no_sense_is_refused_with_its_number(tmp_path: Path, content: str) -> None:
    (tmp_path / "t.csv").write_text(content)
    with pytest.raises(BadRequest, match="row 1"):
        list(listed_frames([str(tmp_path / "t.csv")], None))


@pytest.mark.long
def test_an_archive_from_a_server_is_that_from_the_disk(lists: Path, tmp_path: Path) -> None:
    head, *rows = lists.read_text().splitlines()[:4]
    with _serving(lists.parent) as address:
        for name, where in (("near", str(lists.parent)), ("far", address)):
            table = tmp_path / f"{name}.csv"
            table.write_text("\n".join([head, *(f"{where}/{row}" for row in rows)]) + "\n")
            made = run_here("archive", "init", tmp_path / name, "--frames", table, *SOLVING)
            assert made.returncode == 0, made.stderr
            assert run_here("archive", "work", tmp_path / name).returncode == 0
    near, far = (Folder.open(tmp_path / name).run(None).chunk(0) for name in ("near", "far"))
    assert (near / "solutions.parquet").read_bytes() == (far / "solutions.parquet").read_bytes()
    hashes = [[row["sha256"] for row in read_rows(chunk / "frames.parquet")] for chunk in (near, far)]
    assert hashes[0] == hashes[1]
    assert len(set(hashes[0])) == 3
