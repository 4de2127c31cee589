"""What must be there in a test."""

from __future__ import annotations

from typing import TypeVar

T = TypeVar("T")


def present(value: T | None) -> T:
    """Return a value that must be there: a test fails here that finds none."""
    assert value is not None
    return value
