"""Where the journal lies if nobody says: with the user's state, as the platform has it."""

from __future__ import annotations

import os
from pathlib import Path


def state_folder() -> Path:
    """$XDG_STATE_HOME/mountnav, else ~/.local/state/mountnav; it may not exist yet."""
    if shared := os.environ.get("XDG_STATE_HOME"):
        return Path(shared) / "mountnav"
    return Path.home() / ".local" / "state" / "mountnav"


def default_url() -> str:
    """$MOUNTNAV_JOURNAL (a path or a URL), else ``journal.sqlite`` in the folder of the user's state."""
    return os.environ.get("MOUNTNAV_JOURNAL") or str(state_folder() / "journal.sqlite")
