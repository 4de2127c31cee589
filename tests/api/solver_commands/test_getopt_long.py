"""Arguments are parted as by the C library, with Python's own retelling of it as judge."""

from __future__ import annotations

import getopt

import pytest
from hypothesis import given
from hypothesis import strategies as st

from api.solver_commands.getopt_long import Option, UnknownOption, parted
from api.solver_commands.solve_field_options import OPTIONS

TABLE = (
    Option("overwrite", "O"),
    Option("out", "o", "needed"),
    Option("no-plots", "p"),
    Option("no-verify", ""),
    Option("scale-low", "L", "needed"),
)
WORDS = st.sampled_from(
    ["-O", "-p", "-Op", "-o", "-ox", "-pox", "-OL3", "--out", "--out=a=b", "--overwrite", "--over", "--no",
     "--no-p", "--no-verify", "--sc=5", "--s", "-", "--", "file.fits", "-x", "--bogus", "--over=1", "a b",
     "--o"]
)  # fmt: skip


@given(st.lists(WORDS, max_size=7))
def test_as_pythons_getopt_parts_them(arguments: list[str]) -> None:
    short = "".join(one.letter + (":" if one.value == "needed" else "") for one in TABLE if one.letter)
    long = [one.name + ("=" if one.value == "needed" else "") for one in TABLE]
    letters = {f"-{one.letter}": one.name for one in TABLE if one.letter}
    try:
        options, files = getopt.gnu_getopt(arguments, short, long)
    except getopt.GetoptError:
        with pytest.raises(UnknownOption):
            parted(arguments, TABLE)
        return
    found = parted(arguments, TABLE)
    assert found.options == [(letters.get(name, name.lstrip("-")), value) for name, value in options]
    assert found.files == files


def test_an_option_without_its_value_and_one_with_too_much() -> None:
    for arguments in (["--out"], ["-o"], ["-O", "-p", "-L"]):
        with pytest.raises(UnknownOption, match="requires an argument"):
            parted(arguments, TABLE)
    with pytest.raises(UnknownOption, match="doesn't allow"):
        parted(["--overwrite=yes"], TABLE)
    with pytest.raises(UnknownOption, match="'--no-plots' '--no-verify'"):
        parted(["--no-"], TABLE)


def test_the_last_counts_and_values_may_look_like_options() -> None:
    found = parted(["-L", "-5", "x", "--scale-low=2", "--", "-O"], TABLE)
    assert found.options == [("scale-low", "-5"), ("scale-low", "2")]
    assert found.last("scale-low") == "2"
    assert found.last("out") is None
    assert found.files == ["x", "-O"]
    assert not found.given("overwrite")


def test_no_name_and_no_letter_of_solve_field_comes_twice() -> None:
    names = [option.name for option in OPTIONS]
    letters = [option.letter for option in OPTIONS if option.letter]
    assert len(set(names)) == len(names)
    assert len(set(letters)) == len(letters)
