"""Serial ports: who holds them, and what answers there, on pseudo-terminals and TCP."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from api.cli.ports import ports
from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.ports import holders, probe, probes, serial_ports
from drivers.registry import family, make_fake
from mountnav.clock import utc_now
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Site
from tests.api.command_here import exit_code
from tests.drivers.ioptron.german_fakes import fake_of

IOPTRON = (family("ioptron"),)


@pytest.mark.parametrize(
    ("dialect", "says"),
    [
        ("v3", "iOptron GEM45(G) (0043), command set v3"),
        ("v2", "iOptron CEM60 (0060), command set v2"),
    ],
)
async def test_a_mount_is_found_by_harmless_questions(dialect: str, says: str) -> None:
    fake = fake_of(dialect=dialect)
    with FakeOnPty(fake) as bench:
        found = await probe(bench.address, IOPTRON)
    assert (found.family, found.baud, found.answer) == ("ioptron", 115_200, says)
    assert fake.heard == [b":MountInfo#", b":GLS#"]


@pytest.mark.parametrize(
    ("protocol", "says"),
    [
        ("nexstar", "NexStar hand control 5.31"),
        ("synscan", "SynScan hand control"),
        ("skywatcher", "Sky-Watcher"),
        ("lx200", "LX200"),
        ("ioptron", "iOptron"),
    ],
)
async def test_every_family_is_found_and_none_is_disturbed(protocol: str, says: str) -> None:
    mechanics = Mechanics(Site(49.6, 36.9), Air(), PointingErrors())
    fake = make_fake(protocol, None, mechanics, clock=utc_now, monotonic=time.monotonic)
    before, site, tracking = mechanics.axes(), mechanics.believed_site, mechanics.tracking
    with FakeOnPty(fake) as bench:
        found = await probe(bench.address)
    assert found.family == ("nexstar" if protocol == "synscan" else protocol)
    assert found.answer.startswith(says)
    assert mechanics.axes().dec_axis_deg == before.dec_axis_deg
    assert (mechanics.believed_site, mechanics.tracking) == (site, tracking)
    assert abs((mechanics.believed_utc() - utc_now()).total_seconds()) < 0.1
    assert not mechanics.slewing()


async def test_on_tcp_there_is_no_speed() -> None:
    with FakeOnTcp(fake_of()) as bench:
        found = await probe(bench.address, IOPTRON)
    assert (found.family, found.baud) == ("ioptron", None)


async def test_what_is_unknown_or_not_there_is_told() -> None:
    missing = await probe("/dev/no-such-port", IOPTRON)
    assert (missing.family, "can't be opened" in missing.answer) == ("", True)
    with FakeOnPty(fake_of()) as bench:
        assert (await probe(bench.address, ())).answer == "nothing that is known here answers"


def test_a_port_that_another_program_holds_is_not_opened() -> None:
    fake = fake_of()
    with FakeOnPty(fake) as bench:
        hold = f"held = open({bench.address!r}, 'rb', buffering=0); print('held', flush=True); input()"
        with subprocess.Popen(
            [sys.executable, "-c", hold], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as holder:
            assert holder.stdout is not None
            holder.stdout.readline()
            assert any(str(holder.pid) in one for one in holders(bench.address))
            found = asyncio.run(probe(bench.address, IOPTRON))
            holder.kill()
    assert found.family == ""
    assert f"({holder.pid})" in found.answer
    assert fake.heard == []


def test_a_stable_name_is_the_same_port(tmp_path: Path) -> None:
    with FakeOnPty(fake_of(), link=tmp_path / "by-id") as bench:
        assert holders(bench.address) == holders(bench.device) == ()


def test_the_machines_ports_are_listed() -> None:
    for port in serial_ports():
        assert port.device.startswith("/dev/")
        assert set(port.names) <= {str(entry) for entry in Path("/dev/serial/by-id").glob("*")}


def test_hand_controls_are_asked_first() -> None:
    assert [name for name, _ in probes()] == ["nexstar", "skywatcher", "lx200", "ioptron"]


def test_the_command_tells_what_answers_and_its_address() -> None:
    app = typer.Typer()
    app.command()(ports)
    with FakeOnTcp(fake_of()) as bench:
        told = CliRunner().invoke(app, ["--probe", "--port", bench.address])
        assert told.exit_code == 0, told.output
        assert "ioptron: iOptron GEM45(G)" in told.output
        assert bench.address.replace("socket://", "ioptron+tcp://") in told.output
        rows = json.loads(CliRunner().invoke(app, ["--probe", "--port", bench.address, "--json"]).stdout)
        assert rows[0]["probed"]["family"] == "ioptron"
    assert exit_code(ports, probe=True, port=["/dev/no-such-port"]) == 1
