"""Frames from this machine and from a server, and tables that name them."""

from __future__ import annotations

import errno
import functools
import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from api.archive.fetching import fetched
from api.archive.listing import listed_frames
from mountnav.archive.folder import Folder
from mountnav.archive.tables import read_rows
from mountnav.errors import BadRequest
from tests.api.archive.conftest import SOLVING
from tests.api.command_here import run_here

CONTENT = bytes(range(256)) * 40_000


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *told: object) -> None:
        pass

    def do_GET(self) -> None:
        if self.path.startswith("/never"):
            self.server.asked.wait(20.0)  # type: ignore[attr-defined]
        else:
            super().do_GET()


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
