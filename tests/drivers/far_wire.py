"""A TCP line to somewhere far away: what goes in at one end comes out at the other later, in order."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager


@asynccontextmanager
async def far(host: str, port: int, way_s: Callable[[], float]) -> AsyncIterator[int]:
    """Give the port of a relay that takes `way_s` for each piece, each way.

    Parameters
    ----------
    host, port
        Of the near end.
    way_s : callable
        Seconds one way, asked for each piece.
    """
    ends: set[asyncio.StreamWriter] = set()

    async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        loop = asyncio.get_running_loop()
        under_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

        async def deliver() -> None:
            while True:
                due_s, data = await under_way.get()
                await asyncio.sleep(max(0.0, due_s - loop.time()))
                if not data:
                    return
                writer.write(data)

        delivering = asyncio.create_task(deliver())
        try:
            while data := await reader.read(65536):
                under_way.put_nowait((loop.time() + way_s(), data))
            under_way.put_nowait((loop.time() + way_s(), b""))
            await delivering
        except OSError:
            pass
        finally:
            delivering.cancel()
            writer.close()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, to_there = await asyncio.open_connection(host, port)
        ends.update((writer, to_there))
        await asyncio.gather(carry(reader, to_there), carry(there, writer), return_exceptions=True)

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield int(server.sockets[0].getsockname()[1])
    finally:
        server.close()
        for end in ends:
            end.close()
        await asyncio.sleep(0)
