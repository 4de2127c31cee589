"""`[report]`: where the morning report goes by itself."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, field_validator
from pydantic_core import PydanticCustomError

from mountnav.night.message_kind import MessageKind
from mountnav.settings.section import Section

__all__ = ["ReportSettings", "WebhookSettings"]

_NAME = re.compile(r"[A-Za-z0-9!#$%&'*+.^_`|~-]{1,100}")
"""Of a header [RFC 9110 §5.1]."""
_VALUE = re.compile(r"[\x20-\x7e]{0,2000}")
_OURS = frozenset({"host", "content-length", "transfer-encoding", "connection"})


def _template(text: str) -> str:
    try:
        json.loads(text)
    except (ValueError, RecursionError) as wrong:
        raise PydanticCustomError(
            "no_template",
            "the template is not JSON: {why}",
            {"why": str(wrong), "fix": 'such as {"text": "${title}: ${summary}"}'},
        ) from wrong
    return text


class WebhookSettings(Section):
    """`[[report.webhook]]`: one address that the report is posted to.

    Attributes
    ----------
    url : str
        Anyone who knows it may post there: it is masked wherever it is told.
    kind : {"json", "slack", "discord", "ntfy"}
        What is posted: the whole report as JSON; or a message as these services take it.
    topic : str
        Of ntfy: then `url` is that of its server.
    template : str
        JSON instead, in whose strings ``${title}``, ``${summary}``, ``${text}`` (Markdown), ``${night}``,
        ``${telescopes}``, ``${advice}`` and ``${audit}`` are replaced.
    headers : dict of str to str
        Sent as well, such as Authorization.
    """

    url: str = Field(pattern=r"^https?://[^\s/?#@]+(/\S*)?$", max_length=1000)
    kind: MessageKind = "json"
    topic: str = Field(default="", pattern=r"^[A-Za-z0-9_-]{0,64}$")
    template: Annotated[str, Field(max_length=20_000), AfterValidator(_template)] | None = None
    headers: dict[str, str] = Field(default={}, max_length=20)

    @field_validator("headers")
    @classmethod
    def _headers_are_headers(cls, headers: dict[str, str]) -> dict[str, str]:
        for name, value in headers.items():
            if not _NAME.fullmatch(name) or name.lower() in _OURS or not _VALUE.fullmatch(value):
                raise PydanticCustomError(
                    "no_header",
                    "{name} is not a header that can be sent",
                    {
                        "name": repr(name[:100]),
                        "fix": "a name and a line of ASCII; none of the connection",
                    },
                )
        return headers


class ReportSettings(Section):
    """`[report]`: where the morning report goes by itself, once a night, after sunrise.

    Attributes
    ----------
    folder : Path or None
        It is written there, as ``2026-11-25.html`` and so on.
    forms : tuple of {"html", "markdown", "json"}
        In which forms.
    keep_days : float
        Reports in the folder that are older are removed; 0 keeps all.
    retry_h : float
        So long an address that fails is tried again, hours.
    """

    folder: Path | None = None
    forms: tuple[Literal["html", "markdown", "json"], ...] = Field(default=("html", "json"), min_length=1)
    keep_days: float = Field(default=0.0, ge=0, le=100_000)
    retry_h: float = Field(default=6.0, ge=0, le=20)
    webhook: tuple[WebhookSettings, ...] = Field(default=(), max_length=10)

    @property
    def wanted(self) -> bool:
        """Whether it goes anywhere."""
        return self.folder is not None or bool(self.webhook)
