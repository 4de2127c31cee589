"""The options that stand in a mount's URL, read and checked the same for every family."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

from drivers.generic.timing import Timing
from drivers.generic.url_options import number_of, require_known, whole_of, yes_of
from drivers.wire.exchange import Patience
from drivers.wire.line import ControlLines
from mountnav.devices import Epoch
from mountnav.errors import BadSettings

if TYPE_CHECKING:
    from drivers.generic import DrivenMount
    from drivers.generic.language import Language
    from mountnav.sky.coordinates import Site

_TIMES = (
    "poll_s",
    "slew_timeout_s",
    "stall_s",
    "stop_timeout_s",
    "start_grace_s",
    "rest_s",
    "sync_wait_s",
    "late_s",
    "heartbeat_s",
    "silence_s",
    "lost_after_s",
    "backoff_s",
    "longest_backoff_s",
    "fastest_deg_s",
    "near_arcsec",
)
PORT_OPTIONS = ("baud", "dtr", "rts")
"""Of serial ports; without effect on what is no serial port, and without sense there but for ``baud``."""
LINE_OPTIONS = (*PORT_OPTIONS, "settle_s", "greeting_s")
"""Of all that is opened as a line of bytes."""
OPTIONS = (
    *LINE_OPTIONS,
    "timeout_s",
    "epoch",
    "dialect",
    "set_clock",
    "set_site",
    "trust_on_connect",
    "swap_sides",
    *_TIMES,
)
_MAY_BE_ZERO = ("heartbeat_s",)
_BAUDS = (300, 4_000_000)
"""Least and most bits a second: what serial ports and USB bridges do."""
_LONGEST_SETTLING_S = 120.0
"""s. A board starts in 10 s, an old hand box in 30; twice as long looks as if the service hung."""


@dataclass(frozen=True, slots=True)
class MountOptions:
    """What a URL says of a mount, or what its family does without it.

    Attributes
    ----------
    baud : int
        Speed of a serial port.
    timeout_s : float
        Deadline of one question with all its repetitions.
    epoch : {"apparent", "icrs"}
        Kind of coordinates.
    dialect : str or None
        Instead of what the handshake finds.
    timing : Timing
    set_clock, set_site : bool
        Whether connecting sets the mount's clock and site to ours.
    trust_on_connect : bool
        Whether its position counts at the first connecting, unless it shows that it was just switched on.
    swap_sides : bool or None
        It tells the other side of the pier than the one on which the tube hangs; None: nobody has looked.
    own : mapping of str to str
        Options of the family's own, not yet read.
    control : ControlLines
        Of a serial port.
    settle_s, greeting_s : float
        As of `Patience`.
    """

    baud: int
    timeout_s: float
    epoch: Epoch
    dialect: str | None
    timing: Timing
    set_clock: bool
    set_site: bool
    trust_on_connect: bool
    swap_sides: bool | None
    own: Mapping[str, str]
    control: ControlLines
    settle_s: float
    greeting_s: float

    @property
    def patience(self) -> Patience:
        """For one question: three tries within the deadline."""
        return self.patience_with(Patience(deadline_s=self.timeout_s, try_s=self.timeout_s / 3.0))

    def patience_with(self, patience: Patience) -> Patience:
        """The times of a family's question, with those of a greeting."""
        return replace(patience, settle_s=self.settle_s, greeting_s=self.greeting_s)

    def mount(self, language: Language, *, name: str | None, site: Site | None) -> DrivenMount:
        """Make the mount of a language, treated as these options say."""
        from drivers.generic import DrivenMount

        return DrivenMount(
            language,
            name=name,
            timing=self.timing,
            site=site,
            set_clock=self.set_clock,
            set_site=self.set_site,
            trust_on_connect=self.trust_on_connect,
            swap_sides=self.swap_sides,
        )


def read_options(
    options: Mapping[str, str],
    driver: str,
    *,
    baud: int,
    timeout_s: float,
    timing: Timing | None = None,
    epoch: Epoch = "apparent",
    dialects: Iterable[str] = (),
    own: Iterable[str] = (),
) -> MountOptions:
    """Read the options of a URL.

    Parameters
    ----------
    options : mapping of str to str
    driver : str
        For messages.
    baud, timeout_s, timing, epoch
        What the family has if the URL doesn't say.
    dialects : iterable of str
        What ``dialect`` may be; empty where there is none to choose.
    own : iterable of str
        Further options that the family reads itself, from `MountOptions.own`.

    Raises
    ------
    BadSettings
        If an option is unknown or its value makes no sense.
    """
    own, dialects = tuple(own), tuple(dialects)
    known = [one for one in OPTIONS if one != "dialect" or dialects] + list(own)
    require_known(options, known, driver)
    given_epoch = options.get("epoch", epoch)
    if given_epoch not in ("apparent", "icrs"):
        raise BadSettings(
            f"epoch={given_epoch} is no kind of coordinates", advice="apparent (JNow) or icrs (J2000)"
        )
    dialect = options.get("dialect")
    if dialect is not None and dialect not in dialects:
        raise BadSettings(f"{driver} has no dialect {dialect}", advice=f"known: {', '.join(dialects)}")
    timing = timing or Timing()
    times = {
        name: number_of(options, name, getattr(timing, name), may_be_zero=name in _MAY_BE_ZERO)
        for name in _TIMES
    }
    return MountOptions(
        baud=whole_of(options, "baud", baud, *_BAUDS),
        timeout_s=number_of(options, "timeout_s", timeout_s),
        epoch=cast("Epoch", given_epoch),
        dialect=dialect,
        timing=replace(timing, **times),
        set_clock=yes_of(options, "set_clock", default=False),
        set_site=yes_of(options, "set_site", default=False),
        trust_on_connect=yes_of(options, "trust_on_connect", default=True),
        swap_sides=yes_of(options, "swap_sides", default=False) if "swap_sides" in options else None,
        own={name: options[name] for name in own if name in options},
        control=ControlLines(
            dtr=yes_of(options, "dtr", default=True), rts=yes_of(options, "rts", default=True)
        ),
        settle_s=number_of(options, "settle_s", 0.0, may_be_zero=True, most=_LONGEST_SETTLING_S),
        greeting_s=number_of(options, "greeting_s", Patience().greeting_s, most=_LONGEST_SETTLING_S),
    )
