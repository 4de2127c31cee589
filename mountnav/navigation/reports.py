"""What navigation answers about a look, a slew, a sync, ...: absolute values, never only "how far off"."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from mountnav.navigation.devices import MountReading, SlewOutcome
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset
from mountnav.solution import Solution, Verdict


@dataclass(frozen=True, slots=True)
class Look:
    """Exposed and solved: where the telescope points, and where the mount believed it did.

    Attributes
    ----------
    look_id : str
        Identity, so that a correction can name the frame it came from.
    seen : Icrs
        Solved place of the wanted pixel.
    believed : Icrs
        The mount's reading at mid-exposure (mean of before and after), as ICRS.
    offset : Offset
        Seen minus believed; east and north positive.
    before, after : MountReading
        Raw readings round the exposure.
    """

    look_id: str
    verdict: Verdict
    solution: Solution
    seen: Icrs
    believed: Icrs
    offset: Offset
    before: MountReading
    after: MountReading
    mid_exposure_utc: datetime

    @property
    def blind(self) -> bool:
        """Whether it was found by searching the whole sky, since the mount's belief led nowhere."""
        return self.solution.mode.startswith("blind/")


@dataclass(frozen=True, slots=True)
class SlewReport:
    """How a slew ended: asked, reported afterwards (both ICRS), and their distance."""

    outcome: SlewOutcome
    target: Icrs
    reported: Icrs
    miss_arcsec: float
    elapsed_s: float


class SyncOutcome(StrEnum):
    """How a sync ended."""

    SEEN = "accepted and seen in the read-back"
    IGNORED = "accepted and ignored"


@dataclass(frozen=True, slots=True)
class SyncReport:
    """A sync with its look and its read-back."""

    outcome: SyncOutcome
    look: Look
    read_back: Icrs
    read_back_miss_arcsec: float


@dataclass(frozen=True, slots=True)
class RecoverReport:
    """A lost mount told where it points, by two frames that agree.

    Attributes
    ----------
    outcome : SyncOutcome
        Always `SEEN`; every other end is an error.
    first, second : Look
        The first look, and the one that confirmed it and was synced on.
    apart_arcsec : float
        Between the two solved places, what the mount moved meanwhile taken off.
    altitude_deg : float
        Of the solved place, for the site and this machine's clock.
    believed_altitude_deg : float
        Of the place the mount believed in: below the ground if it was quite lost.
    read_back : Icrs
        The mount's reading afterwards.
    read_back_miss_arcsec : float
        Its distance from the solved place.
    elapsed_s : float
    """

    outcome: SyncOutcome
    first: Look
    second: Look
    apart_arcsec: float
    altitude_deg: float
    believed_altitude_deg: float
    read_back: Icrs
    read_back_miss_arcsec: float
    elapsed_s: float


class CenterOutcome(StrEnum):
    """How a centering ended."""

    CENTERED = "centered"


@dataclass(frozen=True, slots=True)
class Try:
    """One look of a centering and what was done about it."""

    number: int
    seen: Icrs
    error_arcsec: float
    east_arcsec: float
    north_arcsec: float
    pairs: int
    rms_arcsec: float
    false_probability: float
    synced: bool
    sync_outcome: SyncOutcome | None
    slewed: bool
    elapsed_s: float


@dataclass(frozen=True, slots=True)
class CenterReport:
    """A centering: the target, each try, error before and after.

    `error_before_arcsec` is the distance of target and solved place after the first slew,
    `error_after_arcsec` after the last one, `error_sigma_arcsec` its one-sigma.
    """

    outcome: CenterOutcome
    target: Icrs
    tries: tuple[Try, ...]
    error_before_arcsec: float
    error_after_arcsec: float
    error_sigma_arcsec: float
    tolerance_arcsec: float
    elapsed_s: float


@dataclass(frozen=True, slots=True)
class TelescopeState:
    """What is known of a telescope now; None where unknown."""

    name: str
    connected: bool
    activity: str
    reading: MountReading | None
    icrs: Icrs | None
    altitude_deg: float | None
    azimuth_deg: float | None
    problem: str | None
