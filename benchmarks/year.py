"""A year in fast time: night after night at two telescopes, with what happens to an observatory in a year.

Run: python -m benchmarks.year --into FILE [--nights 365] [--seed 1] [--targets 4] [--verbose]

One service (`benchmarks.year_service`: the real one) drives two fake mounts with simulated cameras, at 60
times the pace; the days between are passed over. Each night a program of targets is centered on both at once
by HTTP, then both are parked. By the seed the service is killed or ended, a mount loses its power, the
journal's disk is full for a while, an older journal is restored and upgraded, the service's clock steps by
minutes or an hour, keys are renewed, the catalog is exchanged, backups are made.

After each night the journal is compared with what was ordered and with what the simulator knows: each order
has an outcome, each job an end, and the morning report names the targets, their errors (against where the
tube truly looked at each look), the runs and the troubles of that night, and no others. Memory, descriptors,
threads, files and their sizes are noted. FILE gets a line a night; run again it goes on where it ended. The
exit code is 1 when anything was wrong, or when something grew that may not.
"""

from __future__ import annotations

import argparse
import http.client
import itertools
import json
import os
import random
import resource
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from api.access.callers import Role
from api.access.keys import KeyStore
from benchmarks.faces_load import children
from mountnav.clock import utc_now
from mountnav.journal.audit_chain import prove, read_audit_key
from mountnav.journal.backup import back_up, restore
from mountnav.journal.database import audit_key_beside, database_url
from mountnav.journal.reading import JournalReader, Wanted
from mountnav.journal.upkeep import check
from mountnav.night.daylight import dark_from
from mountnav.night.morning_report import MorningReport, night_of, report_of
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_observed
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import separation_arcsec

SITE, AIR = Site(48.93, 22.27, 700.0), Air(930.0, 5.0, 0.7)
BEGIN = datetime(2026, 12, 1, 12, 0, tzinfo=UTC)
SPEED = 60.0
"""Virtual seconds a second: the most that `[demo] speed` takes."""
TELESCOPES = ("east", "west")
LOOKS_KEPT_DAYS, KEPT_DAYS, AUDIT_KEPT_DAYS = 8.0, 14.0, 20.0
"""Short, so that what is removed is removed within the nights that are run."""
EVENTS_KEPT, JOBS_KEPT = 300, 100
"""The same for what a service remembers: by default 1000 of each, full after 125 such nights."""
BACKUPS_KEPT = 3
_ORDERS = ("slew", "sync", "park", "home")
"""Orders that are written before they are sent, and noted by the mount before they are carried out."""
_ON_ITS_WAY = timedelta(minutes=10)
"""So long an order may take from its row to the mount: 10 s of a loaded machine."""
_TRIES = 25
"""So often a target is tried, a second apart, before the night counts as lost: longer than events last."""
TRUE_ARCSEC = 15.0
"""A stated error agrees with the truth to so much: what a mount moves within an exposure after a slew."""
_NOT_ALLOWED = "slew refused: the slew isn't allowed"
"""What a report says of a way that the limits forbid."""
OLD = Path(__file__).parents[1] / "tests" / "journal" / "version_1.sql"
"""A journal as the first version wrote it."""
PROTOCOLS = {"east": "fake+lx200://?dialect=onstep", "west": "fake+ioptron://"}

EVENTS = (
    "kill",
    "end",
    "power-cut",
    "disk-full",
    "old-journal",
    "clock-minutes",
    "clock-hour",
    "key",
    "catalog",
    "backup",
)
SHARE = 0.5
"""Nights to which something happens."""

SETTINGS = """
[demo]
at = {at}
speed = {speed}
seed = {seed}
[service]
port = 0
keys_file = "{folder}/keys.json"
log_level = "warning"
events_kept = {events_kept}
jobs_kept = {jobs_kept}
[journal]
url = "{folder}/journal.sqlite"
keep_days = {kept}
looks_keep_days = {looks_kept}
audit_keep_days = {audit_kept}
[solving]
blind = "never"
{catalogs}
[site]
latitude_deg = 48.93
longitude_deg = 22.27
height_m = 700.0
[air]
pressure_hpa = 930.0
temperature_c = 5.0
relative_humidity = 0.7
"""
ONE = """
[[telescope]]
id = "{name}"
exposure_s = 2.0
scale_arcsec_px = 6.0
[telescope.mount]
url = "{url}"
mounting = "german"
slew_rate_deg_s = 6.0
[telescope.mount.errors]
ih_arcsec = {ih}
id_arcsec = -240.0
ch_arcsec = 60.0
me_arcsec = 120.0
ma_arcsec = -90.0
backlash_arcsec = 4.0
periodic_amplitude_arcsec = 3.0
[telescope.camera]
kind = "simulated"
width_px = 512
height_px = 400
scale_arcsec_px = 6.0
[telescope.centering]
tolerance_arcsec = 30.0
timeout_s = 60.0
max_sync_arcsec = 7200.0
[telescope.sync]
max_age_s = 1800
[telescope.limits]
untrusted_tracking_s = 40000
[telescope.night]
enabled = true
"""
"""A loaded machine takes seconds for a solve, minutes of the sky: bounds in sky time are made wide."""


@dataclass
class Job:
    """An order of the program, what was said of it, and the truth.

    Attributes
    ----------
    state : str
        As the job ended; ``refused`` when it never began, ``cut off`` when the service died meanwhile.
    looks : list of (str, float)
        When it was looked, and how far off the target the tube truly was then, arcsec.
    """

    telescope: str
    kind: str
    ra_deg: float
    dec_deg: float
    ordered: str
    took_s: float = 0.0
    id: str = ""
    state: str = "refused"
    problem: str = ""
    ended: str = ""
    looks: list[tuple[str, float]] = field(default_factory=list)
    at_end_arcsec: float = 0.0


@dataclass
class Night:
    """A line of FILE."""

    number: int
    date: str
    events: list[str] = field(default_factory=list)
    jobs: list[Job] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)
    ends: str = ""
    starts: int = 0
    catalog: str = "embedded"
    """The one that is exchanged for it ends at 10.5 mag: some fields show too few of its stars."""
    life: int = 0
    stepped_s: float = 0.0
    """By so much the service's clock was put on, and back again."""


class Died(Exception):
    """The service is gone."""


class Service:
    """The service of the year, as its operator and its clients have it."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.seed = folder, seed
        self.process: subprocess.Popen[str] | None = None
        self.secret = ""
        self.catalogs = ""
        self.lives = 0
        self.begun: list[tuple[datetime, int]] = []
        """Each start, and the number of the journal that it was written into."""
        self.journals = 0
        self.port = 0
        self._speaking = threading.Lock()
        self.log = folder / "log"

    @property
    def journal(self) -> Path:
        """Its file."""
        return self.folder / "journal.sqlite"

    @property
    def keys(self) -> KeyStore:
        """Its keys, as `mountnav key` changes them."""
        return KeyStore(self.folder / "keys.json")

    def start(self, at: datetime) -> None:
        """Begin at a virtual instant, and wait until it answers."""
        settings = self.folder / "observatory.toml"
        settings.write_text(self.settings(at), encoding="utf-8")
        environment = {
            **os.environ,
            "XDG_STATE_HOME": str(self.folder / "state"),
            "MOUNTNAV_RUN": str(self.folder / "run"),
            "MOUNTNAV_CATALOGS": str(self.folder / "catalogs"),
        }
        with self.log.open("a", encoding="utf-8") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "benchmarks.year_service", str(settings), "0", self.truth_file],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=environment,
            )
        self.lives += 1
        self.begun.append((at, self.journals))
        assert self.process.stdout is not None
        told = self.process.stdout.readline()
        if " at http://" not in told:
            raise SystemExit(f"the service did not start: {told}{self.log.read_text()[-4000:]}")
        self.port = int(told.split(" at http://127.0.0.1:")[1].split()[0])
        while self.ask("GET", "/v1/health")[0] != 200:
            time.sleep(0.1)

    @property
    def truth_file(self) -> str:
        """Where the orders that reach its mounts are noted."""
        return str(self.folder / "truth.jsonl")

    def settings(self, at: datetime) -> str:
        """The file."""
        text = SETTINGS.format(
            at=at.isoformat(),
            speed=SPEED,
            seed=self.seed,
            folder=self.folder,
            kept=KEPT_DAYS,
            events_kept=EVENTS_KEPT,
            jobs_kept=JOBS_KEPT,
            looks_kept=LOOKS_KEPT_DAYS,
            audit_kept=AUDIT_KEPT_DAYS,
            catalogs=self.catalogs,
        )
        return text + "".join(
            ONE.format(name=name, url=PROTOCOLS[name], ih=300.0 if name == "east" else -450.0)
            for name in TELESCOPES
        )

    def order(self, **asked: Any) -> dict[str, Any]:
        """Have something happen to the observatory."""
        assert self.process is not None
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        with self._speaking:
            try:
                self.process.stdin.write(json.dumps(asked) + "\n")
                self.process.stdin.flush()
            except OSError as gone:
                raise Died from gone
            while line := self.process.stdout.readline():
                if line.startswith("@"):
                    told: dict[str, Any] = json.loads(line[1:])
                    if "wrong" in told:
                        raise SystemExit(f"{asked}: {told['wrong']}")
                    return told
        raise Died

    def ask(self, method: str, path: str, body: object = None, *, key: str | None = None) -> tuple[int, Any]:
        """Ask by HTTP; raises `Died` when nobody answers."""
        link = http.client.HTTPConnection("127.0.0.1", self.port, timeout=180)
        headers = {"authorization": f"Bearer {key or self.secret}"}
        if body is not None:
            headers["content-type"] = "application/json"
        try:
            link.request(method, path, None if body is None else json.dumps(body), headers)
            answer = link.getresponse()
            content = answer.read()
            return answer.status, json.loads(content) if content else None
        except (OSError, http.client.HTTPException) as gone:
            raise Died from gone
        finally:
            link.close()

    def now(self) -> datetime:
        """By the service's clock."""
        return datetime.fromisoformat(self.order(do="now")["utc"])

    def end(self, number: int) -> None:
        """Send it a signal, and wait for its end."""
        assert self.process is not None
        of_it = children(self.process.pid)
        self.process.send_signal(number)
        try:
            self.process.wait(120)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise SystemExit("the service does not end") from None
        deadline_s = time.monotonic() + 30.0
        while left := [one for one in of_it if Path(f"/proc/{one}").exists() and not _is_zombie(one)]:
            if time.monotonic() > deadline_s:
                raise SystemExit(f"processes of the service outlive it: {left}")
            time.sleep(0.05)
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            with suppress(OSError):
                pipe.close()
        self.process = None

    def limit_files(self, size: int) -> None:
        """Let no file of it grow beyond this."""
        assert self.process is not None
        resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

    def figures(self) -> dict[str, float]:
        """What it takes now."""
        assert self.process is not None
        pid = self.process.pid
        status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
        read = {
            name: more.split()[0]
            for name, _, more in (line.partition(":") for line in status.splitlines())
            if more.strip()
        }
        of_it = children(pid)
        files = [path for path in self.folder.rglob("*") if path.is_file()]
        size = {path: path.stat().st_size for path in files if path.exists()}
        return {
            "rss_mb": int(read["VmRSS"]) / 1000.0,
            # without pages of files, such as those of a catalog, which the system takes back
            "own_mb": int(read["RssAnon"]) / 1000.0,
            "children": len(of_it),
            "children_mb": sum(_rss_mb(one) for one in of_it),
            "threads": int(read["Threads"]),
            "descriptors": len(list(Path(f"/proc/{pid}/fd").iterdir())),
            "files": len(files),
            "files_mb": sum(size.values()) / 1e6,
            "journal_mb": sum(
                size.get(self.journal.with_name(self.journal.name + end), 0) for end in ("", "-wal", "-shm")
            )
            / 1e6,
        }


def _rss_mb(pid: int) -> float:
    with suppress(OSError):
        return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * 4096 / 1e6
    return 0.0


def _is_zombie(pid: int) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] == "Z"
    return True


class Year:
    """All nights, one after the other."""

    def __init__(
        self, into: Path, seed: int, targets: int, *, verbose: bool, only: Sequence[str] = ()
    ) -> None:
        self.into, self.seed, self.targets, self.verbose = into, seed, targets, verbose
        self.only = only
        self.folder = into.with_name(into.name + ".state").absolute()
        self.folder.mkdir(parents=True, exist_ok=True)
        self.service = Service(self.folder, seed)
        self.nights = list(_read(into))
        self.said: dict[tuple[str, str], dict[str, Any]] = {}

    def run(self, nights: int) -> None:
        """Live through so many in all."""
        done = len(self.nights)
        at = self._resumed() if self.nights else BEGIN
        self.service.lives = self.nights[-1].life if self.nights else 0
        if not self.nights:
            _old_journal(self.service.journal, "0001")
        self._first_key()
        try:
            for number in range(done, nights):
                if self.service.process is None:
                    self.service.start(at)
                night = self.night(number)
                at = datetime.fromisoformat(night.ends)
                self.nights.append(night)
                with self.into.open("a", encoding="utf-8") as opened:
                    opened.write(json.dumps(asdict(night)) + "\n")
                self.tell(night)
        finally:
            if self.service.process is not None:
                self.service.end(signal.SIGTERM)

    def _resumed(self) -> datetime:
        """Where the last whole night ended; a night that was cut off is passed over, its rows stay."""
        at = datetime.fromisoformat(self.nights[-1].ends)
        last = check(database_url(self.service.journal)).last_utc
        while last is not None and last > at + timedelta(hours=1):
            at += timedelta(days=1)
        return at

    def _first_key(self) -> None:
        name = f"scheduler-{int(time.time() * 1000)}"
        _, self.service.secret = self.service.keys.new(name, Role.CONFIGURE)
        for key in self.service.keys.readable():
            if key.name != name:
                self.service.keys.revoke(key.name)
        self._key = name

    def night(self, number: int) -> Night:
        """One of them, from noon to noon."""
        chance = random.Random(f"{self.seed} {number}")
        service = self.service
        noon = service.now()
        date = (noon + timedelta(hours=SITE.longitude_deg / 15.0)).date().isoformat()
        night = Night(number, date)
        if self.only:
            night.events = [chance.choice(list(self.only))]
        elif chance.random() < SHARE:
            night.events = [chance.choice(EVENTS)]
        event = night.events[0] if night.events else ""
        kept: Path | None = None
        if event == "old-journal":
            kept = self._old(chance, noon, night)
        elif event == "catalog":
            self._exchange_catalog(noon, night)
        night.catalog = "bright" if service.catalogs else "embedded"
        self._pass(dark_from(service.now(), SITE), night)
        self._work(night, event, chance)
        self._park(night)
        noon_after = datetime.fromisoformat(f"{date}T12:00:00+00:00") + timedelta(
            days=1, hours=-SITE.longitude_deg / 15.0, minutes=5
        )
        self._pass(noon_after, night)
        self._judge(night)
        night.figures = {**service.figures(), **_rows(service.journal)}
        if kept is not None:
            service.end(signal.SIGTERM)
            restore(kept, service.journal, utc_now())
            service.journals -= 1
            for path in self.folder.glob("journal.sqlite.before-*"):
                path.unlink()
            kept.unlink()
            service.start(noon_after)
        night.ends = service.now().isoformat()
        night.life = service.lives
        return night

    # -- what a night is made of -------------------------------------------------------------------

    def _pass(self, until: datetime, night: Night) -> None:
        """Let the time pass until then; a mount that still tracks or moves is waited for."""
        service, deadline_s = self.service, time.monotonic() + 60.0
        while until > service.now():
            status, told = service.ask("POST", "/v1/virtual/skip", {"until": until.isoformat()})
            if status == 200:
                break
            if status != 409 or time.monotonic() > deadline_s:
                night.faults.append(f"the time can't pass: {status} {told}")
                self._save(night)
                break
            for name in TELESCOPES:  # a mount that was just switched on tracks
                if service.ask("GET", f"/v1/telescopes/{name}")[1]["tracking"]:
                    service.ask("POST", f"/v1/telescopes/{name}/tracking?wait=20", {"on": False})
            time.sleep(0.3)

    def _save(self, night: Night) -> None:
        """End and start the service: its mounts stand then."""
        at = self.service.now()
        self.service.end(signal.SIGTERM)
        self.service.start(at)

    def _work(self, night: Night, event: str, chance: random.Random) -> None:
        """The program of both telescopes, and the event on the way."""
        seeds = {name: chance.random() for name in TELESCOPES}
        after = chance.randint(1, max(1, self.targets - 1))
        delay_s, who = chance.uniform(0.0, 1.5), chance.choice(TELESCOPES)
        reached = threading.Event()
        gate = threading.Lock()  # held while the service is down
        threads = [
            threading.Thread(
                target=self._program,
                args=(night, name, seeds[name], gate, reached, after if name == who else -1),
            )
            for name in TELESCOPES
        ]
        for one in threads:
            one.start()
        reached.wait(300.0)
        time.sleep(delay_s)
        try:
            self._happen(night, event, who, chance, gate)
        finally:
            for one in threads:
                one.join()

    def _program(
        self, night: Night, name: str, seed: float, gate: threading.Lock, reached: threading.Event, after: int
    ) -> None:
        chance = random.Random(seed)
        try:
            for number in range(self.targets):
                if number == after:
                    reached.set()
                for _ in range(_TRIES):
                    try:
                        with gate:
                            self.service.now()
                        self._unpark(night, name)
                        job = self._one(name, chance)
                    except Died:
                        time.sleep(0.05)
                        continue
                    night.jobs.append(job)
                    if job.state == "succeeded":
                        break
                    # as a scheduler does: once more, a little later
                    time.sleep(1.0)
                else:
                    night.faults.append(f"{name}: no target could be centered any more: {job.problem}")
                    break
        except BaseException as wrong:  # told by the night, whatever it is
            night.faults.append(f"{name}: the program ended by {type(wrong).__name__}: {wrong}")
            raise
        finally:
            reached.set()

    def _unpark(self, night: Night, name: str) -> None:
        """Before the first target, and after whatever made it park or begin anew."""
        status, told = self.service.ask("GET", f"/v1/telescopes/{name}")
        if status == 200 and told["parked"]:
            night.jobs.append(self._carried_out(name, "unpark"))

    def _one(self, name: str, chance: random.Random) -> Job:
        """Center a target."""
        service = self.service
        sky = datetime.fromisoformat(service.order(do="now")["sky_utc"])
        while True:
            place = HourAngle(chance.uniform(-60.0, 60.0), chance.uniform(0.0, 70.0), sky)
            target = hour_angle_to_icrs(place, SITE, AIR)
            if icrs_to_observed(target, sky, SITE, AIR).alt_deg > 30.0:
                break
        return self._carried_out(name, "center", target)

    def _carried_out(self, name: str, kind: str, target: Icrs | None = None) -> Job:
        service = self.service
        job = Job(
            name,
            kind,
            0.0 if target is None else target.ra_deg,
            0.0 if target is None else target.dec_deg,
            service.now().isoformat(),
        )
        body = {} if target is None else {"ra_deg": target.ra_deg, "dec_deg": target.dec_deg}
        lives, began_s = service.lives, time.monotonic()
        status, told = service.ask("POST", f"/v1/telescopes/{name}/{kind}", body)
        if status not in (200, 202):
            job.problem = f"{status} {told.get('type', '')} {told.get('detail', '')}"
            return job
        job.id, job.state = told["id"], "cut off"
        try:
            while told.get("state") in ("queued", "running"):
                status, told = service.ask("GET", f"/v1/jobs/{job.id}?wait=60")
                if status != 200:
                    job.problem = f"{status} {told}"
                    return job
            job.state, job.ended = told["state"], told["finished_utc"]
            job.took_s = time.monotonic() - began_s
            if told.get("problem"):
                job.problem = f"{told['problem'].get('type', '')} {told['problem'].get('detail', '')}"
            if target is not None:
                self._ask_truth(job, target)
        except Died:
            if service.lives == lives and job.state == "cut off":
                job.problem = "the service died"
        return job

    def _ask_truth(self, job: Job, target: Icrs) -> None:
        looks = JournalReader(self.service.journal).looks(Wanted(job_id=job.id))
        # those by which a lost mount was found are of another place
        looks = [one for one in looks if one.used == "centering" and one.solved]
        utcs = [*(one.utc.isoformat() for one in looks), self.service.now().isoformat()]
        told = self.service.order(do="truth", telescope=job.telescope, utcs=utcs)
        off = [separation_arcsec(Icrs(*place), target) for place in told["places"]]
        job.looks, job.at_end_arcsec = list(zip(utcs[:-1], off, strict=False)), off[-1]

    def _park(self, night: Night) -> None:
        for name in TELESCOPES:
            for _ in range(20):
                try:
                    job = self._carried_out(name, "park")
                except Died:
                    night.faults.append("the service died by itself")
                    return
                night.jobs.append(job)
                if job.state == "succeeded":
                    break
                time.sleep(1.0)
        for name in TELESCOPES:
            if not any(
                one.kind == "park" and one.telescope == name and one.state == "succeeded"
                for one in night.jobs
            ):
                night.faults.append(f"{name} could not be parked: {night.jobs[-1].problem}")

    # -- what happens ------------------------------------------------------------------------------

    def _happen(
        self, night: Night, event: str, who: str, chance: random.Random, gate: threading.Lock
    ) -> None:
        service = self.service
        match event:
            case "kill" | "end":
                with gate:
                    at = service.now()
                    service.end(signal.SIGKILL if event == "kill" else signal.SIGTERM)
                    service.start(at + timedelta(seconds=chance.uniform(30.0, 600.0)))
            case "power-cut":
                for_s = chance.uniform(500.0, 900.0)
                service.order(do="power-cut", telescope=who, for_s=for_s)
                night.events.append(f"{who} for {for_s:.0f} s")
                time.sleep(for_s / SPEED)
            case "disk-full":
                service.limit_files(40_000)
                try:
                    time.sleep(chance.uniform(2.0, 6.0))
                finally:
                    service.limit_files(resource.RLIM_INFINITY)
            case "clock-minutes" | "clock-hour":
                by_s = chance.choice((-1.0, 1.0)) * (
                    3600.0 if event == "clock-hour" else chance.uniform(30.0, 400.0)
                )
                night.stepped_s = by_s
                service.order(do="step", by_s=by_s)
                night.events.append(f"{by_s:.0f} s")
                time.sleep(chance.uniform(2.0, 5.0))
                service.order(do="step", by_s=-by_s)
            case "key":
                before = service.secret
                _, service.secret = service.keys.renew(self._key, overlap=timedelta(0))
                deadline_s = time.monotonic() + 20.0
                while service.ask("GET", "/v1/telescopes", key=before)[0] != 401:
                    if time.monotonic() > deadline_s:
                        night.faults.append("a key that was renewed opens still")
                        break
                    time.sleep(0.1)
                if (status := service.ask("GET", "/v1/telescopes")[0]) != 200:
                    night.faults.append(f"the new key is answered by {status}")
            case "backup":
                target = self.folder / "backups"
                target.mkdir(exist_ok=True)
                made = back_up(service.journal, target, service.now())
                if damage := check(database_url(made)).damage:
                    night.faults.append(f"the backup is damaged: {damage}")
                for old in sorted(target.iterdir())[:-BACKUPS_KEPT]:
                    old.unlink()

    def _old(self, chance: random.Random, at: datetime, night: Night) -> Path:
        """Put an older mountnav's journal in the journal's place, as from an old backup."""
        service = self.service
        service.end(signal.SIGTERM)
        kept = back_up(service.journal, self.folder / "present.sqlite", at, force=True)
        version = chance.choice(("0001", "0002", "0003"))
        old = self.folder / "old.sqlite"
        _old_journal(old, version)
        night.events.append(version)
        restore(old, service.journal, utc_now())
        old.unlink()
        service.journals += 1
        service.start(at)
        return kept

    def _exchange_catalog(self, at: datetime, night: Night) -> None:
        """Solve by another catalog from this night on."""
        service = self.service
        service.end(signal.SIGTERM)
        service.catalogs = "" if service.catalogs else self._bright_catalog()
        night.events.append(service.catalogs.replace("\n", " ") or "embedded")
        service.start(at)

    def _bright_catalog(self) -> str:
        folder = self.folder / "catalogs"
        if not (folder / "bright.mnc").exists():
            subprocess.run(
                [
                    *(sys.executable, "-m", "api.main", "catalog", "import", "gaia-bright"),
                    *(
                        "--name",
                        "bright",
                        "--folder",
                        str(folder),
                        "--dec-range",
                        "-12",
                        "82",
                        "--mag-limit",
                        "10.5",
                        "--force",
                    ),
                ],
                check=True,
                capture_output=True,
            )
        return '[catalogs]\nuse = ["bright"]\n'

    # -- what came of it ---------------------------------------------------------------------------

    def _judge(self, night: Night) -> None:
        service = self.service
        reader = JournalReader(service.journal)
        for command in reader.in_flight():
            if command.run_id if hasattr(command, "run_id") else True:
                night.faults.append(
                    f"the {command.order} of {command.telescope} at {command.utc:%H:%M:%S} is open"
                )
        for job in night.jobs:
            if not job.id:
                continue
            row = reader.job(job.id)
            if row is None:
                night.faults.append(f"{job.telescope}: the job {job.kind} of {job.ordered} is lost")
            elif row.finished_utc is None:
                night.faults.append(f"{job.telescope}: the job {job.kind} of {job.ordered} never ended")
            elif job.state not in ("cut off", str(row.state)):
                night.faults.append(f"{job.telescope}: a job said {job.state}, and is written as {row.state}")
        since, until = night_of(night.date, SITE)
        # a restored journal is a second one: what was begun before it was restored stands in the first
        mine = [utc for utc, number in service.begun if number == service.journals]
        night.starts = sum(since <= utc < until for utc in mine)
        for name in TELESCOPES:
            report = report_of(reader, name, since, until)
            night.faults += [f"report of {name}: {wrong}" for wrong in compared(report, night, name)]
            night.faults += list(self._unwritten(night, reader, name, since, until))
        self._audit(night)

    def _unwritten(
        self, night: Night, reader: JournalReader, name: str, since: datetime, until: datetime
    ) -> Iterator[str]:
        """Orders that reached a mount without a row of their own, written before they came."""
        stepped = timedelta(seconds=abs(night.stepped_s))
        rows = [
            (command.order, command.utc)
            for command, _ in reader.commands(Wanted(telescope=name, since=since, until=until))
        ]
        for line in Path(self.service.truth_file).read_text(encoding="utf-8").splitlines():
            read = json.loads(line)
            came = datetime.fromisoformat(read["utc"])
            if read["telescope"] != name or read["order"] not in _ORDERS or not since <= came < until:
                continue
            # its clock may have been put on or back between the row and the mount
            own = [
                row
                for row in rows
                if row[0] == read["order"] and came - _ON_ITS_WAY - stepped < row[1] <= came + stepped
            ]
            if own:
                rows.remove(max(own, key=lambda row: row[1]))
            else:
                yield f"a {read['order']} reached {name} at {came:%H:%M:%S} that is not written"

    def _audit(self, night: Night) -> None:
        journal = self.service.journal
        proof = prove(database_url(journal), [read_audit_key(audit_key_beside(str(journal)))], [])
        if proof.fault is not None:
            night.faults.append(f"the audit is broken: {proof.fault.what}")

    def tell(self, night: Night) -> None:
        """Print a line."""
        ends = [f"{one.state}" for one in night.jobs if one.kind == "center"]
        counts = ", ".join(f"{ends.count(end)} {end}" for end in sorted(set(ends)))
        shown = {name: round(value, 1) for name, value in night.figures.items()}
        print(
            f"{night.number:3} {night.date} {' '.join(night.events) or '-':24} {counts}; "
            f"{len(night.faults)} wrong; {shown if self.verbose else shown.get('rss_mb')}",
            flush=True,
        )
        for wrong in night.faults:
            print(f"      {wrong}", flush=True)


def compared(report: MorningReport, night: Night, name: str) -> Iterator[str]:
    """What a report says wrong of a night."""
    event = night.events[0] if night.events else ""
    jobs = [one for one in night.jobs if one.telescope == name and one.kind == "center" and one.id]
    ended = [one for one in jobs if one.state != "cut off"]
    cut = [one for one in jobs if one.state == "cut off"]
    # one that was refused for want of room is written down later, if it is
    unwritten = sum(
        one.telescope == name and one.kind == "center" and "journal-failed" in one.problem and not one.id
        for one in night.jobs
    )
    if not len(jobs) <= len(report.centerings) <= len(jobs) + unwritten:
        yield f"{len(report.centerings)} targets, and {len(jobs)} were begun ({len(cut)} cut off)"
    right = [one for one in ended if one.state == "succeeded"]
    if report.centered != len(right):
        yield f"{report.centered} were centered, and {len(right)} truly"
    told = sorted((one for one in report.centerings if one.succeeded), key=lambda one: one.utc)
    for one, job in zip(told, sorted(right, key=lambda job: job.ended), strict=False):
        if not job.looks or one.error_after_arcsec is None:
            yield f"the target of {job.ended} has no look"
            continue
        truly = job.looks[-1][1]
        if abs(truly - one.error_after_arcsec) > TRUE_ARCSEC and not event.startswith("clock"):
            yield f"the target of {job.ended} was {truly:.1f}″ off, told as {one.error_after_arcsec:.1f}″"
        first = job.looks[0][1]
        before = one.error_before_arcsec
        if before is not None and abs(first - before) > TRUE_ARCSEC and not event.startswith("clock"):
            yield f"before it was {first:.1f}″ off, and is told as {one.error_before_arcsec:.1f}″"
        if job.at_end_arcsec > 45.0:
            yield f"{job.at_end_arcsec:.0f}″ off, and said to be centered"
    if report.runs != night.starts:
        yield f"{report.runs} starts of the service, and there were {night.starts}"
    links = sum(one.times for one in report.troubles if one.kind == "link")
    if (links > 0) != (event == "power-cut" and f"{name} for" in night.events[1]):
        yield f"{links} lost links, and the event was {night.events}"
    if not night.events and night.number and night.catalog == "embedded":
        if failed := [one for one in jobs if one.state != "succeeded"]:
            yield f"in a quiet night a target was not centered: {failed[0].state} {failed[0].problem}"
        for trouble in report.troubles:
            # some targets have a way round the pier that passes too low: refused, and the other side is taken
            if _NOT_ALLOWED not in trouble.what:
                yield f"a trouble in a quiet night: {trouble.what}"
        if report.lost_s > 0.0:
            yield f"{report.lost_s:.0f} s lost in a quiet night"
        if sum(report.unsolved.values()) > 2:
            yield f"unsolved under a clear sky: {dict(report.unsolved)}"
    if report.open_commands:
        yield f"{report.open_commands} orders without an outcome"


def _old_journal(path: Path, version: str) -> None:
    """Make a journal as an older mountnav left it, of a virtual observatory."""
    from alembic import command
    from alembic.config import Config
    from sqlalchemy import create_engine

    import mountnav.journal

    for end in ("", "-wal", "-shm"):
        path.with_name(path.name + end).unlink(missing_ok=True)
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(OLD.read_text(encoding="utf-8"))
        connection.execute("UPDATE run SET settings = ?", (json.dumps({"demo": {"speed": SPEED}}),))
        connection.commit()
    path.chmod(0o600)
    if version == "0001":
        return
    engine = create_engine(f"sqlite:///{path}")
    with engine.begin() as connection:
        config = Config()
        config.set_main_option("script_location", str(Path(mountnav.journal.__path__[0]) / "migrations"))
        config.attributes["connection"] = connection
        command.upgrade(config, version)
    engine.dispose()


def _rows(journal: Path) -> dict[str, float]:
    return {f"{table}_rows": float(count) for table, count in check(database_url(journal)).rows.items()}


def _read(into: Path) -> Iterator[Night]:
    if not into.exists():
        return
    for line in into.read_text(encoding="utf-8").splitlines():
        read = json.loads(line)
        yield Night(**{**read, "jobs": [Job(**job) for job in read["jobs"]]})


def grown(nights: Sequence[Night]) -> Iterator[str]:
    """What grew that may not."""
    for _, together in itertools.groupby(nights, key=lambda night: night.life):
        life = [night for night in together if night.figures]
        if len(life) < 4:
            continue
        first, last = life[1], life[-1]
        for what, most in (("own_mb", 25.0), ("children_mb", 60.0), ("threads", 3), ("descriptors", 4)):
            if what not in first.figures:
                continue  # of an older program
            more = last.figures[what] - first.figures[what]
            if more > most:
                yield (
                    f"nights {first.number} to {last.number}: {what} from {first.figures[what]:.0f} "
                    f"to {last.figures[what]:.0f}"
                )


def main(arguments: list[str] | None = None) -> int:
    """Run, and tell; 1 where something was wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--into", type=Path, required=True, help="a line a night; run again it goes on")
    parser.add_argument("--nights", type=int, default=365, help="in all, those of FILE included")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--targets", type=int, default=4, help="of each telescope in a night")
    parser.add_argument("--only", nargs="*", default=(), choices=EVENTS, help="draw from these alone")
    parser.add_argument("--verbose", action="store_true")
    asked = parser.parse_args(arguments)
    year = Year(asked.into, asked.seed, asked.targets, verbose=asked.verbose, only=asked.only)
    began_s = time.monotonic()
    year.run(asked.nights)
    wrong = sum(len(night.faults) for night in year.nights)
    jobs = [job for night in year.nights for job in night.jobs]
    growth = list(grown(year.nights))
    print(
        f"{len(year.nights)} nights, {len(jobs)} jobs, {sum(bool(one.events) for one in year.nights)} nights "
        f"with an event, in {time.monotonic() - began_s:.0f} s: {wrong} things wrong"
    )
    for line in growth:
        print(f"  grew: {line}")
    return 1 if wrong or growth else 0


if __name__ == "__main__":
    sys.exit(main())
