"""`mountnav wire`: watches what goes over a mount's line, of a running service or of a line of its own."""

from __future__ import annotations

import asyncio
import json
import time
from pathlib import Path
from typing import Any, TextIO

import httpx

from drivers.registry import read_url
from drivers.wire.wire_log import WireLog
from mountnav.client import Client
from mountnav.errors import BadRequest, DeviceMissing
from mountnav.parsing import json_of

_LOOK_S = 0.25
_ARROWS = {"driver->mount": "->", "mount->driver": "<-", "event": "--"}


def run(what: str, *, service: str, token: str | None, follow: bool, as_json: bool, dump: Path | None) -> int:
    """Print the wire log of a telescope of a service (`what` is its id) or of a mount (`what` is its URL).

    Raises
    ------
    DeviceError
        The mount can't be opened.
    BadRequest
        The service has no such telescope, or the file can't be written.
    DeviceMissing
        There is no service.
    """
    if "://" in what:
        # told before a file is begun for it
        read_url(what)
    try:
        out = None if dump is None else dump.open("w", encoding="utf-8")
    except OSError as cause:
        raise BadRequest(f"{dump} can't be written: {cause.strerror}") from cause
    shown = _Shown(as_json=as_json, dump=out)
    try:
        if "://" in what:
            asyncio.run(_own_line(what, shown, follow=follow))
        else:
            _of_service(what, shown, service=service, token=token, follow=follow)
    except KeyboardInterrupt:
        pass
    finally:
        if out is not None:
            out.close()
    return 0


class _Shown:
    """Prints messages, each once."""

    def __init__(self, *, as_json: bool, dump: TextIO | None) -> None:
        self._as_json = as_json
        self._dump = dump
        self.last = 0

    def show(self, entry: dict[str, Any]) -> None:
        """Print one message, and write it to the file."""
        line = json.dumps(entry)
        if self._dump is not None:
            self._dump.write(f"{line}\n")
            self._dump.flush()
        self.last = max(self.last, int(entry.get("n", 0)))
        print(line if self._as_json else _plain(entry), flush=True)


def _plain(entry: dict[str, Any]) -> str:
    if entry.get("dir") == "header":
        return "  ".join(f"{key} {value}" for key, value in entry.items() if key not in ("t", "dir"))
    said = _readable(bytes.fromhex(entry.get("hex", "")))
    words = "  ".join(part for part in (said, entry.get("meaning", "")) if part)
    return f"{entry['t']:10.3f} {_ARROWS.get(entry['dir'], '  ')} {words}"


def _readable(data: bytes) -> str:
    """Bytes as text where they are, else in hexadecimal."""
    return "".join(chr(byte) if 0x20 <= byte < 0x7F else f"\\x{byte:02x}" for byte in data)


def _of_service(what: str, shown: _Shown, *, service: str, token: str | None, follow: bool) -> None:
    with Client(service, token=token) as client:
        while True:
            try:
                entries = client.wire(what, after=shown.last)
            except httpx.HTTPError as cause:
                raise DeviceMissing(
                    f"no mountnav service answers: {cause}",
                    device=service,
                    advice="start it, or give --service",
                ) from cause
            for entry in entries:
                shown.show(entry)
            if not follow:
                return
            time.sleep(_LOOK_S)


async def _own_line(url: str, shown: _Shown, *, follow: bool) -> None:
    """Open the mount, which moves nothing, and show what is said; without `follow` the greeting alone."""
    from drivers.registry import open_mount

    mount = open_mount(url)
    log = getattr(mount, "wire_log", None)
    if not isinstance(log, WireLog):
        raise BadRequest("its driver keeps no wire log", device=url)

    def show() -> None:
        for line in log.lines({"mount": url} if shown.last == 0 else None, shown.last):
            shown.show(json_of(line))

    try:
        try:
            await mount.open()
        finally:
            show()
        while follow:
            await asyncio.sleep(_LOOK_S)
            show()
    finally:
        await mount.close()
