"""Switched off and on in the middle of a motion: wherever it wakes up, that place is never trusted.

In virtual time, by the drivers' usual timing: silent from 1.2 s, an answer given up after some 5 s, the link
lost after 6 s. A mute of about 4 s ends between all of these.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Iterator

import pytest

from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.registry import make_fake
from mountnav.clock import utc_now
from mountnav.errors import DeviceError
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.virtual_wire import HandClock, VirtualLoop, in_virtual_time
from tests.drivers.wire_families import family
from tests.drivers.wire_fuzz import Rig

FAMILIES = [
    ("lx200", "lx200gps"),
    ("lx200", "onstep"),
    ("lx200", "10micron"),
    ("lx200", "am5"),
    ("nexstar", None),
    ("synscan", None),
    ("ioptron", None),
    ("skywatcher", None),
]
SHORT_S = (0.2, 0.5, 0.8, 1.1)
"""Nobody notices a silence of these: a question is asked again before it counts as unanswered."""
MUTES_S = (2.0, 3.0, 4.0, 4.5, 5.0, 6.5)
ASKED_BEFORE_AN_ORDER = {"nexstar": b"J", "synscan": b"J"}
"""Commands that go out while an order is told, begin so; the other families' all begin with a colon."""
WRONG_ARCSEC = 5.0 * 3600.0


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    logging.disable(logging.WARNING)
    yield
    logging.disable(logging.NOTSET)


class Rebooted:
    """A mount that is switched off and on `at_s` into a motion, and mute for `mute_s`."""

    def __init__(self, protocol: str, dialect: str | None, at_s: float, mute_s: float, seed: int) -> None:
        self.clock = HandClock()
        self.at_s, self.mute_s = at_s, mute_s
        self.protocol, self.dialect, self.seed = protocol, dialect, seed
        self.error: BaseException | None = None
        self.result: object = None
        self.off_arcsec = 0.0
        """How far the tube is at last from where the driver says; 0 where it says nothing."""

    def run(self, monkeypatch: pytest.MonkeyPatch, order: str, then: str = "") -> Rig:
        in_virtual_time(monkeypatch, self.clock)
        loop = VirtualLoop(self.clock)
        try:
            made = family(self.protocol, self.dialect)
            rig = Rig(made, make_fake, self.clock, self.seed, 0.0, ())
            loop.run_until_complete(self._live(rig, order, then))
            return rig
        finally:
            loop.close()
            monkeypatch.undo()

    async def _live(self, rig: Rig, order: str, then: str) -> None:
        mount = rig.mount
        await mount.open()
        mount.trust()
        try:
            # away from where it stands when it is switched on
            here = rig.mechanics.reported()
            start = Apparent(here.ra_deg, 40.0, utc_now())
            await mount.slew(_as_it_speaks(mount, start))
            place = (await mount.reading()).place
            aim = Apparent((place.ra_deg + 30.0) % 360.0, place.dec_deg - 35.0, utc_now())
            if then == "before":
                rig.fake.add_fault(Fault("reboot", for_s=self.mute_s))
                rig.fake.feed(b"")
            elif then == "while it is told":
                on = ASKED_BEFORE_AN_ORDER.get(self.protocol, b":")
                rig.fake.add_fault(Fault("reboot", on=on, skip=round(self.at_s), for_s=self.mute_s))
            if order == "sync":
                near = Apparent(place.ra_deg, place.dec_deg + 0.3, utc_now())
                moving: asyncio.Future[object] = asyncio.ensure_future(mount.sync(_of_kind(near, place)))
            else:
                moving = asyncio.ensure_future(
                    mount.park() if order == "park" else mount.slew(_of_kind(aim, place))
                )
            await asyncio.sleep(self.at_s)
            if then not in ("before", "while it is told"):
                rig.fake.add_fault(Fault("reboot", for_s=self.mute_s))
                rig.fake.feed(b"")
            if then == "stop":
                await asyncio.sleep(0.7 * self.mute_s)
                with contextlib.suppress(DeviceError):
                    await mount.stop()
            elif then == "cancel":
                await asyncio.sleep(0.3)
                moving.cancel()
            await asyncio.wait({moving})
            if not moving.cancelled():
                self.error = moving.exception()
                self.result = None if self.error else moving.result()
            await asyncio.sleep(30.0)
            with contextlib.suppress(DeviceError):
                said = (await mount.reading()).place
                seen = said if isinstance(said, Icrs) else apparent_to_icrs(said)
                self.off_arcsec = separation_arcsec(rig.mechanics.truth(), seen)
        finally:
            await mount.close()


def _of_kind(aim: Apparent, place: Apparent | Icrs) -> Apparent | Icrs:
    return Icrs(aim.ra_deg, aim.dec_deg) if isinstance(place, Icrs) else aim


def _as_it_speaks(mount: GenericMount, place: Apparent) -> Apparent | Icrs:
    return Icrs(place.ra_deg, place.dec_deg) if mount.epoch == "icrs" else place


def wrong_arcsec(rig: Rig) -> float:
    """How far the tube is from where the mount believes."""
    truth, said = rig.mechanics.truth(), rig.mechanics.reported()
    return separation_arcsec(truth, apparent_to_icrs(said))


def swept(
    monkeypatch: pytest.MonkeyPatch,
    protocol: str,
    dialect: str | None,
    order: str,
    then: str,
    *,
    mutes_s: tuple[float, ...] = MUTES_S,
    ats_s: tuple[float, ...] = (0.35, 1.6, 3.1),
) -> tuple[list[str], int]:
    """What was trusted and wrong; and how often the belief was wrong at all."""
    found, wrong = [], 0
    for number, mute_s in enumerate(mutes_s):
        for at_s in ats_s:
            one = Rebooted(protocol, dialect, at_s + 0.07 * number, mute_s, number)
            rig = one.run(monkeypatch, order, then)
            off = wrong_arcsec(rig)
            wrong += off > WRONG_ARCSEC
            if off > WRONG_ARCSEC and rig.mount.trusted:
                state = rig.mount.slew_state
                found.append(f"at {one.at_s:.2f} s, mute {mute_s} s: {off / 3600.0:.1f}° off, {state}")
    return found, wrong


@pytest.mark.long
def test_no_place_it_wakes_up_at_is_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    found, wrong = swept(monkeypatch, "lx200", "onstep", "slew", "", mutes_s=(2.0, 4.0, 4.5), ats_s=(2.0,))
    assert found == []
    assert wrong > 0


@pytest.mark.long
@pytest.mark.parametrize("then", ["before", "while it is told"])
def test_nor_one_at_which_it_woke_up_before_the_order_went_out(
    then: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, wrong = swept(
        monkeypatch, "lx200", "10micron", "slew", then, mutes_s=(2.0, 4.5), ats_s=(0.0, 2.0, 4.0)
    )
    assert found == []
    assert wrong > 0


@pytest.mark.long
@pytest.mark.parametrize(("protocol", "dialect"), FAMILIES)
@pytest.mark.parametrize("then", ["before", "while it is told"])
def test_nor_after_a_silence_too_short_to_be_noticed(
    protocol: str, dialect: str | None, then: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ats_s = (0.0, 1.0, 2.0, 3.0)
    found, _ = swept(monkeypatch, protocol, dialect, "slew", then, mutes_s=SHORT_S[::2], ats_s=ats_s)
    assert found == []


def synced(
    monkeypatch: pytest.MonkeyPatch,
    protocol: str,
    dialect: str | None,
    then: str,
    mutes_s: tuple[float, ...],
    skips: tuple[float, ...],
) -> list[str]:
    """What was wrong of syncs during which the mount was switched off and on."""
    found = []
    for number, mute_s in enumerate(mutes_s):
        for skip in skips:
            one = Rebooted(protocol, dialect, skip, mute_s, number)
            rig = one.run(monkeypatch, "sync", then)
            # bare motors are synced by their driver, which alone knows of it
            off = one.off_arcsec
            said = f"after {skip:.0f}, mute {mute_s} s: {off / 3600.0:.1f}° off, {one.result or one.error!r}"
            if off > WRONG_ARCSEC and rig.mount.trusted:
                found.append(f"trusted {said}")
            if one.result is None and not isinstance(one.error, DeviceError):
                found.append(f"no outcome {said}")
    return found


@pytest.mark.long
def test_a_sync_during_which_it_was_switched_off_and_on_proves_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert synced(monkeypatch, "lx200", "10micron", "while it is told", (0.8, 2.0), (0.0, 2.0, 4.0)) == []


@pytest.mark.long
@pytest.mark.parametrize(("protocol", "dialect"), FAMILIES)
@pytest.mark.parametrize("then", ["before", "while it is told"])
def test_nor_does_one_in_any_family(
    protocol: str, dialect: str | None, then: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    skips = tuple(map(float, range(0, 8, 2))) if then == "while it is told" else (0.0, 1.0)
    assert synced(monkeypatch, protocol, dialect, then, (SHORT_S[2], 2.0, 5.5), skips) == []


@pytest.mark.long
@pytest.mark.parametrize(("protocol", "dialect"), FAMILIES)
@pytest.mark.parametrize(
    ("order", "then"),
    [
        ("slew", ""),
        ("slew", "stop"),
        ("slew", "cancel"),
        ("slew", "before"),
        ("slew", "while it is told"),
        ("park", ""),
        ("park", "before"),
    ],
)
def test_nor_in_any_family_however_long_it_is_mute(
    protocol: str, dialect: str | None, order: str, then: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, wrong = swept(monkeypatch, protocol, dialect, order, then, mutes_s=MUTES_S[::2])
    assert found == []
    if protocol == "lx200" and order == "slew":
        assert wrong > 0  # it was no idle sweep
