"""A mount that lacks a question of the greeting connects, a skill less, and it is told."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from drivers.generic.mount import GenericMount
from drivers.registry import make_fake
from drivers.wire.exchange import Patience
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.devices import Skill
from mountnav.errors import DeviceError, DeviceSilent
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Apparent
from tests.drivers.virtual_wire import HandClock, MemoryLine, VirtualLoop, in_virtual_time
from tests.drivers.wire_families import family, told_dialect
from tests.drivers.wire_fuzz import HERE, Family

_LX200_PLACE = {b":GR#", b":GD#"}
_SKYWATCHER_NEEDED = {b":%s%d\r" % (word, axis) for word in (b"e", b"a", b"b", b"f", b"j") for axis in (1, 2)}

NEEDED: dict[str, set[bytes]] = {
    "lx200": _LX200_PLACE,
    # its version is who it is, its place, and the echo that keeps one # from being taken for another's
    "nexstar": {b"V", b"e", b"K"},
    "synscan": {b"V", b"e", b"K"},
    # what it says of itself tells its command set; and its place
    "ioptron": {b":GLS#", b":GEP#", b":GEC#"},
    # without its gears and their counts it has no place, and without its status no motion is seen
    "skywatcher": _SKYWATCHER_NEEDED,
}
"""Without these there is no mount; all others refine."""

IDENTITY: dict[str, set[bytes]] = {
    "onstep": {b":GVP#"},
    "10micron": {b":GVP#"},
    "am5": {b":GVP#"},
    "gemini": {b"\x06"},
    "autostar": {b":GVP#"},
    "lx200gps": {b":GVP#"},
    "generic": {b":GVP#", b"\x06"},
}
"""Without these it is taken for another: it connects, as a poorer one."""

_UNTOLD = {b"\x06", b":GVN#", b":GVP#", b":U2#"}
"""Greetings, on which only the choice of words hangs, and an order without an answer."""

FAMILIES = [
    *(family("lx200", name) for name in ("onstep", "10micron", "am5", "gemini", "autostar", "lx200gps")),
    *(family("lx200", name) for name in ("generic", "classic", "basic")),
    told_dialect("lx200", "ap"),
    family("nexstar"),
    family("synscan"),
    family("ioptron", "v3"),
    family("ioptron", "v2"),
    family("skywatcher"),
]


class Rig:
    """A mount and its fake in memory, in virtual time."""

    def __init__(self, kind: Family, clock: HandClock, *faults: Fault) -> None:
        self.mechanics = Mechanics(
            HERE, Air(), PointingErrors(), machine=kind.machine or Machine(), clock=clock
        )
        self.fake: WireFake = make_fake(
            kind.protocol, kind.dialect, self.mechanics, faults=faults, clock=clock, monotonic=clock.monotonic
        )
        log = WireLog(monotonic=clock.monotonic)
        self.line = MemoryLine(self.fake, clock, log)
        self.mount = GenericMount(kind.language(Link(self.line, Patience(), log)), site=HERE)

    async def connected(self) -> Rig:
        await self.mount.open()
        await self.mount.reading()
        await self.mount.close()
        return self


def connecting(kind: Family, *faults: Fault) -> Callable[[HandClock], Coroutine[Any, Any, Rig]]:
    """Connects such a mount, on the clock that it is given."""
    return lambda clock: Rig(kind, clock, *faults).connected()


Run = Callable[[Callable[[HandClock], Coroutine[Any, Any, Any]]], Any]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Run:
    def virtually(make: Callable[[HandClock], Coroutine[Any, Any, Any]]) -> Any:
        clock = HandClock()
        in_virtual_time(monkeypatch, clock)
        loop = VirtualLoop(clock)
        try:
            asyncio.set_event_loop(loop)
            return loop.run_until_complete(make(clock))
        finally:
            asyncio.set_event_loop(None)
            loop.close()

    return virtually


@pytest.mark.long
@pytest.mark.parametrize("kind", FAMILIES, ids=str)
def test_each_question_but_the_needed_ones_may_stay_unanswered(kind: Family, run: Run) -> None:
    well = run(connecting(kind))
    assert not any("doesn't answer" in one for one in well.mount.report.problems)
    questions = {one for one in well.fake.obeyed if one and one[:1] != b"K"}
    assert len(questions) >= (2 if kind.dialect == "basic" else 6)
    needed = NEEDED[kind.protocol]
    identity = IDENTITY.get(kind.dialect or "", set())
    wrong = {}
    for question in sorted(questions - needed):
        mute = Fault("lose", on=question, times=10**9)
        try:
            rig = run(connecting(kind, mute))
        except DeviceError as error:
            wrong[question] = str(error)
            continue
        if not rig.fake.strikes:
            wrong[question] = "not asked at all"
        elif question not in identity:
            told = [one for one in rig.mount.report.problems if repr(question) in one]
            if not told and question not in _UNTOLD:
                wrong[question] = f"not told: {rig.mount.report.problems}"
        if rig.mount.skills - well.mount.skills:
            wrong[question] = "more skills than with it"
    assert not wrong


@pytest.mark.long
@pytest.mark.parametrize("kind", FAMILIES, ids=str)
def test_the_needed_ones_are_missed_with_fitting_advice(kind: Family, run: Run) -> None:
    well = run(connecting(kind))
    asked = {one for one in well.fake.obeyed if one in NEEDED[kind.protocol]}
    # OnStep and 10micron are asked for their finer words, and for these where those are missing
    assert asked or kind.dialect in ("onstep", "10micron")
    first = next(iter(well.fake.obeyed))
    for question in sorted(asked):
        mute = Fault("lose", on=question, times=10**9)
        with pytest.raises(DeviceSilent) as missing:
            run(connecting(kind, mute))
        if question != first:
            # the cable is fine: it answers others
            assert "check cable" not in str(missing.value), question


def test_what_is_missing_is_a_skill_less(run: Run) -> None:
    for kind, question, skill in (
        (family("lx200", "10micron"), b":GUDT#", Skill.CLOCK),
        (family("lx200", "onstep"), b":GG#", Skill.CLOCK),
        (family("lx200", "am5"), b":Gm#", Skill.PIER_SIDE),
        (family("lx200", "am5"), b":Gt#", Skill.SITE),
        (family("nexstar"), b"i", Skill.CLOCK),
        (family("nexstar"), b"w", Skill.SITE),
        (family("ioptron", "v3"), b":GUT#", Skill.CLOCK),
    ):
        mute = Fault("lose", on=question, times=10**9)
        rig = run(connecting(kind, mute))
        assert skill not in rig.mount.skills, question
        assert len(rig.mount.skills) > 5
        assert any(repr(question) in one for one in rig.mount.report.problems), question


def test_an_old_am5_is_not_asked_what_it_does_not_know(run: Run) -> None:
    kind = family("lx200", "am5")

    async def old(clock: HandClock) -> Rig:
        rig = Rig(
            kind, clock, Fault("lose", on=b":Gps#", times=10**9), Fault("lose", on=b":hP#", times=10**9)
        )
        rig.fake.take_profile({b":GVN#": b"1.1.2#", b":GV#": b"1.1.2#"})
        return await rig.connected()

    rig = run(old)
    assert b":Gps#" not in rig.fake.heard
    assert {Skill.PARK, Skill.UNPARK} <= rig.mount.skills


def test_an_onstep_without_fine_places_is_read_and_sent_coarsely(run: Run) -> None:
    kind = family("lx200", "onstep")

    async def coarse(clock: HandClock) -> tuple[Rig, Any]:
        mutes = [Fault("lose", on=one, times=10**9) for one in (b":GRH#", b":GDH#")]
        rig = Rig(kind, clock, *mutes)
        await rig.mount.open()
        rig.mount.trust()
        place = (await rig.mount.reading()).place
        assert rig.mount.resolution_arcsec == 15.0
        outcome = await rig.mount.slew(Apparent(place.ra_deg, place.dec_deg - 5.0, clock()))
        await rig.mount.close()
        return rig, outcome

    rig, outcome = run(coarse)
    assert outcome == "arrived"
    assert any(len(one) == len(b":Sr12:34:56#") for one in rig.fake.obeyed if one.startswith(b":Sr"))


def test_a_lost_answer_is_not_a_missing_question(run: Run) -> None:
    kind = family("lx200", "10micron")
    rig = run(lambda clock: Rig(kind, clock, Fault("lose", on=b":GUDT#", times=2)).connected())
    assert Skill.CLOCK in rig.mount.skills


@pytest.mark.long
def test_what_is_missing_is_proven_once_and_a_new_link_waits_less_for_it(run: Run) -> None:
    kind = family("lx200", "classic")

    async def twice(clock: HandClock) -> tuple[float, float, str, str]:
        rig = Rig(kind, clock)
        took, texts = [], []
        for _ in range(2):
            began_s = clock.now_s
            texts.append((await rig.mount.language.open()).text)
            took.append(clock.now_s - began_s)
            await rig.mount.language.close()
        return took[0], took[1], texts[0], texts[1]

    first_s, again_s, first, again = run(twice)
    assert again == first
    assert again_s < 0.5 * first_s
    assert again_s < 3.0
