"""Faults in files: read, refused with the line's name, written back; and drawn at random."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.fakes.faults import (
    KINDS,
    RATE_KINDS,
    USUAL_KINDS,
    Fault,
    RandomFaults,
    Strike,
    faults_as_toml,
    parse_faults,
    rate_fault,
    read_faults,
    scripted,
)
from drivers.lx200.fake.base import FakeLx200
from mountnav.errors import BadSettings
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.rate_faults import RateFault
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Site

SCRIPT = """
[random]
seed = 7
rate = 0.02
kinds = ["late", "garble"]
on = ":G"

[[fault]]
kind = "late"
on = ":GR"
delay_s = 6.5

[[fault]]
kind = "noise-before"
on_hex = "06"
data_hex = "ff00"
times = 3

[[fault]]
kind = "reboot"
at_s = 30.0
for_s = 4
when_slewing = true
"""


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "faults.toml"
    path.write_text(SCRIPT)
    script = read_faults(path)
    assert script.faults == (
        Fault("late", on=b":GR", delay_s=6.5),
        Fault("noise-before", on=b"\x06", data=b"\xff\x00", times=3),
        Fault("reboot", at_s=30.0, for_s=4, when_slewing=True),
    )
    assert script.chance is not None
    assert (script.chance.seed, script.chance.rate, script.chance.kinds) == (7, 0.02, ("late", "garble"))
    assert script.chance.on == b":G"
    other = read_faults(path, seed=8)
    assert other.chance is not None
    assert other.chance.seed == 8
    assert parse_faults("").faults == ()
    assert parse_faults("").chance is None


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            '[[fault]]\nkind = "nope"\n',
            "line 2: fault[0].kind: there is no such kind of fault (there is: lose, ",
        ),
        ('[[fault]]\nkind = "late"\n', "line 2: fault[0].kind: late needs delay_s (add delay_s = ...)"),
        ('[[fault]]\nkind = "reboot"\n', "reboot needs for_s"),
        (
            '\n[[fault]]\nkind = "lose"\nfoo = 1\n',
            "line 4: fault[0].foo: there is no such setting (there is: kind, ",
        ),
        (
            '[[fault]]\non = "a"\n',
            "line 1: fault[0].kind: it is required, and it is missing (add kind = ...)",
        ),
        ("[random]\nrate = 2.0\n", "line 2: random.rate: input should be less than or equal to 1"),
        ('[random]\nrate = 0.5\nkinds = ["lose", "a"]\n', "line 3: random.kinds[1]: there is no such kind"),
        ('[random]\nrate = 0.5\non = "a"\non_hex = "61"\n', "line 3: random.on: on and on_hex together"),
        ('[[fault]]\nkind = "cut"\non_hex = "3"\n', "line 3: fault[0].on_hex: "),
        ('[[fault]]\nkind = "cut"\n[[fault]]\nkind = "cut"\nskip = -1\n', "line 5: fault[1].skip: "),
        ('[[fault]]\nkind = "cut"\ndata = "a"\ndata_hex = "61"\n', "data and data_hex together"),
        ('[[fault]]\nkind = "stick"\naxis = "x"\n', "line 3: fault[0].axis: input should be 'ha' or 'dec'"),
        (
            '[[fault]]\nkind = "dead"\nfor_s = inf\n',
            "line 3: fault[0].for_s: input should be a finite number",
        ),
        ("speed = 1\n", "line 1: speed: there is no such setting (there is: random, fault)"),
        ("[[fault]\n", "this is not TOML"),
    ],
)
def test_nonsense_is_refused_with_its_line(text: str, told: str) -> None:
    with pytest.raises(BadSettings) as refusal:
        parse_faults(text, name="faults.toml")
    assert str(refusal.value).startswith("faults.toml: ")
    assert told in str(refusal.value)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadSettings, match=r"none\.toml"):
        read_faults(tmp_path / "none.toml")


FINE = st.floats(0.0, 1e6, allow_nan=False)
FAULTS = st.builds(
    Fault,
    kind=st.sampled_from(KINDS),
    on=st.binary(max_size=6),
    skip=st.integers(0, 99),
    times=st.integers(1, 99),
    # written always: the kinds that need them
    delay_s=st.floats(0.001, 1e6),
    byte=st.none() | st.integers(0, 99),
    bit=st.integers(0, 7),
    at_s=FINE,
    when_slewing=st.booleans(),
    chance=st.floats(0.001, 1.0),
    after_s=FINE,
    every_s=FINE,
    for_s=st.floats(0.001, 1e6),
    data=st.binary(max_size=6) | st.sampled_from([b'a"b', b"a\\b", b"#"]),
    axis=st.sampled_from(["ha", "dec"]),
    stops=st.integers(0, 9),
    rates=st.sampled_from(["ra", "dec", "both"]),
    # not what is left out where it isn't said: one kind needs it
    factor=st.floats(-1000.0, 1000.0).filter(lambda factor: factor != 1.0),
)


@pytest.mark.long
@given(st.lists(FAULTS, max_size=4))
def test_what_is_written_is_read_again(faults: list[Fault]) -> None:
    assert list(parse_faults(faults_as_toml(faults)).faults) == faults


def test_random_faults_come_at_their_rate_evenly_and_only_where_asked_for() -> None:
    drawn = RandomFaults(5, 0.1, on=b":G")
    met = [drawn.draw(b":GR#") for _ in range(20_000)]
    kinds = Counter(fault.kind for fault in met if fault is not None)
    assert sum(kinds.values()) == pytest.approx(2000, abs=200)
    assert set(kinds) == set(USUAL_KINDS)
    assert all(count == pytest.approx(2000 / len(USUAL_KINDS), abs=90) for count in kinds.values())
    assert all(drawn.draw(b":Q#") is None for _ in range(100))


def test_what_struck_becomes_a_script() -> None:
    late = Fault("late", on=b":G", times=0, delay_s=2.0, chance=0.5, when_slewing=True)
    gone = Fault("vanish", times=0, at_s=9.0, every_s=3.0, for_s=1.0)
    strikes = [Strike(3.0, late, b":GR#", 4), Strike(7.5, gone, b"", 0)]
    assert scripted(strikes) == [
        Fault("late", on=b":GR#", skip=4, delay_s=2.0),
        Fault("vanish", at_s=7.5, for_s=1.0),
    ]


@given(reply=st.binary(min_size=1, max_size=20), fault=FAULTS)
def test_no_fault_breaks_on_any_answer(reply: bytes, fault: Fault) -> None:
    spoiled = fault.spoil(reply)
    if fault.kind in ("garble", "scramble"):
        assert len(spoiled) == len(reply)
    if fault.kind == "garble":
        assert sum((one ^ two).bit_count() for one, two in zip(spoiled, reply, strict=True)) == 1
    if fault.kind == "cut":
        assert reply.startswith(spoiled)
        assert len(spoiled) < len(reply)


RATES_SCRIPT = """
[[fault]]
kind = "rate-factor"
factor = 15.041
rates = "ra"
for_s = 30

[[fault]]
kind = "rate-reversed"
rates = "dec"
at_s = 60
"""


def test_faults_of_rates_come_from_a_file_and_end() -> None:
    script = parse_faults(RATES_SCRIPT)
    assert parse_faults(faults_as_toml(script.faults)).faults == script.faults
    clock = FastClock(0.0)
    mechanics = Mechanics(Site(49.0, 22.0), Air(pressure_hpa=0.0), PointingErrors(), clock=clock)
    mechanics.track_beside(1.0, 0.5)
    began = clock()
    fake = FakeLx200(
        mechanics,
        faults=script.faults,
        clock=clock,
        monotonic=lambda: (clock() - began).total_seconds(),
    )
    seen = []
    for _ in range(3):
        fake.feed(b"")
        clock.on(10.0)
        ha_deg_s, dec_deg_s = mechanics.axis_velocity("ha"), mechanics.axis_velocity("dec")
        seen.append((round((SIDEREAL_DEG_S - ha_deg_s) * 3600.0, 6), round(dec_deg_s * 3600.0, 6)))
        assert mechanics.beside_arcsec_s == pytest.approx((1.0, 0.5))
        clock.on(25.0)
    assert seen == [(15.041, 0.5), (1.0, 0.5), (1.0, -0.5)]


@pytest.mark.parametrize("kind", RATE_KINDS)
def test_each_fault_of_rates_does_something(kind: str) -> None:
    fault = rate_fault(Fault(kind, factor=2.0, rates="dec"))  # type: ignore[arg-type]
    assert fault != RateFault()


def test_a_factor_must_be_given_and_be_a_number() -> None:
    with pytest.raises(BadSettings, match="rate-factor needs factor"):
        parse_faults('[[fault]]\nkind = "rate-factor"\n')
    for wrong in ("nan", "inf", "1e9", '"two"'):
        with pytest.raises(BadSettings, match="factor"):
            parse_faults(f'[[fault]]\nkind = "rate-factor"\nfactor = {wrong}\n')
    with pytest.raises(BadSettings, match="rates"):
        parse_faults('[[fault]]\nkind = "rate-ignored"\nrates = "all"\n')


def test_rate_faults_are_drawn_whole() -> None:
    chances = RandomFaults(3, 1.0, RATE_KINDS)  # type: ignore[arg-type]
    drawn = [chances.draw(b":GR#") for _ in range(300)]
    assert {fault.kind for fault in drawn if fault} == set(RATE_KINDS)
    assert {fault.rates for fault in drawn if fault and fault.kind == "rate-reversed"} == {
        "ra",
        "dec",
        "both",
    }
    assert all(fault.factor != 1.0 for fault in drawn if fault and fault.kind == "rate-factor")
