"""An iOptron mount: its language over a line of its own, driven as all mounts are."""

from __future__ import annotations

from collections.abc import Callable

from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.ioptron.language import IoptronLanguage
from drivers.wire.exchange import Patience
from drivers.wire.line import ByteLine, ControlLines, SerialLine
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.devices import Epoch
from mountnav.sky.coordinates import Site

BAUD = 115_200
"""Of v3 mounts; hand controllers 8407 and 8408, and most v2 mounts, speak at 9600 [IOPTRON, INDI ieqpro]."""


def ioptron_language(
    line: str | Callable[[], ByteLine],
    *,
    baud: int = BAUD,
    control: ControlLines | None = None,
    epoch: Epoch = "apparent",
    dialect: str | None = None,
    patience: Patience | None = None,
) -> IoptronLanguage:
    """Make the language over a line of its own; nothing is opened yet.

    Parameters
    ----------
    line : str or callable
        Address for a `SerialLine`, or a function that makes a `ByteLine`.
    baud : int
        Speed of a serial port.
    control : ControlLines, optional
        Of a serial port.
    epoch : {"apparent", "icrs"}
        Kind of coordinates it is taken to speak.
    dialect : {"v2", "v3"}, optional
        Its command set; found out by default.
    patience : Patience, optional
        For one question.
    """
    log = WireLog()
    made = SerialLine(line, baud=baud, log=log, control=control) if isinstance(line, str) else line()
    return IoptronLanguage(Link(made, patience or Patience(), log), epoch=epoch, dialect=dialect)


def ioptron_mount(
    line: str | Callable[[], ByteLine],
    *,
    name: str | None = None,
    baud: int = BAUD,
    epoch: Epoch = "apparent",
    dialect: str | None = None,
    patience: Patience | None = None,
    timing: Timing | None = None,
    site: Site | None = None,
) -> GenericMount:
    """Make the mount; nothing is opened yet.

    Parameters
    ----------
    line, baud, epoch, dialect, patience
        As of `ioptron_language`.
    name : str, optional
        For messages; the address by default.
    timing : Timing, optional
    site : Site, optional
        Ours, to compare with the mount's.
    """
    language = ioptron_language(line, baud=baud, epoch=epoch, dialect=dialect, patience=patience)
    return GenericMount(language, name=name, timing=timing, site=site)
