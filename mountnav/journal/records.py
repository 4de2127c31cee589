"""What is written down, and who writes it: values only, so that every room may hand them over.

Absolute values at one instant, never only "how far off" [POINTING §6].
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import StrEnum
from typing import Literal, Protocol
from uuid import uuid4

from mountnav.devices import MountReading
from mountnav.sky.coordinates import Air, Apparent, Icrs


def new_id() -> str:
    """An identity that no other row has."""
    return uuid4().hex


class EntryKind(StrEnum):
    """What a note is about. Looks and commands have records of their own."""

    REFUSAL = "refusal"
    """Something was asked and not done; nothing went over the wire."""
    DECISION = "decision"
    """What was chosen, and the numbers behind it."""
    SYNC = "sync"
    """How a sync transaction ended: committed, undone, fallen back to an offset."""
    CENTERING = "centering"
    SEGMENT = "segment"
    """The mount's zero points are new from here on: sync, home, reboot, lost link, flip."""
    STANDING = "standing"
    """Where the mount rests, and whether its position counts: what the next start compares with."""
    FAULT = "fault"
    LINK = "link"
    MODEL = "model"
    SETTINGS = "settings"
    NIGHT = "night"
    JOB = "job"
    SERVICE = "service"
    LEARNED = "learned"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Cause:
    """Why something is done; stands in every row that is written under it.

    Attributes
    ----------
    job_id, night_id, look_id : str or None
        None: it has none.
    why : str
        In words: "centering", "night: corrected a drift of 40″".
    """

    job_id: str | None = None
    night_id: str | None = None
    look_id: str | None = None
    why: str = ""


_CAUSE: ContextVar[Cause] = ContextVar("mountnav_cause", default=Cause())  # noqa: B039 - frozen


def cause() -> Cause:
    """The cause of what is being done now, in this task."""
    return _CAUSE.get()


@contextmanager
def because(
    *,
    job_id: str | None = None,
    night_id: str | None = None,
    look_id: str | None = None,
    why: str | None = None,
) -> Iterator[Cause]:
    """Do what follows for a cause; what is not given stays as it is outside."""
    given = {"job_id": job_id, "night_id": night_id, "look_id": look_id, "why": why}
    token = _CAUSE.set(
        replace(_CAUSE.get(), **{key: value for key, value in given.items() if value is not None})
    )
    try:
        yield _CAUSE.get()
    finally:
        _CAUSE.reset(token)


@dataclass(frozen=True, slots=True)
class LookRecord:
    """A look, solved or not: absolute values at one instant.

    Attributes
    ----------
    utc : datetime
        Mid-exposure; of the second reading where the frame tells none.
    reason, detail : str
        Why not; empty when solved.
    seen : Icrs or None
        Solved place of the wanted pixel.
    covariance_arcsec2 : (float, float, float) or None
        Of `seen`: east-east, east-north, north-north.
    before, after : MountReading
        Raw, round the exposure.
    segment_id : str
        Between two changes of the mount's zero points.
    model_id : str or None
        Pointing model in force.
    camera, source : str
        Camera's name; the frame's file or where it came from.
    mode, catalog : str
        How it was identified, and by which catalog.
    rms_arcsec, false_probability, scale_arcsec_px, rotation_deg : float or None
        None: not solved.
    parity : int or None
        +1 or -1; None: not solved.
    fwhm_px, limiting_mag, sky_adu : float or None
        None: not measured.
    measured : int
        Sources.
    used : str
        What it was used for: "centering", "night", "model run", ...
    """

    look_id: str
    telescope: str
    utc: datetime
    solved: bool
    before: MountReading
    after: MountReading
    segment_id: str
    air: Air
    reason: str = ""
    detail: str = ""
    seen: Icrs | None = None
    covariance_arcsec2: tuple[float, float, float] | None = None
    model_id: str | None = None
    dut1_s: float = 0.0
    camera: str = ""
    source: str = ""
    exposure_s: float = 0.0
    mode: str = ""
    catalog: str = ""
    pairs: int = 0
    rms_arcsec: float | None = None
    false_probability: float | None = None
    scale_arcsec_px: float | None = None
    rotation_deg: float | None = None
    parity: int | None = None
    fwhm_px: float | None = None
    limiting_mag: float | None = None
    sky_adu: float | None = None
    measured: int = 0
    used: str = ""
    cause: Cause = field(default_factory=cause)


Order = Literal[
    "slew",
    "sync",
    "stop",
    "park",
    "unpark",
    "set-park",
    "home",
    "track",
    "guide",
    "offset-rates",
    "move-axis",
    "trust",
    "set-clock",
    "set-site",
]


@dataclass(frozen=True, slots=True)
class CommandRecord:
    """An order to a mount, written before it is sent.

    Attributes
    ----------
    utc : datetime
        Of the writing; the order is sent right after it.
    place : Apparent, Icrs or None
        As the mount gets it.
    facts : mapping
        What else belongs to the order: rate, direction, duration. JSON values.
    before : MountReading or None
        Where the mount believed to be when it was ordered.
    """

    command_id: str
    telescope: str
    utc: datetime
    order: Order
    segment_id: str
    place: Apparent | Icrs | None = None
    facts: Mapping[str, object] = field(default_factory=dict)
    before: MountReading | None = None
    cause: Cause = field(default_factory=cause)


class Outcome(StrEnum):
    """How a command ended, as far as it is known."""

    DONE = "done"
    """The mount did it, by its own readings."""
    LATE = "late"
    IGNORED = "ignored"
    """It said yes and did nothing."""
    ELSEWHERE = "elsewhere"
    """It took a sync for another place than it was told."""
    REFUSED = "refused"
    REFUSED_BUT_DONE = "refused but done"
    """It said no and did it all the same."""
    STALLED = "stalled"
    STOPPED = "stopped"
    NOT_SENT = "not sent"
    """Nothing went over the wire."""
    UNKNOWN = "unknown"
    """It may have been sent and carried out; the mount has to be read to find out."""


@dataclass(frozen=True, slots=True)
class CommandEnd:
    """The outcome of a command.

    Attributes
    ----------
    detail : str
        In words: the error's text.
    after : MountReading or None
        The mount's reading afterwards.
    miss_arcsec : float or None
        Between it and the ordered place.
    facts : mapping
        JSON values.
    """

    utc: datetime
    outcome: Outcome
    detail: str = ""
    after: MountReading | None = None
    miss_arcsec: float | None = None
    facts: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Entry:
    """Anything else that happened: its kind and JSON facts."""

    utc: datetime
    telescope: str
    kind: EntryKind
    what: str
    facts: Mapping[str, object] = field(default_factory=dict)
    cause: Cause = field(default_factory=cause)


class Journal(Protocol):
    """Who writes things down. What was awaited is kept, also when the process is killed right afterwards."""

    async def look(self, record: LookRecord) -> None:
        """Write a look. Raises `JournalFailed`."""
        ...

    async def begin(self, command: CommandRecord) -> None:
        """Write a command down before it is sent; durable on return. On `JournalFailed` it isn't sent."""
        ...

    def begin_now(self, command: CommandRecord) -> None:
        """Write a stop down without being waited for: a stop is never queued behind a disk. Never raises."""
        ...

    async def end(self, command_id: str, end: CommandEnd) -> None:
        """Close a command. Raises `JournalFailed`."""
        ...

    async def note(self, entry: Entry) -> None:
        """Write anything else. Raises `JournalFailed`."""
        ...

    def note_now(self, entry: Entry) -> None:
        """As `note`, from code that can't wait; never raises."""
        ...


class Unwritten:
    """A journal that keeps nothing, for those who have none."""

    async def look(self, record: LookRecord) -> None:
        """Forget."""

    async def begin(self, command: CommandRecord) -> None:
        """Forget."""

    def begin_now(self, command: CommandRecord) -> None:
        """Forget."""

    async def end(self, command_id: str, end: CommandEnd) -> None:
        """Forget."""

    async def note(self, entry: Entry) -> None:
        """Forget."""

    def note_now(self, entry: Entry) -> None:
        """Forget."""


__all__ = [
    "Cause",
    "CommandEnd",
    "CommandRecord",
    "Entry",
    "EntryKind",
    "Journal",
    "LookRecord",
    "Order",
    "Outcome",
    "Unwritten",
    "because",
    "cause",
    "new_id",
]
