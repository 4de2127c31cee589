"""The dead man's guard as a process: it ends rates and moved axes of one mount when the service is dead.

It holds one end of a socket pair to the service, whose other end goes with the service, however it dies.
While nothing goes on by itself at the mount it does nothing at all. Its standard library is enough until it
has to act; only then it loads the drivers.

::

    {"of": {...}}                 who and where: the first line; no password stands in a list of processes
    {"arm": 30.0, "what": [...]}  to be ended in 30 s, or when the service dies
    {"disarm": true}              nothing goes on any more
    {"take_over": true}           the service lets the mount go without having ended it
    {"end": true}                 the service ends in order

A service that lives is not fought: the guard acts when the service is dead, or has not been heard of in time
(then a serial port is still held by it, and opening it is tried until it isn't), or hands the mount over. A
service that was started meanwhile isn't either: who has the mount holds a lock, and the journal tells the
new service what to end (`api.observatory.restart`).
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

_LOOK_S = 0.5
"""How often it looks whether its parent is still the same, s: a descriptor that leaked into a child of the
service would hide its death. Doubled, such a death is noticed half a second later."""
_AGAIN_S = 1.0
"""Between two tries, s, ..."""
_LATER_S = 10.0
"""... and after the first ten. Doubled, a mount that is plugged in again goes on for so much longer."""
_TRIES_SOON = 10
"""So many tries come one after the other. Chosen by hand: a line of a process that died is free at once."""
_STOPS_AFTER = 3
"""After so many tries in which the mount answered and kept its rates it is stopped, and rests. Doubled, it
goes on for some seconds longer."""
_DYING_S, _DYING_LOOK_S = 10.0, 0.02
"""A dying service is waited for so long, and looked at so often, s: the kernel closes its files one after
the other, the link maybe before the lock, and under load some time before it. Doubled, a link that was closed
by a service that lives, which never happens, is acted on later."""
_GIVES_UP_S = 7200.0
"""After so long it is given up, s: what is unplugged for two hours was switched off. Doubled, it waits for
twice as long; a new service ends it in any case."""
_TRY_TAKES_S = 60.0
"""One try takes no longer, s: connecting over slow lines takes 10 s. Halved, a mount with a slow line might
never be reached."""
_MOST_BYTES = 65_536
"""Longest line from the service, bytes; a site and a URL have 400."""
_ENDING_S = 20.0
"""Asked to end (SIGTERM) while it tries, it does so for so long yet, s: systemd kills after 30 s (deploy).
Doubled, it is killed before it has written what became of it."""
_IT_ANSWERED = ("DeviceRefused", "RefusedButDone")
"""Errors of a mount that was reached; by name, since the drivers are loaded late."""
HELD_UP = frozenset({signal.SIGTERM, signal.SIGINT, signal.SIGHUP})
"""Signals that it is started without, until it has its handlers."""


class Guard:
    """What it knows, and what it does."""

    def __init__(self, link: socket.socket) -> None:
        self._link = link
        self._unread = b""
        self._parent = os.getppid()
        self._of: dict[str, Any] = {}
        self._what: list[str] = []
        self._until_s = 0.0
        self._gone = False
        self._over = False
        self._handed = False
        self.ending_s: float | None = None

    # -- news --------------------------------------------------------------------------------------

    @property
    def dead(self) -> bool:
        """Whether the service is."""
        return self._gone or os.getppid() != self._parent

    def run(self) -> None:
        """Do it until the service ends."""
        while True:
            self._hear(self._pause_s())
            if self._what and self.dead:
                self._act("the service has died")
                return
            if self._what and self._handed:
                self._act("the service let the mount go without having ended it")
            elif self._what and time.monotonic() >= self._until_s:
                self._act("the service was not heard of in time")
            if self.dead or self._over or (self.ending_s is not None and not self._what):
                return

    def _pause_s(self) -> float:
        return max(0.0, min(_LOOK_S, self._until_s - time.monotonic())) if self._what else _LOOK_S

    def _hear(self, within_s: float) -> None:
        """Take in what the service says, waiting so long for it."""
        if self._gone:
            time.sleep(min(within_s, _LOOK_S))
            return
        with contextlib.suppress(InterruptedError):
            if not select.select([self._link], [], [], within_s)[0]:
                return
            try:
                came = self._link.recv(_MOST_BYTES)
            except OSError:
                came = b""
            if not came:
                self._gone = True
                return
            *lines, self._unread = (self._unread + came).split(b"\n")
            for line in lines:
                self._told(json.loads(line))

    def _told(self, said: dict[str, Any]) -> None:
        if "of" in said:
            self._of = said["of"]
            self._parent = int(self._of["pid"])
        elif "arm" in said:
            self._until_s = time.monotonic() + float(said["arm"])
            self._what, self._handed = list(said["what"]), False
        elif "disarm" in said:
            self._what, self._handed = [], False
        elif "take_over" in said:
            self._handed = True
        elif "end" in said:
            self._over = True

    # -- acting ------------------------------------------------------------------------------------

    def _act(self, why: str) -> None:
        """End what goes on, by trying until it is done or another service has the mount."""
        began_s, tries, kept, trouble = time.monotonic(), 0, 0, ""
        self._log(f"{why}: ending {' and '.join(self._what)}")
        self._see_it_gone()
        while self._what:
            lived = not self.dead
            outcome = ""
            with _locked(self._of["lock"]) as locked:
                if not locked and not lived:
                    outcome = "left to the service that was started meanwhile"
                elif locked or lived:
                    tries += 1
                    try:
                        outcome = _ended(self._of, self._what, by_stop=kept >= _STOPS_AFTER)
                    except Exception as error:  # whatever it is, it is tried again
                        kept += type(error).__name__ in _IT_ANSWERED
                        trouble = f"{type(error).__name__}: {error}"
                        self._log(f"try {tries}: {trouble}")
            asked_s = self.ending_s
            asked = asked_s is not None and time.monotonic() > max(asked_s, began_s) + _ENDING_S
            if not outcome and (asked or time.monotonic() - began_s > _GIVES_UP_S):
                outcome = "given up"
            if outcome:
                self._report(why, outcome, tries, "" if outcome.startswith("ended") else trouble)
                self._what, self._handed = [], False
                return
            # news: the service may live on, and have ended it
            pause_s = _AGAIN_S if tries < _TRIES_SOON else _LATER_S
            until_s = time.monotonic() + pause_s
            while self._what and time.monotonic() < until_s:
                self._hear(until_s - time.monotonic())

    def _see_it_gone(self) -> None:
        """Wait until a service that dies is dead: the lock that it holds still is no other service's."""
        until_s = time.monotonic() + _DYING_S
        while self._gone and os.getppid() == self._parent and time.monotonic() < until_s:
            time.sleep(_DYING_LOOK_S)

    def _report(self, why: str, outcome: str, tries: int, trouble: str) -> None:
        self._log(f"{outcome} (tries: {tries})")
        line = {
            "utc": datetime.now(UTC).isoformat(),
            "telescope": self._of["telescope"],
            "what": self._what,
            "why": why,
            "outcome": outcome,
            "tries": tries,
            "trouble": trouble,
        }
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        try:
            number = os.open(self._of["report"], flags, 0o600)
            try:
                os.write(number, (json.dumps(line) + "\n").encode())
                os.fsync(number)
            finally:
                os.close(number)
        except OSError as error:
            self._log(f"this can't be written down: {error}")

    def _log(self, what: str) -> None:
        # the service's standard error may have gone with it
        with contextlib.suppress(OSError, ValueError):
            print(f"mountnav: guard of {self._of.get('telescope')}: {what}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def _locked(path: str) -> Iterator[bool]:
    """Hold the lock of the mount for oneself, if no service has it; whether that is so.

    A lock of the process (POSIX), not of the file that is open: children of a service that died don't hold
    it.
    """
    try:
        number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    except OSError:
        # a folder that is gone or full must not keep it from acting
        yield True
        return
    try:
        try:
            fcntl.lockf(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield False
        else:
            yield True
    finally:
        os.close(number)


def _ended(of: dict[str, Any], what: list[str], *, by_stop: bool) -> str:
    """Open the mount, end what goes on, and see that it has. Raises whatever goes wrong."""
    import asyncio

    async def in_time() -> str:
        async with asyncio.timeout(_TRY_TAKES_S):
            return await _end(of, what, by_stop=by_stop)

    return asyncio.run(in_time())


async def _end(of: dict[str, Any], what: list[str], *, by_stop: bool) -> str:
    from drivers.registry import open_mount
    from mountnav.devices import STARS_RATES, MovesAxes, Skill, Skilled, TakesOffsetRates, skills_of
    from mountnav.errors import DeviceError, DeviceRefused
    from mountnav.sky.coordinates import Site

    mount = open_mount(of["url"], name=of["telescope"], site=Site(*of["site"]))
    await mount.open()
    done = []
    try:
        skills = skills_of(mount)
        if "move-axis" in what:
            try:
                if Skill.MOVE_AXIS in skills and isinstance(mount, MovesAxes):
                    await mount.move_axis("primary", 0.0)
                    await mount.move_axis("secondary", 0.0)
                else:
                    await mount.stop()
            except DeviceError:
                await mount.stop()
            done.append("moved axes")
        if "offset-rates" in what and by_stop and Skill.TRACK in skills and isinstance(mount, Skilled):
            # it keeps its rates, whatever it is told: standing still is better than that
            await mount.stop()
            await mount.set_tracking(False)
            done.append(
                "rates beside the stars', by a stop: it kept them when it was told to end them, and rests"
            )
        elif "offset-rates" in what:
            if of["on_loss"] == "stop":
                await mount.stop()
            if Skill.OFFSET_RATES in skills and isinstance(mount, TakesOffsetRates):
                await mount.set_offset_rates(STARS_RATES)
                said = await mount.offset_rates()
                if said is not None and max(abs(said.ra_arcsec_s), abs(said.dec_arcsec_s)) > of["zero"]:
                    raise DeviceRefused(f"it says that it still has rates of {said}")
            elif of["on_loss"] != "stop":
                # it has lost that skill: nothing is surer than a mount that stands still
                await mount.stop()
            if of["on_loss"] == "stop" and Skill.TRACK in skills and isinstance(mount, Skilled):
                await mount.set_tracking(False)
            done.append("offset rates")
    finally:
        with contextlib.suppress(DeviceError):
            await mount.close()
    return f"ended: {', '.join(done)}"


def main() -> None:
    """Guard the mount of the service that holds the other end of the socket named on the command line."""
    link = socket.socket(fileno=int(sys.argv[1]))
    guard = Guard(link)

    def asked_to_end(number: int, frame: object) -> None:
        # what is to be ended is ended first
        guard.ending_s = guard.ending_s or time.monotonic()

    signal.signal(signal.SIGTERM, asked_to_end)
    # a terminal's are for the service
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, HELD_UP)
    guard.run()


if __name__ == "__main__":
    main()
