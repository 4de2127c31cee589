"""An instant in a query: ISO 8601, never a bare number, which would pass for seconds since 1970."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import BeforeValidator


def _as_text(value: object) -> object:
    if isinstance(value, str):
        try:
            float(value)
        except ValueError:
            return value
    elif value is None or isinstance(value, datetime):
        return value
    raise ValueError("no instant: write 2026-12-01T22:00:00Z")


Instant = Annotated[datetime, BeforeValidator(_as_text)]
"""Of a query parameter."""
