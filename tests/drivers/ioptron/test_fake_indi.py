"""The real INDI drivers against the fake: they get their way, and report the fake's own position."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from mountnav.devices import PierSide
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.indi_process import Indi, running
from tests.drivers.ioptron.german_fakes import at_hour_angle, beside, fake_of, mechanics_of

# driver, its device, the fake's command set, whether it tells the side of the pier
V3 = ("indi_ioptronv3_telescope", "iOptronV3", "v3", True)
V2 = ("indi_ieq_telescope", "iEQ", "v2", True)
OLDER = ("indi_ieqlegacy_telescope", "iEQ", "v2", False)


@pytest.mark.long
@pytest.mark.parametrize(
    ("judge", "tcp", "poll_ms"),
    [
        (V3, False, 250),
        (V3, True, 250),
        (V2, False, 1000),
        (V2, True, 250),
        (OLDER, False, 250),
    ],
    ids=["v3-pty", "v3-tcp", "v2-pty", "v2-tcp", "older-v2-pty"],
)
async def test_the_real_driver_goes_syncs_aborts_parks_and_tracks(
    judge: tuple[str, str, str, bool], tcp: bool, poll_ms: int, tmp_path: Path
) -> None:
    driver, device, dialect, tells_side = judge
    mechanics = mechanics_of(slew_rate_deg_s=60.0)
    fake = fake_of(mechanics, dialect=dialect)
    bench = FakeOnTcp(fake) if tcp else FakeOnPty(fake)
    with bench:
        async with running(driver, device, tmp_path) as indi:

            async def agrees(what: str) -> None:
                await indi.until(
                    lambda: separation_arcsec(indi.place(), mechanics.reported()) < 0.1,
                    f"agreeing with the fake {what}",
                )
                if tells_side:
                    side = "PIER_EAST" if mechanics.pier_side() is PierSide.EAST else "PIER_WEST"
                    await indi.until(lambda: indi.values["TELESCOPE_PIER_SIDE", side] == "On", f"on {side}")

            await indi.connect(bench)
            await indi.give("Number", "POLLING_PERIOD", PERIOD_MS=str(poll_ms))
            await indi.until(lambda: ("EQUATORIAL_EOD_COORD", "RA") in indi.values, "telling a place")
            await agrees("at the beginning")
            assert mechanics.pier_side() is PierSide.EAST

            across = at_hour_angle(-30.0, 30.0)
            await indi.aim("TRACK", across)
            await indi.until(mechanics.slewing, "slewing")
            await indi.until(
                lambda: not mechanics.slewing() and indi.states["EQUATORIAL_EOD_COORD"] == "Ok", "arrived"
            )
            assert separation_arcsec(mechanics.reported(), across) < 0.5
            assert mechanics.pier_side() is PierSide.WEST
            await agrees("after a slew")

            shifted, truth = beside(across, 0.3, 0.1), mechanics.truth()
            await indi.aim("SYNC", shifted)
            await indi.until(lambda: b":CM#" in fake.heard, "syncing")
            await agrees("after a sync")
            assert separation_arcsec(indi.place(), shifted) < 0.5
            assert separation_arcsec(mechanics.truth(), truth) < 1.0

            mechanics.slew_rate_deg_s = 1.0
            back = at_hour_angle(25.0, 45.0)
            await indi.aim("TRACK", back)
            await indi.until(mechanics.slewing, "slewing again")
            await indi.give("Switch", "TELESCOPE_ABORT_MOTION", ABORT="On")
            await indi.until(lambda: not mechanics.slewing(), "stopped")
            assert b":Q#" in fake.heard
            assert separation_arcsec(mechanics.reported(), back) > 3600.0

            mechanics.slew_rate_deg_s = 60.0
            await _parks(indi, lambda: mechanics.parked)
            # the driver's park position is the pole, where home is
            assert abs(mechanics.axes().ha_axis_deg - 90.0) < 1.0
            await indi.give("Switch", "TELESCOPE_PARK", UNPARK="On")
            await indi.until(lambda: not mechanics.parked, "unparked")
            await indi.give("Switch", "TELESCOPE_TRACK_STATE", TRACK_ON="On")
            await indi.until(lambda: mechanics.tracking, "tracking")
    assert fake.unknown == []


async def _parks(indi: Indi, parked: Callable[[], bool]) -> None:
    await indi.give("Switch", "TELESCOPE_PARK", PARK="On")
    await indi.until(parked, "parked")
    await indi.until(
        lambda: indi.states["TELESCOPE_PARK"] == "Ok" and indi.values["TELESCOPE_PARK", "PARK"] == "On",
        "saying that it is parked",
    )


async def test_the_real_driver_tells_the_mounts_own_clock_and_site(tmp_path: Path) -> None:
    fake = fake_of()
    with FakeOnPty(fake) as bench:
        async with running("indi_ioptronv3_telescope", "iOptronV3", tmp_path) as indi:
            fake.feed(b":SG+120#:SLO-13284000#:SLA-10800000#")
            await indi.connect(bench)

            def site() -> tuple[float, ...]:
                told = (indi.values.get(("GEOGRAPHIC_COORD", name), "0") for name in ("LAT", "LONG"))
                return tuple(float(one) for one in told)

            await indi.until(lambda: site() == pytest.approx((-30.0, 360.0 - 36.9)), "telling the site")
            await indi.until(lambda: indi.values.get(("TIME_UTC", "OFFSET")) == "2.00", "telling the zone")
            # and sets them: longitudes to the east, half a degree from the first
            await indi.give("Number", "GEOGRAPHIC_COORD", LAT="49.6", LONG="37.4", ELEV="100")
            await indi.until(lambda: b":SLO+13464000#" in fake.heard, "setting the longitude")
            await indi.until(lambda: b":SLA+17856000#" in fake.heard, "setting the latitude")
            assert fake.mechanics.believed_site.longitude_deg == pytest.approx(37.4)


@pytest.mark.long
async def test_the_real_driver_guides_the_right_way(tmp_path: Path) -> None:
    fake = fake_of()
    fake.feed(b":RG9090#")
    mechanics = fake.mechanics
    with FakeOnPty(fake) as bench:
        async with running("indi_ioptronv3_telescope", "iOptronV3", tmp_path) as indi:
            await indi.connect(bench)
            await indi.until(lambda: "TELESCOPE_TIMED_GUIDE_NS" in indi.states, "ready to guide")
            for name, element, other, axis, sign in (
                ("TELESCOPE_TIMED_GUIDE_NS", "TIMED_GUIDE_N", "TIMED_GUIDE_S", "dec_deg", 1.0),
                ("TELESCOPE_TIMED_GUIDE_NS", "TIMED_GUIDE_S", "TIMED_GUIDE_N", "dec_deg", -1.0),
                ("TELESCOPE_TIMED_GUIDE_WE", "TIMED_GUIDE_W", "TIMED_GUIDE_E", "ra_deg", -1.0),
                ("TELESCOPE_TIMED_GUIDE_WE", "TIMED_GUIDE_E", "TIMED_GUIDE_W", "ra_deg", 1.0),
            ):
                before = getattr(mechanics.reported(), axis)
                count = len(fake.obeyed)
                await indi.give("Number", name, **{element: "200", other: "0"})
                await indi.until(
                    lambda count=count: any(one[:2] == b":Z" for one in fake.obeyed[count:]),  # type: ignore[misc]
                    f"guiding by {element}",
                )
                await indi.until(lambda: not mechanics.guiding(), "through with it")
                moved_arcsec = (getattr(mechanics.reported(), axis) - before) * 3600.0
                assert moved_arcsec * sign == pytest.approx(0.9 * 15.04 * 0.2, abs=0.3)
    assert fake.unknown == []
