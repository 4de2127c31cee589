"""The solver daemon: a warm solver behind its socket, which ends when it had nothing to do for long.

``python -m api.solver_daemon.daemon`` is started by the first stub that finds no solver, or by
`mountnav solver start`. A second one of the same user ends at once.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from api.solver.solver import Solver
from api.solver_daemon.connection import OwnWord
from api.solver_daemon.listener import SolverOnLoop, SolverSocket, socket_path
from mountnav import __version__
from mountnav.catalog.catalog_set import open_catalogs
from mountnav.errors import MountnavError
from mountnav.files import make_private_folder
from mountnav.solving.settings import SolveSettings

_log = logging.getLogger(__name__)

IDLE_S = 1800.0
"""The daemon ends after so long without a call: 250 MB. Half an hour is longer than any exposure; doubled, it
holds its memory half an hour longer."""
LOOK_EACH_S = 1.0
"""How often it looks whether it was idle for too long, s."""
LONGEST_LOG_BYTES = 1_000_000
"""A longer log is begun again when a daemon starts."""


class Daemon:
    """A solver and its socket, until it is idle for too long or told to stop.

    Parameters
    ----------
    idle_s : float
        See `IDLE_S`.
    tcp_port : int or None
        See `SolverSocket`.
    """

    def __init__(self, *, idle_s: float = IDLE_S, tcp_port: int | None = None) -> None:
        self._idle_s, self._tcp_port = idle_s, tcp_port
        self._over = asyncio.Event()
        self._began_s = time.monotonic()

    async def run(self, listening: Callable[[SolverSocket], None] | None = None) -> None:
        """Serve. Raises `BadSettings` where it can't be listened."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            loop.add_signal_handler(number, self._over.set)
        solver = Solver(open_catalogs(), worker=True, looks=False, tell=lambda kind, data: None)
        own = {
            "status": OwnWord(lambda: self._status(solver)),
            "stop": OwnWord(self._stops, then=lambda: loop.call_soon_threadsafe(self._over.set)),
        }
        server = SolverSocket(SolverOnLoop(solver, SolveSettings, loop), tcp_port=self._tcp_port, own=own)
        try:
            await server.start()
            # calls that come now wait for the process to be warm, no longer than by themselves
            solver.open()
            if listening is not None:
                listening(server)
            while not self._over.is_set() and server.idle_s < self._idle_s:
                try:
                    async with asyncio.timeout(LOOK_EACH_S):
                        await self._over.wait()
                except TimeoutError:
                    continue
        finally:
            await server.stop()
            await solver.close()

    def _status(self, solver: Solver) -> str:
        told = {
            "pid": os.getpid(),
            "version": __version__,
            "solver": solver.state,
            "index": solver.blind_index.state,
            "up_s": round(time.monotonic() - self._began_s, 1),
            "ends_after_idle_s": self._idle_s,
        }
        return json.dumps(told) + "\n"

    def _stops(self) -> str:
        return json.dumps({"pid": os.getpid(), "stops": True}) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the daemon; 1 if it can't listen, as where another one of this user does."""
    read = argparse.ArgumentParser(prog="api.solver_daemon.daemon", description=__doc__)
    read.add_argument("--idle-s", type=float, default=IDLE_S)
    read.add_argument("--tcp-port", type=int, default=None)
    asked = read.parse_args(arguments)
    folder = socket_path().parent
    make_private_folder(folder)
    _log_into(folder / "solver.log")
    try:
        asyncio.run(Daemon(idle_s=asked.idle_s, tcp_port=asked.tcp_port).run(_told_port(folder)))
    except MountnavError as fault:
        _log.error("%s", fault)
        print(f"mountnav: {fault}", file=sys.stderr)
        return 1
    return 0


def _told_port(folder: Path) -> Callable[[SolverSocket], None]:
    """What a daemon behind TCP writes down for those who start stubs: the value of MOUNTNAV_SOLVER."""

    def tell(server: SolverSocket) -> None:
        host, port = server.address
        if server.token:
            from mountnav.files import make_private

            path = folder / "solver.tcp"
            path.write_text("", encoding="ascii")
            make_private(path)
            path.write_text(f"tcp:{host}:{port}:{server.token}\n", encoding="ascii")
        _log.info("listening on %s", host if not port else f"{host}:{port}")

    return tell


def _log_into(path: Path) -> None:
    mode = "w" if path.exists() and path.stat().st_size > LONGEST_LOG_BYTES else "a"
    logging.basicConfig(
        filename=path, filemode=mode, level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s"
    )


if __name__ == "__main__":
    sys.exit(main())
