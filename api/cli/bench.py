"""`mountnav bench`: tries an owner's mount step by step, compares it with a fake, and keeps what was said."""

from __future__ import annotations

import json
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from api.cli.options import takes_options
from mountnav.errors import BadRequest

if TYPE_CHECKING:
    from drivers.acceptance.report import Capabilities, StepResult
    from drivers.acceptance.steps import Ask, Step
    from drivers.generic.mount import GenericMount
    from drivers.wire.wire_log import WireEntry
    from mountnav.simulation.machine import Machine, Mounting
    from mountnav.sky.coordinates import Site

FAKE_WATCH_S = 5.0
"""So long the fake's tracking is watched at most. chosen: a fake tracks evenly, so that more shows nothing
new; the owner's patience is for the real mount."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchOptions:
    """The options of the command."""

    url: Annotated[str, typer.Argument(help="The mount, such as lx200+serial:///dev/ttyUSB0.")]
    latitude: Annotated[float, typer.Option(min=-90, max=90, help="Where it stands, degrees.")]
    longitude: Annotated[float, typer.Option(min=-180, max=180, help="Degrees, east positive.")]
    step: Annotated[
        list[str] | None,
        typer.Option(
            help="Only read, move, stop, sync, track, guide, rates, move-axis, limit, flip, park; repeatable."
        ),
    ] = None
    yes: Annotated[bool, typer.Option("--yes", help="Don't ask before each step. It moves!")] = False
    compare: Annotated[
        bool, typer.Option("--compare/--no-compare", help="Try the same on a fake of its family.")
    ] = True
    dialect: Annotated[str | None, typer.Option(help="Dialect of that fake; see `fake-mount --list`.")] = None
    mounting: Annotated[
        Literal["fork", "german"] | None,
        typer.Option(help="Build of that fake; as the mount shows itself, or its family usually is."),
    ] = None
    report: Annotated[Path | None, typer.Option(help="Write the findings to this file (JSON).")] = None
    transcript: Annotated[
        Path | None,
        typer.Option(help="Write the dialogue to this file, for `fake-mount --replay`."),
    ] = None
    watch: Annotated[float, typer.Option(min=1, max=3600, help="Seconds to watch it track.")] = 30.0
    lowest: Annotated[float, typer.Option(min=0, max=80, help="Lowest altitude to be sent to.")] = 20.0


def try_mount(asked: BenchOptions) -> int:
    """Try a real mount step by step, each step asked for; a fake in its place tries the steps."""
    import asyncio

    from mountnav.sky.iers import read_tables

    steps = _steps(tuple(asked.step or ()))
    for path in (asked.report, asked.transcript):
        if path is not None and not path.absolute().parent.is_dir():
            raise BadRequest(f"{path.parent} is not a folder", advice="give another path")
    read_tables()
    try:
        return asyncio.run(_run(asked, steps))
    except asyncio.CancelledError:
        return 128 + signal.SIGTERM


bench = takes_options(BenchOptions)(try_mount)


def _steps(names: tuple[str, ...]) -> list[Step]:
    """The steps of these names, in the order of the trial; all without names."""
    from drivers.acceptance.steps import STEPS

    known = {step.name: step for step in STEPS}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise BadRequest(f"there is no step {', '.join(unknown)}", advice=f"there is: {', '.join(known)}")
    return [step for step in STEPS if not names or step.name in names]


async def _run(asked: BenchOptions, steps: list[Step]) -> int:
    """Try the mount, then a fake; 0 if all that was tried is as it should be, else 1."""
    from drivers.acceptance.report import as_lines
    from drivers.acceptance.steps import empty_report, run_steps
    from drivers.acceptance.trial import Trial
    from drivers.registry import fake_protocols, read_url
    from mountnav.sky.coordinates import Air, Site

    site = Site(asked.latitude, asked.longitude)
    url = read_url(asked.url)
    mount = _mount(asked.url, site)
    found: Capabilities | None = None
    fake: Capabilities | None = None
    with ExitStack() as ending, _interruptible():
        if asked.transcript is not None:
            _keep_transcript(asked, asked.transcript, mount, ending)
        try:
            await mount.open()
            _greet(mount)
            trial = Trial(mount, site, Air(), asked.lowest, asked.watch)
            found = empty_report(trial, url.driver)
            await run_steps(found, trial, steps, _asker(yes=asked.yes), _print_result)
        finally:
            # an interrupted slew has been stopped by now
            await mount.close()
            if found is not None:
                _write_report(asked, found, None)
        done = [step for step, result in zip(steps, found.steps, strict=True) if result.done]
        if asked.compare and url.driver in fake_protocols():
            dialect = asked.dialect or _dialect_of(mount, url.driver)
            build = build_of(found, mount, url.driver, asked.mounting)
            fake = await _of_fake(asked, url.driver, dialect, build, site, done)
    print()
    print("\n".join(as_lines(found, fake)))
    _write_report(asked, found, fake)
    return 0 if found.is_fine else 1


@contextmanager
def _interruptible() -> Iterator[None]:
    """A closed terminal or a shutdown ends the trial as an interrupt does: what moves is stopped first."""
    import asyncio

    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    assert task is not None
    endings = (signal.SIGTERM, signal.SIGHUP) if threading.current_thread() is threading.main_thread() else ()
    for number in endings:
        loop.add_signal_handler(number, task.cancel)
    try:
        yield
    finally:
        for number in endings:
            loop.remove_signal_handler(number)


def _write_report(asked: BenchOptions, found: Capabilities, fake: Capabilities | None) -> None:
    if asked.report is not None:
        both = {"mount": found.as_dict(), "fake": None if fake is None else fake.as_dict()}
        asked.report.write_text(json.dumps(both, indent=1) + "\n", encoding="utf-8")


def _mount(url: str, site: Site) -> GenericMount:
    from drivers.generic.mount import GenericMount
    from drivers.registry import open_mount

    mount = open_mount(url, site=site)
    if not isinstance(mount, GenericMount):
        raise BadRequest(
            "its driver is not part of mountnav", device=url, advice="use mountnav.testing.check_mount"
        )
    return mount


def _greet(mount: GenericMount) -> None:
    report = mount.report
    if report is not None:
        print(f"{report.identity} at {mount.name}")
        for problem in report.problems:
            print(f"problem: {problem}")


def _asker(*, yes: bool) -> Ask:
    """Asks the owner before each step, or says yes in their place."""
    import asyncio

    async def ask(question: str) -> bool:
        if yes:
            print(f"{question} yes")
            return True
        answer = await asyncio.to_thread(input, f"{question} [y/N] ")
        return answer.strip().lower() in ("y", "yes")

    return ask


def _print_result(result: StepResult) -> None:
    bad = [finding.key for finding in result.findings if finding.fine is False]
    end = f"not as it should be: {', '.join(bad)}" if bad else "ok"
    if not result.done:
        end = f"not done, {result.why_not}"
    print(f"  {result.name}: {end}", flush=True)


def _dialect_of(mount: GenericMount, protocol: str) -> str:
    """The dialect that the handshake found, as the fakes call it; the usual one if it names none."""
    from drivers.registry import fake_dialects

    spoken = getattr(mount.language, "dialect", None)
    name = str(getattr(spoken, "name", spoken))
    known = fake_dialects(protocol)
    return name if name in known else known[0]


def build_of(found: Capabilities, mount: GenericMount, protocol: str, mounting: Mounting | None) -> Machine:
    """How the fake is built that the mount is compared with: as the mount shows itself to be.

    Whether it changes sides on the way across the meridian says it; else what its hand control calls it, or
    that it tells a side of a pier at all. What shows nothing is built as its family usually is.

    Parameters
    ----------
    found : Capabilities
        Of the mount.
    mounting : {"fork", "german"} or None
        What the owner says, before all else.
    """
    from drivers.registry import fake_machine
    from mountnav.devices import PierSide

    usual = fake_machine(protocol)
    if mounting is None:
        values = {key: finding.value for key, finding in found.findings().items()}
        handset = getattr(mount.language, "handset", None)
        crossed = {"flips": True, "stays": False}.get(str(values.get("flip")))
        if crossed is None:
            sides = {str(PierSide.EAST), str(PierSide.WEST)}
            tells_side = str(values.get("read.pier-side")) in sides
            crossed = tells_side if handset is None or handset.model is None else handset.german
            crossed = crossed or usual.mounting == "german"
        mounting = "german" if crossed else "fork"
    return replace(usual, mounting=mounting)


async def _of_fake(
    asked: BenchOptions, protocol: str, dialect: str, build: Machine, site: Site, steps: list[Step]
) -> Capabilities:
    """The same steps on a fake of the same family and build, without asking."""
    from drivers.acceptance.steps import run_trial
    from drivers.acceptance.trial import Trial
    from drivers.fakes.bench import FakeOnPty
    from drivers.generic.options import PORT_OPTIONS
    from drivers.registry import make_fake, read_url
    from mountnav.clock import utc_now
    from mountnav.simulation.mechanics import Mechanics
    from mountnav.simulation.pointing_errors import PointingErrors
    from mountnav.sky.coordinates import Air

    mechanics = Mechanics(site, Air(), PointingErrors(), machine=build)
    fake = make_fake(protocol, dialect, mechanics, clock=utc_now, monotonic=time.monotonic)
    with ExitStack() as stack:
        bench = stack.enter_context(FakeOnPty(fake))
        query = read_url(asked.url).options
        options = "&".join(f"{name}={value}" for name, value in query.items() if name not in PORT_OPTIONS)
        mount = _mount(f"{protocol}+serial://{bench.address}{'?' * bool(options)}{options}", site)
        try:
            await mount.open()
            mount.trust()
            trial = Trial(mount, site, Air(), asked.lowest, min(asked.watch, FAKE_WATCH_S))
            return await run_trial(trial, steps, _asker_of_fake, driver=protocol)
        finally:
            await mount.close()


async def _asker_of_fake(question: str) -> bool:
    return True


def _keep_transcript(asked: BenchOptions, path: Path, mount: GenericMount, ending: ExitStack) -> None:
    """Write all that is said as it is said: the greeting, which names the mount, and however it ends."""
    from drivers.registry import read_url
    from mountnav.clock import utc_now

    file = ending.enter_context(path.open("w", encoding="utf-8", buffering=1))
    header = {
        "driver": read_url(asked.url).driver,
        "device": mount.name,
        "began": utc_now().isoformat(timespec="seconds"),
    }
    file.write(json.dumps({"t": 0, "dir": "header", **header}) + "\n")

    def write(entry: WireEntry) -> None:
        if not file.closed:
            file.write(entry.as_json() + "\n")

    mount.wire_log.listen(write)
