"""Secrets of settings: each kind of them is masked, wherever it stands and however it is written."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import get_args

import pytest
from pydantic import BaseModel

from mountnav.errors import BadSettings
from mountnav.settings.observatory import Settings
from mountnav.settings.secrets import MASK, Masker, masked_settings, masked_table, secrets_of

SITE = "[site]\nlatitude_deg = 47.0\nlongitude_deg = 11.0\n"
FULL = (
    SITE
    + """
[service]
api_token_sha256 = "TOKEN"
keys_file = "/var/lib/mountnav/keys.json"
[journal]
url = "postgresql://mountnav:jour%6eal-pass@db/nights"
audit_key_file = "/etc/mountnav/audit.key"
[[catalogs.online]]
name = "vizier"
table = "I/355/gaiadr3"
url = "https://catalog-user:catalog-pass@vizier.example/viz?token=vizier-token&x=1"
[report]
[[report.webhook]]
url = "https://hooks.slack.example/services/T0001/B0002/slack-secret-path"
kind = "slack"
headers = { Authorization = "Bearer header-secret", X-Plain = "also-hidden" }
[[report.webhook]]
url = "https://ntfy.example"
kind = "ntfy"
topic = "our-mornings"
[[telescope]]
id = "east"
[telescope.mount]
url = "alpaca+http://alpaca-user:alpaca-pass@10.0.0.5:11111/0"
[telescope.camera]
kind = "folder"
path = "/frames"
""".replace("TOKEN", "ab" * 32)
)
SECRETS = [
    "ab" * 32,
    "jour%6eal-pass",
    "catalog-pass",
    "vizier-token",
    "slack-secret-path",
    "T0001/B0002",
    "header-secret",
    "also-hidden",
    "alpaca-pass",
]
KEPT = [
    "/var/lib/mountnav/keys.json",
    "/etc/mountnav/audit.key",
    "catalog-user",
    "hooks.slack.example",
    "ntfy.example",
    '"id": "east"',
]


@pytest.fixture(scope="module")
def settings() -> Settings:
    return Settings.parse(FULL)


def _fields(kind: object, before: str) -> Iterator[tuple[str, object]]:
    """All fields of all tables, however deep."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        for name, one in kind.model_fields.items():
            yield f"{before}{name}", one.annotation
            yield from _fields(one.annotation, f"{before}{name}.")
    else:
        for part in get_args(kind):
            yield from _fields(part, before)


def test_every_kind_of_secret_is_masked_and_nothing_else(settings: Settings) -> None:
    text = json.dumps(masked_settings(settings))
    assert [one for one in SECRETS if one in text] == []
    assert [one for one in KEPT if one not in text] == []
    told = json.loads(text)
    assert told["report"]["webhook"][0]["url"] == f"https://hooks.slack.example/{MASK}"
    assert told["service"]["api_token_sha256"] == MASK
    # what is masked can be taken out of any other text as well, however it is written there
    masker = Masker(secrets_of(settings))
    # a part of a webhook's path that is as short as a word is no secret by itself
    planted = [one for one in SECRETS if one != "T0001/B0002"]
    journal = "".join(f"log {one} \u2192 {one.encode().hex()} {json.dumps(one)}\n" for one in planted)
    clean = masker.text(journal)
    assert [one for one in planted if one in clean or one.encode().hex() in clean] == []


def test_a_field_that_sounds_secret_is_masked_or_named_here() -> None:
    """So that a new one can't be forgotten: whoever adds it decides."""
    sounds = ("token", "password", "passphrase", "secret", "credential", "key", "authorization", "header")
    paths = {"keys_file", "certificate_key", "audit_key_file"}  # of files: their content never leaves
    for path, annotation in _fields(Settings, ""):
        name = path.rpartition(".")[2]
        if not any(word in name for word in sounds) or name in paths or "bool" in str(annotation):
            continue
        found = masked_table({name: {"a": "planted-secret"} if "header" in name else "planted-secret"})
        assert (path, "planted-secret" in json.dumps(found)) == (path, False)


def test_keys_and_passwords_in_any_text_go_too() -> None:
    masker = Masker([])
    key = "mnk_" + "x" * 43
    text = masker.text(f"GET /v1/jobs?key={key} postgresql://u:p\u00e4ss@h/db {key}")
    assert key not in text
    assert "p\u00e4ss" not in text
    assert masker.value({"lease": {"token": "t0p"}, "n": 1, "list": [key]}) == {
        "lease": {"token": MASK},
        "n": 1,
        "list": ["mnk_***"],
    }


@pytest.mark.parametrize(
    "report",
    [
        'webhook = [{ url = "ftp://x" }]',
        'webhook = [{ url = "https://user:pass@x/y" }]',
        'webhook = [{ url = "https://x", template = "{" }]',
        'webhook = [{ url = "https://x", headers = { "A: b" = "c" } }]',
        'webhook = [{ url = "https://x", headers = { A = "b\\r\\nc" } }]',
        'webhook = [{ url = "https://x", headers = { Host = "y" } }]',
        'webhook = [{ url = "https://x", kind = "ntfy", topic = "a b" }]',
        "forms = []",
        "retry_h = 1e9",
    ],
)
def test_reports_that_could_go_nowhere_are_refused(report: str) -> None:
    telescope = FULL[FULL.index("[[telescope]]") :]
    with pytest.raises(BadSettings) as refused:
        Settings.parse(f"{SITE}[report]\n{report}\n{telescope}")
    assert report.partition(" ")[0] in str(refused.value)
