"""A morning report as a message: what a chat, a phone or a program gets posted. Pure; posts nothing."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from string import Template
from typing import Any

from mountnav.night.message_kind import MessageKind
from mountnav.night.morning_report import MorningReport
from mountnav.night.report_pages import as_markdown

__all__ = ["body_of", "words_of"]

_SLACK_LONGEST, _DISCORD_LONGEST, _NTFY_LONGEST = 12_000, 1900, 3500
"""Characters that each takes, below its own bound (40,000; 2,000; 4,096 bytes). Doubled, it is refused."""
_MORE = "\n… (the rest stands in the report)"


def words_of(reports: Sequence[MorningReport], night: str, audit: str = "") -> dict[str, str]:
    """What a template may name.

    Parameters
    ----------
    reports : sequence of MorningReport
        Of one night, each of one telescope.
    night : str
        The date of its evening.
    audit : str
        Where the audit's chain stands: posted elsewhere, it shows later that nothing was cut off.
    """
    lines = [
        f"{one.telescope}: {one.centered} of {len(one.centerings)} targets centered, "
        f"{one.solved} of {one.looks} looks solved"
        if one.first_utc is not None
        else f"{one.telescope}: nothing was done"
        for one in reports
    ]
    advice = [f"{one.telescope}: {words}" for one in reports for words in one.advice]
    return {
        "title": f"mountnav, night of {night}",
        "summary": "; ".join(lines) + (f". {len(advice)} things to do" if advice else ""),
        "text": "\n".join(as_markdown(one) for one in reports),
        "night": night,
        "telescopes": ", ".join(one.telescope for one in reports),
        "advice": "\n".join(advice),
        "audit": audit,
    }


def body_of(
    kind: MessageKind,
    reports: Sequence[MorningReport],
    words: Mapping[str, str],
    *,
    template: str | None = None,
    topic: str = "",
) -> Any:
    """The JSON that an address gets.

    Parameters
    ----------
    words : mapping of str to str
        Of `words_of`.
    template : str, optional
        JSON with names of `words` in it, instead of what the kind would get.
    topic : str
        Of ntfy.
    """
    if template is not None:
        return _filled(json.loads(template), words)
    if kind == "slack":
        return {"text": _cut(f"*{words['title']}*\n{words['summary']}\n\n{words['text']}", _SLACK_LONGEST)}
    if kind == "discord":
        said = _cut(f"**{words['title']}**\n{words['summary']}\n\n{words['text']}", _DISCORD_LONGEST)
        # names of targets come from strangers: nobody is called by them
        return {"content": said, "allowed_mentions": {"parse": []}}
    if kind == "ntfy":
        told = f"{words['summary']}\n{words['advice']}".strip()
        return {
            "topic": topic,
            "title": words["title"],
            "message": _cut(told, _NTFY_LONGEST, in_bytes=True),
        }
    return {
        "form": "mountnav-report-1",
        **{name: words[name] for name in ("title", "summary", "night", "audit")},
        "reports": [one.as_dict() for one in reports],
    }


def _filled(value: Any, words: Mapping[str, str]) -> Any:
    """A template with its words; what stands in them makes no JSON of its own, and no further template."""
    if isinstance(value, str):
        return Template(value).safe_substitute(words)
    if isinstance(value, dict):
        return {_filled(key, words): _filled(one, words) for key, one in value.items()}
    if isinstance(value, list):
        return [_filled(one, words) for one in value]
    return value


def _cut(text: str, longest: int, *, in_bytes: bool = False) -> str:
    if (len(text.encode()) if in_bytes else len(text)) <= longest:
        return text
    room = longest - (len(_MORE.encode()) if in_bytes else len(_MORE))
    kept = text.encode()[:room].decode("utf-8", "ignore") if in_bytes else text[:room]
    return kept + _MORE
