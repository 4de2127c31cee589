"""Controllers that are deaf after their port opens: greeted until it is clean, in their own dialect."""

from __future__ import annotations

import time

import pytest

from drivers.fakes.bench import FakeOnTcp
from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.nexstar.language import patience_of
from drivers.registry import make_fake, open_mount
from drivers.skywatcher.language import PATIENCE
from drivers.wire.exchange import Patience
from drivers.wire.link import Link
from mountnav.clock import utc_now
from mountnav.errors import DeviceRefused, DeviceSilent
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Apparent
from tests.drivers.generic.plain_language import PlainLanguage
from tests.drivers.test_unanswered_questions import Rig, Run, run
from tests.drivers.virtual_wire import HandClock, MemoryLine
from tests.drivers.wire_families import family
from tests.drivers.wire_fuzz import HERE, Family

__all__ = ["run"]

FAMILIES = [
    *(family("lx200", name) for name in ("onstep", "10micron", "am5", "gemini", "autostar", "lx200gps")),
    *(family("lx200", name) for name in ("generic", "classic", "basic")),
    family("nexstar"),
    family("synscan"),
    family("ioptron", "v3"),
    family("skywatcher"),
]
IN_EVERY_RUN = ("onstep", "10micron", "classic", "nexstar", "skywatcher")
"""One of each way to begin a conversation; all of them are long."""
families = pytest.mark.parametrize(
    "kind",
    [
        pytest.param(one, marks=() if (one.dialect or one.protocol) in IN_EVERY_RUN else pytest.mark.long)
        for one in FAMILIES
    ],
    ids=str,
)
DEAF_S = (0.4, 1.3, 1.9, 2.0, 2.7, 3.1, 3.4, 4.0, 4.9, 5.3, 6.6, 8.0, 9.5)
PATIENCES = {"nexstar": patience_of(8.0), "synscan": patience_of(8.0), "skywatcher": PATIENCE}


def opened(kind: Family, run: Run, *faults: Fault) -> Rig:
    async def one(clock: HandClock) -> Rig:
        rig = Rig(kind, clock, *faults)
        log = rig.mount.wire_log
        # the times that a URL gives the family
        rig.line = MemoryLine(rig.fake, clock, log)
        patience = PATIENCES.get(kind.protocol, Patience(deadline_s=5.0, try_s=5.0 / 3.0))
        rig.mount = GenericMount(kind.language(Link(rig.line, patience, log)), site=HERE)
        return await rig.connected()

    rig: Rig = run(one)
    return rig


@pytest.mark.long
@families
def test_a_deaf_start_ends_in_the_right_dialect_with_all_skills(kind: Family, run: Run) -> None:
    well = opened(kind, run)
    assert well.mount.report is not None
    for for_s in DEAF_S:
        rig = opened(kind, run, Fault("deaf-start", for_s=for_s, times=9))
        assert rig.mount.report is not None
        assert rig.mount.report.identity == well.mount.report.identity, for_s
        assert rig.mount.skills == well.mount.skills, for_s
        assert rig.line.opened == 1, "opened again, it would restart again"
        if for_s > 2.0:
            # what makes it deaf may have made it forget
            assert not rig.mount.trusted, for_s
            assert any("after its port was opened" in one for one in rig.mount.report.problems), for_s


@pytest.mark.parametrize("kind", FAMILIES, ids=str)
def test_a_board_that_opening_starts_anew_is_not_trusted(kind: Family, run: Run) -> None:
    reset = Fault("reset-by-opening", for_s=3.0, times=9)
    if kind.dialect == "gemini":
        # it asks its owner how to start, and is no mount before that
        with pytest.raises(DeviceRefused, match="startup"):
            opened(kind, run, reset)
        return
    assert not opened(kind, run, reset).mount.trusted


def test_one_that_stays_deaf_is_told_after_its_time(run: Run) -> None:
    for kind in FAMILIES:
        with pytest.raises(DeviceSilent) as silent:
            opened(kind, run, Fault("deaf-start", for_s=300.0))
        assert "check cable" in str(silent.value)


@pytest.mark.long
@families
def test_one_lost_answer_changes_no_dialect(kind: Family, run: Run) -> None:
    well = opened(kind, run)
    assert well.mount.report is not None
    for question in sorted({one for one in well.fake.obeyed if one}):
        for spoil in ("lose", "garble", "cut"):
            rig = opened(kind, run, Fault(spoil, on=question, byte=1 if spoil == "garble" else None))
            assert rig.mount.report is not None
            assert rig.mount.skills == well.mount.skills, (question, spoil)


def test_a_board_behind_a_settling_port_is_greeted_cleanly(run: Run) -> None:
    kind = family("lx200", "onstep")

    async def settled(clock: HandClock) -> tuple[Rig, float]:
        rig = Rig(kind, clock, Fault("deaf-start", for_s=2.5, times=9))
        log = rig.mount.wire_log
        rig.line = MemoryLine(rig.fake, clock, log)
        rig.mount = GenericMount(kind.language(Link(rig.line, Patience(settle_s=3.0), log)), site=HERE)
        began_s = clock.now_s
        await rig.connected()
        return rig, clock.now_s - began_s

    rig, took_s = run(settled)
    assert rig.mount.report is not None
    assert rig.mount.report.identity.startswith("OnStep")
    assert rig.mount.trusted
    assert 3.0 <= took_s < 4.5


async def test_over_a_real_socket_with_an_option() -> None:
    mechanics = Mechanics(HERE, Air(), PointingErrors())
    deaf = Fault("deaf-start", for_s=0.8, times=9)
    fake = make_fake("lx200", "onstep", mechanics, faults=[deaf], clock=utc_now, monotonic=time.monotonic)
    with FakeOnTcp(fake) as bench:
        where = bench.address.removeprefix("socket://")
        mount = open_mount(f"lx200+tcp://{where}?settle_s=0.1&greeting_s=6&timeout_s=1.2", site=HERE)
        assert isinstance(mount, GenericMount)
        await mount.open()
        try:
            assert mount.report is not None
            assert mount.report.identity.startswith("OnStep")
            assert not mount.trusted
            with pytest.raises(DeviceRefused, match="port was opened"):
                await mount.slew((await mount.reading()).place)
        finally:
            await mount.close()


@pytest.mark.parametrize(
    ("ra_deg", "below_deg", "why"),
    [(0.0, None, "was never set"), (None, 25.0, "below the horizon")],
)
async def test_an_implausible_place_does_not_count(
    ra_deg: float | None, below_deg: float | None, why: str
) -> None:
    mechanics = Mechanics(HERE, Air(), PointingErrors())
    language = PlainLanguage(mechanics)
    here = mechanics.reported()
    if ra_deg is not None:
        place = Apparent(0.0, 0.0, utc_now())
    else:
        place = Apparent(
            (here.ra_deg + 180.0) % 360.0, -(90.0 - HERE.latitude_deg + (below_deg or 0.0)), utc_now()
        )
    language.odd = [place, place, place]
    mount = GenericMount(language, site=HERE)
    await mount.open()
    try:
        assert not mount.trusted
        assert mount.report is not None
        assert any(why in one for one in mount.report.problems)
    finally:
        await mount.close()
