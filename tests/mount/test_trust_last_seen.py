"""What the next start makes of a mount: as trusted as before, and only where it was left."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from api.observatory.restart import last_seen
from mountnav.devices import MountReading, for_mount
from mountnav.errors import DeviceRefused, Refusal
from mountnav.journal.reading import JournalReader
from mountnav.journal.records import CommandRecord, Order
from mountnav.journal.sql_journal import SqlJournal, open_journal
from mountnav.mount.trust import ELSEWHERE_DEG, LastSeen, strayed_deg, why_not_to_trust
from mountnav.navigation.sync import SyncTrigger
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Apparent, HourAngle, Icrs
from mountnav.sky.sphere import displaced
from tests.navigation.sync_rig import AIR, SITE, SyncRig, rigged

LEFT = datetime(2026, 11, 21, 22, 0, tzinfo=UTC)


def at(ha_deg: float, dec_deg: float, hours: float = 0.0) -> Icrs:
    return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, LEFT + timedelta(hours=hours)), SITE, AIR)


def left(tracking: bool | None, **given: object) -> LastSeen:
    return replace(LastSeen(at(20.0, 40.0), LEFT, tracking), **given)  # type: ignore[arg-type]


def met(ha_deg: float, dec_deg: float, hours: float, **said: object) -> MountReading:
    """A mount that speaks apparent coordinates, so many hours later."""
    utc = LEFT + timedelta(hours=hours)
    return MountReading(icrs_to_apparent(at(ha_deg, dec_deg, hours), utc), utc, **said)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("tracking", "ha_deg", "dec_deg", "hours", "strayed"),
    [
        (True, 20.0, 40.0, 0.0, False),
        # it went on, or rested from the first moment on, or from some moment on
        (True, 50.08, 40.0, 2.0, False),
        (True, 20.0, 40.0, 2.0, False),
        (True, 35.0, 40.0, 2.0, False),
        (True, 52.0, 40.0, 2.0, True),
        (True, 17.0, 40.0, 2.0, True),
        (None, 35.0, 40.0, 2.0, False),
        # what rested doesn't begin to track by itself
        (False, 20.0, 40.0, 9.0, False),
        (False, 35.0, 40.0, 2.0, True),
        # a power cut: at the zenith, or at the pole, tracking or not
        (True, 0.0, 48.9, 0.1, True),
        (True, 0.0, 89.9, 0.1, True),
        (False, 0.0, 48.9, 0.1, True),
        # round the clock
        (True, -170.0, 40.0, 11.3, False),
    ],
)
def test_where_it_may_have_come_to(
    tracking: bool | None, ha_deg: float, dec_deg: float, hours: float, strayed: bool
) -> None:
    off_deg = strayed_deg(left(tracking), met(ha_deg, dec_deg, hours), SITE, AIR)
    assert (off_deg > ELSEWHERE_DEG) is strayed, off_deg


@given(
    ha=st.floats(-80, 80),
    dec=st.floats(-20, 89),
    hours=st.floats(0, 5),
    share=st.floats(0, 1),
    east=st.floats(-1000, 1000),
    north=st.floats(-1000, 1000),
)
def test_what_stays_or_tracks_is_never_astray(
    ha: float, dec: float, hours: float, share: float, east: float, north: float
) -> None:
    known = LastSeen(at(ha, dec), LEFT, True)
    turned = ha + 15.041067 * hours * share
    now = met((turned + 180.0) % 360.0 - 180.0, dec, hours)
    assert isinstance(now.place, Apparent)
    nudged = replace(now, place=displaced(now.place, east, north))
    assert strayed_deg(known, nudged, SITE, AIR) < ELSEWHERE_DEG


def flying(order: Order, place: Icrs | None = None) -> CommandRecord:
    return CommandRecord("c", "rig", LEFT, order, "s", place)


@pytest.mark.parametrize(
    ("in_flight", "now", "trusted"),
    [
        ([], met(20.0, 40.0, 0.0), True),
        ([], met(-30.0, 10.0, 0.0), False),
        # it arrived, it goes on, it stopped on the way, it never went
        ([flying("slew", at(-30.0, 10.0))], met(-30.0, 10.0, 0.0), True),
        ([flying("slew", at(-30.0, 10.0))], met(0.0, 20.0, 0.0, slewing=True), True),
        ([flying("slew", at(-30.0, 10.0))], met(0.0, 20.0, 0.0), False),
        ([flying("slew", at(-30.0, 10.0))], met(20.0, 40.0, 0.0), True),
        ([flying("park")], met(0.0, 88.0, 0.0, parked=True), True),
        ([flying("park")], met(0.0, 88.0, 0.0, parked=False), False),
        ([flying("home")], met(0.0, 88.0, 0.0, at_home=True), True),
        ([flying("track")], met(0.0, 88.0, 0.0, parked=True), False),
    ],
)
def test_what_was_in_flight_explains_where_it_stands(
    in_flight: list[CommandRecord], now: MountReading, trusted: bool
) -> None:
    why = why_not_to_trust(left(True), in_flight, now, SITE, AIR)
    assert (why is None) is trusted, why
    # and nothing explains away what was not trusted before
    assert why_not_to_trust(left(True, trusted=False, why="lost"), in_flight, now, SITE, AIR) is not None


# -- over a restart ------------------------------------------------------------------------------------


def next_run(
    file: Path, work: Callable[[SyncRig, SqlJournal], Awaitable[None]], *, killed: bool = True
) -> None:
    """One run of a service over the journal in `file`; a killed one closes nothing."""

    async def whole(rig: SyncRig) -> None:
        reader, own = journal.reader, journal.run_id
        in_flight = reader.in_flight("rig", but_run=own)
        await rig.mount.take_up(last_seen(reader, "rig"), in_flight)
        await work(rig, journal)

    journal = open_journal(file, inline=True)
    try:
        rigged(whole, journal=journal)
    finally:
        if not killed:
            journal.close()


async def refused(rig: SyncRig) -> Refusal:
    with pytest.raises(DeviceRefused) as error:
        await rig.slew(rig.up(-30.0, 20.0))
    return error.value.reason


@pytest.mark.long
def test_distrust_survives_until_a_sync_was_seen(tmp_path: Path) -> None:
    file = tmp_path / "journal.sqlite"

    async def lost(rig: SyncRig, _: SqlJournal) -> None:
        await rig.slew(rig.up())
        rig.driver._session.distrust("its link was lost")

    async def again(rig: SyncRig, _: SqlJournal) -> None:
        # the driver itself would trust it
        assert rig.driver.trusted
        assert not rig.mount.trusted
        assert "its link was lost" in rig.mount.why_untrusted
        assert await refused(rig) is Refusal.UNTRUSTED

    async def synced(rig: SyncRig, _: SqlJournal) -> None:
        assert not rig.mount.trusted
        rig.driver._session.trust("the way there is not what is tried here")
        await rig.driver.slew(for_mount(rig.up(), "apparent", rig.clock.utc()))
        await rig.clock.sleep(2.0)
        await rig.guard.commit(await rig.look(), SyncTrigger.RECOVERY)
        assert rig.mount.trusted
        await rig.mount.reading()

    next_run(file, lost)
    next_run(file, again)
    # over any number of starts
    next_run(file, again)
    next_run(file, synced)
    known = last_seen(JournalReader(file), "rig")
    assert known is not None
    assert known.trusted


def test_an_operators_word_is_kept_too(tmp_path: Path) -> None:
    file = tmp_path / "journal.sqlite"

    async def trusted(rig: SyncRig, _: SqlJournal) -> None:
        await rig.mount.reading()
        rig.mount.distrust("a sync could not be taken back")
        rig.mount.trust()
        await rig.mount.reading()

    async def after(rig: SyncRig, _: SqlJournal) -> None:
        assert rig.mount.trusted

    next_run(file, trusted)
    next_run(file, after)


@pytest.mark.long
def test_a_mount_that_wakes_elsewhere_is_not_trusted(tmp_path: Path) -> None:
    file = tmp_path / "journal.sqlite"

    async def night(rig: SyncRig, _: SqlJournal) -> None:
        await rig.slew(rig.up(-40.0, 10.0))
        await rig.mount.reading()

    async def woken(rig: SyncRig, _: SqlJournal) -> None:
        # a new rig begins where its machine does: that is a power cut of both
        assert not rig.mount.trusted
        assert "from where it was seen last" in rig.mount.why_untrusted
        assert await refused(rig) is Refusal.UNTRUSTED

    next_run(file, night)
    next_run(file, woken)
    next_run(file, woken)


@pytest.mark.long
def test_a_quiet_night_writes_few_rows(tmp_path: Path) -> None:
    async def night(rig: SyncRig, journal: SqlJournal) -> None:
        for ha_deg in (-40.0, -10.0, 20.0):
            await rig.slew(rig.up(ha_deg, 20.0))
            for _ in range(6):
                await rig.clock.sleep(5.0)
                await rig.mount.reading()
        rows = [one for one in journal.reader.entries() if one.kind == "standing"]
        assert 4 <= len(rows) <= 6, [one.facts for one in rows]

    next_run(tmp_path / "journal.sqlite", night, killed=False)
