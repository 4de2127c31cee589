"""A small Alpaca server of the tests' own: the standard library's HTTP, own parsing, the mechanics behind.

It shares nothing with our driver but the mechanics, so that a misreading shows. Written from the published
reference: lower-case paths, queries in any case, forms in exact case, an envelope with nothing added.
"""

from __future__ import annotations

import base64
import contextlib
import gzip
import json
import math
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from mountnav.clock import utc_now
from mountnav.devices import PierSide, TrackingRate
from mountnav.errors import Refusal
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.chain import apparent_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Apparent, Icrs, Site

HERE = Site(49.6, 36.9, 140.0)
_SIDES = {PierSide.EAST: 0, PierSide.WEST: 1, PierSide.UNKNOWN: -1}
_RATES = (TrackingRate.SIDEREAL, TrackingRate.LUNAR, TrackingRate.SOLAR, TrackingRate.KING)
ARCSEC_S_OF_RA_RATE = 15.0 / 0.9972695677
"""Arcseconds per SI second of one RightAscensionRate, by the factor that ASCOM's page gives."""
_GUIDE_DEG_S = 0.5 * 15.041 / 3600.0
_CODES = {
    "int16": 1, "int32": 2, "float64": 3, "float32": 4, "uint64": 5, "uint8": 6, "int64": 7, "uint16": 8,
    "uint32": 9,
}  # fmt: skip


_FREE = {"name", "driverinfo", "driverversion", "interfaceversion", "connected", "connect", "connecting"}
"""These answer without a connection."""


class AlpacaError(Exception):
    def __init__(self, number: int, message: str) -> None:
        super().__init__(message)
        self.number, self.message = number, message


class Bad(Exception):
    """HTTP status 400."""


NOT_IMPLEMENTED = AlpacaError(0x400, "is not implemented")


@dataclass
class Fault:
    """Something that goes wrong with the next requests of one member.

    What: "slow" (seconds), "deaf" (done, never answered within seconds), "drop" (done, connection closed
    without an answer), "refuse-connection" (closed before anything is done), "wrong-id", "html", "status",
    "error" (number, message), "denied" (the same, but done), "text" (that body), "ignored" (answered, not
    done), "half" (cut in the middle).
    """

    member: str
    what: str
    times: int = 1
    seconds: float = 0.0
    number: int = 0
    body: str = ""
    verb: str = ""
    """Of the requests that it meets: "get", "put", or all of them."""
    over: bool = False
    """Set when a slow one has waited."""


class FakeDevice:
    """What telescopes and cameras have in common."""

    kind = ""
    newest = 4

    def __init__(self, version: int) -> None:
        self.version = version
        self.connected = False
        self.connects_in_s = 0.05
        self.connect_error: AlpacaError | None = None
        self.answers_connecting_after_s = 0.0
        self._connecting_until_s = 0.0
        self.missing: set[str] = set()
        """Members that say they are not implemented."""

    def need(self, form: dict[str, str], name: str, read: Callable[[str], Any]) -> Any:
        if name not in form:
            raise Bad(f"{name} is missing")
        try:
            value = read(form[name])
        except ValueError as fault:
            raise Bad(f"{name}={form[name]}: {fault}") from fault
        if isinstance(value, float) and not math.isfinite(value):
            raise Bad(f"{name} is not finite")
        return value

    @staticmethod
    def boolean(text: str) -> bool:
        if text.lower() not in ("true", "false"):
            raise ValueError(text)
        return text.lower() == "true"

    def answer(self, verb: str, member: str, form: dict[str, str]) -> Any:
        method = getattr(self, f"{verb}_{member}", None)
        if method is None:
            raise Bad(f"unknown {member}")
        if member not in _FREE and not self.is_connected():
            raise AlpacaError(0x407, "Not connected")
        if member in self.missing:
            raise NOT_IMPLEMENTED
        return method(form)

    def is_connected(self) -> bool:
        if self._connecting_until_s and time.monotonic() >= self._connecting_until_s:
            self._connecting_until_s = 0.0
            self.connected = self.connect_error is None
        return self.connected

    def get_interfaceversion(self, _: dict[str, str]) -> int:
        if self.version == 1:
            raise NOT_IMPLEMENTED
        return self.version

    def get_name(self, _: dict[str, str]) -> str:
        return f"Small {self.kind}"

    def get_driverinfo(self, _: dict[str, str]) -> str:
        return "written for the tests"

    def get_driverversion(self, _: dict[str, str]) -> str:
        return "1.0"

    def get_connected(self, _: dict[str, str]) -> bool:
        return self.is_connected()

    def put_connected(self, form: dict[str, str]) -> None:
        wanted = self.need(form, "Connected", self.boolean)
        if wanted and self.connect_error:
            raise self.connect_error
        time.sleep(self.answers_connecting_after_s)
        self.connected = wanted

    def put_connect(self, _: dict[str, str]) -> None:
        if self.version < 4:
            raise NOT_IMPLEMENTED
        self._connecting_until_s = time.monotonic() + self.connects_in_s

    def get_connecting(self, _: dict[str, str]) -> bool:
        if self.version < 4:
            raise NOT_IMPLEMENTED
        self.is_connected()
        if not self._connecting_until_s and self.connect_error:
            raise self.connect_error
        return bool(self._connecting_until_s)


class FakeTelescope(FakeDevice):
    """An ITelescope of version 1 to 4 over the mechanics."""

    kind = "telescope"

    def __init__(self, mechanics: Mechanics, version: int = 4, system: int = 1) -> None:
        super().__init__(version)
        self.mechanics = mechanics
        self.system = system
        self.can: dict[str, bool] = {}
        self.fails_after_s: float | None = None
        """A slew fails so long after its beginning."""
        self.failure: AlpacaError | None = None
        self._fails_at_s: float | None = None
        self.blocks = version < 4
        """Park and home answer when they are over."""
        self.site = [HERE.latitude_deg, HERE.longitude_deg, HERE.height_m]
        self.utc_off = timedelta(0)
        self.rates = [0.0, 0.0]
        """RightAscensionRate and DeclinationRate as they were set, in their own units."""
        self.ra_unit_arcsec_s = ARCSEC_S_OF_RA_RATE
        """What it makes of one RightAscensionRate; the right value, unless a test spoils it."""
        self.says_rates_after_abort = False
        """AbortSlew ends the rates, and they are still reported: as the simulator of ASCOM's makers does."""
        self.axis_rates: dict[int, list[dict[str, float]]] = {
            0: [{"Minimum": 0.0, "Maximum": 4.0}],
            1: [{"Minimum": 0.0, "Maximum": 4.0}],
            2: [],
        }
        self.axis_senses = [1.0, 1.0]
        """-1: a positive MoveAxis turns that axis the other way than most do."""
        self.alignment = 2
        self.moved = [0.0, 0.0]

    # places in the system that it speaks

    def _told(self) -> tuple[float, float]:
        place: Apparent | Icrs = self.mechanics.reported()
        if self.system == 2:
            assert isinstance(place, Apparent)
            place = apparent_to_icrs(place)
        return place.ra_deg / 15.0 % 24.0, place.dec_deg

    def _asked(self, form: dict[str, str]) -> Apparent:
        ra_h, dec_deg = self.need(form, "RightAscension", float), self.need(form, "Declination", float)
        if not (0.0 <= ra_h < 24.0 and abs(dec_deg) <= 90.0):
            raise AlpacaError(0x401, "Coordinates out of range")
        if self.system == 2:
            return icrs_to_apparent(Icrs(ra_h * 15.0, dec_deg), utc_now())
        return Apparent(ra_h * 15.0, dec_deg, utc_now())

    def _require_moving_allowed(self, *, tracking: bool = True) -> None:
        if self.mechanics.parked:
            raise AlpacaError(0x408, "Parked")
        if tracking and not self.mechanics.tracking:
            raise AlpacaError(0x40B, "Wrong tracking state")

    # readings

    def get_rightascension(self, _: dict[str, str]) -> float:
        return self._told()[0]

    def get_declination(self, _: dict[str, str]) -> float:
        return self._told()[1]

    def get_slewing(self, _: dict[str, str]) -> bool:
        if self._fails_at_s is not None and time.monotonic() >= self._fails_at_s:
            self._fails_at_s = None
            self.mechanics.stop()
            self.failure = AlpacaError(0x501, "Motor stalled on axis 1")
        if self.failure is not None:
            raise self.failure
        return self.mechanics.slewing()

    def get_tracking(self, _: dict[str, str]) -> bool:
        return self.mechanics.tracking

    def get_atpark(self, _: dict[str, str]) -> bool:
        return self.mechanics.parked

    def get_athome(self, _: dict[str, str]) -> bool:
        return self.mechanics.at_home

    def get_sideofpier(self, _: dict[str, str]) -> int:
        if self.version == 1:
            raise NOT_IMPLEMENTED
        return _SIDES[self.mechanics.pier_side()]

    def get_destinationsideofpier(self, form: dict[str, str]) -> int:
        lower = {name.lower(): value for name, value in form.items()}
        named = {
            "RightAscension": lower.get("rightascension", ""),
            "Declination": lower.get("declination", ""),
        }
        return _SIDES[self.mechanics.destination_side(self._asked(named))]

    def get_devicestate(self, _: dict[str, str]) -> list[dict[str, Any]]:
        if self.version < 4:
            raise NOT_IMPLEMENTED
        ra_h, dec_deg = self._told()
        state = {
            "RightAscension": ra_h,
            "Declination": dec_deg,
            "Tracking": self.mechanics.tracking,
            "AtPark": self.mechanics.parked,
            "AtHome": self.mechanics.at_home,
            "SideOfPier": _SIDES[self.mechanics.pier_side()],
            "IsPulseGuiding": self.mechanics.guiding(),
            "TimeStamp": utc_now().isoformat(),
        }
        if self.failure is None:
            state["Slewing"] = self.mechanics.slewing()
        return [
            {"Name": name, "Value": value}
            for name, value in state.items()
            if name.lower() not in self.missing
        ]

    def get_equatorialsystem(self, _: dict[str, str]) -> int:
        if self.version == 1:
            raise NOT_IMPLEMENTED
        return self.system

    def get_trackingrates(self, _: dict[str, str]) -> list[int]:
        return [0, 1, 2]

    def get_trackingrate(self, _: dict[str, str]) -> int:
        # offset rates are beside the sidereal one: that is what it says then
        return 0 if self.mechanics.rate is TrackingRate.CUSTOM else _RATES.index(self.mechanics.rate)

    def put_trackingrate(self, form: dict[str, str]) -> None:
        self.rates = [0.0, 0.0]
        self.mechanics.rate = _RATES[self.need(form, "TrackingRate", int)]

    # rates and axes

    def _require_sidereal(self) -> None:
        if self.mechanics.rate in _RATES[1:]:
            raise AlpacaError(0x40B, "Only when tracking at the sidereal rate")

    def _set_rates(self, which: int, rate: float) -> None:
        self._require_sidereal()
        self.rates[which] = rate
        ra_arcsec_s = self.rates[0] * self.ra_unit_arcsec_s
        self.mechanics.track_beside(ra_arcsec_s, self.rates[1])

    def get_rightascensionrate(self, _: dict[str, str]) -> float:
        return self.rates[0]

    def get_declinationrate(self, _: dict[str, str]) -> float:
        return self.rates[1]

    def put_rightascensionrate(self, form: dict[str, str]) -> None:
        rate = self.need(form, "RightAscensionRate", float)
        if not self.can.get("cansetrightascensionrate", True):
            raise NOT_IMPLEMENTED
        self._set_rates(0, rate)

    def put_declinationrate(self, form: dict[str, str]) -> None:
        rate = self.need(form, "DeclinationRate", float)
        if not self.can.get("cansetdeclinationrate", True):
            raise NOT_IMPLEMENTED
        self._set_rates(1, rate)

    def get_alignmentmode(self, _: dict[str, str]) -> int:
        return self.alignment

    def get_canmoveaxis(self, form: dict[str, str]) -> bool:
        return bool(self.axis_rates[self._axis(form)])

    def get_axisrates(self, form: dict[str, str]) -> list[dict[str, float]]:
        return self.axis_rates[self._axis(form)]

    def _axis(self, form: dict[str, str]) -> int:
        lower = {name.lower(): value for name, value in form.items()}
        axis: int = self.need(lower, "axis", int)
        if axis not in (0, 1, 2):
            raise AlpacaError(0x401, "No such axis")
        return axis

    def put_moveaxis(self, form: dict[str, str]) -> None:
        axis, rate = self.need(form, "Axis", int), self.need(form, "Rate", float)
        if axis not in (0, 1) or not self.axis_rates[axis]:
            raise AlpacaError(0x401, "No such axis")
        if self.mechanics.parked:
            raise AlpacaError(0x408, "Parked")
        if rate and not any(one["Minimum"] <= abs(rate) <= one["Maximum"] for one in self.axis_rates[axis]):
            raise AlpacaError(0x401, "Rate out of range")
        self.moved[axis] = rate
        if rate == 0.0:
            self.mechanics.stop_move("w" if axis == 0 else "n")
            return
        turned = rate * self.axis_senses[axis]
        if axis == 0:
            # the hour angle axis, with tracking suspended; the mechanics count from tracking
            west = turned - (SIDEREAL_DEG_S if self.mechanics.tracking else 0.0)
            self.mechanics.move("w" if west > 0.0 else "e", abs(west))
        else:
            north = -turned if self.mechanics.pier_side() is PierSide.WEST else turned
            self.mechanics.move("n" if north > 0.0 else "s", abs(north))

    def get_guideraterightascension(self, _: dict[str, str]) -> float:
        return _GUIDE_DEG_S

    get_guideratedeclination = get_guideraterightascension

    def get_utcdate(self, _: dict[str, str]) -> str:
        return (utc_now() + self.utc_off).strftime("%Y-%m-%dT%H:%M:%S.%f0Z")

    def put_utcdate(self, form: dict[str, str]) -> None:
        text = self.need(form, "UTCDate", str)
        if not text.endswith("Z"):
            raise Bad("UTCDate without Z")
        self.utc_off = datetime.fromisoformat(text) - utc_now()

    def get_sitelatitude(self, _: dict[str, str]) -> float:
        return self.site[0]

    def get_sitelongitude(self, _: dict[str, str]) -> float:
        return self.site[1]

    def get_siteelevation(self, _: dict[str, str]) -> float:
        return self.site[2]

    def put_sitelatitude(self, form: dict[str, str]) -> None:
        self.site[0] = self.need(form, "SiteLatitude", float)

    def put_sitelongitude(self, form: dict[str, str]) -> None:
        self.site[1] = self.need(form, "SiteLongitude", float)

    def put_siteelevation(self, form: dict[str, str]) -> None:
        self.site[2] = self.need(form, "SiteElevation", float)

    # orders

    def put_slewtocoordinatesasync(self, form: dict[str, str]) -> None:
        place = self._asked(form)
        self._require_moving_allowed()
        refusal = self.mechanics.refusal(place)
        if refusal is Refusal.BELOW_HORIZON:
            raise AlpacaError(0x40B, "Target is below the horizon")
        if refusal is not None:
            raise AlpacaError(0x401, "Target can't be reached")
        self.failure = None
        self._fails_at_s = None if self.fails_after_s is None else time.monotonic() + self.fails_after_s
        self.mechanics.slew(place)

    def put_slewtocoordinates(self, form: dict[str, str]) -> None:
        self.put_slewtocoordinatesasync(form)
        self._wait(lambda: not self.mechanics.slewing())
        if self.fails_after_s is not None:
            raise AlpacaError(0x501, "Motor stalled on axis 1")

    def _wait(self, over: Callable[[], bool]) -> None:
        until_s = time.monotonic() + 120.0
        while not over() and time.monotonic() < until_s:
            time.sleep(0.02)

    def put_synctocoordinates(self, form: dict[str, str]) -> None:
        place = self._asked(form)
        self._require_moving_allowed()
        if self.mechanics.sync(place) is not None:
            raise AlpacaError(0x500, "The controller refused the sync")

    def put_abortslew(self, _: dict[str, str]) -> None:
        self._require_moving_allowed(tracking=False)
        self._fails_at_s = None
        self.moved = [0.0, 0.0]
        self.mechanics.stop()
        if self.says_rates_after_abort:
            self.mechanics.track_beside(0.0, 0.0)

    def put_park(self, _: dict[str, str]) -> None:
        self.mechanics.park()
        if self.blocks:
            self._wait(lambda: not self.mechanics.slewing())

    def put_unpark(self, _: dict[str, str]) -> None:
        self.mechanics.unpark()

    def put_setpark(self, _: dict[str, str]) -> None:
        self.mechanics.set_park()

    def put_findhome(self, _: dict[str, str]) -> None:
        self._require_moving_allowed(tracking=False)
        self.mechanics.home()
        if self.blocks:
            self._wait(lambda: not self.mechanics.slewing())

    def put_tracking(self, form: dict[str, str]) -> None:
        on = self.need(form, "Tracking", self.boolean)
        if on and self.mechanics.parked:
            raise AlpacaError(0x408, "Parked")
        self.mechanics.tracking = on

    def put_pulseguide(self, form: dict[str, str]) -> None:
        direction, ms = self.need(form, "Direction", int), self.need(form, "Duration", int)
        self._require_moving_allowed()
        self.mechanics.pulse("nsew"[direction], _GUIDE_DEG_S, ms / 1000.0)  # type: ignore[arg-type]

    def answer(self, verb: str, member: str, form: dict[str, str]) -> Any:
        if verb == "get" and member.startswith("can") and member != "canmoveaxis":
            if not self.is_connected():
                raise AlpacaError(0x407, "Not connected")
            return self.can.get(member, True)
        return super().answer(verb, member, form)


class FakeCamera(FakeDevice):
    """An ICamera whose pixels tell their own place."""

    kind = "camera"

    def __init__(self, width_px: int = 64, height_px: int = 48, version: int = 4) -> None:
        super().__init__(version)
        self.width_px, self.height_px = width_px, height_px
        self.values: dict[str, Any] = {
            "binx": 1, "biny": 1, "startx": 3, "starty": 5, "numx": width_px, "numy": height_px, "gain": 10,
            "offset": 0, "cameraxsize": width_px, "cameraysize": height_px, "pixelsizex": 3.76,
            "pixelsizey": 3.76, "maxbinx": 4, "maxbiny": 4, "sensortype": 0, "maxadu": 65535,
            "exposuremin": 0.001, "exposuremax": 3600.0, "canabortexposure": True, "canstopexposure": True,
        }  # fmt: skip
        self.gains: list[str] | None = None
        self.dtype = "uint16"
        self.planes = 0
        self.binary = True
        self.data_start = 44
        self.failure: AlpacaError | None = None
        self.image_error: AlpacaError | None = None
        self.clock_off = timedelta(0)
        self.began: datetime | None = None
        self.duration_s = 0.0
        self.late_s = 0.05
        self.aborts = 0
        self._ready_at_s = math.inf

    def answer(self, verb: str, member: str, form: dict[str, str]) -> Any:
        if member in self.values and member not in self.missing:
            if not self.is_connected():
                raise AlpacaError(0x407, "Not connected")
            if verb == "get":
                return self.values[member]
            (name,) = (one for one in form if one.lower() == member)
            self.values[member] = int(form[name])
            return None
        return super().answer(verb, member, form)

    def get_gains(self, _: dict[str, str]) -> list[str]:
        if self.gains is None:
            raise NOT_IMPLEMENTED
        return self.gains

    def put_startexposure(self, form: dict[str, str]) -> None:
        self.duration_s = self.need(form, "Duration", float)
        self.need(form, "Light", self.boolean)
        if self.get_camerastate({}) != 0:
            raise AlpacaError(0x40B, "An exposure is running")
        self.began = utc_now() + self.clock_off
        self._ready_at_s = time.monotonic() + self.duration_s + self.late_s

    def put_abortexposure(self, _: dict[str, str]) -> None:
        self.aborts += 1
        self._ready_at_s = math.inf

    put_stopexposure = put_abortexposure

    def get_camerastate(self, _: dict[str, str]) -> int:
        return 2 if self._ready_at_s != math.inf and time.monotonic() < self._ready_at_s else 0

    def get_imageready(self, _: dict[str, str]) -> bool:
        if self.failure is not None:
            raise self.failure
        return time.monotonic() >= self._ready_at_s

    def get_lastexposurestarttime(self, _: dict[str, str]) -> str:
        if self.began is None:
            raise AlpacaError(0x40B, "No exposure yet")
        return self.began.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%f")

    def get_lastexposureduration(self, _: dict[str, str]) -> float:
        if self.began is None:
            raise AlpacaError(0x40B, "No exposure yet")
        return self.duration_s

    def pixels(self) -> np.ndarray[Any, Any]:
        """Shape (x, y) or (x, y, plane), as Alpaca has it."""
        width, height = self.values["numx"], self.values["numy"]
        x, y = np.meshgrid(np.arange(width), np.arange(height), indexing="ij")
        flat = (100 + x + 3 * y) % 251
        image = np.stack([flat + p for p in range(self.planes)], axis=-1) if self.planes else flat
        return image.astype(self.dtype)


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True
    request_queue_size = 64
    owner: AlpacaServer

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that went away is no news."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    wbufsize = -1
    _half = False
    disable_nagle_algorithm = True
    server: _Server

    def log_message(self, format: str, *args: Any) -> None:
        pass

    def setup(self) -> None:
        super().setup()
        self.server.owner.connections.append(self.connection)

    def do_GET(self) -> None:
        parts = urlsplit(self.path)
        pairs = dict(parse_qsl(parts.query, keep_blank_values=True))
        self._handle("get", parts.path, pairs)

    def do_PUT(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0))).decode()
        self._handle("put", urlsplit(self.path).path, dict(parse_qsl(body, keep_blank_values=True)))

    def _handle(self, verb: str, path: str, form: dict[str, str]) -> None:
        owner = self.server.owner
        member = path.rsplit("/", 1)[-1]
        if owner.basic is not None:
            wanted = "Basic " + base64.b64encode(":".join(owner.basic).encode()).decode()
            if self.headers.get("Authorization") != wanted:
                return self._reply(401, b"who are you?", "text/plain")
        way_s = owner.far()
        time.sleep(way_s / 2.0)
        owner.note(verb, member, form)
        fault = owner.fault_for(verb, member)
        what = fault.what if fault else ""
        self._half = what == "half"
        if what == "refuse-connection":
            self.close_connection = True
            return None
        if fault and what == "slow":
            time.sleep(fault.seconds)
            fault.over = True
        if fault and what == "html":
            return self._reply(200, b"<html><body>Welcome to the router</body></html>", "text/html")
        if fault and what == "status":
            return self._reply(fault.number, b"it has broken", "text/plain")
        if fault and what == "text":
            return self._reply(200, fault.body.encode(), "application/json")
        lower = {name.lower(): value for name, value in form.items()}
        envelope: dict[str, Any] = {
            "ClientTransactionID": int(lower.get("clienttransactionid", "0")) + (what == "wrong-id"),
            "ServerTransactionID": owner.count(),
            "ErrorNumber": 0,
            "ErrorMessage": "",
        }
        try:
            value: Any = None
            if fault and what == "error":
                raise AlpacaError(fault.number, fault.body)
            if path == "/management/v1/configureddevices":
                value = owner.described()
            elif what != "ignored":
                value = self._device(path).answer(verb, member, form)
            if fault and what == "denied":
                raise AlpacaError(fault.number, fault.body)
        except Bad as bad:
            return self._reply(400, str(bad).encode(), "text/plain")
        except AlpacaError as error:
            envelope |= {"ErrorNumber": error.number, "ErrorMessage": error.message}
            value = None
        time.sleep(way_s / 2.0)
        if fault and what == "deaf":
            time.sleep(fault.seconds)
        if what in ("drop", "deaf"):
            self.close_connection = True
            return None
        if verb == "get":
            envelope["Value"] = value
        return self._reply(200, json.dumps(envelope).encode(), "application/json")

    def _device(self, path: str) -> FakeDevice:
        found = self.server.owner.devices.get(path.removeprefix("/api/v1/").rpartition("/")[0])
        if found is None:
            raise Bad("no such device")
        if path.endswith("/imagearray"):
            self._image(found)
        return found

    def _image(self, camera: FakeDevice) -> None:
        """Answer with an image; never comes back."""
        assert isinstance(camera, FakeCamera)
        form = {name.lower(): value for name, value in parse_qsl(urlsplit(self.path).query)}
        transaction = int(form.get("clienttransactionid", "0"))
        if not (camera.binary and "application/imagebytes" in self.headers.get("Accept", "")):
            image = camera.pixels()
            envelope = {
                "Type": 2, "Rank": image.ndim, "Value": image.tolist(), "ClientTransactionID": transaction,
                "ServerTransactionID": 1, "ErrorNumber": 0, "ErrorMessage": "",
            }  # fmt: skip
            if camera.image_error:
                envelope |= {
                    "ErrorNumber": camera.image_error.number,
                    "ErrorMessage": camera.image_error.message,
                }
                del envelope["Value"]
            self._reply(200, json.dumps(envelope).encode(), "application/json; charset=utf-8")
        else:
            self._reply(200, image_bytes(camera, transaction), "application/imagebytes")
        raise _Answered

    def _reply(self, status: int, body: bytes, kind: str) -> None:
        owner = self.server.owner
        headers = {"Content-Type": kind}
        if owner.gzip and "gzip" in self.headers.get("Accept-Encoding", ""):
            body, headers["Content-Encoding"] = gzip.compress(body), "gzip"
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[: len(body) // 2] if self._half else body)
        self.close_connection = self.close_connection or self._half
        self.wfile.flush()

    def handle_one_request(self) -> None:
        try:
            super().handle_one_request()
        except _Answered:
            pass
        except OSError:
            self.close_connection = True


class _Answered(Exception):
    pass


def image_bytes(camera: FakeCamera, transaction: int) -> bytes:
    """The binary form, as its header's description has it."""
    error = camera.image_error
    if error:
        return (
            struct.pack("<11i", 1, error.number, transaction, 1, 44, 0, 0, 0, 0, 0, 0)
            + error.message.encode()
        )
    image = camera.pixels()
    sides = (*image.shape, 0)[:3]
    code = _CODES[camera.dtype]
    head = struct.pack("<11i", 1, 0, transaction, 1, camera.data_start, 2, code, image.ndim, *sides)
    little = image.astype(image.dtype.newbyteorder("<"))
    return head + b"\xa5" * (camera.data_start - 44) + little.tobytes(order="C")


@dataclass
class AlpacaServer:
    """The server, with what it was asked.

    Attributes
    ----------
    devices : dict
        By "telescope/0".
    asked : list of (verb, member, parameters)
    far : callable
        Seconds that a question and its answer take on their way, half of them each.
    """

    devices: dict[str, FakeDevice]
    basic: tuple[str, str] | None = None
    far: Callable[[], float] = lambda: 0.0
    gzip: bool = False
    faults: list[Fault] = field(default_factory=list)
    asked: list[tuple[str, str, dict[str, str]]] = field(default_factory=list)
    connections: list[Any] = field(default_factory=list)
    port: int = 0
    _count: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _server: _Server | None = None

    def start(self) -> AlpacaServer:
        server = self._server = _Server(("127.0.0.1", self.port), _Handler)
        server.owner = self
        self.port = server.server_address[1]
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        return self

    def stop(self) -> None:
        """Be gone at once, connections and all."""
        server, self._server = self._server, None
        if server is None:
            return
        server.shutdown()
        server.server_close()
        for one in self.connections:
            with contextlib.suppress(OSError):
                one.shutdown(2)
        self.connections.clear()

    def __enter__(self) -> AlpacaServer:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    def url(self, device: str, options: str = "") -> str:
        return f"alpaca+http://127.0.0.1:{self.port}/{device}?{options}".rstrip("?")

    def note(self, verb: str, member: str, form: dict[str, str]) -> None:
        with self._lock:
            self.asked.append((verb, member, form))

    def orders(self) -> list[str]:
        """Members that were ordered, in their order."""
        with self._lock:
            return [member for verb, member, _ in self.asked if verb == "put"]

    def fault_for(self, verb: str, member: str) -> Fault | None:
        with self._lock:
            for fault in self.faults:
                if fault.member == member and fault.verb in ("", verb) and fault.times > 0:
                    fault.times -= 1
                    return fault
        return None

    def count(self) -> int:
        with self._lock:
            self._count += 1
            return self._count

    def described(self) -> list[dict[str, Any]]:
        return [
            {
                "DeviceName": f"Small {one.kind}",
                "DeviceType": one.kind.capitalize(),
                "DeviceNumber": int(key.rpartition("/")[2]),
                "UniqueID": f"id-of-{key}",
            }
            for key, one in self.devices.items()
        ]


def quick_mechanics(machine: Machine | None = None, **changes: Any) -> Mechanics:
    """One that slews fast (both axes together below what is believed of motors), two hours past noon."""
    machine = machine or Machine(mounting="german", lowest_altitude_deg=0.0)
    options = {"slew_rate_deg_s": 25.0, "acceleration_deg_s2": 150.0} | changes
    zenith = Mechanics(HERE, Air(), PointingErrors(), machine=machine).reported()
    start = Apparent((zenith.ra_deg - 30.0) % 360.0, 45.0, utc_now())
    return Mechanics(HERE, Air(), PointingErrors(), machine=machine, start=start, **options)
