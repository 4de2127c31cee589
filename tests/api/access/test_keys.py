"""API keys: made once, kept as hashes, followed at once by a running service, and closed when in doubt."""

from __future__ import annotations

import errno
import json
import os
import re
import stat
from datetime import timedelta
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.access.callers import Role
from api.access.keys import KeyStore, keys_path, open_keys, sha256_of
from api.cli.keys import key_app
from mountnav.errors import BadRequest, BadSettings, NotFound
from mountnav.settings.observatory import Settings


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Where the keys are to be; the folder isn't there yet."""
    return tmp_path / "state" / "keys.json"


def test_a_key_opens_and_its_secret_is_nowhere_on_disk(path: Path) -> None:
    store = KeyStore(path)
    key, secret = store.new("scheduler", Role.OPERATE)
    assert store.find(secret) == key
    assert (key.name, key.role, key.hint) == ("scheduler", Role.OPERATE, secret[-4:])
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    # 256 bits, in the alphabet of base64url
    assert re.fullmatch(r"mnk_[A-Za-z0-9_-]{43}", secret)
    for file in path.parent.iterdir():
        assert secret not in file.read_text(encoding="utf-8")
        assert secret[4:-4] not in file.read_text(encoding="utf-8")
    assert sha256_of(secret) in path.read_text(encoding="utf-8")


def test_another_process_is_followed_at_once(path: Path) -> None:
    running, command_line = KeyStore(path), KeyStore(path)
    guarded = [running.guards]
    _, first = command_line.new("one", Role.VIEW)
    assert [*guarded, running.guards] == [False, True]
    _, second = command_line.new("two", Role.CONFIGURE)
    found = [running.find(one) for one in (first, second)]
    assert [None if one is None else one.name for one in found] == ["one", "two"]
    command_line.revoke("one")
    assert running.find(first) is None
    assert running.find(second) is not None


def test_the_last_key_revoked_opens_nothing(path: Path) -> None:
    store = KeyStore(path)
    _, secret = store.new("only", Role.CONFIGURE)
    store.revoke("only")
    assert store.guards
    assert store.find(secret) is None
    assert store.find("") is None


@pytest.mark.parametrize(
    "damage",
    [
        b"",
        b"{",
        b'{"version": 3, "keys": []}',
        b'{"version": 1, "keys": [{"name": "x"}]}',
        b"\xff\xfe",
        b'{"version": 1, "keys": [], "more": 1}',
    ],
)
def test_a_damaged_file_lets_nobody_in_and_is_not_written_over(path: Path, damage: bytes) -> None:
    store = KeyStore(path)
    _, secret = store.new("only", Role.CONFIGURE)
    path.write_bytes(damage)
    assert store.guards
    assert store.find(secret) is None
    assert store.problem is not None
    assert "damaged" in store.problem
    with pytest.raises(BadSettings, match="damaged"):
        store.new("other", Role.VIEW)
    with pytest.raises(BadSettings, match="damaged"):
        store.readable()
    assert path.read_bytes() == damage


def test_a_file_that_anybody_can_write_lets_nobody_in(path: Path) -> None:
    store = KeyStore(path)
    _, secret = store.new("only", Role.CONFIGURE)
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content)
    path.chmod(0o666)
    assert store.guards
    assert store.find(secret) is None
    path.unlink()
    path.write_bytes(content)
    path.chmod(0o600)
    assert store.find(secret) is not None


def test_a_file_taken_away_asks_again_only_where_others_can_come(path: Path) -> None:
    near, wide = KeyStore(path), KeyStore(path, always=True)
    assert (near.guards, wide.guards) == (False, True)
    KeyStore(path).new("one", Role.VIEW)
    assert (near.guards, wide.guards) == (True, True)
    path.unlink()
    assert (near.guards, wide.guards) == (False, True)


def test_the_token_of_the_settings_is_a_key_that_may_everything(path: Path) -> None:
    store = KeyStore(path, token_sha256=sha256_of("open sesame"))
    found = store.find("open sesame")
    assert store.guards
    assert found is not None
    assert (found.name, found.role) == ("token", Role.CONFIGURE)
    assert store.find("open sesam") is None
    assert store.find(sha256_of("open sesame")) is None


@pytest.mark.parametrize(
    "name", ["", " ", "token", "this machine", "the service", "lease of x", "a\nb", "x" * 65, "-x", "é"]
)
def test_names_that_could_deceive_are_refused(path: Path, name: str) -> None:
    with pytest.raises(BadRequest):
        KeyStore(path).new(name, Role.VIEW)
    assert not path.exists()


def test_a_name_is_taken_once(path: Path) -> None:
    store = KeyStore(path)
    store.new("one", Role.VIEW)
    with pytest.raises(BadRequest, match="already"):
        store.new("one", Role.CONFIGURE)
    assert [key.role for key in store.keys] == [Role.VIEW]
    with pytest.raises(NotFound, match="there is: one"):
        store.revoke("two")


def test_keys_lie_beside_the_journal_unless_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert keys_path(None, str(tmp_path / "night.sqlite")) == tmp_path / "keys.json"
    assert keys_path(None, "postgresql://me@there/x") == tmp_path / "state" / "mountnav" / "keys.json"
    assert keys_path(tmp_path / "k", "postgresql://me@there/x") == tmp_path / "k"


def test_a_named_file_guards_before_it_is_there(observatory_toml: str, tmp_path: Path) -> None:
    file = tmp_path / "keys.json"
    toml = observatory_toml.replace("[service]", f'[service]\nhost = "0.0.0.0"\nkeys_file = "{file}"')
    assert open_keys(Settings.parse(toml)).guards
    near = observatory_toml.replace("[service]", f'[service]\nkeys_file = "{file}"')
    assert open_keys(Settings.parse(near)).guards
    assert not open_keys(Settings.parse(observatory_toml)).guards


def test_the_command_line_makes_lists_and_revokes(path: Path) -> None:
    runner = CliRunner()
    made = runner.invoke(key_app, ["new", "night robot", "--role", "operate", "--file", str(path)])
    secret = made.stdout.strip()
    assert made.exit_code == 0
    assert KeyStore(path).find(secret) is not None
    assert "operate" in made.stderr
    assert secret not in made.stderr
    listed = runner.invoke(key_app, ["list", "--file", str(path)])
    assert re.match(rf"night robot  operate    \.\.\.{re.escape(secret[-4:])}  made ", listed.stdout)
    [row] = json.loads(runner.invoke(key_app, ["list", "--json", "--file", str(path)]).stdout)
    assert (row["name"], row["role"], row["hint"]) == ("night robot", "operate", secret[-4:])
    assert sha256_of(secret) not in json.dumps(row)
    revoked = runner.invoke(key_app, ["revoke", "night robot", "--file", str(path)])
    assert revoked.exit_code == 0
    assert "no key is left" in revoked.stdout
    assert KeyStore(path).find(secret) is None


def test_the_command_line_takes_the_settings_file(path: Path, tmp_path: Path, observatory_toml: str) -> None:
    config = tmp_path / "observatory.toml"
    config.write_text(observatory_toml.replace("[service]", f'[service]\nkeys_file = "{path}"'))
    made = CliRunner().invoke(key_app, ["new", "eye", "--role", "view", "--config", str(config)])
    assert made.exit_code == 0
    assert [key.name for key in KeyStore(path).keys] == ["eye"]


def test_a_file_that_can_t_be_reached_or_is_none_of_ours_lets_nobody_in(path: Path) -> None:
    store = KeyStore(path)
    _, secret = store.new("only", Role.CONFIGURE)
    with path.open("ab") as file:
        file.truncate(1 << 32)  # sparse: it takes no place
    assert (store.guards, store.find(secret)) == (True, None)
    assert "mountnav has not written it" in str(store.problem)
    # it may be there, but a file stands in the place of its folder
    path.unlink()
    for left in path.parent.iterdir():
        left.unlink()
    path.parent.rmdir()
    path.parent.write_text("")
    assert (store.guards, store.find(secret)) == (True, None)
    assert store.problem is not None
    assert any("nobody is let in" in concern for concern in store.concerns())


def test_a_disk_without_room_changes_no_key(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = KeyStore(path)
    _, secret = store.new("only", Role.CONFIGURE)
    before, names = path.read_bytes(), sorted(one.name for one in path.parent.iterdir())

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(BadSettings, match="can't be written"):
        store.new("other", Role.VIEW)
    with pytest.raises(BadSettings, match="can't be written"):
        store.revoke("only")
    assert store.find(secret) is not None
    assert path.read_bytes() == before
    assert sorted(one.name for one in path.parent.iterdir()) == names


@pytest.mark.parametrize("overlap", [timedelta(seconds=-1), timedelta.max])
def test_an_overlap_that_is_no_length_of_time_leaves_the_key_as_it_was(
    path: Path, overlap: timedelta
) -> None:
    store = KeyStore(path)
    key, secret = store.new("scheduler", Role.OPERATE)
    before = path.read_bytes()
    with pytest.raises(BadRequest, match="not a length of time"):
        store.renew("scheduler", overlap=overlap)
    assert path.read_bytes() == before
    assert store.find(secret) == key


def test_keys_are_as_many_as_are_still_read(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("api.access.keys._MOST_KEYS", 2)
    store = KeyStore(path)
    _, secret = store.new("one", Role.VIEW)
    store.new("two", Role.VIEW)
    with pytest.raises(BadRequest, match="there are 2 keys already"):
        store.new("three", Role.VIEW)
    # one goes, and there is room
    store.revoke("two")
    store.new("three", Role.VIEW)
    assert store.find(secret) is not None
