"""A small scheduler: ten targets that are up now, each centered, looked at and written down; then park.

    mountnav serve --demo                                  # an observatory without hardware
    python docs/examples/ten_targets.py http://127.0.0.1:8000

It holds the telescope by a lease: if this program dies, the service parks the mount. Each order has a key of
its own, so that a lost answer never moves the telescope twice. What can't be done is written down as such.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from mountnav.client import Client, Job, JobFailed, ServiceError, SkyObject, orders, targets

LOWEST_DEG, HIGHEST_DEG = 30.0, 80.0
NEAREST_TO_POLE_DEG = 15.0
"""Beside the pole a frame hardly tells how the hour angle axis stands."""
TRIES = 2
READY_S, CENTERING_S, LOOK_S, PARK_S = 120.0, 600.0, 120.0, 300.0
HELD_BY_OTHERS = ("leased", "lease-lost", "unauthorized", "role-too-low")
"""Problems after which nothing more can be ordered: the night ends."""


@dataclass
class Observed:
    """A line of the night's record."""

    target: str
    outcome: str
    tries: int = 0
    error_arcsec: float | None = None
    seen_ra_deg: float | None = None
    seen_dec_deg: float | None = None
    problem: str | None = None
    finished_utc: str = ""


class Scheduler:
    """Runs one night on one telescope."""

    def __init__(
        self, client: Client, telescope_id: str, record: Path, tolerance_arcsec: float | None
    ) -> None:
        self.client = client
        self.telescope_id = telescope_id
        self.record = record
        self.tolerance_arcsec = tolerance_arcsec
        self.skills: set[str] = set()

    def run(self, wanted: int) -> list[Observed]:
        """Observe so many targets; fewer if there are no more, or if the telescope is taken from us."""
        self._wait_until_ready()
        found = {one["id"]: one for one in self.client.capabilities()["telescopes"]}
        if self.telescope_id not in found:
            raise SystemExit(f"there is no telescope {self.telescope_id}; there is: {', '.join(found)}")
        self.skills = set(found[self.telescope_id]["skills"])
        night: list[Observed] = []
        # falling silent parks the mount: nobody else is there to do it
        with self.client.lease(
            self.telescope_id, ttl_s=60.0, on_expiry="park", note="docs/examples/ten_targets.py"
        ) as lease:
            try:
                self._wake_up()
                for one in self._candidates():
                    if sum(line.outcome == "centered" for line in night) >= wanted:
                        break
                    lease.require()
                    self._recover_if_lost()
                    night.append(self._observe(one))
                    self._write(night[-1])
            finally:
                if lease.held:
                    self._park()
        return night

    def _wait_until_ready(self) -> None:
        """One that has just been started takes a moment to load its star catalogs."""
        until_s = time.monotonic() + READY_S
        while not (health := self.client.health())["ready"]:
            if time.monotonic() > until_s:
                raise SystemExit(f"the service is not ready: {'; '.join(health['why_not'])}")
            time.sleep(1.0)

    def _candidates(self) -> Iterator[SkyObject]:
        """Stars that stand well now, from west to east: those that set come first."""
        up = [
            one
            for one in self.client.objects(count=100)
            if one["kind"] == "star"
            and LOWEST_DEG <= (one["altitude_deg"] or 0.0) <= HIGHEST_DEG
            and abs(one["icrs"]["dec_deg"]) < 90.0 - NEAREST_TO_POLE_DEG
        ]
        yield from sorted(up, key=lambda one: -(one["azimuth_deg"] or 0.0))

    def _wake_up(self) -> None:
        if self.client.telescope(self.telescope_id)["parked"] and "unpark" in self.skills:
            self._done(self.client.order(self.telescope_id, orders.unpark()), PARK_S)

    def _recover_if_lost(self) -> None:
        """A mount that may have been moved or switched off is looked through before it is moved."""
        if self.client.telescope(self.telescope_id)["trusted"] is False:
            self._done(self._given(orders.recover()), CENTERING_S)

    def _observe(self, one: SkyObject) -> Observed:
        line = Observed(one["name"], "not tried")
        center = orders.center(targets.named(one["name"]), tolerance_arcsec=self.tolerance_arcsec)
        try:
            for line.tries in range(1, TRIES + 1):
                try:
                    job = self._done(self._given(center), CENTERING_S)
                    break
                except JobFailed as failed:
                    # clouds pass and mounts settle; a limit stays where it is
                    if not failed.retryable or line.tries == TRIES:
                        raise
            line.outcome = "centered"
            line.error_arcsec = (job["result"] or {})["error_after_arcsec"]
            seen = (self._done(self._given(orders.look()), LOOK_S)["result"] or {})["seen"]
            line.seen_ra_deg, line.seen_dec_deg = seen["ra_deg"], seen["dec_deg"]
        except TimeoutError as late:
            line.outcome, line.problem = "failed", str(late)
        except ServiceError as error:
            if error.slug in HELD_BY_OTHERS:
                raise
            if line.outcome != "centered":
                line.outcome = "not allowed" if error.slug == "outside-limits" else "failed"
            line.problem = f"{error.slug}: {error}"
        line.finished_utc = datetime.now(UTC).isoformat(timespec="seconds")
        return line

    def _given(self, order: orders.Order) -> Job:
        """Give an order; wait for whoever holds the telescope, and as long as the service says."""
        while True:
            try:
                return self.client.order(self.telescope_id, order)
            except ServiceError as error:
                if error.slug != "busy" or error.job_id is None:
                    raise
                self.client.wait(error.job_id, timeout_s=CENTERING_S)

    def _done(self, job: Job, timeout_s: float) -> Job:
        try:
            return self.client.succeeded(job, timeout_s=timeout_s)
        except TimeoutError:
            # nobody waits for it any more: it must not go on by itself
            self.client.cancel(job)
            raise

    def _park(self) -> None:
        """Park; where that can't be, at least nothing moves."""
        try:
            if "park" in self.skills:
                self._done(self._given(orders.park()), PARK_S)
                return
            why = "this mount can't"
        except (ServiceError, TimeoutError) as error:
            why = str(error)
        print(f"NOT PARKED: {why}", file=sys.stderr)
        self.client.stop(self.telescope_id)

    def _write(self, line: Observed) -> None:
        with self.record.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(line)) + "\n")
        what = f"{line.error_arcsec:.1f}″ off" if line.error_arcsec is not None else line.problem
        print(f"{line.target:20} {line.outcome:12} {what}", flush=True)


def main(arguments: list[str] | None = None) -> int:
    """Run the night; 0 only if all targets were centered."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("service", help="such as http://127.0.0.1:8000")
    parser.add_argument("--telescope", default="demo")
    parser.add_argument("--key", help="API key, where the service wants one")
    parser.add_argument("--targets", type=int, default=10)
    parser.add_argument("--tolerance-arcsec", type=float)
    parser.add_argument("--record", type=Path, default=Path("night.jsonl"))
    asked = parser.parse_args(arguments)
    with Client(asked.service, token=asked.key) as client:
        try:
            night = Scheduler(client, asked.telescope, asked.record, asked.tolerance_arcsec).run(
                asked.targets
            )
        except (ServiceError, TimeoutError) as error:
            print(f"the night ends: {getattr(error, 'slug', 'late')}: {error}", file=sys.stderr)
            return 2
    centered = sum(line.outcome == "centered" for line in night)
    print(f"{centered} of {asked.targets} targets centered, {len(night) - centered} not; see {asked.record}")
    return 0 if centered >= asked.targets else 1


if __name__ == "__main__":
    sys.exit(main())
