"""Files written at once or not at all, with the mode they had."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from mountnav.files import replace_bytes, require_replaceable


def test_a_new_file_has_the_mode_that_the_umask_leaves(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        replace_bytes(tmp_path / "new", b"content")
    finally:
        os.umask(before)
    assert (tmp_path / "new").read_bytes() == b"content"
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("mode", [0o600, 0o644, 0o755])
def test_a_file_that_is_there_keeps_its_mode_and_a_link_stays_one(tmp_path: Path, mode: int) -> None:
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_bytes(b"old")
    file.chmod(mode)
    link.symlink_to("file")
    replace_bytes(link, memoryview(b"content"))
    assert link.is_symlink()
    assert file.read_bytes() == b"content"
    assert file.stat().st_mode & 0o777 == mode
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "link"]


def test_who_reads_the_old_one_reads_it_to_its_end(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"old content")
    with open(tmp_path / "file", "rb") as reader:
        assert reader.read(3) == b"old"
        replace_bytes(tmp_path / "file", b"new")
        assert reader.read() == b" content"


@pytest.mark.parametrize("kind", ["folder", "pipe", "device", "missing folder"])
def test_what_is_no_file_is_refused_and_left_alone(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "odd"
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/null")
    else:
        path = path / "file"
    before = sorted(tmp_path.iterdir())
    with pytest.raises(OSError) as raised:
        replace_bytes(path, b"content")
    if kind != "missing folder":
        with pytest.raises(OSError):
            require_replaceable(path)
    assert raised.value.filename in (str(path), str(path.resolve())), "not of a file that nobody knows"
    assert sorted(tmp_path.iterdir()) == before
    assert Path("/dev/null").is_char_device()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write to any file")
def test_a_file_that_may_not_be_written_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"old")
    (tmp_path / "file").chmod(0o444)
    with pytest.raises(PermissionError):
        replace_bytes(tmp_path / "file", b"new")
    assert (tmp_path / "file").read_bytes() == b"old"


def test_files_and_nothing_may_be_replaced(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to("nowhere")
    for name in ("file", "link", "none"):
        require_replaceable(tmp_path / name)


def test_a_disk_that_gets_full_leaves_the_old_one_and_is_told_with_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "report.html"
    path.write_bytes(b"old")

    def full(number: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("mountnav.files.os.fsync", full)
    with pytest.raises(OSError, match="No space left on device") as told:
        replace_bytes(path, b"new")
    assert told.value.filename == str(path)
    assert (told.value.errno, path.read_bytes()) == (errno.ENOSPC, b"old")
    assert [one.name for one in tmp_path.iterdir()] == ["report.html"]
