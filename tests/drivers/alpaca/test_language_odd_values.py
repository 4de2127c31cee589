"""A telescope whose server says what makes no sense: used as far as it can be, or refused with words."""

from __future__ import annotations

import json
from typing import Any

import pytest

from drivers.registry import open_mount
from mountnav.errors import MountnavError
from tests.drivers.alpaca.alpaca_server import HERE, AlpacaServer, FakeTelescope, Fault, quick_mechanics

MEMBERS = (
    *(
        "utcdate",
        "sitelatitude",
        "sitelongitude",
        "siteelevation",
        "guideraterightascension",
        "trackingrates",
    ),
    *(
        "equatorialsystem",
        "interfaceversion",
        "name",
        "driverinfo",
        "rightascension",
        "sideofpier",
        "slewing",
    ),
    *("tracking", "atpark", "canslewasync", "devicestate"),
)
REFINEMENTS = ("utcdate", "siteelevation", "sitelatitude", "sitelongitude")
VALUES: tuple[Any, ...] = (
    *(
        "0001-01-01T00:00:00+23:59",
        "9999-12-31T23:59:59-23:59",
        10**300,
        1e308,
        -1e308,
        [],
        {},
        None,
        "x" * 9000,
    ),
)


@pytest.mark.long
@pytest.mark.parametrize("member", MEMBERS)
async def test_an_odd_value_is_never_a_traceback(member: str) -> None:
    """Each member, with each odd value, of both versions in turns, through connecting and a reading."""
    for number, value in enumerate(VALUES):
        telescope = FakeTelescope(quick_mechanics(), 3 + number % 2)
        telescope.connected = True
        with AlpacaServer({"telescope/0": telescope}) as server:
            body = json.dumps({"Value": value, "ErrorNumber": 0, "ErrorMessage": ""})
            server.faults.append(Fault(member, "text", times=10**6, body=body))
            mount = open_mount(server.url("telescope/0", "heartbeat_s=0"), site=HERE)
            refused: MountnavError | None = None
            try:
                await mount.open()
                await mount.reading()
            except MountnavError as error:
                refused = error
            finally:
                await mount.close()
            assert len(str(refused)) < 1000
            # clock and site are refinements: without them it is used all the same
            assert refused is None or member not in REFINEMENTS
