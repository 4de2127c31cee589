"""Files that the commands write, by the stub and in a process of their own: whole, or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from api.solver_commands.host import LocalHost
from api.solver_daemon import stub

Write = Callable[[Path, bytes], None]


@pytest.fixture(params=["stub", "alone"])
def write(request: pytest.FixtureRequest) -> Write:
    """Both ways."""
    if request.param == "stub":
        return lambda path, content: stub.written(os.fsencode(path), content)
    return lambda path, content: LocalHost().write(str(path), content)


@pytest.mark.parametrize("name", ["a" * 251 + ".wcs", "星" * 83 + ".wcs", "a b[1].wcs", "b\n.wcs"])
def test_a_name_may_be_as_long_as_names_can_be(tmp_path: Path, write: Write, name: str) -> None:
    write(tmp_path / name, b"one")
    write(tmp_path / name, b"two")
    assert (tmp_path / name).read_bytes() == b"two"
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.fixture(params=["stub", "alone"])
def remove(request: pytest.FixtureRequest) -> Callable[[Path], None]:
    """Both ways."""
    if request.param == "stub":
        return lambda path: stub.removed(os.fsencode(path))
    return lambda path: LocalHost().remove(str(path))


def test_the_null_device_takes_all_and_stays_what_it_is(
    tmp_path: Path, write: Write, remove: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    # whoever runs this as root shall keep it, whatever is wrong
    for name in ("replace", "rename", "unlink"):
        monkeypatch.setattr(os, name, lambda *given, **_: pytest.fail(f"{given}"))
    (tmp_path / "link").symlink_to("/dev/null")
    for path in (tmp_path / "link", Path("/dev/null")):
        write(path, b"content")
        remove(path)
        assert not LocalHost().exists(str(path))
    assert Path("/dev/null").is_char_device()


def test_what_is_no_file_is_not_removed(tmp_path: Path, remove: Callable[[Path], None]) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder"):
        with pytest.raises(OSError):
            remove(tmp_path / name)
    (tmp_path / "link").symlink_to("pipe")
    (tmp_path / "file").touch()
    for name in ("link", "file", "none"):
        remove(tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "pipe"]


@pytest.mark.parametrize("kind", ["folder", "pipe", "device"])
def test_what_is_no_file_is_refused_and_left_alone(tmp_path: Path, write: Write, kind: str) -> None:
    path = tmp_path / "odd"
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises(OSError):
        write(path, b"content")
    assert not path.is_file()
    assert [one.name for one in tmp_path.iterdir()] == ["odd"]
    assert Path("/dev/zero").is_char_device()


def test_links_are_followed_and_the_mode_stays(tmp_path: Path, write: Write) -> None:
    (tmp_path / "file").write_bytes(b"old")
    (tmp_path / "file").chmod(0o640)
    (tmp_path / "link").symlink_to("file")
    write(tmp_path / "link", b"new")
    assert (tmp_path / "file").read_bytes() == b"new"
    assert (tmp_path / "file").stat().st_mode & 0o777 == 0o640
    assert (tmp_path / "link").is_symlink()


def test_a_file_that_may_not_be_written_stays(
    tmp_path: Path, write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_bytes(b"precious")
    # as the system answers everybody but root of a file of mode 0444
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(PermissionError):
        write(tmp_path / "file", b"new")
    assert (tmp_path / "file").read_bytes() == b"precious"
