"""`mountnav wire`: watches what goes over a mount's line, of a running service or of a line of its own."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer

from api.cli.options import LOCAL_SERVICE, Service, Token, json_option
from api.cli.output import answering, refusing_os_errors
from mountnav.errors import BadRequest

POLL_S = 0.25
"""Between two looks into a log that is followed. chosen: a person sees no delay, and a service answers four
short requests a second; twice as long and the lines come in jerks."""
_ARROWS = {"driver->mount": "->", "mount->driver": "<-", "event": "--"}


def wire(
    what: Annotated[str, typer.Argument(help="Id of a telescope of a running service, or a mount's URL.")],
    service: Service = LOCAL_SERVICE,
    token: Token = None,
    follow: Annotated[
        bool, typer.Option("--follow/--no-follow", help="Go on until interrupted, or show what there is.")
    ] = True,
    as_json: Annotated[bool, json_option("JSON lines, as recorded dialogues are kept.")] = False,
    dump: Annotated[Path | None, typer.Option(help="Write the JSON lines here as well.")] = None,
) -> None:
    """Watch what goes over a mount's line."""
    import asyncio

    is_url = "://" in what
    if is_url:
        from drivers.registry import read_url

        read_url(what)  # a wrong one is refused before a file is begun for it
    with ExitStack() as stack:
        kept: TextIO | None = None
        if dump is not None:
            with refusing_os_errors(f"{dump} can't be written"):
                kept = stack.enter_context(dump.open("w", encoding="utf-8"))
        printer = _Printer(as_json=as_json, kept=kept)
        try:
            if is_url:
                asyncio.run(_print_own_line(what, printer, follow=follow))
            else:
                _print_log_of_service(what, printer, service=service, token=token, follow=follow)
        except KeyboardInterrupt:
            pass


class _Printer:
    """Prints the entries of a wire log, and writes them to a file if there is one."""

    def __init__(self, *, as_json: bool, kept: TextIO | None) -> None:
        self._as_json = as_json
        self._kept = kept
        self.last = 0
        """Number of the last entry, from which a log is read on."""

    def show(self, entry: dict[str, Any]) -> None:
        """Print one entry."""
        line = json.dumps(entry)
        if self._kept is not None:
            self._kept.write(f"{line}\n")
            self._kept.flush()
        self.last = max(self.last, int(entry.get("n", 0)))
        print(line if self._as_json else _plain(entry), flush=True)


def _plain(entry: dict[str, Any]) -> str:
    """An entry for people: seconds, direction, what was said and what it means."""
    if entry.get("dir") == "header":
        return "  ".join(f"{key} {value}" for key, value in entry.items() if key not in ("t", "dir"))
    said = _readable(bytes.fromhex(entry.get("hex", "")))
    words = "  ".join(part for part in (said, entry.get("meaning", "")) if part)
    return f"{entry['t']:10.3f} {_ARROWS.get(entry['dir'], '  ')} {words}"


def _readable(data: bytes) -> str:
    """Bytes as text where they are printable ASCII, else in hexadecimal."""
    return "".join(chr(byte) if 0x20 <= byte < 0x7F else f"\\x{byte:02x}" for byte in data)


def _print_log_of_service(
    telescope: str, printer: _Printer, *, service: str, token: str | None, follow: bool
) -> None:
    from mountnav.client import Client

    with answering(service), Client(service, token=token) as client:
        while True:
            for entry in client.wire(telescope, after=printer.last):
                printer.show(entry)
            if not follow:
                return
            time.sleep(POLL_S)


async def _print_own_line(url: str, printer: _Printer, *, follow: bool) -> None:
    """Open the mount, which moves nothing, and show what is said; without `follow` the greeting alone."""
    import asyncio

    from drivers.registry import open_mount
    from drivers.wire.wire_log import WireLog
    from mountnav.parsing import json_of

    mount = open_mount(url)
    log = getattr(mount, "wire_log", None)
    if not isinstance(log, WireLog):
        raise BadRequest("its driver keeps no wire log", device=url)

    def show() -> None:
        for line in log.lines({"mount": url} if printer.last == 0 else None, printer.last):
            printer.show(json_of(line))

    try:
        try:
            await mount.open()
        finally:
            show()
        while follow:
            await asyncio.sleep(POLL_S)
            show()
    finally:
        await mount.close()
