"""What the solver's process answers is data: all that a verdict holds comes over, and nothing else does."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import pickle
import socket
import struct
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from api.solver.link import ProcessEnded, ProcessLink
from api.solver.messages import HEADER, Answer, BadAnswer, Built, Done, Fault, Progress, Ready, read, written
from mountnav.catalog.embedded import embedded_catalog
from mountnav.errors import BadCatalog, BadFrame, DeviceRefused, MountnavError
from mountnav.frames import Frame, Hint
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Reason, Times, Verdict
from mountnav.solving.solve import SolveSettings, solve

TRUTH = Icrs(85.0, 30.0)


@pytest.fixture(scope="module")
def verdicts() -> tuple[Verdict, Verdict]:
    """A real frame, solved, and sought far from where it is."""
    frame = draw_frame(
        TRUTH,
        SimulatedOptics(800, 600, 4.0),
        embedded_catalog(),
        exposure_s=2.0,
        mid_exposure_utc=datetime(2026, 11, 21, tzinfo=UTC),
        seed=(1, 2),
    )

    def solved(place: Icrs, budget_s: float) -> Verdict:
        hint = Hint(center=place, scale_low_arcsec_px=3.8, scale_high_arcsec_px=4.2)
        return solve(
            frame, embedded_catalog(), hint=hint, settings=SolveSettings(blind="never", budget_s=0.5)
        )

    return solved(TRUTH, 30.0), solved(Icrs(200.0, -60.0), 0.1)


def _same(one: object, other: object) -> bool:
    """Equal in value and type, arrays and NaN included."""
    if type(one) is not type(other):
        return isinstance(one, np.generic) and _same(one.item(), other)
    if isinstance(one, np.ndarray):
        assert isinstance(other, np.ndarray)
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if dataclasses.is_dataclass(one):
        return all(_same(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(one))
    if isinstance(one, tuple | list):
        assert isinstance(other, tuple | list)
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, dict):
        assert isinstance(other, dict)
        return one.keys() == other.keys() and all(_same(one[key], other[key]) for key in one)
    return one == other or (isinstance(one, float) and math.isnan(one) and math.isnan(other))  # type: ignore[arg-type]


@pytest.mark.long
def test_verdicts_come_over_whole(verdicts: tuple[Verdict, Verdict]) -> None:
    solved, unsolved = verdicts
    assert solved.solution is not None
    assert unsolved.reason is not None
    for verdict in verdicts:
        there = read(written(Done(verdict=verdict, grown_mb=1.5)))
        assert isinstance(there, Done)
        assert there.verdict is not None
        assert there.grown_mb == 1.5
        told = dataclasses.asdict(verdict), dataclasses.asdict(there.verdict)
        assert told[0].keys() == told[1].keys()
        for name in told[0]:
            assert _same(told[0][name], told[1][name]), name
    assert isinstance(read(written(Done(verdict=unsolved))).verdict.reason, Reason)  # type: ignore[union-attr]


@pytest.mark.parametrize("answer", [Ready(1.5, ("slow",)), Progress(0.25), Built(Path("/a/b")), Done()])
def test_the_others_come_over(answer: Answer) -> None:
    assert read(written(answer)) == answer


def test_a_frame_comes_over_with_its_header_as_it_was() -> None:
    header: dict[str, str | int | float | bool] = {"A": 1, "B": 1.0, "C": True, "D": "ä\udc80", "E": 10**38}
    frame = Frame(
        np.zeros((0, 0), np.uint16),
        datetime(2026, 1, 1, tzinfo=UTC),
        2.0,
        hint=Hint(Icrs(1.0, 2.0), alternatives=(Hint(Icrs(3.0, 4.0)),)),
        header=header,
        mosaic=True,
    )
    there = read(written(Done(frame=frame, dtype="<u2", shape=(3, 4))))
    assert isinstance(there, Done)
    assert there.frame is not None
    assert _same(dataclasses.asdict(frame), dataclasses.asdict(there.frame))
    assert [type(one) for one in there.frame.header.values()] == [int, float, bool, str, int]


def test_errors_come_over_by_name() -> None:
    ours = BadFrame("cut short", device="x.fits", advice="copy it again")
    ours.add_note("where")
    again = read(written(Done(fault=Fault.of(ours))))
    assert isinstance(again, Done)
    assert again.fault is not None
    error = again.fault.error()
    assert type(error) is BadFrame
    assert (error.what, error.device, error.advice) == ("cut short", "x.fits", "copy it again")
    assert error.__notes__ == ["where"]
    assert str(error) == str(ours)
    assert type(Fault.of(BadCatalog("x")).error()) is BadCatalog
    assert isinstance(Fault.of(DeviceRefused("x")).error(), DeviceRefused)
    assert type(Fault.of(ZeroDivisionError("a bug")).error()) is ZeroDivisionError

    class Strange(Exception):
        pass

    class Mine(MountnavError):
        pass

    assert str(Fault.of(Strange("odd")).error()) == "Strange: odd"
    assert type(Fault.of(Mine("odd")).error()) is RuntimeError
    # what no constructor takes with one text never comes over by that name
    for kind in ("UnicodeDecodeError", "ExceptionGroup", "StopIteration", "SystemExit", "KeyboardInterrupt"):
        assert type(Fault(kind, "x").error()) is RuntimeError


class _Evil:
    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (Path("/tmp/never-made-by-a-test"),))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\0\0\0\0",
        pickle.dumps(_Evil()),
        struct.pack("<I", 5) + b"[[[[[",
        struct.pack("<I", 200_000) + b"[" * 200_000,
        struct.pack("<I", 6000) + b"1" * 6000,
        struct.pack("<I", 4) + b'"x"}',
        written(Progress(0.5)).replace(b"Progress", b"Popen123"),
        written(Progress(0.5)).replace(b"0.5", b'"x"'),
        written(Progress(0.5)).replace(b'"share"', b'"Share"'),
        written(Built(Path("/abc"))).replace(b'"/abc"', b'{"":1}'),
    ],
)
def test_nothing_else_is_taken(content: bytes) -> None:
    with pytest.raises(BadAnswer):
        read(content)
    assert not Path("/tmp/never-made-by-a-test").exists()


def _array(told: list[object], data: bytes = bytes(64)) -> bytes:
    verdict = json.loads(written(Done(verdict=Verdict(None, Reason.NO_MATCH, "", 0, Times())))[4:])
    verdict["is"]["verdict"]["seen_px"] = told
    text = json.dumps(verdict).encode()
    return struct.pack("<I", len(text)) + text + data


@pytest.mark.parametrize(
    "told",
    [
        ["<f4", [4, 2], 40],  # reaches beyond the end
        ["<f4", [1 << 62, 4], 0],
        ["<f4", [-1, -8], 0],
        ["<f4", [2, 2], -1],
        ["|O", [2, 2], 0],
        ["<M8[s]", [1, 2], 0],
        ["f4,f4", [1, 2], 0],
        ["<f4", [2.0, 2], 0],
        ["<c8", [1, 2], 0],
        ["<f4", [2, 2]],
        "text",
    ],
)
def test_arrays_that_are_none(told: list[object]) -> None:
    assert isinstance(read(_array(["<f4", [4, 2], 0])), Done)
    with pytest.raises(BadAnswer):
        read(_array(told))


@pytest.mark.long
@given(data=st.data())
def test_damaged_answers_are_answers_or_refused(
    data: st.DataObject, verdicts: tuple[Verdict, Verdict]
) -> None:
    content = bytearray(written(Done(verdict=verdicts[1])))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, min(len(content) - 1, 3000)))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(BadAnswer):
        assert isinstance(read(content[: data.draw(st.integers(0, len(content)))]), Done)


class _Process:
    """Stands for the process of a link, whose socket is real."""

    pid = 1
    killed = False

    def kill(self) -> None:
        self.killed = True

    def wait(self, timeout: float = 0.0) -> int:
        return -9


@pytest.mark.parametrize("content", [HEADER.pack(1 << 40), HEADER.pack(3) + b"abc"])
async def test_a_process_that_answers_otherwise_is_ended(content: bytes) -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.setblocking(False)
        process = _Process()
        link = ProcessLink(process, ours)  # type: ignore[arg-type]
        theirs.sendall(content)
        with pytest.raises(ProcessEnded, match="an invalid answer"):
            await link.receive()
        assert process.killed
