"""The serial ports of this machine: stable names, makers, who holds them, and what answers there.

Probing asks each family's harmless greeting at its usual speeds; nothing that moves, syncs or sets. It still
opens the port, and some boards reset when their port is opened. A port that another program holds is not
opened.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from serial.tools import list_ports

from drivers.wire.line import SerialLine
from mountnav.errors import DeviceError, DeviceMissing

_STABLE = Path("/dev/serial/by-id")
"""Where udev keeps names that stay the same when a device is plugged in again."""
_PROCESSES = Path("/proc")
"""Where Linux shows the open files of processes."""

PROBING = (
    "drivers.nexstar.family",
    "drivers.skywatcher.family",
    "drivers.lx200.family",
    "drivers.ioptron.family",
)
"""The modules that probe, in this order: each has ``BAUDS`` and ``async probe(line) -> str | None``.

Hand controls come first: they obey single letters, so that greetings of other families are orders to them
(the M of ``:MountInfo#`` cancels a goto, its I begins to set the clock).
"""


@dataclass(frozen=True, slots=True)
class Port:
    """A serial port.

    Attributes
    ----------
    device : str
        Its present name.
    names : tuple of str
        Names that stay the same when it is plugged in again.
    manufacturer, product, serial_number : str or None
        As far as the device reports them.
    held_by : tuple of str
        Programs that have it open, with their process ids; programs of other users may be missing.
    """

    device: str
    names: tuple[str, ...] = ()
    manufacturer: str | None = None
    product: str | None = None
    serial_number: str | None = None
    held_by: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Probed:
    """The result of probing a line.

    Attributes
    ----------
    family : str
        As in a mount's URL; empty if no known mount answered.
    baud : int or None
        Speed; None on TCP.
    answer : str
        What the mount calls itself, or why it was not asked.
    """

    address: str
    family: str
    baud: int | None
    answer: str


def serial_ports() -> list[Port]:
    """List this machine's serial ports."""
    stable = _stable_names()
    return [
        Port(
            found.device,
            tuple(stable.get(os.path.realpath(found.device), ())),
            found.manufacturer,
            found.product,
            found.serial_number,
            holders(found.device),
        )
        for found in sorted(list_ports.comports(), key=lambda found: str(found.device))
    ]


def _stable_names() -> dict[str, list[str]]:
    names: dict[str, list[str]] = {}
    for entry in sorted(_STABLE.glob("*")):
        names.setdefault(os.path.realpath(entry), []).append(str(entry))
    return names


def holders(device: str) -> tuple[str, ...]:
    """Programs other than this one that have a device open, as far as the system shows them."""
    target = os.path.realpath(device)
    found = []
    for process in _PROCESSES.glob("[0-9]*"):
        if int(process.name) == os.getpid():
            continue
        try:
            opened = {os.path.realpath(entry) for entry in (process / "fd").iterdir()}
            # the process with a pseudo-terminal's master is the other end of the line: a fake mount
            held = target in opened and not (target.startswith("/dev/pts/") and "/dev/ptmx" in opened)
            name = (process / "comm").read_text(encoding="utf-8", errors="replace").strip() if held else ""
        except OSError:
            # the process has ended, or is another user's
            continue
        if held:
            found.append(f"{name} ({process.name})")
    return tuple(sorted(found))


async def probe(address: str, modules: Iterable[str] = PROBING) -> Probed:
    """Ask on a line which mount is there.

    Parameters
    ----------
    address : str
        Device path or ``socket://host:port``.
    modules : iterable of str
        As `PROBING` describes.
    """
    held_by = () if "://" in address else holders(address)
    if held_by:
        return Probed(address, "", None, f"not asked: held by {', '.join(held_by)}")
    for dotted in modules:
        module = _probing(dotted)
        if module is None:
            continue
        for baud in (None,) if "://" in address else module.BAUDS:
            try:
                answer = await _asked(address, baud, module)
            except DeviceMissing as missing:
                return Probed(address, "", baud, missing.what)
            if answer is not None:
                return Probed(address, dotted.split(".")[1], baud, answer)
    return Probed(address, "", None, "nothing that is known here answers")


def _probing(dotted: str) -> ModuleType | None:
    try:
        return importlib.import_module(dotted)
    except ModuleNotFoundError as cause:
        if cause.name is not None and dotted.startswith(cause.name):
            return None
        raise


async def _asked(address: str, baud: int | None, module: ModuleType) -> str | None:
    line = SerialLine(address) if baud is None else SerialLine(address, baud=baud)
    await line.open()
    try:
        answer: str | None = await module.probe(line)
    except DeviceMissing:
        raise
    except DeviceError:
        return None
    finally:
        await line.close()
    return answer
