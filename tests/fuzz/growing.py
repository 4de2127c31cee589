"""``python -m tests.fuzz.growing [--target NAME ...]``: whether a parser's time grows faster than its input.

From each seed inputs are made in which one piece (a byte, a word, a line, any slice) stands 32,000 and
128,000 bytes long. A time that grows with the square shows as a factor of sixteen for four times the bytes;
what is suspected is measured again, longer, before it is told.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import random
import re
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

from tests.fuzz.targets import TARGETS, corpus

SMALL_BYTES, FACTOR = 32_000, 4
"""The shorter input, and how many times as long the longer one is."""
MOST_GROWTH = 9.0
"""Of the time, for four times the input: linear is four, n log n five, the square sixteen."""
LEAST_S = 0.02
"""Less than that in the longer one is noise."""
PUMPS = (
    b"\0", b" ", b"a", b"1", b"\n", b"\r\n", b"#", b":", b"<", b">", b"</", b"<a>", b'"', b"'", b"''", b"[",
    b"{", b"]", b"a.", b"a=1\n", b"[a]\n", b"[[a]]\n", b'{"a":', b'[{"a":1},', b"&", b"&amp;", b"\\", b"\\n",
    b",", b"-", b"1,", b"1 ", b"1\n", b"# ", b"# a\n", b"\xff", b"\xc3\xa4", b"e1", b"0x", b"''' ", b"=",
    b"\t", b"*", b"%", b"_",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Pumped:
    """An input with one piece that can be as long as one likes."""

    before: bytes
    piece: bytes
    after: bytes

    def of(self, size: int) -> bytes:
        """The input with about so many bytes of the piece."""
        return self.before + self.piece * max(1, size // len(self.piece)) + self.after


def pumps(data: bytes, rng: random.Random, count: int) -> Iterator[Pumped]:
    """Ways to make an input long: pieces of its own doubled in place, and foreign ones put in."""
    yield Pumped(b"", data, b"")
    for match in itertools.islice(re.finditer(rb"[^\n]+\n", data), 20):
        yield Pumped(data[: match.start()], match[0], data[match.end() :])
    edges = sorted({0, len(data), *(match.end() for match in re.finditer(rb"[^\w]|\w+", data[:4000]))})
    for _ in range(count):
        start, end = sorted(rng.sample(edges, 2)) if len(edges) > 1 else (0, len(data))
        if rng.random() < 0.5 and end > start:
            end = min(end, start + rng.choice((8, 40, 200, 2000)))
            yield Pumped(data[:start], data[start:end], data[end:])
        else:
            after = data[start:] if rng.random() < 0.7 else b""
            yield Pumped(data[:start], rng.choice(PUMPS), after)


def _time_s(name: str, data: bytes, times: int) -> float:
    least_s = float("inf")
    for _ in range(times):
        begun_s = time.process_time()
        with contextlib.suppress(AssertionError):
            TARGETS[name].run(data)
        least_s = min(least_s, time.process_time() - begun_s)
    return least_s


def growth(name: str, pumped: Pumped, size: int = SMALL_BYTES, times: int = 1) -> tuple[float, float]:
    """By how much the time grows with four times the input, and the longer time, s."""
    long_s = _time_s(name, pumped.of(FACTOR * size), times)
    if long_s < LEAST_S:
        return 0.0, long_s
    return long_s / max(1e-4, _time_s(name, pumped.of(size), times + 1)), long_s


def suspects(name: str, count: int, seed: int) -> Iterator[tuple[Pumped, float, float]]:
    """Inputs whose time grows too fast, with the growth and the time of a longer one."""
    rng = random.Random(seed)
    inputs = corpus(name)
    for data in inputs:
        TARGETS[name].run(data)
    for data in inputs:
        for pumped in pumps(data, rng, max(1, count // len(inputs))):
            if growth(name, pumped)[0] < MOST_GROWTH:
                continue
            # a longer one is sure: what is set up once has no share in it
            found, long_s = growth(name, pumped, 4 * SMALL_BYTES, 3)
            if found >= MOST_GROWTH:
                yield pumped, found, long_s


def main() -> int:
    """Look for them."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.growing")
    parser.add_argument("--target", action="append", help="only this one; may be given again")
    parser.add_argument("--inputs", type=int, default=100, help="for each target")
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    warnings.simplefilter("ignore")
    broken = []
    for name in chosen.target or TARGETS:
        begun_s, found = time.process_time(), 0
        for pumped, factor, long_s in suspects(name, chosen.inputs, chosen.seed):
            found += 1
            print(
                f"{name}: × {factor:.0f} for four times the bytes ({long_s:.2f} s for "
                f"{16 * SMALL_BYTES} bytes): {pumped.before[-60:]!r} + {pumped.piece[:60]!r} × n",
                flush=True,
            )
            if found >= 5:
                break
        print(f"{name}: {found} suspects, {time.process_time() - begun_s:.0f} s", flush=True)
        broken += [name] if found else []
    print(f"too fast: {', '.join(broken)}" if broken else "nothing grows faster than its input", flush=True)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
