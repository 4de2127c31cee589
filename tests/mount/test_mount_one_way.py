"""Nobody orders anything from a raw driver: in the service every order goes through `CheckedMount`.

Read from the source: what is declared a `Mount` (a driver) or comes from `open_mount` gets no orders, but in
the checked mount itself. And seen at work: each order that reaches a driver was given by that room.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import FrameType

import pytest

from drivers.simulated.mount import SimulatedMount
from mountnav.devices import Direction, SlewOutcome
from tests.mount.mount_rig import Rig, run

ROOT = Path(__file__).parents[2]
BESIDE_STARS = {"set_offset_rates", "move_axis"}
ORDERS = {
    "slew",
    "sync",
    "park",
    "unpark",
    "home",
    "set_tracking",
    "guide",
    "stop",
    "set_park",
} | BESIDE_STARS
CHECKED = "mountnav/mount/"
AFTER_DEATH = "api/observatory/dead_man_process.py"
"""The guard, a process of its own: it ends what goes on when there is no service any more to do it."""
BY_THEMSELVES = (CHECKED, "drivers/", "mountnav/simulation/", "mountnav/testing/")
"""Drivers and fakes move what is their own; `testing` tries a driver with no observatory round it."""


@cache
def sources() -> list[tuple[str, ast.Module]]:
    """Every file of the service that drivers are handed through."""
    found = []
    for package in ("mountnav", "api"):
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            text = path.read_text(encoding="utf-8")
            if (
                name != AFTER_DEATH
                and not name.startswith(BY_THEMSELVES)
                and "mount" in text.lower().replace("mountnav", "")
            ):
                found.append((name, ast.parse(text)))
    return found


def is_raw(annotation: ast.expr | None) -> bool:
    """Whether an annotation says that something is a driver."""
    if annotation is None:
        return False
    names = {node.id for node in ast.walk(annotation) if isinstance(node, ast.Name)}
    return "Mount" in names and not isinstance(annotation, ast.Subscript)


def raw_names(scope: ast.AST) -> Iterator[str]:
    """Expressions in a class or module that hold a driver, as far as they are declared or assigned so."""
    drivers: set[str] = set()
    for node in ast.walk(scope):
        if isinstance(node, ast.arg) and is_raw(node.annotation):
            drivers.add(node.arg)
        if isinstance(node, ast.AnnAssign) and is_raw(node.annotation):
            drivers.add(ast.unparse(node.target))
        opened = isinstance(node, ast.Assign) and isinstance(node.value, ast.Call)
        if opened and ast.unparse(node.value.func).split(".")[-1] == "open_mount":  # type: ignore[attr-defined]
            drivers.update(ast.unparse(target) for target in node.targets)  # type: ignore[attr-defined]
    for node in ast.walk(scope):
        if isinstance(node, ast.Assign) and ast.unparse(node.value) in drivers:
            drivers.update(ast.unparse(target) for target in node.targets)
    yield from drivers


def orders_to(scope: ast.AST, holders: set[str]) -> list[str]:
    """Orders that are given to these."""
    return [
        ast.unparse(node)
        for node in ast.walk(scope)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in ORDERS
        and ast.unparse(node.func.value) in holders
    ]


def scopes(tree: ast.Module) -> Iterator[ast.AST]:
    """Classes and the functions outside of them."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


@pytest.mark.long
def test_what_is_declared_a_driver_gets_no_orders() -> None:
    declared = 0
    for name, tree in sources():
        for scope in scopes(tree):
            holders = set(raw_names(scope))
            declared += len(holders)
            assert orders_to(scope, holders) == [], name
    assert declared > 0, "the search finds no driver at all: it is blind"


@pytest.mark.long
def test_the_service_itself_runs_nothing_of_its_guard() -> None:
    module = AFTER_DEATH.removesuffix(".py").replace("/", ".")
    for name, tree in sources():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module == module:
                assert [one.name for one in node.names] == ["HELD_UP"], name
            if isinstance(node, ast.Import):
                assert module not in [one.name for one in node.names], name


def test_the_search_sees_an_order_to_a_driver() -> None:
    tree = ast.parse(
        "class Sly:\n"
        "    def __init__(self, mount: Mount) -> None:\n"
        "        self._there = mount\n"
        "    async def go(self, place):\n"
        "        await self._there.slew(place)\n"
        "async def sly(url):\n"
        "    mount = open_mount(url)\n"
        "    await mount.sync(1)\n"
    )
    seen = [orders_to(scope, set(raw_names(scope))) for scope in scopes(tree)]
    assert seen == [["self._there.slew(place)"], ["mount.sync(1)"]]


@pytest.mark.long
def test_nobody_takes_a_checked_mount_apart_and_only_the_navigator_makes_one() -> None:
    makers = set()
    for name, tree in sources():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] == "CheckedMount":
                makers.add(name)
            if isinstance(node, ast.Attribute) and node.attr == "_mount":
                assert ast.unparse(node.value) == "self", f"{name}: {ast.unparse(node)}"
    assert len(makers) == 1, makers
    assert makers <= {"mountnav/navigation/navigator.py", "mountnav/navigation/equipment.py"}


def test_each_order_that_reaches_a_driver_comes_from_the_checked_mount(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    came: list[tuple[str, bool]] = []

    def spied(order: str) -> None:
        given = getattr(SimulatedMount, order)

        async def spy(self: SimulatedMount, *args: object, **named: object) -> object:
            frame: FrameType | None = sys._getframe(1)
            files: list[str] = []
            while frame is not None and len(files) < 6:
                files.append(frame.f_code.co_filename)
                frame = frame.f_back
            came.append((order, any(CHECKED in file for file in files)))
            return await given(self, *args, **named)

        monkeypatch.setattr(SimulatedMount, order, spy)

    # rates and moved axes: `tests.mount.test_offset_rates` and `test_moved_axes` order them
    for order in ORDERS - {"set_park"} - BESIDE_STARS:
        spied(order)

    async def work(rig: Rig) -> None:
        assert await rig.mount.slew(rig.place(-20.0, 40.0)) is SlewOutcome.ARRIVED
        await rig.mount.sync((await rig.mount.reading()).place)
        await rig.mount.guide(Direction.NORTH, 0.5)
        await rig.mount.set_tracking(True)
        await rig.mount.stop()
        await rig.mount.home()
        await rig.mount.park()
        await rig.mount.unpark()

    run(work)
    assert {order for order, _ in came} == ORDERS - {"set_park"} - BESIDE_STARS
    assert all(checked for _, checked in came)
