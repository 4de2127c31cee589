"""API keys: random secrets of which only the hashes lie on disk.

Each has a name and a role; it may be for some telescopes alone, and may have an end.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import re
import stat
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from secrets import compare_digest, token_urlsafe

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from api.access.callers import Role
from mountnav.errors import BadRequest, BadSettings, NotFound
from mountnav.files import locked, read_bytes
from mountnav.journal.database import database_url, file_of, state_folder
from mountnav.settings.observatory import Settings

_log = logging.getLogger(__name__)

PREFIX = "mnk_"
"""Each key begins so: programs that look for leaked secrets find them by it."""
TOKEN_NAME = "token"
"""The name of the key that `[service] api_token_sha256` is."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._@-]{0,62}[A-Za-z0-9]|[A-Za-z0-9]")
_TAKEN = frozenset({TOKEN_NAME, "this machine", "the service"})
_SECRET_BYTES = 32
"""Random bytes of a key: 256 bits, as `secrets` recommends. Halved, 128 bits, still out of reach of
guessing."""
_HINT = 4
"""Last characters of a key that are shown, so that people tell keys apart: 24 of 256 bits. Doubled, 48 of
them are known to all who may list keys."""
_TELESCOPE = re.compile(r"[a-z0-9][a-z0-9_-]{0,39}")
_MOST_TELESCOPES = 100
"""Telescopes that one key may name; chosen by hand, far above one service's. Doubled, the file grows."""
_MOST_KEYS = 10_000
"""Keys of one file; each request goes through all of them, 0.1 ms a thousand. Doubled, twice as long."""
_MOST_FILE_BYTES = 8_000_000
"""Longest file of keys that is read, bytes: ten thousand keys. Doubled, a file that grew by mistake holds
every request up for twice as long."""
TOLD_DAYS = 14.0
"""So many days before a key ends health and log say so: time enough to hand out a new one. Doubled, a key
that is made for a month is told of from its first day on."""
_TOLD_AGAIN_S = 86_400.0
"""Between two lines of the log about the same key that ends soon, s. Doubled, two days."""
OVERLAP = timedelta(days=1)
"""How long the old secret of a key that was renewed is taken, unless told otherwise: a night and a day, in
which its program is given the new one. Doubled, one that leaked is of use for two days."""
LONGEST = timedelta(days=36_525)
"""Longest life of a key: a century; what is longer was mistyped, and overflows the calendar soon."""


@dataclass(frozen=True, slots=True)
class Key:
    """One key, without its secret.

    Attributes
    ----------
    name : str
        Who uses it; audits and leases name callers so.
    sha256 : str
        Of the secret, in hexadecimal digits.
    created_utc : datetime or None
        None for the token of the settings.
    hint : str
        The secret's last characters, to tell keys apart.
    telescopes : frozenset of str or None
        Those that it opens; None: all of the service.
    expires_utc : datetime or None
        From then on it is none any more; None: it has no end.
    """

    name: str
    role: Role
    sha256: str
    created_utc: datetime | None = None
    hint: str = ""
    telescopes: frozenset[str] | None = None
    expires_utc: datetime | None = None


class _KeyRecord(BaseModel):
    model_config = ConfigDict(extra="forbid")

    name: str
    role: Role
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    created_utc: AwareDatetime
    hint: str
    telescopes: list[str] | None = Field(default=None, min_length=1, max_length=_MOST_TELESCOPES)
    expires_utc: AwareDatetime | None = None


class _KeyFile(BaseModel):
    """The file.

    Version 1 knows neither telescopes nor ends, and is written as long as no key has one, so that a service
    of before goes on with it. Such a one refuses version 2 whole: it would let a narrow key do everything.
    """

    model_config = ConfigDict(extra="forbid")

    version: int = Field(default=1, ge=1, le=2)
    keys: list[_KeyRecord] = Field(default=[], max_length=_MOST_KEYS)


class KeyClock:
    """UTC for the ends of keys: one that is set back makes no key live again while the service runs.

    It is the machine's, never a virtual sky's. A clock that was ahead and is set right again is believed
    again: else a wrong second from a GPS would keep everybody out, stops among them.

    Parameters
    ----------
    now : callable
        Aware UTC of the machine.
    monotonic_s : callable
        Seconds that never run back.
    """

    def __init__(
        self,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._now, self._monotonic_s = now, monotonic_s
        self._began_utc, self._began_s = now(), monotonic_s()

    def __call__(self) -> datetime:
        """The machine's time, but not before its time at the start plus what has passed since."""
        passed = timedelta(seconds=self._monotonic_s() - self._began_s)
        return max(self._now(), self._began_utc + passed)


class KeyStore:
    """The keys of a service: a file (mode 0600) that is read again whenever it changes.

    A key that was revoked is refused from the next request on. A file that can't be read or makes no sense
    lets nobody in; what is wrong with it stands in `problem`.

    Parameters
    ----------
    path : Path
        It need not exist.
    token_sha256 : str, optional
        Of the settings' token: one more key, named ``token``, that may do everything.
    always : bool
        Ask for keys even while there is no file: others than this machine reach the service.
    clock : callable, optional
        Aware UTC, by which keys end.
    """

    def __init__(
        self,
        path: Path,
        *,
        token_sha256: str | None = None,
        always: bool = False,
        clock: Callable[[], datetime] | None = None,
    ) -> None:
        self.path = path
        self._clock = clock or KeyClock()
        self._floor_utc: datetime | None = None
        self._told: dict[tuple[str, bool], float] = {}
        self.problem: str | None = None
        self._token = None if token_sha256 is None else Key(TOKEN_NAME, Role.CONFIGURE, token_sha256)
        self._always = always
        self._seen: tuple[int, int, int] | None = None
        self._exists = False
        self._keys: tuple[Key, ...] = ()

    @property
    def guards(self) -> bool:
        """Whether a key is needed. Without, only this machine is let in, and may do everything."""
        self._follow()
        return self._always or self._token is not None or self._exists

    @property
    def keys(self) -> list[Key]:
        """All keys of the file, in the order of their making."""
        self._follow()
        return list(self._keys)

    def find(self, secret: str) -> Key | None:
        """The key whose secret this is; None for one that was revoked or has ended, or never was one."""
        found = self._any(sha256_of(secret))
        return None if found is None or self.has_ended(found) else found

    def ended(self, secret: str) -> Key | None:
        """The key whose secret this is, if it has come to its end; for telling its holder so."""
        found = self._any(sha256_of(secret))
        return found if found is not None and self.has_ended(found) else None

    def known(self, sha256: str) -> Key | None:
        """The key with this hash; None once it was revoked or has ended. For sessions begun with it."""
        found = self._any(sha256)
        return None if found is None or self.has_ended(found) else found

    def has_ended(self, key: Key) -> bool:
        """Whether the time of a key of this store is over."""
        return key.expires_utc is not None and self._now() >= key.expires_utc

    def ending(self, within: timedelta = timedelta(days=TOLD_DAYS)) -> list[Key]:
        """Keys that end within that time or have ended, the first one first.

        The old secret of a key that was renewed is none of them: its successor is there.
        """
        now = self._now()
        keys = [key for key in self.keys if key.expires_utc is not None and key.expires_utc <= now + within]
        latest = {key.name: key for key in self.keys}
        keys = [key for key in keys if latest[key.name] is key]
        return sorted(keys, key=lambda key: key.expires_utc or now)

    def concerns(self) -> list[str]:
        """What health says of keys: in numbers, without names, since everybody may read it."""
        self._follow()
        if self.problem is not None:
            return ["keys: the keys file can't be used, so nobody is let in; the log says why"]
        ending = self.ending()
        over = [key for key in ending if self.has_ended(key)]
        soon = [key for key in ending if not self.has_ended(key)]
        told = []
        if over:
            told.append(f"keys: {len(over)} have ended and open nothing; `mountnav key list` names them")
        if soon:
            first = soon[0].expires_utc
            told.append(
                f"keys: {len(soon)} end within {TOLD_DAYS:.0f} days, the first at "
                f"{first:%Y-%m-%d %H:%M} UTC; `mountnav key list` names them"
            )
        return told

    def tell_ends(self, now_s: float | None = None) -> None:
        """Write into the log which keys end soon or have ended: each once a day."""
        now_s = time.monotonic() if now_s is None else now_s
        for key in self.ending():
            over = self.has_ended(key)
            mark = (key.sha256, over)
            if now_s - self._told.get(mark, -_TOLD_AGAIN_S) < _TOLD_AGAIN_S:
                continue
            self._told[mark] = now_s
            _log.warning(
                "the key of %s (...%s) %s at %s UTC: `mountnav key renew` makes a new one",
                key.name,
                key.hint,
                "has ended" if over else "ends",
                f"{key.expires_utc:%Y-%m-%d %H:%M}",
            )
        known = {key.sha256 for key in self._keys}
        self._told = {mark: at_s for mark, at_s in self._told.items() if mark[0] in known}

    def _any(self, digest: str) -> Key | None:
        """The key with this hash, whether it has ended or not; always through all of them."""
        self._follow()
        found = None
        for key in self._keys if self._token is None else (*self._keys, self._token):
            if compare_digest(key.sha256, digest):
                found = key
        return found

    def _now(self) -> datetime:
        """Now, but no earlier than the newest key was made: some machines start with a clock of before."""
        now = self._clock()
        return now if self._floor_utc is None else max(now, self._floor_utc)

    def readable(self) -> list[Key]:
        """As `keys`, for people: a file that makes no sense is reported. Raises `BadSettings`."""
        keys = self.keys
        if self.problem is not None:
            raise BadSettings(self.problem, advice="see `mountnav docs security`")
        return keys

    def new(
        self,
        name: str,
        role: Role,
        *,
        telescopes: Collection[str] | None = None,
        lasts: timedelta | None = None,
        until: datetime | None = None,
    ) -> tuple[Key, str]:
        """Make a key. Its secret is returned this once, and kept nowhere.

        Parameters
        ----------
        telescopes : collection of str, optional
            Those that it opens; all if not given.
        lasts : timedelta, optional
            When it ends, from now; never if neither this nor `until` is given.
        until : datetime, optional
            Aware.

        Raises
        ------
        BadRequest
            The name is no name, or taken; the end has passed; a telescope's id is none.
        BadSettings
            The file can't be read or written.
        """
        scope = _scope(telescopes)
        expires_utc = self._end(lasts, until)
        if not _NAME.fullmatch(name) or name in _TAKEN or name.startswith("lease of "):
            raise BadRequest(
                f"{name!r} can't be the name of a key",
                advice="letters, digits, space and ._@- (64 at most), and none of the service's own names",
            )
        with self._changing() as record:
            if any(key.name == name for key in record.keys):
                raise BadRequest(
                    f"there is a key named {name!r} already", advice="revoke it first, or take another name"
                )
            made, secret = self._made(name, role, scope, expires_utc)
            _put(record, made)
        return _key(made), secret

    def renew(
        self,
        name: str,
        *,
        lasts: timedelta | None = None,
        until: datetime | None = None,
        overlap: timedelta = OVERLAP,
    ) -> tuple[Key, str]:
        """Make a new secret for a key; the old one is taken for `overlap` yet, so that nothing stands still.

        Parameters
        ----------
        lasts, until : timedelta, datetime, optional
            When the new one ends. If neither is given, it lasts as long as the old one was made for.
        overlap : timedelta
            0: the old one is refused at once. It never lives longer than it would have.

        Raises
        ------
        NotFound, BadRequest, BadSettings
            As `new` and `revoke`.
        """
        if not timedelta(0) <= overlap <= LONGEST:
            raise BadRequest("that is not a length of time", advice="such as 24h; 0 ends the old key at once")
        with self._changing() as record:
            old = self._named(record, name)[-1]
            now = self._now()
            if lasts is None and until is None and old.expires_utc is not None:
                lasts = max(old.expires_utc - old.created_utc, timedelta(days=1))
            made, secret = self._made(name, old.role, old.telescopes, self._end(lasts, until))
            kept = []
            for key in record.keys:
                if key.name != name:
                    kept.append(key)
                    continue
                ends = now + overlap if key.expires_utc is None else min(key.expires_utc, now + overlap)
                if ends > now:
                    kept.append(key.model_copy(update={"expires_utc": ends}))
            record.keys = kept
            _put(record, made)
        return _key(made), secret

    def change(
        self,
        name: str,
        *,
        role: Role | None = None,
        telescopes: Collection[str] | None = None,
        all_telescopes: bool = False,
        lasts: timedelta | None = None,
        until: datetime | None = None,
        endless: bool = False,
    ) -> Key:
        """Change what a key may, or when it ends, without a new secret. What isn't given stays.

        Raises
        ------
        NotFound, BadRequest, BadSettings
            As `new` and `revoke`.
        """
        scope, ends = _scope(telescopes), self._end(lasts, until)
        with self._changing() as record:
            found = self._named(record, name)[-1]
            told: dict[str, object] = {}
            if role is not None:
                told["role"] = role
            if scope is not None or all_telescopes:
                told["telescopes"] = None if all_telescopes else scope
            if ends is not None or endless:
                told["expires_utc"] = None if endless else ends
            changed = found.model_copy(update=told)
            record.keys = [changed if key is found else key for key in record.keys]
        return _key(changed)

    def revoke(self, name: str, *, hint: str | None = None) -> Key:
        """Remove a key with all its secrets; a running service refuses it from the next request on.

        Parameters
        ----------
        hint : str, optional
            Only the secret that ends so: one of a key that was renewed.

        Raises
        ------
        NotFound
            There is none of this name.
        BadSettings
            The file can't be read or written.
        """
        with self._changing() as record:
            named = self._named(record, name)
            gone = [key for key in named if hint is None or key.hint == hint]
            if not gone:
                raise NotFound(
                    f"the key of {name!r} has no secret that ends with {hint!r}",
                    device=str(self.path),
                    advice=f"there is: {', '.join('...' + key.hint for key in named)}",
                )
            record.keys = [key for key in record.keys if key not in gone]
        return _key(gone[-1])

    def _named(self, record: _KeyFile, name: str) -> list[_KeyRecord]:
        """The secrets of a name, the newest last. Raises `NotFound`."""
        found = [key for key in record.keys if key.name == name]
        if not found:
            names = dict.fromkeys(key.name for key in record.keys)
            raise NotFound(
                f"there is no key named {name!r}",
                device=str(self.path),
                advice=f"there is: {', '.join(names) or 'none'}",
            )
        return found

    def _made(
        self, name: str, role: Role, telescopes: Sequence[str] | None, expires_utc: datetime | None
    ) -> tuple[_KeyRecord, str]:
        secret = PREFIX + token_urlsafe(_SECRET_BYTES)
        return (
            _KeyRecord(
                name=name,
                role=role,
                sha256=sha256_of(secret),
                created_utc=datetime.now(UTC),
                hint=secret[-_HINT:],
                telescopes=None if telescopes is None else list(telescopes),
                expires_utc=expires_utc,
            ),
            secret,
        )

    def _end(self, lasts: timedelta | None, until: datetime | None) -> datetime | None:
        """When a key ends. Raises `BadRequest` for an end that has passed, or is none."""
        if lasts is None and until is None:
            return None
        now = self._now()
        if lasts is not None and until is not None:
            raise BadRequest("a key ends once", advice="say how long it lasts, or until when")
        if lasts is not None and not timedelta(0) < lasts <= LONGEST:
            raise BadRequest("a key can't last so long", advice="such as 90d or 12h, a century at most")
        end = now + lasts if lasts is not None else until
        assert end is not None
        if end <= now or end > now + LONGEST:
            raise BadRequest(
                f"a key can't end at {end:%Y-%m-%d %H:%M} UTC",
                advice="name a time in the future, within a century",
            )
        return end

    def _follow(self) -> None:
        """Read the file if it has changed."""
        try:
            found = self.path.stat()
        except FileNotFoundError:
            self._seen, self._exists, self._keys, self.problem = None, False, (), None
            self._floor_utc = None
            return
        except OSError as error:
            # it may be there: nobody is let in by it
            self._seen, self._exists, self._keys = None, True, ()
            self._tell(f"{self.path}: {error.strerror}")
            return
        seen = (found.st_mtime_ns, found.st_size, found.st_ino)
        if seen == self._seen:
            return
        self._exists = True
        try:
            record = self._read(found)
        except BadSettings as error:
            self._keys = ()
            self._tell(str(error))
        else:
            self._keys, self.problem = tuple(_key(key) for key in record.keys), None
            self._floor_utc = max((key.created_utc for key in record.keys), default=None)
        self._seen = seen

    def _read(self, found: os.stat_result) -> _KeyFile:
        if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            raise BadSettings(
                "others than its owner could add a key to the keys file",
                device=str(self.path),
                advice=f"chmod 600 {self.path}",
            )
        if found.st_size > _MOST_FILE_BYTES:
            raise BadSettings(
                f"the keys file has {found.st_size / 1e6:.0f} MB: mountnav has not written it",
                device=str(self.path),
                advice="move it away and make new keys with `mountnav key new`",
            )
        try:
            return _KeyFile.model_validate_json(read_bytes(self.path))
        except OSError as error:
            raise BadSettings(
                f"the keys file can't be read: {error.strerror}",
                device=str(self.path),
                advice="it must be readable by the user that runs the service",
            ) from error
        except ValidationError as error:
            raise BadSettings(
                "the keys file is damaged, so nobody is let in",
                device=str(self.path),
                advice="move it away and make new keys with `mountnav key new`",
            ) from error

    def _tell(self, what: str) -> None:
        if what != self.problem:
            _log.error("API keys: %s", what)
        self.problem = what

    @contextlib.contextmanager
    def _changing(self) -> Iterator[_KeyFile]:
        """The file's content, written back at the end; others who change it wait for their turn."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            with locked(self.path.with_name(self.path.name + ".lock")):
                record = self._read(self.path.stat()) if self.path.exists() else _KeyFile()
                yield record
                self._write(record)
        except OSError as error:
            raise BadSettings(
                f"the keys file can't be written: {error.strerror}",
                device=str(self.path),
                advice="run this as the user that runs the service, or name another keys_file",
            ) from error

    def _write(self, record: _KeyFile) -> None:
        """All of it or nothing: a reader never meets half a file."""
        narrow = any(key.telescopes is not None or key.expires_utc is not None for key in record.keys)
        record.version = 2 if narrow else 1
        text = json.dumps(record.model_dump(mode="json", exclude_none=True), indent=1) + "\n"
        handle, name = tempfile.mkstemp(dir=self.path.parent, prefix=".keys-")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                os.fchmod(file.fileno(), 0o600)
                known = self.path if self.path.exists() else self.path.parent
                _keep_owner(file.fileno(), known.stat())
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            os.replace(name, self.path)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(name)
            raise


def keys_path(keys_file: Path | None, journal: str) -> Path:
    """Where keys are kept: as given, else beside the journal.

    Parameters
    ----------
    keys_file : Path or None
        Of `[service]`.
    journal : str
        The journal's path or URL. Beside one on a server: in the folder of the user's state.
    """
    if keys_file is not None:
        return keys_file
    file = file_of(database_url(journal))
    return (state_folder() if file is None else file.parent) / "keys.json"


def open_keys(settings: Settings, *, wide: bool = False) -> KeyStore:
    """The keys of a service of these settings; `wide`: others than this machine reach a port of its."""
    service = settings.service
    return KeyStore(
        keys_path(service.keys_file, settings.journal.where),
        token_sha256=service.api_token_sha256,
        always=wide or service.keys_file is not None or not service.is_loopback,
    )


def sha256_of(secret: str) -> str:
    """The hash that stands for a secret, in hexadecimal digits.

    A plain hash will do: the secrets are random and of 256 bits, nobody guesses one.
    """
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()


def _key(record: _KeyRecord) -> Key:
    return Key(
        record.name,
        record.role,
        record.sha256,
        record.created_utc,
        record.hint,
        None if record.telescopes is None else frozenset(record.telescopes),
        record.expires_utc,
    )


def _scope(telescopes: Collection[str] | None) -> list[str] | None:
    """Telescopes of a key, each once. Raises `BadRequest` for what is no id."""
    if telescopes is None:
        return None
    named = list(dict.fromkeys(telescopes))
    if not 0 < len(named) <= _MOST_TELESCOPES or not all(_TELESCOPE.fullmatch(one) for one in named):
        raise BadRequest(
            "that is not a list of telescope ids",
            advice="ids as in the settings, 100 at most; leave them out for all",
        )
    return named


def _put(record: _KeyFile, made: _KeyRecord) -> None:
    if len(record.keys) >= _MOST_KEYS:
        raise BadRequest(f"there are {_MOST_KEYS} keys already", advice="revoke what isn't used any more")
    record.keys.append(made)


def _keep_owner(file: int, found: os.stat_result) -> None:
    """A file that root writes is its owner's, or its folder's owner's: else the service could not read it."""
    if os.geteuid() == 0:
        os.fchown(file, found.st_uid, found.st_gid)


__all__ = ["OVERLAP", "Key", "KeyClock", "KeyStore", "keys_path", "open_keys", "sha256_of"]
