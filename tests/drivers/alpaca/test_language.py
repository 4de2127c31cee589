"""An Alpaca telescope as a mount, against a small server of the tests' own and all that it does wrong."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any

import pytest

from drivers.generic.link_supervisor import LinkState
from drivers.generic.mount import GenericMount
from drivers.registry import open_mount
from mountnav.clock import utc_now
from mountnav.devices import (
    Announces,
    Direction,
    PierSide,
    Skill,
    Skilled,
    SlewOutcome,
    SlewState,
    SyncOutcome,
    TrackingRate,
    Trusts,
)
from mountnav.errors import BadSettings, DeviceError, DeviceMissing, DeviceRefused, DeviceSilent, Refusal
from mountnav.simulation.mechanics import Machine
from mountnav.sky.coordinates import Apparent, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from mountnav.testing.check_mount import check_mount
from tests.drivers.alpaca.alpaca_server import (
    HERE,
    AlpacaError,
    AlpacaServer,
    FakeTelescope,
    Fault,
    quick_mechanics,
)

QUICK = "poll_s=0.1&start_grace_s=0.8&rest_s=0.5&stall_s=3&sync_wait_s=1.0&late_s=0.5&backoff_s=0.1"


@contextmanager
def served(telescope: FakeTelescope, **options: Any) -> Iterator[AlpacaServer]:
    with AlpacaServer({"telescope/0": telescope}, **options) as server:
        yield server


class Rig:
    """A mount, its server and the telescope behind."""

    def __init__(self, mount: GenericMount, server: AlpacaServer, telescope: FakeTelescope) -> None:
        self.mount, self.server, self.telescope = mount, server, telescope
        self.told: list[str] = []
        mount.listen(lambda what, _facts: self.told.append(what))

    async def beside(self, north_deg: float) -> Apparent | Icrs:
        place = (await self.mount.reading()).place
        if isinstance(place, Icrs):
            return Icrs(place.ra_deg, place.dec_deg + north_deg)
        return Apparent(place.ra_deg, place.dec_deg + north_deg, utc_now())

    async def until(self, true: Callable[[], object]) -> None:
        async with asyncio.timeout(60.0):
            while not true():
                await asyncio.sleep(0.01)

    def fault(self, member: str, what: str, **details: Any) -> None:
        self.server.faults.append(Fault(member, what, **details))


@asynccontextmanager
async def rigged(
    telescope: FakeTelescope | None = None, more: str = "", **options: Any
) -> AsyncIterator[Rig]:
    telescope = telescope or FakeTelescope(quick_mechanics())
    with served(telescope, **options) as server:
        mount = open_mount(server.url("telescope/0", QUICK + more), site=HERE)
        assert isinstance(mount, GenericMount)
        await mount.open()
        try:
            yield Rig(mount, server, telescope)
        finally:
            await mount.close()


def apart_arcsec(a: Apparent | Icrs, b: Apparent | Icrs) -> float:
    return separation_arcsec(Icrs(a.ra_deg, a.dec_deg), Icrs(b.ra_deg, b.dec_deg))


# -- what it is ----------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(
    ("version", "system"),
    [(4, 1), pytest.param(3, 2, marks=pytest.mark.long)],
)
async def test_each_version_of_the_interface_conforms(version: int, system: int) -> None:
    async with rigged(FakeTelescope(quick_mechanics(), version, system)) as rig:
        assert rig.mount.epoch == ("apparent" if system == 1 else "icrs")
        await check_mount(rig.mount)


async def test_it_is_all_that_navigation_asks_for() -> None:
    async with rigged() as rig:
        mount = rig.mount
        assert isinstance(mount, Skilled)
        assert isinstance(mount, Trusts)
        assert isinstance(mount, Announces)
        assert mount.report is not None
        assert mount.report.identity == (
            "Small telescope (written for the tests 1.0; ITelescopeV4, topocentric (JNow) coordinates)"
        )
        assert mount.report.problems == ("it was not connected: we connected it",)
        assert mount.link is LinkState.UP
        reading = await mount.reading()
        assert reading.pier_side is PierSide.EAST
        assert (reading.tracking, reading.parked, reading.slewing) == (True, False, False)
        missing = set(Skill) - mount.skills
        # a home that is found by a sensor is for the configuration to say
        assert missing == {Skill.FIND_HOME}
        # connecting orders nothing but the connection
        assert rig.server.orders() == ["connect"]


@pytest.mark.long
async def test_what_it_says_it_cannot_is_no_skill_and_is_refused() -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope.can = dict.fromkeys(
        (
            *("canpark", "canunpark", "cansetpark", "canfindhome", "canpulseguide"),
            *("cansetrightascensionrate", "cansetdeclinationrate"),
        ),
        False,
    )
    telescope.can["cansync"] = False
    telescope.missing = {
        *("sideofpier", "athome", "utcdate", "destinationsideofpier", "trackingrates"),
        "canmoveaxis",
    }
    async with rigged(telescope) as rig:
        assert rig.mount.skills == {Skill.TRACK, Skill.SITE, Skill.SET_SITE}
        reading = await rig.mount.reading()
        assert (reading.pier_side, reading.at_home) == (None, None)
        with pytest.raises(DeviceRefused) as refused:
            await rig.mount.sync(reading.place)
        assert refused.value.reason is Refusal.UNSUPPORTED
        await check_mount(rig.mount)


@pytest.mark.long
async def test_an_old_driver_that_tells_no_version_needs_its_epoch_said() -> None:
    telescope = FakeTelescope(quick_mechanics(), version=1)
    with pytest.raises(DeviceRefused, match=r"doesn't say which.*epoch"):
        async with rigged(telescope):
            pass
    async with rigged(FakeTelescope(quick_mechanics(), version=1), "&epoch=apparent") as rig:
        assert rig.mount.report is not None
        assert (
            "it is set to speak apparent coordinates, and doesn't say which itself"
            in rig.mount.report.problems
        )
        place = await rig.beside(-3.0)
        assert await rig.mount.slew(place) is SlewOutcome.ARRIVED


@pytest.mark.parametrize(("system", "name"), [(4, "B1950"), pytest.param(0, "other", marks=pytest.mark.long)])
async def test_coordinates_that_we_do_not_speak_are_refused(system: int, name: str) -> None:
    telescope = FakeTelescope(quick_mechanics(), system=system)
    with pytest.raises(DeviceRefused, match=rf"says {name}.*or say epoch"):
        async with rigged(telescope):
            pass
    async with rigged(telescope, "&epoch=apparent") as rig:
        assert rig.mount.epoch == "apparent"
        assert rig.mount.report is not None
        assert any(f"says {name}" in problem for problem in rig.mount.report.problems)


@pytest.mark.long
async def test_the_settings_may_say_otherwise_and_it_is_told() -> None:
    async with rigged(FakeTelescope(quick_mechanics(), system=1), "&epoch=icrs") as rig:
        assert rig.mount.epoch == "icrs"
        assert rig.mount.report is not None
        assert (
            "it is set to speak icrs coordinates, and says topocentric (JNow) itself"
            in rig.mount.report.problems
        )


# -- connecting ----------------------------------------------------------------------------------------


@pytest.mark.long
async def test_one_that_is_connected_is_ordered_nothing() -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope.connected = True
    async with rigged(telescope) as rig:
        assert rig.server.orders() == []
        await rig.mount.close()
        assert rig.server.orders() == []
        assert telescope.connected, "others may be using it"


@pytest.mark.long
async def test_an_old_one_is_connected_the_old_way() -> None:
    async with rigged(FakeTelescope(quick_mechanics(), version=3)) as rig:
        assert rig.server.orders() == ["connected"]


@pytest.mark.long
async def test_it_may_be_left_to_others_to_connect() -> None:
    with pytest.raises(DeviceRefused, match="leaves that to others"):
        async with rigged(more="&connect=no"):
            pass


@pytest.mark.parametrize("version", [4, pytest.param(3, marks=pytest.mark.long)])
async def test_a_driver_that_cannot_connect_says_why(version: int) -> None:
    telescope = FakeTelescope(quick_mechanics(), version)
    telescope.connect_error = AlpacaError(0x500, "COM7 does not exist")
    with pytest.raises(DeviceMissing, match="COM7 does not exist"):
        async with rigged(telescope):
            pass


@pytest.mark.long
async def test_a_driver_that_connects_late_is_connected_all_the_same() -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope.connects_in_s = 0.6
    async with rigged(telescope) as rig:
        assert rig.server.orders() == ["connect"]
    telescope = FakeTelescope(quick_mechanics(), version=3)
    telescope.answers_connecting_after_s = 0.6
    # it takes its whole time and is there: that counts, not the time
    async with rigged(telescope, "&connect_s=0.7") as rig:
        assert rig.server.orders() == ["connected"]


@pytest.mark.long
async def test_an_order_that_http_refuses_is_refused() -> None:
    async with rigged() as rig:
        rig.fault("slewtocoordinatesasync", "status", number=400)
        with pytest.raises(DeviceRefused, match="HTTP status 400") as refused:
            await rig.mount.slew(await rig.beside(-3.0))
        assert refused.value.reason is Refusal.OTHER


async def test_no_server_no_telescope_and_no_password_are_told() -> None:
    with pytest.raises(DeviceMissing, match="can't be reached"):
        await open_mount("alpaca+http://127.0.0.1:9/telescope/0").open()
    with served(FakeTelescope(quick_mechanics())) as server:
        mount = open_mount(server.url("telescope/7"))
        with pytest.raises(DeviceMissing, match=r"no telescope 7.*it has: telescope/0 \(Small telescope\)"):
            await mount.open()
    with served(FakeTelescope(quick_mechanics()), basic=("obs", "p@ss/word")) as server:
        with pytest.raises(DeviceMissing, match="user:password@"):
            await open_mount(server.url("telescope/0")).open()
        url = server.url("telescope/0", QUICK).replace("://", "://obs:p%40ss%2Fword@")
        mount = open_mount(url)
        await mount.open()
        assert isinstance(mount, GenericMount)
        assert "p@ss" not in mount.name
        assert not any(b"p@ss" in entry.data for entry in mount.wire_log.entries())
        await mount.close()


@pytest.mark.long
async def test_clock_and_site_are_compared_and_set_when_asked_for() -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope.site = [HERE.latitude_deg, -HERE.longitude_deg, 0.0]
    telescope.utc_off *= 0
    async with rigged(telescope) as rig:
        report = rig.mount.report
        assert report is not None
        assert report.clock_off_s == pytest.approx(0.0, abs=0.5)
        assert any("the sign of the longitude is wrong" in problem for problem in report.problems)
    async with rigged(telescope, "&set_site=yes&set_clock=yes") as rig:
        assert telescope.site == pytest.approx([HERE.latitude_deg, HERE.longitude_deg, HERE.height_m])
        assert rig.mount.report is not None
        assert rig.mount.report.done == ("site set", "clock set")
        assert abs(telescope.utc_off.total_seconds()) < 1.0


@pytest.mark.parametrize(
    "url",
    [
        "alpaca://host:1/telescope/0",
        "alpaca+http://host/telescope",
        "alpaca+http://host/dome/0",
        "alpaca+tcp://host:1/telescope/0",
        "alpaca+http:///telescope/0",
        "alpaca+http://u:secret@host/telescope/x",
        "alpaca+http://host/telescope/0?connect=maybe",
        "alpaca+http://host/telescope/0?dialect=onstep",
        "alpaca+http://host/telescope/0?epoch=b1950",
        "alpaca+http://host/camera/0",
    ],
)
def test_urls_that_make_no_sense_are_refused_without_the_password(url: str) -> None:
    with pytest.raises(BadSettings) as refused:
        open_mount(url)
    assert "secret" not in str(refused.value)


# -- orders --------------------------------------------------------------------------------------------


@pytest.mark.long
async def test_a_slew_arrives_and_a_sync_is_seen() -> None:
    async with rigged() as rig:
        there = await rig.beside(-8.0)
        assert await rig.mount.slew(there) is SlewOutcome.ARRIVED
        assert apart_arcsec((await rig.mount.reading()).place, there) < 10.0
        result = await rig.mount.sync(await rig.beside(0.2))
        assert result.outcome is SyncOutcome.SEEN
        assert rig.server.orders() == ["connect", "slewtocoordinatesasync", "synctocoordinates"]


@pytest.mark.parametrize(
    ("behavior", "outcome"),
    [("ignore", SyncOutcome.IGNORED), pytest.param("late", SyncOutcome.LATE, marks=pytest.mark.long)],
)
async def test_syncs_are_believed_by_their_read_back(behavior: Any, outcome: SyncOutcome) -> None:
    async with rigged() as rig:
        rig.telescope.mechanics.sync_behavior = behavior
        rig.telescope.mechanics.sync_late_s = 0.7
        result = await rig.mount.sync(await rig.beside(0.2))
        assert result.outcome is outcome


@pytest.mark.long
async def test_a_refused_sync_says_why() -> None:
    async with rigged() as rig:
        rig.telescope.mechanics.sync_behavior = "refuse"
        with pytest.raises(DeviceRefused, match="The controller refused the sync"):
            await rig.mount.sync(await rig.beside(0.2))
        await rig.mount.set_tracking(False)
        with pytest.raises(DeviceRefused) as refused:
            await rig.mount.sync(await rig.beside(0.2))
        assert refused.value.reason is Refusal.NOT_TRACKING


@pytest.mark.long
async def test_a_slew_switches_tracking_on_before() -> None:
    async with rigged() as rig:
        await rig.mount.set_tracking(False)
        assert await rig.mount.slew(await rig.beside(-3.0)) is SlewOutcome.ARRIVED
        assert rig.telescope.mechanics.tracking
        assert rig.server.orders()[-2:] == ["tracking", "slewtocoordinatesasync"]


@pytest.mark.long
async def test_refusals_have_their_reason() -> None:
    telescope = FakeTelescope(quick_mechanics(Machine(mounting="german", lowest_altitude_deg=0.0)))
    async with rigged(telescope) as rig:
        place = (await rig.mount.reading()).place
        with pytest.raises(DeviceRefused) as below:
            await rig.mount.slew(Apparent((place.ra_deg + 180.0) % 360.0, -60.0, utc_now()))
        assert below.value.reason is Refusal.BELOW_HORIZON
        assert await rig.mount.park() is SlewOutcome.ARRIVED
        with pytest.raises(DeviceRefused) as parked:
            await rig.mount.slew(place)
        assert parked.value.reason is Refusal.PARKED
        await rig.mount.stop()  # a parked one refuses AbortSlew, and rests
        with pytest.raises(DeviceRefused) as unsupported:
            await rig.mount.set_tracking(True, TrackingRate.KING)
        assert unsupported.value.reason is Refusal.UNSUPPORTED


@pytest.mark.long
async def test_tracking_rates_guiding_home_and_sides() -> None:
    async with rigged() as rig:
        mount, mechanics = rig.mount, rig.telescope.mechanics
        await mount.set_tracking(True, TrackingRate.LUNAR)
        assert mechanics.rate is TrackingRate.LUNAR
        before = (await mount.reading()).place
        assert mount.guide_rates_deg_s == pytest.approx((7.5205 / 3600.0,) * 2)
        await mount.guide(Direction.NORTH, 1.0)
        assert (await mount.reading()).place.dec_deg - before.dec_deg == pytest.approx(7.5 / 3600.0, abs=2e-4)
        assert await mount.destination_side(before) is mechanics.destination_side(before)  # type: ignore[arg-type]
        assert await mount.home() is SlewOutcome.ARRIVED
        assert (await mount.reading()).at_home


@pytest.mark.parametrize(("version", "system"), [(4, 1), pytest.param(3, 1, marks=pytest.mark.long)])
async def test_a_slew_that_fails_on_its_way_is_told_by_its_own_words(version: int, system: int) -> None:
    telescope = FakeTelescope(quick_mechanics(slew_rate_deg_s=3.0), version, system)
    async with rigged(telescope) as rig:
        telescope.fails_after_s = 0.5
        with pytest.raises(DeviceRefused, match="failed on the way: Motor stalled on axis 1"):
            await rig.mount.slew(await rig.beside(-30.0))
        assert rig.mount.slew_state is SlewState.LOST
        # it can be read, and the next slew is another matter
        assert (await rig.mount.reading()).slewing is None
        telescope.fails_after_s = None
        telescope.mechanics.slew_rate_deg_s = 20.0
        assert await rig.mount.slew(await rig.beside(5.0)) is SlewOutcome.ARRIVED


@pytest.mark.long
async def test_one_that_slews_synchronously_only_is_followed_all_the_same() -> None:
    telescope = FakeTelescope(quick_mechanics(slew_rate_deg_s=8.0), version=3)
    telescope.can["canslewasync"] = False
    async with rigged(telescope) as rig:
        assert await rig.mount.slew(await rig.beside(-20.0)) is SlewOutcome.ARRIVED
        assert rig.server.orders()[-1] == "slewtocoordinates"
        telescope.fails_after_s = 1.2
        telescope.mechanics.slew_rate_deg_s = 3.0
        with pytest.raises(DeviceRefused, match="Motor stalled"):
            await rig.mount.slew(await rig.beside(20.0))


# -- stop ----------------------------------------------------------------------------------------------


@pytest.mark.long
async def test_a_stop_passes_a_question_that_hangs() -> None:
    telescope = FakeTelescope(quick_mechanics(slew_rate_deg_s=3.0))
    async with rigged(telescope, "&timeout_s=20&silence_s=30&lost_after_s=60") as rig:
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(-40.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        rig.fault("slewing", "slow", seconds=2.0)
        await rig.until(lambda: rig.server.faults[0].times == 0)
        stop = asyncio.create_task(rig.mount.stop())
        await rig.until(lambda: "abortslew" in rig.server.orders())
        assert not rig.server.faults[0].over, "it waited for the question"
        await rig.until(lambda: not telescope.mechanics.slewing())
        await stop
        assert await slew is SlewOutcome.STOPPED


@pytest.mark.long
async def test_a_stop_whose_answer_hangs_is_told_again_and_the_rest_is_seen() -> None:
    telescope = FakeTelescope(quick_mechanics(slew_rate_deg_s=3.0))
    async with rigged(telescope) as rig:
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(-40.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        rig.fault("abortslew", "ignored")
        rig.fault("abortslew", "error", number=0x500, body="busy")
        rig.fault("abortslew", "slow", seconds=2.0)
        await rig.mount.stop()
        assert not telescope.mechanics.slewing()
        assert rig.server.orders().count("abortslew") >= 3
        assert await slew is SlewOutcome.STOPPED


# -- orders whose answer is lost -----------------------------------------------------------------------


DONE = ("drop", "deaf", "wrong-id")
NOT_DONE = ("refuse-connection", "status")


@pytest.mark.parametrize(
    "what", ["deaf", *(pytest.param(one, marks=pytest.mark.long) for one in ("drop", "wrong-id", *NOT_DONE))]
)
async def test_no_order_is_sent_twice_whatever_becomes_of_its_answer(what: str) -> None:
    async with rigged(more="&timeout_s=0.6") as rig:
        there = await rig.beside(-6.0)
        rig.fault("slewtocoordinatesasync", what, seconds=1.5, number=500)
        if what in DONE:
            # it was carried out: that shows
            assert await rig.mount.slew(there) is SlewOutcome.ARRIVED
        else:
            with pytest.raises(DeviceError, match="not known"):
                await rig.mount.slew(there)
        assert rig.server.orders().count("slewtocoordinatesasync") == 1
        rig.fault("synctocoordinates", what, seconds=1.5, number=500)
        place = await rig.beside(0.2)
        if what in DONE:
            assert (await rig.mount.sync(place)).outcome in (SyncOutcome.SEEN, SyncOutcome.LATE)
        else:
            with pytest.raises(DeviceError, match="not known"):
                await rig.mount.sync(place)
        assert rig.server.orders().count("synctocoordinates") == 1


@pytest.mark.long
async def test_an_ignored_slew_has_not_arrived() -> None:
    async with rigged() as rig:
        rig.fault("slewtocoordinatesasync", "ignored")
        assert await rig.mount.slew(await rig.beside(-6.0)) is SlewOutcome.STALLED


# -- readings that go wrong ----------------------------------------------------------------------------


WRONG: tuple[tuple[str, dict[str, Any]], ...] = (
    ("drop", {}),
    ("refuse-connection", {}),
    ("wrong-id", {}),
    ("html", {}),
    ("text", {"body": '{"Value": NaN, "ErrorNumber": 0}'}),
    ("text", {"body": '{"Value": "12.5", "ErrorNumber": 0}'}),
    ("text", {"body": '{"Value": 99.0, "ErrorNumber": 0}'}),
    ("text", {"body": '{"Value": [{"Name": "RightAscension", "Value": 25.5}], "ErrorNumber": 0}'}),
    ("text", {"body": "[]"}),
    ("error", {"number": 0x500, "body": "serial port timed out"}),
    ("status", {"number": 500}),
    ("status", {"number": 302}),
)


@pytest.mark.parametrize("version", [4, pytest.param(3, marks=pytest.mark.long)])
async def test_nothing_but_a_place_is_ever_a_place(version: int) -> None:
    async with rigged(FakeTelescope(quick_mechanics(), version), "&heartbeat_s=0") as rig:
        truly = rig.telescope.mechanics.reported()
        member = "devicestate" if version == 4 else "declination"
        for what, details in WRONG:
            rig.fault(member, what, **details)
            if what in ("drop", "refuse-connection"):
                # a dropped question is asked again
                assert apart_arcsec((await rig.mount.reading()).place, truly) < 60.0
            else:
                with pytest.raises(DeviceError):
                    await rig.mount.reading()
            assert apart_arcsec((await rig.mount.reading()).place, truly) < 60.0


@pytest.mark.long
async def test_a_driver_that_cannot_read_its_mount_is_silent_not_refusing() -> None:
    async with rigged(more="&heartbeat_s=0") as rig:
        rig.fault("devicestate", "error", number=0x500, body="serial port timed out")
        with pytest.raises(DeviceSilent, match="serial port timed out"):
            await rig.mount.reading()


@pytest.mark.long
async def test_compressed_answers_are_read() -> None:
    async with rigged(gzip=True) as rig:
        assert await rig.mount.slew(await rig.beside(-3.0)) is SlewOutcome.ARRIVED


# -- the link ------------------------------------------------------------------------------------------


@pytest.mark.long
async def test_a_silent_server_and_its_return_are_announced() -> None:
    async with rigged(more="&silence_s=0.4&heartbeat_s=0.1&timeout_s=3") as rig:
        rig.fault("slewing", "slow", seconds=1.5)
        await rig.until(lambda: "link-silent" in rig.told)
        assert rig.mount.link is LinkState.SILENT
        await rig.until(lambda: "link-back" in rig.told)
        assert rig.mount.link is LinkState.UP
        assert rig.mount.trusted, "a silence is not a loss"


@pytest.mark.long
async def test_a_server_that_dies_in_a_slew_is_lost_and_comes_back_untrusted() -> None:
    telescope = FakeTelescope(quick_mechanics(slew_rate_deg_s=3.0))
    async with rigged(telescope, "&heartbeat_s=0.1") as rig:
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(-40.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        rig.server.stop()
        with pytest.raises(DeviceMissing):
            await slew
        await rig.until(lambda: "link-lost" in rig.told)
        assert rig.mount.slew_state is SlewState.LOST
        assert telescope.mechanics.slewing(), "nobody could stop it"
        rig.server.start()
        await rig.until(lambda: "link-back" in rig.told)
        # something was moving when the link broke: it is stopped, and nothing moves by a doubtful position
        await rig.until(lambda: not telescope.mechanics.slewing())
        assert "abortslew" in rig.server.orders()
        assert not rig.mount.trusted
        with pytest.raises(DeviceRefused) as refused:
            await rig.mount.slew(await rig.beside(1.0))
        assert refused.value.reason is Refusal.UNTRUSTED


@pytest.mark.long
async def test_a_telescope_that_another_program_disconnects_is_lost_and_connected_again() -> None:
    async with rigged(more="&heartbeat_s=0.1") as rig:
        rig.telescope.connected = False
        await rig.until(lambda: "link-lost" in rig.told)
        await rig.until(lambda: "link-back" in rig.told)
        assert rig.telescope.connected
        assert not rig.mount.trusted
        assert (await rig.mount.sync(await rig.beside(0.1))).outcome is SyncOutcome.SEEN
        assert rig.mount.trusted


@pytest.mark.long
async def test_closing_leaves_nothing_running() -> None:
    telescope = FakeTelescope(quick_mechanics(slew_rate_deg_s=3.0), version=3)
    async with rigged(telescope) as rig:
        parking = asyncio.create_task(rig.mount.park())
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        parking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await parking
        await rig.until(lambda: not telescope.mechanics.slewing())
        await rig.mount.close()
        assert [one for one in asyncio.all_tasks() if one.get_name().startswith(("alpaca", "link"))] == []


def test_a_site_is_compared_only_where_there_is_one() -> None:
    mount = open_mount("alpaca+http://127.0.0.1:1/telescope/0", site=Site(1.0, 2.0))
    assert mount.name == "alpaca+http://127.0.0.1:1/telescope/0"
    assert mount.resolution_arcsec == 1.0
