"""Measure the structure of mountnav: the figures that docs/explanation/architecture.md shows.

Run: python tools/house.py [FOLDER] [--hops]

FOLDER is a checkout (default: this one), so that an old state can be measured by the same rules. Figures are
counted from the source text alone, with the standard library; `--hops` runs a service in this process (this
checkout only): it solves drawn frames, centers a fake mount with a sync, and stops it, and counts what these
pass through. `--hops --calls` prints every call of these ways.

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
  a type and not one word of description;
- *ways* (`--hops`): the functions of the three packages that wait for one another when the last one is
  called, from the route or the decision on. Where a way goes on in another task it is followed there: `WAYS`.
"""

from __future__ import annotations

import argparse
import ast
import asyncio
import os
import re
import sys
import threading
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType

PACKAGES = ("mountnav", "drivers", "api")
ROOMS = (
    "library",
    "client",
    "settings",
    "testing",
    "night",
    "navigation",
    "mount",
    "journal",
    "guiding",
    "pointing",
    "series",
    "archive",
    "simulation",
    "solving",
    "identification",
    "solution",
    "measuring",
    "catalog",
    "reading",
    "devices",
    "frames",
    "ephemeris",
    "sky",
    "clock",
    "extras",
    "files",
    "masking",
    "start_up",
    "tasks",
    "parsing",
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


def measure(root: Path, modules: dict[str, Module]) -> list[tuple[str, str]]:
    """The table: what, and its figure."""
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


@dataclass(frozen=True, slots=True)
class Leg:
    """A part of a way that runs in one task.

    Attributes
    ----------
    start, end : str
        Qualified names of the first and the last function; `end` may be folders, parted by spaces: any
        function in them.
    through : str
        Qualified name of a function that must lie between, if there are several ways.
    """

    start: str
    end: str
    through: str = ""


WAYS = {
    "`POST center` to the first astronomy": (
        Leg("center_telescope", "begun"),
        Leg("Jobs._run", "mountnav/sky/ mountnav/pointing/"),
    ),
    "sync decision to the bytes": (Leg("GuardedSync.commit", "SerialLine.write", "Lx200Language.send_sync"),),
    "`POST stop` to the bytes": (
        Leg("stop_telescope", "waited_for"),
        Leg("Dispatcher.stop", "MountOrders.stop"),
        Leg("CheckedMount.stop", "SerialLine.write_now"),
    ),
}
"""What `--hops` follows through a service: a centering that syncs, and a stop while it slews."""

OBSERVATORY = """
[service]
[solving]
worker = false
[site]
latitude_deg = 47.0
longitude_deg = 11.0
[[telescope]]
id = "east"
exposure_s = 0.5
[telescope.mount]
url = "fake+lx200://"
slew_rate_deg_s = 45.0
acceleration_deg_s2 = 8.0
[telescope.mount.errors]
ih_arcsec = 300.0
id_arcsec = -240.0
[telescope.camera]
kind = "simulated"
width_px = 1200
height_px = 900
scale_arcsec_px = 4.0
[telescope.centering]
settle_s = 0.0
"""
"""The service that `--hops` asks: one telescope, 5' beside where its mount believes it to be."""

Call = tuple[str, str]
"""File, from the checkout on, and function."""


class Trace:
    """Calls into the three packages, in their order, of all threads."""

    def __init__(self, root: Path, legs: tuple[Leg, ...] = ()) -> None:
        self._root = f"{root}/"
        self._roots = tuple(f"{root / package}/" for package in PACKAGES)
        self.calls: list[Call] = []
        self.chains: dict[Leg, list[Call]] = {}
        """The functions of each leg that was gone to its end."""
        self._legs = legs
        self._entered: dict[Leg, set[Call]] = {leg: set() for leg in legs}

    def _called(self, frame: FrameType, event: str, _value: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(self._roots) and code.co_name[0] != "<":
            self.calls.append((code.co_filename, code.co_qualname))
            if len(self.chains) < len(self._legs):
                self._follow(list(self._waiting(frame)))

    def _follow(self, waiting: list[Call]) -> None:
        names = [name for _, name in waiting]
        for leg in self._legs:
            if leg in self.chains or leg.start not in names:
                continue
            chain = waiting[: names.index(leg.start) + 1]
            self._entered[leg].add(chain[0])
            file, name = chain[0]
            there = file.startswith(tuple(leg.end.split())) if "/" in leg.end else name == leg.end
            if there and (not leg.through or leg.through in names):
                self.chains[leg] = chain[::-1]

    def _waiting(self, frame: FrameType | None) -> Iterator[Call]:
        while frame is not None:
            code = frame.f_code
            if code.co_filename.startswith(self._roots) and code.co_name[0] != "<":
                yield code.co_filename.removeprefix(self._root), code.co_qualname
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

    def way(self, legs: tuple[Leg, ...]) -> list[Call]:
        """All functions of the legs, in their order."""
        missing = [leg for leg in legs if leg not in self.chains]
        if missing:
            raise SystemExit(f"not gone: {missing[0]}")
        return [call for leg in legs for call in self.chains[leg]]

    def entered(self, legs: tuple[Leg, ...]) -> set[Call]:
        """What was entered on the legs before their ends, beside the functions that wait."""
        return {call for leg in legs for call in self._entered[leg]}


def hops(root: Path) -> tuple[list[tuple[str, str]], list[tuple[str, list[Call]]]]:
    """What solves, a centering with its sync, and a stop pass through: figures, and the calls of each way."""
    sys.path.insert(0, str(root))
    found = list[tuple[str, str]]()
    for name, center in (("first", (83.8, -5.4)), ("second", (210.8, 54.3))):
        trace = _solve_traced(root, *center)
        found.append((f"files that solve enters, {name} frame", str(len(trace.files()))))
        inner = trace.files("identification", "solving")
        found.append(("of these in identification and solving", str(len(inner))))
        found.append(("changes of file in that trace", f"{trace.changes():,}"))
    trace = asyncio.run(_service_traced(root))
    ways = list[tuple[str, list[Call]]]()
    for what, legs in WAYS.items():
        way = trace.way(legs)
        ways.append((what, way))
        found.append((what, f"{len(way)} functions in {_files(way)} files"))
        entered = trace.entered(legs)
        found.append(("entered in all on that way", f"{len(entered)} functions in {_files(entered)} files"))
    return found, ways


def _files(calls: Iterable[Call]) -> int:
    return len({file for file, _ in calls})


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


async def _service_traced(root: Path) -> Trace:
    import httpx

    from api.http.app import create_app
    from mountnav.settings.observatory import Settings

    trace = Trace(root, tuple(leg for legs in WAYS.values() for leg in legs))
    with TemporaryDirectory() as folder:
        os.environ["MOUNTNAV_JOURNAL"] = str(Path(folder) / "journal.sqlite")
        app = create_app(Settings.parse(OBSERVATORY))
        transport = httpx.ASGITransport(app=app)
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1/v1", timeout=60) as client,
        ):
            east = "/telescopes/east"
            # its answer is all that a client sees of the first reading
            while not (here := (await client.get(east)).json())["icrs"]:  # noqa: ASYNC110
                await asyncio.sleep(0.2)
            target = {"ra_deg": here["icrs"]["ra_deg"], "dec_deg": here["icrs"]["dec_deg"] - 8.0}
            with trace.on():
                job = (await client.post(f"{east}/center", json=target)).raise_for_status().json()
                while not job["finished_utc"]:
                    await asyncio.sleep(0.2)
                    job = (await client.get(f"/jobs/{job['id']}")).json()
                if job["state"] != "succeeded":
                    raise SystemExit(f"not centered: {job}")
                target["dec_deg"] -= 12.0
                (await client.post(f"{east}/slew", json=target)).raise_for_status()
                await asyncio.sleep(0.3)
                (await client.post(f"{east}/stop")).raise_for_status()
                await asyncio.sleep(0.3)
    return trace


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).resolve().parent.parent)
    parser.add_argument(
        "--list", choices=("up", "circles", "constants"), help="what a figure counts, by name"
    )
    parser.add_argument(
        "--hops", action="store_true", help="what a solve, a centering and a stop pass through"
    )
    parser.add_argument("--calls", action="store_true", help="with --hops: each call of the ways")
    given = parser.parse_args()
    if given.hops:
        table, ways = hops(given.folder)
        print("\n".join(f"{what:<{max(len(one) for one, _ in table)}}  {figure}" for what, figure in table))
        for what, way in ways if given.calls else ():
            print(f"\n{what}")
            print("\n".join(f"    {file} {function}" for file, function in way))
        return
    modules = modules_of(given.folder)
    if given.list == "up":
        print("\n".join(f"{one} -> {other}" for one, other in arrows_up(modules)))
    elif given.list == "circles":
        print("\n".join(" <-> ".join(ring) for ring in circles(modules)))
    elif given.list == "constants":
        print("\n".join(line for module in modules.values() for line in bare_constants(module)[1]))
    else:
        table = measure(given.folder, modules)
        width = max(len(what) for what, _ in table)
        print("\n".join(f"{what:<{width}}  {figure}" for what, figure in table))


if __name__ == "__main__":
    main()
