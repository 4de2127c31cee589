"""An LX200 mount from its URL's options."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

from drivers.exchange import Patience
from drivers.lx200.habits import Lx200Habits
from drivers.lx200.mount import Lx200Mount
from mountnav.errors import BadSettings
from mountnav.navigation.devices import Epoch

if TYPE_CHECKING:
    from drivers.registry import MountUrl

_OPTIONS = ("baud", "timeout_s", "epoch", "poll_s", "slew_timeout_s")


def mount_from(url: MountUrl, name: str | None) -> Lx200Mount:
    """Make the mount; nothing is opened yet.

    Raises
    ------
    BadSettings
        If an option is unknown or its value makes no sense.
    """
    unknown = sorted(set(url.options) - set(_OPTIONS))
    if unknown:
        raise BadSettings(
            f"unknown option {', '.join(unknown)} for lx200", advice=f"known: {', '.join(_OPTIONS)}"
        )
    epoch = url.options.get("epoch", "apparent")
    if epoch not in ("apparent", "icrs"):
        raise BadSettings(
            f"epoch={epoch} is no kind of coordinates", advice="apparent (JNow) or icrs (J2000)"
        )
    deadline_s = _number(url.options, "timeout_s", 5.0)
    habits = Lx200Habits(
        epoch=cast("Epoch", epoch),
        patience=Patience(deadline_s=deadline_s, try_s=deadline_s / 3.0),
        poll_s=_number(url.options, "poll_s", 0.5),
        slew_timeout_s=_number(url.options, "slew_timeout_s", 300.0),
    )
    return Lx200Mount(url.line, name=name, baud=round(_number(url.options, "baud", 9600.0)), habits=habits)


def _number(options: Mapping[str, str], option: str, default: float) -> float:
    text = options.get(option)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0):
        raise BadSettings(f"{option}={text} makes no sense", advice="a number above 0")
    return value
