"""What a service manager is told: that the service is up, that it lives, that it goes down [sd_notify(3)].

Outside of systemd nothing is told. The protocol is a datagram of a few lines to the socket that the
environment names; the watchdog is fed by the event loop, so that one that hangs is ended and begun again.
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket

_log = logging.getLogger(__name__)

_FEEDS = 3.0
"""So many times within its span the watchdog is fed: one late turn of the loop is no hang. With half as many
one turn that takes half of the span ends the service."""


class ServiceManager:
    """The manager that started this process, if one wants to be told.

    Parameters
    ----------
    environment : mapping, optional
        With ``NOTIFY_SOCKET``, ``WATCHDOG_USEC`` and ``WATCHDOG_PID``; that of the process by default.
    """

    def __init__(self, environment: os._Environ[str] | dict[str, str] | None = None) -> None:
        given = os.environ if environment is None else environment
        self._address = given.get("NOTIFY_SOCKET", "")
        self.watchdog_s = _watchdog_s(given)

    def tell(self, *lines: str) -> None:
        """Tell it something, such as ``READY=1``. A manager that can't be reached is no reason to stop."""
        if not self._address:
            return
        # an @ stands for the zero of an abstract name
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as link:
                link.setblocking(False)
                link.connect(address)
                link.send("\n".join(lines).encode())
        except OSError as error:
            _log.warning("the service manager can't be notified of %s: %s", lines[0], error)

    async def feed_watchdog(self) -> None:
        """Feed it for as long as the event loop turns; returns at once where there is none."""
        if not self._address or self.watchdog_s is None:
            return
        while True:
            self.tell("WATCHDOG=1")
            await asyncio.sleep(self.watchdog_s / _FEEDS)


def _watchdog_s(given: os._Environ[str] | dict[str, str]) -> float | None:
    """How long it waits between two signs of life; None where it doesn't watch this process."""
    word, of = given.get("WATCHDOG_USEC", ""), given.get("WATCHDOG_PID", "")
    if not (word.isascii() and word.isdigit() and 0 < len(word) < 16 and int(word) > 0):
        return None
    if of and of != str(os.getpid()):
        return None
    return int(word) / 1e6
