"""What real drivers and mounts said to each other, as it was recorded."""

from __future__ import annotations

import json
from pathlib import Path


def dialogue(path: Path) -> list[tuple[float, bytes, bytes]]:
    """Each command with its time and all that was answered to it."""
    pairs: list[tuple[float, bytes, bytes]] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        entry = json.loads(line)
        if entry["dir"] == "driver->mount":
            pairs.append((entry["t"], bytes.fromhex(entry["hex"]), b""))
        elif entry["dir"] == "mount->driver":
            t_s, command, reply = pairs[-1]
            pairs[-1] = (t_s, command, reply + bytes.fromhex(entry["hex"]))
    return pairs
