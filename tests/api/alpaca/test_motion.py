"""What moves over Alpaca: slews, syncs, aborts, parking, homing, guiding; as several clients meet it."""

from __future__ import annotations

import asyncio

import pytest

from api.access.callers import Caller, Face, Role
from api.orders.targets import AltAzTarget
from api.orders.vocabulary import CenterOrder, SlewOrder
from mountnav.errors import DeviceRefused, Refusal
from tests.api.alpaca.alpaca_observatory import OBSERVATORY, SPEED, AlpacaProbe, Running, running

SETTLE_S = 30
SOMEBODY = Caller("a scheduler", Role.OPERATE, Face.REST)


@pytest.mark.long
async def test_slews_set_the_target_arrive_and_keep_the_pointing_state(fast: Running) -> None:
    german = fast.probe
    for hour_angle_h, dec_deg, side in ((-3.0, 23.5, 1), (3.0, 23.5, 0), (-9.0, 75.0, 1), (9.0, 75.0, 0)):
        ra_h = await german.at_hour_angle(hour_angle_h)
        place = {"RightAscension": ra_h, "Declination": dec_deg}
        assert await german.get("destinationsideofpier", **place) == side
        await german.put("slewtocoordinatesasync", **place)
        # before the answer, not a moment later
        assert await german.get("slewing") is True
        await german.until_rest()
        assert await german.miss_arcsec(ra_h, dec_deg) < 2.0
        assert await german.get("sideofpier") == side
        assert await german.get("targetrightascension") == ra_h
        assert await german.get("targetdeclination") == dec_deg
        assert await german.get("tracking") is True


@pytest.mark.long
async def test_slews_to_the_target_and_those_that_wait(fast: Running) -> None:
    german = fast.probe
    for member in ("slewtotarget", "slewtotargetasync", "synctotarget"):
        assert await german.refused("PUT", member) == 0x402
    ra_h = await german.at_hour_angle(-4.0)
    await german.put("targetrightascension", TargetRightAscension=ra_h)
    assert await german.refused("PUT", "slewtotargetasync") == 0x402
    await german.put("targetdeclination", TargetDeclination=4.0)
    await german.put("slewtotargetasync")
    assert await german.get("slewing") is True
    await german.until_rest()
    assert await german.miss_arcsec(ra_h, 4.0) < 2.0
    await german.put("targetdeclination", TargetDeclination=6.0)
    # those that wait let others be served meanwhile
    waiting = asyncio.create_task(german.ask("PUT", "slewtotarget"))
    other = german.as_client(7)
    async with asyncio.timeout(60):
        while not await other.get("slewing"):
            await asyncio.sleep(0.01)
    assert not waiting.done()
    assert (await waiting).number == 0
    assert await german.get("slewing") is False
    assert await german.miss_arcsec(ra_h, 6.0) < 2.0
    await german.put("slewtocoordinates", RightAscension=ra_h, Declination=8.0)
    assert await german.miss_arcsec(ra_h, 8.0) < 2.0


@pytest.mark.long
async def test_what_a_slew_would_be_refused_for_is_told_at_once_and_nothing_moves(
    german: AlpacaProbe,
) -> None:
    before = await german.get("rightascension"), await german.get("declination")
    below = await german.at_hour_angle(12.0)
    found = await german.ask("PUT", "slewtocoordinatesasync", RightAscension=below, Declination=-20.0)
    assert found.number == 0x40B
    assert "altitude" in found.words
    assert await german.get("slewing") is False
    assert (await german.get("rightascension"), await german.get("declination")) == pytest.approx(
        before, abs=1e-3
    )
    # the same wherever the horizon is: no waiting brings it up
    away = await german.ask("PUT", "slewtocoordinates", RightAscension=below, Declination=-89.0)
    assert away.number in (0x401, 0x40B)


@pytest.mark.long
async def test_right_ascension_needs_tracking_and_azimuth_needs_none(fast: Running) -> None:
    german = fast.probe
    ra_h = await german.at_hour_angle(-1.0)
    direction = {"Azimuth": 150.0, "Altitude": 50.0}
    assert await german.refused("PUT", "slewtoaltazasync", **direction) == 0x40B
    await german.put("tracking", Tracking=False)
    assert await german.get("tracking") is False
    place = {"RightAscension": ra_h, "Declination": 10.0}
    for member in ("slewtocoordinates", "slewtocoordinatesasync", "synctocoordinates"):
        assert await german.refused("PUT", member, **place) == 0x40B
    await german.put("slewtoaltazasync", **direction)
    assert await german.get("slewing") is True
    await german.until_rest()
    assert await german.get("azimuth") == pytest.approx(150.0, abs=0.5)
    assert await german.get("altitude") == pytest.approx(50.0, abs=0.5)
    assert await german.get("tracking") is False


@pytest.mark.long
async def test_a_sync_is_read_back_before_the_answer_and_moves_nothing(fast: Running) -> None:
    german = fast.probe
    ra_h = await german.slew_to(3.0, 23.5)
    for step_deg in (-1.0, 1.0, 2.0 / 60.0):
        place = {"RightAscension": (ra_h + step_deg / 15.0) % 24.0, "Declination": 23.5 + step_deg}
        await german.put("synctocoordinates", **place)
        assert await german.get("slewing") is False
        assert await german.miss_arcsec(place["RightAscension"], place["Declination"]) < 10.0
        assert await german.get("targetrightascension") == place["RightAscension"]
        await german.put("slewtocoordinates", RightAscension=ra_h, Declination=23.5)
        assert await german.miss_arcsec(ra_h, 23.5) < 10.0
    far = await german.ask("PUT", "synctocoordinates", RightAscension=ra_h, Declination=50.0)
    assert far.number == 0x40B
    assert await german.miss_arcsec(ra_h, 23.5) < 10.0
    await german.put("targetdeclination", TargetDeclination=23.6)
    await german.put("targetrightascension", TargetRightAscension=ra_h)
    await german.put("synctotarget")
    assert await german.miss_arcsec(ra_h, 23.6) < 10.0


@pytest.mark.long
async def test_an_abort_stops_whatever_moves_and_is_no_failure(observatory: Running) -> None:
    german = observatory.probe
    await german.put("abortslew")
    await german.until_rest()
    ra_h = await german.at_hour_angle(-3.0)
    await german.put("slewtocoordinatesasync", RightAscension=ra_h, Declination=20.0)
    assert await german.get("slewing") is True
    await german.put("abortslew")
    await german.until_rest()  # without an error
    assert await german.get("tracking") is True
    assert await german.miss_arcsec(ra_h, 20.0) > 3600.0
    # somebody else's slew, too, and by another client than the one that looks on
    await observatory.service.dispatcher.order(
        SOMEBODY, "german", SlewOrder(target=AltAzTarget(alt_deg=40.0, az_deg=90.0))
    )
    assert await german.get("slewing") is True
    await german.as_client(8).put("abortslew")
    await german.until_rest()


@pytest.mark.long
async def test_an_order_right_after_an_abort_waits_for_it(observatory: Running) -> None:
    german = observatory.probe
    ra_h = await german.at_hour_angle(-3.0)
    await german.put("slewtocoordinatesasync", RightAscension=ra_h, Declination=20.0)
    await german.put("abortslew")
    await german.put("tracking", Tracking=False)
    await german.until_rest()
    assert await german.get("tracking") is False


@pytest.mark.long
async def test_a_slew_of_the_same_client_makes_room_for_its_next_and_of_nobody_else(fast: Running) -> None:
    german = fast.probe
    first = await german.at_hour_angle(-4.0)
    await german.put("slewtocoordinatesasync", RightAscension=first, Declination=60.0)
    # another client is told who holds it
    busy = await german.as_client(9).ask(
        "PUT", "slewtocoordinatesasync", RightAscension=first, Declination=20.0
    )
    assert busy.number == 0x40B
    assert "slew" in busy.words
    second = await german.at_hour_angle(-2.0)
    await german.put("slewtocoordinatesasync", RightAscension=second, Declination=40.0)
    await german.until_rest()
    assert await german.miss_arcsec(second, 40.0) < 2.0
    # a night's or a scheduler's work makes room for nobody
    job = await fast.service.dispatcher.order(
        SOMEBODY, "german", CenterOrder(target=AltAzTarget(alt_deg=40.0, az_deg=90.0))
    )
    place = {"RightAscension": second, "Declination": 30.0}
    assert await german.refused("PUT", "slewtocoordinatesasync", **place) == 0x40B
    assert await german.refused("PUT", "park") == 0x40B
    assert not job.is_over
    await german.put("abortslew")


@pytest.mark.long
async def test_a_slew_that_fails_raises_once_for_each_client_that_reads_slewing(
    observatory: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    german, other, silent = observatory.probe, observatory.probe.as_client(5), observatory.probe.as_client(0)
    navigator = observatory.service.observatory.telescope("german").navigator

    async def fails(target: object, **_: object) -> object:
        await asyncio.sleep(0.1)
        raise DeviceRefused("a gear is broken", device="german", reason=Refusal.OTHER)

    monkeypatch.setattr(navigator, "slew", fails)
    ra_h = await german.at_hour_angle(-1.0)
    await german.put("slewtocoordinatesasync", RightAscension=ra_h, Declination=20.0)
    async with asyncio.timeout(60):
        while (found := await german.ask("GET", "slewing")).value and not found.number:
            await asyncio.sleep(0.01)
    assert 0x500 <= found.number <= 0xFFF
    assert "a gear is broken" in found.words
    assert await german.get("slewing") is False
    assert await other.refused("GET", "slewing") == found.number
    assert await other.get("slewing") is False
    # one without a name can't be told apart from others: it is told until something is done about it
    for _ in range(2):
        assert await silent.refused("GET", "slewing") == found.number
    state = {one["Name"]: one["Value"] for one in await german.get("devicestate")}
    assert state["Slewing"] is False
    assert (
        await german.refused("PUT", "slewtocoordinates", RightAscension=ra_h, Declination=20.0)
        == found.number
    )
    await silent.put("abortslew")
    await silent.until_rest()


@pytest.mark.long
async def test_somebody_elses_stop_is_told_to_whoever_slews(observatory: Running) -> None:
    german = observatory.probe
    ra_h = await german.at_hour_angle(-3.0)
    await german.put("slewtocoordinatesasync", RightAscension=ra_h, Declination=20.0)
    await observatory.service.dispatcher.stop(SOMEBODY, "german")
    async with asyncio.timeout(60):
        while (found := await german.ask("GET", "slewing")).value and not found.number:
            await asyncio.sleep(0.02)
    assert found.number == 0x40E


@pytest.mark.long
async def test_parking_unparking_and_what_is_refused_between(fast: Running) -> None:
    german = fast.probe
    ra_h = await german.slew_to(-3.0, 20.0)
    await german.put("park")
    assert await german.get("slewing") is True
    await german.until_rest()
    assert await german.get("atpark") is True
    assert await german.get("tracking") is False
    await german.put("park")  # harmless
    assert await german.get("slewing") is False
    assert await german.get("atpark") is True
    place = {"RightAscension": ra_h, "Declination": 20.0}
    await german.put("targetrightascension", TargetRightAscension=ra_h)
    await german.put("targetdeclination", TargetDeclination=20.0)
    for member, given in (
        ("slewtocoordinates", place),
        ("slewtocoordinatesasync", place),
        ("synctocoordinates", place),
        ("slewtotarget", {}),
        ("slewtotargetasync", {}),
        ("synctotarget", {}),
        ("slewtoaltaz", {"Azimuth": 150.0, "Altitude": 50.0}),
        ("slewtoaltazasync", {"Azimuth": 150.0, "Altitude": 50.0}),
        ("findhome", {}),
        ("pulseguide", {"Direction": 2, "Duration": 0}),
        ("tracking", {"Tracking": True}),
        ("abortslew", {}),
    ):
        assert await german.refused("PUT", member, **given) == 0x408, member
    await german.put("tracking", Tracking=False)
    await german.put("unpark")
    await german.until_rest()
    assert await german.get("atpark") is False
    await german.put("unpark")  # harmless
    await german.put("tracking", Tracking=True)
    assert await german.get("tracking") is True
    await german.put("setpark")


@pytest.mark.long
async def test_finding_home_does_not_park(fast: Running) -> None:
    german = fast.probe
    await german.put("tracking", Tracking=False)
    await german.put("findhome")
    assert await german.get("slewing") is True
    await german.until_rest()
    assert await german.get("athome") is True
    assert await german.get("atpark") is False
    await german.put("tracking", Tracking=True)
    await german.slew_to(-2.0, 30.0)
    assert await german.get("athome") is False


@pytest.mark.long
async def test_guide_pulses_of_both_axes_may_be_asked_at_once(observatory: Running) -> None:
    german = observatory.probe
    assert await german.get("ispulseguiding") is False
    before = await german.get("declination")
    await german.put("pulseguide", Direction=0, Duration=400)
    assert await german.get("ispulseguiding") is True
    assert await german.get("slewing") is False
    await german.put("pulseguide", Direction=2, Duration=200)
    for direction in (0, 1, 2, 3):
        assert await german.refused("PUT", "pulseguide", Direction=direction, Duration=200) == 0x40B
    await german.until("ispulseguiding", False)
    await observatory.service.dispatcher.watch("german").refresh()
    assert await german.get("declination") > before
    for direction in (0, 1, 2, 3):
        await german.put("pulseguide", Direction=direction, Duration=50)
        await german.until("ispulseguiding", False)
    # no pulse while it slews
    ra_h = await german.at_hour_angle(-2.0)
    await german.put("slewtocoordinatesasync", RightAscension=ra_h, Declination=20.0)
    assert await german.refused("PUT", "pulseguide", Direction=0, Duration=100) == 0x40B
    assert await german.get("ispulseguiding") is False
    await german.put("abortslew")


@pytest.mark.long
async def test_a_pulse_moves_as_far_as_the_guide_rates_say(observatory: Running) -> None:
    german, duration_s = observatory.probe, 1.0
    rates = {
        0: await german.get("guideratedeclination"),
        2: await german.get("guideraterightascension"),
    }
    # degrees per second, of the order of the sidereal rate
    assert all(0.1 < rate * 240.0 < 1.1 for rate in rates.values())
    for direction, rate_deg_s in rates.items():
        before = await german.get("rightascension") * 15.0, await german.get("declination")
        await german.put("pulseguide", Direction=direction, Duration=int(duration_s * 1000))
        await german.until("ispulseguiding", False)
        after = await german.get("rightascension") * 15.0, await german.get("declination")
        moved = after[1] - before[1] if direction == 0 else (after[0] - before[0] + 180.0) % 360.0 - 180.0
        assert moved * 3600.0 == pytest.approx(rate_deg_s * duration_s * 3600.0, abs=1.0)
    # they are the mount's: not to be set from here, and not known where it doesn't tell
    assert await german.get("cansetguiderates") is False
    for member, name in (
        ("guideratedeclination", "GuideRateDeclination"),
        ("guideraterightascension", "GuideRateRightAscension"),
    ):
        assert await german.refused("PUT", member, **{name: 0.002}) == 0x400
        assert await german.at(1).refused("GET", member) == 0x400


@pytest.mark.long
@pytest.mark.parametrize("by", ["alpaca", "another face"])
async def test_a_stop_ends_the_pulse_that_waits(observatory: Running, by: str) -> None:
    german = observatory.probe
    await german.put("pulseguide", Direction=0, Duration=3000)
    await german.put("pulseguide", Direction=2, Duration=3000)
    if by == "alpaca":
        await german.put("abortslew")
    else:
        await observatory.service.dispatcher.stop(SOMEBODY, "german")
        # who didn't stop it himself is told
        async with asyncio.timeout(60):
            while not (told := await german.ask("GET", "ispulseguiding")).number:
                await asyncio.sleep(0.01)
        assert told.number == 0x40E
    await german.until("ispulseguiding", False)
    kinds = [job.kind for job in observatory.service.jobs.all()]
    assert kinds.count("guide") == 1


@pytest.mark.long
async def test_tracking_rates(observatory: Running) -> None:
    german = observatory.probe
    rates = await german.get("trackingrates")
    assert rates == [0, 1, 2, 3]
    for rate in (*rates, 0):
        await german.put("trackingrate", TrackingRate=rate)
        assert await german.get("trackingrate") == rate
        assert await german.get("tracking") is True
    # kept for when it tracks again
    await german.put("tracking", Tracking=False)
    await german.put("trackingrate", TrackingRate=1)
    assert await german.get("tracking") is False
    await german.put("tracking", Tracking=True)
    assert await german.get("trackingrate") == 1
    assert observatory.service.observatory.telescope("german").navigator.mount.tracking_rate == "lunar"
    await german.put("trackingrate", TrackingRate=0)


@pytest.mark.long
async def test_settling_counts_as_slewing(fast: Running) -> None:
    german = fast.probe
    await german.put("slewsettletime", SlewSettleTime=SETTLE_S)
    assert await german.get("slewsettletime") == SETTLE_S
    ra_h = await german.at_hour_angle(-0.2)
    loop = asyncio.get_running_loop()
    await german.put("slewtocoordinatesasync", RightAscension=ra_h, Declination=46.0)
    job = fast.service.jobs.running_on("german")
    assert job is not None
    await job.ended.wait()
    ended = loop.time()
    assert await german.get("slewing") is True
    await german.until_rest()
    assert loop.time() - ended > SETTLE_S / SPEED * 0.9
    # an abort waits for no settling
    await german.put("slewsettletime", SlewSettleTime=300)
    before = len(fast.service.jobs.all())
    await german.put("slewtocoordinatesasync", RightAscension=ra_h, Declination=45.0)
    job = fast.service.jobs.running_on("german")
    assert job is not None
    await job.ended.wait()
    ended = loop.time()
    assert await german.get("slewing") is True
    await german.put("abortslew")
    await german.until_rest()
    assert loop.time() - ended < 300.0 / SPEED * 0.9
    assert len(fast.service.jobs.all()) == before + 1


@pytest.mark.long
async def test_a_lease_of_somebody_else_is_told_with_its_holders_name(observatory: Running) -> None:
    german, leases = observatory.probe, observatory.service.leases
    await leases.take(Caller("dome computer", Role.OPERATE, Face.REST), "german", ttl_s=60.0)
    ra_h = await german.at_hour_angle(-1.0)
    found = await german.ask("PUT", "slewtocoordinatesasync", RightAscension=ra_h, Declination=20.0)
    assert found.number == 0x40B
    assert "dome computer" in found.words
    assert await german.get("slewing") is False
    for member in ("park", "findhome"):
        assert await german.refused("PUT", member) == 0x40B
    await german.put("abortslew")  # a stop is anybody's


@pytest.mark.long
async def test_what_a_fork_without_skills_cant_it_says(fast: Running) -> None:
    fork = fast.probe.at(1)
    for member in (
        "canfindhome",
        "canunpark",
        "cansettracking",
        "canslewaltaz",
        "canslewaltazasync",
        "cansetpark",
        "cansetpierside",
    ):
        assert await fork.get(member) is False, member
    for member in ("canslew", "canslewasync", "cansync", "canpulseguide"):
        assert await fork.get(member) is True, member
    for member, given in (
        ("findhome", {}),
        ("unpark", {}),
        ("setpark", {}),
        ("tracking", {"Tracking": True}),
        ("slewtoaltaz", {"Azimuth": 10, "Altitude": 50}),
        ("slewtoaltazasync", {"Azimuth": 10, "Altitude": 50}),
    ):
        assert await fork.refused("PUT", member, **given) == 0x400, member
    assert await fork.refused("GET", "sideofpier") == 0x400
    assert await fork.refused("GET", "destinationsideofpier", RightAscension=1, Declination=1) == 0x400
    assert await fork.get("alignmentmode") == 1
    assert await fork.get("equatorialsystem") == 1
    assert await fork.get("tracking") is True
    ra_h = await fork.slew_to(-1.0, 30.0)
    # its answers have a step of a second of time
    assert await fork.miss_arcsec(ra_h, 30.0) < 16.0


@pytest.mark.long
async def test_a_mount_of_j2000_is_told_so_and_spoken_to_in_j2000() -> None:
    toml = OBSERVATORY.replace('mounting = "german"\n', 'mounting = "german"\nepoch = "icrs"\n')
    async with running(toml, speed=SPEED) as found:
        german = found.probe
        assert await german.get("equatorialsystem") == 2
        ra_h = await german.slew_to(-2.0, 30.0)
        assert await german.miss_arcsec(ra_h, 30.0) < 2.0
        icrs = found.service.dispatcher.watch("german").latest.state.icrs
        assert icrs is not None
        assert icrs.ra_deg == pytest.approx(ra_h * 15.0, abs=1e-3)
