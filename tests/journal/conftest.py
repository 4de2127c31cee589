"""Real journals: files of SQLite, and where its programs are installed, a server of PostgreSQL."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from mountnav.journal.sql_journal import SqlJournal, open_journal


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "state" / "journal.sqlite"


@pytest.fixture
def journal(file: Path) -> Iterator[SqlJournal]:
    opened = open_journal(file)
    yield opened
    opened.close()


@pytest.fixture(scope="session")
def postgresql() -> Iterator[str]:
    """The URL of a temporary server's database, or a skip with the reason."""
    initdb, postgres = shutil.which("initdb"), shutil.which("postgres")
    if initdb is None or postgres is None:
        pytest.skip("PostgreSQL's initdb and postgres are not on the PATH")
    pytest.importorskip("psycopg")
    # the server refuses to run as root
    user = "nobody" if os.geteuid() == 0 else None
    # not below pytest's own folder, which that user may not enter
    folder = Path(tempfile.mkdtemp(prefix="mountnav-postgresql-"))
    if user is not None:
        shutil.chown(folder, user)
    data = folder / "data"
    made = subprocess.run(
        [initdb, "-D", data, "-U", "mountnav", "-A", "trust", "--no-sync", "--no-locale", "-E", "UTF8"],
        user=user,
        capture_output=True,
        text=True,
        cwd=folder,
        check=False,
    )
    if made.returncode:
        pytest.skip(f"initdb can't make a cluster here: {made.stderr.strip()[-200:]}")
    server = subprocess.Popen(
        [postgres, "-D", data, "-k", folder, "-c", "listen_addresses=", "-c", "shared_buffers=8MB"],
        user=user,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
    )
    url = f"postgresql://mountnav@/postgres?host={folder}"
    try:
        assert server.stderr is not None
        for line in server.stderr:
            if "ready to accept connections" in line:
                break
        else:
            pytest.skip("the server of PostgreSQL doesn't start here")
        yield url
    finally:
        server.terminate()
        with suppress(subprocess.TimeoutExpired):
            server.wait(30)
        server.kill()
        server.wait()
        if server.stderr is not None:
            server.stderr.close()
        shutil.rmtree(folder, ignore_errors=True)
