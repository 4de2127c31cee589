"""The whole command line, with all commands: for completions, the manual page, and tests."""

from __future__ import annotations

from api.cli.commands import app_of

app = app_of(())
