"""Print the manual page of `mountnav`, made of its commands' own help.

Run: python tools/man_page.py > mountnav.1
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

from typer.main import get_command

from api.cli.app import app
from mountnav import __version__


def _escaped(text: str) -> str:
    """Text as roff takes it: no line begins with a dot or a quote, and dashes are dashes."""
    lines = text.replace("\\", "\\e").replace("-", "\\-").splitlines()
    return "\n".join(f"\\&{line}" if line.startswith((".", "'")) else line for line in lines)


def _commands(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The commands below one, each with its whole name."""
    for word, below in getattr(command, "commands", {}).items():
        if getattr(below, "commands", None):
            yield from _commands(below, f"{name} {word}")
        else:
            yield f"{name} {word}", below


def _page() -> Iterator[str]:
    top = get_command(app)
    today = datetime.now(UTC).strftime("%Y-%m-%d")
    yield f'.TH MOUNTNAV 1 "{today}" "mountnav {__version__}" "mountnav"'
    yield ".SH NAME"
    yield _escaped(f"mountnav - {(top.help or '').rstrip('.')}")
    yield ".SH SYNOPSIS"
    yield ".B mountnav\n.I COMMAND\n[\\fIOPTIONS\\fR] [\\fIARGUMENTS\\fR]"
    yield ".SH COMMANDS"
    for name, command in _commands(top, "mountnav"):
        yield f".SS {_escaped(name)}"
        yield _escaped(" ".join((command.help or "").split()))
        for parameter in command.params:
            if parameter.name == "help":
                continue
            is_option = parameter.param_type_name == "option"
            names = ", ".join(parameter.opts) if is_option else str(parameter.name).upper()
            yield ".TP"
            yield f"\\fB{_escaped(names)}\\fR"
            yield _escaped(" ".join((getattr(parameter, "help", None) or "").split())) or "\\&"
    yield ".SH FILES"
    yield ".TP\n/etc/mountnav/observatory.toml\nThe settings that the system service reads."
    yield ".SH EXIT STATUS"
    yield "0: done. 1: trouble. 2: wrong usage or settings. 130: interrupted."


if __name__ == "__main__":
    sys.stdout.write("\n".join(_page()) + "\n")
