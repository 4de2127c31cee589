"""How values lie in the database: instants as UTC with microseconds, JSON without NaN, text without NUL."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, date, datetime
from enum import Enum
from typing import Any

from sqlalchemy import JSON, DateTime, Dialect, Float, Text, TypeDecorator

_DEEPEST = 20


class UtcTime(TypeDecorator[datetime]):
    """An instant: ``2026-11-22 03:12:45.123456`` (UTC) in SQLite, ``timestamptz`` in PostgreSQL."""

    impl = DateTime
    cache_ok = True

    def load_dialect_impl(self, dialect: Dialect) -> Any:
        """With a zone where the database knows zones."""
        return dialect.type_descriptor(DateTime(timezone=dialect.name != "sqlite"))

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """To the database; an instant without a zone is UTC."""
        if value is None:
            return None
        aware = value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)
        return aware.replace(tzinfo=None) if dialect.name == "sqlite" else aware

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """From the database: always aware UTC."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Number(TypeDecorator[float]):
    """A double; NaN and infinities are NULL: a value that is none is not known."""

    impl = Float(53)
    cache_ok = True

    def process_bind_param(self, value: float | None, dialect: Dialect) -> float | None:
        """To the database."""
        return None if value is None or not math.isfinite(value) else float(value)


class Words(TypeDecorator[str]):
    """Text that any database takes: no NUL, no half of a surrogate pair."""

    impl = Text
    cache_ok = True

    def process_bind_param(self, value: str | None, dialect: Dialect) -> str | None:
        """To the database."""
        return None if value is None else plain_text(value)


class Facts(TypeDecorator[Any]):
    """A JSON value."""

    impl = JSON(none_as_null=True)
    cache_ok = True

    def process_bind_param(self, value: object, dialect: Dialect) -> object:
        """To the database."""
        return plain_json(value)


def plain_text(text: str) -> str:
    """`text` with what databases refuse (NUL, lone surrogates) replaced by U+FFFD."""
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace").replace("\0", "\ufffd")


def plain_json(value: object, depth: int = 0) -> object:
    """`value` as JSON can hold it, whatever somebody put into facts: it never fails for a fact's type.

    NaN and infinities become null, instants ISO 8601 text, enumerations their values, mappings objects
    with text keys, sequences and sets arrays, numpy's scalars and arrays numbers and lists; all else, and
    what is nested too deep, becomes its text.
    """
    if isinstance(value, Enum):
        return plain_json(value.value, depth)
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, str):
        return plain_text(value)
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, datetime | date):
        return value.isoformat()
    if depth < _DEEPEST:
        if isinstance(value, Mapping):
            return {plain_text(str(key)): plain_json(one, depth + 1) for key, one in value.items()}
        if isinstance(value, list | tuple | set | frozenset):
            return [plain_json(one, depth + 1) for one in value]
        if callable(tolist := getattr(value, "tolist", None)):
            return plain_json(tolist(), depth + 1)
    return plain_text(str(value))
