"""A service is killed while its mount follows, or an axis is moved: its guard ends that, by the motors."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from api.http.app import create_app
from api.observatory.dead_man import MountGuard
from drivers.registry import open_mount
from mountnav.clock import utc_now
from mountnav.devices import OffsetRates, TakesOffsetRates
from mountnav.errors import DeviceRefused
from mountnav.journal.reading import JournalReader
from mountnav.journal.records import EntryKind
from mountnav.settings.observatory import Settings
from mountnav.sky.coordinates import SIDEREAL_DEG_S
from tests.api.observatory.true_mount import SITE
from tests.settings_text import FREE_GERMAN_MOUNT, SERVICE_AND_SITE

pytestmark = [pytest.mark.long, pytest.mark.first]  # they wait for mounts: not at the end

SETTINGS = (
    SERVICE_AND_SITE
    + FREE_GERMAN_MOUNT
    + """
[telescope.following]
on_loss = "{on_loss}"
"""
)
ONSTEP = "lx200+serial://{device}?dialect=onstep"
_MANY = 6
"""Deaths of the service in the long test."""


@dataclass
class TrueMount:
    """The fake in its own process, and what its motors do."""

    device: str
    process: subprocess.Popen[str]
    url: str = ""
    told: list[dict[str, Any]] = field(default_factory=list)

    def now(self) -> dict[str, Any]:
        """What it says of this moment."""
        from_s = time.monotonic()
        while not self.told or self.told[-1]["s"] < from_s:
            time.sleep(0.01)
        return self.told[-1]

    def until(self, holds: Callable[[dict[str, Any]], bool]) -> float:
        """Wait until something holds of it; how many seconds that took."""
        began_s = time.monotonic()
        while not holds(self.now()):
            assert self.process.poll() is None
        return float(self.told[-1]["s"]) - began_s


def sidereal(told: dict[str, Any]) -> bool:
    """Whether it tracks as for a star, and nothing else."""
    ha, dec = told["velocity"]
    return bool(
        told["tracking"]
        and told["beside"] == [0.0, 0.0]
        and abs(ha - SIDEREAL_DEG_S) < 1e-6
        and abs(dec) < 1e-6
    )


def as_a_star(told: dict[str, Any]) -> bool:
    """The same of any family, by its motors, to what its protocol rounds: 0.1″/s."""
    ha, dec = told["velocity"]
    return bool(abs(ha - SIDEREAL_DEG_S) < 3e-5 and abs(dec) < 3e-5)


def follows(told: dict[str, Any]) -> bool:
    """Whether it has rates."""
    return bool(abs(told["beside"][0]) > 1.0)


def rests(told: dict[str, Any]) -> bool:
    """Whether its motors stand."""
    return all(abs(one) < 1e-6 for one in told["velocity"])


@pytest.fixture
def true_mount() -> Iterator[TrueMount]:
    """A mount that outlives the service."""
    with mount_of() as mount:
        yield mount


@contextlib.contextmanager
def mount_of(url: str = ONSTEP, *kind: str) -> Iterator[TrueMount]:
    """The same, of a family: how its URL begins and ends, protocol and dialect."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.api.observatory.true_mount", *kind], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    device = process.stdout.readline().strip()
    mount = TrueMount(device, process, url.format(device=device))

    def read() -> None:
        assert process.stdout is not None
        for line in process.stdout:
            mount.told.append(json.loads(line))

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        yield mount
    finally:
        process.kill()
        process.wait()
        reader.join()
        process.stdout.close()


@dataclass
class Service:
    """The service as a process."""

    process: subprocess.Popen[str]

    def says(self, word: str) -> None:
        """Wait until it says so."""
        assert self.process.stdout is not None
        while (line := self.process.stdout.readline().strip()) != word:
            assert line or self.process.poll() is None, "it has ended"

    def kill(self) -> None:
        """As the kernel does: nothing more of it runs."""
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


@dataclass
class Place:
    """Where a service of these tests lives."""

    folder: Path
    settings: Path
    journal: Path
    served: list[Service] = field(default_factory=list)

    @property
    def environment(self) -> dict[str, str]:
        """With journal and cache of its own."""
        return os.environ | {
            "MOUNTNAV_JOURNAL": str(self.journal),
            "MOUNTNAV_CACHE": str(self.folder / "cache"),
        }

    def serve(self, what: str = "rates", renew: str = "renew", *more: str) -> Service:
        """Start it."""
        with (self.folder / "log").open("a") as log:
            process = subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    "tests.api.observatory.follower",
                    str(self.settings),
                    what,
                    renew,
                    *more,
                ],
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=self.environment,
            )
        self.served.append(Service(process))
        return self.served[-1]

    def guards(self) -> list[int]:
        """Process ids of guards that are alive."""
        found = []
        for one in Path("/proc").iterdir():
            with contextlib.suppress(OSError, ValueError):
                line = (one / "cmdline").read_bytes().split(b"\0")
                if (
                    b"api.observatory.dead_man_process" in line
                    and str(self.folder).encode() in (one / "environ").read_bytes()
                ):
                    found.append(int(one.name))
        return found

    def reports(self) -> list[dict[str, Any]]:
        """What guards have written and nobody has read yet."""
        return [
            json.loads(line)
            for file in (self.folder / "cache" / "guards").glob("*.jsonl")
            for line in file.read_text().splitlines()
        ]


@pytest.fixture
def place(true_mount: TrueMount, tmp_path: Path) -> Iterator[Place]:
    """Where services live; all of them and their guards are ended afterwards."""
    made = placed(tmp_path, true_mount)
    yield made
    for service in made.served:
        service.kill()
    for guard in made.guards():
        with contextlib.suppress(ProcessLookupError):
            os.kill(guard, signal.SIGKILL)


def placed(folder: Path, mount: TrueMount, on_loss: str = "sidereal") -> Place:
    url = mount.url or ONSTEP.format(device=mount.device)
    settings = folder / "observatory.toml"
    (folder / "frames").mkdir(exist_ok=True)
    settings.write_text(SETTINGS.format(url=url, folder=folder / "frames", on_loss=on_loss))
    return Place(folder, settings, folder / "journal.sqlite")


def until(holds: Callable[[], object]) -> None:
    while not holds():
        time.sleep(0.05)


def test_rates_do_not_outlive_a_killed_service(true_mount: TrueMount, place: Place) -> None:
    service = place.serve()
    service.says("in force")
    true_mount.until(follows)
    service.kill()
    true_mount.until(sidereal)
    until(place.reports)
    (report,) = place.reports()
    assert report["outcome"].startswith("ended")
    assert report["why"] == "the service has died"
    until(lambda: not place.guards())

    # the next start tells it, and has nothing left to end but ends it
    service = place.serve(renew="once")
    service.says("open")
    assert place.reports() == []
    service.says("in force")
    service.kill()
    true_mount.until(sidereal)
    reader = JournalReader(place.journal)
    told = [entry.what for entry in reader.entries() if entry.kind is EntryKind.FAULT]
    assert any("the guard of an earlier run: the service has died; ended" in what for what in told)
    assert any("the service ended without having ended it: rates of 6." in what for what in told)


def test_by_policy_the_mount_of_a_killed_service_stands_still(true_mount: TrueMount, place: Place) -> None:
    placed(place.folder, true_mount, "stop")
    service = place.serve()
    service.says("in force")
    service.kill()
    true_mount.until(rests)
    assert not true_mount.now()["tracking"]


def test_a_moved_axis_does_not_outlive_a_killed_service(true_mount: TrueMount, place: Place) -> None:
    service = place.serve("axis")
    service.says("in force")
    true_mount.until(lambda told: abs(told["velocity"][1]) > 0.01)
    service.kill()
    true_mount.until(lambda told: abs(told["velocity"][1]) < 1e-6)
    until(place.reports)
    assert place.reports()[0]["what"] == ["move-axis"]


def test_a_service_that_ends_in_order_leaves_its_guard_no_work(true_mount: TrueMount, place: Place) -> None:
    service = place.serve()
    service.says("in force")
    (guard,) = place.guards()
    # as systemd does: all processes of the unit at once
    os.kill(guard, signal.SIGTERM)
    service.process.send_signal(signal.SIGINT)
    service.process.wait()
    service.kill()
    until(lambda: not place.guards())
    assert place.reports() == []
    assert sidereal(true_mount.now())


def test_a_guard_that_is_asked_to_end_does_its_work_first(true_mount: TrueMount, place: Place) -> None:
    service = place.serve()
    service.says("in force")
    (guard,) = place.guards()
    os.kill(guard, signal.SIGTERM)
    os.kill(guard, signal.SIGINT)
    assert follows(true_mount.now())
    service.kill()
    with contextlib.suppress(ProcessLookupError):  # it may be done already
        os.kill(guard, signal.SIGTERM)
    true_mount.until(sidereal)
    until(lambda: not place.guards())


def test_a_guard_is_small(true_mount: TrueMount, place: Place) -> None:
    service = place.serve()
    service.says("in force")
    (guard,) = place.guards()
    status = Path(f"/proc/{guard}/status").read_text()
    resident_kb = int(status.split("VmRSS:")[1].split()[0])
    assert resident_kb < 20_000
    service.kill()
    until(lambda: not place.guards())


def test_a_guard_does_not_fight_a_service_started_meanwhile(true_mount: TrueMount, place: Place) -> None:
    first = place.serve()
    first.says("in force")
    (guard,) = place.guards()
    # it is held up until the next service has the mount
    os.kill(guard, signal.SIGSTOP)
    first.kill()
    second = place.serve(renew="once")
    second.says("in force")
    os.kill(guard, signal.SIGCONT)
    until(lambda: guard not in place.guards())
    assert follows(true_mount.now())
    assert place.reports()[0]["outcome"].startswith("left to the service")
    second.kill()
    true_mount.until(sidereal)


def test_none_of_many_outlive_a_service_that_is_killed_at_any_moment(
    true_mount: TrueMount, place: Place
) -> None:
    chance = random.Random(18)
    took = []
    for number in range(_MANY):
        service = place.serve(chance.choice(["rates", "rates", "axis"]))
        service.says("open")
        # before the first order, during one, between two
        time.sleep(chance.choice([0.0, 0.02, 0.05, 0.1, 0.3, 1.0]) * chance.random() * 2.0)
        service.kill()
        took.append(true_mount.until(sidereal))
        until(lambda: not place.guards())
        assert sidereal(true_mount.now()), f"death {number} left it following"
    print(f"ended after {max(took):.2f} s at most")


_INDI = "poll_s=0.1&heartbeat_s=0.5&set_site=yes&set_clock=yes"
FAMILIES = {
    "skywatcher": ("skywatcher+serial://{device}", ("skywatcher", ""), ("rates", "axis")),
    "nexstar": ("nexstar+serial://{device}", ("nexstar", ""), ("rates", "axis")),
    "ioptron": ("ioptron+serial://{device}", ("ioptron", ""), ("ra", "axis")),
    "astro-physics": ("lx200+serial://{device}?dialect=ap", ("lx200", "ap"), ("ra",)),
    "am5": ("lx200+serial://{device}?dialect=am5", ("lx200", "am5"), ("axis",)),
    "alpaca": ("{device}", ("alpaca", ""), ("rates", "axis")),
    "indi-eqmod": (f"{{device}}?{_INDI}", ("indi", "indi_eqmod_telescope"), ("rates", "axis")),
    "indi-ioptron": (f"{{device}}?{_INDI}", ("indi", "indi_ioptronv3_telescope"), ("ra", "axis")),
}
"""How each family's URL is written, its fake, and what its protocol lets go on by itself; OnStep is above."""


def killed_and_ended(family: str, what: str, folder: Path) -> dict[str, Any]:
    """Kill a service whose mount goes on by itself, and wait until that has ended; the guard's report."""
    url, kind, _ = FAMILIES[family]
    with mount_of(url, *kind) as mount:
        place = placed(folder, mount)
        try:
            service = place.serve(what, "renew", "slew")
            service.says("in force")
            mount.until(lambda told: not as_a_star(told))
            service.kill()
            # a hand control that was told to move an axis tracks no more, and rests
            over = as_a_star if what != "axis" else lambda told: as_a_star(told) or rests(told)
            mount.until(over)
            until(lambda: not place.guards())
            assert over(mount.now())
            (report,) = place.reports()
        finally:
            for one in place.served:
                one.kill()
            for guard in place.guards():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(guard, signal.SIGKILL)
    return report


# a driver that comes anew to them knows nothing of the rates in force; all others: benchmarks/guards.py
@pytest.mark.parametrize("family", ["skywatcher", "nexstar"])
def test_of_motors_that_tell_little_rates_do_not_outlive_a_killed_service(
    family: str, tmp_path: Path
) -> None:
    assert killed_and_ended(family, "rates", tmp_path)["outcome"].startswith("ended")


@pytest.mark.long
def test_the_fake_mount_of_the_command_line_is_left_at_the_sidereal_rate(tmp_path: Path) -> None:
    link = tmp_path / "port"
    fake = subprocess.Popen(
        [sys.executable, "-m", "api.main", "fake-mount", "--dialect", "onstep", "--link", str(link)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert fake.stdout is not None
    place = None
    try:
        device = fake.stdout.readline().strip()
        place = placed(tmp_path, TrueMount(device, fake))
        service = place.serve()
        service.says("in force")
        service.kill()
        until(place.reports)
        assert place.reports()[0]["outcome"].startswith("ended")
        until(lambda: not place.guards())
        assert asyncio.run(_rates_of(device)) == OffsetRates(0.0, 0.0)
    finally:
        for service in [] if place is None else place.served:
            service.kill()
        fake.terminate()
        fake.wait()
        fake.stdout.close()


# -- the guard alone -------------------------------------------------------------------------------


async def _rates_of(device: str, rates: OffsetRates | None = None) -> OffsetRates | None:
    mount = open_mount(f"lx200+serial://{device}?dialect=onstep", site=SITE)
    await mount.open()
    try:
        assert isinstance(mount, TakesOffsetRates)
        if rates is not None:
            await mount.set_offset_rates(rates)
            # let it go as it is: a driver that is closed ends its rates
            mount._session.drift.ours = False  # type: ignore[attr-defined]
        return await mount.offset_rates()
    finally:
        await mount.close()


def guard_of(mount: TrueMount, folder: Path) -> MountGuard:
    url = f"lx200+serial://{mount.device}?dialect=onstep"
    return MountGuard("east", url, SITE, "sidereal", folder=folder)


async def test_a_guard_that_hears_nothing_in_time_acts(true_mount: TrueMount, tmp_path: Path) -> None:
    await _rates_of(true_mount.device, OffsetRates(5.0, 5.0))
    assert follows(true_mount.now())
    guard = guard_of(true_mount, tmp_path)
    guard.arm(utc_now() + timedelta(seconds=0.5), ["offset-rates"])
    while not sidereal(await asyncio.to_thread(true_mount.now)):
        pass
    while not guard.reports():
        await asyncio.sleep(0.05)
    assert guard.reports()[0]["why"] == "the service was not heard of in time"
    # it guards on
    assert guard.pid is not None
    guard.told()
    assert guard.reports() == []
    await guard.close()


DIES_SLOWLY = """
import asyncio, os, pathlib, sys, time
from datetime import timedelta
from api.observatory.dead_man import MountGuard
from mountnav.clock import utc_now
from tests.api.observatory.true_mount import SITE

async def die():
    guard = MountGuard("east", sys.argv[1], SITE, "sidereal", folder=pathlib.Path(sys.argv[2]))
    await guard.hold()
    guard.arm(utc_now() + timedelta(seconds=600.0), ["offset-rates"])
    # as the kernel may: the link first, the lock some time later
    guard._link.close()
    time.sleep(1.0)
    os._exit(0)

asyncio.run(die())
"""


async def test_the_lock_of_a_service_that_is_still_dying_is_no_other_service(
    true_mount: TrueMount, tmp_path: Path
) -> None:
    await _rates_of(true_mount.device, OffsetRates(5.0, 5.0))
    url = ONSTEP.format(device=true_mount.device)
    dies = [sys.executable, "-c", DIES_SLOWLY, url, str(tmp_path)]
    await asyncio.to_thread(subprocess.run, dies, check=True)
    while not sidereal(await asyncio.to_thread(true_mount.now)):
        pass
    guard = guard_of(true_mount, tmp_path)
    while not guard.reports():
        await asyncio.sleep(0.05)
    (report,) = guard.reports()
    assert report["outcome"].startswith("ended")


async def test_a_guard_that_is_disarmed_does_nothing(true_mount: TrueMount, tmp_path: Path) -> None:
    await _rates_of(true_mount.device, OffsetRates(5.0, 5.0))
    guard = guard_of(true_mount, tmp_path)
    guard.arm(utc_now() + timedelta(seconds=60.0), ["offset-rates"])
    guard.disarm()
    await guard.close()
    assert follows(true_mount.now())
    assert guard.reports() == []


async def test_a_mount_that_is_let_go_with_rates_is_taken_over(true_mount: TrueMount, tmp_path: Path) -> None:
    await _rates_of(true_mount.device, OffsetRates(5.0, 5.0))
    guard = guard_of(true_mount, tmp_path)
    guard.arm(utc_now() + timedelta(seconds=600.0), ["offset-rates"])
    guard.take_over()
    while not sidereal(await asyncio.to_thread(true_mount.now)):
        pass
    await guard.close()


async def test_a_guard_that_died_is_replaced_while_it_is_needed(
    true_mount: TrueMount, tmp_path: Path
) -> None:
    guard = guard_of(true_mount, tmp_path)
    guard.arm(utc_now() + timedelta(seconds=600.0), ["offset-rates"])
    first = guard.pid
    assert first is not None
    os.kill(first, signal.SIGKILL)
    while guard.pid in (None, first):
        await asyncio.sleep(0.02)
    # it knows what to do
    await _rates_of(true_mount.device, OffsetRates(5.0, 5.0))
    guard.take_over()
    while not sidereal(await asyncio.to_thread(true_mount.now)):
        pass
    # and one that isn't needed isn't replaced
    second = guard.pid
    assert second is not None
    os.kill(second, signal.SIGKILL)
    while guard._process is not None:
        await asyncio.sleep(0.02)
    await guard.close()


async def test_without_a_guard_nothing_is_armed(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    guard = MountGuard("east", "lx200+serial:///dev/none", SITE, "sidereal", folder=file / "guards")
    with pytest.raises(DeviceRefused, match="can't be started"):
        guard.arm(utc_now() + timedelta(seconds=60.0), ["offset-rates"])


async def test_a_guard_tries_on_until_the_port_is_there_again(true_mount: TrueMount, tmp_path: Path) -> None:
    link = tmp_path / "port"
    guard = MountGuard("east", f"lx200+serial://{link}?dialect=onstep", SITE, "sidereal", folder=tmp_path)
    await _rates_of(true_mount.device, OffsetRates(5.0, 5.0))
    guard.arm(utc_now(), ["offset-rates"])
    await asyncio.sleep(3.0)
    assert follows(true_mount.now())
    link.symlink_to(true_mount.device)
    while not sidereal(await asyncio.to_thread(true_mount.now)):
        pass
    while not guard.reports():
        await asyncio.sleep(0.05)
    assert guard.reports()[0]["tries"] > 1
    await guard.close()


async def test_a_service_waits_for_a_guard_that_is_at_work(true_mount: TrueMount, tmp_path: Path) -> None:
    guard = MountGuard("east", "lx200+serial:///dev/none?dialect=onstep", SITE, "sidereal", folder=tmp_path)
    # at work: the lock is taken by another process
    taking = subprocess.Popen(  # noqa: ASYNC220 - it lasts no longer than a fork
        [
            sys.executable,
            "-c",
            "import fcntl, os, sys, time\n"
            "number = os.open(sys.argv[1], os.O_RDWR | os.O_CREAT, 0o600)\n"
            "fcntl.lockf(number, fcntl.LOCK_EX)\n"
            "print('held', flush=True)\n"
            "sys.stdin.read()\n",
            str(guard._lock_file),
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert taking.stdout is not None
    assert taking.stdin is not None
    taking.stdout.readline()
    holding = asyncio.ensure_future(guard.hold())
    await asyncio.sleep(0.6)
    assert not holding.done()
    taking.stdin.close()
    await holding
    assert guard._lock is not None
    guard.release()
    taking.wait()
    taking.stdout.close()


# -- the client ------------------------------------------------------------------------------------

INSIDE = (
    SERVICE_AND_SITE
    + """
[[telescope]]
id = "east"
mount = { url = "fake+lx200://?dialect=onstep", slew_rate_deg_s = 45.0, acceleration_deg_s2 = 8.0 }
camera = { kind = "simulated", width_px = 400, height_px = 300, scale_arcsec_px = 4.0 }
"""
)


@pytest.mark.parametrize("on_expiry", ["stop", "park"])
async def test_rates_do_not_outlive_the_lease_of_a_client_that_died(
    on_expiry: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOUNTNAV_CACHE", str(tmp_path / "cache"))
    app = create_app(Settings.parse(INSIDE))
    transport = httpx.ASGITransport(app=app)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as client,
    ):
        telescope = app.state.service.observatory.telescope("east")
        # it dies with the service: there is nobody to guard it, and nothing to be guarded from
        assert telescope.dead_man is None
        mount, mechanics = (await telescope.ready()).mount, telescope.mechanics
        mount.trust()
        mechanics.tracking = True
        taken = await client.post("/v1/telescopes/east/lease", json={"ttl_s": 5, "on_expiry": on_expiry})
        assert taken.status_code == 201, taken.text
        ends = utc_now() + timedelta(seconds=600.0)
        await mount.set_offset_rates(OffsetRates(6.0, 4.0), ends_utc=ends)
        assert mechanics.beside_arcsec_s != (0.0, 0.0)
        # no heartbeat comes any more
        while mount.offset_rates_in_force is not None:
            await asyncio.sleep(0.1)
        assert mechanics.beside_arcsec_s == (0.0, 0.0)
