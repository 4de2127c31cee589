"""Options that are declared once: commands of a dataclass, and what is imported for help."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

import api
from api.cli.options import takes_options

SLOW = (
    *("numpy", "scipy", "astropy", "matplotlib", "PIL", "rich", "pydantic", "sqlalchemy", "serial"),
    *("httpx", "fastapi", "uvicorn", "asyncio", "mountnav.client", "mountnav.settings", "drivers"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    name: Annotated[str, typer.Argument(help="Of whom.")]
    times: Annotated[int, typer.Option(min=1, help="How often.")] = 1
    words: Annotated[list[str] | None, typer.Option("--word", help="What.")] = None


def wish(asked: Wishes) -> int:
    """Wish something, and end with how often."""
    typer.echo(f"{asked.name}: {asked.words}")
    return asked.times


@pytest.fixture
def app() -> typer.Typer:
    made = typer.Typer()
    made.command("wish")(takes_options(Wishes)(wish))
    return made


def test_the_fields_of_a_dataclass_are_the_options(app: typer.Typer) -> None:
    done = CliRunner().invoke(app, ["anna", "--times", "3", "--word", "a", "--word", "b"])
    assert (done.exit_code, done.output) == (3, "anna: ['a', 'b']\n")
    done = CliRunner().invoke(app, ["anna"])
    assert (done.exit_code, done.output) == (1, "anna: None\n")


@pytest.mark.parametrize("words", [[], ["anna", "--times", "0"], ["anna", "--wish", "x"]])
def test_bad_usage_of_such_a_command_exits_2(app: typer.Typer, words: list[str]) -> None:
    assert CliRunner().invoke(app, words).exit_code == 2


def test_the_help_of_such_a_command_is_the_docstring(app: typer.Typer) -> None:
    shown = CliRunner().invoke(app, ["--help"]).output
    assert "Wish something, and end with how often." in shown
    assert "How often." in shown


def test_all_commands_together_import_nothing_slow() -> None:
    """For `mountnav --help` all files of commands are imported."""
    code = "import json, sys, api.cli.app; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert [name for name in SLOW if name in json.loads(done.stdout)] == []


@pytest.mark.long
def test_nothing_but_the_entry_point_imports_the_commands() -> None:
    """What the service shares with a command stands in a room of its own."""
    root = Path(api.__file__).parents[1]
    importers = set()
    for room in ("api", "drivers", "mountnav"):
        for path in (root / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if any(name == "api.cli" or name.startswith("api.cli.") for name in names):
                    importers.add(path.relative_to(root))
    outside = {path for path in importers if path.parts[:2] != ("api", "cli")}
    assert outside == {Path("api/main.py")}
