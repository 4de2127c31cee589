"""A family that another package adds: opened by its URL, faked, probed; docs/how-to/add-a-mount-family.md."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from drivers.fakes.bench import FakeOnPty
from drivers.ports import probe
from drivers.registry import drivers, fake_dialects, family, make_fake, open_mount
from drivers.wire.command import Unreadable
from mountnav.clock import utc_now
from mountnav.devices import SlewOutcome
from mountnav.errors import BadSettings, DeviceRefused, Refusal
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Apparent, Site
from mountnav.testing.check_mount import check_mount
from tests.drivers.toy import codec
from tests.drivers.toy.fake import FakeToy
from tests.drivers.toy.family import FAMILY

HERE = Site(49.6, 36.9)
QUICK = "poll_s=0.1&start_grace_s=0.6&rest_s=0.4&sync_wait_s=1.0&late_s=0.5"
ROOT = Path(__file__).parents[2]


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package that offers the toy, as pip leaves it: metadata on the path, and nothing else."""
    metadata = tmp_path / "toy_mounts-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-mounts\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[mountnav.mounts]\ntoy = tests.drivers.toy.family:FAMILY\n")
    monkeypatch.syspath_prepend(str(tmp_path))


def _mechanics() -> Mechanics:
    machine = Machine(slew_rate_deg_s=20.0, acceleration_deg_s2=40.0, lowest_altitude_deg=0.0)
    return Mechanics(HERE, Air(), PointingErrors(), machine=machine)


@pytest.mark.usefixtures("installed")
async def test_a_toy_slews_on_its_wire() -> None:
    mechanics = _mechanics()
    with FakeOnPty(make_fake("toy", None, mechanics)) as bench:
        mount = open_mount(f"toy+serial://{bench.address}?{QUICK}", site=HERE)
        await mount.open()
        try:
            begun = (await mount.reading()).place
            assert isinstance(begun, Apparent)
            target = Apparent(begun.ra_deg, begun.dec_deg - 3.0, utc_now())
            assert await mount.slew(target) is SlewOutcome.ARRIVED
            reached = (await mount.reading()).place
            assert reached.dec_deg == pytest.approx(begun.dec_deg - 3.0, abs=2.0 * codec.STEP_ARCSEC / 3600.0)
            with pytest.raises(DeviceRefused) as refused:
                await mount.slew(Apparent((begun.ra_deg + 180.0) % 360.0, -60.0, utc_now()))
            assert refused.value.reason is Refusal.BELOW_HORIZON
        finally:
            await mount.close()


@pytest.mark.usefixtures("installed")
async def test_a_toy_passes_the_checks_of_all_mounts() -> None:
    with FakeOnPty(make_fake("toy", None, _mechanics())) as bench:
        mount = open_mount(f"toy+serial://{bench.address}?{QUICK}", site=HERE)
        await mount.open()
        try:
            await check_mount(mount)
        finally:
            await mount.close()


@pytest.mark.usefixtures("installed")
async def test_a_toy_is_known_by_its_name() -> None:
    assert "toy" in drivers()
    assert family("toy") is FAMILY
    assert fake_dialects("toy") == ("toy",)
    with pytest.raises(BadSettings, match="toy\\+tcp://host:4030"):
        open_mount("toy+tcp://host")


async def test_a_toy_is_found_on_its_port() -> None:
    with FakeOnPty(FakeToy(_mechanics())) as bench:
        found = await probe(bench.address, [FAMILY])
    assert (found.family, found.baud, found.answer) == ("toy", 9600, "toy 1.0")


def test_what_is_no_place_is_refused() -> None:
    where = codec.where_from_text("123.4567 -12.3456 0 1")
    assert codec.where_from_text(codec.where_to_text(where)) == where
    for wrong in ("", "123.4567", "360.0000 +00.0000 0 1", "10.0000 +90.5000 0 1", "10.0000 10.0000 0 1"):
        with pytest.raises(Unreadable):
            codec.where_from_text(wrong)


def test_the_page_quotes_this_code() -> None:
    page = (ROOT / "docs" / "how-to" / "add-a-mount-family.md").read_text()
    quoted = re.findall(r"```python\n# (\S+)\n(.*?)```", page, re.DOTALL)
    assert {path for path, _ in quoted} == {
        f"tests/drivers/toy/{name}.py" for name in ("codec", "language", "fake", "family")
    }
    for path, code in quoted:
        source = (ROOT / path).read_text()
        for piece in code.split("...\n"):
            assert piece.strip("\n") in source, piece
