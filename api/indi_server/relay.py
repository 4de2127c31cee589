"""`mountnav indi-driver`: a driver for a stock `indiserver`, which only passes on what our server says.

`indiserver` speaks to its drivers by their standard input and output; whatever it says goes to the running
service, and back. When the service is gone the driver ends, and `indiserver` runs it again.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import threading
from typing import BinaryIO

_AT_ONCE_BYTES = 65_536
"""Bytes passed on in one read, as much as a pipe holds. Halved, twice the system calls."""
_CONNECT_S = 10.0
"""Longest wait for our server to accept, s; chosen by hand. Doubled, `indiserver` learns later that it
isn't there."""

_A_SERVER = b"<getProperties version='1.7' device='*'/>\n"
"""Said first: who asks is a server, with clients of its own, and no client [as an `indiserver` tells another
one]. It answers pings for clients that are long gone."""


def relay(host: str, port: int, *, heard: BinaryIO | None = None, said: BinaryIO | None = None) -> int:
    """Pass on until one side ends.

    Parameters
    ----------
    host, port
        Where the service's INDI server listens.
    heard, said : binary files, optional
        Instead of standard input and output.

    Returns
    -------
    int
        0 when `indiserver` has ended, 1 when the service is not there or has gone.
    """
    heard = sys.stdin.buffer if heard is None else heard
    said = sys.stdout.buffer if said is None else said
    try:
        connection = socket.create_connection((host, port), timeout=_CONNECT_S)
    except OSError as error:
        print(f"mountnav indi-driver: no service at {host} port {port}: {error}", file=sys.stderr)
        return 1
    connection.settimeout(None)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.sendall(_A_SERVER)
    over = threading.Event()

    def pass_in() -> None:
        with contextlib.suppress(OSError):
            while data := os.read(heard.fileno(), _AT_ONCE_BYTES):
                connection.sendall(data)
        over.set()
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)

    # it may wait for a line that never comes: the process doesn't
    threading.Thread(target=pass_in, daemon=True, name="from indiserver").start()
    with connection:
        try:
            while data := connection.recv(_AT_ONCE_BYTES):
                said.write(data)
                said.flush()
        except OSError:
            over.wait(0.1)
    return 0 if over.is_set() else 1


__all__ = ["relay"]
