"""The latest known state of each telescope, read in the background: reading it waits for no device."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime

from api.observatory.observatory import Telescope
from api.orders.jobs import Job, Jobs
from api.orders.vocabulary import MOVING
from mountnav.clock import real_s, utc_now
from mountnav.navigation.reports import TelescopeState
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import separation_arcsec
from mountnav.tasks import begun, cancelled, fault_words

__all__ = ["Snapshot", "Watch", "apparent_place", "still_since"]


_log = logging.getLogger(__name__)


_STILL_ARCSEC = 30.0
"""What a still mount's reading may change by: LX200 mounts round to 15″ in right ascension, the short format
to 90″, which then counts as moved. Doubled, a nudge of a minute of arc is not noticed."""
_STILL_ARCSEC_S = 20.0
"""And by so much a second: one that stands while the sky turns reads 15.04″/s. Doubled, a motion by hand at
twice the guide rate is not noticed."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A telescope at one moment.

    Attributes
    ----------
    utc : datetime
        When it was put together; ``state.reading.utc`` tells when the mount was read.
    revision : int
        Counts up.
    job : Job or None
        What holds the telescope.
    still_since_utc : datetime or None
        Of the first reading from which on the mount was seen to go nowhere but with the stars; None while it
        slews or isn't read.
    """

    state: TelescopeState
    utc: datetime
    revision: int
    job: Job | None
    still_since_utc: datetime | None = None

    @property
    def slewing(self) -> bool:
        """Whether it slews, or was ordered to: from the taking of such an order to its end.

        A target that moves is followed for hours: once it is, what the mount says counts.
        """
        job = self.job
        under_way = job is not None and not job.is_over and job.kind in MOVING
        if job is not None and under_way and job.progress.get("phase") != "following":
            return True
        return self.state.reading is not None and bool(self.state.reading.slewing)


def still_since(since_utc: datetime | None, before: TelescopeState, now: TelescopeState) -> datetime | None:
    """Since when a mount is still, by its next reading; None while it moves or can't be read.

    Parameters
    ----------
    since_utc : datetime or None
        What was known until now.
    before, now : TelescopeState
        Of two readings, one after the other.
    """
    last, reading = before.reading, now.reading
    if not now.connected or reading is None or reading.slewing:
        return None
    if since_utc is None or last is None or not before.connected:
        return reading.utc
    if before.icrs is None or now.icrs is None:
        return since_utc
    took_s = max(0.0, (reading.utc - last.utc).total_seconds())
    moved_arcsec = separation_arcsec(before.icrs, now.icrs)
    return since_utc if moved_arcsec <= _STILL_ARCSEC + _STILL_ARCSEC_S * took_s else reading.utc


class Watch:
    """Reads one telescope's state again and again.

    Parameters
    ----------
    first_revision : int
        Above those of a watch that this one follows: no client takes a reading for one that it has.
    """

    def __init__(self, telescope: Telescope, jobs: Jobs, poll_s: float, *, first_revision: int = 0) -> None:
        self._telescope = telescope
        self._jobs = jobs
        self._poll_s = poll_s
        self._state = TelescopeState(telescope.id, False, "idle", None, None, None, None, telescope.problem)
        self._utc = utc_now()
        self._revision = first_revision
        self._still_since_utc: datetime | None = None
        self._news = asyncio.Event()
        self._wake = asyncio.Event()
        self._turn = asyncio.Lock()
        self._task: asyncio.Task[None] | None = None

    @property
    def latest(self) -> Snapshot:
        """What is known now. Asks no device. The job is the one of this very moment."""
        job = self._jobs.running_on(self._telescope.id)
        return Snapshot(self._state, self._utc, self._revision, job, self._still_since_utc)

    def start(self) -> None:
        """Begin to read."""
        self._telescope.navigator.mount.listen(self._mount_said)
        self._begin()

    def _begin(self) -> None:
        self._task = begun(self._run(), f"watch {self._telescope.id}", died=self._died)

    def _died(self, fault: Exception) -> None:
        """Nobody reads it any more: what was last seen is not what is. Begin again."""
        self._take(replace(self._state, connected=False, problem=fault_words(fault)))
        self._begin()

    async def close(self) -> None:
        """Read no more."""
        await cancelled(self._task)
        self._task = None

    def wake(self) -> None:
        """Something happened: read at once."""
        self._wake.set()

    async def refresh(self) -> Snapshot:
        """Read the telescope once, now. Device trouble is part of what is returned."""
        async with self._turn:
            self._take(await self._telescope.state())
        return self.latest

    async def next(self, after_revision: int) -> Snapshot:
        """What is known next after a revision."""
        while self._revision <= after_revision:
            await self._news.wait()
        return self.latest

    async def _run(self) -> None:
        while True:
            try:
                await self.refresh()
            except asyncio.CancelledError:
                raise
            except Exception as fault:
                # one reading that fails in an unforeseen way must not blind the service for the night; what
                # was seen before is not what is
                words = fault_words(fault)
                if self._state.problem != words:
                    _log.exception("%s can't be watched", self._telescope.id)
                self._take(replace(self._state, connected=False, problem=words))
            self._wake.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(real_s(self._poll_s)):
                    await self._wake.wait()

    def _mount_said(self, what: str, facts: Mapping[str, object]) -> None:
        """A link that falls silent is reported at once: the reading that finds out may hang for seconds."""
        if not what.startswith("link"):
            return
        link = self._telescope.navigator.mount.link
        if link is not None and str(link) != self._state.link and self._state.connected:
            words = "" if str(link) == "up" else f"the mount gives no answer: its link is {link}"
            self._take(replace(self._state, link=str(link), problem=self._state.problem or words or None))
        self.wake()

    def _take(self, state: TelescopeState) -> None:
        self._still_since_utc = still_since(self._still_since_utc, self._state, state)
        self._state, self._utc = state, utc_now()
        self._revision += 1
        news, self._news = self._news, asyncio.Event()
        news.set()


def apparent_place(snapshot: Snapshot) -> Apparent | None:
    """Where the mount says it points, of date; None where it was not read."""
    state = snapshot.state
    if state.reading is None or not state.connected:
        return None
    if isinstance(state.reading.place, Apparent):
        return state.reading.place
    return None if state.icrs is None else icrs_to_apparent(state.icrs, state.reading.utc)
