"""`mountnav fake-mount`: a fake on a pseudo-terminal, a TCP or a UDP port, until interrupted."""

from __future__ import annotations

import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.options import takes_options
from api.cli.output import reason_of
from mountnav.errors import BadRequest, BadSettings, DeviceMissing

if TYPE_CHECKING:
    from types import FrameType

    from drivers.fakes.bench import Bench, Fake
    from drivers.fakes.wire_fake import WireFake
    from mountnav.simulation.mechanics import Mechanics
    from mountnav.simulation.sky_clock import FastClock

AIR_PRESSURE_HPA = 1010.0
"""Of the air that a fake without a mechanics file refracts through, as mechanics files have it by default:
near sea level. Doubled, the fake's refraction doubles, about 1′ more at an altitude of 45°."""
_ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Ctrl-C, a supervisor, and a terminal that was closed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FakeMountOptions:
    """The options of the command."""

    protocol: Annotated[
        str, typer.Option(help="What it speaks: lx200, nexstar, synscan, ioptron, skywatcher.")
    ] = "lx200"
    dialect: Annotated[str | None, typer.Option(help="How it speaks it; --list shows them.")] = None
    list_all: Annotated[bool, typer.Option("--list", help="List protocols and dialects, and exit.")] = False
    link: Annotated[Path | None, typer.Option(help="Make this a symlink to the pseudo-terminal.")] = None
    tcp: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="Serve on TCP instead.")] = None
    udp: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="Serve on UDP instead.")] = None
    baud: Annotated[int | None, typer.Option(min=50, help="Delay bytes as a line of this speed does.")] = None
    mechanics: Annotated[Path | None, typer.Option(help="How the mount is built (TOML).")] = None
    errors: Annotated[Path | None, typer.Option(help="Pointing errors (TOML).")] = None
    faults: Annotated[Path | None, typer.Option(help="What goes wrong, and when (TOML).")] = None
    seed: Annotated[int | None, typer.Option(help="Seed of the random faults, instead of the file's.")] = None
    struck: Annotated[
        Path | None,
        typer.Option(
            help="At the end, write the faults that occurred to this file; it repeats them as a faults file."
        ),
    ] = None
    speed: Annotated[float | None, typer.Option(min=0.01, max=1000, help="How fast its time runs.")] = None
    record: Annotated[Path | None, typer.Option(help="Write the dialogue here (JSON lines).")] = None
    replay: Annotated[
        Path | None, typer.Option(help="Take its identity from this recording of a real mount.")
    ] = None
    latitude: Annotated[float, typer.Option(min=-90, max=90, help="Degrees.")] = 47.0
    longitude: Annotated[float, typer.Option(min=-180, max=180, help="Degrees, east positive.")] = 11.0


def serve_fake(asked: FakeMountOptions) -> int:
    """Serve a fake mount until interrupted; prints its address when it is ready."""
    if asked.list_all:
        return _list_fakes()
    _refuse_contradictions(asked)
    address = _address(asked)
    with _ending_signal() as wait_for_end, ExitStack() as ending:
        from mountnav.sky.iers import read_tables

        read_tables()
        clock, mechanics = _telescope(asked)
        fake = _fake(asked, clock, mechanics)
        if asked.struck is not None:
            ending.callback(_write_struck, asked.struck, fake)
        bench = _bench(asked, _around(asked, fake, clock, ending), address)
        try:
            bench.start()
        except OSError as error:
            raise DeviceMissing(
                f"can't be served: {reason_of(error)}",
                device=asked.tcp or asked.udp or str(asked.link),
                advice="give another address",
            ) from error
        ending.callback(bench.stop)
        print(bench.address, flush=True)
        wait_for_end()
    return 0


fake_mount = takes_options(FakeMountOptions)(serve_fake)


def _list_fakes() -> int:
    from drivers.registry import fake_dialects, fake_protocols

    for protocol in fake_protocols():
        print(f"{protocol}: {', '.join(fake_dialects(protocol))}")
    return 0


@contextmanager
def _ending_signal() -> Iterator[Callable[[], None]]:
    """Gives what waits for SIGINT, SIGTERM or SIGHUP, from now on; the handlers of before are given back.

    Handlers, and no mask: numpy's BLAS has started threads by now that don't share the main thread's mask,
    and a signal that one of them takes would end the process before the symlink is removed. A handler
    writes to a socket whichever thread takes the signal, and a signal that comes early is still in it.
    """
    heard, written = socket.socketpair()
    with heard, written:
        written.setblocking(False)
        fd_before = signal.set_wakeup_fd(written.fileno(), warn_on_full_buffer=False)
        # under nohup a closed terminal is ignored, and shall be
        taken = [number for number in _ENDING_SIGNALS if number is not signal.SIGHUP or not _ignored(number)]
        before = {number: signal.signal(number, _nothing) for number in taken}
        try:
            yield lambda: _wait(heard)
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(fd_before)


def _ignored(number: signal.Signals) -> bool:
    return signal.getsignal(number) == signal.SIG_IGN


def _wait(heard: socket.socket) -> None:
    heard.recv(1)


def _nothing(number: int, frame: FrameType | None) -> None:
    """A handler is what makes the signal reach the wake-up descriptor."""


def _refuse_contradictions(asked: FakeMountOptions) -> None:
    wires = [
        name
        for name, given in (("--link", asked.link), ("--tcp", asked.tcp), ("--udp", asked.udp))
        if given is not None
    ]
    if len(wires) > 1:
        raise BadRequest(f"{' and '.join(wires)} together", advice="give one of them")
    if asked.udp is not None and asked.baud is not None:
        raise BadRequest("--udp has no speed", advice="leave --baud out")
    if asked.mechanics is not None and asked.errors is not None:
        raise BadRequest("--mechanics and --errors together", advice="put [errors] into the mechanics file")
    if asked.link is not None and asked.link.exists() and not asked.link.is_symlink():
        raise BadRequest(f"{asked.link} exists and is not a symlink", advice="give a path that is free")
    if asked.struck is not None and not asked.struck.parent.is_dir():
        raise BadRequest(f"{asked.struck.parent} is not a folder", advice="give another path to --struck")


def _address(asked: FakeMountOptions) -> tuple[str, int] | None:
    for option, text in (("--tcp", asked.tcp), ("--udp", asked.udp)):
        if text is not None:
            return _host_and_port(option, text)
    return None


def _fake(asked: FakeMountOptions, clock: FastClock, mechanics: Mechanics) -> WireFake:
    from drivers.fakes.faults import FaultScript, read_faults
    from drivers.fakes.recording import profile_of, read_dialogue
    from drivers.registry import make_fake

    script = FaultScript() if asked.faults is None else read_faults(asked.faults, seed=asked.seed)
    fake = make_fake(
        asked.protocol,
        asked.dialect,
        mechanics,
        faults=script.faults,
        clock=clock,
        monotonic=clock.monotonic,
    )
    fake.chance = script.chance
    if asked.replay is not None:
        taken = fake.take_profile(profile_of(read_dialogue(asked.replay), fake))
        if not taken:
            raise BadSettings(
                f"it holds no answer that identifies a {asked.protocol} mount",
                device=str(asked.replay),
                advice="record the greeting as well",
            )
    return fake


def _telescope(asked: FakeMountOptions) -> tuple[FastClock, Mechanics]:
    """The mechanics, and the clock that all of it goes by."""
    from drivers.registry import fake_machine
    from mountnav.simulation.machine_file import MachineFile
    from mountnav.simulation.mechanics import Mechanics
    from mountnav.simulation.pointing_errors import PointingErrors
    from mountnav.simulation.sky_clock import FastClock
    from mountnav.sky.coordinates import Air, Site

    site = Site(asked.latitude, asked.longitude)
    if asked.mechanics is not None:
        built = MachineFile.from_toml(asked.mechanics)
        clock = FastClock(asked.speed or built.clock_speed, built.clock_start_utc)
        return clock, built.make_mechanics(clock=clock, site=site)
    clock = FastClock(asked.speed or 1.0)
    pointing = PointingErrors() if asked.errors is None else PointingErrors.from_toml(asked.errors)
    built_as = fake_machine(asked.protocol)
    return clock, Mechanics(site, Air(pressure_hpa=AIR_PRESSURE_HPA), pointing, machine=built_as, clock=clock)


def _around(asked: FakeMountOptions, fake: WireFake, clock: FastClock, ending: ExitStack) -> Fake:
    from drivers.fakes.bench.thread import InFastTime
    from drivers.fakes.recording import Recorder

    spoken: Fake = fake if clock.speed == 1.0 else InFastTime(fake, clock)
    if asked.record is None:
        return spoken
    header = {"driver": "unknown", "fake": asked.protocol, "dialect": asked.dialect or "usual"}
    return ending.enter_context(Recorder(spoken, asked.record, header))


def _bench(asked: FakeMountOptions, fake: Fake, address: tuple[str, int] | None) -> Bench:
    from drivers.fakes.bench import FakeOnPty, FakeOnTcp, FakeOnUdp

    if address is None:
        return FakeOnPty(fake, asked.link, baud=asked.baud)
    return FakeOnTcp(fake, *address, baud=asked.baud) if asked.udp is None else FakeOnUdp(fake, *address)


def _write_struck(path: Path, fake: WireFake) -> None:
    from drivers.fakes.faults import faults_as_toml, scripted

    path.write_text(faults_as_toml(scripted(fake.strikes)), encoding="utf-8")


def _host_and_port(option: str, text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and int(port) <= 65535):
        raise BadRequest(f"{option} {text} is not HOST:PORT", advice=f"for example {option} 127.0.0.1:4030")
    return host.strip("[]"), int(port)
