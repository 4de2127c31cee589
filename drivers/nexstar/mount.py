"""A mount behind a hand control: NexStar's language, driven as all mounts are."""

from __future__ import annotations

from collections.abc import Callable

from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.nexstar.language import NexstarLanguage
from drivers.nexstar.parking import Horizon
from drivers.wire.exchange import Patience
from drivers.wire.line import ByteLine, ControlLines, SerialLine
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.devices import Epoch
from mountnav.sky.coordinates import Site


def patience_of(timeout_s: float) -> Patience:
    """Return the times of one question: two tries, since an answer may be held back for 3.5 s [NexStar]."""
    return Patience(deadline_s=timeout_s, try_s=0.45 * timeout_s)


def nexstar_language(
    line: str | Callable[[], ByteLine],
    *,
    baud: int = 9600,
    control: ControlLines | None = None,
    epoch: Epoch = "apparent",
    patience: Patience | None = None,
    park: Horizon | None = None,
) -> NexstarLanguage:
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
        Kind of coordinates: JNow for Celestron, J2000 for SynScan.
    patience : Patience, optional
        For one question.
    park : Horizon, optional
        Where it parks.
    """
    log = WireLog()
    made = SerialLine(line, baud=baud, log=log, control=control) if isinstance(line, str) else line()
    return NexstarLanguage(Link(made, patience or patience_of(8.0), log), epoch=epoch, park=park)


def nexstar_mount(
    line: str | Callable[[], ByteLine],
    *,
    name: str | None = None,
    baud: int = 9600,
    epoch: Epoch = "apparent",
    patience: Patience | None = None,
    park: Horizon | None = None,
    timing: Timing | None = None,
    site: Site | None = None,
) -> GenericMount:
    """Make the mount; nothing is opened yet.

    Parameters
    ----------
    line, baud, epoch, patience, park
        As of `nexstar_language`.
    name : str, optional
        For messages; the address by default.
    timing : Timing, optional
    site : Site, optional
        Ours, to compare with the mount's.
    """
    language = nexstar_language(line, baud=baud, epoch=epoch, patience=patience, park=park)
    return GenericMount(language, name=name, timing=timing, site=site)
