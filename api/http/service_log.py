"""The service's log: lines for people, for journald, or JSON for programs; levels, and instants in UTC.

All goes to the standard error; who rotates files is who writes them (journald, logrotate): the service writes
none.
"""

from __future__ import annotations

import json
import logging
import os
import stat
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Literal, TextIO

from mountnav.masking import mask_logs, masked

__all__ = ["JournaldLines", "JsonLines", "PlainLines", "begin_log", "form_for"]

LogForm = Literal["auto", "text", "json", "journald"]

_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
"""Syslog's priorities of levels [RFC 5424 §6.2.1]; what is below INFO has 7."""
_LEVEL_WIDTH = 8
"""Letters of the longest level, CRITICAL."""


class PlainLines(logging.Formatter):
    """One line each: the instant in UTC, level, logger, words; an exception's lines behind it, set in."""

    def format(self, record: logging.LogRecord) -> str:
        """As a line."""
        level = record.levelname.ljust(_LEVEL_WIDTH)
        return f"{_instant(record)} {level} {record.name}: {_set_in(_words(self, record))}"


class JournaldLines(logging.Formatter):
    """For the standard error of a unit: each line with its priority, without an instant [sd-daemon(3)]."""

    def format(self, record: logging.LogRecord) -> str:
        """As lines."""
        priority = next((number for level, number in _PRIORITIES if record.levelno >= level), 7)
        text = f"{record.name}: {_set_in(_words(self, record))}"
        return "\n".join(f"<{priority}>{line}" for line in text.split("\n"))


class JsonLines(logging.Formatter):
    """One JSON object a line: utc, level, logger, message, and exception where there is one."""

    def format(self, record: logging.LogRecord) -> str:
        """As JSON."""
        told = {
            "utc": _instant(record),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if (fault := _fault(self, record)) is not None:
            told["exception"] = fault
        return json.dumps(told, ensure_ascii=True)


def form_for(form: LogForm, stream: TextIO, environment: Mapping[str, str] = os.environ) -> LogForm:
    """The form that is meant: ``auto`` is journald's where its socket is the stream, else lines."""
    if form != "auto":
        return form
    return "journald" if _is_journald(stream, environment) else "text"


def begin_log(form: LogForm = "auto", level: str = "info", stream: TextIO | None = None) -> logging.Handler:
    """Let this process log to the standard error from now on, whatever logs. Once; twice replaces the first.

    Parameters
    ----------
    level : str
        What is below isn't written.
    stream : file, optional
        Instead of the standard error.
    """
    mask_logs()
    handler = logging.StreamHandler(stream or sys.stderr)
    formatters = {"text": PlainLines, "json": JsonLines, "journald": JournaldLines}
    handler.setFormatter(formatters[form_for(form, handler.stream)]())
    root = logging.getLogger()
    for old in [one for one in root.handlers if isinstance(one.formatter, tuple(formatters.values()))]:
        root.removeHandler(old)
    root.addHandler(handler)
    root.setLevel(level.upper())
    logging.captureWarnings(True)
    # each request to a mount by Alpaca is a line otherwise, and the address of a webhook is a secret
    for chatty in ("httpx", "httpcore", "alembic"):
        logging.getLogger(chatty).setLevel(max(logging.WARNING, root.level))
    return handler


def _instant(record: logging.LogRecord) -> str:
    utc = datetime.fromtimestamp(record.created, UTC)
    return utc.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _words(formatter: logging.Formatter, record: logging.LogRecord) -> str:
    fault = _fault(formatter, record)
    return record.getMessage() + ("" if fault is None else f"\n{fault}")


def _fault(formatter: logging.Formatter, record: logging.LogRecord) -> str | None:
    if record.exc_text:
        # another handler may have made it
        return masked(record.exc_text)
    if record.exc_info and record.exc_info[0] is not None:
        return masked(formatter.formatException(record.exc_info))
    return None


def _set_in(text: str) -> str:
    return text.replace("\r", "\\r").replace("\n", "\n    ")


def _is_journald(stream: TextIO, environment: Mapping[str, str]) -> bool:
    """Whether the stream is the one that systemd has made [systemd.exec(5), JOURNAL_STREAM]."""
    device, _, inode = environment.get("JOURNAL_STREAM", "").partition(":")
    try:
        found = os.fstat(stream.fileno())
    except (OSError, ValueError):
        return False
    return stat.S_ISSOCK(found.st_mode) and (str(found.st_dev), str(found.st_ino)) == (device, inode)
