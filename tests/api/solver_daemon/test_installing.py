"""The commands in a folder: written, run, taken away, and nobody else's file touched."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from api.solver_commands.registry import NAMES
from api.solver_daemon.installing import MARK, install, is_ours, uninstall
from mountnav.errors import BadRequest


def test_all_commands_are_written_and_taken_away(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "bin"
    done = install(folder)
    assert [path.name for path in done.written] == list(NAMES)
    assert done.kept == ()
    assert all(os.access(path, os.X_OK) and is_ours(path) for path in done.written)
    (folder / "mine").write_text("kept")
    assert set(uninstall(folder)) == set(done.written)
    assert [path.name for path in folder.iterdir()] == ["mine"]


def test_a_program_of_others_is_replaced_by_force_only(tmp_path: Path) -> None:
    theirs = tmp_path / "astap"
    theirs.write_bytes(b"\x7fELF the real one")
    done = install(tmp_path)
    assert done.kept == (theirs,)
    assert theirs.read_bytes() == b"\x7fELF the real one"
    assert uninstall(tmp_path)
    assert theirs.exists()
    assert install(tmp_path, force=True).kept == ()
    assert is_ours(theirs)


def test_no_command_is_written_through_a_link(tmp_path: Path) -> None:
    real = tmp_path / "system-astap"
    real.write_bytes(b"the system's")
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "astap").symlink_to(real)
    assert install(folder, ["astap"]).kept == (folder / "astap",)
    install(folder, ["astap"], force=True)
    assert real.read_bytes() == b"the system's"
    assert not (folder / "astap").is_symlink()


def test_installing_twice_renews(tmp_path: Path) -> None:
    install(tmp_path, ["astap"])
    (tmp_path / "astap").write_text(f"#!/bin/sh\n{MARK}\nan older version\n")
    assert install(tmp_path, ["astap"]).written == (tmp_path / "astap",)
    assert "an older version" not in (tmp_path / "astap").read_text()


def test_an_interpreter_with_blanks_in_its_path_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    odd = tmp_path / "my programs"
    odd.mkdir()
    (odd / "python").symlink_to(Path(sys.executable).resolve())
    monkeypatch.setattr(sys, "executable", str(odd / "python"))
    install(tmp_path, ["wcsinfo"])
    told = subprocess.run(
        [tmp_path / "wcsinfo", "x"],
        env={"MOUNTNAV_SOLVER": "off", "PATH": os.environ["PATH"]},
        capture_output=True,
        text=True,
    )
    # that interpreter knows no mountnav: but it was found, and ran the stub
    assert "api.solver_daemon" in told.stderr


def test_bad_folders_and_names_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadRequest, match="can't be written"):
        install(tmp_path / "file")
    with pytest.raises(BadRequest, match="no command"):
        install(tmp_path, ["rm"])
