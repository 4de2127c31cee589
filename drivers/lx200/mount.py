"""An LX200 mount: a `drivers.generic.mount.GenericMount` that speaks `drivers.lx200.language`."""

from __future__ import annotations

from collections.abc import Callable

from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.lx200.dialects import dialect_named
from drivers.lx200.language import Lx200Language
from drivers.wire.exchange import Patience
from drivers.wire.line import ByteLine, ControlLines, SerialLine
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.devices import Epoch
from mountnav.sky.coordinates import Site


def lx200_language(
    line: str | Callable[[WireLog], ByteLine],
    *,
    baud: int = 9600,
    control: ControlLines | None = None,
    patience: Patience | None = None,
    dialect: str | None = None,
    epoch: Epoch | None = None,
) -> Lx200Language:
    """Make the language alone, over a line that is not opened yet.

    Parameters
    ----------
    line : str or callable
        Address for a `SerialLine`, or a function that makes a `ByteLine` with the log given.
    baud : int
        Speed of a serial port.
    control : ControlLines, optional
        Of a serial port.
    patience : Patience, optional
        For one question.
    dialect : str, optional
        Instead of the one that the handshake shows.
    epoch : {"apparent", "icrs"}, optional
        Kind of coordinates; the dialect's by default.

    Raises
    ------
    BadSettings
        If there is no such dialect.
    """
    log = WireLog()
    opened: ByteLine = (
        SerialLine(line, baud=baud, log=log, control=control) if isinstance(line, str) else line(log)
    )
    spoken = None if dialect is None else dialect_named(dialect)
    return Lx200Language(Link(opened, patience or Patience(), log), spoken, epoch=epoch)


def lx200_mount(
    line: str | Callable[[WireLog], ByteLine],
    *,
    name: str | None = None,
    baud: int = 9600,
    patience: Patience | None = None,
    dialect: str | None = None,
    epoch: Epoch | None = None,
    timing: Timing | None = None,
    site: Site | None = None,
    set_clock: bool = False,
    set_site: bool = False,
    trust_on_connect: bool = True,
) -> GenericMount:
    """Make a mount; nothing is opened yet.

    Parameters
    ----------
    line, baud, patience, dialect, epoch
        As of `lx200_language`.
    name, timing, site, set_clock, set_site, trust_on_connect
        As of `GenericMount`.

    Raises
    ------
    BadSettings
        If there is no such dialect.
    """
    return GenericMount(
        lx200_language(line, baud=baud, patience=patience, dialect=dialect, epoch=epoch),
        name=name,
        timing=timing,
        site=site,
        set_clock=set_clock,
        set_site=set_site,
        trust_on_connect=trust_on_connect,
    )
