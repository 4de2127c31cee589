"""API keys: random secrets of which only the hashes lie on disk, each with a name and a role."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from secrets import compare_digest, token_urlsafe

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from api.access.callers import Role
from mountnav.clock import utc_now
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
    """

    name: str
    role: Role
    sha256: str
    created_utc: datetime | None = None
    hint: str = ""


class _KeyRecord(BaseModel):
    model_config = ConfigDict(extra="forbid")

    name: str
    role: Role
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    created_utc: AwareDatetime
    hint: str


class _KeyFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    version: int = Field(default=1, ge=1, le=1)
    keys: list[_KeyRecord] = []


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
    """

    def __init__(self, path: Path, *, token_sha256: str | None = None, always: bool = False) -> None:
        self.path = path
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
        """The key whose secret this is; None for one that was revoked, or never was one."""
        self._follow()
        digest = sha256_of(secret)
        found = None
        for key in self._keys if self._token is None else (*self._keys, self._token):
            if compare_digest(key.sha256, digest):
                found = key
        return found

    def known(self, sha256: str) -> Key | None:
        """The key with this hash; None once it was revoked. For sessions that were begun with it."""
        self._follow()
        keys = self._keys if self._token is None else (*self._keys, self._token)
        return next((key for key in keys if compare_digest(key.sha256, sha256)), None)

    def readable(self) -> list[Key]:
        """As `keys`, for people: a file that makes no sense is reported. Raises `BadSettings`."""
        keys = self.keys
        if self.problem is not None:
            raise BadSettings(self.problem, advice="see docs/how-to/security.md")
        return keys

    def new(self, name: str, role: Role) -> tuple[Key, str]:
        """Make a key. Its secret is returned this once, and kept nowhere.

        Raises
        ------
        BadRequest
            The name is no name, or taken.
        BadSettings
            The file can't be read or written.
        """
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
            secret = PREFIX + token_urlsafe(_SECRET_BYTES)
            made = _KeyRecord(
                name=name,
                role=role,
                sha256=sha256_of(secret),
                created_utc=utc_now(),
                hint=secret[-_HINT:],
            )
            record.keys.append(made)
        return _key(made), secret

    def revoke(self, name: str) -> Key:
        """Remove a key; a running service refuses it from the next request on.

        Raises
        ------
        NotFound
            There is none of this name.
        BadSettings
            The file can't be read or written.
        """
        with self._changing() as record:
            found = next((key for key in record.keys if key.name == name), None)
            if found is None:
                raise NotFound(
                    f"there is no key named {name!r}",
                    device=str(self.path),
                    advice=f"there is: {', '.join(key.name for key in record.keys) or 'none'}",
                )
            record.keys.remove(found)
        return _key(found)

    def _follow(self) -> None:
        """Read the file if it has changed."""
        try:
            found = self.path.stat()
        except FileNotFoundError:
            self._seen, self._exists, self._keys, self.problem = None, False, (), None
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
        self._seen = seen

    def _read(self, found: os.stat_result) -> _KeyFile:
        if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            raise BadSettings(
                "others than its owner could add a key to the file of keys",
                device=str(self.path),
                advice=f"chmod 600 {self.path}",
            )
        try:
            return _KeyFile.model_validate_json(read_bytes(self.path))
        except OSError as error:
            raise BadSettings(
                f"the file of keys can't be read: {error.strerror}",
                device=str(self.path),
                advice="it must be readable by the user that runs the service",
            ) from error
        except ValidationError as error:
            raise BadSettings(
                "the file of keys is damaged, and lets nobody in",
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
                f"the file of keys can't be written: {error.strerror}",
                device=str(self.path),
                advice="run this as the user that runs the service, or name another keys_file",
            ) from error

    def _write(self, record: _KeyFile) -> None:
        """All of it or nothing: a reader never meets half a file."""
        text = json.dumps(record.model_dump(mode="json"), indent=1) + "\n"
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
    return Key(record.name, record.role, record.sha256, record.created_utc, record.hint)


def _keep_owner(file: int, found: os.stat_result) -> None:
    """A file that root writes is its owner's, or its folder's owner's: else the service could not read it."""
    if os.geteuid() == 0:
        os.fchown(file, found.st_uid, found.st_gid)


__all__ = ["Key", "KeyStore", "keys_path", "open_keys", "sha256_of"]
