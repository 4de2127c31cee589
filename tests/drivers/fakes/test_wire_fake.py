"""What all fakes share: cutting, answers in their time, faults, spells, reboots; no I/O, no real time."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.fakes.bench import SlowLine
from drivers.fakes.faults import ANSWER_KINDS, Fault, RandomFaults, scripted
from drivers.fakes.wire_fake import WireFake
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Apparent, Site
from tests.drivers.virtual_wire import HandClock


class Echo(WireFake):
    """Answers `x#` with `<x#`; knows no `?#`; `m#` sets out on a slew; `p#` begins a pulse of 1 s."""

    IDENTITY = (b"who",)

    def __init__(self, clock: HandClock, **given: object) -> None:
        mechanics = Mechanics(Site(49.6, 36.9), Air(), PointingErrors(), clock=clock)
        super().__init__(mechanics, clock=clock, monotonic=clock.monotonic, **given)  # type: ignore[arg-type]
        self.pulse_s: float | None = None
        self.pulses_ended = 0
        self.state = "known"

    def cut(self, buffer: bytes) -> tuple[bytes | None, bytes]:
        end = buffer.find(b"#")
        return (None, buffer) if end < 0 else (buffer[: end + 1], buffer[end + 1 :])

    def carry_out(self, command: bytes) -> bytes | None:
        if command == b"?#":
            return None
        if command == b"m#":
            here = self.mechanics.reported()
            self.mechanics.slew(Apparent(here.ra_deg + 20.0, here.dec_deg - 20.0, here.utc))
        if command == b"p#":
            self.pulse_s = self._monotonic() + 1.0
            return b""
        return b"<" + command

    def deaf_reply(self, command: bytes) -> bytes:
        return b"<" + command

    def reboot(self) -> None:
        super().reboot()
        self.state = "forgotten"

    def dues(self) -> list[float]:
        return [] if self.pulse_s is None else [self.pulse_s]

    def tick(self) -> None:
        if self.pulse_s is not None and self.pulse_s <= self._monotonic():
            self.pulse_s = None
            self.pulses_ended += 1


class Rig:
    def __init__(self, *faults: Fault, **given: object) -> None:
        self.clock = HandClock()
        self.began_s = self.clock.now_s
        self.fake = Echo(self.clock, faults=faults, **given)

    def say(self, data: bytes, wait_s: float = 0.0) -> bytes:
        self.clock.now_s += wait_s
        return self.fake.feed(data)

    def all_later(self, until_s: float = 100.0) -> list[tuple[float, bytes]]:
        """All that it says unasked until then, with the instants; as a bench would fetch it."""
        said = []
        while (due_in_s := self.fake.due_in_s()) is not None and self.clock.now_s - self.began_s < until_s:
            self.clock.now_s += due_in_s + 1e-9
            if came := self.fake.feed(b""):
                said.append((round(self.clock.now_s - self.began_s, 3), came))
        return said


def test_bytes_are_cut_into_commands_however_they_come() -> None:
    rig = Rig()
    assert [rig.say(bytes([byte])) for byte in b"ab#c#"] == [b"", b"", b"<ab#", b"", b"<c#"]
    assert rig.say(b"d#e#f") == b"<d#<e#"
    assert rig.fake.heard == rig.fake.obeyed == [b"ab#", b"c#", b"d#", b"e#"]
    assert rig.fake.due_in_s() is None


def test_what_it_does_not_know_is_noted_and_met_with_silence() -> None:
    rig = Rig()
    assert rig.say(b"?#a#") == b"<a#"
    assert rig.fake.unknown == [b"?#"]
    assert rig.fake.obeyed == [b"a#"]


@pytest.mark.parametrize(
    ("fault", "answer"),
    [
        (Fault("lose"), b""),
        (Fault("cut"), b"<a"),
        (Fault("cut", byte=3), b"<ab"),
        (Fault("double"), b"<ab#<ab#"),
        (Fault("garble", byte=1, bit=0), b"<`b#"),
        (Fault("garble"), b"|ab#"),
        (Fault("scramble", byte=1, data=b"XY"), b"<XY#"),
        (Fault("scramble", byte=3, data=b"XY"), b"<abX"),
        (Fault("noise-before", data=b"!!"), b"!!<ab#"),
        (Fault("noise-after", data=b"!!"), b"<ab#!!"),
        (Fault("deaf"), b"<ab#"),
    ],
)
def test_spoiled_answers(fault: Fault, answer: bytes) -> None:
    rig = Rig(fault)
    assert rig.say(b"ab#") == answer
    assert rig.say(b"ab#") == b"<ab#"
    assert rig.fake.heard == [b"ab#", b"ab#"]
    assert rig.fake.obeyed == [b"ab#"] * (1 if fault.kind == "deaf" else 2)


def test_late_answers_are_never_overtaken() -> None:
    rig = Rig(Fault("late", on=b"a", delay_s=2.0))
    assert rig.say(b"a#b#") == b""
    assert rig.say(b"c#", wait_s=1.0) == b""
    assert rig.fake.due_in_s() == pytest.approx(1.0)
    assert rig.all_later() == [(2.0, b"<a#<b#<c#")]
    assert rig.say(b"d#") == b"<d#"


def test_bytes_may_come_one_by_one() -> None:
    rig = Rig(Fault("dribble", on=b"a", delay_s=0.5))
    assert rig.say(b"a#b#") == b"<"
    assert rig.all_later() == [(0.5, b"a"), (1.0, b"#<b#")]


def test_several_faults_strike_one_answer() -> None:
    rig = Rig(
        Fault("late", delay_s=1.0),
        Fault("late", delay_s=0.5),
        Fault("double"),
        Fault("noise-after", data=b"!"),
    )
    assert rig.say(b"a#") == b""
    assert rig.all_later() == [(1.5, b"<a#<a#!")]
    assert [strike.fault.kind for strike in rig.fake.strikes] == ["late", "late", "double", "noise-after"]


def test_triggers_are_counted_and_timed() -> None:
    rig = Rig(Fault("lose", on=b"a", skip=1, times=2, at_s=5.0))
    assert rig.say(b"a#") == b"<a#"  # not yet
    rig.clock.now_s += 5.0
    assert [rig.say(b"b#a#")[3:], rig.say(b"a#"), rig.say(b"a#"), rig.say(b"a#")] == [
        b"<a#",
        b"",
        b"",
        b"<a#",
    ]


def test_only_while_slewing() -> None:
    rig = Rig(Fault("lose", on=b"a", when_slewing=True))
    assert rig.say(b"a#") == b"<a#"
    assert rig.say(b"m#a#", wait_s=1.0) == b"<m#"
    assert rig.say(b"a#", wait_s=1.0) == b"<a#"


def test_chance_is_kept() -> None:
    rig = Rig(Fault("lose", chance=0.25, times=10**6), seed=3)
    lost = sum(rig.say(b"a#") == b"" for _ in range(2000))
    assert 400 < lost < 600


def test_silence_carries_out_and_says_nothing() -> None:
    rig = Rig(Fault("silence", on=b"s", for_s=3.0))
    assert rig.say(b"a#s#b#") == b""
    assert rig.say(b"c#", wait_s=2.9) == b""
    assert rig.fake.obeyed == [b"a#", b"s#", b"b#", b"c#"]
    assert rig.say(b"d#", wait_s=0.2) == b"<d#"


def test_a_dead_mount_hears_nothing() -> None:
    rig = Rig(Fault("dead", at_s=1.0, for_s=3.0))
    assert rig.say(b"a#b", wait_s=0.5) == b"<a#"
    assert rig.all_later(until_s=1.1) == []
    assert rig.say(b"c#", wait_s=0.1) == b""
    assert rig.fake.heard == [b"a#"]
    # what had come before is still in its buffer
    assert rig.say(b"d#", wait_s=3.0) == b"<bd#"


def test_a_dead_line_stays_dead() -> None:
    rig = Rig(Fault("dead", on=b"x"))
    assert rig.say(b"x#") == b""
    assert rig.say(b"a#", wait_s=1e6) == b""
    assert rig.fake.obeyed == []


def test_a_flood_mixes_with_answers() -> None:
    rig = Rig(Fault("flood", on=b"f", data=b"!", delay_s=0.1, for_s=0.25))
    assert rig.say(b"f#") == b"<f#!"
    assert rig.say(b"a#", wait_s=0.15) == b"!<a#"
    assert rig.all_later() == [(0.2, b"!")]


def test_a_reboot_forgets_and_takes_its_time() -> None:
    rig = Rig(Fault("reboot", on=b"m", after_s=2.0, for_s=5.0), Fault("late", on=b"l", delay_s=4.0))
    assert rig.say(b"m#l#") == b"<m#"
    rig.clock.now_s += 1.9
    assert rig.fake.mechanics.slewing()
    assert rig.fake.due_in_s() == pytest.approx(0.1)
    assert rig.say(b"a", wait_s=0.2) == b""
    assert rig.fake.state == "forgotten"
    assert rig.fake.mechanics.boots == 1
    assert not rig.fake.mechanics.slewing()
    assert rig.say(b"b#", wait_s=4.7) == b""
    assert rig.say(b"c#", wait_s=0.4) == b"<c#"
    assert rig.fake.heard == [b"m#", b"l#", b"c#"]
    assert rig.all_later() == []


def test_a_fault_comes_again_by_itself() -> None:
    rig = Rig(Fault("reboot", at_s=1.0, every_s=2.0, times=3, for_s=0.1))
    rig.all_later()
    assert [round(strike.t_s, 6) for strike in rig.fake.strikes] == [1.0, 3.0, 5.0]


def test_a_fault_may_wait_for_a_slew() -> None:
    rig = Rig(Fault("reboot", when_slewing=True, after_s=1.0, for_s=0.1))
    rig.say(b"a#")
    assert rig.fake.due_in_s() is None
    rig.say(b"m#")
    assert rig.fake.due_in_s() == pytest.approx(1.0)
    rig.all_later()
    assert rig.fake.mechanics.boots == 1


def test_timers_of_the_family() -> None:
    rig = Rig()
    rig.say(b"p#")
    assert rig.fake.due_in_s() == pytest.approx(1.0)
    assert rig.all_later() == []
    assert rig.fake.pulses_ended == 1


@pytest.mark.parametrize("kind", ["sync-ignored", "sync-refused", "sync-late"])
def test_faults_of_syncs_end(kind: str) -> None:
    rig = Rig(Fault(kind, on=b"a", delay_s=2.0, for_s=3.0))  # type: ignore[arg-type]
    mechanics = rig.fake.mechanics
    before = mechanics.reported()
    place = Apparent(before.ra_deg + 1.0, before.dec_deg, before.utc)
    rig.say(b"a#")
    assert (mechanics.sync(place) is None) == (kind != "sync-refused")
    assert mechanics.reported().ra_deg == pytest.approx(before.ra_deg)
    rig.clock.now_s += 2.5
    moved = mechanics.reported().ra_deg == pytest.approx(place.ra_deg)
    assert moved == (kind == "sync-late")
    rig.all_later()
    mechanics.sync(place)
    assert mechanics.reported().ra_deg == pytest.approx(place.ra_deg)


def test_a_stuck_axis_comes_free() -> None:
    rig = Rig(Fault("stick", axis="dec", for_s=5.0))
    rig.say(b"m#")
    before = rig.fake.mechanics.reported()
    rig.clock.now_s += 4.9
    rig.say(b"")
    assert rig.fake.mechanics.reported().dec_deg == pytest.approx(before.dec_deg, abs=1e-3)
    rig.say(b"", wait_s=0.2)
    rig.clock.now_s += 2.0
    assert rig.fake.mechanics.reported().dec_deg < before.dec_deg - 1.0


def test_an_axis_that_runs_away_heeds_the_stop_after_next() -> None:
    rig = Rig(Fault("run-away", axis="ha", stops=1))
    rig.say(b"m#")
    rig.clock.now_s += 60.0
    assert rig.fake.mechanics.slewing()
    rig.fake.mechanics.stop()
    rig.clock.now_s += 5.0
    assert rig.fake.mechanics.slewing()
    rig.fake.mechanics.stop()
    rig.clock.now_s += 5.0
    assert not rig.fake.mechanics.slewing()


def test_orders_to_the_line_are_handed_out_once() -> None:
    rig = Rig(Fault("vanish", on=b"v", for_s=2.0), Fault("reset", at_s=1.0))
    assert rig.say(b"v#") == b"<v#"
    assert [(order.kind, order.for_s) for order in rig.fake.line_orders()] == [("vanish", 2.0)]
    rig.all_later()
    assert [order.kind for order in rig.fake.line_orders()] == ["reset"]
    assert rig.fake.line_orders() == []


def test_a_profile_gives_only_its_identity() -> None:
    rig = Rig()
    assert rig.fake.take_profile({b"who#": b"an AVX#", b"m#": b"moved#"}) == [b"who#"]
    assert rig.say(b"who#m#") == b"an AVX#<m#"
    rig.clock.now_s += 1.0
    assert rig.fake.mechanics.slewing()


def test_a_slow_line_takes_its_time_both_ways() -> None:
    clock = HandClock()
    line = SlowLine(Echo(clock), 9600, clock.monotonic)
    began_s, came = clock.now_s, []
    said = line.feed(b"ab#")
    while (due_in_s := line.due_in_s()) is not None:
        clock.now_s += due_in_s + 1e-9
        if said := line.feed(b""):
            came.append((clock.now_s - began_s, said))
    assert b"".join(data for _, data in came) == b"<ab#"
    # three bytes there, four back, ten bits each
    assert came[0][0] == pytest.approx(4 * 10 / 9600, abs=1e-6)
    assert came[-1][0] == pytest.approx(7 * 10 / 9600, abs=1e-6)


KINDS = [kind for kind in ANSWER_KINDS if kind != "deaf"]


@pytest.mark.long
@given(seed=st.integers(0, 2**32), rate=st.sampled_from([0.1, 0.5, 1.0]))
def test_the_same_seed_strikes_the_same(seed: int, rate: float) -> None:
    def life() -> tuple[list[bytes], list[object]]:
        rig = Rig()
        rig.fake.chance = RandomFaults(seed, rate, [*KINDS, "silence", "dead", "flood", "reboot"])  # type: ignore[list-item]
        return [rig.say(b"a#b", 0.1) + rig.say(b"#", 0.1) for _ in range(30)], list(rig.fake.strikes)

    assert life() == life()


@pytest.mark.long
@given(seed=st.integers(0, 2**32))
def test_a_random_run_becomes_a_script_that_goes_the_same(seed: int) -> None:
    def life(rig: Rig) -> list[bytes]:
        commands = random.Random(seed).choices([b"a#", b"ab#", b"b#", b"who#"], k=60)
        return [rig.say(command, 0.1) for command in commands]

    first = Rig(Fault("garble", chance=0.1, times=10**6), seed=seed)
    first.fake.chance = RandomFaults(seed, 0.2, [*KINDS, "deaf", "silence", "flood"])  # type: ignore[list-item]
    said = life(first)
    again = Rig(*scripted(first.fake.strikes))
    assert life(again) == said
    assert [(strike.t_s, strike.command) for strike in again.fake.strikes] == [
        (strike.t_s, strike.command) for strike in first.fake.strikes
    ]
