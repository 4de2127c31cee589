"""A target by LX200 is two commands: halves that don't belong together are no target; pure."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from api.planetarium import lx200_session
from api.planetarium.lx200_session import Aim, Aims, Machine
from drivers.wire.command import Unreadable

LIVES = timedelta(seconds=30)


class Clock:
    """A time of its own."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.utc = datetime(2026, 11, 22, 23, 0, tzinfo=UTC)
        monkeypatch.setattr(lx200_session, "utc_now", lambda: self.utc)

    def on(self, seconds: float) -> None:
        self.utc += timedelta(seconds=seconds)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def place(aim: Aim | Aims) -> tuple[float, float] | None:
    target = aim.target()
    return None if target is None else (target.ra_deg, target.dec_deg)


def test_a_refused_half_leaves_no_target(clock: Clock) -> None:
    """An app that sends all in one go doesn't see the 0: it must not go to a mixed place."""
    aims = Aims(Machine())
    aims.set("r", b"01:00:00")
    aims.set("d", b"+10*00:00")
    assert place(aims) == (15.0, 10.0)
    aims.set("r", b"02:00:00")
    with pytest.raises(Unreadable):
        aims.set("d", b"+95*00:00")
    assert place(aims) is None
    # nor to one that another program of its machine has set meanwhile
    other = Aims(aims.machine)
    other.set("r", b"03:00:00")
    other.set("d", b"+30*00:00")
    assert place(aims) is None
    assert place(other) == (45.0, 30.0)
    aims.set("d", b"+20*00:00")
    assert place(aims) == (30.0, 20.0)


def test_halves_set_far_apart_are_no_target(clock: Clock) -> None:
    aim = Aim()
    aim.set("r", b"01:00:00")
    aim.set("d", b"+10*00:00")
    clock.on(3600.0)
    # a connection's own stays, as on a real mount
    assert place(aim) == (15.0, 10.0)
    aim.set("d", b"+20*00:00")
    assert place(aim) is None
    aim.set("r", b"02:00:00")
    assert place(aim) == (30.0, 20.0)


def test_what_is_kept_for_a_machine_is_short_lived(clock: Clock) -> None:
    machine = Machine()
    Aims(machine).set("r", b"01:00:00")
    Aims(machine).set("d", b"-05*00:00")
    assert place(Aims(machine)) == (15.0, -5.0)
    clock.on(LIVES.total_seconds() + 1.0)
    assert place(Aims(machine)) is None


@pytest.mark.parametrize(
    ("ra", "dec", "wanted"),
    [
        (b"24:00:00", b"+20*30:00", (0.0, 20.5)),
        (b"24:00.0", b"20*30", (0.0, 20.5)),
        (b" 5:35:17", b" 20*30:00", (83.820833, 20.5)),
        (b"5:35:17.3", b"20\xdf30:00", (83.822083, 20.5)),
        (b"05:35:17", b"-20:30:00", (83.820833, -20.5)),
    ],
)
def test_what_common_apps_send_is_a_place(
    clock: Clock, ra: bytes, dec: bytes, wanted: tuple[float, float]
) -> None:
    aims = Aims(Machine())
    aims.set("r", ra)
    aims.set("d", dec)
    assert place(aims) == pytest.approx(wanted, abs=1e-5)


@pytest.mark.parametrize(
    ("half", "wire"),
    [
        *(
            ("r", one)
            for one in (b"24:00:01", b"25:00:00", b"-5:35:17", b"5", b"5:35", b"005:35:17", b"", b"5:60:00")
        ),
        *(
            ("d", one)
            for one in (b"90*00:01", b"91*00:00", b"5*30:00", b"", b"+-20*30", b"*30:00", b"020*30")
        ),
    ],
)
def test_what_is_no_place_stays_none(clock: Clock, half: str, wire: bytes) -> None:
    with pytest.raises(Unreadable):
        Aims(Machine()).set(half, wire)  # type: ignore[arg-type]
