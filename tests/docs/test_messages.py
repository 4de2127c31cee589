"""The list of messages has what users read, of each kind, and no more of the code than that."""

from __future__ import annotations

import ast
import importlib.util
import re
import sys
from types import ModuleType

import pytest

from tests.docs.walk import ROOT

_CODE = '''
"""A docstring that nobody but readers of the code sees."""

_LEAST = 3
"""Words about a constant."""


def read(path, count):
    """Read it."""
    _log.warning("the file %s is skipped: %s", path, count)
    raise BadFrame(f"only {count + 1} stars are there" + " in all", advice="expose longer, then try again")


@app.command("read")
def command(name: Annotated[str, typer.Option(help="Name of the file.")]):
    """Read a file and tell what is in it."""
    db.execute("SELECT name FROM stars")
    reason = "no star was found"
'''


@pytest.fixture(scope="module")
def messages() -> ModuleType:
    """The tool, which is no module of a package."""
    spec = importlib.util.spec_from_file_location("messages", ROOT / "tools" / "messages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["messages"] = module
    spec.loader.exec_module(module)
    return module


def test_each_kind_of_message_is_found_and_nothing_else(messages: ModuleType) -> None:
    found = messages._Reader("mountnav/any.py", ast.parse(_CODE), {"BadFrame"}).found
    assert [(one.kind, one.line, one.text) for one in found] == [
        ("log", 10, "the file %s is skipped: %s"),
        ("errors", 11, "only {count + 1} stars are there in all"),
        ("errors", 11, "expose longer, then try again"),
        ("cli", 15, "Read a file and tell what is in it."),
        ("cli", 15, "Name of the file."),
        ("texts", 18, "no star was found"),
    ]


def test_the_page_s_words_are_found(messages: ModuleType) -> None:
    found = messages.in_page()
    words = {one.text for one in found}
    assert len(found) > 200
    assert "Take control …" in words
    assert any(one.path.endswith("stop.js") and "NOT CERTAIN" in one.text for one in found)


def test_the_pages_that_messages_name_are_found_by_that_name(messages: ModuleType) -> None:
    named = {
        topic
        for one in messages.messages()
        for topic in re.findall(r"`?mountnav docs ([a-z][a-z-]{2,})`?", one.text)
    }
    assert len(named) > 5
    for topic in named:
        assert len(list((ROOT / "docs").rglob(f"{topic}.md"))) == 1, topic


def test_no_message_names_a_file_that_only_a_checkout_has(messages: ModuleType) -> None:
    named = [
        f"{one.path}:{one.line}" for one in messages.messages() if re.search(r"\bdocs/[a-z/-]+\.md", one.text)
    ]
    assert named == []
