"""One device of an Alpaca server over HTTP: a question, one answer, one deadline.

- A question may be asked again when its connection broke: it changes nothing.
- An order goes out once, over a connection of its own, so that it never meets one that has just been closed.
  An answer that doesn't come leaves its outcome unknown, and the error says so.
- A stop has a connection of its own, beside all others.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from urllib.parse import urlencode

import httpx

from drivers.alpaca.bodies import MOST_ANSWER_BYTES, MOST_IMAGE_BYTES, answered
from drivers.alpaca.codec import Answer, Malformed, Parameters, form, next_id, read_answer
from drivers.alpaca.connections import Connections
from drivers.alpaca.image_bytes import IMAGE_BYTES, ImageAnswer, read_image
from drivers.alpaca.refusals import NOT_CONNECTED, refusal
from drivers.alpaca.responses import garbled, require_understood
from drivers.alpaca.where import Where
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceError, DeviceMissing, DeviceSilent
from mountnav.tasks import fault_words

_BROKEN = (httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError, httpx.CloseError)
_LOGGED_BYTES = 2000


class Asking:
    """Questions and orders to one device; it can be opened again after it was lost.

    Parameters
    ----------
    where : Where
    log : WireLog
    deadline_s : float
        For each question and order.
    """

    def __init__(self, where: Where, *, log: WireLog, deadline_s: float = 5.0) -> None:
        self.where = where
        self.log = log
        self.deadline_s = deadline_s
        self._client_id = random.randint(1, 0xFFFF)
        self._transaction = 0
        self._connections: Connections | None = None
        self.connected = False
        """Whether its driver is: then one that says it is not has lost its hardware."""
        self._why_lost: str | None = "not connected"
        self._news = asyncio.Event()
        self._waiting: list[float] = []

    @property
    def address(self) -> str:
        """Server and device, for messages."""
        return self.where.address

    @property
    def usable(self) -> bool:
        """Whether it is open and not lost."""
        return self._why_lost is None

    def unanswered_s(self) -> float:
        """Since when the oldest question waits; 0 when none does."""
        return asyncio.get_running_loop().time() - self._waiting[0] if self._waiting else 0.0

    async def open(self) -> None:
        """Get ready to ask; nothing is sent yet.

        Raises
        ------
        DeviceMissing
            If the file of certificates can't be read.
        """
        await self.close()
        self._connections = Connections(self.where)
        self._why_lost, self.connected = None, False
        self._news = asyncio.Event()

    async def close(self) -> None:
        """Release all connections; closing twice is fine."""
        self.lose("closed by us")
        connections, self._connections = self._connections, None
        if connections is not None:
            await connections.close()

    async def lost(self) -> str:
        """Wait until it is lost, and tell why."""
        while self._why_lost is None:
            await self._news.wait()
        return self._why_lost

    def lose(self, why: str) -> None:
        """Count it as lost from now on."""
        if self._why_lost is None:
            self._why_lost = why
            self.log.note("event", meaning=f"{self.address}: {why}")
            self._news.set()

    def died(self, fault: Exception) -> None:
        """A task of ours that spoke with it hit a fault: what it was told is not known."""
        self.lose(fault_words(fault))

    # -- questions -------------------------------------------------------------------------------

    async def get(
        self, member: str, parameters: Parameters | None = None, *, deadline_s: float | None = None
    ) -> object:
        """Ask for the value of a member.

        Raises
        ------
        AlpacaRefused
            If the device says an error.
        DeviceMissing
            If there is no server, no such device, no access, or its driver is not connected.
        DeviceSilent
            If no answer came in time, or the server failed over the question.
        DeviceGarbled
            If the answer makes no sense.
        """
        transaction, said = self._next(parameters or {})
        url = f"{self.where.url(member)}?{urlencode(said)}"
        with self._asked():
            response = await self._question(url, member, deadline_s or self.deadline_s)
        return self._judged(response, transaction, f"a question for {member}").value

    async def image(self, *, deadline_s: float) -> ImageAnswer:
        """Ask for the image, as ImageBytes if the server can.

        Raises
        ------
        AlpacaRefused, DeviceMissing, DeviceSilent, DeviceGarbled
            As of `get`.
        """
        transaction, said = self._next({})
        url = f"{self.where.url('imagearray')}?{urlencode(said)}"
        accept = {"Accept": f"{IMAGE_BYTES}, application/json;q=0.5"}
        with self._asked():
            response = await self._question(url, "imagearray", deadline_s, accept, MOST_IMAGE_BYTES)
        require_understood(response, "a question for imagearray", self.address)
        try:
            kind = response.headers.get("content-type", "")
            told = await asyncio.to_thread(read_image, response.content, kind, transaction)
        except Malformed as fault:
            raise garbled("imagearray", fault, self.address) from fault
        self._require_no_error(told.answer, "a question for imagearray")
        return told

    async def described(self) -> list[str]:
        """What devices the server has, in words; empty if it doesn't tell."""
        try:
            url = f"{self.where.server}/management/v1/configureddevices"
            response = await self._question(url, "configureddevices", self.deadline_s)
            value = read_answer(response.content, response.headers.get("content-type", ""), 0).value
            if not isinstance(value, list):
                return []
            return [
                f"{one['DeviceType'].lower()}/{one['DeviceNumber']} ({one['DeviceName']})" for one in value
            ]
        except (DeviceError, Malformed, TypeError, KeyError, AttributeError):
            return []

    async def _question(
        self,
        url: str,
        member: str,
        deadline_s: float,
        headers: dict[str, str] | None = None,
        most_bytes: int = MOST_ANSWER_BYTES,
    ) -> httpx.Response:
        """Ask, once more if the connection broke."""
        self.log.note("driver->mount", f"GET {_shown(url)}".encode())
        client = self._open_ones().looks
        ask = partial(answered, client, "GET", url, most_bytes=most_bytes, headers=headers)
        try:
            async with asyncio.timeout(deadline_s):
                try:
                    response = await ask()
                except _BROKEN as broken:
                    self.log.note("event", meaning=f"asked again: {_words(broken)}")
                    response = await ask()
        except TimeoutError as late:
            raise DeviceSilent(
                f"no answer to a question for {member} within {deadline_s:.1f} s",
                device=self.address,
                advice="is the server busy, or the network slow?",
            ) from late
        except Malformed as fault:
            raise garbled(member, fault, self.address) from fault
        except httpx.TransportError as fault:
            raise self._unreachable(fault) from fault
        self._note_answer(response)
        return response

    # -- orders ----------------------------------------------------------------------------------

    async def put(
        self, member: str, parameters: Parameters | None = None, *, deadline_s: float | None = None
    ) -> None:
        """Give an order, once.

        Raises
        ------
        AlpacaRefused
            If the device says no: nothing was changed.
        DeviceMissing
            If the order can't have reached it.
        DeviceSilent, DeviceGarbled
            If its answer did not come or made no sense: what came of it is not known.
        """
        with self._asked():
            client = self._open_ones().orders
            await self._order(client, member, parameters or {}, deadline_s or self.deadline_s)

    async def put_past_all(self, member: str, *, deadline_s: float | None = None) -> None:
        """Give an order beside all others, as `put`."""
        await self._order(self._open_ones().stops, member, {}, deadline_s or self.deadline_s)

    async def _order(
        self, client: httpx.AsyncClient, member: str, parameters: Parameters, deadline_s: float
    ) -> None:
        transaction, said = self._next(parameters)
        url = self.where.url(member)
        self.log.note("driver->mount", f"PUT {_shown(url)} {urlencode(said)}".encode())
        try:
            async with asyncio.timeout(deadline_s):
                response = await answered(client, "PUT", url, most_bytes=MOST_ANSWER_BYTES, said=said)
        except TimeoutError as late:
            raise DeviceSilent(
                f"no answer to {member} within {deadline_s:.1f} s: whether it was taken up is not known",
                device=self.address,
                advice="see what it does before the next order",
            ) from late
        except (httpx.ConnectError, httpx.UnsupportedProtocol) as fault:
            raise self._unreachable(fault) from fault
        except httpx.TransportError as fault:
            raise DeviceSilent(
                f"the connection broke before {member} was answered ({_words(fault)}): "
                "whether it was taken up is not known",
                device=self.address,
                advice="see what it does before the next order",
            ) from fault
        except Malformed as fault:
            raise garbled(member, fault, self.address, order=True) from fault
        self._note_answer(response)
        self._judged(response, transaction, member, order=True)

    # -- what came back --------------------------------------------------------------------------

    def _judged(
        self, response: httpx.Response, transaction: int, what: str, *, order: bool = False
    ) -> Answer:
        require_understood(response, what, self.address, order=order)
        try:
            kind = response.headers.get("content-type", "")
            answer = read_answer(response.content, kind, transaction)
        except Malformed as fault:
            raise garbled(what, fault, self.address, order=order) from fault
        self._require_no_error(answer, what)
        return answer

    def _require_no_error(self, answer: Answer, what: str) -> None:
        if answer.error_number == NOT_CONNECTED and self.connected:
            words = f"its server says that it is not connected ({answer.error_message or 'no reason told'})"
            self.lose(words)
            raise DeviceMissing(words, device=self.address, advice="see whether another program disconnected")
        if answer.error_number:
            raise refusal(what, answer.error_number, answer.error_message, self.address)

    def _unreachable(self, fault: Exception) -> DeviceMissing:
        self.lose(f"the server can't be reached: {_words(fault)}")
        return DeviceMissing(
            f"the server can't be reached: {_words(fault)}",
            device=self.address,
            advice="is it running? check host, port and http or https",
        )

    # -- inside ----------------------------------------------------------------------------------

    def _open_ones(self) -> Connections:
        if self._connections is None or self._why_lost is not None:
            raise DeviceMissing(
                f"the connection is lost: {self._why_lost}", device=self.address, advice="connect again"
            )
        return self._connections

    def _next(self, parameters: Parameters) -> tuple[int, dict[str, str]]:
        self._transaction = next_id(self._transaction)
        return self._transaction, form(parameters, self._client_id, self._transaction)

    @contextmanager
    def _asked(self) -> Iterator[None]:
        began = asyncio.get_running_loop().time()
        self._waiting.append(began)
        try:
            yield
        finally:
            self._waiting.remove(began)

    def _note_answer(self, response: httpx.Response) -> None:
        kind = response.headers.get("content-type", "")
        whole = not kind.startswith(IMAGE_BYTES) and len(response.content) <= _LOGGED_BYTES
        body = response.content if whole else f"<{len(response.content)} bytes of {kind}>".encode()
        self.log.note("mount->driver", f"{response.status_code} ".encode() + body)


def _shown(url: str) -> str:
    """What stands after the host."""
    return "/" + url.split("/", 3)[3]


def _words(fault: Exception) -> str:
    return str(fault) or type(fault).__name__
