"""The options that stand in a mount's URL, read and checked the same for every family."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

from drivers.exchange import Patience
from drivers.timing import Timing
from drivers.url_options import number_of, yes_of
from mountnav.errors import BadSettings
from mountnav.navigation.devices import Epoch

if TYPE_CHECKING:
    from drivers.driven import DrivenMount
    from drivers.language import Language
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
OPTIONS = ("baud", "timeout_s", "epoch", "dialect", "set_clock", "set_site", "trust_on_connect", *_TIMES)
_MAY_BE_ZERO = ("heartbeat_s",)


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
    own : mapping of str to str
        Options of the family's own, not yet read.
    """

    baud: int
    timeout_s: float
    epoch: Epoch
    dialect: str | None
    timing: Timing
    set_clock: bool
    set_site: bool
    trust_on_connect: bool
    own: Mapping[str, str]

    @property
    def patience(self) -> Patience:
        """For one question: three tries within the deadline."""
        return Patience(deadline_s=self.timeout_s, try_s=self.timeout_s / 3.0)

    def mount(self, language: Language, *, name: str | None, site: Site | None) -> DrivenMount:
        """Make the mount of a language, treated as these options say."""
        from drivers.driven import DrivenMount

        return DrivenMount(
            language,
            name=name,
            timing=self.timing,
            site=site,
            set_clock=self.set_clock,
            set_site=self.set_site,
            trust_on_connect=self.trust_on_connect,
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
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise BadSettings(
            f"unknown option {', '.join(unknown)} for {driver}", advice=f"known: {', '.join(known)}"
        )
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
        baud=round(number_of(options, "baud", float(baud))),
        timeout_s=number_of(options, "timeout_s", timeout_s),
        epoch=cast("Epoch", given_epoch),
        dialect=dialect,
        timing=replace(timing, **times),
        set_clock=yes_of(options, "set_clock", default=False),
        set_site=yes_of(options, "set_site", default=False),
        trust_on_connect=yes_of(options, "trust_on_connect", default=True),
        own={name: options[name] for name in own if name in options},
    )
