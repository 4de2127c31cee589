"""What is written is for its user alone, whatever the umask; a lock file that is a link is refused."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from api.access.keys import KeyStore
from api.alpaca.management import unique_ids
from mountnav.catalog.installed import held
from mountnav.errors import BadSettings
from mountnav.files import locked, make_private_folder
from mountnav.journal.sql_journal import open_journal


@pytest.fixture(params=[0o000, 0o022])
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def _mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_journal_and_its_folder(tmp_path: Path, umask: int) -> None:
    file = tmp_path / "state" / "mountnav" / "journal.sqlite"
    journal = open_journal(file)
    try:
        found = {one.name: _mode(one) for one in file.parent.iterdir()}
        assert found == {
            "journal.sqlite": 0o600,
            "journal.sqlite-wal": 0o600,
            "journal.sqlite-shm": 0o600,
        }
        assert (_mode(file.parent), _mode(file.parent.parent)) == (0o700, 0o700)
    finally:
        journal.close()


def test_an_older_journal_is_closed_to_others(tmp_path: Path) -> None:
    file = tmp_path / "journal.sqlite"
    open_journal(file).close()
    file.chmod(0o644)
    open_journal(file).close()
    assert _mode(file) == 0o600


def test_a_folder_that_is_there_stays_as_it_is(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    make_private_folder(tmp_path)
    assert _mode(tmp_path) == 0o755


def _lock(path: Path) -> None:
    with locked(path):
        pass


def _import(path: Path) -> None:
    with held(path.parent):
        pass


@pytest.mark.parametrize("take", [_lock, _import], ids=["locked", "held"])
def test_locks(tmp_path: Path, umask: int, take: Callable[[Path], None]) -> None:
    path = tmp_path / "lock"
    take(path)
    assert _mode(path) == 0o600
    path.unlink()
    victim = tmp_path / "victim"
    victim.write_text("mine")
    path.symlink_to(victim)
    with pytest.raises(OSError):
        take(path)
    assert victim.read_text() == "mine"


def test_the_lock_of_alpacas_ids_follows_no_link(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / "ids.lock").symlink_to(victim)
    # they are made of names then, and it is logged
    assert unique_ids(tmp_path / "ids.json", ["east"]) == unique_ids(tmp_path / "ids.json", ["east"])
    assert victim.read_text() == "mine"
    assert not (tmp_path / "ids.json").exists()


@pytest.mark.parametrize("mode", [0o620, 0o660, 0o602])
def test_a_key_file_that_others_can_write_lets_nobody_in(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "keys.json"
    KeyStore(path).new("one", "operate")  # type: ignore[arg-type]
    path.chmod(mode)
    with pytest.raises(BadSettings, match="others than its owner"):
        KeyStore(path).new("two", "operate")  # type: ignore[arg-type]
