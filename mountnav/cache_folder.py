"""Where mountnav keeps what it can make or fetch again: one rule for the whole house."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """$MOUNTNAV_CACHE, else $XDG_CACHE_HOME/mountnav, else ~/.cache/mountnav; it may not exist yet."""
    if own := os.environ.get("MOUNTNAV_CACHE"):
        return Path(own)
    if shared := os.environ.get("XDG_CACHE_HOME"):
        return Path(shared) / "mountnav"
    return Path.home() / ".cache" / "mountnav"
