"""What commands do in one way: JSON, files that can't be used, a service that doesn't answer."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest

from api.cli.output import finite_or_none, print_json, refusing_os_errors, unreadable
from api.main import main
from mountnav.errors import BadRequest
from tests.api.command_here import run_here

NOBODY = "http://127.0.0.1:9"


def test_numbers_that_json_has_not_become_null(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"a": [math.nan, 1.5, {"b": -math.inf}], "c": (1, True, None, "ü")})
    out = capsys.readouterr().out
    assert out.endswith("\n")
    assert json.loads(out) == {"a": [None, 1.5, {"b": None}], "c": [1, True, None, "ü"]}
    assert "\\u00fc" in out
    assert [finite_or_none(value) for value in (None, math.nan, math.inf, 2)] == [None, None, None, 2.0]


def test_json_as_others_want_it(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"a": ["ü", 1]}, ascii_only=False, compact=True)
    print_json([1], indent=1)
    assert capsys.readouterr().out == '{"a":["ü",1]}\n[\n 1\n]\n'


def test_a_pipe_of_another_encoding_gets_question_marks(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with (tmp_path / "out").open("w", encoding="ascii") as out:
        monkeypatch.setattr(sys, "stdout", out)
        monkeypatch.setattr(sys, "argv", ["mountnav", "solve", "no-such-file.fits"])
        with pytest.raises(SystemExit) as ended:
            main()
    assert ended.value.code == 1
    assert (tmp_path / "out").read_text("ascii").startswith("? no-such-file.fits  not solved")


def test_files_that_cant_be_used_are_refused_with_the_reason() -> None:
    with (
        pytest.raises(BadRequest, match="x can't be written: No such file or directory") as refused,
        refusing_os_errors("x can't be written", advice="name another"),
    ):
        Path("/there/is/none").write_text("")
    assert refused.value.advice == "name another"
    assert unreadable(OSError("no file at all")) == "the file can't be read: no file at all"


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        ["first-light", "east"],
        ["site-time", "east", "--accept"],
        ["night", "status", "east"],
        ["night", "pause", "east"],
        ["wire", "east", "--no-follow"],
    ],
)
def test_a_service_that_doesnt_answer_is_one_line(words: list[str]) -> None:
    ended = run_here(*words, "--service", NOBODY)
    assert (ended.returncode, ended.stdout) == (1, "")
    (line,) = ended.stderr.splitlines()
    assert line.startswith(f"mountnav: {NOBODY}: no mountnav service answers: ")
    assert line.endswith("(start it, or give --service)")
