"""Arguments as the C library's `getopt_long` parts them: options of astrometry.net's commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

__all__ = ["Option", "Parted", "UnknownOption", "parted"]


class UnknownOption(Exception):
    """An unknown or ambiguous option, or one without its value; in the words of the C library.

    Attributes
    ----------
    option : str
        The argument.
    """

    def __init__(self, words: str, option: str) -> None:
        self.option = option
        super().__init__(words)


@dataclass(frozen=True, slots=True)
class Option:
    """One option.

    Attributes
    ----------
    name : str
        Long name, without dashes.
    letter : str
        Short name; empty for none.
    """

    name: str
    letter: str = ""
    value: Literal["none", "needed"] = "none"


@dataclass(frozen=True, slots=True)
class Parted:
    """Arguments, parted.

    Attributes
    ----------
    options : list of (str, str)
        Long name and value (empty where there is none), in the order in which they were given.
    files : list of str
        All that belongs to no option.
    """

    options: list[tuple[str, str]]
    files: list[str]

    def last(self, name: str) -> str | None:
        """The value that an option was given last, or None."""
        return next((value for one, value in reversed(self.options) if one == name), None)

    def given(self, name: str) -> bool:
        """Whether an option was given."""
        return any(one == name for one, _ in self.options)


def parted(arguments: Sequence[str], table: Sequence[Option]) -> Parted:
    """Part arguments: short options together or apart, long ones abbreviated, files anywhere, ``--``.

    Parameters
    ----------
    arguments : sequence of str
        Without the command's own name.

    Raises
    ------
    UnknownOption
    """
    letters = {option.letter: option for option in table if option.letter}
    found = Parted([], [])
    left = list(arguments)[::-1]
    while left:
        argument = left.pop()
        if argument == "--":
            found.files.extend(left[::-1])
            break
        if argument.startswith("--"):
            name, equals, value = argument[2:].partition("=")
            option = _long(name, table)
            if option.value == "none" and equals:
                raise UnknownOption(f"option '--{option.name}' doesn't allow an argument", argument)
            if option.value == "needed" and not equals:
                if not left:
                    raise UnknownOption(f"option '--{option.name}' requires an argument", argument)
                value = left.pop()
            found.options.append((option.name, value))
        elif argument.startswith("-") and argument != "-":
            _short(argument, left, letters, found)
        else:
            found.files.append(argument)
    return found


def _long(name: str, table: Sequence[Option]) -> Option:
    """The option of that name, or the only one that begins so."""
    for option in table:
        if option.name == name:
            return option
    begin = [option for option in table if option.name.startswith(name)]
    if not begin:
        raise UnknownOption(f"unrecognized option '--{name}'", name)
    if len(begin) > 1:
        possible = " ".join(f"'--{option.name}'" for option in begin)
        raise UnknownOption(f"option '--{name}' is ambiguous; possibilities: {possible}", name)
    return begin[0]


def _short(argument: str, left: list[str], letters: dict[str, Option], found: Parted) -> None:
    """Options of one letter each; the first that needs a value takes the rest, or the next argument."""
    for at, letter in enumerate(argument[1:], start=2):
        option = letters.get(letter)
        if option is None:
            raise UnknownOption(f"invalid option -- '{letter}'", argument)
        if option.value == "none":
            found.options.append((option.name, ""))
            continue
        value = argument[at:]
        if not value:
            if not left:
                raise UnknownOption(f"option requires an argument -- '{letter}'", argument)
            value = left.pop()
        found.options.append((option.name, value))
        return
