"""Every member by alpyca, the standard's own Python client, over a real socket; and its discovery."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime

import alpaca.discovery
import httpx
import pytest
from alpaca import management
from alpaca.exceptions import (
    ActionNotImplementedException,
    DriverException,
    InvalidOperationException,
    InvalidValueException,
    NotConnectedException,
    NotImplementedException,
    ParkedException,
    ValueNotSetException,
)
from alpaca.telescope import (
    AlignmentModes,
    DriveRates,
    EquatorialCoordinateType,
    GuideDirections,
    PierSide,
    Telescope,
    TelescopeAxes,
)

from api.http.app import create_app
from api.http.serving import bind, make_server
from mountnav.clock import in_virtual_time, utc_now
from mountnav.settings.observatory import Settings
from mountnav.simulation.sky_clock import FastClock
from tests.api.alpaca.alpaca_observatory import OBSERVATORY, SPEED


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service on a real socket, in a thread, with discovery on a port that alpyca is told."""
    toml = OBSERVATORY.replace("discovery = false", "discovery_port = 0")
    with (
        pytest.MonkeyPatch.context() as patch,
        in_virtual_time(FastClock(SPEED, utc_now())),
        bind("127.0.0.1", 0) as listener,
    ):
        patch.setenv("MOUNTNAV_JOURNAL", str(tmp_path_factory.mktemp("alpyca") / "journal.sqlite"))
        app = create_app(Settings.parse(toml))
        app.state.http_address = listener.getsockname()[:2]
        server = make_server(app, log_level="warning")
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="service")
        thread.start()
        try:
            while not server.started:
                assert thread.is_alive(), "the service did not start"
                time.sleep(0.01)
            patch.setattr(
                alpaca.discovery, "port", app.state.service.listeners.states["alpaca-discovery"].port
            )
            yield f"127.0.0.1:{listener.getsockname()[1]}"
        finally:
            server.should_exit = True
            thread.join()


@pytest.fixture
def telescope(address: str) -> Iterator[Telescope]:
    """The German mount, connected, and left at rest."""
    found = Telescope(address, 0)
    found.Connected = True
    if found.AtPark:
        found.Unpark()
        _until(lambda: not found.AtPark)
    found.Tracking = True
    yield found
    found.Connected = False


def _until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < deadline, "it never came"
        time.sleep(0.02)


def test_management(address: str) -> None:
    assert management.apiversions(address) == [1]
    assert management.description(address)["ServerName"] == "mountnav"
    devices = management.configureddevices(address)
    assert [one["DeviceNumber"] for one in devices] == [0, 1, 2]
    assert {one["DeviceType"] for one in devices} == {"Telescope"}


@pytest.mark.long
def test_alpycas_own_search_finds_it(address: str) -> None:
    _until(lambda: address in alpaca.discovery.search_ipv4(numquery=1, timeout=1))


@pytest.mark.long
def test_what_it_is_and_can(telescope: Telescope) -> None:
    assert telescope.Connected
    assert not telescope.Connecting
    assert telescope.InterfaceVersion == 4
    assert telescope.Name == "mountnav german"
    assert "german" in telescope.Description
    assert telescope.DriverInfo
    assert telescope.DriverVersion
    assert telescope.SupportedActions == []
    with pytest.raises(ActionNotImplementedException):
        telescope.Action("anything")
    for command in (telescope.CommandBlind, telescope.CommandBool, telescope.CommandString):
        with pytest.raises(NotImplementedException):
            command("x", True)
    yes = "FindHome Park PulseGuide SetPark SetTracking Slew SlewAltAz SlewAltAzAsync SlewAsync Sync Unpark"
    for name in yes.split():
        assert getattr(telescope, f"Can{name}") is True, name
    for name in ["SetGuideRates", "SetPierSide", "SyncAltAz"]:
        assert getattr(telescope, f"Can{name}") is False, name
    for axis in (TelescopeAxes.axisPrimary, TelescopeAxes.axisSecondary):
        assert telescope.CanMoveAxis(axis) is True
        assert all(0.0 <= one.Minimum <= one.Maximum for one in telescope.AxisRates(axis))
        with pytest.raises(InvalidValueException):
            telescope.MoveAxis(axis, 1000.0)
    assert telescope.CanMoveAxis(TelescopeAxes.axisTertiary) is False
    assert telescope.AxisRates(TelescopeAxes.axisTertiary) == []
    assert telescope.AlignmentMode is AlignmentModes.algGermanPolar
    assert telescope.EquatorialSystem is EquatorialCoordinateType.equTopocentric
    assert telescope.DoesRefraction is False
    assert telescope.FocalLength == 0.8
    assert telescope.ApertureDiameter == 0.2
    assert (telescope.SiteLatitude, telescope.SiteLongitude, telescope.SiteElevation) == (47.0, 11.0, 580.0)
    assert telescope.RightAscensionRate == telescope.DeclinationRate == 0.0
    for name, value in (
        ("DoesRefraction", True),
        ("SiteLatitude", 40.0),
        ("SiteLongitude", 10.0),
        ("SiteElevation", 100.0),
        ("GuideRateRightAscension", 0.002),
        ("GuideRateDeclination", 0.002),
        ("SideOfPier", PierSide.pierWest),
        ("UTCDate", datetime.now(UTC)),
    ):
        with pytest.raises(NotImplementedException):
            setattr(telescope, name, value)
    with pytest.raises(NotImplementedException):
        _ = telescope.ApertureArea
    # half the sidereal rate, in degrees per second, as the mount says
    half = pytest.approx(0.5 * 15.041 / 3600.0, rel=1e-3)
    assert telescope.GuideRateRightAscension == half
    assert telescope.GuideRateDeclination == half


@pytest.mark.long
def test_rates_beside_the_sidereal_one_are_kept_and_end(telescope: Telescope) -> None:
    assert telescope.CanSetRightAscensionRate is True
    assert telescope.CanSetDeclinationRate is True
    telescope.Tracking = True
    telescope.RightAscensionRate = 0.01
    telescope.DeclinationRate = -0.1
    assert telescope.RightAscensionRate == pytest.approx(0.01, rel=1e-3)
    assert telescope.DeclinationRate == pytest.approx(-0.1, rel=1e-3)
    telescope.RightAscensionRate = 0.0
    telescope.DeclinationRate = 0.0
    assert telescope.RightAscensionRate == telescope.DeclinationRate == 0.0


def test_what_it_reads(telescope: Telescope) -> None:
    assert 0.0 <= telescope.RightAscension < 24.0
    assert -90.0 <= telescope.Declination <= 90.0
    assert 0.0 <= telescope.Azimuth < 360.0
    assert -90.0 <= telescope.Altitude <= 90.0
    assert 0.0 <= telescope.SiderealTime < 24.0
    assert abs((telescope.UTCDate - utc_now().replace(tzinfo=telescope.UTCDate.tzinfo)).total_seconds()) < 600
    assert telescope.AtPark is False
    assert telescope.Slewing is False
    assert telescope.IsPulseGuiding is False
    assert telescope.SideOfPier in (PierSide.pierEast, PierSide.pierWest)
    state = {one["Name"]: one["Value"] for one in telescope.DeviceState}
    assert {"RightAscension", "Declination", "Slewing", "Tracking", "UTCDate", "TimeStamp"} <= set(state)


@pytest.mark.long
def test_a_slew_a_sync_and_an_abort(telescope: Telescope) -> None:
    with pytest.raises(ValueNotSetException):
        _ = telescope.TargetDeclination
    for ra_h, dec_deg in ((24.0, 0.0), (-1.0, 0.0), (1.0, 91.0)):
        with pytest.raises(InvalidValueException):
            telescope.SlewToCoordinatesAsync(ra_h, dec_deg)
    ra_h = (telescope.SiderealTime + 3.0) % 24.0
    assert telescope.DestinationSideOfPier(ra_h, 30.0) == PierSide.pierWest.value
    telescope.SlewToCoordinatesAsync(ra_h, 30.0)
    assert telescope.Slewing
    _until(lambda: not telescope.Slewing)
    assert telescope.RightAscension == pytest.approx(ra_h, abs=1e-4)
    assert telescope.Declination == pytest.approx(30.0, abs=1e-3)
    assert telescope.SideOfPier is PierSide.pierWest
    telescope.SyncToCoordinates(ra_h, 30.5)
    assert telescope.Declination == pytest.approx(30.5, abs=1e-3)
    assert telescope.TargetDeclination == 30.5
    telescope.TargetRightAscension = ra_h
    telescope.TargetDeclination = 30.0
    telescope.SyncToTarget()
    assert telescope.Declination == pytest.approx(30.0, abs=1e-3)
    with pytest.raises(NotImplementedException):
        telescope.SyncToAltAz(100.0, 50.0)
    telescope.TargetDeclination = 80.0
    telescope.SlewToTargetAsync()
    telescope.AbortSlew()
    _until(lambda: not telescope.Slewing)
    telescope.Tracking = False
    with pytest.raises(InvalidOperationException):
        telescope.SlewToCoordinatesAsync(ra_h, 30.0)
    telescope.SlewToAltAzAsync(150.0, 50.0)
    _until(lambda: not telescope.Slewing)
    assert telescope.Azimuth == pytest.approx(150.0, abs=1.0)
    assert telescope.Tracking is False


@pytest.mark.long
def test_rates_settling_and_guiding(telescope: Telescope) -> None:
    assert [DriveRates(one) for one in telescope.TrackingRates] == list(DriveRates)
    telescope.TrackingRate = DriveRates.driveLunar
    assert telescope.TrackingRate is DriveRates.driveLunar
    telescope.TrackingRate = DriveRates.driveSidereal
    telescope.SlewSettleTime = 1
    assert telescope.SlewSettleTime == 1
    telescope.SlewSettleTime = 0
    telescope.PulseGuide(GuideDirections.guideNorth, 4000)
    assert telescope.IsPulseGuiding
    assert not telescope.Slewing
    telescope.PulseGuide(GuideDirections.guideEast, 1000)
    _until(lambda: not telescope.IsPulseGuiding)


@pytest.mark.long
def test_home_park_and_unpark(telescope: Telescope) -> None:
    telescope.FindHome()
    assert telescope.Slewing
    _until(lambda: not telescope.Slewing)
    assert telescope.AtHome
    telescope.Park()
    _until(lambda: not telescope.Slewing)
    assert telescope.AtPark
    telescope.Park()
    assert telescope.AtPark
    for order in (telescope.FindHome, telescope.AbortSlew, telescope.SyncToTarget):
        with pytest.raises((ParkedException, ValueNotSetException)):
            order()
    with pytest.raises(ParkedException):
        telescope.Tracking = True
    telescope.Tracking = False
    telescope.Unpark()
    _until(lambda: not telescope.Slewing)
    assert not telescope.AtPark
    telescope.Unpark()
    telescope.SetPark()


def test_connecting_and_disconnecting(address: str) -> None:
    one = Telescope(address, 0)
    one.Connect()
    _until(lambda: not one.Connecting)
    assert one.Connected
    one.Disconnect()
    assert not one.Connected
    with pytest.raises(NotConnectedException):
        _ = one.RightAscension
    # one that sends no ids is another client
    other = httpx.get(f"http://{address}/api/v1/telescope/0/connected", trust_env=False)
    assert other.json()["Value"] is True
    gone = Telescope(address, 2)
    with pytest.raises(DriverException, match="there-is-no-such-port"):
        gone.Connected = True
