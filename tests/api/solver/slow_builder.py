"""What builds an index, in the hands of a test: it tells how far it is and goes on when a file appears."""

from __future__ import annotations

import os
import time
from pathlib import Path

from api.solver.attached import attached
from api.solver.messages import Built, Done, Fault, Progress, Setup, receive, send
from mountnav.errors import BadSettings


def main() -> None:
    folder = Path(os.environ["SLOW_BUILDER"])
    link = attached()
    (folder / "pid").write_text(str(os.getpid()))
    setup, _ = receive(link)
    assert isinstance(setup, Setup)
    send(link, Progress(0.42))
    while not (folder / "go on").exists():
        time.sleep(0.02)
    if (folder / "fail").exists():
        send(link, Done(fault=Fault.of(BadSettings("no room", device="the cache", advice="make some"))))
    else:
        send(link, Built(folder / "index"))


if __name__ == "__main__":
    main()
