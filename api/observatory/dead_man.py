"""The dead man's guard of one mount, as the service holds it; the lock that says who has the mount; reports.

See `api.observatory.dead_man_process`: what the guard does. It is started with the first rates or the first
axis that is moved, and lives as long as the service.

A fake that the service runs itself needs none: it dies with the service, and can't be opened from outside.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import hashlib
import json
import logging
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Collection
from datetime import datetime
from pathlib import Path
from typing import Any

from api.observatory.dead_man_process import HELD_UP
from mountnav.clock import utc_now
from mountnav.errors import DeviceRefused
from mountnav.files import cache_folder, make_private_folder, open_lock, read_text
from mountnav.mount import OnLoss, SelfActing
from mountnav.sky.coordinates import Site
from mountnav.start_up import by_one_thread

_log = logging.getLogger(__name__)

_WAITS_S = 30.0
"""So long a mount that a guard holds is waited for, s: a guard's try over a slow line takes 10 s. Doubled, a
service waits twice as long for a guard that hangs; then it opens the mount all the same."""
_LOOK_S = 0.2
"""How often it is looked whether the guard has let it go, s."""
_ENDS_WITHIN_S = 2.0
"""A guard without work ends in this time, s. Doubled, a service whose guard has work ends so much later."""
_at_work: list[subprocess.Popen[bytes]] = []
"""Guards that this process leaves at their work."""
_ZERO_ARCSEC_S = 5e-4
"""Rates below this are none for the guard, ″/s; see `mountnav.mount.offset_rates`."""


class MountGuard:
    """The guard of one mount: a `mountnav.mount.Deadman`.

    Parameters
    ----------
    telescope : str
        Its id.
    url : str
        By which the mount is opened again.
    folder : Path, optional
        Where lock and reports are; a folder in the cache, if left out.
    """

    def __init__(
        self, telescope: str, url: str, site: Site, on_loss: OnLoss, *, folder: Path | None = None
    ) -> None:
        self._telescope, self._url, self._site, self._on_loss = telescope, url, site, on_loss
        folder = folder or cache_folder() / "guards"
        name = f"{telescope}-{hashlib.sha256(url.encode()).hexdigest()[:12]}"
        self._folder, self._lock_file = folder, folder / f"{name}.lock"
        self._report_file = folder / f"{name}.jsonl"
        self._process: subprocess.Popen[bytes] | None = None
        self._link: socket.socket | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._armed: tuple[float, list[SelfActing]] | None = None
        self._lock: int | None = None

    @property
    def pid(self) -> int | None:
        """Of its process; None while there is none."""
        process = self._process
        return None if process is None or process.poll() is not None else process.pid

    # -- armed and disarmed ------------------------------------------------------------------------

    def arm(self, until_utc: datetime, what: Collection[SelfActing]) -> None:
        """Have it end this if the service dies, or isn't heard of until then.

        Raises
        ------
        DeviceRefused
            It can't be started, or takes no orders.
        """
        left_s = (until_utc - utc_now()).total_seconds()
        self._order(time.monotonic() + left_s, sorted(what))

    def _order(self, until_s: float, what: list[SelfActing]) -> None:
        order = {"arm": max(until_s - time.monotonic(), 0.0), "what": what}
        if self.pid is None:
            self._start()
        try:
            self._say(order)
        except OSError:
            # it has died since, or hangs: another one
            self._start()
            try:
                self._say(order)
            except OSError as error:
                self._drop()
                raise self._no_guard(error) from error
        self._armed = until_s, what

    def disarm(self) -> None:
        """Nothing goes on by itself any more."""
        self._armed = None
        self._say_if_it_lives({"disarm": True})

    def take_over(self) -> None:
        """The mount is let go without having been ended."""
        self._say_if_it_lives({"take_over": True})
        # what it does from now on is its own
        self._armed = None

    def _ended(self) -> None:
        """Its process has ended by itself: while it is needed there has to be another one."""
        armed = self._armed
        self._drop()
        if armed is None:
            return
        _log.warning("%s: the guard has died: another one is started", self._telescope)
        try:
            self._order(*armed)
        except DeviceRefused as error:
            _log.error(
                "%s: if the service died, nothing would end what the mount is doing: %s",
                self._telescope,
                error,
            )

    async def close(self) -> None:
        """End it; one that has work ends by itself after that. Twice is fine."""
        self._armed = None
        self._say_if_it_lives({"end": True})
        process = self._process
        self._drop(kill=False)
        if process is not None:
            try:
                await asyncio.to_thread(process.wait, _ENDS_WITHIN_S)
            except subprocess.TimeoutExpired:
                _at_work.append(process)

    def _no_guard(self, error: OSError) -> DeviceRefused:
        return DeviceRefused(
            f"the guard process, which ends motion if the service dies, can't be started: {error}",
            device=self._telescope,
            advice="see the service's log; without a guard nothing may go on by itself "
            "(following.guard = false, if that is meant)",
        )

    def _start(self) -> None:
        self._drop()
        try:
            make_private_folder(self._folder)
            ours, theirs = socket.socketpair()
        except OSError as error:
            raise self._no_guard(error) from error
        ours.setblocking(False)
        try:
            self._process = _spawned(theirs.fileno())
        except OSError as error:
            ours.close()
            raise self._no_guard(error) from error
        finally:
            theirs.close()
        self._link = ours
        with contextlib.suppress(RuntimeError):
            self._loop = asyncio.get_running_loop()
            # it says nothing: what can be read is its end
            self._loop.add_reader(ours, self._ended)
        site = self._site
        try:
            self._say(
                {
                    "of": {
                        "pid": os.getpid(),
                        "telescope": self._telescope,
                        "url": self._url,
                        "site": [site.latitude_deg, site.longitude_deg, site.height_m],
                        "on_loss": self._on_loss,
                        "zero": _ZERO_ARCSEC_S,
                        "lock": str(self._lock_file),
                        "report": str(self._report_file),
                    }
                }
            )
        except OSError as error:
            self._drop()
            raise self._no_guard(error) from error

    def _say(self, order: dict[str, Any]) -> None:
        if self._link is None:
            raise BrokenPipeError(32, "it has ended")
        line = (json.dumps(order) + "\n").encode()
        # some hundred bytes find room, or it hangs
        if self._link.send(line) != len(line):
            raise BrokenPipeError(32, "it takes no more orders")

    def _say_if_it_lives(self, order: dict[str, Any]) -> None:
        with contextlib.suppress(OSError):
            self._say(order)

    def _drop(self, *, kill: bool = True) -> None:
        """Let its process go."""
        link, self._link = self._link, None
        loop, self._loop = self._loop, None
        if link is not None and loop is not None and not loop.is_closed():
            loop.remove_reader(link)
        process, self._process = self._process, None
        if process is not None and kill and process.poll() is None:
            process.kill()
        if link is not None:
            link.close()
        if process is not None and kill:
            process.wait()

    # -- who has the mount -------------------------------------------------------------------------

    async def hold(self) -> None:
        """Wait until no guard of an earlier run has the mount, and hold it; once is enough."""
        if self._lock is not None:
            return
        loop = asyncio.get_running_loop()
        until_s, told = loop.time() + _WAITS_S, False
        try:
            make_private_folder(self._folder)
            number = open_lock(self._lock_file)
        except OSError as error:
            _log.warning("%s: guards can't find out who controls the mount: %s", self._telescope, error)
            return
        while True:
            try:
                # other services may have it as well: some mounts serve several
                fcntl.lockf(number, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except OSError:
                if loop.time() > until_s:
                    _log.warning("%s: a guard of an earlier run still controls the mount", self._telescope)
                    os.close(number)
                    return
                if not told:
                    told = True
                    _log.info("%s: the guard of an earlier run is at work: waiting", self._telescope)
                await asyncio.sleep(_LOOK_S)
            else:
                self._lock = number
                return

    def release(self) -> None:
        """Let it be another's; once is enough."""
        number, self._lock = self._lock, None
        if number is not None:
            os.close(number)

    # -- what guards have done ---------------------------------------------------------------------

    def reports(self) -> list[dict[str, Any]]:
        """What guards of earlier runs have written and nobody has told yet; blocks, never raises."""
        found: list[dict[str, Any]] = []
        try:
            lines = read_text(self._report_file).splitlines()
        except (OSError, UnicodeDecodeError):
            return found
        for line in lines[-_MOST_REPORTS:]:
            with contextlib.suppress(ValueError):
                one = json.loads(line)
                if isinstance(one, dict):
                    found.append(one)
        return found

    def told(self) -> None:
        """They have been told, and written down."""
        with contextlib.suppress(OSError):
            self._report_file.unlink(missing_ok=True)


_MOST_REPORTS = 100
"""So many of the latest reports are told; there is one for each death of the service."""


def _spawned(link: int) -> subprocess.Popen[bytes]:
    environment = dict(os.environ)
    # the same modules as here, wherever this process found them
    environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    by_one_thread(environment)
    # a signal that comes before it has its handlers must not end it: it inherits this thread's mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, HELD_UP)
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "api.observatory.dead_man_process", str(link)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=[link],
            env=environment,
            # what ends the service's group must not end its guard
            start_new_session=True,
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
