"""What strangers can have logged is bounded, whatever they send: no flood fills a disk or hides a line.

Two bounds, at the handlers that write, so that no line of code has to think of them:

- of one place in the code so many lines a minute are written, and the rest counted;
- of the access log all requests of those who showed who they are, and so many lines a minute of all others.

What comes from elsewhere stands in one line of bounded length each.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass

from starlette.types import ASGIApp, Receive, Scope, Send

from api.access.callers import Caller
from api.problems import Refused

_EACH_S = 60.0
"""How long lines are counted before it is logged how many were left out, s. Doubled, half as many lines in
all, each summary a minute later."""
_MOST_LINES = 20
"""Of one place in the code, a minute. Doubled, a flood of faults with their traces (5 kB each) writes 12 MB
an hour."""
_MOST_REQUESTS = 120
"""Of those who showed no key, a minute: a probe of a monitor asks once in some seconds. Doubled, a flood
fills 100 MB a day."""
_MOST_TEXT = 500
"""Characters of one value in a line; an address may have 8,192."""
_ACCESS = "uvicorn.access"
_CONTROLS = {number: f"\\x{number:02x}" for number in (*range(32), *range(127, 160))}

_known: ContextVar[bool] = ContextVar("mountnav_caller_known", default=False)
"""Whether the request that is being answered came from somebody who showed who he is."""


class KnownCallers:
    """Tell the log whose requests these are. Plain ASGI.

    Parameters
    ----------
    shows_who : callable
        The caller by what a request shows, not by the listener it came to. Raises `Refused`.
    """

    def __init__(self, app: ASGIApp, shows_who: Callable[[Scope], Caller]) -> None:
        self._app = app
        self._shows_who = shows_who

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] == "http":
            try:
                self._shows_who(scope)
            except Refused:
                _known.set(False)
            else:
                _known.set(True)
        await self._app(scope, receive, send)


@dataclass(slots=True)
class _Minute:
    since_s: float
    lines: int = 0
    left_out: int = 0


class RateLimitedLog(logging.Filter):
    """Lets a handler write so many lines of each place a minute; tells how many more there were."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock_s = clock_s
        self._minutes: dict[tuple[str, str, int], _Minute] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether this line is written."""
        if record.name == __name__:
            return True
        _make_plain(record)
        now_s = self._clock_s()
        self._tell_what_was_left_out(now_s)
        if record.name == _ACCESS and _known.get():
            return True
        place = (record.name, record.pathname, record.lineno)
        minute = self._minutes.setdefault(place, _Minute(now_s))
        minute.lines += 1
        if minute.lines <= (_MOST_REQUESTS if record.name == _ACCESS else _MOST_LINES):
            return True
        minute.left_out += 1
        return False

    def _tell_what_was_left_out(self, now_s: float) -> None:
        # places are as many as the code has
        for place, minute in list(self._minutes.items()):
            if now_s - minute.since_s < _EACH_S:
                continue
            if self._minutes.pop(place, None) is minute and minute.left_out:
                logger, file, line = place
                _log.warning(
                    "%d more lines like those of %s (%s:%d) were not written",
                    minute.left_out,
                    logger,
                    file.rpartition("/")[2],
                    line,
                )


_log = logging.getLogger(__name__)


def limit_log_rates(*loggers: str) -> None:
    """Bound what the handlers of these loggers write, and what goes out where there are none. Twice is fine.

    Parameters
    ----------
    *loggers : str
        Such as ``uvicorn``.
    """
    handlers = [handler for name in loggers for handler in logging.getLogger(name).handlers]
    if logging.lastResort is not None:
        handlers.append(logging.lastResort)
    for handler in handlers:
        if not any(isinstance(log_filter, RateLimitedLog) for log_filter in handler.filters):
            handler.addFilter(RateLimitedLog())


def _make_plain(record: logging.LogRecord) -> None:
    """Bound the values in a line, and have them make no lines of their own."""
    if isinstance(record.args, tuple) and not getattr(record, "plain", False):
        # once: what was cut would be cut again by the next handler
        record.plain = True
        record.args = tuple(_plain(one) for one in record.args)


def _plain(value: object) -> object:
    if value is None or isinstance(value, bool | int | float):
        return value
    try:
        text = str(value)
    except Exception:
        # its formatter will say what is wrong
        return value
    if len(text) > _MOST_TEXT:
        text = f"{text[:_MOST_TEXT]}... ({len(text)} characters)"
    plain = text.translate(_CONTROLS)
    # what is no text stays what it is where it makes no trouble: a number has its own format
    return plain if isinstance(value, str) or plain != str(value) else value


__all__ = ["KnownCallers", "RateLimitedLog", "limit_log_rates"]
