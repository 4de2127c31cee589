"""The options in the URL of a mount, read and checked the same for every family; and the times they set."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from typing import TYPE_CHECKING, cast

from drivers.wire.exchange import Patience
from drivers.wire.line import ControlLines
from mountnav.devices import Epoch
from mountnav.errors import BadSettings

if TYPE_CHECKING:
    from drivers.generic.language import Language
    from drivers.generic.mount import GenericMount
    from drivers.wire.link import Link
    from mountnav.sky.coordinates import Site


_LARGEST = 1e9
"""The largest number that an option may be: 30 years in seconds. Chosen only to keep infinity and typing
errors out of timers; doubled or halved, nothing changes."""
_WORDS = {"yes": True, "true": True, "1": True, "no": False, "false": False, "0": False}


def require_known(options: Mapping[str, str], known: Iterable[str], what: str) -> None:
    """Raise `BadSettings` unless all options are known; `what` names the driver in the message."""
    known = tuple(known)
    unknown = sorted(set(options) - set(known))
    if unknown:
        near = [
            close[0] for option in unknown if (close := get_close_matches(option, known, n=1, cutoff=0.6))
        ]
        meant = f"did you mean {', '.join(near)}? " if near else ""
        raise BadSettings(
            f"unknown option {', '.join(unknown)} for {what}", advice=f"{meant}known: {', '.join(known)}"
        )


def whole_of(options: Mapping[str, str], option: str, default: int, least: int, most: int) -> int:
    """Read a whole number from `least` to `most`, or raise `BadSettings`; `default` where it isn't given."""
    text = options.get(option)
    if text is None:
        return default
    if not (text.isascii() and text.isdigit() and len(text) < 10 and least <= int(text) <= most):
        raise BadSettings(
            f"{option}={text} makes no sense",
            advice=f"a whole number from {least} to {most}, such as {default}",
        )
    return int(text)


def number_of(
    options: Mapping[str, str],
    option: str,
    default: float,
    *,
    may_be_zero: bool = False,
    most: float = _LARGEST,
) -> float:
    """Read a number above 0 (or 0, where that may be), or raise `BadSettings`; else `default`."""
    text = options.get(option)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not (0.0 < value <= most or (may_be_zero and value == 0.0)):
        advice = "a number above 0" if most == _LARGEST else f"a number above 0, at most {most:g}"
        raise BadSettings(f"{option}={text} makes no sense", advice=advice)
    return value


def maybe_number_of(options: Mapping[str, str], option: str) -> float | None:
    """As `number_of`; None where it isn't given."""
    return number_of(options, option, 1.0) if option in options else None


def yes_of(options: Mapping[str, str], option: str, *, default: bool) -> bool:
    """Read yes or no, or raise `BadSettings`; `default` where it isn't given."""
    text = options.get(option)
    if text is None:
        return default
    if text.lower() not in _WORDS:
        raise BadSettings(f"{option}={text} is neither yes nor no", advice="yes or no")
    return _WORDS[text.lower()]


_SOON_S = 0.2
"""Longest time (s) between two readings that wait for a sync, a refusal or a switch to show. Chosen by
hand: an operator waits, and `Timing.late_s` (1 s) is measured in these steps. Doubled, a sync may be called
late that was not."""


@dataclass(frozen=True, slots=True)
class Timing:
    """How long one mount is waited for, and how far its readings are believed.

    Attributes
    ----------
    poll_s : float
        Between two readings of a mount that moves, and between two stops.
    slew_timeout_s : float
        A slew that runs longer is stopped and counts as stalled.
    stall_s : float
        A mount that reports a slew and doesn't move for so long is stopped and counts as stalled.
    stop_timeout_s : float
        After this time a stop counts as failed if the mount still moves.
    start_grace_s : float
        A mount that doesn't move within this time after an order has stalled.
    rest_s : float
        A mount that rests beside its place for so long has stalled; it may pause between two axes.
    sync_wait_s : float
        Within this time a sync must show in the readings.
    late_s : float
        A sync that shows later than this counts as late.
    heartbeat_s : float
        Between two readings of an idle mount; 0: none (a dead mount is then noticed by the next order only).
    silence_s : float
        A question unanswered for so long is announced as a silent link.
    lost_after_s : float
        A silence of so long counts as a lost link.
    backoff_s, longest_backoff_s : float
        Wait before the first and at most before any later attempt to connect again.
    fastest_deg_s : float
        No mount moves faster (direct drives reach 30).
    acceleration_deg_s2 : float
        Speed that it may gain between two readings (per second of the sky).
    resting_arcsec : float
        A reading of a resting mount that is further than this (and two steps of the wire) from the last one
        is doubted and asked again.
    drift_arcsec_s : float
        What a mount at rest may drift: a little more than the sky turns, for tracking switched off.
    near_arcsec : float
        A slew has arrived when it rests so near to its place, or within two steps of the wire if more.
    """

    poll_s: float = 0.5
    slew_timeout_s: float = 300.0
    stall_s: float = 15.0
    stop_timeout_s: float = 20.0
    start_grace_s: float = 3.0
    rest_s: float = 1.5
    sync_wait_s: float = 3.0
    late_s: float = 1.0
    heartbeat_s: float = 0.5
    silence_s: float = 1.2
    lost_after_s: float = 6.0
    backoff_s: float = 0.5
    longest_backoff_s: float = 30.0
    fastest_deg_s: float = 40.0
    acceleration_deg_s2: float = 8.0
    resting_arcsec: float = 5.0
    drift_arcsec_s: float = 20.0
    near_arcsec: float = 30.0

    @property
    def soon_s(self) -> float:
        """Between two readings that wait for an order to show: `poll_s`, but no more than `_SOON_S`."""
        return min(_SOON_S, self.poll_s)

    def resting_free_arcsec(self, resolution_arcsec: float) -> float:
        """How far two readings of a resting mount may differ: `resting_arcsec` and two steps of the wire."""
        return self.resting_arcsec + 2.0 * resolution_arcsec


_MEASURED = ("acceleration_deg_s2", "resting_arcsec", "drift_arcsec_s")
"""Fields of `Timing` that a URL can't set: they say what mounts can do, not how patient an owner is."""
_TIMES = tuple(field.name for field in fields(Timing) if field.name not in _MEASURED)
"""Fields of `Timing` that a URL may set, under the same names."""

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
"""Options for which 0 means "off"."""
_BAUDS = (300, 4_000_000)
"""Least and most bits a second: what serial ports and USB bridges do."""
_LONGEST_SETTLING_S = 120.0
"""The longest settle_s and greeting_s, in seconds. A board starts in 10 s, an old hand control in 30;
doubled, a mistyped option looks as if the service hung."""


@dataclass(frozen=True, slots=True)
class MountOptions:
    """What a URL says about a mount, with the family's defaults where it says nothing.

    Attributes
    ----------
    baud : int
        Speed of a serial port.
    timeout_s : float
        Deadline of one question with all its repetitions.
    epoch : {"apparent", "icrs"}
        Kind of coordinates.
    dialect : str or None
        Used instead of what the handshake finds.
    set_clock, set_site : bool
        Whether connecting sets the mount's clock and site to ours.
    trust_on_connect : bool
        Whether its position is trusted at the first connecting, unless it shows that it was just switched on.
    swap_sides : bool or None
        Whether it reports the side of the pier opposite to the one on which the tube hangs; None: not
        checked.
    own : mapping of str to str
        The family's own options, not yet read.
    control : ControlLines
        DTR and RTS of a serial port.
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
        """The times of one question: three tries within the deadline."""
        return self.patience_with(Patience(deadline_s=self.timeout_s, try_s=self.timeout_s / 3.0))

    def patience_with(self, patience: Patience) -> Patience:
        """A family's own times of a question, with the settling and greeting times of this URL."""
        return replace(patience, settle_s=self.settle_s, greeting_s=self.greeting_s)

    def link(self, line: str, patience: Patience | None = None) -> Link:
        """Make the link to a URL's line, with these options; `patience`: the family's own."""
        from drivers.wire.link import link_to

        patience = self.patience if patience is None else self.patience_with(patience)
        return link_to(line, baud=self.baud, control=self.control, patience=patience)

    def mount(self, language: Language, *, name: str | None, site: Site | None) -> GenericMount:
        """Make the mount that speaks a language, with these options."""
        from drivers.generic.mount import GenericMount

        return GenericMount(
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
    driver : str
        For messages.
    baud, timeout_s, timing, epoch
        The family's defaults.
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
    known = [option for option in OPTIONS if option != "dialect" or dialects] + list(own)
    require_known(options, known, driver)
    given_epoch = options.get("epoch", epoch)
    if given_epoch not in ("apparent", "icrs"):
        raise BadSettings(
            f"epoch={given_epoch} is not a kind of coordinates", advice="apparent (JNow) or icrs (J2000)"
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
