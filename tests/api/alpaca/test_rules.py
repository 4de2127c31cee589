"""Every member held against the protocol's rules: names, cases, ids, numbers, envelopes, order of checks.

Each check is a row; all rows of a table are asked of one observatory, and all that fail are told at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from api.alpaca.telescope import AlpacaTelescope
from tests.api.alpaca.alpaca_observatory import AlpacaProbe, Running

pytestmark = pytest.mark.asyncio(loop_scope="module")
TEXT, NUMBER, WHOLE, TRUTH, LIST = str, float, int, bool, list

READ: dict[str, tuple[type, int]] = {
    # member: type of its value, error number on the German mount that can everything
    "alignmentmode": (WHOLE, 0),
    "altitude": (NUMBER, 0),
    "aperturearea": (NUMBER, 0x400),
    "aperturediameter": (NUMBER, 0),
    "athome": (TRUTH, 0),
    "atpark": (TRUTH, 0),
    "azimuth": (NUMBER, 0),
    "canfindhome": (TRUTH, 0),
    "canpark": (TRUTH, 0),
    "canpulseguide": (TRUTH, 0),
    "cansetdeclinationrate": (TRUTH, 0),
    "cansetguiderates": (TRUTH, 0),
    "cansetpark": (TRUTH, 0),
    "cansetpierside": (TRUTH, 0),
    "cansetrightascensionrate": (TRUTH, 0),
    "cansettracking": (TRUTH, 0),
    "canslew": (TRUTH, 0),
    "canslewaltaz": (TRUTH, 0),
    "canslewaltazasync": (TRUTH, 0),
    "canslewasync": (TRUTH, 0),
    "cansync": (TRUTH, 0),
    "cansyncaltaz": (TRUTH, 0),
    "canunpark": (TRUTH, 0),
    "connected": (TRUTH, 0),
    "connecting": (TRUTH, 0),
    "declination": (NUMBER, 0),
    "declinationrate": (NUMBER, 0),
    "description": (TEXT, 0),
    "devicestate": (LIST, 0),
    "doesrefraction": (TRUTH, 0),
    "driverinfo": (TEXT, 0),
    "driverversion": (TEXT, 0),
    "equatorialsystem": (WHOLE, 0),
    "focallength": (NUMBER, 0),
    "guideratedeclination": (NUMBER, 0),
    "guideraterightascension": (NUMBER, 0),
    "interfaceversion": (WHOLE, 0),
    "ispulseguiding": (TRUTH, 0),
    "name": (TEXT, 0),
    "rightascension": (NUMBER, 0),
    "rightascensionrate": (NUMBER, 0),
    "sideofpier": (WHOLE, 0),
    "siderealtime": (NUMBER, 0),
    "siteelevation": (NUMBER, 0),
    "sitelatitude": (NUMBER, 0),
    "sitelongitude": (NUMBER, 0),
    "slewing": (TRUTH, 0),
    "slewsettletime": (WHOLE, 0),
    "supportedactions": (LIST, 0),
    "targetdeclination": (NUMBER, 0x402),
    "targetrightascension": (NUMBER, 0x402),
    "tracking": (TRUTH, 0),
    "trackingrate": (WHOLE, 0),
    "trackingrates": (LIST, 0),
    "utcdate": (TEXT, 0),
}
OFFLINE = {"connected", "connecting", "driverinfo", "driverversion", "interfaceversion", "name"}

PLACE = {"RightAscension": "nan-is-set-below", "Declination": "20"}
BODIES: dict[str, dict[str, str]] = {
    # what a PUT takes; the values are good ones
    "action": {"Action": "Anything", "Parameters": ""},
    "commandblind": {"Command": "x", "Raw": "true"},
    "commandbool": {"Command": "x", "Raw": "true"},
    "commandstring": {"Command": "x", "Raw": "true"},
    "connected": {"Connected": "True"},
    "connect": {},
    "declinationrate": {"DeclinationRate": "0.0"},
    "doesrefraction": {"DoesRefraction": "false"},
    "guideratedeclination": {"GuideRateDeclination": "0.002"},
    "guideraterightascension": {"GuideRateRightAscension": "0.002"},
    "rightascensionrate": {"RightAscensionRate": "0.0"},
    "sideofpier": {"SideOfPier": "0"},
    "siteelevation": {"SiteElevation": "100"},
    "sitelatitude": {"SiteLatitude": "47"},
    "sitelongitude": {"SiteLongitude": "11"},
    "slewsettletime": {"SlewSettleTime": "0"},
    "targetdeclination": {"TargetDeclination": "10"},
    "targetrightascension": {"TargetRightAscension": "10"},
    "tracking": {"Tracking": "True"},
    "trackingrate": {"TrackingRate": "0"},
    "utcdate": {"UTCDate": "2026-11-22T09:00:00.0000000Z"},
    "abortslew": {},
    "moveaxis": {"Axis": "0", "Rate": "0.0"},
    "pulseguide": {"Direction": "0", "Duration": "0"},
    "setpark": {},
    "slewtoaltaz": {"Azimuth": "150", "Altitude": "50"},
    "slewtoaltazasync": {"Azimuth": "150", "Altitude": "50"},
    "synctoaltaz": {"Azimuth": "150", "Altitude": "50"},
    "slewtocoordinates": {"RightAscension": "1", "Declination": "20"},
    "slewtocoordinatesasync": {"RightAscension": "1", "Declination": "20"},
    "synctocoordinates": {"RightAscension": "1", "Declination": "20"},
    "slewtotarget": {},
    "slewtotargetasync": {},
    "synctotarget": {},
    "findhome": {},
    "park": {},
    "unpark": {},
    "disconnect": {},
}
OPTIONAL = {"Parameters"}
NOT_IMPLEMENTED = {
    "commandblind",
    "commandbool",
    "commandstring",
    "doesrefraction",
    "guideratedeclination",
    "guideraterightascension",
    "sideofpier",
    "siteelevation",
    "sitelatitude",
    "sitelongitude",
    "synctoaltaz",
    "utcdate",
}
TEXTS = {"Action", "Parameters", "Command"}
"""Parameters that may be anything."""

ASKED: dict[str, dict[str, str]] = {
    # GETs with parameters
    "axisrates": {"Axis": "1"},
    "canmoveaxis": {"Axis": "1"},
    "destinationsideofpier": {"RightAscension": "3.5", "Declination": "30"},
}


class Checks:
    """Counts checks, and keeps those that fail."""

    def __init__(self) -> None:
        self.made = 0
        self.failed: list[str] = []

    def hold(self, what: str, found: object, wanted: object) -> None:
        """One check."""
        self.made += 1
        if found != wanted:
            self.failed.append(f"{what}: {found!r} instead of {wanted!r}")

    def true(self, what: str, held: bool) -> None:
        """One check of something that must hold."""
        self.hold(what, held, True)

    def done(self, at_least: int) -> None:
        """The verdict; so many checks must have been made."""
        assert not self.failed, "\n".join(self.failed)
        assert self.made >= at_least


BAD_IDS = ("", "     ", "-12345", "NASDAQ", "4294967296", "1.5")


async def _ids(checks: Checks, probe: AlpacaProbe, verb: str, member: str, given: dict[str, str]) -> None:
    """The checks of ids and of additional parameters that hold for every member."""
    for name, wanted in (
        ("ClientTransactionID", 77),
        ("clienttransactionid", 77 if verb == "GET" else 0),
        ("CLIENTTRANSACTIONID", 77 if verb == "GET" else 0),
    ):
        found = await probe.raw(verb, member, {**given, "ClientID": "1", name: "77"})
        checks.hold(f"{verb} {member} with {name}: status", found.status_code, 200)
        checks.hold(f"{verb} {member} with {name}: echo", found.json()["ClientTransactionID"], wanted)
    found = await probe.raw(
        verb, member, {**given, "clientid": "1", "Unknown": "?", "ClientTransactionID": "5"}
    )
    checks.hold(f"{verb} {member} with a parameter more: status", found.status_code, 200)
    found = await probe.raw(verb, member, dict(given))
    checks.hold(f"{verb} {member} without ids: status", found.status_code, 200)
    checks.hold(f"{verb} {member} without ids: echo", found.json()["ClientTransactionID"], 0)
    for bad in BAD_IDS:
        found = await probe.raw(verb, member, {**given, "ClientID": "1", "ClientTransactionID": bad})
        checks.hold(
            f"{verb} {member} with ClientTransactionID {bad!r}", found.json()["ClientTransactionID"], 0
        )
        found = await probe.raw(verb, member, {**given, "ClientID": bad, "ClientTransactionID": "6"})
        checks.hold(f"{verb} {member} with ClientID {bad!r}", found.json()["ClientTransactionID"], 6)


@pytest.mark.long
async def test_every_member_that_is_read(shared_observatory: Running) -> None:
    german = shared_observatory.probe
    checks = Checks()
    for member, (kind, number) in READ.items():
        found = await german.ask("GET", member)
        checks.hold(f"{member}: error", hex(found.number), hex(number))
        value = found.value
        is_kind = isinstance(value, int | float) if kind is NUMBER else type(value) is kind
        checks.true(f"{member} = {value!r} is {kind.__name__}", is_kind)
        await _ids(checks, german, "GET", member, {})
    for member, given in ASKED.items():
        await german.get(member, **given)
        await _ids(checks, german, "GET", member, given)
        for name in given:
            swapped = {one.swapcase() if one == name else one: value for one, value in given.items()}
            answered = await german.raw("GET", member, dict(swapped))
            checks.hold(f"GET {member} with {name.swapcase()}", answered.status_code, 200)
    checks.done(1000)


@pytest.mark.long
async def test_every_parameter_that_is_missing_or_makes_no_sense(shared_observatory: Running) -> None:
    german = shared_observatory.probe
    checks = Checks()
    rows = [*(("PUT", *row) for row in BODIES.items()), *(("GET", *row) for row in ASKED.items())]
    for verb, member, given in rows:
        for name in given:
            without = {one: value for one, value in given.items() if one != name}
            for what, fields in _bad(verb, name, without):
                found = await german.raw(
                    verb, member, {**fields, "ClientID": "42", "ClientTransactionID": "1"}
                )
                if name in OPTIONAL and what != "no sense":
                    checks.hold(f"{verb} {member} {name} {what}", found.status_code, 200)
                    continue
                checks.hold(f"{verb} {member} {name} {what}: status", found.status_code, 400)
                kind = found.headers["content-type"].partition(";")[0]
                checks.hold(f"{verb} {member} {name} {what}: kind", kind, "text/plain")
                checks.true(f"{verb} {member} {name} {what}: words", name in found.text)
    checks.done(250)


def _bad(verb: str, name: str, without: dict[str, str]) -> Iterator[tuple[str, dict[str, object]]]:
    yield "missing", dict(without)
    if verb == "PUT":
        for other in (name.lower(), name.upper(), name.swapcase()):
            yield f"as {other}", {**without, other: "1"}
    if name not in TEXTS:
        for bad in ("", "asdqwe", "NaN", "Infinity", "-inf", "1,5", "1e999"):
            yield "no sense", {**without, name: bad}


@pytest.mark.long
async def test_every_member_that_is_written_while_it_stands_still(shared_observatory: Running) -> None:
    """What moves nothing; what does has tests of its own."""
    german = shared_observatory.probe
    checks = Checks()
    # a stop takes its time until the mount is seen to rest
    harmless = set(BODIES) - {"park", "findhome", "setpark", "disconnect", "abortslew"}
    harmless -= {member for member in BODIES if member.startswith(("slewto", "syncto"))} - {"synctoaltaz"}
    for member in sorted(harmless):
        found = await german.ask("PUT", member, **BODIES[member])
        wanted = 0x400 if member in NOT_IMPLEMENTED else 0x40C if member == "action" else 0
        checks.hold(f"PUT {member}", hex(found.number), hex(wanted))
        if member != "tracking":
            await _ids(checks, german, "PUT", member, BODIES[member])
    checks.done(450)


RANGES: list[tuple[str, Any, Any]] = (
    [
        (
            member,
            {"RightAscension": 1.0, "Declination": 20.0},
            [
                ("RightAscension", [-1.0, -1e-9, 24.0, 25.0]),
                ("Declination", [-91.0, -90.0001, 90.0001, 100.0]),
            ],
        )
        for member in ("slewtocoordinates", "slewtocoordinatesasync", "synctocoordinates")
    ]
    + [
        (
            member,
            {"Azimuth": 150.0, "Altitude": 50.0},
            [("Azimuth", [-10.0, 370.0, 360.0]), ("Altitude", [-100.0, 100.0])],
        )
        for member in ("slewtoaltaz", "slewtoaltazasync")
    ]
    + [
        ("targetrightascension", {}, [("TargetRightAscension", [-1.0, 24.0, 25.0])]),
        ("targetdeclination", {}, [("TargetDeclination", [-91.0, 91.0])]),
        ("slewsettletime", {}, [("SlewSettleTime", [-1, 301])]),
        ("trackingrate", {}, [("TrackingRate", [-1, 4, 5])]),
        ("pulseguide", {"Direction": 0, "Duration": 0}, [("Direction", [-1, 4]), ("Duration", [-1, 60_001])]),
    ]
)


@pytest.mark.long
async def test_values_out_of_range_are_invalid(shared_observatory: Running) -> None:
    german = shared_observatory.probe
    checks = Checks()

    async def all_of_them(when: str) -> None:
        for member, good, parameters in RANGES:
            for name, values in parameters:
                for value in values:
                    found = await german.ask("PUT", member, **{**good, name: value})
                    checks.hold(f"{when}: {member} {name}={value}", hex(found.number), "0x401")
        for member in ("axisrates", "canmoveaxis"):
            for axis in (-1, 3):
                found = await german.ask("GET", member, Axis=axis)
                checks.hold(f"{when}: {member} {axis}", hex(found.number), "0x401")
        for ra, dec in ((-0.1, 0), (24, 0), (0, -91), (0, 91)):
            found = await german.ask("GET", "destinationsideofpier", RightAscension=ra, Declination=dec)
            checks.hold(f"{when}: destinationsideofpier {ra} {dec}", hex(found.number), "0x401")

    await all_of_them("at rest")
    # ranges come before parked
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(AlpacaTelescope, "is_parked", True)
        await all_of_them("parked")
    checks.done(80)


@pytest.mark.long
async def test_while_not_connected_only_a_few_members_answer(shared_observatory: Running) -> None:
    german = shared_observatory.probe
    checks = Checks()
    await german.put("connected", Connected=False)
    for member in READ:
        found = await german.ask("GET", member)
        checks.hold(f"GET {member}", hex(found.number), "0x0" if member in OFFLINE else "0x407")
    for member, given in ASKED.items():
        checks.hold(f"GET {member}", hex((await german.ask("GET", member, **given)).number), "0x407")
    for member, given in BODIES.items():
        if member in ("connected", "connect", "disconnect"):
            continue
        found = await german.ask("PUT", member, **given)
        checks.hold(f"PUT {member}", hex(found.number), "0x407")
        # connection comes before implementation and before ranges, and after syntax
        for name in given:
            if name in TEXTS:
                continue
            wrong = await german.raw("PUT", member, {**given, name: "asd", "ClientID": "42"})
            checks.hold(f"PUT {member} with {name} of no sense", wrong.status_code, 400)
    checks.hold("connected", await german.get("connected"), False)
    await german.put("connected", Connected=True)
    checks.hold("connected", await german.get("connected"), True)
    await german.get("rightascension")
    checks.done(100)


PATHS: list[tuple[str, str, int]] = [
    ("GET", "/api/v1/telescope/0/Tracking", 400),
    ("GET", "/api/v1/Telescope/0/tracking", 400),
    ("GET", "/API/v1/telescope/0/tracking", 404),
    ("GET", "/api/V1/telescope/0/tracking", 400),
    ("GET", "/api/v2/telescope/0/tracking", 400),
    ("GET", "/api/v1/telescope/0/nonsense", 400),
    ("GET", "/api/v1/telescope/0/tracking/", 400),
    ("GET", "/api/v1/telescope/99/tracking", 400),
    ("GET", "/api/v1/telescope/-1/tracking", 400),
    ("GET", "/api/v1/telescope/A/tracking", 400),
    ("GET", "/api/v1/telescope/0", 400),
    ("GET", "/api/v1/telescope/0/", 400),
    ("GET", "/api/v1/camera/0/connected", 400),
    ("GET", "/api/v1/", 400),
    ("GET", "/api/", 400),
    ("GET", "/api", 400),
    ("PUT", "/api", 400),
    ("GET", "/management", 404),
    ("GET", "/management/", 404),
    ("GET", "/api/v1/telescope/0/abortslew", 400),
    ("PUT", "/api/v1/telescope/0/rightascension", 400),
    ("PUT", "/api/v1/telescope/0/canslew", 400),
    ("POST", "/api/v1/telescope/0/tracking", 405),
    ("DELETE", "/api/v1/telescope/0/connected", 405),
    ("PATCH", "/api/v1/telescope/0/connected", 405),
    ("GET", "/management/v1/nonsense", 404),
    ("GET", "/management/v1/Description", 404),
    ("GET", "/management/apiversions/", 404),
    ("PUT", "/management/apiversions", 405),
    ("GET", "/setup/v1/telescope/9/setup", 400),
    ("GET", "/setup/v1/telescope/0", 404),
]


async def test_paths_that_lead_nowhere_are_refused_in_plain_text(shared_observatory: Running) -> None:
    checks = Checks()
    for verb, path, status in PATHS:
        found = await shared_observatory.http.request(verb, path)
        checks.hold(f"{verb} {path}: status", found.status_code, status)
        if status != 404 or path.startswith("/management"):
            kind = found.headers["content-type"].partition(";")[0]
            checks.hold(f"{verb} {path}: kind", kind, "text/plain")
        checks.true(f"{verb} {path}: words", bool(found.text))
    checks.done(60)


async def test_parameters_count_only_where_the_standard_puts_them(shared_observatory: Running) -> None:
    german = shared_observatory.probe
    path = "/api/v1/telescope/0/tracking"
    in_query = await german.http.put(path, params={"Tracking": "True"})
    assert in_query.status_code == 400
    as_json = await german.http.put(path, json={"Tracking": True})
    assert as_json.status_code == 400
    with_charset = await german.http.put(
        path,
        content=b"Tracking=True&ClientTransactionID=3",
        headers={"Content-Type": "application/x-www-form-urlencoded; charset=utf-8"},
    )
    assert with_charset.json()["ClientTransactionID"] == 3
    too_long = await german.http.put(path, data={"Tracking": "True", "more": "x" * 70_000})
    assert too_long.status_code == 400
    no_parameters = await german.http.put("/api/v1/telescope/0/action", data={"Action": "A"})
    assert no_parameters.json()["ErrorNumber"] == 0x40C


async def test_the_management_answers_without_error_keys(shared_observatory: Running) -> None:
    values: dict[str, Any] = {}
    for page in ("apiversions", "v1/description", "v1/configureddevices"):
        for name in ("ClientTransactionID", "clienttransactionid"):
            found = await shared_observatory.http.get(
                f"/management/{page}", params={name: "9", "ClientID": "1"}
            )
            assert found.status_code == 200
            answer = found.json()
            assert set(answer) == {"Value", "ClientTransactionID", "ServerTransactionID"}
            assert answer["ClientTransactionID"] == 9
            values[page] = answer["Value"]
        assert (await shared_observatory.http.get(f"/management/{page}")).json()["ClientTransactionID"] == 0
    assert values["apiversions"] == [1]
    described = values["v1/description"]
    assert set(described) == {"ServerName", "Manufacturer", "ManufacturerVersion", "Location"}
    assert described["Location"] == "a test"
    devices = values["v1/configureddevices"]
    assert [(one["DeviceType"], one["DeviceNumber"]) for one in devices] == [
        ("Telescope", 0),
        ("Telescope", 1),
        ("Telescope", 2),
    ]
    assert all(set(one) == {"DeviceName", "DeviceType", "DeviceNumber", "UniqueID"} for one in devices)
    assert len({one["UniqueID"] for one in devices}) == 3


async def test_device_state_says_what_the_members_say(shared_observatory: Running) -> None:
    german = shared_observatory.probe
    state = {one["Name"]: one["Value"] for one in await german.get("devicestate")}
    assert list(state) == [
        *("Altitude", "AtHome", "AtPark", "Azimuth", "Declination", "IsPulseGuiding", "RightAscension"),
        *("SideOfPier", "SiderealTime", "Slewing", "Tracking", "UTCDate", "TimeStamp"),
    ]
    for name in set(state) - {"TimeStamp"}:
        value = await german.get(name.lower())
        assert type(value) is type(state[name]), name
        if isinstance(value, float):
            assert abs(value - state[name]) < 0.05, name
    # what a mount can't is left out
    names = {one["Name"] for one in await german.at(1).get("devicestate")}
    assert "SideOfPier" not in names
    assert {"RightAscension", "Slewing", "TimeStamp"} <= names


async def test_the_setup_pages(shared_observatory: Running) -> None:
    server = await shared_observatory.http.get("/setup")
    assert server.status_code == 200
    assert server.headers["content-type"].startswith("text/html")
    assert server.text.startswith("<!DOCTYPE")
    for number, name in enumerate(("german", "fork", "gone")):
        path = f"/setup/v1/telescope/{number}/setup"
        assert path in server.text
        page = await shared_observatory.http.get(path)
        assert page.status_code == 200
        assert name in page.text
        assert 'href="/"' in page.text


@pytest.mark.long
async def test_none_of_it_stands_in_the_public_description(shared_observatory: Running) -> None:
    paths = shared_observatory.app.openapi()["paths"]
    assert paths
    assert not [path for path in paths if path.startswith(("/api/", "/management", "/setup"))]
