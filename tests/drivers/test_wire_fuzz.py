"""All families against their fakes in memory and in virtual time, with faults at random: the common proof.

No wrong position is published, no order is carried out twice, nothing hangs, a stop is on the wire at once.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest

from drivers.fakes.faults import USUAL_KINDS, Fault, Kind, scripted
from drivers.registry import make_fake
from mountnav.devices import SyncOutcome
from tests.drivers.virtual_wire import HandClock, VirtualLoop, in_virtual_time
from tests.drivers.wire_families import family
from tests.drivers.wire_fuzz import Findings, Rig

EVERYTHING: tuple[Kind, ...] = (
    *USUAL_KINDS,
    "deaf",
    "silence",
    "dead",
    "flood",
    "vanish",
    "hang-up",
    "black-hole",
    "deaf-start",
)
FAMILIES = [
    ("lx200", "lx200gps"),
    ("nexstar", None),
    ("synscan", None),
    ("ioptron", None),
    ("skywatcher", None),
]
IN_EVERY_RUN = (("lx200", "lx200gps"), ("skywatcher", None))
"""One of words, one of an axis controller's numbers."""


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    # each fault is a warning
    logging.disable(logging.WARNING)
    yield
    logging.disable(logging.NOTSET)


def lived(
    monkeypatch: pytest.MonkeyPatch,
    protocol: str,
    dialect: str | None,
    exchanges: int,
    seed: int,
    rate: float = 0.03,
    kinds: tuple[Kind, ...] = EVERYTHING,
    script: list[Fault] | None = None,
    *,
    contradicts: bool = False,
    follows: bool = False,
) -> tuple[Findings, Rig]:
    clock = HandClock()
    fuzzed = family(protocol, dialect)
    in_virtual_time(monkeypatch, clock)
    loop = VirtualLoop(clock)
    try:
        # its events and locks are made for this loop
        rig = Rig(fuzzed, make_fake, clock, seed, rate, kinds, contradicts=contradicts, follows=follows)
        if script is not None:
            rig.fake.faults += script
        return loop.run_until_complete(rig.live(exchanges)), rig
    finally:
        loop.close()


@pytest.mark.long
@pytest.mark.parametrize(
    ("protocol", "dialect"),
    [pytest.param(*one, marks=() if one in IN_EVERY_RUN else pytest.mark.long) for one in FAMILIES],
)
def test_nothing_wrong_in_3000_exchanges(
    protocol: str, dialect: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    # a bad cable, then everything
    cable, _ = lived(monkeypatch, protocol, dialect, 1500, 3, 0.05, USUAL_KINDS)
    monkeypatch.undo()
    worst, _ = lived(monkeypatch, protocol, dialect, 1500, 4, 0.02)
    assert cable.wrong + worst.wrong == []
    assert cable.exchanges + worst.exchanges >= 3000
    # it was no idle life
    assert cable.readings + worst.readings > 100
    assert sum(cable.struck.values()) > 50
    assert cable.outcomes["slew: arrived"] > 0
    assert set(worst.struck) & {"vanish", "hang-up", "black-hole"}


@pytest.mark.first
@pytest.mark.long
@pytest.mark.parametrize(("protocol", "dialect"), FAMILIES)
def test_nothing_wrong_in_20_000_exchanges(
    protocol: str, dialect: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    exchanges, wrong = 0, []
    # several lives, of bad cables and of everything; `benchmarks.contradicting_mounts --honest` lives ten
    for seed in range(100, 102):
        rate, kinds = (0.05, USUAL_KINDS) if seed % 2 else (0.02, EVERYTHING)
        findings, _ = lived(monkeypatch, protocol, dialect, 10_000, seed, rate, kinds)
        monkeypatch.undo()
        exchanges += findings.exchanges
        wrong += [f"seed {seed}: {what}" for what in findings.wrong]
    assert wrong == []
    assert exchanges >= 20_000


CONTRADICTING = [*FAMILIES, ("lx200", "onstep"), ("lx200", "10micron"), ("lx200", "am5")]
A_LIFE = 10_000
"""Exchanges of a whole one; `benchmarks.contradicting_mounts` lives ten of each."""

CONTRADICTING_SEED = 203


@pytest.mark.parametrize(
    ("protocol", "dialect", "exchanges"),
    [
        pytest.param("lx200", "onstep", 2000, id="short"),
        *(
            pytest.param(*one, A_LIFE, marks=pytest.mark.long, id="-".join(filter(None, one)))
            for one in CONTRADICTING
        ),
    ],
)
def test_a_mount_that_contradicts_itself_is_never_believed(
    protocol: str, dialect: str | None, exchanges: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    life, rig = lived(
        monkeypatch, protocol, dialect, exchanges, CONTRADICTING_SEED, 0.02, USUAL_KINDS, contradicts=True
    )
    assert life.wrong == []
    assert life.exchanges >= exchanges
    # what it is about was met
    assert rig.mechanics.boots > 0
    assert life.outcomes["slew: arrived"] > 0
    if rig.family.syncs:
        assert life.outcomes[f"sync: {SyncOutcome.ELSEWHERE}"] > 0


FOLLOWING = [("lx200", "onstep"), ("ioptron", None), ("skywatcher", None), ("nexstar", None)]


@pytest.mark.parametrize(
    ("protocol", "dialect"),
    [pytest.param(*one, marks=() if one[1] == "onstep" else pytest.mark.long) for one in FOLLOWING],
)
@pytest.mark.parametrize("seed", [303, pytest.param(304, marks=pytest.mark.long)])
def test_rates_and_moved_axes_on_bad_wires(
    protocol: str, dialect: str | None, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rates that were accepted are kept; an axis that was told to end has ended; nothing hangs."""
    kinds = USUAL_KINDS if seed % 2 else EVERYTHING
    life, _ = lived(monkeypatch, protocol, dialect, 2500, seed, 0.03, kinds, follows=True)
    assert life.wrong == []
    assert life.outcomes["rates: done"] > 5
    assert life.outcomes["move: done"] > 2


@pytest.mark.long
def test_the_same_seed_is_the_same_life() -> None:
    def life() -> tuple[list[bytes], Rig]:
        with pytest.MonkeyPatch.context() as patched:
            _, rig = lived(patched, "nexstar", None, 1500, 5, 0.05)
        return list(rig.fake.heard), rig

    heard, rig = life()
    again, _ = life()
    assert again == heard
    assert len(rig.fake.strikes) > 30


@pytest.mark.long
def test_what_struck_strikes_again_from_its_script() -> None:
    with pytest.MonkeyPatch.context() as patched:
        _, rig = lived(patched, "ioptron", None, 1500, 5)
    with pytest.MonkeyPatch.context() as patched:
        _, again = lived(patched, "ioptron", None, 1500, 5, rate=0.0, script=scripted(rig.fake.strikes))
    assert again.fake.heard == rig.fake.heard
