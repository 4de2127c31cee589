"""Dialogues in files, as JSON lines: those of fakes are recorded, those of mounts become profiles."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.fakes.bench.thread import Fake, Troubled
from drivers.fakes.faults import LineOrder
from drivers.fakes.wire_fake import WireFake
from drivers.wire.wire_log import Way, WireEntry
from mountnav.errors import BadSettings
from mountnav.files import MOST_RECORD_BYTES, read_text
from mountnav.parsing import json_of

_PIECE_BYTES = 4096
"""Recorded bytes are cut into commands in pieces of this size: a line gives less at once. Doubled, cutting a
recording of large writes takes twice the time, since each cut copies what is left."""


class Recorder:
    """A fake whose dialogue is written to a file meanwhile; a context manager.

    Parameters
    ----------
    path : Path
        Is overwritten.
    header : mapping
        For the first line: what was recorded.
    monotonic : callable
        Gives seconds.

    Raises
    ------
    BadSettings
        If the file can't be written.
    """

    def __init__(
        self,
        fake: Fake,
        path: Path,
        header: Mapping[str, object],
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._fake = fake
        self._monotonic = monotonic
        self._began_s = monotonic()
        self._count = 0
        try:
            # line-buffered: lines are complete on the disk however the program ends
            self._file = path.open("w", encoding="utf-8", buffering=1)
        except OSError as cause:
            raise BadSettings(
                f"the recording can't be written: {cause.strerror}", device=str(path), advice="give another"
            ) from cause
        began = datetime.now(UTC).isoformat(timespec="seconds")
        self._file.write(json.dumps({"t": 0, "dir": "header", **header, "began": began}) + "\n")

    def feed(self, data: bytes) -> bytes:
        """Take bytes and return the fake's answer; both are recorded."""
        self._note("driver->mount", data)
        said = self._fake.feed(data)
        self._note("mount->driver", said)
        return said

    def due_in_s(self) -> float | None:
        """As of the fake."""
        return self._fake.due_in_s()

    def line_orders(self) -> list[LineOrder]:
        """As of the fake; they are recorded as well."""
        orders = self._fake.line_orders() if isinstance(self._fake, Troubled) else []
        for order in orders:
            self._note("event", b"", f"line: {order.kind}")
        return orders

    def wake_by(self, wake: Callable[[], None] | None) -> None:
        """As of the fake."""
        if isinstance(self._fake, Troubled):
            self._fake.wake_by(wake)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _note(self, way: Way, data: bytes, meaning: str = "") -> None:
        if data or way == "event":
            self._count += 1
            entry = WireEntry(self._count, self._monotonic() - self._began_s, way, data, meaning)
            self._file.write(entry.as_json() + "\n")


def read_dialogue(path: Path | str) -> list[tuple[bytes, bytes]]:
    """Read a recording as turns: what the driver sent at once, and all answers until it sent again.

    Raises
    ------
    BadSettings
        If it can't be read or is no recording; with the line.
    """
    try:
        lines = read_text(Path(path), MOST_RECORD_BYTES).splitlines()
    except (OSError, UnicodeDecodeError) as cause:
        raise BadSettings(f"the recording can't be read: {cause}", device=str(path)) from cause
    turns: list[tuple[bytes, bytearray]] = []
    for number, line in enumerate(lines, 1):
        try:
            entry = json_of(line)
            if entry["dir"] == "driver->mount":
                turns.append((bytes.fromhex(entry["hex"]), bytearray()))
            elif entry["dir"] == "mount->driver" and turns:
                turns[-1][1].extend(bytes.fromhex(entry["hex"]))
        except (ValueError, KeyError, TypeError) as cause:
            raise BadSettings(
                f"line {number} is not a line of a recording",
                device=str(path),
                advice='each is JSON with "t", "dir", and "hex" where bytes went',
            ) from cause
    return [(sent, bytes(answered)) for sent, answered in turns]


def profile_of(turns: list[tuple[bytes, bytes]], fake: WireFake) -> dict[bytes, bytes]:
    """The questions of a dialogue that were always answered alike, with their answers.

    Parameters
    ----------
    fake : WireFake
        A fake of the same protocol, which cuts bytes into commands.
    """
    answers: dict[bytes, set[bytes]] = {}
    waiting = b""
    for sent, answered in turns:
        commands: list[bytes] = []
        # in pieces, as a line gives them: each cut copies what is left
        for start in range(0, len(sent), _PIECE_BYTES):
            waiting += sent[start : start + _PIECE_BYTES]
            while True:
                command, waiting = fake.cut(waiting)
                if command is None:
                    break
                commands.append(command)
        if len(commands) == 1 and answered:
            answers.setdefault(commands[0], set()).add(answered)
        else:
            # which of them was answered is unknown
            for command in commands:
                answers.setdefault(command, set()).add(b"")
    return {
        command: heard.pop() for command, heard in answers.items() if len(heard) == 1 and b"" not in heard
    }
