"""TOML and JSON that was made to harm is refused at once, as a syntax error with its place, in every file."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from time import process_time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.fakes.faults import read_faults
from drivers.fakes.recording import read_dialogue
from mountnav.errors import BadRequest, BadSettings, MountnavError
from mountnav.night.recording import read_recording
from mountnav.parsing import json_of, repeated, toml_of
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.observation import read_observations
from mountnav.settings.observatory import Settings
from mountnav.simulation.machine_file import MachineFile
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.simulation.sky_script import SkyScript

BAD_TOML = {
    "brackets": "a = 1\nb = " + "[" * 100_000,
    "closed": "a = 1\nb = " + "[" * 100_000 + "]" * 100_000,
    "tables": "a = " + "{a = " * 20_000 + "1" + "}" * 20_000,
    "dots": "a = 1\n" + ".".join("a" * 20_000) + " = 1",
    "spaced dots": " . ".join("a" * 20_000) + " = 1",
    "quoted dots": ".".join(['"a"', "'b'"] * 10_000) + " = 1",
    "header": "[" + ".".join("a" * 20_000) + "]",
    "digits": "a = 1\nb = " + "1" * 5000,
    "parted digits": "a = " + "1_" * 5000 + "1",
    "long": "# " + "x" * 1_000_001,
    "beyond floats": "a = 1\nb = [{c = " + "1" * 400 + "}]",
    "beyond floats, in sixteens": "a = 0x" + "f" * 400,
}
BAD_JSON: dict[str, str | bytes] = {
    "brackets": '{"a": ' + "[" * 100_000,
    "closed": '{"a": ' + "[" * 100_000 + "]" * 100_000 + "}",
    "objects": '{"a": ' * 100_000 + "1" + "}" * 100_000,
    "digits": '{"a": ' + "1" * 5000 + "}",
    "beyond floats": '{"a": [-' + "1" * 400 + "]}",
    "text": "\x00",
    "surrogate": b'{"a": "\xff"}',
}


@pytest.mark.parametrize("text", BAD_TOML.values(), ids=BAD_TOML)
def test_toml_is_refused_at_once(text: str) -> None:
    began = process_time()
    with pytest.raises(tomllib.TOMLDecodeError, match=r"at line \d+, column \d+|at end of document"):
        toml_of(text)
    assert process_time() - began < 5.0  # 22 s and more without a bound


def test_the_place_is_told() -> None:
    with pytest.raises(tomllib.TOMLDecodeError, match=r"Number with too many digits \(at line 2, column 5\)"):
        toml_of(BAD_TOML["digits"])
    with pytest.raises(
        tomllib.TOMLDecodeError, match=r"Dotted key of more than 32 parts \(at line 2, column 1\)"
    ):
        toml_of(BAD_TOML["dots"])
    with pytest.raises(tomllib.TOMLDecodeError, match=r"Nested too deep \(at line 2, column \d+\)"):
        toml_of(BAD_TOML["brackets"])
    with pytest.raises(
        tomllib.TOMLDecodeError, match=r"Number with too many digits \(at line 2, column 11\)"
    ):
        toml_of(BAD_TOML["beyond floats"])
    with pytest.raises(json.JSONDecodeError, match=r"Number with too many digits: line 1 column 9"):
        json_of(BAD_JSON["beyond floats"])
    with pytest.raises(json.JSONDecodeError, match=r"Nested too deep: line 1"):
        json_of(BAD_JSON["closed"])


@pytest.mark.parametrize("text", BAD_JSON.values(), ids=BAD_JSON)
def test_json_is_refused_at_once(text: str | bytes) -> None:
    with pytest.raises(json.JSONDecodeError):
        json_of(text)


@given(st.text(max_size=300))
def test_whatever_else_is_as_the_library_says(text: str) -> None:
    for ours, theirs, fault in (
        (toml_of, tomllib.loads, tomllib.TOMLDecodeError),
        (json_of, json.loads, json.JSONDecodeError),
    ):
        try:
            expected = repr(theirs(text))
        except (ValueError, RecursionError):
            with pytest.raises(fault):
                ours(text)
        else:
            assert repr(ours(text)) == expected


@pytest.mark.long
def test_long_strings_and_many_keys_are_no_fault() -> None:
    text = (
        "a.b.c.d = 1\n"
        + 'e = "'
        + "x" * 100_000
        + '"\nf = "1.2.3.4"\n'
        + "".join(f"g{i} = {i}\n" for i in range(3000))
    )
    assert toml_of(text)["g2999"] == 2999


@given(st.integers())
def test_whole_numbers_of_64_bits_are_kept_and_larger_ones_refused(number: int) -> None:
    if abs(number) <= 2**64:
        assert toml_of(f"a = {number}") == json_of(f'{{"a": {number}}}') == {"a": number}
    else:
        with pytest.raises(tomllib.TOMLDecodeError):
            toml_of(f"a = {number}")
        with pytest.raises(json.JSONDecodeError):
            json_of(f'{{"a": {number}}}')


@given(st.lists(st.integers(0, 9)))
def test_what_stands_there_twice_is_found(names: list[int]) -> None:
    assert repeated(names) == sorted({one for one in names if names.count(one) > 1}, key=names.index)


class _Counted:
    """A name that counts how often names are compared: all share one hash only when they are equal."""

    compared = 0

    def __init__(self, name: int) -> None:
        self.name = name

    def __hash__(self) -> int:
        return hash(self.name)

    def __eq__(self, other: object) -> bool:
        _Counted.compared += 1
        return isinstance(other, _Counted) and self.name == other.name


def test_twenty_five_thousand_names_are_compared_a_few_times_each() -> None:
    _Counted.compared = 0
    names = [_Counted(number) for number in (*range(25_000), 24_999)]
    assert [one.name for one in repeated(names)] == [24_999]
    assert _Counted.compared < 4 * len(names)  # 625,000,000 when each is counted in the whole list


TOML_READERS = [
    Settings.load,
    Settings.load_solving,
    PointingErrors.from_toml,
    SkyScript.from_toml,
    MachineFile.from_toml,
    read_faults,
]
JSON_READERS = [PointingModel.load, read_observations, read_recording, read_dialogue]


@pytest.mark.long
@pytest.mark.parametrize("read", TOML_READERS, ids=lambda one: getattr(one, "__qualname__", str(one)))
@pytest.mark.parametrize("text", BAD_TOML.values(), ids=BAD_TOML)
def test_every_toml_file_gives_our_own_error(read: object, text: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(BadSettings, match=r"bad\.toml") as told:
        read(path)  # type: ignore[operator]
    assert len(str(told.value)) < 500


@pytest.mark.long
@pytest.mark.parametrize("read", JSON_READERS, ids=lambda one: getattr(one, "__qualname__", str(one)))
@pytest.mark.parametrize("name", ["brackets", "closed", "objects", "digits", "beyond floats"])
def test_every_json_file_gives_our_own_error(read: object, name: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.json"
    path.write_bytes(str(BAD_JSON[name]).encode() + b"\n{}\n")
    with pytest.raises((BadRequest, BadSettings), match=r"bad\.json") as told:
        read(path)  # type: ignore[operator]
    assert isinstance(told.value, MountnavError)
    assert len(str(told.value)) < 500
