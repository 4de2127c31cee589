"""Figures of the running service for Prometheus: what happens is counted by events, the rest read when asked.

Names are ``mountnav_<what>_<unit>``, counters end in ``_total``. What isn't known is left out, never 0.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily, InfoMetricFamily
from prometheus_client.process_collector import ProcessCollector
from prometheus_client.registry import Collector

from api.events import Event, Events
from api.leases.leases import Leases
from api.orders.dispatcher import Dispatcher
from api.orders.job import ENDS
from api.orders.jobs import Jobs
from mountnav import __version__
from mountnav.clock import real_s, utc_now
from mountnav.devices import SyncOutcome
from mountnav.tasks import begun, cancelled

_SOLVE_S = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
"""Bucket bounds of the histogram of solve times, s: from a quick look (0.05) to the longest budget. Part of
the Prometheus interface: changed bounds break recorded dashboards."""
_OFFSETS_ARCSEC = (1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 120.0, 300.0, 900.0, 1800.0, 3600.0)
"""Bucket bounds of the histogram of pointing offsets, arcsec: from a good model (1) to lost (1°). As
above."""
_ENDS = tuple(str(end) for end in sorted(ENDS))
_SYNCS = {
    str(SyncOutcome.SEEN): "seen",
    str(SyncOutcome.LATE): "late",
    str(SyncOutcome.IGNORED): "ignored",
    str(SyncOutcome.ELSEWHERE): "elsewhere",
}
_T = ("telescope",)


class JournalHealth(Protocol):
    """The journal, as far as it is told here."""

    @property
    def problem(self) -> str | None:
        """Why it can't be written."""
        ...

    @property
    def waiting(self) -> int:
        """Rows that are not written yet."""
        ...


@dataclass(frozen=True, slots=True)
class Observed:
    """What is told of."""

    dispatcher: Dispatcher
    jobs: Jobs
    events: Events
    leases: Leases
    journal: JournalHealth


class Metrics:
    """All figures of one service, in registries of its own. Used from the event loop's thread alone."""

    def __init__(self, observed: Observed) -> None:
        self._observed = observed
        self._counted = _Counted([telescope.id for telescope in observed.dispatcher.telescopes])
        self.registry = self._counted.registry
        self.registry.register(_Now(observed))
        ProcessCollector(registry=self.registry)
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin to count."""
        # figures that stand still would say that nothing happens: count on
        self._task = begun(self._count(), "metrics", died=lambda _: self.start())

    async def close(self) -> None:
        """Count no more."""
        await cancelled(self._task)
        self._task = None

    def text(self, *others: CollectorRegistry) -> str:
        """The figures, and those of other registries, in Prometheus' text format."""
        return "".join(generate_latest(one).decode() for one in (self.registry, *others))

    async def _count(self) -> None:
        events = self._observed.events
        # what happened while the service was being put together counts as well
        async for event in events.follow(f"{events.run}-0"):
            self._counted.take(event)


class _Counted:
    """What happened, counted."""

    def __init__(self, telescopes: Iterable[str]) -> None:
        self.registry = CollectorRegistry()
        new = self.registry
        self.jobs = Counter("mountnav_jobs", "Jobs that ended.", ("telescope", "kind", "state"), registry=new)
        self.looks = Counter(
            "mountnav_looks", "Frames that were looked at.", ("telescope", "outcome"), registry=new
        )
        self.solving = Histogram(
            "mountnav_solve_duration_seconds",
            "From a frame to its solution, of frames that were solved.",
            _T,
            buckets=_SOLVE_S,
            registry=new,
        )
        self.offsets = Histogram(
            "mountnav_look_offset_arcseconds",
            "How far the telescope was seen from where the mount believed it.",
            _T,
            buckets=_OFFSETS_ARCSEC,
            registry=new,
        )
        self.syncs = Counter(
            "mountnav_syncs", "Syncs by what they came to.", ("telescope", "outcome"), registry=new
        )
        self.slews = Counter(
            "mountnav_slews", "Slews by how they ended.", ("telescope", "outcome"), registry=new
        )
        self.stops = Counter("mountnav_stops", "Stops that were sent to a mount.", _T, registry=new)
        self.limit_stops = Counter(
            "mountnav_limit_stops", "Stops at a limit while tracking.", _T, registry=new
        )
        self.expired = Counter(
            "mountnav_leases_expired",
            "Leases whose holders fell silent.",
            ("telescope", "on_expiry"),
            registry=new,
        )
        self.missed = Counter(
            "mountnav_events_missed", "Events that these figures do not know of.", registry=new
        )
        self.last_offset = _LastOffset()
        self.registry.register(self.last_offset)
        for telescope in telescopes:
            # zero is known: nothing has happened yet
            for outcome in ("solved", "unsolved"):
                self.looks.labels(telescope, outcome)
            for outcome in (*_SYNCS.values(), "refused", "undone"):
                self.syncs.labels(telescope, outcome)
            for one in (self.solving, self.offsets, self.stops, self.limit_stops):
                one.labels(telescope)

    def take(self, event: Event) -> None:
        """Count one event."""
        data = event.data
        telescope = str(data.get("telescope") or "")
        match event.kind:
            case "job" if data.get("state") in _ENDS:
                self.jobs.labels(telescope, str(data.get("kind")), str(data["state"])).inc()
            case "solved":
                self.looks.labels(telescope, "solved").inc()
                if (solve_s := _number(data.get("solve_s"))) is not None:
                    self.solving.labels(telescope).observe(solve_s)
                if (offset_arcsec := _number(data.get("offset_arcsec"))) is not None:
                    self.offsets.labels(telescope).observe(offset_arcsec)
                    self.last_offset.told[telescope] = data
            case "not-solved":
                self.looks.labels(telescope, "unsolved").inc()
            case "synced":
                self.syncs.labels(telescope, _SYNCS.get(str(data.get("outcome")), "seen")).inc()
            case "sync-refused":
                self.syncs.labels(telescope, "refused").inc()
            case "sync-undone":
                self.syncs.labels(telescope, "undone").inc()
            case "slewed":
                self.slews.labels(telescope, str(data.get("outcome"))).inc()
            case "stopped":
                self.stops.labels(telescope).inc()
            case "limit-stop":
                self.limit_stops.labels(telescope).inc()
            case "lease-expired":
                self.expired.labels(telescope, str(data.get("on_expiry"))).inc()
            case "gap":
                self.missed.inc()
            case _:
                return


class _LastOffset(Collector):
    """The offset of each telescope's last solved look."""

    def __init__(self) -> None:
        self.told: dict[str, dict[str, object]] = {}

    def collect(self) -> Iterator[GaugeMetricFamily]:
        family = GaugeMetricFamily(
            "mountnav_last_look_offset_arcseconds",
            "Seen minus believed of the last solved look; east and north positive.",
            labels=("telescope", "direction"),
        )
        for telescope, data in self.told.items():
            for direction in ("east", "north"):
                value = _number(data.get(f"offset_{direction}_arcsec"))
                if value is not None:
                    family.add_metric((telescope, direction), value)
        yield family


class _Now(Collector):
    """How things stand at the moment somebody asks. Asks no device."""

    def __init__(self, observed: Observed) -> None:
        self._observed = observed

    def collect(self) -> Iterator[GaugeMetricFamily | InfoMetricFamily]:
        yield InfoMetricFamily("mountnav_build", "What runs here.", value={"version": __version__})
        yield from self._telescopes()
        yield from self._service()

    def _telescopes(self) -> Iterator[GaugeMetricFamily]:
        def gauge(name: str, text: str, *more: str) -> GaugeMetricFamily:
            return GaugeMetricFamily(f"mountnav_telescope_{name}", text, labels=("telescope", *more))

        connected = gauge("connected", "Whether the mount can be read.")
        flags = {
            "slewing": gauge("slewing", "Whether it slews, or was ordered to."),
            "tracking": gauge("tracking", "Whether it follows the sky, as the mount says."),
            "parked": gauge("parked", "Whether it is parked, as the mount says."),
            "trusted": gauge("trusted", "Whether the mount's position is trusted."),
        }
        places = {
            "altitude_deg": gauge("altitude_degrees", "Where it believes it points."),
            "azimuth_deg": gauge("azimuth_degrees", "Where it believes it points."),
        }
        link = gauge("link", "State of the link to the mount: 1 for the state that it is in.", "state")
        age = gauge("state_age_seconds", "Since the mount's state was read last.")
        leased = gauge("leased", "Whether somebody holds the telescope.")
        running = gauge("job_running", "Whether a job holds the telescope.")
        rates = gauge("offset_rate_arcseconds_per_second", "Rates beside the sidereal one.", "axis")
        left = gauge("offset_rate_seconds_left", "Until those rates end by themselves.")
        moved = gauge("axis_moved", "Whether an axis is moved by hand.")
        off = gauge("followed_offset_arcseconds", "Of a target that is followed, as the last look saw it.")
        now = utc_now()
        for telescope in self._observed.dispatcher.telescopes:
            name = (telescope.id,)
            snapshot = self._observed.dispatcher.watch(telescope.id).latest
            state, reading = snapshot.state, snapshot.state.reading
            connected.add_metric(name, float(state.connected))
            known = {
                "slewing": snapshot.slewing if state.connected else None,
                "tracking": None if reading is None else reading.tracking,
                "parked": None if reading is None else reading.parked,
                "trusted": state.trusted,
            }
            for flag, value in known.items():
                if value is not None:
                    flags[flag].add_metric(name, float(value))
            for place, family in places.items():
                if (degrees := _number(getattr(state, place))) is not None:
                    family.add_metric(name, degrees)
            if state.link is not None:
                link.add_metric((telescope.id, state.link), 1.0)
            age.add_metric(name, max(0.0, real_s((now - snapshot.utc).total_seconds())))
            leased.add_metric(name, float(self._observed.leases.of(telescope.id) is not None))
            running.add_metric(name, float(snapshot.job is not None))
            mount = telescope.navigator.mount
            moved.add_metric(name, float(mount.axis_moving))
            force = mount.offset_rates_in_force
            if force is not None:
                rates.add_metric((telescope.id, "ra"), force.rates.ra_arcsec_s)
                rates.add_metric((telescope.id, "dec"), force.rates.dec_arcsec_s)
                left.add_metric(name, max(0.0, (force.ends_utc - now).total_seconds()))
            followed = {} if snapshot.job is None else snapshot.job.progress
            if (off_arcsec := _number(followed.get("off_arcsec"))) is not None:
                off.add_metric(name, off_arcsec)
        yield from (rates, left, moved, off)
        yield from (connected, *flags.values(), *places.values(), link, age, leased, running)

    def _service(self) -> Iterator[GaugeMetricFamily]:
        journal = self._observed.journal
        writable = GaugeMetricFamily("mountnav_journal_writable", "Whether the journal can be written.")
        writable.add_metric((), float(journal.problem is None))
        waiting = GaugeMetricFamily("mountnav_journal_waiting_rows", "Rows that are not written yet.")
        waiting.add_metric((), float(journal.waiting))
        events = GaugeMetricFamily("mountnav_events_last_number", "Number of the last event of this run.")
        events.add_metric((), float(self._observed.events.last))
        yield from (writable, waiting, events)


def _number(value: object) -> float | None:
    """A finite number, or nothing."""
    if isinstance(value, int | float) and math.isfinite(value):
        return float(value)
    return None


__all__ = ["Metrics", "Observed"]
