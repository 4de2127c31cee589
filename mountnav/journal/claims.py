"""Whose telescopes are whose, where several services write one journal on PostgreSQL.

A service claims its telescopes by advisory locks of the connection that it writes with: they end with the
connection, however it ends, and are taken again with the next one. Two services that have the same telescope
would give it orders at cross purposes, and each would take the other's jobs for its own.
"""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import time
from collections.abc import Iterable

from sqlalchemy import URL, Connection, text
from sqlalchemy.exc import SQLAlchemyError

from mountnav.errors import BadSettings, JournalFailed
from mountnav.journal.database import connectable, file_of, shown_url

_log = logging.getLogger(__name__)

CLAIM_PATIENCE_S = 30.0
"""How long a service that starts waits for another one to let a telescope go. A server notices within 25 s
that a client's machine is gone; doubled, a mistake in the settings is told twice as late."""

_PAUSE_S = 0.5
"""Between two tries."""

_KEEPALIVE = {"tcp_keepalives_idle": 10, "tcp_keepalives_interval": 5, "tcp_keepalives_count": 3}
"""For the server, s and tries: without them it would hold the locks of a machine that lost its power for two
hours. Doubled, its successor waits twice as long."""

_MOST_NAME = 63
"""Bytes that PostgreSQL keeps of a connection's name."""


def claim(connection: Connection, telescopes: Iterable[str]) -> None:
    """Take telescopes for as long as this connection lives.

    Raises
    ------
    JournalFailed
        Another service has one of them.
    """
    if connection.dialect.name != "postgresql":
        return
    with connection.begin():
        for name, value in _KEEPALIVE.items():
            connection.exec_driver_sql(f"SET {name} = {value}")
        own = f"mountnav on {platform.node()}, process {os.getpid()}"
        connection.execute(
            text("SELECT set_config('application_name', :own, false)"),
            {"own": own.encode("ascii", "replace")[:_MOST_NAME].decode("ascii")},
        )
        for telescope in sorted(telescopes):
            key = {"key": _key(telescope)}
            if not connection.execute(text("SELECT pg_try_advisory_lock(:key)"), key).scalar():
                who = connection.execute(_HOLDER, key).scalar() or "another service"
                raise JournalFailed(
                    f"the telescope {telescope!r} is served by another service on this journal: {who}",
                    device=shown_url(connection.engine.url),
                    advice="end that one, or give this telescope another id",
                )


_HOLDER = text(
    "SELECT a.application_name FROM pg_locks l JOIN pg_stat_activity a USING (pid) "
    "WHERE l.locktype = 'advisory' AND l.granted AND l.objsubid = 1 "
    "AND ((l.classid::bigint << 32) | l.objid::bigint) = :key LIMIT 1"
)


def _key(telescope: str) -> int:
    """A number for a telescope, of 64 bits: two of a thousand are the same once in 10^13 sites."""
    digest = hashlib.sha256(b"mountnav-telescope:" + telescope.encode("utf-8", "surrogatepass")).digest()
    return int.from_bytes(digest[:8], "big", signed=True)


def require_free(url: URL, telescopes: Iterable[str], patience_s: float = CLAIM_PATIENCE_S) -> None:
    """Wait until no other service has one of these telescopes.

    A server that can't be reached is no reason: who writes finds out.

    Raises
    ------
    BadSettings
        One has, still.
    """
    if file_of(url) is not None:
        return
    wanted, end_s, told = frozenset(telescopes), time.monotonic() + patience_s, False
    engine = connectable(url, "write")
    try:
        while True:
            try:
                with engine.connect() as connection:
                    claim(connection, wanted)
                return
            except JournalFailed as taken:
                if time.monotonic() > end_s:
                    raise BadSettings(taken.what, device=taken.device, advice=taken.advice) from taken
                if not told:
                    _log.warning("%s; it is waited for %.0f s", taken, patience_s)
                told = True
            except SQLAlchemyError:
                return
            time.sleep(_PAUSE_S)
    finally:
        engine.dispose()
