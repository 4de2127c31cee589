"""How a process of ours begins: on the socket that `api.solver.link` gave it, and it ends with that one."""

from __future__ import annotations

import os
import select
import signal
import socket
import sys
import threading


def end_with(link: socket.socket) -> None:
    """End this process at once when the other end of its socket is closed, whatever it is doing."""
    hung_up = select.poll()
    hung_up.register(link, 0)  # a hang-up is told in any case, and nothing else is wanted

    def watch() -> None:
        while not hung_up.poll():
            pass
        os._exit(0)

    threading.Thread(target=watch, name="watch", daemon=True).start()


def attached() -> socket.socket:
    """The socket that this process was started with; the service alone decides when it ends."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    link = socket.socket(fileno=int(sys.argv[1]))
    end_with(link)
    return link
