"""Waiting in tests for what shows by itself."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

PATIENCE_S = 180.0
"""So long at most, s: only what never comes is waited for that long, on a busy machine too."""


async def until(true: Callable[[], object], what: str) -> None:
    """Wait until something is true that no event tells of."""
    try:
        async with asyncio.timeout(PATIENCE_S):
            while not true():
                await asyncio.sleep(0.01)
    except TimeoutError:
        raise AssertionError(f"not {what}") from None
