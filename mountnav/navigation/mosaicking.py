"""A mosaic, or a pattern of offsets, as one order: each panel centered, and left to the camera.

Before anything moves it is known when each panel is allowed. A panel that isn't when its turn comes, or that
can't be centered, is left out and told; the others are gone on with.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from enum import StrEnum
from typing import Literal

from mountnav.devices import PierSide
from mountnav.errors import (
    BadRequest,
    DeviceRefused,
    MountMoved,
    NotReached,
    OffsetTooLarge,
    OutsideLimits,
    SolveFailed,
    SyncRefused,
    TargetNotReached,
)
from mountnav.journal.records import EntryKind
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.reports import CenterReport, angle_words
from mountnav.sky.patterns import Panel

__all__ = [
    "FAILURES_IN_A_ROW",
    "MosaicReport",
    "MosaicWait",
    "Mosaicking",
    "PanelEnd",
    "PanelPlan",
    "PanelReport",
    "plan_panels",
]

FAILURES_IN_A_ROW = 3
"""So many panels in a row that can't be centered end a mosaic: it is cloudy, or something is wrong. Chosen by
hand. Doubled, a cloudy sky takes six centerings until that is said."""
LONGEST_WAIT_S = 43_200.0
"""The longest that a camera program may take for one panel, s: half a day. Doubled, a program that has died
keeps a telescope for a day."""


@dataclass(frozen=True, slots=True)
class MosaicWait:
    """What a panel is left for.

    Attributes
    ----------
    until : {"next", "dwell"}
        Until somebody says that the next one may begin; or for a fixed time.
    dwell_s : float
        That time.
    signals : int
        So many times it must be said: as often as frames are wanted of each panel.
    most_s : float
        A program that says nothing for so long has died: the mosaic ends, and may be resumed.
    """

    until: Literal["next", "dwell"] = "next"
    dwell_s: float = 0.0
    signals: int = 1
    most_s: float = 7200.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.dwell_s <= LONGEST_WAIT_S or not 0.0 < self.most_s <= LONGEST_WAIT_S:
            raise BadRequest(
                f"waits of {self.dwell_s} s, {self.most_s} s", advice=f"0 to {LONGEST_WAIT_S:.0f} s"
            )
        if not 1 <= self.signals <= 10_000:
            raise BadRequest(f"{self.signals} signals", advice="1 to 10000 for each panel")


class PanelEnd(StrEnum):
    """What became of a panel."""

    DONE = "done"
    """It was centered, and left when that was said."""
    CENTERED = "centered"
    """It was centered, and the mosaic ended on it."""
    NOT_ALLOWED = "not allowed"
    FAILED = "not centered"
    LEFT_OUT = "left out"
    """Before the one that the order began with, or after its end."""


@dataclass(frozen=True, slots=True)
class PanelPlan:
    """When a panel is allowed, as it is known beforehand.

    Attributes
    ----------
    from_utc : datetime or None
        When it is allowed next; now, if it is; None: not within a day.
    until_utc : datetime or None
        When tracking on it reaches a limit, from then on; None: none within half a day, or not known.
    words : str
        For people.
    """

    panel: Panel
    allowed_now: bool
    from_utc: datetime | None
    until_utc: datetime | None
    words: str


@dataclass(frozen=True, slots=True)
class PanelReport:
    """One panel as it ended.

    Attributes
    ----------
    error_arcsec : float or None
        Of the last look, from the panel's place.
    rotation_deg : float or None
        How the image stood; it is to stand at the panel's position angle.
    words : str
        Why, if it wasn't done.
    """

    panel: Panel
    end: PanelEnd
    error_arcsec: float | None = None
    rotation_deg: float | None = None
    centered_utc: datetime | None = None
    left_utc: datetime | None = None
    words: str = ""


@dataclass(frozen=True, slots=True)
class MosaicReport:
    """A whole mosaic.

    Attributes
    ----------
    panels : tuple of PanelReport
        All of them, in their order.
    missing : tuple of int
        Numbers of those that were not done: what a later order may begin with.
    notes : tuple of str
        What an operator should know.
    """

    panels: tuple[PanelReport, ...]
    missing: tuple[int, ...]
    notes: tuple[str, ...]
    elapsed_s: float


def plan_panels(
    equipment: Equipment, panels: Sequence[Panel], *, side: PierSide = PierSide.UNKNOWN
) -> tuple[PanelPlan, ...]:
    """When each panel is allowed; nothing moves."""
    mount, now = equipment.mount, equipment.clock.utc()
    limits, site, air = mount.limits, equipment.site, equipment.air
    plans = []
    for panel in panels:
        try:
            limits.check(panel.place, now, site, air)
            from_utc: datetime | None = now
            words = "allowed now"
        except OutsideLimits as error:
            from_utc = limits.next_allowed(panel.place, now, site, air)
            words = f"{error.limit}: " + (
                "not within a day" if from_utc is None else f"allowed from {from_utc:%Y-%m-%d %H:%M} UTC on"
            )
        until_utc = None
        if from_utc is not None:
            found = limits.reached(
                panel.place,
                from_utc,
                site,
                air,
                mounting=mount.mounting,
                side=None if side is PierSide.UNKNOWN else side,
            )
            if found is not None:
                until_utc = from_utc + timedelta(seconds=found.after_s)
                words += f", until {until_utc:%H:%M} UTC ({found.limit})"
        plans.append(PanelPlan(panel, from_utc == now, from_utc, until_utc, words))
    return tuple(plans)


Center = Callable[[Panel], Awaitable[CenterReport]]
Heard = Callable[[PanelReport], None]


@dataclass
class Mosaicking:
    """One run.

    Parameters
    ----------
    center : callable
        Centers a panel, and turns the field where that is wanted.
    heard : callable
        Told of each panel when it is centered, and when it ends.

    Attributes
    ----------
    waiting : bool
        Whether a panel waits for the next signal.
    """

    equipment: Equipment
    panels: Sequence[Panel]
    wait: MosaicWait
    center: Center
    heard: Heard
    waiting: bool = False
    notes: list[str] = field(default_factory=list)
    _signals: int = 0
    _told: asyncio.Event = field(default_factory=asyncio.Event)

    def signal(self) -> int:
        """Say that the camera is through with a frame; how many are wanted yet of this panel.

        Raises
        ------
        BadRequest
            No panel waits for it.
        """
        if not self.waiting:
            raise BadRequest(
                "no panel is waiting for that",
                device=self.equipment.name,
                advice="wait until the panel is centered: the event panel tells",
            )
        self._signals += 1
        self._told.set()
        return max(0, self.wait.signals - self._signals)

    async def run(self, from_panel: int = 1) -> MosaicReport:
        """Go through them.

        Parameters
        ----------
        from_panel : int
            Number of the first one.

        Raises
        ------
        BadRequest
            There is no panel of that number.
        OutsideLimits
            None of the panels is allowed now; nothing moved.
        TargetNotReached
            The camera program said nothing for too long (`NotReached.TIME`), or panels in a row couldn't be
            centered (`NotReached.OTHER`): both tell with which panel to begin again.
        Cancelled, DeviceError, JournalFailed
        """
        clock = self.equipment.clock
        began_s = clock.monotonic_s()
        if not 1 <= from_panel <= len(self.panels):
            raise BadRequest(f"there is no panel {from_panel}", advice=f"1 to {len(self.panels)}")
        await self._plan(from_panel)
        ends = {panel.number: PanelReport(panel, PanelEnd.LEFT_OUT) for panel in self.panels}
        failed = 0
        for panel in self.panels[from_panel - 1 :]:
            ended = await self._panel(panel)
            ends[panel.number] = ended
            await self._note(ended)
            failed = failed + 1 if ended.end is PanelEnd.FAILED else 0
            if failed >= FAILURES_IN_A_ROW:
                raise TargetNotReached(
                    f"{failed} panels in a row couldn't be centered, at last panel {panel.number}: "
                    f"{ended.words}",
                    device=self.equipment.name,
                    advice=f"order it again with from_panel = {panel.number - failed + 1} when it is clear",
                    reason=NotReached.OTHER,
                )
        reports = tuple(ends[panel.number] for panel in self.panels)
        missing = tuple(
            one.panel.number
            for one in reports
            if one.end is not PanelEnd.DONE and one.panel.number >= from_panel
        )
        return MosaicReport(reports, missing, tuple(self.notes), clock.monotonic_s() - began_s)

    async def _plan(self, from_panel: int) -> None:
        plans = plan_panels(self.equipment, self.panels[from_panel - 1 :])
        rows = [
            {
                "number": plan.panel.number,
                "ra_deg": plan.panel.place.ra_deg,
                "dec_deg": plan.panel.place.dec_deg,
                "allowed_now": plan.allowed_now,
                "from_utc": None if plan.from_utc is None else plan.from_utc.isoformat(),
                "until_utc": None if plan.until_utc is None else plan.until_utc.isoformat(),
                "words": plan.words,
            }
            for plan in plans
        ]
        facts: dict[str, object] = {"panels": rows}
        self.equipment.listen("mosaic-plan", dict(facts))
        await self.equipment.note(EntryKind.DECISION, f"mosaic: {len(plans)} panel(s) planned", facts)
        later = [plan for plan in plans if not plan.allowed_now]
        self.notes += [f"panel {plan.panel.number}: {plan.words}" for plan in later]
        if len(later) == len(plans):
            # with the words of the first one's limit, and when it will be allowed
            limits, now = self.equipment.mount.limits, self.equipment.clock.utc()
            limits.check(plans[0].panel.place, now, self.equipment.site, self.equipment.air)

    async def _panel(self, panel: Panel) -> PanelReport:
        clock = self.equipment.clock
        try:
            report = await self.center(panel)
        except OutsideLimits as error:
            return PanelReport(panel, PanelEnd.NOT_ALLOWED, words=error.what)
        except DeviceRefused as error:
            if not error.of_place:
                raise
            return PanelReport(panel, PanelEnd.NOT_ALLOWED, words=error.what)
        except (SolveFailed, TargetNotReached, SyncRefused, OffsetTooLarge, MountMoved) as error:
            return PanelReport(panel, PanelEnd.FAILED, words=error.what)
        centered = PanelReport(
            panel,
            PanelEnd.CENTERED,
            report.error_after_arcsec,
            report.rotation_deg,
            clock.utc(),
            words="; ".join(report.notes),
        )
        await self._left(centered)
        return replace(centered, end=PanelEnd.DONE, left_utc=clock.utc())

    async def _left(self, centered: PanelReport) -> None:
        """Leave it to the camera until it is through."""
        wait, clock = self.wait, self.equipment.clock
        self._signals = 0
        self._told.clear()
        self.waiting = wait.until == "next"
        self.heard(centered)
        try:
            if wait.until == "dwell":
                await clock.sleep(wait.dwell_s)
                return
            while self._signals < wait.signals:
                self._told.clear()
                async with asyncio.timeout(wait.most_s):
                    await self._told.wait()
        except TimeoutError:
            raise TargetNotReached(
                f"panel {centered.panel.number} is centered, and nobody said for {wait.most_s:.0f} s "
                "that the "
                "next one may begin",
                device=self.equipment.name,
                advice=f"has the camera program ended? order it again with from_panel = "
                f"{centered.panel.number}, or the next one",
                reason=NotReached.TIME,
            ) from None
        finally:
            self.waiting = False

    async def _note(self, ended: PanelReport) -> None:
        self.heard(ended)
        words = f"mosaic: panel {ended.panel.number} of {len(self.panels)} {ended.end}"
        if ended.error_arcsec is not None:
            words += f", centered to {angle_words(ended.error_arcsec)}"
        facts: dict[str, object] = {
            "panel": ended.panel.number,
            "end": str(ended.end),
            "error_arcsec": ended.error_arcsec,
            "rotation_deg": ended.rotation_deg,
            "words": ended.words,
        }
        await self.equipment.note(EntryKind.NOTE, words, facts)
