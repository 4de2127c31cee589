"""What happens in a simulated night, as data: clouds, satellites, wrong solutions, reboots, cables.

::

    seed = 7                          # of all that is left to chance
    satellite_every = 10              # every tenth frame is crossed by one
    false_share = 0.01                # of the frames solved wrongly, with good odds; a third of them anywhere
    poor_share = 0.03                 # of the sky (cells of a degree) too poor for the usual exposure
    slow_share = 0.01                 # of the solves that run out of time
    stale_share = 0.005               # of the frames that are the one before, once more

    [[clouds]]
    from_min = 60
    to_min = 95
    thin = false                      # a thin one costs stars, and some of the frames
    [[incidents]]
    at_min = 200
    what = "reboot"                   # unplug, silence, reboot, block-ha, block-dec, sync-deaf
    for_s = 5
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, get_args

from mountnav.errors import BadSettings
from mountnav.files import read_text
from mountnav.parsing import toml_of

What = Literal["unplug", "silence", "reboot", "block-ha", "block-dec", "sync-deaf"]
_WHATS = get_args(What)
_SHARES = ("false_share", "poor_share", "slow_share", "stale_share")


@dataclass(frozen=True, slots=True)
class Cloud:
    """Cloud over the whole sky, in minutes since the script began."""

    from_min: float
    to_min: float
    thin: bool = False


@dataclass(frozen=True, slots=True)
class Incident:
    """What happens to the mount.

    Attributes
    ----------
    at_min : float
        Since the script began.
    what : str
        "unplug": the port is gone; "silence": nothing answers; "reboot": switched off and on, silent
        meanwhile; "block-ha", "block-dec": the axis stands; "sync-deaf": syncs are accepted and ignored.
    for_s : float
        How long.
    """

    at_min: float
    what: What
    for_s: float = 10.0


@dataclass(frozen=True, slots=True)
class SkyScript:
    """A night's events; what is left to chance is the same for the same seed.

    Attributes
    ----------
    satellite_every : int
        Every so many frames one has a satellite's trail across it; 0: none.
    false_share : float
        Of the frames that are solved wrongly, with good odds: at a place nearby, or anywhere, with a wrong
        rotation and a scale within the hint's bounds, as chance makes them.
    poor_share : float
        Of the sky that is too poor in stars for the usual exposure; a third of it for any.
    slow_share : float
        Of the solves that run out of time.
    stale_share : float
        Of the frames for which the camera hands out the one before.
    solve_s : float
        What a solve takes.

    Raises
    ------
    BadSettings
        When a value makes no sense.
    """

    seed: int = 0
    clouds: tuple[Cloud, ...] = ()
    incidents: tuple[Incident, ...] = ()
    satellite_every: int = 0
    false_share: float = 0.0
    poor_share: float = 0.0
    slow_share: float = 0.0
    stale_share: float = 0.0
    solve_s: float = 0.4

    def __post_init__(self) -> None:
        for name in _SHARES:
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise BadSettings(f"sky script: {name} = {getattr(self, name)}", advice="0 to 1")
        for cloud in self.clouds:
            if not cloud.from_min < cloud.to_min:
                raise BadSettings(
                    f"sky script: a cloud from {cloud.from_min} to {cloud.to_min} min", advice="from < to"
                )
        for incident in self.incidents:
            if incident.what not in _WHATS:
                raise BadSettings(
                    f"sky script: incident {incident.what!r}", advice=f"one of {', '.join(_WHATS)}"
                )
        if self.satellite_every < 0 or not (math.isfinite(self.solve_s) and self.solve_s >= 0.0):
            raise BadSettings("sky script: satellite_every and solve_s are 0 or more")

    def cloud_at(self, minutes: float) -> Cloud | None:
        """The cloud over the sky at an instant; a thick one before a thin one."""
        over = [cloud for cloud in self.clouds if cloud.from_min <= minutes < cloud.to_min]
        return min(over, key=lambda cloud: cloud.thin, default=None)

    def clear_from(self, minutes: float) -> float:
        """From when on, after an instant, there is no thick cloud (minutes)."""
        while (cloud := self.cloud_at(minutes)) is not None and not cloud.thin:
            minutes = cloud.to_min
        return minutes

    @classmethod
    def from_toml(cls, path: Path | str) -> SkyScript:
        """Read a script from a file.

        Raises
        ------
        BadSettings
            When the file can't be read, is no TOML, or holds an unknown name or a bad value.
        """
        try:
            values = toml_of(read_text(Path(path)))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as cause:
            raise BadSettings(f"can't read the sky script {path}: {cause}") from cause
        try:
            return cls.from_mapping(values)
        except BadSettings as cause:
            raise BadSettings(f"{path}: {cause.what}", advice=cause.advice) from cause

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> SkyScript:
        """Make a script of a file's values. Raises `BadSettings`."""
        given = dict(values)
        given["clouds"] = tuple(_made(Cloud, one) for one in given.get("clouds", ()))
        given["incidents"] = tuple(_made(Incident, one) for one in given.get("incidents", ()))
        made: SkyScript = _made(cls, given)
        return made


def _made(kind: type, values: Mapping[str, Any]) -> Any:
    names = [field.name for field in fields(kind)]
    unknown = sorted(set(values) - set(names))
    if unknown:
        raise BadSettings(
            f"sky script: unknown {', '.join(unknown)} in {kind.__name__}",
            advice=f"allowed: {', '.join(names)}",
        )
    try:
        return kind(**values)
    except TypeError as cause:
        raise BadSettings(f"sky script: {kind.__name__}: {cause}") from cause
