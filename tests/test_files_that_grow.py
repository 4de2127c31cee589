"""Files that somebody else wrote are read in proportion to their length, however they were made."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.fakes.recording import profile_of, read_dialogue
from mountnav.errors import BadRequest
from mountnav.night.recording import read_recording
from mountnav.parsing import toml_of
from mountnav.pointing.limits.horizon import Horizon
from mountnav.pointing.model.tpoint_file import read_observations_text
from tests.drivers.skywatcher.quick_fakes import quick
from tests.growth import LINEAR, growth

HEADER = json.dumps({"kind": "header", "version": 3}) + "\n"
SENT = json.dumps({"dir": "driver->mount", "hex": "3a475223"}) + "\n"
ANSWERED = json.dumps({"dir": "mount->driver", "hex": "3a475223" * 20}) + "\n"


def _toml(path: Path) -> object:
    return toml_of(path.read_text())


@pytest.mark.long
@pytest.mark.parametrize(
    ("read", "before", "line"),
    [
        pytest.param(read_dialogue, SENT, ANSWERED, id="one question, many answers"),
        pytest.param(read_dialogue, "", SENT + ANSWERED, id="many questions"),
        pytest.param(read_recording, HEADER, HEADER, id="a service that started again and again"),
        pytest.param(Horizon.read, "", "10 {}.5\n", id="horizon"),
        pytest.param(_toml, "", "[t.a{}]\nb.c = 1\n", id="tables"),
        pytest.param(_toml, "[[t]]\n", "[[t.a]]\nb = '{}'\n", id="arrays of tables"),
    ],
)
def test_a_file_is_read_in_proportion_to_its_length(
    tmp_path: Path, read: Callable[[Path], object], before: str, line: str
) -> None:
    def made(count: int) -> Path:
        path = tmp_path / str(count)
        lines = (line.replace("{}", str(number % 80)) for number in range(count))
        if "[t." in line:
            lines = (line.replace("{}", str(number)) for number in range(count))
        path.write_text(before + "".join(lines))
        return path

    assert growth(made, read, 3000) < LINEAR


def test_a_profile_is_found_in_proportion_to_what_was_sent() -> None:
    def sent(count: int) -> list[tuple[bytes, bytes]]:
        return [(b":j1\r" * count, b"")]

    assert growth(sent, lambda turns: profile_of(turns, quick()), 20_000) < LINEAR


def test_noise_of_any_length_is_cut_off_by_a_fake_mount() -> None:
    assert quick().cut(b"\r" * 5000 + b"x:j1\r:f") == (b":j1\r", b":f")
    assert quick().cut(b"\r" * 5000) == (None, b"")
    assert quick().cut(b"x\r:j") == (None, b":j")


@pytest.mark.parametrize(
    "text",
    [
        "x\nE\n48\n10 10 10 10\n" + "1" * 400 + " 10 10 10\n",
        "x\n:NODA\n+48 10 00\n10 20 nan +10 10 10 10 20 30 +10 10 10 10 20\n",
        "x\n:NODA\n+48 10 00\n10 20 30 +1e400 10 10 10 20 30 +10 10 10 10 20\n",
    ],
)
def test_angles_of_no_mount_are_refused(text: str) -> None:
    with pytest.raises(BadRequest, match=r"observation . of . has an impossible angle"):
        read_observations_text(text)
