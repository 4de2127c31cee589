"""What is secret in settings, and texts without it: for records, bundles and whatever is handed to others.

A field is secret by its name (`_SECRET`), unless it names a file; of addresses the user's password, values of
the query, and, of webhooks, the whole path: anyone who knows it may post there.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from mountnav.journal.database import without_password
from mountnav.masking import masked

__all__ = ["MASK", "Masker", "masked_settings", "masked_table", "secrets_in", "secrets_of"]

MASK = "***"
_SECRET = re.compile(
    r"(^|_)(token|tokens|password|passwd|passphrase|secret|secrets|authorization|credentials?|api_?key|pin)"
    r"(_sha256)?$",
    re.IGNORECASE,
)
_OF_SECRETS = re.compile(r"(^|_)headers$", re.IGNORECASE)
"""Tables whose values are secret, whatever they are named."""
_POSTED_TO = re.compile(r"(^|_)(webhook|webhooks|hook)$", re.IGNORECASE)
_USER = re.compile(r"(?P<scheme>[A-Za-z][A-Za-z0-9+.-]*://)(?P<user>[^\s/@]+)@")
_QUERY = re.compile(r"(?P<name>[?&;][^=&\s#\"']{1,100}=)(?P<value>[^&\s#\"']+)")
_PATH = re.compile(r"^(?P<place>[A-Za-z][A-Za-z0-9+.-]*://[^/?#]+)[/?#].*$", re.DOTALL)
_SHORTEST = 4
"""Letters of the shortest secret that is looked for in other texts: a shorter one would take parts of words
with it. Doubled, passwords of five to eight letters stay where somebody wrote them down."""


def masked_settings(settings: BaseModel, **dump: Any) -> dict[str, Any]:
    """Settings as JSON values, without their secrets.

    Parameters
    ----------
    **dump
        As of pydantic's `model_dump`.
    """
    found = _walk(settings.model_dump(mode="json", **dump), "", [])
    assert isinstance(found, dict)
    return found


def secrets_of(settings: BaseModel) -> list[str]:
    """All secrets of settings, for taking them out of other texts."""
    found: list[str] = []
    _walk(settings.model_dump(mode="json"), "", found)
    return found


def secrets_in(table: Mapping[str, Any]) -> list[str]:
    """As `secrets_of`, of a table that is no settings (any more)."""
    found: list[str] = []
    _walk(dict(table), "", found)
    return found


def masked_table(table: Mapping[str, Any]) -> dict[str, Any]:
    """The same of a table that is no settings (any more): what a file holds, or a record tells."""
    found = _walk(dict(table), "", [])
    assert isinstance(found, dict)
    return found


def _walk(value: object, name: str, secrets: list[str], *, posted_to: bool = False) -> object:
    if isinstance(value, Mapping):
        within = posted_to or _POSTED_TO.search(name) is not None
        if _OF_SECRETS.search(name):
            return {key: _hidden(one, secrets) for key, one in value.items()}
        return {key: _walk(one, str(key), secrets, posted_to=within) for key, one in value.items()}
    if isinstance(value, list | tuple):
        within = posted_to or _POSTED_TO.search(name) is not None
        return [_walk(one, name, secrets, posted_to=within) for one in value]
    if value is not None and _SECRET.search(name):
        return _hidden(value, secrets)
    if isinstance(value, str) and "://" in value:
        return _address(value, secrets, posted_to=posted_to)
    return value


def _hidden(value: object, secrets: list[str]) -> object:
    if isinstance(value, Mapping):
        return {key: _hidden(one, secrets) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_hidden(one, secrets) for one in value]
    if value in (None, "", True, False):
        return value
    # of "Bearer abc" the credential alone as well
    secrets += [str(value), str(value).rpartition(" ")[2]]
    return MASK


def _address(text: str, secrets: list[str], *, posted_to: bool) -> str:
    def user(found: re.Match[str]) -> str:
        name, colon, password = found["user"].partition(":")
        secrets.append(password if colon else name)
        return f"{found['scheme']}{name}:{MASK}@" if colon else f"{found['scheme']}{MASK}@"

    text = _USER.sub(user, text)
    if posted_to and (whole := _PATH.match(text)) is not None:
        secrets += [text, text[len(whole["place"]) :]]
        secrets += [
            one for one in re.split(r"[/?#&=]", text[len(whole["place"]) :]) if len(one) > 2 * _SHORTEST
        ]
        return f"{whole['place']}/{MASK}"

    def query(found: re.Match[str]) -> str:
        if not _SECRET.search(found["name"][1:-1]):
            return found[0]
        secrets.append(found["value"])
        return found["name"] + MASK

    return _QUERY.sub(query, text)


class Masker:
    """Takes secrets out of any text.

    Parameters
    ----------
    secrets : iterable of str
        That are known; besides them keys are found by their form, and passwords by standing in addresses.
    """

    def __init__(self, secrets: Iterable[str]) -> None:
        known = {form for one in secrets if len(one) >= _SHORTEST for form in _forms(one)}
        # the longest first: one that holds another goes whole
        words = sorted(known, key=len, reverse=True)
        self._known = re.compile("|".join(map(re.escape, words))) if words else None

    def text(self, text: str) -> str:
        """`text` without secrets."""
        if self._known is not None:
            text = self._known.sub(MASK, text)
        return masked(without_password(text))

    def value(self, value: object, name: str = "") -> object:
        """JSON values without secrets: by their names as well."""
        if isinstance(value, Mapping):
            return {self.text(str(key)): self.value(one, str(key)) for key, one in value.items()}
        if isinstance(value, Sequence) and not isinstance(value, str | bytes):
            return [self.value(one, name) for one in value]
        if isinstance(value, str):
            return MASK if value and _SECRET.search(name) else self.text(value)
        return MASK if value is not None and not isinstance(value, bool) and _SECRET.search(name) else value


def _forms(secret: str) -> Iterator[str]:
    """How a secret may be written: as it is, in JSON, in an address, in bytes."""
    yield secret
    yield json.dumps(secret)[1:-1]
    yield json.dumps(secret, ensure_ascii=False)[1:-1]
    from urllib.parse import quote, unquote

    yield quote(secret, safe="")
    if len(plain := unquote(secret)) >= _SHORTEST:
        yield plain
    yield secret.encode().hex()
