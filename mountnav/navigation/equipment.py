"""What one telescope navigates with: devices, solver, journal, listeners; put together once."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

from mountnav.catalog.stars import Catalog
from mountnav.clock import Clock, SystemClock
from mountnav.devices import Camera, Mount
from mountnav.frames import Frame, Hint
from mountnav.journal.records import Entry, EntryKind, Journal, Unwritten
from mountnav.mount import CheckedMount, Deadman, FollowingPolicy
from mountnav.navigation.frames_seen import FramesSeen
from mountnav.navigation.learned import Learned
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.rates_kept import RatesKept
from mountnav.navigation.reading_history import ReadingHistory
from mountnav.navigation.reports import Listener
from mountnav.navigation.sync import GuardedSync
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.pointing.limits import Limits, Mounting
from mountnav.pointing.model.in_force import NoModel, Pointing
from mountnav.sky.coordinates import Air, Site
from mountnav.solution import Verdict
from mountnav.solving.settings import SolveSettings


class Solve(Protocol):
    """Finds out where a frame was taken, while everything else goes on: a stop never waits for it."""

    async def __call__(self, frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
        """Answer with a verdict, as `mountnav.solving.solve.solve` does."""
        ...


def in_thread(catalog: Catalog) -> Solve:
    """Solve in a thread of this process, where there is no solver process.

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
    policy : CenteringPolicy
        What navigation is allowed; an order may set some of it otherwise for itself.
    guard : GuardedSync
        Judges each look, and does the syncs.
    listen : callable
        Told of each step; it never steers.
    apply_model : bool
        Whether slews are aimed by the pointing model.
    frames : FramesSeen
        By which an old frame is known.
    rates : RatesKept
        How the mount keeps rates beside the sidereal one, as looks have shown.
    """

    name: str
    mount: CheckedMount
    camera: Camera
    solve: Solve
    solving: SolveSettings
    policy: CenteringPolicy
    clock: Clock
    journal: Journal
    guard: GuardedSync
    readings: ReadingHistory
    listen: Listener
    apply_model: bool = True
    frames: FramesSeen = field(default_factory=FramesSeen)
    rates: RatesKept = field(default_factory=lambda: RatesKept(""))

    @property
    def site(self) -> Site:
        """Where the telescope stands."""
        return self.mount.site

    @property
    def air(self) -> Air:
        """The air there."""
        return self.mount.air

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


def equip(
    *,
    name: str,
    mount: Mount,
    camera: Camera,
    catalog: Catalog,
    site: Site,
    air: Air,
    policy: CenteringPolicy,
    listen: Listener,
    solving: SolveSettings | None = None,
    solve: Solve | None = None,
    limits: Limits | None = None,
    sync: SyncPolicy | None = None,
    journal: Journal | None = None,
    clock: Clock | None = None,
    pointing: Pointing | None = None,
    apply_model: bool = True,
    learned: Learned | None = None,
    mounting: Mounting | None = None,
    following: FollowingPolicy | None = None,
    dead_man: Deadman | None = None,
) -> Equipment:
    """Put a telescope's equipment together: the driver behind its checks, syncs behind their guard.

    Parameters
    ----------
    mount : Mount
        The driver; from now on only `Equipment.mount`, which checks and writes down each order, may be used.
    catalog : Catalog
        For `solve`, where that is left out.
    listen : callable
        Told of each step; it never steers.
    solving : SolveSettings, optional
        How frames are calibrated, measured and identified.
    solve : Solve, optional
        Who solves them; a thread of this process with the catalog if left out.
    limits : Limits, optional
        The policy's lowest altitude alone, if left out.
    pointing : Pointing, optional
        The pointing model in force.
    apply_model : bool
        Whether slews are aimed by it.
    learned : Learned, optional
        What is known of the camera already.
    mounting : {"german", "fork", "altaz"}, optional
        None: not known.
    following : FollowingPolicy, optional
        Bounds of rates beside the stars' and of axes moved by hand.
    dead_man : Deadman, optional
        Who ends them when the service is dead.
    """
    journal, clock = journal or Unwritten(), clock or SystemClock()
    checked = CheckedMount(
        mount,
        telescope=name,
        limits=limits or Limits(min_altitude_deg=policy.min_altitude_deg),
        site=site,
        air=air,
        journal=journal,
        clock=clock,
        mounting=mounting,
        following=following,
        dead_man=dead_man,
    )
    readings = ReadingHistory()
    checked.on_reading(readings.add)
    guard = GuardedSync(
        checked,
        telescope=name,
        policy=sync_rules(sync, policy),
        learned=learned or Learned(mounting=mounting),
        pointing=pointing or NoModel(),
        journal=journal,
        clock=clock,
        listen=listen,
    )
    return Equipment(
        name=name,
        mount=checked,
        camera=camera,
        solve=solve or in_thread(catalog),
        solving=solving or SolveSettings(),
        policy=policy,
        clock=clock,
        journal=journal,
        guard=guard,
        readings=readings,
        listen=listen,
        apply_model=apply_model,
        rates=RatesKept(mount.name),
    )


def sync_rules(sync: SyncPolicy | None, policy: CenteringPolicy) -> SyncPolicy:
    """The policy of syncs; the smaller of the two caps on their size holds."""
    rules = sync or SyncPolicy(read_back_s=policy.sync_read_back_s)
    return replace(rules, max_arcsec=min(rules.max_arcsec, policy.max_sync_arcsec))


__all__ = ["Equipment", "Listener", "Solve", "equip", "in_thread", "sync_rules"]
