"""Frames from this machine and from a server, and tables that name them."""

from __future__ import annotations

import errno
import functools
import hashlib
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from api.archive.fetching import fetched
from api.archive.listing import listed_frames
from mountnav.errors import BadRequest

CONTENT = bytes(range(256)) * 40_000


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *told: object) -> None:
        pass

    def do_GET(self) -> None:
        if self.path.startswith("/never"):
            self.server.asked.wait(20.0)  # type: ignore[attr-defined]
        else:
            super().do_GET()


@pytest.fixture
def served(tmp_path: Path) -> Iterator[str]:
    """A server of a folder with a frame."""
    (tmp_path / "a.fits").write_bytes(CONTENT)
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Quiet, directory=str(tmp_path)))
    server.asked = threading.Event()  # type: ignore[attr-defined]
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.asked.set()  # type: ignore[attr-defined]
    server.shutdown()
    server.server_close()


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
