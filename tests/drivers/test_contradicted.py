"""What a mount says and what it does, in nine families: half a sync, a damaged one, a no that moves.

Seven on their own wires, one behind a real INDI server and driver, one behind an Alpaca server.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from drivers.generic.mount import GenericMount
from mountnav.clock import utc_now
from mountnav.devices import SyncOutcome
from mountnav.errors import DeviceRefused, Refusal, RefusedButDone
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.alpaca import test_language as alpaca
from tests.drivers.alpaca.alpaca_server import Fault as AlpacaFault
from tests.drivers.indi.test_language_through_indi import through_indi, up_now
from tests.drivers.test_every_family import rigged

pytestmark = pytest.mark.first  # they wait for mounts: not at the end, when nothing else is left to do

ON_A_WIRE = {
    "lx200": ("lx200", "lx200gps"),
    "onstep": ("lx200", "onstep"),
    "10micron": ("lx200", "10micron"),
    "am5": ("lx200", "am5"),
    "ioptron": ("ioptron", "v3"),
    "nexstar": ("nexstar", "nexstar"),
    "synscan": ("synscan", "synscan"),
}
ALL = [*ON_A_WIRE, "indi", "alpaca"]
IN_EVERY_RUN = {"onstep", "alpaca"}
WORDLESS = {"nexstar", "synscan"}
"""Hand controls that answer each order alike: they have no words for a refusal."""


@dataclass
class Contradicted:
    """A mount, what stands behind it, and what it told."""

    mount: GenericMount
    mechanics: Mechanics
    fake: WireFake | None = None
    server: Any = None
    told: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.mount.listen(lambda what, _facts: self.told.append(what))

    async def beside(self, ra_deg: float, dec_deg: float) -> Apparent | Icrs:
        place = (await self.mount.reading()).place
        ra, dec = (place.ra_deg + ra_deg) % 360.0, place.dec_deg + dec_deg
        return Icrs(ra, dec) if isinstance(place, Icrs) else Apparent(ra, dec, utc_now())

    def deny_the_slew(self) -> None:
        """The next goto is carried out, and answered by a no."""
        if self.server is not None:
            for member in ("slewtocoordinatesasync", "slewtocoordinates"):
                self.server.faults.append(AlpacaFault(member, "denied", number=0x500, body="The slew failed"))
            return
        assert self.fake is not None
        for on in (b":MS", b":J1"):
            self.fake.add_fault(Fault("deny", on=on))


@asynccontextmanager
async def mount_of(family: str, home: Path) -> AsyncIterator[Contradicted]:
    if family == "indi":
        async with through_indi(home) as (mount, fake):
            await mount.slew(up_now(-30.0, 40.0))
            yield Contradicted(mount, fake.mechanics, fake)
    elif family == "alpaca":
        async with alpaca.rigged() as rig:
            yield Contradicted(rig.mount, rig.telescope.mechanics, server=rig.server)
    else:
        protocol, dialect = ON_A_WIRE[family]
        async with rigged(protocol, dialect) as wired:
            yield Contradicted(wired.mount, wired.fake.mechanics, wired.fake)


families = pytest.mark.parametrize(
    "family", [pytest.param(one, marks=[] if one in IN_EVERY_RUN else [pytest.mark.long]) for one in ALL]
)


@pytest.mark.long
@families
@pytest.mark.parametrize("took", ["half", "dec-only", "elsewhere"])
async def test_a_sync_that_takes_another_place_is_never_called_ignored(
    family: str, took: Any, tmp_path: Path
) -> None:
    async with mount_of(family, tmp_path / "home") as rig:
        assert rig.mount.trusted
        before = (await rig.mount.reading()).place
        place = await rig.beside(0.3, -0.2)
        rig.mechanics.sync_behavior = took
        result = await rig.mount.sync(place)
        assert result.outcome is SyncOutcome.ELSEWHERE
        assert not result.outcome.seen
        # the belief did move, and not to there
        after = result.read_back.place
        assert _apart(before, after) > 300.0
        assert result.miss_arcsec > 300.0
        assert not rig.mount.trusted
        assert rig.told.count("sync-elsewhere") == 1
        with pytest.raises(DeviceRefused) as refused:
            await rig.mount.slew(place)
        assert refused.value.reason is Refusal.UNTRUSTED
        # the way out: a sync that is seen
        rig.mechanics.sync_behavior = "normal"
        assert (await rig.mount.sync(place)).outcome is SyncOutcome.SEEN
        assert rig.mount.trusted


@pytest.mark.long
@families
async def test_a_sync_that_is_ignored_is_no_fault(family: str, tmp_path: Path) -> None:
    async with mount_of(family, tmp_path / "home") as rig:
        rig.mechanics.sync_behavior = "ignore"
        for ra_deg, dec_deg in ((0.3, -0.2), (0.02, 0.01)):
            result = await rig.mount.sync(await rig.beside(ra_deg, dec_deg))
            assert result.outcome is SyncOutcome.IGNORED
        assert rig.mount.trusted
        assert "sync-elsewhere" not in rig.told


@pytest.mark.parametrize(
    "family",
    [
        pytest.param(one, marks=[] if one in IN_EVERY_RUN else [pytest.mark.long])
        for one in ALL
        if one not in WORDLESS
    ],
)
async def test_a_slew_that_was_refused_and_goes_is_stopped(family: str, tmp_path: Path) -> None:
    async with mount_of(family, tmp_path / "home") as rig:
        rig.mechanics.slew_rate_deg_s = 3.0
        place = await rig.beside(20.0, -20.0)
        rig.deny_the_slew()
        with pytest.raises(RefusedButDone, match=r"said refused .*, but moved.*stopped"):
            await rig.mount.slew(place)
        assert not rig.mechanics.slewing()
        assert _apart((await rig.mount.reading()).place, place) > 5.0 * 3600.0
        assert not rig.mount.trusted
        assert rig.told.count("refused-but-done") == 1


def _apart(one: Apparent | Icrs, two: Apparent | Icrs) -> float:
    return separation_arcsec(Icrs(one.ra_deg, one.dec_deg), Icrs(two.ra_deg, two.dec_deg))
