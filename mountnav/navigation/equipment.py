"""What one telescope navigates with: its devices, its eyes, its memory, who is told; put together once."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from mountnav.catalog.stars import Catalog
from mountnav.clock import Clock
from mountnav.devices import Camera, Mount
from mountnav.frames import Frame, Hint
from mountnav.journal.records import Entry, EntryKind, Journal
from mountnav.mount import CheckedMount
from mountnav.navigation.frames_seen import FramesSeen
from mountnav.navigation.learned import Learned
from mountnav.navigation.reading_history import ReadingHistory
from mountnav.navigation.sync import GuardedSync
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.pointing.limits import Limits, Mounting
from mountnav.pointing.model.in_force import Pointing
from mountnav.sky.coordinates import Air, Site
from mountnav.solution import Verdict
from mountnav.solving.settings import SolveSettings

Listener = Callable[[str, dict[str, object]], None]


class Solve(Protocol):
    """Finds out where a frame was taken, while everything else goes on: a stop never waits for it."""

    async def __call__(self, frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
        """Answer with a verdict, as `mountnav.solving.solve.solve` does."""
        ...


def in_thread(catalog: Catalog) -> Solve:
    """Solve in a thread of this process, for whoever has no solver of his own.

    Parameters
    ----------
    catalog : Catalog

    Returns
    -------
    Solve
        Cancelling it frees the caller at once; the thread goes on to its end.
    """
    from mountnav.solving.solve import solve  # a service that has a solver needs none of its parts

    async def solve_in_thread(frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
        return await asyncio.to_thread(solve, frame, catalog, hint=hint, settings=settings)

    return solve_in_thread


@dataclass
class Equipment:
    """What one telescope navigates with.

    Attributes
    ----------
    name : str
        The telescope's.
    mount : CheckedMount
    camera : Camera
    solve : Solve
    solving : SolveSettings
    site, air : Site, Air
    clock : Clock
    journal : Journal
    guard : GuardedSync
        Judges each look, and does the syncs.
    readings : ReadingHistory
    listen : callable
        Told of each step; it never steers.
    apply_model : bool
        Whether slews are aimed by the pointing model.
    frames : FramesSeen
        By which an old frame is known.
    """

    name: str
    mount: CheckedMount
    camera: Camera
    solve: Solve
    solving: SolveSettings
    site: Site
    air: Air
    clock: Clock
    journal: Journal
    guard: GuardedSync
    readings: ReadingHistory
    listen: Listener
    apply_model: bool = True
    frames: FramesSeen = field(default_factory=FramesSeen)

    @property
    def pointing(self) -> Pointing:
        """The pointing model in force."""
        return self.guard.pointing

    @property
    def trusted(self) -> bool:
        """Whether the mount's own position counts."""
        return self.mount.trusted

    async def note(self, kind: EntryKind, what: str, facts: Mapping[str, object]) -> None:
        """Write something down. Raises `JournalFailed`."""
        await self.journal.note(self._entry(kind, what, facts))

    def note_now(self, kind: EntryKind, what: str, facts: Mapping[str, object]) -> None:
        """Write something down where nobody can wait."""
        self.journal.note_now(self._entry(kind, what, facts))

    def _entry(self, kind: EntryKind, what: str, facts: Mapping[str, object]) -> Entry:
        return Entry(self.clock.utc(), self.name, kind, what, facts)


def equipped(
    *,
    name: str,
    mount: Mount,
    camera: Camera,
    solve: Solve,
    solving: SolveSettings,
    site: Site,
    air: Air,
    limits: Limits,
    rules: SyncPolicy,
    journal: Journal,
    clock: Clock,
    pointing: Pointing,
    learned: Learned,
    mounting: Mounting | None,
    listen: Listener,
    apply_model: bool,
) -> Equipment:
    """Put a telescope's equipment together: the driver behind its checks, syncs behind their guard."""
    checked = CheckedMount(
        mount,
        telescope=name,
        limits=limits,
        site=site,
        air=air,
        journal=journal,
        clock=clock,
        mounting=mounting,
    )
    readings = ReadingHistory()
    checked.on_reading(readings.add)
    guard = GuardedSync(
        checked,
        telescope=name,
        policy=rules,
        learned=learned,
        pointing=pointing,
        site=site,
        air=air,
        limits=limits,
        journal=journal,
        clock=clock,
        listen=listen,
    )
    return Equipment(
        name=name,
        mount=checked,
        camera=camera,
        solve=solve,
        solving=solving,
        site=site,
        air=air,
        clock=clock,
        journal=journal,
        guard=guard,
        readings=readings,
        listen=listen,
        apply_model=apply_model,
    )


__all__ = ["Equipment", "Listener", "Solve", "equipped", "in_thread"]
