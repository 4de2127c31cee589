"""Virtual time: when it begins, what is refused, and that sky, mounts and pauses all go by it."""

from __future__ import annotations

import asyncio
import contextlib
import sqlite3
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest

from api.cli.serve import ServeOptions, VirtualMounting, settings_of
from api.demo.observatory import demo_journal, demo_service_settings, mount_errors_of_seed
from api.http.app import create_app
from api.observatory.fake_mounts import fake_on_pty, mechanics_of
from api.observatory.virtual import begin_of, virtual_days, virtual_view
from drivers.registry import open_mount
from mountnav.clock import SystemClock, in_virtual_time, pause, real_s, seconds, sky_s, utc_now, virtual_time
from mountnav.devices import Direction, Skilled, SlewOutcome
from mountnav.errors import BadRequest, BadSettings
from mountnav.journal.sql_journal import open_journal
from mountnav.night.daylight import dark_from, sun_altitude_deg
from mountnav.settings.demo import DemoSettings
from mountnav.settings.journal import JournalSettings
from mountnav.settings.observatory import Settings
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.coordinates import Apparent, Site
from mountnav.sky.sphere import separation_arcsec

DARK = datetime(2026, 12, 1, 22, 0, tzinfo=UTC)
NOON = datetime(2026, 12, 1, 10, 30, tzinfo=UTC)
SITE = Site(48.93, 22.27, 700.0)


# -- when it begins ------------------------------------------------------------


def test_night_begins_now_if_it_is_dark_else_at_dusk() -> None:
    assert dark_from(DARK, SITE) == DARK
    dusk = dark_from(NOON, SITE)
    assert timedelta(hours=4) < dusk - NOON < timedelta(hours=8)
    assert sun_altitude_deg(dusk, SITE) <= -18.0 < sun_altitude_deg(dusk - timedelta(minutes=5), SITE)


def test_where_it_never_gets_dark_the_sun_stands_lowest() -> None:
    lowest = dark_from(datetime(2026, 6, 21, 10, 0, tzinfo=UTC), SITE)
    height = sun_altitude_deg(lowest, SITE)
    assert -18.0 < height < -17.0
    assert height <= min(sun_altitude_deg(lowest + timedelta(minutes=m), SITE) for m in (-30, -10, 10, 30))


def test_a_chosen_instant_is_taken_as_it_is() -> None:
    assert begin_of(DemoSettings(at=NOON), SITE) == NOON
    with in_virtual_time(FastClock(1.0, NOON, ticks=lambda: 0.0)):
        assert begin_of(DemoSettings(), SITE) == NOON
        assert begin_of(DemoSettings(at="night"), SITE) == dark_from(NOON, SITE)


# -- one time for the whole process ------------------------------------------------------------


def test_by_default_there_is_none() -> None:
    assert virtual_time() is None
    assert virtual_view() is None
    assert real_s(3.0) == sky_s(3.0) == 3.0
    before = datetime.now(UTC)
    assert before <= utc_now() <= datetime.now(UTC)


def test_instants_and_seconds_are_of_one_time() -> None:
    ticks = [100.0]
    with in_virtual_time(FastClock(10.0, DARK, ticks=lambda: ticks[0])):
        began_s = seconds()
        ticks[0] += 6.0
        assert utc_now() == DARK + timedelta(minutes=1)
        assert seconds() - began_s == pytest.approx(60.0)
        assert real_s(60.0) == pytest.approx(6.0)
        assert sky_s(6.0) == pytest.approx(60.0)
        view = virtual_view()
        assert view is not None
        assert (view.utc, view.speed) == (utc_now(), 10.0)
        with pytest.raises(BadSettings, match="already"), in_virtual_time(FastClock(1.0)):
            pass
        assert utc_now() == DARK + timedelta(minutes=1)
    assert virtual_time() is None


def test_a_time_that_stands_still_is_refused() -> None:
    with pytest.raises(BadSettings, match="nothing would ever end"), in_virtual_time(FastClock(0.0)):
        pass


async def test_pauses_last_as_long_as_virtual_time_says() -> None:
    with virtual_days(DemoSettings(at=DARK, speed=50.0), SITE):
        clock, began = SystemClock(), time.monotonic()
        before = clock.monotonic_s()
        await pause(5.0)
        await clock.sleep(5.0)
        took_s = time.monotonic() - began
        assert clock.monotonic_s() - before >= 10.0 - 1e-3
        assert took_s >= 0.2 - 1e-3
        # the same stretch by both clocks, measured one inside the other
        assert clock.monotonic_s() - before <= 50.0 * (time.monotonic() - began) + 1e-6


# -- what is refused ------------------------------------------------------------

REAL = """
[site]
latitude_deg = 47.0
longitude_deg = 11.0
[demo]
speed = 10.0
[[telescope]]
id = "east"
mount = { url = "lx200+serial:///dev/ttyUSB0" }
camera = { kind = "folder", path = "/" }
"""
FAKE = REAL.replace("lx200+serial:///dev/ttyUSB0", "fake+lx200://")


@pytest.mark.parametrize(
    ("toml", "what"),
    [
        (REAL, r"real mount .*lx200\+serial.*can't live in a virtual time"),
        (FAKE, "frames of a folder camera"),
        (
            FAKE.replace('kind = "folder", path = "/"', 'kind = "simulated"')
            + 'night = { enabled = true, safety_file = "/safe" }',
            "safety file",
        ),
        (
            FAKE.replace("speed = 10.0", "at = 2026-12-01T22:00:00"),
            r"line 6: demo\.at: .* not an instant with its time zone",
        ),
        (FAKE.replace("speed = 10.0", "at = 1890-12-01T22:00:00Z"), "too far off"),
        (FAKE.replace("speed = 10.0", "speed = 0"), "demo.speed: "),
        (FAKE.replace("speed = 10.0", 'at = "tea time"'), "demo.at: tea time is not an instant"),
    ],
)
def test_what_can_not_be_virtual_is_refused(toml: str, what: str) -> None:
    with pytest.raises(BadSettings, match=what):
        Settings.parse(toml)


def test_the_same_settings_without_hardware_are_taken() -> None:
    settings = Settings.parse(FAKE.replace('kind = "folder", path = "/"', 'kind = "simulated"'))
    assert settings.demo == DemoSettings(speed=10.0)


@pytest.mark.parametrize(
    ("asked", "what"),
    [
        (ServeOptions(), "nothing to serve"),
        (
            ServeOptions(demo=True, at="2026-12-01T22:00:00"),
            "at: 2026-12-01T22:00:00 is not an instant with its time zone",
        ),
        (ServeOptions(demo=True, at="soon"), "not an instant"),
        (ServeOptions(demo=True, speed=1000.0), "speed"),
        (ServeOptions(config=Path("c"), mounting=VirtualMounting.FORK), "--mounting"),
        (ServeOptions(config=Path("c"), speed=2.0), "--speed is for a virtual observatory"),
        (ServeOptions(config=Path("real"), demo=True), "real mount"),
    ],
)
def test_options_that_make_no_sense(asked: ServeOptions, what: str, tmp_path: Path) -> None:
    if asked.config is not None:
        real = REAL.replace("[demo]\nspeed = 10.0\n", "")
        (tmp_path / str(asked.config)).write_text(real, encoding="utf-8")
        asked = ServeOptions(**{**_fields(asked), "config": tmp_path / str(asked.config)})  # type: ignore[arg-type]
    with pytest.raises(BadRequest, match=what):
        settings_of(asked)


def _fields(asked: ServeOptions) -> dict[str, object]:
    return {name: getattr(asked, name) for name in ServeOptions.__dataclass_fields__}


def test_options_go_before_the_file(tmp_path: Path) -> None:
    file = tmp_path / "virtual.toml"
    file.write_text(FAKE.replace('kind = "folder", path = "/"', 'kind = "simulated"'), encoding="utf-8")
    settings = settings_of(ServeOptions(config=file, at="2026-12-01T23:00:00+01:00", port=0, seed=4))
    assert settings.demo == DemoSettings(at=DARK, speed=10.0, seed=4)
    assert settings.service.port == 0
    assert settings_of(ServeOptions(config=file)).demo == DemoSettings(speed=10.0)


def test_a_seed_is_a_mount() -> None:
    assert mount_errors_of_seed(3) == mount_errors_of_seed(3) != mount_errors_of_seed(4)
    of_seed = demo_service_settings(DemoSettings(seed=3), 0).telescope[0].mount.errors
    assert (
        of_seed
        == mount_errors_of_seed(3)
        != demo_service_settings(DemoSettings(), 0).telescope[0].mount.errors
    )


def test_a_real_observatorys_journal_is_left_alone(tmp_path: Path) -> None:
    real, virtual = tmp_path / "real.sqlite", tmp_path / "virtual.sqlite"
    settings = demo_service_settings(DemoSettings(), 0)
    open_journal(
        str(real), settings_text=settings.model_copy(update={"demo": None}).model_dump_json()
    ).close()
    open_journal(str(virtual), settings_text=settings.model_dump_json()).close()

    def keeping(path: Path) -> Settings:
        return settings.model_copy(update={"journal": JournalSettings(url=str(path))})

    with pytest.raises(BadSettings, match="is of a real observatory"), demo_journal(keeping(real)):
        pass
    with demo_journal(keeping(virtual)) as kept:
        assert kept.journal.url == str(virtual)
    with demo_journal(settings) as passing:
        assert passing.journal.url != ""
        assert Path(passing.journal.url).parent.is_dir()
    assert not Path(passing.journal.url).parent.exists()


@pytest.mark.parametrize(("kept", "refused"), [('{"demo": {"speed": 2.0}}', False), ("{}", True)])
def test_a_virtual_journal_of_an_older_version_is_taken_up(tmp_path: Path, kept: str, refused: bool) -> None:
    """The service brings it up to date at its start; whether it is of a virtual sky is seen before."""
    path = tmp_path / "old.sqlite"
    old = Path(__file__).parents[2] / "journal" / "version_1.sql"
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.executescript(old.read_text(encoding="utf-8"))
        connection.execute("UPDATE run SET settings = ?", (kept,))
        connection.commit()
    settings = demo_service_settings(DemoSettings(), 0)
    settings = settings.model_copy(update={"journal": JournalSettings(url=str(path))})
    if refused:
        with pytest.raises(BadSettings, match="is of a real observatory"), demo_journal(settings):
            pass
        return
    with demo_journal(settings):
        open_journal(path).close()


# -- the mount's own time ------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("mounting", ["german", "fork"])
async def test_a_mount_slews_and_is_guided_in_virtual_time(mounting: str) -> None:
    settings = demo_service_settings(DemoSettings(at=DARK, speed=20.0), 0, mounting)  # type: ignore[arg-type]
    with virtual_days(DemoSettings(at=DARK, speed=20.0), settings.site.site) as clock:
        mechanics = mechanics_of(settings.telescope[0], settings)
        assert mechanics.machine.mounting == mounting
        bench = fake_on_pty("lx200", "onstep", mechanics)
        try:
            mount = open_mount(f"lx200+serial://{bench.address}", site=settings.site.site)
            await mount.open()
            try:
                start = mechanics.reported()
                place = Apparent((start.ra_deg + 20.0) % 360.0, start.dec_deg - 25.0, utc_now())
                began_s = clock.monotonic()
                assert await mount.slew(place) is SlewOutcome.ARRIVED
                took_s = clock.monotonic() - began_s
                # 25 degrees at 15 deg/s with ramps of 2 deg/s2, by the mount's own time
                assert took_s >= 2.0 * (25.0 / 2.0) ** 0.5
                there = mechanics.reported()
                miss_arcsec = separation_arcsec(there, Apparent(place.ra_deg, place.dec_deg, there.utc))
                assert miss_arcsec < 5.0

                before = mechanics.reported()
                began_s = clock.monotonic()
                assert isinstance(mount, Skilled)
                await mount.guide(Direction.NORTH, 4.0)
                assert clock.monotonic() - began_s >= 4.0
                after = mechanics.reported()
                # a pulse of four virtual seconds at half the sidereal rate or the whole of it
                assert 25.0 < 3600.0 * (after.dec_deg - before.dec_deg) < 65.0
            finally:
                await mount.close()
        finally:
            await asyncio.to_thread(bench.stop)


# -- a night at noon ------------------------------------------------------------


@pytest.mark.long
async def test_a_night_begins_and_ends_by_the_virtual_sun(tmp_path: Path) -> None:
    demo = DemoSettings(at=NOON, speed=20.0)
    settings = demo_service_settings(demo, 0)
    settings = settings.model_copy(
        update={
            "solving": settings.solving.model_copy(update={"worker": False, "blind": "never"}),
            "journal": JournalSettings(url=str(tmp_path / "virtual.sqlite")),
        }
    )
    with virtual_days(demo, settings.site.site) as clock:
        app = create_app(settings)
        transport = httpx.ASGITransport(app=app)
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as client,
        ):
            assert await _phase(client, "waiting") == "waiting"
            clock.on(8 * 3600.0)
            assert await _phase(client, "calibrating") == "calibrating"
            clock.on(12 * 3600.0)
            assert await _phase(client, "waiting") == "waiting"
            lines = (await client.get("/v1/journal", params={"limit": 200})).json()["lines"]
        times = [datetime.fromisoformat(line["utc"]) for line in lines]
        assert min(times) >= NOON
        assert max(times) <= clock()
        assert max(times) - min(times) > timedelta(hours=19)


async def _phase(client: httpx.AsyncClient, wanted: str) -> str:
    """Of the night, as soon as it is this one."""
    phase = ""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(60.0):
            while phase != wanted:
                phase = (await client.get("/v1/telescopes/demo/night")).json()["phase"]
                await asyncio.sleep(0.02)
    return phase
