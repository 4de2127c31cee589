"""Each command that the docs show is one: its subcommand, its options and its arguments are there."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer.main

from api.cli.app import app
from tests.docs.walk import ROOT

PAGES = [
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if "decisions" not in page.parts),
    *(ROOT / one for one in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
]
_FENCED = re.compile(r"^```(?:sh|text|console)?[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"^ {4}(.+)$", re.MULTILINE)
_TICKED = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
_COMMAND = re.compile(r"(?:^|[\s;&|(/])mountnav ((?!\d)[^\n]*)")
_ENDS = {"|", "||", "&&", ";", "&", ">", ">>", "2>", "<", "#", "(", ")", "->"}


@cache
def _root() -> Any:
    return typer.main.get_command(app)


def commands_of(text: str) -> Iterator[tuple[int, str]]:
    """Line and words of each command of ours that a page shows."""
    for pattern in (_FENCED, _INDENTED, _TICKED):
        for match in pattern.finditer(text):
            first = text[: match.start(1)].count("\n") + 1
            whole = re.sub(r"\\\n\s*", " ", match[1])
            for offset, line in enumerate(whole.split("\n")):
                found = _COMMAND.search(line.split(" # ")[0])
                # prose, tables and answers speak of mountnav too
                if found and re.match(r"[a-z-]+(\s|$)", found[1]) and line.strip().startswith(STARTS):
                    yield first + offset, found[1]


STARTS = (
    "mountnav",
    "$ mountnav",
    "sudo mountnav",
    "~/",
    "find ",
    ".venv/bin/mountnav",
    "/opt/",
    "echo",
    "[",
)
"""How a line begins that shows a command."""


def wrong_with(words: str) -> str:
    """What is wrong with a command: "" if nothing is."""
    try:
        parts = shlex.split(words, comments=True)
    except ValueError:
        return ""  # a quotation that goes on in the next line
    command = _root()
    options: list[str] = []
    while parts:
        part = parts.pop(0)
        if part in _ENDS or part.startswith((">", "2>", "|", ";", "<(")):
            break
        part = part.strip("[]").rstrip(";,")
        if part.startswith("-") and len(part) > 1 and not re.fullmatch(r"-[\d.]+.*", part):
            options.append(part.split("=")[0])
        elif hasattr(command, "commands") and not options:
            step = command.commands.get(part)
            if step is None:
                return "" if part.isupper() or not part.isascii() else f"no command {part!r}"
            command = step
    known = {name for one in command.params for name in (*one.opts, *one.secondary_opts)} | {"--help"}
    if command is _root():
        known |= {"--version", "--install-completion", "--show-completion"}
    for option in options:
        short = re.fullmatch(r"-[a-zA-Z]", option)
        if option not in known and (short or option.startswith("--")):
            return f"{command.name} has no {option}"
    return ""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_each_command_is_there(page: Path) -> None:
    wrong = [
        f"{line}: mountnav {words}: {what}"
        for line, words in commands_of(page.read_text(encoding="utf-8"))
        if (what := wrong_with(words))
    ]
    assert wrong == []


def test_commands_are_found_at_all() -> None:
    shown = [words for page in PAGES for _, words in commands_of(page.read_text(encoding="utf-8"))]
    assert len(shown) > 300


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ("solve frames --jobs 0", ""),
        ("solve frames --jbos 0", "solve has no --jbos"),
        ("model fti a.dat", "no command 'fti'"),
        ("key new east --role operate", ""),
        ("center M31 -z", "center has no -z"),
    ],
)
def test_a_wrong_one_is_named(words: str, what: str) -> None:
    assert wrong_with(words) == what
