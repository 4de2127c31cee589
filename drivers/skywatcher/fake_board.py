"""What the boards of some mounts say of themselves: the numbers that a fake of each answers."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.skywatcher.rates import Gearing
from drivers.skywatcher.words import Axis, Board


@dataclass(frozen=True, slots=True)
class FakeBoard:
    """One kind of mount.

    Attributes
    ----------
    board : Board
    gears : dict of Axis to Gearing
    features : str or None
        Answer to ``:q``; None on old boards, which don't know it.
    goto_deg_s, slow_goto_deg_s, acceleration_deg_s2 : float
        Of its gotos.
    least_period : int
        Shorter step periods are taken for this.
    """

    board: Board
    gears: dict[Axis, Gearing]
    features: str | None = None
    goto_deg_s: float = 3.4
    slow_goto_deg_s: float = 0.2134
    acceleration_deg_s2: float = 2.2
    least_period: int = 6


def _both(counts: int, timer_hz: int, ratio: int) -> dict[Axis, Gearing]:
    return {axis: Gearing(counts, timer_hz, ratio) for axis in Axis}


BOARDS = {
    # numbers, speeds and firmware as an owner's HEQ5 Pro told them; an EQ6 counts alike [INDI eqmod]
    "eq6": FakeBoard(Board(2, 4, 0x00), _both(9_024_000, 64_935, 16)),
    "heq5": FakeBoard(Board(2, 4, 0x01), _both(9_024_000, 64_935, 16)),
    # counts from an owner's log, features from another's notes; timer and firmware are not checked
    "eq8": FakeBoard(Board(3, 0, 0x04), _both(11_136_000, 16_000_000, 16), "076000"),
    "az-eq6": FakeBoard(Board(3, 0, 0x05), _both(9_216_000, 16_000_000, 32), "0B3000"),
    # counts and timer as an owner's told them: the axes differ; ratio and features are not checked
    "star-adventurer-gti": FakeBoard(
        Board(3, 0x30, 0x0C),
        {
            Axis.HOUR_ANGLE: Gearing(3_628_800, 16_000_000, 1),
            Axis.DECLINATION: Gearing(2_903_040, 16_000_000, 1),
        },
        "008000",
        least_period=1,
    ),
}
