"""Measure the structure of mountnav: the figures that docs/explanation/architecture.md shows.

Run: python tools/house.py [FOLDER] [--hops]

FOLDER is a checkout (default: this one), so that an old state can be measured by the same rules. Figures are
counted from the source text alone, with the standard library; `--hops` runs a solve of a drawn frame, and a
slew and a stop of a fake mount, in this process and counts what they pass through (this checkout only).

How each figure is counted:

- *files, lines*: of `mountnav`, `drivers`, `api`, with `__init__.py`, blank lines included;
- *single importer*: modules that exactly one other module of the three packages imports;
- *side by side*: the most modules that lie in one folder of `api`;
- *arrows up*: imports inside `mountnav` from a room to one that stands higher in `ROOMS`, function-level ones
  included, those for annotations alone (`if TYPE_CHECKING`) left out;
- *circles*: groups of modules that import each other in a ring, by the same imports at module level;
- *constants without a word*: assignments of upper-case names to numbers at module level that have neither a
  comment above or beside them nor a string literal below;
- *comments*: lines that begin with `#`, as a share of all lines;
- *headings that repeat*: numpydoc entries of a parameter, a return value or an attribute that have a name and
  a type and not one word of description.
"""

from __future__ import annotations

import argparse
import ast
import asyncio
import re
import sys
import threading
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from types import FrameType

PACKAGES = ("mountnav", "drivers", "api")
ROOMS = (
    "client",
    "settings",
    "testing",
    "night",
    "navigation",
    "mount",
    "journal",
    "pointing",
    "series",
    "simulation",
    "solving",
    "identification",
    "solution",
    "measuring",
    "catalog",
    "reading",
    "devices",
    "frames",
    "sky",
    "clock",
    "files",
    "parsing",
    "masking",
    "tasks",
    "errors",
    "units",
    "version",
)
"""Rooms of `mountnav` from the top to the ground; the contract in pyproject.toml holds the same order."""
SHORT_LINES = 100
"""Files shorter than this are counted as fragments, as HOUSE.md's first table did."""


@dataclass(frozen=True)
class Module:
    """One file: its dotted name, its text, and what it imports."""

    name: str
    path: Path
    text: str
    tree: ast.Module
    at_start: frozenset[str]
    in_functions: frozenset[str]


def modules_of(root: Path) -> dict[str, Module]:
    """All modules of the three packages, by dotted name."""
    found: dict[str, tuple[Path, str, ast.Module]] = {}
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            parts = list(path.relative_to(root).with_suffix("").parts)
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            text = path.read_text(encoding="utf-8")
            found[name] = path, text, ast.parse(text)
    names = frozenset(found)
    return {
        name: Module(name, path, text, tree, *_imports(tree, name, names))
        for name, (path, text, tree) in found.items()
    }


def _imports(tree: ast.Module, own: str, names: frozenset[str]) -> tuple[frozenset[str], frozenset[str]]:
    at_start: set[str] = set()
    in_functions: set[str] = set()

    def visit(node: ast.AST, inside: bool) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.ImportFrom) and child.module:
                for alias in child.names:
                    full = f"{child.module}.{alias.name}"
                    target = full if full in names else child.module
                    if target in names and target != own:
                        (in_functions if inside else at_start).add(target)
            visit(child, inside or isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)))

    visit(tree, inside=False)
    return frozenset(at_start), frozenset(in_functions)


def arrows_up(modules: dict[str, Module]) -> list[tuple[str, str]]:
    """Imports inside `mountnav` that lead to a room that stands higher."""
    rank = {room: k for k, room in enumerate(ROOMS)}
    up = []
    for module in modules.values():
        room = _room(module.name)
        for target in sorted(module.at_start | module.in_functions):
            there = _room(target)
            if room in rank and there in rank and rank[there] < rank[room]:
                up.append((module.name, target))
    return up


def _room(name: str) -> str:
    parts = name.split(".")
    return parts[1] if parts[0] == "mountnav" and len(parts) > 1 else ""


def circles(modules: dict[str, Module]) -> list[list[str]]:
    """Groups of modules that import each other in a ring (strongly connected, by imports at module level)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def connect(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for target in modules[name].at_start:
            if target not in index:
                connect(target)
                low[name] = min(low[name], low[target])
            elif target in stack:
                low[name] = min(low[name], index[target])
        if low[name] == index[name]:
            ring = []
            while True:
                ring.append(stack.pop())
                if ring[-1] == name:
                    break
            if len(ring) > 1:
                found.append(sorted(ring))

    sys.setrecursionlimit(10_000)
    for name in modules:
        if name not in index:
            connect(name)
    return found


def bare_constants(module: Module) -> tuple[int, list[str]]:
    """How many numeric constants a module has, and those that no word explains."""
    lines = module.text.splitlines()
    count, bare = 0, []
    body = module.tree.body
    for k, node in enumerate(body):
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        value = getattr(node, "value", None)
        if not isinstance(node, (ast.Assign, ast.AnnAssign)) or value is None or not _has_number(value):
            continue
        names = [one.id for one in ast.walk(target) if isinstance(one, ast.Name)] if target else []
        if not names or not all(re.fullmatch(r"_*[A-Z][A-Z0-9_]*", name) for name in names):
            continue
        count += 1
        below = body[k + 1] if k + 1 < len(body) else None
        told_below = isinstance(below, ast.Expr) and isinstance(getattr(below.value, "value", None), str)
        above = lines[node.lineno - 2].strip() if node.lineno > 1 else ""
        beside = "#" in lines[node.lineno - 1].partition("=")[2]
        if not (told_below or above.startswith("#") or beside):
            bare.append(f"{module.name}: {', '.join(names)}")
    return count, bare


def _has_number(value: ast.expr) -> bool:
    """Whether a value is made of numbers: a number, arithmetic of numbers, a tuple or table of them."""
    if isinstance(value, ast.Constant):
        return isinstance(value.value, (int, float)) and not isinstance(value.value, bool)
    if isinstance(value, (ast.Tuple, ast.List)):
        return bool(value.elts) and all(_has_number(one) for one in value.elts)
    if isinstance(value, ast.UnaryOp):
        return _has_number(value.operand)
    if isinstance(value, ast.BinOp):
        return _has_number(value.left) or _has_number(value.right)
    if isinstance(value, ast.Dict):
        return bool(value.values) and all(_has_number(one) for one in value.values)
    return False


def repeated_headings(module: Module) -> tuple[int, int]:
    """Numpydoc entries, and those of them that hold a name and a type alone."""
    entries = empty = 0
    for node in ast.walk(module.tree):
        if not isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        text = ast.get_docstring(node)
        if text is None or "\n---" not in text:
            continue
        lines = text.splitlines()
        inside = False
        for k, line in enumerate(lines):
            if k + 1 < len(lines) and re.fullmatch(r"-{3,}", lines[k + 1].strip()):
                inside = line.strip() in ("Parameters", "Returns", "Attributes", "Yields")
                continue
            if not inside or not line.strip() or line.startswith((" ", "---")):
                continue
            entries += 1
            following = lines[k + 1] if k + 1 < len(lines) else ""
            empty += not (following.startswith(" ") and following.strip())
    return entries, empty


def comment_lines(module: Module) -> int:
    """Lines that hold a comment alone."""
    with module.path.open("rb") as file:
        return sum(
            token.type == tokenize.COMMENT and token.line.lstrip().startswith("#")
            for token in tokenize.tokenize(file.readline)
        )


def measure(root: Path) -> list[tuple[str, str]]:
    """The table: what, and its figure."""
    modules = modules_of(root)
    lines = {name: module.text.count("\n") for name, module in modules.items()}
    short = [name for name, count in lines.items() if count < SHORT_LINES]
    importers: dict[str, set[str]] = defaultdict(set)
    for module in modules.values():
        for target in module.at_start | module.in_functions:
            importers[target].add(module.name)
    beside = Counter(
        str(module.path.parent.relative_to(root))
        for module in modules.values()
        if module.name.startswith("api") and module.path.name != "__init__.py"
    )
    folder, most = beside.most_common(1)[0]
    constants = [bare_constants(module) for module in modules.values()]
    headings = [repeated_headings(module) for module in modules.values()]
    comments = sum(comment_lines(module) for module in modules.values())
    total = sum(lines.values())
    rings = circles(modules)
    up = arrows_up(modules)
    tests = {path.stem for path in (root / "tests").rglob("test_*.py")}
    own_test = [
        name
        for name, module in modules.items()
        if module.path.name != "__init__.py"
        and any(test == f"test_{name.rsplit('.', 1)[-1]}" for test in tests)
    ]
    bare = sum(len(one) for _, one in constants)
    return [
        ("product files / lines", f"{len(modules):,} / {total:,}"),
        (
            f"files under {SHORT_LINES} lines, and their lines",
            f"{len(short)}, {sum(lines[name] for name in short):,}",
        ),
        ("modules with a single importer", str(sum(len(one) == 1 for one in importers.values()))),
        ("most modules of `api` side by side", f"{most} ({folder})"),
        ("arrows that run up inside `mountnav`", str(len(up))),
        ("circles", str(len(rings))),
        ("numeric constants, those without a word", f"{sum(n for n, _ in constants):,}, {bare}"),
        ("lines that are comments", f"{100.0 * comments / total:.1f} %"),
        (
            "docstring entries, those without a description",
            f"{sum(n for n, _ in headings):,}, {sum(n for _, n in headings):,}",
        ),
        ("modules with a test file of their name", f"{len(own_test)} of {len(modules)}"),
    ]


class Trace:
    """Calls into the three packages, in their order, of all threads.

    Parameters
    ----------
    target : str
        The function whose callers are noted when it is first called.
    """

    def __init__(self, root: Path, target: str = "") -> None:
        self._target = target
        self.chain: list[tuple[str, str]] = []
        """File and function of the target and of all that wait for it."""
        self._roots = tuple(f"{root / package}/" for package in PACKAGES)
        self.calls: list[tuple[str, str]] = []
        """File and function."""

    def _called(self, frame: FrameType, event: str, _value: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(self._roots) and code.co_name[0] != "<":
            self.calls.append((code.co_filename, code.co_qualname))
            if code.co_qualname == self._target and not self.chain:
                self.chain = list(self._waiting(frame))

    def _waiting(self, frame: FrameType | None) -> Iterator[tuple[str, str]]:
        while frame is not None:
            code = frame.f_code
            if code.co_filename.startswith(self._roots) and code.co_name[0] != "<":
                yield code.co_filename, code.co_qualname
            frame = frame.f_back

    @contextmanager
    def on(self) -> Iterator[None]:
        """Trace what is called meanwhile."""
        threading.setprofile(self._called)
        sys.setprofile(self._called)
        try:
            yield
        finally:
            sys.setprofile(None)
            threading.setprofile(None)

    def files(self, *within: str) -> set[str]:
        """Files that were entered, of all rooms or of those named."""
        return {file for file, _ in self.calls if not within or any(f"/{one}/" in file for one in within)}

    def changes(self) -> int:
        """How often a call led to another file than the one before."""
        return sum(one[0] != other[0] for one, other in pairwise(self.calls))

    def way(self) -> tuple[int, int]:
        """Functions and files of the chain of calls to the target."""
        return len(self.chain), len({file for file, _ in self.chain})


def hops(root: Path) -> list[tuple[str, str]]:
    """What a solve, and a slew and a stop of a fake mount, pass through."""
    sys.path.insert(0, str(root))
    found = list[tuple[str, str]]()
    for name, center in (("first", (83.8, -5.4)), ("second", (210.8, 54.3))):
        trace = _solve_traced(root, *center)
        found.append((f"files that solve enters, {name} frame", str(len(trace.files()))))
        inner = trace.files("identification", "solving")
        found.append(("of these in identification and solving", str(len(inner))))
        found.append(("changes of file in that trace", f"{trace.changes():,}"))
    slew, stop = asyncio.run(_orders_traced(root))
    for what, (functions, files) in (("slew", slew), ("stop", stop)):
        found.append((f"{what} of a checked mount to its wire", f"{functions} functions in {files} files"))
    return found


def _solve_traced(root: Path, ra_deg: float, dec_deg: float) -> Trace:
    from mountnav.catalog.embedded import embedded_catalog
    from mountnav.frames import Hint
    from mountnav.simulation.optics import SimulatedOptics
    from mountnav.simulation.render import draw_frame
    from mountnav.sky.coordinates import Icrs
    from mountnav.solving.solve import solve

    center = Icrs(ra_deg, dec_deg)
    optics = SimulatedOptics(1600, 1200, 4.0, fwhm_px=3.0, sky_adu_s=5.0)
    when = datetime(2026, 11, 21, 22, tzinfo=UTC)
    frame = draw_frame(center, optics, embedded_catalog(), exposure_s=10.0, mid_exposure_utc=when, seed=1)
    hint = Hint(center, 1.0, 0.98 * optics.scale_arcsec_px, 1.02 * optics.scale_arcsec_px)
    trace = Trace(root)
    with trace.on():
        verdict = solve(frame, embedded_catalog(), hint=hint)
    if verdict.solution is None:
        raise SystemExit(f"the drawn frame was not solved: {verdict.detail}")
    return trace


async def _orders_traced(root: Path) -> tuple[tuple[int, int], tuple[int, int]]:
    from drivers.fakes.bench import FakeOnPty
    from drivers.registry import make_fake, open_mount
    from mountnav.clock import SystemClock
    from mountnav.journal.memory import MemoryJournal
    from mountnav.mount import CheckedMount
    from mountnav.pointing.limits import Limits
    from mountnav.simulation.mechanics import Mechanics, PointingErrors
    from mountnav.sky.coordinates import Air, Site

    site, air = Site(47.0, 11.0, 600.0), Air()
    with FakeOnPty(make_fake("lx200", "onstep", Mechanics(site, air, PointingErrors()))) as bench:
        mount = CheckedMount(
            open_mount(f"lx200+serial://{bench.address}", site=site),
            telescope="traced",
            limits=Limits(0.0),
            site=site,
            air=air,
            journal=MemoryJournal(),
            clock=SystemClock(),
        )
        await mount.open()
        mount.trust()
        try:
            here = (await mount.reading()).place
            trace = Trace(root, "Lx200Exchange.once")
            with trace.on():
                slewing = asyncio.create_task(mount.slew(replace(here, dec_deg=here.dec_deg - 5.0)))
                await asyncio.sleep(1.0)
            slew = trace.way()
            trace = Trace(root, "Exchange.send_now")
            with trace.on():
                await mount.stop()
            stop = trace.way()
            await asyncio.gather(slewing, return_exceptions=True)
        finally:
            await mount.close()
    return slew, stop


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).resolve().parent.parent)
    parser.add_argument(
        "--list", choices=("up", "circles", "constants"), help="what a figure counts, by name"
    )
    parser.add_argument("--hops", action="store_true", help="what a solve, a slew and a stop pass through")
    given = parser.parse_args()
    if given.hops:
        table = hops(given.folder)
        print("\n".join(f"{what:<{max(len(one) for one, _ in table)}}  {figure}" for what, figure in table))
        return
    modules = modules_of(given.folder)
    if given.list == "up":
        print("\n".join(f"{one} -> {other}" for one, other in arrows_up(modules)))
    elif given.list == "circles":
        print("\n".join(" <-> ".join(ring) for ring in circles(modules)))
    elif given.list == "constants":
        print("\n".join(line for module in modules.values() for line in bare_constants(module)[1]))
    else:
        width = max(len(what) for what, _ in measure(given.folder))
        for what, figure in measure(given.folder):
            print(f"{what:<{width}}  {figure}")


if __name__ == "__main__":
    main()
