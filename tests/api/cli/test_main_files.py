"""A file that can't be used is named, in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.api.command_here import run_here


def _refused(*arguments: str | Path) -> str:
    done = run_here(*arguments)
    assert done.returncode in (1, 2)
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    return line


@pytest.mark.parametrize(
    ("name", "words"),
    [("none/observatory.toml", "No such file or directory"), ("file/observatory.toml", "Not a directory")],
)
def test_a_file_that_cannot_be_written_is_named(name: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    site = ("--latitude", "47", "--longitude", "11", "--height", "600", "--mount", "fake", "--no-look")
    line = _refused("init", *site, "--out", tmp_path / name)
    assert str(tmp_path / name.partition("/")[0]) in line
    assert words in line


def test_settings_and_backups_that_are_none_are_named(tmp_path: Path) -> None:
    for command in (("check", "--json"), ("serve",), ("report",), ("journal", "check")):
        assert run_here(*command, "--config", tmp_path).returncode == 2
    settings = tmp_path / "observatory.toml"
    settings.write_text("[site]\nlatitude_deg = 47.0\nlongitude_deg = 11.0\n")
    line = _refused("journal", "restore", tmp_path, "--config", settings, "--journal", tmp_path / "j.sqlite")
    assert str(tmp_path) in line
    assert "it is a folder, not a file" in line
