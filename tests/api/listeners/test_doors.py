"""Doors without keys: who may come in by his address, on every one of them, and what strangers are told."""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path

import pytest

from api.access.audit import Audit
from api.access.keys import KeyStore
from api.alpaca.server import alpaca_caller
from api.listeners.doors import Door
from api.listeners.tcp import TcpPort
from api.problems import Refused
from mountnav.errors import BadSettings
from mountnav.journal.audit_and_leases import AuditRow
from mountnav.settings.faces import AlpacaSettings, IndiServerSettings, StellariumSettings
from mountnav.settings.networks import in_networks
from mountnav.settings.observatory import Settings
from tests.api.conftest import OBSERVATORY


@pytest.mark.parametrize(
    ("address", "inside"),
    [
        ("192.168.1.17", True),
        ("::ffff:192.168.1.17", True),
        ("192.168.2.17", False),
        ("127.0.0.1", True),
        ("127.9.9.9", True),
        ("::1", True),
        ("::ffff:127.0.0.1", True),
        ("fd00::17", True),
        ("fe80::1%eth0", False),
        ("10.0.0.5", True),
        ("10.0.0.6", False),
        ("0.0.0.0", False),
        ("", False),
        ("localhost", False),
        ("192.168.1.17 ", False),
        ("３.３.３.３", False),
        ("1" * 100_000, False),
    ],
)
def test_an_address_is_in_or_out(address: str, inside: bool) -> None:
    assert in_networks(address, ("192.168.1.0/24", "fd00::/8", "10.0.0.5/32")) is inside


@pytest.mark.parametrize(
    ("door", "words"),
    [
        ('host = "0.0.0.0"', "open = true"),
        ('host = "0.0.0.0"\nallow = ["192.168.1.5/24"]', 'the network is "192.168.1.0/24"'),
        ('host = "0.0.0.0"\nallow = ["observatory.example"]', "names are not looked up"),
        ('host = "0.0.0.0"\nallow = ["0.0.0.0/0"]', "whole world"),
        ('host = "0.0.0.0"\nallow = ["::/1"]', "whole world"),
        ("allow = [1]", "allow"),
    ],
)
@pytest.mark.parametrize("section", ["indi_server", "lx200_server", "stellarium"])
def test_settings_that_let_too_many_in_are_refused(section: str, door: str, words: str) -> None:
    with pytest.raises(BadSettings) as refused:
        Settings.parse(f"{OBSERVATORY}\n[{section}]\nenabled = true\n{door}")
    assert words in str(refused.value)


def test_this_machine_alone_unless_told() -> None:
    for settings in (IndiServerSettings(), StellariumSettings(host="0.0.0.0", allow=("10.0.0.0/8",))):
        assert settings.admits("127.0.0.1")
        assert not settings.admits("192.168.1.1")
    assert StellariumSettings(open=True).admits("203.0.113.9")
    narrow = StellariumSettings(open=True, allow=("10.0.0.0/8",))
    assert (narrow.admits("10.1.2.3"), narrow.admits("203.0.113.9")) == (True, False)


def test_alpaca_without_keys_is_for_the_addresses_that_are_named(tmp_path: Path) -> None:
    keys = KeyStore(tmp_path / "keys.json", always=True)
    settings = AlpacaSettings(open=True, allow=("192.168.1.0/24",))

    def ask(address: str) -> str:
        scope = {"type": "http", "headers": [], "client": (address, 1)}
        return alpaca_caller(scope, keys, admits=settings.admits).name

    assert ask("192.168.1.17") == "alpaca 192.168.1.17"
    with pytest.raises(Refused):
        ask("203.0.113.9")


class Kept:
    def __init__(self) -> None:
        self.rows: list[AuditRow] = []

    def audit_now(self, row: AuditRow) -> None:
        self.rows.append(row)


async def test_a_stranger_is_told_logged_audited_and_takes_no_place(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """On a real socket: 127.0.0.1 plays both, as the settings' network changes."""
    kept, allowed, served = Kept(), [False], []
    door = Door(lambda _: allowed[0], Audit(kept), "indi_server")

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        served.append(await reader.read(1))
        writer.close()

    port = TcpPort("127.0.0.1", 0, serve, name="INDI", lets_in=door.lets_in, refused=b"not you", most=1)
    await port.start()
    try:
        with caplog.at_level(logging.WARNING):
            for _ in range(30):
                reader, writer = await asyncio.open_connection(*port.address)
                async with asyncio.timeout(30):
                    assert await reader.read() == b"not you"
                writer.close()
        assert [row.what for row in kept.rows] == ["connect to indi_server"]
        assert (kept.rows[0].caller, kept.rows[0].outcome) == ("(unknown)", "forbidden")
        assert len([one for one in caplog.records if "lets nobody in from 127.0.0.1" in one.message]) == 1
        allowed[0] = True
        reader, writer = await asyncio.open_connection(*port.address)
        writer.write(b"x")
        async with asyncio.timeout(30):
            assert await reader.read() == b""
        writer.close()
        assert served == [b"x"]
    finally:
        await port.stop()
