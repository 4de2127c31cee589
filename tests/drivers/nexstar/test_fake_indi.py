"""The judge of the fake hand control: the real INDI driver drives it and must believe it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.nexstar.codec import base
from drivers.nexstar.fake import FakeNexstar, make_fake
from mountnav.clock import utc_now
from mountnav.devices import PierSide
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.chain import sidereal_time_deg
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.indi_process import running

HERE = Site(49.6, 36.9)


# five of its ten seconds the driver waits for a focuser that isn't there
@pytest.mark.long
@pytest.mark.parametrize("tcp", [False, True])
async def test_the_real_driver_believes_the_fake(tmp_path: Path, tcp: bool) -> None:
    now = utc_now()
    start = Apparent((sidereal_time_deg(now, HERE) - 40.0) % 360.0, 30.0, now)
    mechanics = Mechanics(
        HERE,
        Air(),
        PointingErrors(),
        machine=Machine(mounting="german"),
        slew_rate_deg_s=60.0,
        acceleration_deg_s2=120.0,
        start=start,
    )
    fake = FakeNexstar(mechanics)
    async with running("indi_celestron_gps", "Celestron GPS", tmp_path) as indi:
        with FakeOnTcp(fake) if tcp else FakeOnPty(fake) as bench:
            await indi.connect(bench)
            await indi.give("Number", "POLLING_PERIOD", PERIOD_MS="200")
            assert not mechanics.slewing()

            def agree(within_arcsec: float = 1.0) -> bool:
                believed = replace(mechanics.reported(), utc=utc_now())
                return separation_arcsec(indi.place(), believed) < within_arcsec

            def said(words: str) -> bool:
                return any(words in one for one in indi.said)

            def side() -> str:
                return next(
                    name
                    for name in ("PIER_EAST", "PIER_WEST")
                    if indi.values["TELESCOPE_PIER_SIDE", name] == "On"
                )

            await indi.until(agree, "agreeing at the start")
            await indi.until(lambda: side() == "PIER_EAST", "seeing the tube in the east")

            # over the meridian: the mount changes sides, and the driver sees that
            target = Apparent((start.ra_deg + 60.0) % 360.0, 42.0, utc_now())
            await indi.aim("TRACK", target)
            await indi.until(lambda: said("Slew complete"), "arrived")
            await indi.until(agree, "agreeing after the goto")
            assert separation_arcsec(mechanics.reported(), replace(target, utc=utc_now())) < 1.0
            assert mechanics.tracking
            assert mechanics.pier_side() is PierSide.WEST
            await indi.until(lambda: side() == "PIER_WEST", "seeing the tube in the west")

            tube = mechanics.axes()
            shifted = Apparent((target.ra_deg + 0.3) % 360.0, target.dec_deg + 0.1, utc_now())
            await indi.aim("SYNC", shifted)
            await indi.until(
                lambda: separation_arcsec(indi.place(), replace(shifted, utc=utc_now())) < 1.0, "synced"
            )
            assert agree()
            assert abs(mechanics.axes().dec_axis_deg - tube.dec_axis_deg) < 1e-6

            away = Apparent(start.ra_deg, 0.0, utc_now())
            await indi.aim("TRACK", away)
            await indi.until(mechanics.slewing, "setting out")
            await indi.give("Switch", "TELESCOPE_ABORT_MOTION", ABORT="On")
            await indi.until(lambda: not mechanics.slewing(), "at rest after the abort")
            await indi.until(agree, "agreeing after the abort")
            assert separation_arcsec(indi.place(), replace(away, utc=utc_now())) > 3600.0
            assert mechanics.tracking

            # north is up, whichever side the tube hangs on
            before_deg = mechanics.reported().dec_deg
            await indi.give("Switch", "TELESCOPE_MOTION_NS", MOTION_NORTH="On")
            await indi.until(lambda: mechanics.reported().dec_deg > before_deg + 0.005, "moving north")
            await indi.give("Switch", "TELESCOPE_MOTION_NS", MOTION_NORTH="Off", MOTION_SOUTH="Off")
            await indi.until(lambda: not mechanics.slewing(), "at rest after the move")

            await indi.give("Switch", "TELESCOPE_PARK", PARK="On")
            await indi.until(lambda: said("Mount is parked"), "parked")
            assert not mechanics.tracking
            assert not mechanics.slewing()
            # it goes to its own az 0, alt 0, and tracks on for the moment until it has seen that
            horizon = base.GET_HORIZON.read(fake.feed(b"z"), False)
            assert horizon is not None
            off_arcsec = separation_arcsec(
                Icrs(horizon.value.first_deg, horizon.value.second_deg), Icrs(0.0, 0.0)
            )
            assert off_arcsec < 30.0
            await indi.give("Switch", "TELESCOPE_PARK", UNPARK="On")
            await indi.until(lambda: indi.values["TELESCOPE_PARK", "UNPARK"] == "On", "unparked")
            await indi.give("Switch", "TELESCOPE_TRACK_STATE", TRACK_ON="On")
            await indi.until(lambda: mechanics.tracking, "tracking again")

            # nothing it said was beyond the fake, but for a focuser that isn't there
            assert {command[:4] for command in fake.unknown} <= {b"P\x01\x12\xfe"}
            await indi.give("Switch", "CONNECTION", DISCONNECT="On")
            await indi.until(lambda: indi.values["CONNECTION", "CONNECT"] == "Off", "disconnected")


# five of its five seconds it waits for a focuser that isn't there
@pytest.mark.long
async def test_it_believes_an_older_one_too(tmp_path: Path) -> None:
    mechanics = Mechanics(HERE, Air(), PointingErrors())
    fake = make_fake("nexstar-4", mechanics)
    async with running("indi_celestron_gps", "Celestron GPS", tmp_path) as indi:
        with FakeOnPty(fake) as bench:
            await indi.connect(bench)
            await indi.until(
                lambda: separation_arcsec(indi.place(), replace(mechanics.reported(), utc=utc_now())) < 1.0,
                "agreeing",
            )
            # whole-hour zones, and neither kind nor quarters asked for
            assert b"h" in fake.heard
            assert {command[:4] for command in fake.unknown} <= {b"P\x01\x12\xfe"}
