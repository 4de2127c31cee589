"""One device of an Alpaca server over HTTP: a question, one answer, one deadline.

- A question may be asked again when its connection broke: it changes nothing.
- An order goes out once, over a connection of its own, so that it never meets one that has just been closed.
  An answer that doesn't come leaves its outcome unknown, and the error says so.
- A stop has a connection of its own, beside all others.

A server may send without end, and 1 MB of gzip unpacks to 1 GB: neither may take the memory, nor
keep the loop from a stop.
"""

from __future__ import annotations

import asyncio
import random
import ssl
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from urllib.parse import urlencode

import httpx

from drivers.alpaca.codec.base import (
    NOT_CONNECTED,
    AlpacaRefused,
    Answer,
    DeviceAddress,
    Malformed,
    Parameters,
    excerpt,
    form,
    next_id,
    read_answer,
    refusal,
)
from drivers.alpaca.codec.exposure import IMAGE_BYTES, ImageAnswer, read_image
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceError, DeviceGarbled, DeviceMissing, DeviceRefused, DeviceSilent, Refusal
from mountnav.reading.unpacking import MOST_BYTES
from mountnav.tasks import fault_words

__all__ = ["MOST_ANSWER_BYTES", "MOST_IMAGE_BYTES", "answered"]


_KEPT = 8
"""A reading of a telescope without DeviceState asks seven questions at once; with fewer, some reconnect."""


class Connections:
    """Three sets of connections, so that no kind waits for another.

    Raises
    ------
    DeviceMissing
        If the file of certificates can't be read.

    Attributes
    ----------
    looks, orders, stops : httpx.AsyncClient
        Those of orders and stops are new each time: they never meet one that has just been closed.
    """

    def __init__(self, where: DeviceAddress) -> None:
        trusted = _trusted(where)
        auth = (where.user, where.password) if where.user or where.password else None

        def client(*, kept: int) -> httpx.AsyncClient:
            return httpx.AsyncClient(
                auth=auth,
                verify=trusted,
                # asyncio.timeout gives each its whole deadline: httpx knows only that of each read
                timeout=None,
                limits=httpx.Limits(max_keepalive_connections=kept),
                headers={"User-Agent": "mountnav"},
                trust_env=False,
            )

        self.looks, self.orders, self.stops = client(kept=_KEPT), client(kept=0), client(kept=0)

    async def close(self) -> None:
        """Release all."""
        for client in (self.looks, self.orders, self.stops):
            await client.aclose()


def _trusted(where: DeviceAddress) -> ssl.SSLContext:
    """Whose certificates count; over plain http nobody's, which costs nothing to load."""
    if not where.server.startswith("https"):
        return ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    trusted = ssl.create_default_context()
    if where.ca is not None:
        try:
            trusted.load_verify_locations(where.ca)
        except OSError as cause:
            raise DeviceMissing(
                f"its certificates can't be read from {where.ca}: {cause}",
                device=where.address,
                advice="see the option ca of its URL",
            ) from cause
    return trusted


MOST_ANSWER_BYTES = 1 << 20
"""Of an answer that is no image; a device's state has some kilobytes. To read more keeps a stop waiting."""

MOST_IMAGE_BYTES = 2 * MOST_BYTES
"""Of an image: in JSON a pixel takes up to twice as many bytes as in the widest type that is read."""

_PLAIN = ("", "identity")
_PACKED = ("gzip", "x-gzip", "deflate")
_EITHER_WRAPPING = 32 + zlib.MAX_WBITS
"""gzip's or zlib's, whichever it has [zlib's manual, inflateInit2]."""


async def answered(
    client: httpx.AsyncClient,
    method: str,
    url: str,
    *,
    most_bytes: int,
    headers: Mapping[str, str] | None = None,
    said: Mapping[str, str] | None = None,
) -> httpx.Response:
    """Send a request and read the whole answer.

    Parameters
    ----------
    most_bytes : int
        What the body may have, unpacked.
    headers, said : mapping, optional
        Headers beside the usual ones, and the form of an order.

    Returns
    -------
    httpx.Response
        With its body.

    Raises
    ------
    Malformed
        The body is longer, or packed in a way that nobody asked for, or its packing is damaged.
    httpx.TransportError
        The connection can't be made, or broke.
    """
    # an answer packed all the same is read, too: some proxies pack
    asked = {"Accept-Encoding": "identity"} | dict(headers or {})
    async with client.stream(method, url, headers=asked, data=said) as response:
        packing = response.headers.get("content-encoding", "").strip().lower()
        if packing not in (*_PLAIN, *_PACKED):
            raise Malformed(f"an answer that is compressed as {packing[:40]!r}")
        unpacking = zlib.decompressobj(_EITHER_WRAPPING) if packing in _PACKED else None
        body = bytearray()
        async for piece in response.aiter_raw():
            if unpacking is not None:
                try:
                    piece = unpacking.decompress(piece, most_bytes - len(body) + 1)
                except zlib.error as broken:
                    raise Malformed(f"an answer whose compression is damaged: {broken}") from broken
            body += piece
            if len(body) > most_bytes:
                raise Malformed(f"an answer of more than {most_bytes} bytes")
        if unpacking is not None and body and not unpacking.eof:
            raise Malformed("a compressed answer that is cut off")
    left = [(name, value) for name, value in response.headers.items() if name != "content-encoding"]
    return httpx.Response(response.status_code, headers=left, content=bytes(body))


_NO_ACCESS = (401, 403)
"""HTTP states that mean a wrong or missing password."""
_LATER = (408, 429)
"""What a busy server says; all else between 400 and 499 is a no."""
_UNKNOWN = ": whether the order was accepted is not known"


def require_understood(response: httpx.Response, what: str, device: str, *, order: bool = False) -> None:
    """Raise what any status but 200 means.

    Raises
    ------
    DeviceMissing
        If the server wants to know who asks, or sends elsewhere.
    AlpacaRefused
        If it says no.
    DeviceSilent
        If it failed over it.
    """
    status = response.status_code
    if status == httpx.codes.OK:
        return
    said = excerpt(response.content)
    if status in _NO_ACCESS:
        raise DeviceMissing(
            f"the server asks for a login (HTTP status {status})",
            device=device,
            advice="put user:password@ before the host in its URL",
        )
    if 300 <= status < 400:
        raise DeviceMissing(
            f"the server redirects (HTTP status {status}, {response.headers.get('location')!r})",
            device=device,
            advice="put the address it names into the URL",
        )
    if 400 <= status < 500 and status not in _LATER:
        raise AlpacaRefused(
            f"refused {what}: HTTP status {status}, {said}",
            device=device,
            advice="is it the right device?",
            reason=Refusal.OTHER if order else Refusal.UNSUPPORTED,
            words=said,
        )
    raise DeviceSilent(
        f"the server failed over {what} (HTTP status {status}, {said}){_UNKNOWN if order else ''}",
        device=device,
        advice="see the server's own log",
    )


def garbled(what: str, fault: Exception, device: str, *, order: bool = False) -> DeviceGarbled:
    """Make the error of an answer that makes no sense."""
    return DeviceGarbled(
        f"gave a nonsensical answer to {what}: {fault}{_UNKNOWN if order else ''}",
        device=device,
        advice="is it an Alpaca server, without a proxy between?",
    )


def understood(what: str, fault: Malformed, device: str) -> DeviceGarbled:
    """Make the error of a value that makes no sense."""
    return DeviceGarbled(f"gave nonsense as its {what}: {fault}", device=device, advice="see its driver")


def require_known(one: DeviceRefused) -> None:
    """Pass over what a device doesn't have; raise any other refusal."""
    if not (isinstance(one, AlpacaRefused) and one.unsupported):
        raise one


_BROKEN = (httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError, httpx.CloseError)
_LOGGED_BYTES = 2000
"""Longer answers are noted in the wire log by their length only. Chosen by hand: `devicestate` fits."""


class AlpacaClient:
    """Questions and orders to one device; it can be opened again after it was lost.

    Parameters
    ----------
    deadline_s : float
        For each question and order.
    """

    def __init__(self, where: DeviceAddress, *, log: WireLog, deadline_s: float = 5.0) -> None:
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
        """Wait until it is lost, and return why."""
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
        """A task of ours that spoke with it hit a fault: what was said on it is not known."""
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
        """What devices the server has, in words; empty if it doesn't say."""
        try:
            url = f"{self.where.server}/management/v1/configureddevices"
            response = await self._question(url, "configureddevices", self.deadline_s)
            value = read_answer(response.content, response.headers.get("content-type", ""), 0).value
            if not isinstance(value, list):
                return []
            return [
                f"{entry['DeviceType'].lower()}/{entry['DeviceNumber']} ({entry['DeviceName']})"
                for entry in value
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
                f"no answer to {member} within {deadline_s:.1f} s: whether the "
                "order was accepted is not known",
                device=self.address,
                advice="see what it does before the next order",
            ) from late
        except (httpx.ConnectError, httpx.UnsupportedProtocol) as fault:
            raise self._unreachable(fault) from fault
        except httpx.TransportError as fault:
            raise DeviceSilent(
                f"the connection broke before {member} was answered ({_words(fault)}): "
                "whether the order was accepted is not known",
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
