"""Sky-Watcher motor controller commands and the readers of their replies, without any I/O [SKYWATCHER].

``:`` command axis data CR is answered ``=`` data CR or ``!`` code CR. Replies don't say what they answer, and
many are of one length, so a reader asks for the exact length and leaves the rest to the exchange (and, for
positions, to what an axis can have reached).

A board that got a question damaged says ``!1`` or ``!3``: that is no answer of the mount and is asked again.
All commands but ``:J`` may be sent twice: they set registers, and only ``:J`` starts a motor.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from drivers.skywatcher.words import (
    Axis,
    Board,
    Features,
    MotorStatus,
    Nack,
    number,
    number_text,
    ratio,
    read_board,
    read_features,
    read_status,
)
from drivers.wire.command import Command, Read, Unreadable

T = TypeVar("T")
_END = b"\r"
_LONGEST = 8


def _whole(buffer: bytes) -> tuple[bytes, str, int] | None:
    """Cut one answer off the front: its first byte, its data, its length; None while it isn't whole."""
    if buffer[:1] not in (b"", b"=", b"!"):
        raise Unreadable(f"{buffer!r} begins with neither = nor !")
    end = buffer.find(_END)
    if end < 0:
        if len(buffer) > _LONGEST:
            raise Unreadable(f"{buffer!r} is longer than any answer")
        return None
    return buffer[:1], buffer[1:end].decode("latin-1"), end + 1


def _answer(understand: Callable[[str], T]) -> Callable[[bytes, bool], Read[T] | None]:
    """Make a reader of an answer that is never refused: a board that refuses it got it damaged."""

    def read(buffer: bytes, final: bool) -> Read[T] | None:
        whole = _whole(buffer)
        if whole is None:
            return None
        kind, text, length = whole
        if kind == b"!":
            raise Unreadable(f"refused with code {text!r}")
        return Read(understand(text), length)

    return read


def _answer_or_nack(
    understand: Callable[[str], T], codes: str
) -> Callable[[bytes, bool], Read[T | Nack] | None]:
    """Make a reader of an answer or of a refusal by one of some codes."""

    def read(buffer: bytes, final: bool) -> Read[T | Nack] | None:
        whole = _whole(buffer)
        if whole is None:
            return None
        kind, text, length = whole
        if kind == b"=":
            return Read(understand(text), length)
        if len(text) != 1 or text not in codes:
            raise Unreadable(f"refused with code {text!r}")
        return Read(Nack(text), length)

    return read


def _count(smallest: int, largest: int) -> Callable[[str], int]:
    def understand(text: str) -> int:
        value = number(text)
        if not smallest <= value <= largest:
            raise Unreadable(f"{value} is not between {smallest} and {largest}")
        return value

    return understand


def _nothing(text: str) -> None:
    if text:
        raise Unreadable(f"{text!r} where nothing was expected")


def _ask(letter: str, axis: Axis, meaning: str, understand: Callable[[str], T], data: str = "") -> Command[T]:
    # a question that is refused at all arrived damaged: asked again, and nonsense in the end
    sent = f":{letter}{int(axis)}{data}\r".encode("ascii")
    return Command(sent, f"{meaning} of axis {int(axis)}", _answer(understand))


def _set(
    letter: str, axis: Axis, meaning: str, data: str = "", *, repeatable: bool = True
) -> Command[Nack | None]:
    sent = f":{letter}{int(axis)}{data}\r".encode("ascii")
    refusals = "0245678" if repeatable else "012345678"
    return Command(
        sent, f"{meaning} of axis {int(axis)}", _answer_or_nack(_nothing, refusals), repeatable=repeatable
    )


# -- questions ---------------------------------------------------------------------------------------


def board() -> Command[Board]:
    """Ask for firmware and model [SKYWATCHER :e]."""
    return _ask("e", Axis.HOUR_ANGLE, "version", read_board)


def counts_per_turn(axis: Axis) -> Command[int]:
    """Ask how many counts make one turn [SKYWATCHER :a]."""
    return _ask("a", axis, "counts per turn", _count(100_000, 0xFFFFFF))


def timer_hz(axis: Axis) -> Command[int]:
    """Ask for the frequency that step periods are counted in [SKYWATCHER :b]."""
    return _ask("b", axis, "timer frequency", _count(1_000, 0xFFFFFF))


def fast_ratio(axis: Axis) -> Command[int]:
    """Ask by how much the high speed range is faster [SKYWATCHER :g]."""
    return _ask("g", axis, "high speed ratio", ratio)


def features(axis: Axis) -> Command[Features | Nack]:
    """Ask what the board has [SKYWATCHER :q]; older boards answer ``!0``."""
    sent = f":q{int(axis)}010000\r".encode("ascii")
    return Command(sent, f"features of axis {int(axis)}", _answer_or_nack(read_features, "0123"))


def status(axis: Axis) -> Command[MotorStatus]:
    """Ask what a motor does [SKYWATCHER :f]."""
    return _ask("f", axis, "status", read_status)


def position(axis: Axis) -> Command[int]:
    """Ask for the count of an axis, 0x800000 at power-up [SKYWATCHER :j]."""
    return _ask("j", axis, "position", number)


def step_period(axis: Axis) -> Command[int]:
    """Ask for the step period in force, in ticks of the timer [SKYWATCHER :i]."""
    return _ask("i", axis, "step period", number)


def goto_target(axis: Axis) -> Command[int]:
    """Ask for the count a goto runs to [SKYWATCHER :h]."""
    return _ask("h", axis, "goto target", number)


def worm_counts(axis: Axis) -> Command[int]:
    """Ask how many counts make one turn of the worm [SKYWATCHER :s]."""
    return _ask("s", axis, "counts per turn of the worm", number)


def sidereal_period(axis: Axis) -> Command[int]:
    """Ask for the step period that the board itself takes for sidereal [SKYWATCHER :D]."""
    return _ask("D", axis, "sidereal step period", number)


# -- orders ------------------------------------------------------------------------------------------


def energize(axis: Axis) -> Command[Nack | None]:
    """Switch a motor's current on [SKYWATCHER :F]; it doesn't move, and its count stays."""
    return _set("F", axis, "energizing")


def set_position(axis: Axis, count: int) -> Command[Nack | None]:
    """Give the present place a count; only at rest [SKYWATCHER :E]."""
    return _set("E", axis, "setting the position", number_text(count))


def motion(axis: Axis, *, goto: bool, fast: bool, backward: bool) -> Command[Nack | None]:
    """Choose how it will run; refused while it runs [SKYWATCHER :G]."""
    mode = (0 if fast else 2) if goto else (3 if fast else 1)
    return _set("G", axis, "motion mode", f"{mode}{int(backward)}")


def goto_by(axis: Axis, counts: int) -> Command[Nack | None]:
    """Choose how far the next goto runs from here, in the direction of `motion` [SKYWATCHER :H]."""
    return _set("H", axis, "goto increment", number_text(counts))


def goto_to(axis: Axis, count: int) -> Command[Nack | None]:
    """Choose the count that the next goto runs to [SKYWATCHER :S]."""
    return _set("S", axis, "goto target", number_text(count))


def brake_by(axis: Axis, counts: int) -> Command[Nack | None]:
    """Choose how long before its target a goto slows down [SKYWATCHER :M]."""
    return _set("M", axis, "brake increment", number_text(counts))


def period(axis: Axis, ticks: int) -> Command[Nack | None]:
    """Set the step period; taken at once by a motor that runs slowly [SKYWATCHER :I]."""
    return _set("I", axis, "step period", number_text(ticks))


def start(axis: Axis) -> Command[Nack | None]:
    """Start a motor [SKYWATCHER :J]. The one command that must not be sent twice."""
    return _set("J", axis, "start", repeatable=False)


def slow_down(axis: Axis) -> Command[Nack | None]:
    """Stop a motor by its ramp [SKYWATCHER :K]; the answer comes long before it rests."""
    return _set("K", axis, "stop")


def stop_hard(axis: Axis) -> Command[Nack | None]:
    """Stop a motor without a ramp [SKYWATCHER :L]."""
    return _set("L", axis, "instant stop")


def hand_guide_rate(axis: Axis, step: int) -> Command[Nack | None]:
    """Set the rate of the guide port: 0 to 4 for 1, 0.75, 0.5, 0.25, 0.125 [SKYWATCHER :P]."""
    return _set("P", axis, "rate of the guide port", f"{step:X}")


# -- the path of a stop ------------------------------------------------------------------------------


def urgent(command: Command[Nack | None]) -> Command[None]:
    """Make a command whose answer is left to whoever reads next."""
    return Command(command.sent, command.meaning, lambda _buffer, _final: Read(None, 0))
