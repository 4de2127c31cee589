"""The file of `mountnav site`: which services are shown together, and how each of them is reached."""

from __future__ import annotations

import ipaddress
import re
import tomllib
from pathlib import Path
from typing import Literal, Self
from urllib.parse import urlsplit

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from mountnav.errors import BadSettings
from mountnav.files import read_text
from mountnav.parsing import toml_of
from mountnav.settings.certificates import require_certificate_files
from mountnav.settings.explained import explain, syntax_fault
from mountnav.settings.section import Section, require_unique

MOST_SERVICES = 100
"""Each is asked every few seconds and holds two connections. Doubled, so do these."""

_LONGEST_KEY = 500
"""Characters of a key's file; ours have 50."""


class SitePageSettings(Section):
    """`[site]`: where the page of all services is, and who may see it.

    Attributes
    ----------
    host, port
        Where it listens; 0 takes any free port.
    api_token_sha256 : str or None
        The sha256 of a token that may see all and STOP ALL.
    keys_file : Path or None
        Where `mountnav key` keeps hashes of keys: with the role view they see, with operate they STOP ALL.
    tls : {"off", "files"}
        https with the next two; a reverse proxy may do it instead.
    certificate, certificate_key : Path or None
        PEM files.
    poll_s : float
        How often each service is asked.
    """

    host: str = "127.0.0.1"
    port: int = Field(default=8010, ge=0, le=65535)
    api_token_sha256: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$")
    keys_file: Path | None = None
    tls: Literal["off", "files"] = "off"
    certificate: Path | None = None
    certificate_key: Path | None = None
    poll_s: float = Field(default=2.0, ge=0.2, le=60)

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach it."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @model_validator(mode="after")
    def _can_be_served(self) -> Self:
        require_certificate_files(self.tls, self.certificate, self.certificate_key)
        if not self.is_loopback and self.api_token_sha256 is None and self.keys_file is None:
            raise PydanticCustomError(
                "wide_without_token",
                "binding {host} lets other machines see the site and STOP ALL, and no key is set",
                {
                    "host": self.host,
                    "key": "host",
                    "fix": 'set host = "127.0.0.1", or set api_token_sha256 to the output of `printf %s '
                    "YOUR-TOKEN | sha256sum`, or name a keys_file that `mountnav key new NAME --role operate "
                    "--file FILE` has written",
                },
            )
        return self


class SiteServiceSettings(Section):
    """`[[service]]`: one service of the site.

    Attributes
    ----------
    name : str
        For people; each has its own.
    url : str
        Of its API, ``https://dome-1:8000``: scheme, host and port.
    key_file : Path or None
        A file that holds its key and that nobody else can read; it is read again for each call. The role view
        shows, operate stops as well.
    ca_file : Path or None
        Certificates (PEM) that its own must be signed by, instead of the system's.
    fingerprint_sha256 : str or None
        Of its certificate, as ``mountnav serve --tls self`` tells it: no other is taken, whoever signed it.
    """

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]{0,39}$")
    url: str
    key_file: Path | None = None
    ca_file: Path | None = None
    fingerprint_sha256: str | None = Field(default=None, pattern=r"^([0-9a-fA-F]{2}:?){31}[0-9a-fA-F]{2}$")

    @field_validator("url")
    @classmethod
    def _is_an_origin(cls, url: str) -> str:
        try:
            parts = urlsplit(url)
            _ = parts.port
            plain = not (parts.username or parts.password or parts.query or parts.fragment)
            good = parts.scheme in ("http", "https") and bool(parts.hostname) and plain
        except ValueError:
            good = False
        if not good or not re.fullmatch(r"[!-~]{1,200}", url):
            raise PydanticCustomError(
                "no_service_url",
                "this is not the address of a service",
                {"key": "url", "fix": 'write scheme, host and port alone: "https://dome-1:8000"'},
            )
        return url.rstrip("/")

    @model_validator(mode="after")
    def _tls_is_asked_where_it_is(self) -> Self:
        asked = self.ca_file is not None or self.fingerprint_sha256 is not None
        if asked and not self.url.startswith("https:"):
            raise PydanticCustomError(
                "certificate_without_tls",
                "a certificate is asked for, and {url} has none",
                {"url": self.url, "key": "url", "fix": "begin it with https://"},
            )
        if self.ca_file is not None and self.fingerprint_sha256 is not None:
            raise PydanticCustomError(
                "two_certificates",
                "ca_file and fingerprint_sha256 both say which certificate is right",
                {"key": "ca_file", "fix": "remove one of the two"},
            )
        return self

    def key(self) -> str | None:
        """Read the key; None where none is named. Blocks.

        Raises
        ------
        BadSettings
            There is none that can be used.
        """
        if self.key_file is None:
            return None
        try:
            text = read_text(self.key_file, most_bytes=_LONGEST_KEY)
            mode = self.key_file.stat().st_mode
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or "it is no text"
            raise BadSettings(
                f"the key of {self.name} can't be read: {why}",
                device=str(self.key_file),
                advice="put the key alone into that file",
            ) from error
        if mode & 0o077:
            raise BadSettings(
                f"others can read the key of {self.name}",
                device=str(self.key_file),
                advice=f"chmod 600 {self.key_file}",
            )
        key = text.strip()
        if not re.fullmatch(r"[!-~]{8,400}", key):
            raise BadSettings(
                f"the file of the key of {self.name} holds no key",
                device=str(self.key_file),
                advice="put the key alone into that file, as `mountnav key new` printed it",
            )
        return key


class SiteFile(Section):
    """The whole file."""

    site: SitePageSettings = SitePageSettings()
    service: tuple[SiteServiceSettings, ...] = Field(min_length=1, max_length=MOST_SERVICES)

    @field_validator("service")
    @classmethod
    def _names_differ(cls, services: tuple[SiteServiceSettings, ...]) -> tuple[SiteServiceSettings, ...]:
        fix = "give each [[service]] a name of its own"
        require_unique(
            (one.name for one in services), "name_twice", "two services have the name {name}", fix=fix
        )
        return services

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a file; names of files in it are taken from its own folder.

        Raises
        ------
        BadSettings
            With the file, the line, the field, what is wrong, and the fix.
        """
        try:
            text = read_text(path)
        except (OSError, UnicodeDecodeError) as error:
            why = getattr(error, "strerror", None) or "it is not UTF-8 text"
            raise BadSettings(
                f"the site's file can't be read: {why}",
                device=str(path),
                advice="give its path with --config",
            ) from error
        try:
            data = toml_of(text)
        except tomllib.TOMLDecodeError as error:
            raise syntax_fault(str(path), text, error) from error
        try:
            read = cls.model_validate(data)
        except ValidationError as error:
            known = {*cls.model_fields, *SitePageSettings.model_fields, *SiteServiceSettings.model_fields}
            raise explain(error, str(path), text, data, known=known) from error
        folder = path.absolute().parent

        def at(section: Section, *names: str) -> dict[str, Path]:
            found = {name: getattr(section, name) for name in names}
            return {name: folder / one for name, one in found.items() if one is not None}

        page = read.site.model_copy(update=at(read.site, "keys_file", "certificate", "certificate_key"))
        services = tuple(one.model_copy(update=at(one, "key_file", "ca_file")) for one in read.service)
        return read.model_copy(update={"site": page, "service": services})
