"""Keys are masked in whatever is logged, answered or written down: they belong into headers alone."""

from __future__ import annotations

import logging
import re
import traceback
from typing import Any

_KEY = re.compile(r"mnk(_|%5f)[A-Za-z0-9_%-]+", re.IGNORECASE)
_QUERY = re.compile(
    r"(?P<name>[?&](?:key|api[-_]?key|x-api-key|token|access_token|password)=)[^&\s\"'#]+", re.IGNORECASE
)
_MASK = "mnk_***"


def masked(text: str) -> str:
    """`text` with the keys in it, and values of a query that are named as keys are, made unreadable."""
    if "=" in text:
        text = _QUERY.sub(r"\g<name>***", text)
    return _KEY.sub(_MASK, text) if "mnk" in text.lower() else text


def mask_logs() -> None:
    """From now on mask all that is logged in this process, whatever logs it and wherever it goes.

    At the making of records: no logger or handler, of whatever library, is left out. Twice is fine.
    """
    make = logging.getLogRecordFactory()
    if getattr(make, "masks", False):
        return

    def make_masked(*args: Any, **kwargs: Any) -> logging.LogRecord:
        record = make(*args, **kwargs)
        if isinstance(record.msg, str):
            record.msg = masked(record.msg)
        if isinstance(record.args, tuple):
            record.args = tuple(_masked_value(one) for one in record.args)
        elif record.args:
            record.args = {name: _masked_value(one) for name, one in record.args.items()}
        if record.exc_info and record.exc_info[0] is not None:
            text = "".join(traceback.format_exception(*record.exc_info)).rstrip("\n")
            if (clean := masked(text)) != text:
                # formatters take this instead of formatting the exception themselves
                record.exc_text, record.exc_info = clean, None
        return record

    make_masked.masks = True  # type: ignore[attr-defined]
    logging.setLogRecordFactory(make_masked)


def _masked_value(value: object) -> object:
    if value is None or isinstance(value, bool | int | float):
        return value
    if isinstance(value, str):
        return masked(value)
    try:
        text = str(value)
    except Exception:
        # what formats it will say what is wrong
        return value
    return clean if (clean := masked(text)) != text else value


__all__ = ["mask_logs", "masked"]
