"""A mount behind a real `indiserver`, with `indi_simulator_telescope` as the mount."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.generic.mount import GenericMount
from drivers.indi.codec import messages
from drivers.indi.codec import state as claims
from drivers.indi.codec.answers import reason_of, refusal, slew_was_refused, was_turned
from drivers.indi.codec.messages import Changed, Reader, State
from drivers.indi.codec.state import Property
from drivers.registry import open_mount
from mountnav.clock import utc_now
from mountnav.devices import Direction, SlewOutcome, SlewState, SyncOutcome, TrackingRate
from mountnav.errors import DeviceMissing, DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from mountnav.testing.check_mount import check_mount
from tests.drivers.indi.real_server import TELESCOPE, IndiServer
from tests.pace import slowness

SITE = Site(48.93, 22.27, 700.0)
OPTIONS = "poll_s=0.1&heartbeat_s=0.3&backoff_s=0.1"


@asynccontextmanager
async def running_server(folder: Path) -> AsyncIterator[IndiServer]:
    one = IndiServer(("indi_simulator_telescope",), folder / "home", restarts=2)
    await one.start()
    try:
        yield one
    finally:
        await one.kill()


@pytest.fixture
async def server(tmp_path: Path) -> AsyncIterator[IndiServer]:
    """With the simulator connected, and at a faster pace than its own four looks a second."""
    async with running_server(tmp_path) as one:
        await one.set_numbers(TELESCOPE, "POLLING_PERIOD", PERIOD_MS=50.0)
        yield one


def url_of(server: IndiServer, options: str = OPTIONS, device: str = "Telescope%20Simulator") -> str:
    return f"indi://127.0.0.1:{server.port}/{device}?{options}"


@pytest.fixture
async def mount(server: IndiServer) -> AsyncIterator[GenericMount]:
    """Tracking, at declination 50: not at the pole, where it starts."""
    one = open_mount(url_of(server, f"set_site=yes&{OPTIONS}"), site=SITE)
    assert isinstance(one, GenericMount)
    await one.open()
    try:
        await one.set_tracking(True)
        here = (await one.reading()).place
        await one.sync(Apparent(here.ra_deg, 50.0, utc_now()))
        yield one
    finally:
        await one.close()


def beside(place: Apparent | Icrs, north_deg: float) -> Apparent:
    return Apparent(place.ra_deg, place.dec_deg + north_deg, utc_now())


def apart_arcsec(a: Apparent | Icrs, b: Apparent | Icrs) -> float:
    return separation_arcsec(Icrs(a.ra_deg, a.dec_deg), Icrs(b.ra_deg, b.dec_deg))


async def until(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(30.0):
        while not true():
            await asyncio.sleep(0.01)


def sent(mount: GenericMount) -> list[str]:
    """Orders that went out, as "property" or "property:switch"."""
    found = []
    for entry in mount.wire_log.entries():
        if entry.way == "driver->mount" and entry.data.startswith(b"<new"):
            name = entry.data.split(b'name="')[1].split(b'"')[0].decode()
            on = [part.split(b'"')[0].decode() for part in entry.data.split(b'name="')[2:] if b">On<" in part]
            found.append(":".join([name, *on]))
    return found


async def test_connecting_orders_nothing_but_the_connection(tmp_path: Path) -> None:
    async with running_server(tmp_path) as server:
        await _connecting_orders_nothing_else(server)


async def _connecting_orders_nothing_else(server: IndiServer) -> None:
    mount = open_mount(url_of(server), site=SITE)
    assert isinstance(mount, GenericMount)
    await mount.open()
    try:
        assert sent(mount) == ["CONNECTION:CONNECT"]
        assert mount.report is not None
        assert mount.report.identity.startswith("Telescope Simulator (indi_simulator_telescope")
        # what it tells before its first look at the mount is not a place
        assert (await mount.reading()).place.dec_deg == pytest.approx(90.0)
        assert mount.trusted
    finally:
        await mount.close()
    again = open_mount(url_of(server, f"connect=no&{OPTIONS}"))
    await again.open()
    assert sent(again) == []  # type: ignore[arg-type]
    await again.close()


async def test_a_device_may_be_left_to_others(tmp_path: Path) -> None:
    async with running_server(tmp_path) as server:
        mount = open_mount(url_of(server, "connect=no"))
        with pytest.raises(DeviceRefused, match="leaves that to others"):
            await mount.open()


@pytest.mark.long
async def test_an_unknown_device_is_told_with_those_that_are_there(server: IndiServer) -> None:
    mount = open_mount(url_of(server, device="EQMod%20Mount"))
    with pytest.raises(DeviceMissing, match="it has: Telescope Simulator"):
        await mount.open()


async def test_no_server_is_told() -> None:
    with pytest.raises(DeviceMissing, match="is indiserver running"):
        await open_mount("indi://127.0.0.1:9/Telescope%20Simulator").open()


async def test_each_order_to_the_coordinates_has_its_switch_before_it(mount: GenericMount) -> None:
    here = (await mount.reading()).place
    there = beside(here, 2.0)
    assert await mount.slew(there) is SlewOutcome.ARRIVED
    assert apart_arcsec((await mount.reading()).place, there) < 30.0
    result = await mount.sync(beside(there, 0.1))
    assert result.outcome is SyncOutcome.SEEN
    orders = [one for one in sent(mount) if one.startswith(("ON_COORD_SET", "EQUATORIAL"))]
    # the fixture's sync, the slew, the sync
    sync = ["ON_COORD_SET:SYNC"] * 2 + ["EQUATORIAL_EOD_COORD"] + ["ON_COORD_SET:TRACK"] * 2
    slew = ["ON_COORD_SET:TRACK"] * 2 + ["EQUATORIAL_EOD_COORD"]
    assert orders == sync + slew + sync


async def test_another_client_finds_no_sync_selected_after_ours(
    server: IndiServer, mount: GenericMount
) -> None:
    other = server.device(TELESCOPE)
    await other.bring_up(may_connect=False, needed=("ON_COORD_SET",))
    mode = other.get("ON_COORD_SET")
    assert mode is not None
    assert mode.on("TRACK")
    assert not mode.on("SYNC")
    await other.client.close()


async def test_a_sync_left_by_another_program_does_not_turn_our_slew_into_one(
    server: IndiServer, mount: GenericMount
) -> None:
    other = server.device(TELESCOPE)
    await other.bring_up(may_connect=False, needed=("ON_COORD_SET",))
    await other.set_switches("ON_COORD_SET", {"TRACK": False, "SLEW": False, "SYNC": True})
    there = beside((await mount.reading()).place, 12.0)
    task = asyncio.create_task(mount.slew(there))
    await until(lambda: mount.slew_state is SlewState.UNDER_WAY)
    # a sync would have brought it there at once
    assert apart_arcsec((await mount.reading()).place, there) > 60.0
    assert await task is SlewOutcome.ARRIVED
    await other.client.close()


async def test_a_stop_ends_a_slew_and_leaves_tracking(mount: GenericMount) -> None:
    there = beside((await mount.reading()).place, -40.0)
    task = asyncio.create_task(mount.slew(there))
    await until(lambda: mount.slew_state is SlewState.UNDER_WAY)
    count = mount.wire_log.count
    await mount.stop()
    assert await task is SlewOutcome.STOPPED
    reading = await mount.reading()
    assert reading.slewing is False
    assert reading.tracking is True
    assert apart_arcsec(reading.place, there) > 3600.0
    first = mount.wire_log.entries(after=count)[0]
    assert b"TELESCOPE_ABORT_MOTION" in first.data


async def test_parking_and_what_a_parked_mount_refuses(mount: GenericMount) -> None:
    await mount.set_park()
    assert await mount.park() is SlewOutcome.ARRIVED
    reading = await mount.reading()
    assert reading.parked is True
    for order in (mount.slew, mount.sync):
        with pytest.raises(DeviceRefused) as caught:
            await order(beside(reading.place, 1.0))
        assert caught.value.reason is Refusal.PARKED
    with pytest.raises(DeviceRefused, match="parked"):
        await mount.guide(Direction.NORTH, 0.1)
    await mount.unpark()
    assert (await mount.reading()).parked is False


async def test_the_drivers_own_words_when_it_is_parked_behind_our_back(
    server: IndiServer, mount: GenericMount
) -> None:
    other = server.device(TELESCOPE)
    await other.bring_up(may_connect=False, needed=("TELESCOPE_PARK",))
    await other.ordered(
        messages.new_switches(TELESCOPE, "TELESCOPE_PARK_OPTION", {"PARK_CURRENT": True}),
        messages.new_switches(TELESCOPE, "TELESCOPE_PARK", {"PARK": True}),
        asking="TELESCOPE_PARK",
    )

    def is_parked() -> bool:
        park = other.get("TELESCOPE_PARK")
        return park is not None and park.state is State.OK and park.on("PARK") is True

    assert await other.client.until(is_parked, 20.0)
    # the order that our language sends, past its own check
    events = await other.ordered(
        messages.new_numbers(TELESCOPE, "EQUATORIAL_EOD_COORD", {"RA": 1.0, "DEC": 60.0}),
        asking="ON_COORD_SET",
    )
    assert slew_was_refused("EQUATORIAL_EOD_COORD", events)
    assert refusal("the slew", events, "x").reason is Refusal.PARKED
    await other.client.close()


async def test_tracking_and_its_rates(mount: GenericMount) -> None:
    await mount.set_tracking(False)
    assert (await mount.reading()).tracking is False
    await mount.set_tracking(True, TrackingRate.LUNAR)
    assert (await mount.reading()).tracking is True
    assert "TELESCOPE_TRACK_MODE:TRACK_LUNAR" in sent(mount)
    with pytest.raises(DeviceRefused) as caught:
        await mount.set_tracking(True, TrackingRate.KING)
    assert caught.value.reason is Refusal.UNSUPPORTED


@pytest.mark.long
async def test_a_guide_pulse_moves_by_its_length(mount: GenericMount) -> None:
    before = (await mount.reading()).place
    await mount.guide(Direction.NORTH, 1.0)
    await asyncio.sleep(0.6)
    moved_arcsec = ((await mount.reading()).place.dec_deg - before.dec_deg) * 3600.0
    # the simulator guides at half the sidereal rate
    assert moved_arcsec == pytest.approx(7.5, abs=2.5)


async def test_a_mount_that_is_sent_elsewhere_by_another_program_is_noticed(
    server: IndiServer, mount: GenericMount
) -> None:
    here = (await mount.reading()).place
    await server.set_numbers(
        TELESCOPE, "EQUATORIAL_EOD_COORD", RA=here.ra_deg / 15.0, DEC=here.dec_deg - 30.0
    )
    said = "another program ordered EQUATORIAL_EOD_COORD"
    await until(lambda: said in [entry.meaning for entry in mount.wire_log.entries()])
    assert (await mount.reading()).slewing is True
    await mount.stop()
    assert (await mount.reading()).slewing is False


class Told:
    """What a mount announced."""

    def __init__(self, mount: GenericMount) -> None:
        self.all: list[tuple[str, Mapping[str, object]]] = []
        mount.listen(lambda what, facts: self.all.append((what, facts)))

    def has(self, what: str) -> bool:
        return any(kind == what for kind, _ in self.all)


async def test_a_server_killed_during_a_slew_is_noticed_and_found_again(
    server: IndiServer, mount: GenericMount
) -> None:
    told = Told(mount)
    task = asyncio.create_task(mount.slew(beside((await mount.reading()).place, -40.0)))
    await until(lambda: mount.slew_state is SlewState.UNDER_WAY)
    loop = asyncio.get_running_loop()
    killed = loop.time()
    await server.kill()
    await until(lambda: told.has("link-lost"))
    noticed_s = loop.time() - killed
    with pytest.raises(DeviceMissing):
        await task
    assert mount.slew_state is SlewState.LOST
    assert not mount.trusted
    await server.start()
    await until(lambda: told.has("link-back"))
    # it is another mount now, as it were: at the pole again
    assert (await mount.reading()).place.dec_deg == pytest.approx(90.0)
    with pytest.raises(DeviceRefused) as caught:
        await mount.slew(Apparent(10.0, 40.0, utc_now()))
    assert caught.value.reason is Refusal.UNTRUSTED
    here = (await mount.reading()).place
    await mount.sync(Apparent(here.ra_deg, 60.0, utc_now()))
    assert mount.trusted
    assert noticed_s < 2.0 * slowness()


@pytest.mark.long
async def test_a_server_that_hangs_is_noticed(server: IndiServer, mount: GenericMount) -> None:
    told = Told(mount)
    server.freeze()
    await until(lambda: told.has("link-lost"))
    (why,) = [str(facts["why"]) for what, facts in told.all if what == "link-lost"]
    assert why.startswith("the server was silent for 1.")
    server.thaw()
    await until(lambda: told.has("link-back"))


@pytest.mark.parametrize("how", ["killed", "disconnected"])
async def test_a_driver_that_is_gone_is_noticed_and_connected_again(
    server: IndiServer, mount: GenericMount, how: str
) -> None:
    told = Told(mount)
    if how == "killed":
        server.kill_driver("indi_simulator_telescope")
    else:
        other = server.device(TELESCOPE)
        await other.bring_up(may_connect=False, needed=("ON_COORD_SET",))
        other.client.send(
            messages.new_switches(TELESCOPE, "CONNECTION", {"CONNECT": False, "DISCONNECT": True})
        )
        await other.lost()
        await other.client.close()
    await until(lambda: told.has("link-lost"))
    await until(lambda: told.has("link-back"))
    assert not mount.trusted
    assert (await mount.reading()).place is not None


@pytest.mark.long
async def test_it_keeps_the_promises_of_a_mount(mount: GenericMount) -> None:
    # it goes below the horizon and back, at 6° a second, and to its park position
    await mount.sync(Apparent((await mount.reading()).place.ra_deg, 5.0, utc_now()))
    await mount.set_park()
    await check_mount(mount)


# -- what the drivers' messages mean, from recorded ones -------------------------------------------


def changed(name: str, state: str, **values: str) -> bytes:
    kind = "Switch" if set(values.values()) <= {"On", "Off"} else "Number"
    inside = "".join(f'<one{kind} name="{key}">{text}</one{kind}>' for key, text in values.items())
    return f'<set{kind}Vector device="A" name="{name}" state="{state}">{inside}</set{kind}Vector>'.encode()


TRACK = changed("ON_COORD_SET", "Ok", TRACK="On", SYNC="Off")
SYNC = changed("ON_COORD_SET", "Ok", TRACK="Off", SYNC="On")
BUSY = changed("EQUATORIAL_EOD_COORD", "Busy", RA="1", DEC="2")
OK = changed("EQUATORIAL_EOD_COORD", "Ok", RA="1", DEC="2")


@pytest.mark.parametrize(
    ("stream", "turned"),
    [
        (TRACK + BUSY, False),
        (OK + TRACK + OK + BUSY, False),
        # after the order was taken up it is none of our business
        (TRACK + BUSY + SYNC + BUSY, False),
        (TRACK + SYNC + OK, True),
        (SYNC + OK, True),
    ],
)
def test_a_switch_turned_before_our_coordinates_were_taken_up_is_noticed(stream: bytes, turned: bool) -> None:
    assert was_turned("TRACK", "EQUATORIAL_EOD_COORD", Reader().feed(stream)) is turned


@pytest.mark.parametrize(
    ("ra_h", "dec_deg", "place"),
    [
        ("2.5", "40", Icrs(37.5, 40.0)),
        # as indi_simulator_telescope tells a place before 0 h, and EQMod one past the pole
        ("-10.13", "0", Icrs(208.05, 0.0)),
        ("25", "0", Icrs(15.0, 0.0)),
        ("14.5", "90.25", Icrs(37.5, 89.75)),
        ("14.5", "-90.25", Icrs(37.5, -89.75)),
        ("2.5", "96", None),
        ("nan", "40", None),
        ("2.5", "inf", None),
        ("49", "0", None),
    ],
)
def test_coordinates_become_places_or_nothing(ra_h: str, dec_deg: str, place: Icrs | None) -> None:
    (event,) = Reader().feed(changed("EQUATORIAL_COORD", "Ok", RA=ra_h, DEC=dec_deg))
    assert isinstance(event, Changed)
    told = Property(
        "A", event.name, event.kind, State.OK, "rw", "", event.values, utc_now(), told_s=0.0, count=1
    )
    found = claims.place(told, "icrs", utc_now())
    assert (found is None) == (place is None)
    if found is not None and place is not None:
        assert apart_arcsec(found, place) < 1e-3


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("Please unpark the mount before issuing any motion/sync commands.", Refusal.PARKED),
        ("Error Slewing to JNow RA 1:00:00 - DEC 2:00:00. Object below horizon", Refusal.BELOW_HORIZON),
        ("Slew target outside of limits", Refusal.LIMIT),
        ("Mount is not aligned", Refusal.NOT_ALIGNED),
        ("Something else", Refusal.OTHER),
    ],
)
def test_words_tell_the_reason(words: str, reason: Refusal) -> None:
    assert reason_of(words) is reason
