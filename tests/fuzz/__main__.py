"""``python -m tests.fuzz [--seconds N | --inputs N] [--target NAME ...]``: fuzz each target; 1 if one broke.

Guided by coverage where atheris is installed, each target in a process of its own; else by chance. With
`--inputs` the search is the same on every machine: so many inputs, by chance. An input that breaks a target
is kept in its corpus: the next `make test` fails on it until it is mended.

With `--keep DIR` the search goes on where it was left: what it has found to reach more code, and the CPU time
that each target has had, stay there. ``--keep DIR --hours 1`` goes on in slices until each has had its hour.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import resource
import subprocess
import sys
import time
import traceback
import warnings
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path


def _keep(name: str, data: bytes) -> Path:
    from tests.fuzz.targets import CORPORA

    folder = CORPORA / name
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"broke-{hashlib.sha256(data).hexdigest()[:12]}"
    path.write_bytes(data)
    return path


def _tried(name: str, data: bytes) -> None:
    """Run one input; what breaks is kept, told and raised."""
    from tests.fuzz.targets import TARGETS

    try:
        TARGETS[name].run(data)
    except BaseException as fault:
        if isinstance(fault, KeyboardInterrupt):
            raise
        print(f"{name}: broken by {_keep(name, data)}", flush=True)
        raise


def mutated(data: bytes, others: list[bytes], rng: random.Random) -> bytes:
    """The input with some of its bytes changed, cut, doubled, or put together with another's."""
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        at = rng.randrange(len(found) + 1)
        match rng.randrange(7):
            case 0 if found:
                found[at % len(found)] = rng.randrange(256)
            case 1 if found:
                found[at % len(found)] ^= 1 << rng.randrange(8)
            case 2:
                found[at:at] = rng.randbytes(rng.randrange(1, 9))
            case 3:
                del found[at : at + rng.randrange(1, 40)]
            case 4:
                piece = found[at : at + rng.randrange(1, 60)]
                found[at:at] = piece * rng.randrange(1, 20)
            case 5:
                other = rng.choice(others)
                start = rng.randrange(len(other) + 1)
                found[at:] = other[start:]
            case _:
                word = rng.choice(_WORDS)
                found[at : at + len(word)] = word
    return bytes(found)


_WORDS = (
    b"NaN", b"1e999", b"-1", b"null", b"true", b"[]", b"{}", b'""', b"0", b"\0", b"\xff\xff\xff\xff",
    b"9" * 30, b"1" * 5000, b"-0", b"#", b":", b"\r\n", b"0001-01-01T00:00:00+23:59",
    b"\xc3\xa4", b"\xed\xa0\x80", b"2147483648", b"18446744073709551616", b"'", b'"', b"<", b">", b"&#0;",
)  # fmt: skip


def by_chance(name: str, seconds: float, seed: int, most: int | None = None) -> int:
    """Mutate the corpus for so long, or so many times; how many inputs were tried."""
    from tests.fuzz.targets import corpus

    rng, inputs, count = random.Random(seed), corpus(name), 0
    for data in inputs:
        _tried(name, data)
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s if most is None else count < most:
        _tried(name, mutated(rng.choice(inputs), inputs, rng))
        count += 1
    return count


def _guided(name: str, seconds: float, grown: Path | None) -> None:
    """Let atheris find its way, from what it has found before; never returns."""
    import atheris

    with atheris.instrument_imports(include=["mountnav", "drivers", "api"]):
        from tests.fuzz.targets import CORPORA, corpus
    import tempfile

    seeds = Path(tempfile.mkdtemp(prefix=f"fuzz-{name}-"))
    for number, data in enumerate(corpus(name)):
        (seeds / f"{number:03d}").write_bytes(data)
    options = [f"-max_total_time={seconds:.0f}", "-max_len=20000", "-timeout=60", "-rss_limit_mb=3000"]
    options += [f"-artifact_prefix={CORPORA}/{name}-", "-verbosity=0", "-print_final_stats=1"]
    # libFuzzer writes what it finds into the first folder
    folders = [str(seeds)] if grown is None else [str(grown), str(seeds)]
    atheris.Setup([sys.argv[0], *options, *folders], lambda data: _tried(name, data))
    atheris.Fuzz()


class Spent:
    """The CPU time that each target has had so far, in a file of the folder that is kept.

    Parameters
    ----------
    folder : Path or None
        None: nothing is kept.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self.cpu_s: dict[str, float] = {}
        if folder is not None and (folder / "cpu_s.json").exists():
            self.cpu_s = json.loads((folder / "cpu_s.json").read_text())

    def grown(self, name: str) -> Path | None:
        """Where a target's inputs are kept."""
        if self.folder is None:
            return None
        (self.folder / name).mkdir(parents=True, exist_ok=True)
        return self.folder / name

    def add(self, name: str, cpu_s: float) -> None:
        """Count, and write it down."""
        self.cpu_s[name] = round(self.cpu_s.get(name, 0.0) + cpu_s, 1)
        if self.folder is not None:
            (self.folder / "cpu_s.json").write_text(json.dumps(self.cpu_s, indent=1) + "\n")

    def turns(self, names: list[str], hours: float | None, broken: list[str]) -> Iterator[str]:
        """Each target once; with hours, always the one that has had the least, until each has had them.

        One that broke would break in the same way again: it gets no more.
        """
        if hours is None:
            yield from names
            return
        most_s = hours * 3600.0
        while short := [name for name in names if self.cpu_s.get(name, 0.0) < most_s and name not in broken]:
            yield min(short, key=lambda name: self.cpu_s.get(name, 0.0))


def _guided_apart(name: str, seconds: float, spent: Spent) -> bool:
    """Search in a process of its own; whether nothing broke."""
    command = [sys.executable, "-m", "tests.fuzz", "--guided", name, "--seconds", str(seconds)]
    if (grown := spent.grown(name)) is not None:
        command += ["--keep", str(grown)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ended = subprocess.run(command, check=False, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    spent.add(name, cpu_s)
    told = [line for line in ended.stderr.splitlines() if "number_of_executed_units" in line]
    held = "ok" if ended.returncode == 0 else ended.stdout + ended.stderr[-3000:]
    print(f"{name}: {cpu_s:.0f} CPU s, {spent.cpu_s[name]:.0f} so far", *told, held, flush=True)
    return ended.returncode == 0


def main() -> int:
    """Fuzz."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    parser.add_argument("--seconds", type=float, default=10.0, help="for each target")
    parser.add_argument("--inputs", type=int, help="for each target, by chance, instead of a time")
    parser.add_argument("--target", action="append", help="only this one; may be given again")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="for the search by chance")
    parser.add_argument("--keep", type=Path, help="folder in which a guided search goes on where it was left")
    parser.add_argument(
        "--hours", type=float, help="with --keep: CPU hours of each target, all sessions together"
    )
    parser.add_argument("--guided", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    warnings.simplefilter("ignore")
    if chosen.guided:
        _guided(chosen.guided, chosen.seconds, chosen.keep)
        return 0
    guided = chosen.inputs is None and find_spec("atheris") is not None
    if chosen.hours is not None and (chosen.keep is None or not guided):
        parser.error("--hours needs --keep, and atheris (pip install atheris)")
    from tests.fuzz.targets import TARGETS

    spent = Spent(chosen.keep)
    broken: list[str] = []
    if unknown := set(chosen.target or ()) - set(TARGETS):
        parser.error(f"no such target: {', '.join(sorted(unknown))}; there are {', '.join(TARGETS)}")
    for name in spent.turns(chosen.target or list(TARGETS), chosen.hours, broken):
        if guided:
            if not _guided_apart(name, chosen.seconds, spent):
                broken.append(name)
            continue
        try:
            count = by_chance(name, chosen.seconds, chosen.seed, chosen.inputs)
            print(f"{name}: {count} inputs, seed {chosen.seed}", flush=True)
        except Exception:
            traceback.print_exc()
            broken.append(name)
    print(f"broken: {', '.join(broken)}" if broken else "nothing broke", flush=True)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
