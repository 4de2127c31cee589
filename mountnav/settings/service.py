"""`[service]`: where the API listens, who may use it, and how much of it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from mountnav.settings.certificates import require_certificate_files
from mountnav.settings.networks import is_loopback
from mountnav.settings.section import Section

_ORIGIN = re.compile(r"https?://(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+)(:\d{1,5})?")


class ServiceSettings(Section):
    """`[service]`: where the API listens, who may use it, and how much of it.

    Attributes
    ----------
    host, port
        Where the service listens; 0 takes any free port.
    api_token_sha256 : str or None
        The sha256 of one token that may do everything: a key named ``token`` with the role configure.
    keys_file : Path or None
        Where `mountnav key` keeps the hashes of API keys. None: ``keys.json`` beside the journal's file.
    max_upload_mb : float
        The largest frame that is taken.
    max_body_kb : float
        The largest body of any other request.
    rate_limit_per_s : float
        Requests per second that one caller may send in the long run; 0 for no limit. Stops are never
        limited.
    rate_burst : int
        So many may come at once after a pause.
    max_connections : int
        HTTP connections at a time; fewer where the system's limit of open files leaves no room.
    connections_per_address : int
        Of these from one address. Behind a reverse proxy all come from its address.
    address_limit_per_s : float
        Requests per second of one address, whatever keys they show; 0 for no limit. Stops are never limited.
        At once come twice as many.
    streams_per_caller : int
        Streams of events that one caller may hold open.
    tls : {"off", "self", "files"}
        https: with a certificate that mountnav makes itself, or with that of `certificate` and
        `certificate_key`. A reverse proxy may do it instead.
    certificate, certificate_key : Path or None
        PEM files; they are read again when they change.
    log_form : {"auto", "text", "json", "journald"}
        How lines are written to the standard error; auto: journald's where it reads it, else text.
    log_level : {"debug", "info", "warning", "error"}
        What is below isn't written.
    cors_origins : tuple of str
        Pages of these origins (``https://host[:port]``) may use the API from a browser. Empty: none but the
        service's own.
    events_kept, jobs_kept : int
        How many stay readable without the journal.
    state_poll_s : float
        How often each mount's state is read.
    """

    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    api_token_sha256: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$")
    keys_file: Path | None = None
    max_upload_mb: float = Field(default=256.0, gt=0, le=4096)
    max_body_kb: float = Field(default=256.0, ge=1, le=1_000_000)
    rate_limit_per_s: float = Field(default=200.0, ge=0, le=100_000)
    rate_burst: int = Field(default=400, ge=1, le=1_000_000)
    max_connections: int = Field(default=512, ge=8, le=512)
    connections_per_address: int = Field(default=128, ge=4, le=512)
    address_limit_per_s: float = Field(default=2000.0, ge=0, le=1_000_000)
    streams_per_caller: int = Field(default=128, ge=1, le=512)
    tls: Literal["off", "self", "files"] = "off"
    certificate: Path | None = None
    certificate_key: Path | None = None
    log_form: Literal["auto", "text", "json", "journald"] = "auto"
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    cors_origins: tuple[str, ...] = ()
    events_kept: int = Field(default=1000, ge=10, le=100_000)
    jobs_kept: int = Field(default=1000, ge=10, le=100_000)
    state_poll_s: float = Field(default=0.5, ge=0.05, le=60)

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the service."""
        return is_loopback(self.host)

    @field_validator("cors_origins")
    @classmethod
    def _origins_are_origins(cls, origins: tuple[str, ...]) -> tuple[str, ...]:
        for origin in origins:
            if not _ORIGIN.fullmatch(origin):
                raise PydanticCustomError(
                    "no_origin",
                    "{origin} is not the origin of a page",
                    {
                        "origin": repr(origin),
                        "fix": 'write scheme, host and port alone: "https://observatory.example:8443"; '
                        "there is no * for all",
                    },
                )
        return origins

    @model_validator(mode="after")
    def _files_are_named(self) -> Self:
        require_certificate_files(self.tls, self.certificate, self.certificate_key)
        return self

    @model_validator(mode="after")
    def _wide_needs_token(self) -> Self:
        if not self.is_loopback and self.api_token_sha256 is None and self.keys_file is None:
            raise PydanticCustomError(
                "wide_without_token",
                "binding {host} lets other machines move the telescope, and no API token is set",
                {
                    "host": self.host,
                    "key": "host",
                    "fix": 'set host = "127.0.0.1", or name a keys_file and make keys with `mountnav key '
                    "new`, or set api_token_sha256 to the output of `printf %s YOUR-TOKEN | sha256sum`",
                },
            )
        return self
