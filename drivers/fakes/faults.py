"""What can go wrong on the wire and behind it: scripted in tests, read from a file, or drawn at random.

A file of faults has a script and a random part::

    [random]
    seed = 7
    rate = 0.02
    kinds = ["late", "garble"]

    [[fault]]
    kind = "late"
    on = ":GR"            # or on_hex = "3a4752"
    delay_s = 6.5
"""

from __future__ import annotations

import json
import random
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mountnav.errors import BadSettings
from mountnav.files import read_text
from mountnav.parsing import toml_of
from mountnav.settings.explained import line_of
from mountnav.simulation.mechanics import Mechanics, SyncBehavior
from mountnav.simulation.rate_faults import RateFault

AnswerKind = Literal[
    "lose",
    "late",
    "cut",
    "double",
    "garble",
    "scramble",
    "noise-before",
    "noise-after",
    "dribble",
    "deaf",
    "deny",
]
"""Faults of the answer to one command."""

MountKind = Literal[
    "silence",
    "dead",
    "flood",
    "reboot",
    "sync-ignored",
    "sync-refused",
    "sync-late",
    "sync-half",
    "sync-elsewhere",
    "stick",
    "run-away",
    "deaf-start",
    "reset-by-opening",
    "rate-reversed",
    "rate-factor",
    "rate-swapped",
    "rate-ignored",
    "rate-dropped",
    "rate-forgotten",
    "rate-lost-at-flip",
    "rate-unturned",
]
"""Faults of the mount as a whole."""

OpeningKind = Literal["deaf-start", "reset-by-opening"]
"""Those of them that strike each time the port is opened."""

LineKind = Literal["vanish", "hang-up", "reset", "black-hole"]
"""Faults of the line; `drivers.fakes.bench` carries them out."""

Kind = Literal[AnswerKind, MountKind, LineKind]
ANSWER_KINDS: tuple[str, ...] = get_args(AnswerKind)
MOUNT_KINDS: tuple[str, ...] = get_args(MountKind)
LINE_KINDS: tuple[str, ...] = get_args(LineKind)
OPENING_KINDS: tuple[str, ...] = get_args(OpeningKind)
RATE_KINDS = tuple(kind for kind in MOUNT_KINDS if kind.startswith("rate-"))
"""Those of them that spoil rates beside the sidereal one."""
KINDS = ANSWER_KINDS + MOUNT_KINDS + LINE_KINDS
"""All kinds of faults, in the order in which messages name them."""


@dataclass(slots=True)
class Fault:
    """One thing that goes wrong, and when.

    Attributes
    ----------
    kind : str
        To the answer of one command: ``lose``: carried out, no answer. ``late``: the answer (and all after
        it) comes `delay_s` later. ``cut``: only its first `byte` bytes come, half of it by default.
        ``double``: it comes twice. ``garble``: one bit flips. ``scramble``: `data` overwrites it from `byte`
        on. ``noise-before``, ``noise-after``: `data` comes as well. ``dribble``: its bytes come `delay_s`
        apart. ``deaf``: answered, but not carried out. ``deny``: carried out, and answered by a refusal,
        where the family has words for one (or by `data`).
        To the mount: ``silence``: for `for_s` it says nothing, but carries out what it hears. ``dead``: for
        `for_s` it neither hears nor speaks. ``flood``: for `for_s` it sends `data` unasked, every `delay_s`.
        ``reboot``: it forgets, and is dead for `for_s`. ``sync-ignored``, ``sync-refused``, ``sync-late``
        (after `delay_s`), ``sync-half`` (the declination alone), ``sync-elsewhere`` (another place): what
        becomes of the syncs for `for_s`. ``stick``: an `axis` no longer moves, for
        `for_s`. ``run-away``: for `for_s`, slews of an `axis` go on past their target, until a stop.
        ``deaf-start``: for `for_s` after its port was opened it neither hears nor speaks, as a network
        adapter that makes its connection. ``reset-by-opening``: it forgets as well, as an Arduino that DTR
        resets. Both each time the port is opened, `times` times; on TCP and in memory, for a
        pseudo-terminal doesn't tell when it is opened.
        To rates beside the sidereal one, for `for_s`, those in force as well (read back they are as ordered):
        ``rate-reversed``: the wrong way; ``rate-factor``: times `factor`, as with a wrong unit;
        ``rate-ignored``: not kept at all (all three: of `rates`). ``rate-swapped``: each axis takes the
        other's. ``rate-dropped``: not kept, and zero when they are read back. ``rate-forgotten``: kept until
        the next slew. ``rate-lost-at-flip``: kept until it changes sides. ``rate-unturned``: in declination
        the wrong way on the west side of the pier.
        To the line: ``vanish``: the port is gone for `for_s` and comes back under another name. ``hang-up``:
        the other end closes. ``reset``: it breaks off hard. ``black-hole``: for `for_s` the port can be
        opened, and nothing comes.
    on : bytes
        Commands that begin so; empty means all. A fault of the mount or the line with an empty one doesn't
        wait for a command, it comes by itself.
    skip : int
        How many of them go well before; counted down.
    times : int
        How many go wrong then; counted down.
    delay_s : float
        See the kinds.
    byte : int or None
        Which byte of the answer, counted round and round.
    bit : int
        For ``garble``.
    at_s : float
        Not before this time, counted from the making of the fake.
    when_slewing : bool
        Only while the mount slews.
    chance : float
        With this probability each time all else is right.
    after_s : float
        Faults of mount and line come so long after what brings them on.
    every_s : float
        Faults that come by themselves come again after this time, as often as `times` says.
    for_s : float
        How long it lasts; for ever where it is not said (a reboot: no time at all).
    data : bytes
        See the kinds; drawn at random where it is empty and needed.
    axis : {"ha", "dec"}
        For ``stick`` and ``run-away``.
    stops : int
        For ``run-away``: so many stops are not heeded.
    rates : {"ra", "dec", "both"}
        Which rates ``rate-reversed``, ``rate-factor`` and ``rate-ignored`` are about.
    factor : float
        For ``rate-factor``: what is kept, over what was ordered. 15.04 and 0.0665 are seconds for seconds of
        arc, 1.0027 a sidereal second for a second, 220 a gear's factor.
    """

    kind: Kind
    on: bytes = b""
    skip: int = 0
    times: int = 1
    delay_s: float = 0.0
    byte: int | None = None
    bit: int = 6
    at_s: float = 0.0
    when_slewing: bool = False
    chance: float = 1.0
    after_s: float = 0.0
    every_s: float = 0.0
    for_s: float | None = None
    data: bytes = b""
    axis: Literal["ha", "dec"] = "ha"
    stops: int = 0
    rates: Literal["ra", "dec", "both"] = "both"
    factor: float = 1.0

    @property
    def spoils_answers(self) -> bool:
        """Whether it is a fault of answers, not of the mount or the line."""
        return self.kind in ANSWER_KINDS

    @property
    def by_itself(self) -> bool:
        """Whether it strikes without a command."""
        return not self.on and not self.spoils_answers and not self.by_opening

    @property
    def by_opening(self) -> bool:
        """Whether it strikes when the port is opened."""
        return self.kind in OPENING_KINDS

    def strikes(
        self,
        command: bytes,
        *,
        t_s: float = float("inf"),
        slewing: bool = False,
        chances: random.Random | None = None,
    ) -> bool:
        """Whether one command is to go wrong; `skip` and `times` are counted down.

        Parameters
        ----------
        t_s : float
            Since the making of the fake.
        chances : random.Random, optional
            For `chance`.
        """
        if self.by_itself or self.by_opening or self.times <= 0 or not command.startswith(self.on):
            return False
        if t_s < self.at_s or (self.when_slewing and not slewing):
            return False
        if self.skip > 0:
            self.skip -= 1
            return False
        if self.chance < 1.0 and (chances is None or chances.random() >= self.chance):
            return False
        self.times -= 1
        return True

    def comes(self, t_s: float, *, slewing: bool, chances: random.Random) -> bool:
        """Whether it strikes without a command now; `times` is counted down."""
        if not self.by_itself or self.times <= 0 or t_s < self.at_s:
            return False
        if self.when_slewing and not slewing:
            return False
        self.times -= 1
        self.at_s = t_s + self.every_s
        return self.chance >= 1.0 or chances.random() < self.chance

    def complete(self, chances: random.Random) -> Fault:
        """A copy with its random parts drawn."""
        if self.data or self.kind not in ("scramble", "noise-before", "noise-after", "flood"):
            return replace(self)
        return replace(self, data=chances.randbytes(chances.randint(1, 6)))

    def spoil(self, reply: bytes) -> bytes:
        """What is left of an answer; `reply` is not empty."""
        place = (self.byte or 0) % len(reply)
        match self.kind:
            case "lose":
                return b""
            case "cut":
                return reply[: len(reply) // 2 if self.byte is None else place]
            case "double":
                return reply * 2
            case "garble":
                return reply[:place] + bytes([reply[place] ^ (1 << self.bit)]) + reply[place + 1 :]
            case "scramble":
                return (reply[:place] + self.data)[: len(reply)] + reply[place + len(self.data) :]
            case "noise-before":
                return self.data + reply
            case "noise-after":
                return reply + self.data
            case _:
                return reply


@dataclass(frozen=True, slots=True)
class LineOrder:
    """What a fault wants done to the line, and for how long (s); `kind` is one of `LINE_KINDS`."""

    kind: str
    for_s: float | None


@dataclass(frozen=True, slots=True)
class Strike:
    """A fault that has struck.

    Attributes
    ----------
    t_s : float
        Since the making of the fake.
    fault : Fault
        With its random parts drawn.
    command : bytes
        The command that it struck on; empty when it struck without one.
    earlier : int
        How many commands that begin like it had been heard before.
    """

    t_s: float
    fault: Fault
    command: bytes
    earlier: int

    def scripted(self) -> Fault:
        """The same fault, made to strike at exactly this command or time."""
        fault = replace(self.fault, times=1, chance=1.0, when_slewing=False, every_s=0.0)
        if self.command:
            return replace(fault, on=self.command, skip=self.earlier, at_s=0.0)
        return replace(fault, on=b"", at_s=self.t_s, after_s=0.0)


def scripted(strikes: Iterable[Strike]) -> list[Fault]:
    """Turn what has struck into a script that repeats it, as far as the driver asks the same questions."""
    return [strike.scripted() for strike in strikes]


USUAL_KINDS: tuple[Kind, ...] = (
    "lose",
    "late",
    "cut",
    "double",
    "garble",
    "scramble",
    "noise-before",
    "noise-after",
    "dribble",
)
"""The faults of a bad cable."""

_PIECES = 50.0
"""Delays between single bytes are drawn so many times shorter than those of whole answers: an answer has some
20 bytes, so that it still comes within a try. Halved or doubled, fewer or more dribbling answers count as
lost."""
_MOST_BYTE = 1000
"""Which byte is hit is drawn below this, and counted round and round: much longer than any answer, so that
all bytes are hit alike. Changed, seeds draw other faults."""


class RandomFaults:
    """Faults drawn at random, one draw for each command.

    Parameters
    ----------
    seed : int
        The same commands then meet the same faults.
    rate : float
        Probability for each command, 0..1.
    kinds : sequence of str
        One of these, with equal probability.
    on : bytes
        Only commands that begin like this.
    longest_s : float
        Delays and durations are drawn up to this.
    """

    def __init__(
        self,
        seed: int,
        rate: float,
        kinds: Iterable[Kind] = USUAL_KINDS,
        *,
        on: bytes = b"",
        longest_s: float = 2.0,
    ) -> None:
        self.seed, self.rate, self.kinds = seed, rate, tuple(kinds)
        self.on, self.longest_s = on, longest_s
        self._chances = random.Random(seed)

    def draw(self, command: bytes) -> Fault | None:
        """The fault that strikes a command; None for none."""
        chances = self._chances
        if not command.startswith(self.on) or chances.random() >= self.rate:
            return None
        kind = chances.choice(self.kinds)
        delay_s = chances.uniform(0.0, self.longest_s)
        return Fault(
            kind,
            on=command,
            delay_s=delay_s / _PIECES if kind in ("dribble", "flood") else delay_s,
            for_s=chances.uniform(0.0, self.longest_s),
            byte=chances.randrange(_MOST_BYTE),
            bit=chances.randrange(8),
            # a refusal is in the family's own words
            data=b"" if kind == "deny" else chances.randbytes(chances.randint(1, 6)),
            axis=chances.choice(("ha", "dec")),
            # drawn where it is needed only, so that seeds draw other faults as before
            rates=chances.choice(("ra", "dec", "both")) if kind in _SOME_RATES else "both",
            factor=chances.choice(_FACTORS) if kind == "rate-factor" else 1.0,
        )


_SYNC_BEHAVIORS: dict[str, SyncBehavior] = {
    "sync-ignored": "ignore",
    "sync-refused": "refuse",
    "sync-late": "late",
    "sync-half": "dec-only",
    "sync-elsewhere": "elsewhere",
}
"""How the mechanics treat syncs, by the kind of a fault."""


_SOME_RATES = {"rate-reversed": -1.0, "rate-factor": None, "rate-ignored": 0.0}
"""Faults of one rate or both, and what is kept, over what was ordered; None where the fault says it."""

_FACTORS = (15.041, 1.0 / 15.041, 1.0027379, 1.0 / 1.0027379, 2.0, 0.5, 220.0)
"""Factors to be drawn: those of units that are taken for each other, and of wrong gears [ASCOMPlatform 64,
GSServer 41, INDI 2132]. Changed, seeds draw other faults."""


def rate_fault(fault: Fault) -> RateFault:
    """What a fault of rates does to them."""
    if fault.kind in _SOME_RATES:
        kept = _SOME_RATES[fault.kind]
        kept = fault.factor if kept is None else kept
        return RateFault(
            ra_factor=1.0 if fault.rates == "dec" else kept, dec_factor=1.0 if fault.rates == "ra" else kept
        )
    return {
        "rate-swapped": RateFault(swapped=True),
        "rate-dropped": RateFault(ra_factor=0.0, dec_factor=0.0, reads_zero=True),
        "rate-forgotten": RateFault(lost_by_slew=True),
        "rate-lost-at-flip": RateFault(lost_by_flip=True),
        "rate-unturned": RateFault(unturned=True),
    }[fault.kind]


def strike_mechanics(mechanics: Mechanics, fault: Fault) -> Callable[[], None]:
    """Start a fault of the mount itself, and return the function that ends it."""
    if fault.kind in RATE_KINDS:
        return mechanics.fail_rates(rate_fault(fault))
    if fault.kind == "stick":
        mechanics.stick(fault.axis)
        return lambda: mechanics.unstick(fault.axis)
    if fault.kind == "run-away":
        mechanics.run_away(fault.axis, deaf_stops=fault.stops)
        return lambda: mechanics.run_away(fault.axis, past_target=False)
    mechanics.sync_behavior = _SYNC_BEHAVIORS[fault.kind]
    if fault.kind == "sync-late":
        mechanics.sync_late_s = fault.delay_s

    def usual() -> None:
        mechanics.sync_behavior = "normal"

    return usual


_Hex = Annotated[str | None, Field(pattern=r"^([0-9a-fA-F]{2})*$")]
_Seconds = Annotated[float, Field(ge=0.0)]
_BYTES = ("on", "data")
"""Fields of bytes; a file gives them as text or, with `_hex` at the end of their name, in hexadecimal."""
_NEEDS = {
    "late": ("delay_s",),
    "dribble": ("delay_s",),
    "sync-late": ("delay_s",),
    "black-hole": ("for_s",),
    "reboot": ("for_s",),
    "rate-factor": ("factor",),
}
"""Keys that a kind needs: without them it would be no fault, or never end."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class _FaultTable(_Table):
    """`[[fault]]`: the attributes of a `Fault`; bytes as text (Latin-1) or in hexadecimal."""

    kind: Kind
    on: str | None = None
    on_hex: _Hex = None
    skip: int = Field(default=0, ge=0)
    times: int = Field(default=1, ge=1)
    delay_s: _Seconds = 0.0
    byte: int | None = Field(default=None, ge=0)
    bit: int = Field(default=6, ge=0, le=7)
    at_s: _Seconds = 0.0
    when_slewing: bool = False
    chance: float = Field(default=1.0, gt=0.0, le=1.0)
    after_s: _Seconds = 0.0
    every_s: _Seconds = 0.0
    for_s: Annotated[float | None, Field(gt=0.0)] = None
    data: str | None = None
    data_hex: _Hex = None
    axis: Literal["ha", "dec"] = "ha"
    stops: int = Field(default=0, ge=0)
    rates: Literal["ra", "dec", "both"] = "both"
    factor: Annotated[float, Field(ge=-1000.0, le=1000.0)] = 1.0


class _RandomTable(_Table):
    """`[random]`: what `RandomFaults` takes."""

    seed: int = 0
    rate: float = Field(ge=0.0, le=1.0)
    kinds: Annotated[list[Kind], Field(min_length=1)] = list(USUAL_KINDS)
    on: str | None = None
    on_hex: _Hex = None
    longest_s: float = Field(default=2.0, gt=0.0)


class _File(_Table):
    random: _RandomTable | None = None
    fault: list[_FaultTable] = []


@dataclass(frozen=True, slots=True)
class FaultScript:
    """The content of a faults file."""

    faults: tuple[Fault, ...] = ()
    chance: RandomFaults | None = None


def read_faults(path: Path | str, *, seed: int | None = None) -> FaultScript:
    """Read a faults file.

    Parameters
    ----------
    seed : int, optional
        Replaces the one in the file.

    Raises
    ------
    BadSettings
        If it can't be read or is wrong: with the line and what is allowed.
    """
    try:
        text = read_text(Path(path))
    except (OSError, UnicodeDecodeError) as cause:
        raise BadSettings(f"the faults can't be read: {cause}", device=str(path)) from cause
    return parse_faults(text, name=str(path), seed=seed)


def parse_faults(text: str, *, name: str = "faults", seed: int | None = None) -> FaultScript:
    """Read faults from TOML text; `name` is used in messages. Raises `BadSettings`."""
    try:
        data = toml_of(text)
    except tomllib.TOMLDecodeError as cause:
        raise BadSettings(f"this is not TOML: {cause}", device=name) from cause
    try:
        file = _File.model_validate(data)
    except ValidationError as cause:
        detail = cause.errors(include_url=False)[0]
        raise _wrong(
            text, name, detail["loc"], *_explained(detail["type"], detail["msg"], detail["loc"])
        ) from cause
    faults = []
    for number, table in enumerate(file.fault):
        _check(table, text, name, number)
        faults.append(_fault(table))
    return FaultScript(tuple(faults), _random(file.random, text, name, seed))


def _check(table: _FaultTable, text: str, name: str, number: int) -> None:
    given = table.model_fields_set
    for key in _BYTES:
        if {key, f"{key}_hex"} <= given:
            raise _wrong(
                text, name, ("fault", number, key), f"{key} and {key}_hex together", "give one of them"
            )
    missing = [key for key in _NEEDS.get(table.kind, ()) if key not in given]
    if missing:
        raise _wrong(
            text,
            name,
            ("fault", number, "kind"),
            f"{table.kind} needs {missing[0]}",
            f"add {missing[0]} = ...",
        )


def _fault(table: _FaultTable) -> Fault:
    values = {key: value for key, value in table.model_dump().items() if key in _PLAIN}
    return Fault(**values, on=_bytes(table.on, table.on_hex), data=_bytes(table.data, table.data_hex))


def _random(table: _RandomTable | None, text: str, name: str, seed: int | None) -> RandomFaults | None:
    if table is None:
        return None
    if table.on is not None and table.on_hex is not None:
        raise _wrong(text, name, ("random", "on"), "on and on_hex together", "give one of them")
    return RandomFaults(
        table.seed if seed is None else seed,
        table.rate,
        table.kinds,
        on=_bytes(table.on, table.on_hex),
        longest_s=table.longest_s,
    )


def _bytes(text: str | None, digits: str | None) -> bytes:
    return bytes.fromhex(digits) if digits is not None else (text or "").encode("latin-1", "replace")


def _explained(kind: str, message: str, loc: tuple[str | int, ...]) -> tuple[str, str]:
    key = str(loc[-1]) if loc else ""
    if kind == "extra_forbidden":
        tables: dict[str, type[_Table]] = {"random": _RandomTable, "fault": _FaultTable}
        known = tables.get(str(loc[0]) if len(loc) > 1 else "", _File)
        return "there is no such setting", f"there is: {', '.join(known.model_fields)}"
    if kind == "missing":
        return "it is required, and it is missing", f"add {key} = ..."
    if kind == "literal_error" and key not in ("axis", "rates"):
        return "there is no such kind of fault", f"there is: {', '.join(KINDS)}"
    return message[:1].lower() + message[1:], f"change {key}"


def _wrong(text: str, name: str, loc: tuple[str | int, ...], what: str, fix: str) -> BadSettings:
    line = line_of(text, loc)
    dotted = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc).lstrip(".")
    return BadSettings(f"{f'line {line}: ' if line else ''}{dotted}: {what}", device=name, advice=fix)


_DEFAULTS = Fault("lose")
"""A fault with the default of each field; what equals it is not written."""
_PLAIN = tuple(field.name for field in fields(Fault) if field.name not in _BYTES)


def faults_as_toml(faults: Iterable[Fault]) -> str:
    """Write faults as a file for `read_faults`; bytes as text where they are printable."""
    return "\n".join(_table_of(fault) for fault in faults)


def _table_of(fault: Fault) -> str:
    lines = ["[[fault]]"]
    for field in fields(Fault):
        value: Any = getattr(fault, field.name)
        if field.name != "kind" and value == getattr(_DEFAULTS, field.name):
            continue
        name = field.name
        if isinstance(value, bytes):
            if all(0x20 <= byte < 0x7F for byte in value):
                value = value.decode("ascii")
            else:
                name, value = f"{name}_hex", value.hex()
        # strings, numbers and booleans are written alike in JSON and TOML
        lines.append(f"{name} = {json.dumps(value)}")
    return "\n".join(lines) + "\n"
