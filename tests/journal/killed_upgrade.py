"""A child that brings a journal up to date, and is killed right before its n-th change of the database."""

from __future__ import annotations

import os
import signal
import sys

from sqlalchemy import Engine, event

from mountnav.journal.database import database_url
from mountnav.journal.upgrading import upgrade


def main() -> None:
    """Upgrade the journal of the first argument; die at the change whose number is the second one."""
    path, die_at = sys.argv[1], int(sys.argv[2])
    done = 0

    @event.listens_for(Engine, "before_cursor_execute")
    def _(_connection: object, _cursor: object, statement: str, *_more: object) -> None:
        nonlocal done
        if statement.lstrip().upper().startswith(("SELECT", "PRAGMA")):
            return
        done += 1
        if done == die_at:
            os.kill(os.getpid(), signal.SIGKILL)

    @event.listens_for(Engine, "commit")
    def _(_connection: object) -> None:
        nonlocal done
        done += 1
        if done == die_at:
            os.kill(os.getpid(), signal.SIGKILL)

    upgrade(database_url(path))
    print(done)


if __name__ == "__main__":
    main()
