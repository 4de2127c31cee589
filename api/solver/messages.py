"""What the service and its solving process send each other: each message with its length before it.

Questions are pickles: they come from the service, which its process obeys in any case. Pixels and uploads
don't go through the socket: they lie in a file without a name (`memfd_create`, or the upload's spool),
whose descriptor is sent along.

Answers are data: JSON with the arrays behind it, read by the types we expect. The process reads strangers'
files. If one of them should take it over, its answers must not take over the service: no pickle comes back,
nothing is made but the classes named here, and no answer is longer than `MOST_BYTES`. An answer is a length
(`<I`), as much JSON, and the arrays' bytes one after the other.
"""

from __future__ import annotations

import builtins
import collections.abc
import dataclasses
import json
import math
import pickle
import socket
import struct
import types
import typing
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from api.solver.limits import Limits
from mountnav import errors
from mountnav.catalog.stars import Catalog
from mountnav.frames import Frame, Hint
from mountnav.reading.star_lists import ListFormat
from mountnav.solution import Verdict
from mountnav.solving.settings import SolveSettings

if TYPE_CHECKING:
    from mountnav.measuring.calibration import Calibration


MOST_BYTES = 64 << 20
"""Longest answer. A verdict with 10,000 pairs takes 1.5 MB; doubled, a rogue process costs twice as much."""

_MOST_TEXT = 20_000
"""Characters of an error's text or of a note that are carried over; a traceback has a few thousand."""

_LENGTH = struct.Struct("<I")
_ALIAS: tuple[type[Any], ...] = tuple(
    one for one in (getattr(typing, "TypeAliasType", None),) if one is not None
)
"""Aliases of types; Python 3.11 has none."""
_ERRORS: dict[str, type[errors.MountnavError]] = {
    name: one
    for name, one in vars(errors).items()
    if isinstance(one, type) and issubclass(one, errors.MountnavError)
}
_PLAIN_ERRORS: dict[str, type[Exception]] = {
    name: one
    for name, one in vars(builtins).items()
    if isinstance(one, type)
    and issubclass(one, Exception)
    and not issubclass(one, (UnicodeError, ExceptionGroup, StopIteration, StopAsyncIteration, Warning))
}


class BadAnswer(ValueError):
    """What came back is no answer."""


@dataclass(frozen=True, slots=True)
class Ready:
    """The process solved a frame of its own, and will not be slower from now on."""

    started_s: float
    troubles: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Fault:
    """An error as it is carried over: by name, and made from that there.

    Attributes
    ----------
    kind : str
        The class: one of ours, or one of Python's own; any other arrives as a RuntimeError.
    device, advice : str or None
        Of one of ours.
    notes : tuple of str
        Where it happened.
    """

    kind: str
    what: str
    device: str | None = None
    advice: str | None = None
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, error: Exception) -> Fault:
        """Describe an error."""
        kind = type(error).__name__
        notes = tuple(str(note)[:_MOST_TEXT] for note in getattr(error, "__notes__", ()))
        if isinstance(error, errors.MountnavError) and _ERRORS.get(kind) is type(error):
            return cls(kind, str(error.what)[:_MOST_TEXT], error.device, error.advice, notes)
        if _PLAIN_ERRORS.get(kind) is type(error):
            return cls(kind, str(error)[:_MOST_TEXT], notes=notes)
        return cls("RuntimeError", f"{kind}: {error}"[:_MOST_TEXT], notes=notes)

    def error(self) -> Exception:
        """Make the error."""
        ours = _ERRORS.get(self.kind)
        error: Exception
        if ours is not None:
            error = ours(self.what, device=self.device, advice=self.advice)
        else:
            error = _PLAIN_ERRORS.get(self.kind, RuntimeError)(self.what)
        for note in self.notes:
            error.add_note(note)
        return error


@dataclass(frozen=True, slots=True)
class Done:
    """What became of a task: a verdict, a frame that was read, or the error that was raised.

    Attributes
    ----------
    frame : Frame or None
        With an empty array for pixels; these lie in the file that came along with the order to read.
    dtype : str
        Of those pixels.
    grown_mb : float
        Memory that the process holds since it is warm, now that the task is done.
    """

    verdict: Verdict | None = None
    frame: Frame | None = None
    dtype: str = ""
    shape: tuple[int, ...] = ()
    fault: Fault | None = None
    grown_mb: float = 0.0


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the index is built, 0 to 1."""

    share: float


@dataclass(frozen=True, slots=True)
class Built:
    """The index lies there now."""

    path: Path


@dataclass(frozen=True, slots=True)
class Relayed:
    """What came of a frame that was sent to a cluster.

    Attributes
    ----------
    number : int
        Of the frame.
    done : Done or None
        The answer; None: there is none, and `trouble` says why.
    """

    number: int
    done: Done | None = None
    trouble: str = ""


@dataclass(frozen=True, slots=True)
class ClusterSeen:
    """How the cluster is seen: so many workers that may be asked; or why none can be."""

    workers: int
    trouble: str = ""


Answer = Ready | Done | Progress | Built | Relayed | ClusterSeen
_KINDS: dict[str, type[Any]] = {
    one.__name__: one for one in (Ready, Done, Progress, Built, Relayed, ClusterSeen)
}


def written(answer: Answer) -> bytes:
    """Write an answer down.

    Raises
    ------
    TypeError
        It holds something that has no place in an answer: a mistake of ours.
    """
    arrays: list[bytes] = []
    plain = {"kind": type(answer).__name__, "is": _plain(answer, arrays)}
    text = json.dumps(plain, separators=(",", ":")).encode()
    return b"".join((_LENGTH.pack(len(text)), text, *arrays))


def read(content: bytes | bytearray) -> Answer:
    """Read an answer; whatever the bytes are, nothing else can come of them.

    Raises
    ------
    BadAnswer
    """
    try:
        (length,) = _LENGTH.unpack_from(content)
        text, arrays = content[_LENGTH.size : _LENGTH.size + length], content[_LENGTH.size + length :]
        plain = json.loads(text)
        kind = _KINDS[plain["kind"]]
        made = _made(plain["is"], kind, memoryview(arrays))
    except BadAnswer:
        raise
    except (struct.error, ValueError, TypeError, KeyError, OverflowError, RecursionError) as fault:
        raise BadAnswer(f"{type(fault).__name__}: {fault}") from fault
    assert isinstance(made, (Ready, Done, Progress, Built, Relayed, ClusterSeen))
    return made


def _plain(value: object, arrays: list[bytes]) -> Any:
    """The value in JSON's own kinds; arrays are put aside."""
    if type(value) in _SCALARS:
        return value  # nearly all of a header's cards, and by far the most values of an answer
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biuf":
            raise TypeError(f"arrays of {value.dtype} can't be part of an answer")
        at = sum(map(len, arrays))
        whole = np.ascontiguousarray(value, value.dtype.newbyteorder("<"))
        arrays.append(whole.tobytes())
        return [whole.dtype.str, list(whole.shape), at]
    if isinstance(value, np.generic):
        return _plain(value.item(), arrays)
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (tuple, list)):
        return [_plain(one, arrays) for one in value]
    if isinstance(value, collections.abc.Mapping):
        return {str(key): _plain(one, arrays) for key, one in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name), arrays) for field in dataclasses.fields(value)}
    raise TypeError(f"{type(value).__name__} can't be part of an answer")


_SCALARS = frozenset({str, int, float, bool, type(None)})


@cache
def _hints(kind: type[Any]) -> dict[str, Any]:
    """The fields that a class of ours is made with, by name, and their types."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind) if field.init}


def _made(value: Any, kind: Any, arrays: memoryview) -> Any:
    """Make what the type says of what came; anything else is a BadAnswer."""
    if kind is type(value) and kind in _SCALARS:
        return value
    kind = _unaliased(kind)
    origin = get_origin(kind)
    if origin is np.ndarray:
        return _array(value, kind, arrays)
    if origin in (Union, types.UnionType):
        return _one_of(value, get_args(kind), arrays)
    if origin is tuple:
        return _tuple(_checked(value, list), get_args(kind), arrays)
    if origin in (dict, collections.abc.Mapping):
        of = get_args(kind)[1]
        return {key: _made(one, of, arrays) for key, one in _checked(value, dict).items()}
    if kind is type(None):
        return _checked(value, type(None))
    if kind is float:
        return float(value) if type(value) is int else _checked(value, float)
    if kind in (bool, int, str):
        return _checked(value, kind)
    if kind is datetime:
        return datetime.fromisoformat(_checked(value, str))
    if kind is Path:
        return Path(_checked(value, str))
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return kind(_checked(value, str))
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        hints = _hints(kind)
        fields = _checked(value, dict)
        if set(fields) != set(hints):
            raise BadAnswer(f"{kind.__name__} has not the fields {sorted(set(fields) ^ set(hints))}")
        return kind(**{name: _made(one, hints[name], arrays) for name, one in fields.items()})
    raise BadAnswer(f"nothing is known of {kind}")


def _unaliased(kind: Any) -> Any:
    """What a type alias stands for: numpy's `NDArray[...]` is one from Python 3.12 on."""
    while isinstance(alias := get_origin(kind) or kind, _ALIAS):
        kind = alias.__value__[args] if (args := get_args(kind)) else alias.__value__
    return kind


def _checked(value: Any, kind: type[Any]) -> Any:
    if type(value) is not kind:
        raise BadAnswer(f"{kind.__name__} was expected, {type(value).__name__} came")
    return value


def _one_of(value: Any, kinds: tuple[Any, ...], arrays: memoryview) -> Any:
    if type(value) in _SCALARS and type(value) in kinds:
        return value
    # a whole number is also a float: the exact kind goes first, so that cards stay what they were
    for kind in sorted(kinds, key=lambda one: one is not type(value)):
        try:
            return _made(value, kind, arrays)
        except (BadAnswer, ValueError):
            continue
    raise BadAnswer(f"{type(value).__name__} is not one of the expected types")


def _tuple(values: list[Any], kinds: tuple[Any, ...], arrays: memoryview) -> tuple[Any, ...]:
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        return tuple(_made(one, kinds[0], arrays) for one in values)
    if len(values) != len(kinds):
        raise BadAnswer(f"{len(kinds)} values were expected, {len(values)} came")
    return tuple(_made(one, kind, arrays) for one, kind in zip(values, kinds, strict=True))


def _array(value: Any, kind: Any, arrays: memoryview) -> NDArray[np.generic]:
    told, sides, at = _checked(value, list)
    dtype = np.dtype(_checked(told, str))
    wanted = get_args(get_args(kind)[1])[0]
    kept = dtype if wanted is np.generic else np.dtype(wanted)
    if dtype.kind not in "biuf" or not np.can_cast(dtype, kept, "same_kind"):
        raise BadAnswer(f"an array of {dtype} is none of {kept}")
    shape = tuple(_checked(side, int) for side in _checked(sides, list))
    count = math.prod(shape)
    if min(shape, default=0) < 0 or not 0 <= _checked(at, int) <= len(arrays) - count * dtype.itemsize:
        raise BadAnswer(f"an array of {shape} at {at} is not there")
    if not count:
        return np.empty(shape, kept)
    return np.frombuffer(arrays, dtype, count=count, offset=at).reshape(shape).astype(kept)


HEADER = struct.Struct("<Q")
"""Length of the message that follows, bytes."""


@dataclass(frozen=True, slots=True)
class Setup:
    """First of all: what to solve with, which catalog, which index is known to exist, and the limits.

    Attributes
    ----------
    warm : bool
        Solve drawn frames first, so that no real one pays for what is loaded on first use.
    """

    catalog: Catalog
    index: Path | None
    limits: Limits = field(default_factory=Limits)
    niceness: int = 0
    warm: bool = True


@dataclass(frozen=True, slots=True)
class SharedPixels:
    """A frame whose pixels lie in the file that comes along.

    Attributes
    ----------
    frame : Frame
        With an empty array for pixels.
    """

    frame: Frame
    dtype: str
    shape: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class SharedFile:
    """An upload, as it came, in the file that comes along.

    Attributes
    ----------
    stars : ListFormat or None
        How to read it if it is a list of stars.
    hdu : int or str or None
        Which FITS extension is meant.
    """

    name: str
    stars: ListFormat | None = None
    hdu: int | str | None = None


@dataclass(frozen=True, slots=True)
class Task:
    """One frame to solve.

    Attributes
    ----------
    settings : SolveSettings
        Without masters and index, which have ways of their own.
    calibration_number : int or None
        Which masters; numbers are the service's.
    calibration : Calibration or None
        The masters of that number, if this process has not heard of them yet.
    index : Path or None
        For the blind search.
    """

    source: SharedPixels | SharedFile
    hint: Hint | None
    settings: SolveSettings
    calibration_number: int | None = None
    calibration: Calibration | None = None
    index: Path | None = None

    @property
    def name(self) -> str:
        """What to call the frame."""
        return self.source.name if isinstance(self.source, SharedFile) else self.source.frame.source


@dataclass(frozen=True, slots=True)
class Read:
    """A file to read, not to solve: its pixels go into the second of the two files that come along."""

    name: str


@dataclass(frozen=True, slots=True)
class SolvingThere:
    """What a worker of a cluster solves with.

    Attributes
    ----------
    catalog : bytes
        The service's catalogs as a pickle: names of files, which may lie elsewhere on the worker.
    catalogs : str
        What decides of catalogs and version, to compare with the worker's own.
    limits : Limits
        What a solving process may take there.
    """

    catalog: bytes
    catalogs: str
    limits: Limits


@dataclass(frozen=True, slots=True)
class ClusterSetup:
    """First of all to the process that speaks with a cluster.

    Attributes
    ----------
    resource : str or None
        That a worker must have.
    given : SolvingThere
        What workers solve with.
    """

    scheduler: str
    resource: str | None
    given: SolvingThere


@dataclass(frozen=True, slots=True)
class ClusterTask:
    """A frame for the cluster, whose pixels lie in the file that comes along.

    Attributes
    ----------
    most_s : float
        What it may take there, reading included.
    """

    number: int
    task: Task
    most_s: float


@dataclass(frozen=True, slots=True)
class Forget:
    """Nobody waits for the frame of that number any more."""

    number: int


def packed(message: object) -> bytes:
    """Pickle what is asked."""
    return pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)


def unpacked(content: bytes | bytearray) -> object:
    """Read what is asked; only the service may have written it."""
    return pickle.loads(content)


def send(link: socket.socket, answer: Answer) -> None:
    """Answer through a blocking socket. Raises `OSError` when the other end is gone."""
    content = written(answer)
    link.sendall(HEADER.pack(len(content)))
    link.sendall(content)


def receive(link: socket.socket) -> tuple[object, list[int]]:
    """Receive what is asked, and the descriptors that came with it, from a blocking socket.

    Raises
    ------
    EOFError
        The other end is gone.
    """
    head, files, _, _ = socket.recv_fds(link, HEADER.size, 2)
    head += _exactly(link, HEADER.size - len(head)) if head else b""
    if not head:
        raise EOFError
    (length,) = HEADER.unpack(head)
    return unpacked(_exactly(link, length)), files


def _exactly(link: socket.socket, length: int) -> bytes:
    content = bytearray()
    while len(content) < length:
        piece = link.recv(min(length - len(content), 1 << 20))
        if not piece:
            raise EOFError
        content += piece
    return bytes(content)
