"""`mountnav solver`: the commands of other plate solvers, and the solver that is warm for them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from mountnav.errors import DeviceError

solver_app = typer.Typer(
    no_args_is_help=True,
    help="Commands of other plate solvers (astap, solve-field, ...), and the solver that is warm for them.",
)

START_S = 30.0
"""The daemon listens by then, s: before it has solved anything. A slow computer takes a fifth of it."""
_LOOK_EACH_S = 0.05
"""How often it is looked whether the daemon listens or has ended, s."""

Folder = Annotated[
    Path | None, typer.Option("--dir", help="Folder for the commands; one of mountnav's own if left out.")
]


@solver_app.command("install")
def install_commands(
    folder: Folder = None,
    force: Annotated[
        bool, typer.Option("--force", help="Also replace files that mountnav has not written.")
    ] = False,
) -> None:
    """Write commands named astap, solve-field, ... into a folder, for programs that call them."""
    from api.solver_daemon.installing import install, own_folder

    done = install(folder or own_folder(), force=force)
    for path in done.written:
        typer.echo(str(path))
    for path in done.kept:
        typer.echo(f"{path} is another program and stays; --force replaces it", err=True)
    typer.echo(f'set this folder in your program, or: PATH="{done.folder}:$PATH"', err=True)
    raise typer.Exit(1 if done.kept else 0)


@solver_app.command("uninstall")
def uninstall_commands(folder: Folder = None) -> None:
    """Remove these commands. Other files in the folder stay."""
    from api.solver_daemon.installing import own_folder, uninstall

    for path in uninstall(folder or own_folder()):
        typer.echo(str(path))


@solver_app.command("start")
def start(
    idle_s: Annotated[float | None, typer.Option(help="It ends after so long without a call.")] = None,
    tcp_port: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            help="Listen on this port of 127.0.0.1 with a token, for programs in a box that see no socket; "
            "0: any that is free.",
        ),
    ] = None,
) -> None:
    """Start the solver that is warm for these commands. They start it by themselves, too."""
    from api.solver_daemon.listener import socket_path

    if (there := _told("status")) is not None:
        _show(there)
        return
    arguments = [sys.executable, "-P", "-m", "api.solver_daemon.daemon"]
    arguments += [] if idle_s is None else ["--idle-s", str(idle_s)]
    arguments += [] if tcp_port is None else ["--tcp-port", str(tcp_port)]
    told_in = socket_path().with_name("solver.tcp")
    told_in.unlink(missing_ok=True)
    begun = subprocess.Popen(
        arguments,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    until_s = time.monotonic() + START_S
    while time.monotonic() < until_s:
        if tcp_port is not None and told_in.exists() and (value := told_in.read_text(encoding="ascii")):
            typer.echo(f"MOUNTNAV_SOLVER={value.strip()}")
            return
        if tcp_port is None and (there := _told("status")) is not None:
            _show(there)
            return
        if begun.poll() not in (None, 0):
            break
        time.sleep(_LOOK_EACH_S)
    raise DeviceError(
        "it is not listening", device="solver daemon", advice=f"see {socket_path().with_name('solver.log')}"
    )


@solver_app.command("stop")
def stop() -> None:
    """End that solver. Calls that it is carrying out are carried out by their own processes."""
    typer.echo("no solver was running" if _told("stop") is None else "stopped")


@solver_app.command("status")
def status() -> None:
    """Say whether a solver is running. Exit code 1 if none is."""
    found = _told("status")
    if found is None:
        typer.echo("no solver is running; the next command starts one")
        raise typer.Exit(1)
    _show(found)


def _show(found: dict[str, Any]) -> None:
    for name, value in found.items():
        typer.echo(f"{name}: {value}")


def _told(word: str) -> dict[str, Any] | None:
    """The running solver's answer to a word; None if there is none."""
    from api.solver_daemon import stub

    where = os.environ.get("MOUNTNAV_SOLVER", "")
    if where in ("", "off"):
        where = os.path.join(stub.folder(), "solver.sock")
    heard = stub.asked(where, word)
    found: dict[str, Any] | None = json.loads(heard) if heard else None
    return found
