"""HTTP connections: how many there may be and how long they may dawdle, so that a stop always gets through.

uvicorn waits without end for the head of a request, and takes as many connections as there are. Here a
connection that says nothing, or says it too slowly, is closed, and so is one whose request has a head beyond
all bounds; what comes is read in turns (`api.http.fair_scheduling`); one address may hold so many; and when
there are too many, the one that has been idle for longest makes room. If none is idle, a newcomer is let in
all the same, to send a stop and nothing else.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from urllib.parse import unquote

import h11
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from api.access.rate_limits import is_stop
from api.http.fair_scheduling import PIECE_BYTES, ReadingTurns
from api.http.headers import SAFE_HEADERS
from api.listeners.admission import ConnectionRoom, ToldSeldom
from api.problems import problem, refusal_response

_log = logging.getLogger(__name__)

_SWEEP_S = 0.5
"""Deadlines are looked at so often, s: each may last longer by that. Doubled, by a second."""
_MOST_HEAD_BYTES, _MOST_HEAD_LINES = 16_384, 256
"""Of a request; ours have 1 kB and 20 lines. The parser takes 8 µs for a line before anybody sees the
request: doubled, 4 ms of a turn."""
_MOST_WAITING_BYTES = 65_536
"""So much may wait to be read before nothing more is taken from a connection: as much as comes at once."""
_STOP_HEAD = re.compile(
    rb"(POST /v1/stop|POST /v1/telescopes/[^/\s]{1,200}/(night/)?stop|DELETE /v1/jobs/[^/\s]{1,200}"
    rb"|POST /v1/jobs/[^/\s]{1,200}/cancel|PUT /api/v1/telescope/\d{1,9}/abortslew)/?[? ]"
)
"""How the bytes of a stop begin; see `is_stop`."""
_ABSOLUTE = re.compile(rb"https?://(?P<host>[^/?#]*)(?P<path>/.*)?", re.IGNORECASE)
"""The address of a request as proxies are sent it."""
_LOOK_BYTES = 512
"""As many bytes tell a stop, `_STOP_HEAD`; with fewer, one of a telescope with a long name is overlooked."""
_LEAST_BODY_BYTES_S = 1000.0
"""A body that comes more slowly for `Deadlines.body_s` is given up: 256 kB would take it four minutes."""


@dataclass(frozen=True, slots=True)
class Deadlines:
    """How long a client may take, in seconds.

    Attributes
    ----------
    head_s : float
        From its coming, or from the last answer, until the next request's head is there.
    stop_head_s : float
        The same where only a stop is waited for.
    body_s : float
        For the next piece of a body; and the time over which its rate is judged.
    answer_s : float
        To take anything of an answer that waits for it.
    """

    head_s: float = 10.0
    stop_head_s: float = 3.0
    body_s: float = 15.0
    answer_s: float = 30.0


@dataclass(frozen=True, slots=True)
class Bounds:
    """How many connections there may be.

    Attributes
    ----------
    stops : int
        Beyond these: for stops alone. 0 where none are heard: who comes too late is let go.
    fresh : int
        So many more may be there for a moment; see `Room`.
    """

    most: int = 512
    each_address: int = 128
    stops: int = 32
    fresh: int = 8


class Gate:
    """All connections: lets in, makes room, ends those that dawdle. Used from the loop's thread alone.

    Parameters
    ----------
    turns : ReadingTurns, optional
        Shared by the ports of one loop: one piece is read in each of its turns.
    """

    def __init__(
        self, bounds: Bounds, deadlines: Deadlines | None = None, turns: ReadingTurns | None = None
    ) -> None:
        self._bounds = bounds
        self.deadlines = deadlines or Deadlines()
        self._here: ConnectionRoom[Guarded] = ConnectionRoom(bounds.most, bounds.each_address, bounds.fresh)
        self._stopping: set[Guarded] = set()
        self.turns = turns or ReadingTurns()
        self._sweeping: asyncio.TimerHandle | None = None
        self._crowds = ToldSeldom(_log)

    @property
    def hears_stops(self) -> bool:
        """Whether stops are ordered here."""
        return self._bounds.stops > 0

    @property
    def count(self) -> int:
        """How many connections there are."""
        return len(self._here) + len(self._stopping)

    def protocol(self) -> Callable[..., asyncio.Protocol]:
        """What uvicorn makes connections of: ``Config(http=...)``."""
        gate = self

        class OfThisGate(Guarded):
            def __init__(
                self,
                config: Config,
                server_state: ServerState,
                app_state: dict[str, Any],
                _loop: asyncio.AbstractEventLoop | None = None,
            ) -> None:
                super().__init__(gate, config, server_state, app_state, _loop)

        return OfThisGate

    def came(self, one: Guarded) -> None:
        """Let a connection in; another one makes room for it, or it may only stop."""
        if self._sweeping is None:
            self._sweeping = one.loop.call_later(_SWEEP_S, self._sweep, one.loop)
        now_s = one.loop.time()
        taken = self._here.take_in(one, now_s)
        if taken.crowded:
            self._crowds.tell(
                now_s,
                "too many connections (%d, the last from %s): idle ones are closed, stops still get through",
                self.count,
                one.address,
            )
        if taken.goes is not None and self.hears_stops and taken.goes.has_sent_stop():
            self._among_stops(taken.goes)
        elif taken.goes is not None:
            self._drop(taken.goes)
        if not taken.let_in and not self.hears_stops:
            one.transport.abort()
        elif not taken.let_in:
            self._among_stops(one)

    def _among_stops(self, one: Guarded) -> None:
        """Let it send a stop and nothing else; who has been idle for longest among those makes room."""
        one.stops_only = True
        if len(self._stopping) >= self._bounds.stops:
            in_turn = sorted(self._stopping, key=lambda each: (not each.may_go, each.since_s))
            self._drop(next((each for each in in_turn if not each.has_sent_stop()), in_turn[0]))
        self._stopping.add(one)

    def went(self, one: Guarded) -> None:
        """A connection is gone. Twice is fine."""
        self._stopping.discard(one)
        self._here.leave(one)

    def _drop(self, one: Guarded) -> None:
        self.went(one)
        one.transport.abort()

    def _sweep(self, loop: asyncio.AbstractEventLoop) -> None:
        for client in [*self._here, *self._stopping]:
            if client.dawdles(_SWEEP_S):
                self._drop(client)
        self._sweeping = loop.call_later(_SWEEP_S, self._sweep, loop) if self.count else None


class Guarded(H11Protocol):
    """A connection that stands before a gate."""

    def __init__(
        self,
        gate: Gate,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, loop)
        self._gate = gate
        self._served: ASGIApp = self.app
        self.app = self._serve
        self.address = ""
        self.stops_only = False
        self.answered = 0
        self.since_s = self.loop.time()
        """When it came, or was last answered."""
        self._body_bytes = 0
        self._body_waited_s = 0.0
        self._silent_s = 0.0
        self._deaf_s = 0.0
        self._waiting = bytearray()
        self._ended = False

    @property
    def is_idle(self) -> bool:
        """Whether nothing that it asked is being answered: no whole head of a request came since."""
        return self.cycle is None or self.cycle.response_complete

    @property
    def may_go(self) -> bool:
        """Whether it may make room for another one: it is idle, and no stop waits to be read."""
        return self.is_idle and not self.is_urgent

    def has_sent_stop(self) -> bool:
        """Whether a stop came, read or not.

        Between a connection's coming and the reading of its first bytes lie a few turns of the loop. In a
        flood others come in these, and it would have to go before anybody has looked at its bytes.
        """
        return self.is_urgent or (self.is_idle and _STOP_HEAD.match(self._unread()) is not None)

    def _unread(self) -> bytes:
        """What the system has received for this connection, and nobody has taken yet."""
        ours = self.transport.get_extra_info("socket")
        if self._waiting or ours is None:
            return b""
        try:
            with socket.socket(fileno=os.dup(ours.fileno())) as same:
                return same.recv(_LOOK_BYTES, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except OSError:
            return b""

    @property
    def has_spoken(self) -> bool:
        """Whether anything that it asked was answered."""
        return self.answered > 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """It is there."""
        super().connection_made(transport)
        self.address = self.client[0] if self.client else ""
        self._gate.came(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """It is gone; a stop that came before counts."""
        self._gate.went(self)
        if self.is_urgent:
            super().data_received(bytes(self._waiting[:_MOST_HEAD_BYTES]))
        self._waiting.clear()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Something came."""
        self._silent_s = 0.0
        self._body_bytes += len(data)
        if not self._waiting and self._has_sized_body:
            super().data_received(data)
            return
        waited = bool(self._waiting)
        self._waiting += data
        if not waited:
            self._gate.turns.ask(self)
        if len(self._waiting) > _MOST_WAITING_BYTES:
            self.transport.pause_reading()

    def eof_received(self) -> bool:  # type: ignore[override]
        """Nothing more comes; what waits is read before the connection is closed."""
        self._ended = bool(self._waiting)
        return self._ended

    @property
    def _has_sized_body(self) -> bool:
        if self.conn.their_state is not h11.SEND_BODY:
            return False
        names = {name for name, _ in self.headers}
        return b"content-length" in names and b"transfer-encoding" not in names

    @property
    def is_urgent(self) -> bool:
        """Whether what waits is a stop."""
        return (
            self._gate.hears_stops
            and self.conn.their_state is h11.IDLE
            and _STOP_HEAD.match(self._waiting) is not None
        )

    def read_piece(self) -> bool:
        """Read some of what waits; whether more waits."""
        if self.transport.is_closing():
            self._waiting.clear()
            return False
        # a body whose length is told is one event, however much of it waits
        size = len(self._waiting) if self._has_sized_body else PIECE_BYTES
        piece = bytes(self._waiting[:size])
        del self._waiting[:size]
        super().data_received(piece)
        if self._waiting:
            return True
        if self._ended:
            self.transport.close()
        elif not self.flow.read_paused:
            with contextlib.suppress(RuntimeError):  # it is being closed
                self.transport.resume_reading()
        return False

    def handle_events(self) -> None:
        """Go through what was read; a head beyond all bounds is not even parsed."""
        if self.conn.their_state is h11.IDLE:
            head = self.conn.trailing_data[0].partition(b"\r\n\r\n")[0]
            if len(head) > _MOST_HEAD_BYTES or head.count(b"\n") > _MOST_HEAD_LINES:
                self._refuse(431, b"Request Header Fields Too Large", "The head of the request is too long.")
                return
        super().handle_events()

    def on_response_complete(self) -> None:
        """A request was answered; the next one's time begins."""
        self.answered += 1
        self.since_s = self.loop.time()
        self._body_bytes, self._body_waited_s, self._silent_s, self._deaf_s = 0, 0.0, 0.0, 0.0
        super().on_response_complete()

    def dawdles(self, tick_s: float) -> bool:
        """Whether its time is over; to be asked each `tick_s`."""
        deadlines = self._gate.deadlines
        if self.is_idle:
            most_s = deadlines.stop_head_s if self.stops_only else deadlines.head_s
            return self.loop.time() - self.since_s > most_s
        if self.flow.write_paused:
            self._deaf_s += tick_s
            return self._deaf_s > deadlines.answer_s
        self._deaf_s = 0.0
        if self.cycle.more_body and not self.flow.read_paused:
            self._silent_s += tick_s
            self._body_waited_s += tick_s
            slow = (
                self._body_waited_s > deadlines.body_s
                and self._body_bytes < _LEAST_BODY_BYTES_S * self._body_waited_s
            )
            return slow or self._silent_s > deadlines.body_s
        return False

    def send_400_response(self, msg: str) -> None:
        """What was no HTTP is answered as everything is: with the headers that browsers heed."""
        self._refuse(400, b"Bad Request", msg)

    def _refuse(self, status: int, reason: bytes, msg: str) -> None:
        """Answer in place of the application, where it hasn't begun to, and close."""
        if self.cycle is not None and not self.cycle.response_complete:
            # what still works at an answer has nobody to give it to
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        if self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            self.transport.close()
            return
        headers = [
            (b"content-type", b"text/plain; charset=utf-8"),
            (b"connection", b"close"),
            *SAFE_HEADERS,
        ]
        for event in (
            h11.Response(status_code=status, headers=headers, reason=reason),
            h11.Data(data=msg.encode("ascii", "replace")),
            h11.EndOfMessage(),
        ):
            self.transport.write(self.conn.send(event))
        self.transport.close()

    def _should_upgrade(self) -> bool:
        """No other protocol is spoken here, and anyone who asks for one is answered by this one."""
        return False

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        _take_origin_form(scope)
        if _ends_doubtfully(scope):
            # where the next request begins is not sure either: this is the connection's last
            self.cycle.keep_alive = False
            if not is_stop(scope["method"], scope["path"]):
                found = problem("bad-request", 400, "the request gives its length in two ways")
                await refusal_response(scope, found)(scope, receive, send)
                return
        if not self.stops_only or is_stop(scope["method"], scope["path"]):
            await self._served(scope, receive, send)
            return
        found = problem(
            "too-many-connections",
            503,
            "there are too many connections: only a stop is taken now",
            retryable=True,
            advice="close some; [service] max_connections and connections_per_address bound them",
        )
        answer = refusal_response(scope, found)
        answer.headers["Connection"] = "close"
        await answer(scope, receive, send)


def _take_origin_form(scope: Scope) -> None:
    """Take an address that names its host as one that doesn't; its host counts [RFC 9112 §3.2.2]."""
    whole = _ABSOLUTE.match(scope["raw_path"])
    if whole is None:
        return
    scope["raw_path"] = whole["path"] or b"/"
    scope["path"] = unquote(scope["raw_path"].decode("ascii"))
    others = [(name, value) for name, value in scope["headers"] if name != b"host"]
    scope["headers"] = [(b"host", whole["host"]), *others]


def _ends_doubtfully(scope: Scope) -> bool:
    """Whether a proxy may see another end of a request than we do [RFC 9112 §6.1]."""
    names = {name for name, _ in scope["headers"]}
    return b"transfer-encoding" in names and (b"content-length" in names or scope["http_version"] < "1.1")


__all__ = ["Bounds", "Deadlines", "Gate", "Guarded"]
