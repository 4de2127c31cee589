"""The serial ports of this machine: stable names, makers, who holds them, and what answers there.

Probing asks each family's harmless greeting at its usual speeds; nothing that moves, syncs or sets. It still
opens the port, and some boards start again when theirs is opened. A port that another program holds is left
alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports

from drivers.family import Family, Probe
from drivers.registry import families
from drivers.wire.exchange import Exchange, Patience
from drivers.wire.line import SerialLine
from mountnav.errors import DeviceError, DeviceMissing

_STABLE = Path("/dev/serial/by-id")
"""Where udev keeps names that stay the same when a device is plugged in again."""
_PROCESSES = Path("/proc")
"""Where Linux shows the open files of processes."""

_QUIET_S = 0.1
"""A line that has been silent for so long is asked; chosen: a few bytes at 9600 baud, twice."""


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
        As far as it tells.
    held_by : tuple of str
        Programs that have it open, with their process ids; of those of other users we may not know.
    """

    device: str
    names: tuple[str, ...] = ()
    manufacturer: str | None = None
    product: str | None = None
    serial_number: str | None = None
    held_by: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Probed:
    """What a line answered.

    Attributes
    ----------
    family : str
        As in a mount's URL; empty if nothing known answered.
    baud : int or None
        At which speed; None on TCP.
    answer : str
        What it calls itself, or why it was not asked.
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
    """Programs other than this one that have a device open, as far as the system lets us see."""
    target = os.path.realpath(device)
    found = []
    for process in _PROCESSES.glob("[0-9]*"):
        if int(process.name) == os.getpid():
            continue
        try:
            opened = {os.path.realpath(entry) for entry in (process / "fd").iterdir()}
            # who holds a pseudo-terminal's master is the other end of the line: a fake mount
            held = target in opened and not (target.startswith("/dev/pts/") and "/dev/ptmx" in opened)
            name = (process / "comm").read_text(encoding="utf-8", errors="replace").strip() if held else ""
        except OSError:
            # it has ended, or is another user's
            continue
        if held:
            found.append(f"{name} ({process.name})")
    return tuple(sorted(found))


async def probe(address: str, asked: Iterable[Family] | None = None) -> Probed:
    """Ask on a line who is there.

    Parameters
    ----------
    address : str
        Device path or ``socket://host:port``.
    asked : iterable of Family, optional
        Whose probes are tried; of all our own families by default.
    """
    held_by = () if "://" in address else holders(address)
    if held_by:
        return Probed(address, "", None, f"not asked: held by {', '.join(held_by)}")
    for family, how in probes(asked):
        for baud in (None,) if "://" in address else how.bauds:
            try:
                answer = await _answer(address, baud, how)
            except DeviceMissing as missing:
                return Probed(address, "", baud, missing.what)
            if answer is not None:
                return Probed(address, family, baud, answer)
    return Probed(address, "", None, "nothing that is known here answers")


def probes(asked: Iterable[Family] | None = None) -> list[tuple[str, Probe]]:
    """List names and probes of families (all our own if None), in the order in which they must be asked."""
    found = [
        (family.name, family.probe)
        for family in (families() if asked is None else asked)
        if family.probe is not None
    ]
    return sorted(found, key=lambda named: named[1].turn)


async def _answer(address: str, baud: int | None, how: Probe) -> str | None:
    """What a family's questions are answered on a line, in words; None if nothing it understands."""
    line = SerialLine(address) if baud is None else SerialLine(address, baud=baud)
    await line.open()
    try:
        return await how.ask(Exchange(line, Patience(how.deadline_s, how.try_s, _QUIET_S)))
    except DeviceMissing:
        raise
    except DeviceError:
        return None
    finally:
        await line.close()
