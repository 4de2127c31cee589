"""A toy face: a TCP port on which ``state`` is answered by an altitude, and ``stop`` stops the telescope."""

from __future__ import annotations

import asyncio

from api.access.callers import Caller, Face, Role
from api.listeners.tcp import Allowance, TcpPort, Turns
from api.problems import Refused
from api.service import Service

_AT_ONCE_BYTES = 256
"""Bytes taken in one read; a word of this protocol has five."""
_LONGEST_LINE_BYTES = 80
"""A client that sends a longer line doesn't speak this protocol, and is let go."""
_LONGEST_SILENCE_S = 10.0
"""A client that takes no answer for so long is let go, s."""


class ToyFace:
    """Serves one telescope; implements `api.listeners.listeners.Listener`."""

    def __init__(self, service: Service, telescope_id: str, *, role: Role, port: int = 0) -> None:
        self._id, self._role = telescope_id, role
        self._dispatcher = service.dispatcher
        self._watch = service.dispatcher.watch(telescope_id)
        self._turns = Turns()
        self._listening = TcpPort("127.0.0.1", port, self._serve, name="the toy's port")

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that it listens on."""
        return self._listening.address

    async def start(self) -> None:
        """Listen. Raises `BadSettings`."""
        await self._listening.start()

    async def stop(self) -> None:
        """Listen no more, and let all clients go."""
        await self._listening.stop()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        host = str(writer.get_extra_info("peername")[0])
        # a real face has a name of its own in `Face`
        caller = Caller(f"toy {host}", self._role, Face.SERVICE, host)
        allowance, begun = Allowance(), b""
        while data := await reader.read(_AT_ONCE_BYTES):
            await allowance.spend(len(data))
            *lines, begun = (begun + data).split(b"\n")
            for line in lines:
                # one client's many lines are not one turn of the loop
                await self._turns.mine()
                writer.write(await self._answer(caller, line.strip()) + b"\n")
                async with asyncio.timeout(_LONGEST_SILENCE_S):
                    await writer.drain()
            if len(begun) > _LONGEST_LINE_BYTES:
                return

    async def _answer(self, caller: Caller, word: bytes) -> bytes:
        if word == b"state":
            altitude_deg = self._watch.latest.state.altitude_deg
            return b"unknown" if altitude_deg is None else f"{altitude_deg:.3f}".encode()
        if word == b"stop":
            return await self._stop(caller)
        return b"what?"

    async def _stop(self, caller: Caller) -> bytes:
        try:
            given = await self._dispatcher.give_stop(caller, self._id)
        except Refused as refusal:
            return f"refused: {refusal}".encode()
        if given.error is not None:
            return f"failed: {given.error}".encode()
        return b"stopped" if given.sent else b"stopping"
