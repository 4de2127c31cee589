"""A stop that has to be known to have stopped, on machines that are too busy to know it at once."""

from __future__ import annotations

import asyncio
from typing import Any

import httpx

PATIENCE_S = 60.0


async def stopped(client: httpx.AsyncClient, path: str, **given: Any) -> httpx.Response:
    """The first answer to a stop that tells what came of it.

    A stop is answered within 2 s, by 202 if the mount hasn't been seen at rest by then: an honest answer of a
    machine that has other work, and no reason to fail. So it is ordered again, as people do.
    """
    async with asyncio.timeout(PATIENCE_S):
        while (answer := await client.post(path, **given)).status_code == 202:
            assert answer.json()["stopped"] is None, answer.text
    return answer
