"""What a program does by each face, all with the same verbs: go there, stop, sync, park; and was it taken?"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import httpx

from api.planetarium.stellarium_codec import Goto
from drivers.indi.codec import messages as orders
from drivers.indi.codec.messages import Changed, Defined, Event, Reader, State
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import Apparent
from tests.api.all_faces.attacked_service import Standing
from tests.api.planetarium.stellarium_client import goto_message
from tests.waiting import PATIENCE_S

EAST = "/v1/telescopes/east"
FACES = ("rest", "alpaca", "indi", "lx200", "stellarium")


@dataclass(frozen=True)
class Told:
    """What a face has answered: whether the order was taken; None where it has no word for that."""

    taken: bool | None
    words: str


class Hand(Protocol):
    """A program that came by one face."""

    face: str

    async def goto(self, place: Apparent) -> Told:
        """Order a slew."""
        ...

    async def sync(self, place: Apparent) -> Told:
        """Say that it points there."""
        ...

    async def park(self) -> Told:
        """Order it to its park position."""
        ...

    async def stop(self) -> Told:
        """Stop all motion."""
        ...


class RestHand:
    """A scheduler."""

    face = "rest"

    def __init__(self, http: httpx.AsyncClient) -> None:
        self.http = http

    async def post(self, path: str, body: Any = None, **headers: str) -> httpx.Response:
        """Send an order as it is."""
        return await self.http.post(f"{EAST}{path}", json=body, headers=headers)

    async def _ordered(self, path: str, body: Any = None) -> Told:
        answer = await self.post(path, body)
        if answer.status_code < 300:
            return Told(True, answer.text)
        assert answer.headers["content-type"] == "application/problem+json", answer.text
        assert answer.status_code < 500 or answer.status_code in (503, 504), answer.text
        return Told(False, answer.text)

    async def goto(self, place: Apparent) -> Told:
        body = {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg, "frame": "jnow-apparent"}
        return await self._ordered("/slew", body)

    async def sync(self, place: Apparent) -> Told:
        return await self._ordered("/sync")

    async def park(self) -> Told:
        return await self._ordered("/park")

    async def stop(self) -> Told:
        return await self._ordered("/stop")

    async def state(self) -> dict[str, Any]:
        """Where it stands."""
        answer = await self.http.get(EAST)
        assert answer.status_code == 200, answer.text
        found: dict[str, Any] = answer.json()
        return found

    async def ended(self, started: httpx.Response) -> dict[str, Any]:
        """The end of a job that was begun."""
        assert started.status_code == 202, started.text
        found = await self.http.get(started.headers["location"], params={"wait": 60})
        body: dict[str, Any] = found.json()
        return body


class AlpacaHand:
    """An ASCOM program."""

    face = "alpaca"

    def __init__(self, http: httpx.AsyncClient, client_id: int = 77) -> None:
        self.http = http
        self.client_id = client_id

    async def put(self, member: str, **form: object) -> Told:
        """Write a member."""
        texts = {name: str(value) for name, value in form.items()}
        answer = await self.http.put(
            f"/api/v1/telescope/0/{member}", data={**texts, "ClientID": str(self.client_id)}
        )
        assert answer.status_code in (200, 400), answer.text
        if answer.status_code == 400:
            return Told(False, answer.text)
        body = answer.json()
        return Told(body["ErrorNumber"] == 0, body["ErrorMessage"])

    async def get(self, member: str) -> Any:
        """Read a member; its whole answer."""
        answer = await self.http.get(
            f"/api/v1/telescope/0/{member}", params={"ClientID": str(self.client_id)}
        )
        assert answer.status_code == 200, answer.text
        return answer.json()

    async def goto(self, place: Apparent) -> Told:
        return await self.put(
            "slewtocoordinatesasync", RightAscension=place.ra_deg / 15.0, Declination=place.dec_deg
        )

    async def sync(self, place: Apparent) -> Told:
        return await self.put(
            "synctocoordinates", RightAscension=place.ra_deg / 15.0, Declination=place.dec_deg
        )

    async def park(self) -> Told:
        return await self.put("park")

    async def stop(self) -> Told:
        return await self.put("abortslew")


class IndiHand:
    """A client such as KStars."""

    face = "indi"

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.heard: list[Event] = []
        self._stream = Reader()
        self._pings = 0

    async def say(self, *messages: bytes) -> list[Event]:
        """Send, and return all that is heard until all of it was worked off."""
        self._pings += 1
        uid = f"p{self._pings}"
        mark = len(self.heard)
        self.writer.write(b"".join(messages) + orders.ping_request(uid))
        await self.writer.drain()
        async with asyncio.timeout(PATIENCE_S):
            while not self._answered(uid, mark):
                data = await self.reader.read(65536)
                assert data, "the INDI server has hung up"
                self.heard += self._stream.feed(data)
        return self.heard[mark:]

    def _answered(self, uid: str, mark: int) -> bool:
        return any(getattr(one, "uid", None) == uid for one in self.heard[mark:])

    async def ask(self) -> None:
        """Ask for all properties."""
        await self.say(orders.get_properties())

    def value(self, name: str) -> Defined | Changed:
        """What was told of a property last."""
        return next(
            one for one in reversed(self.heard) if isinstance(one, Defined | Changed) and one.name == name
        )

    async def give(self, name: str, *messages: bytes) -> Told:
        """Send orders to a property; whether they were taken."""
        heard = await self.say(*messages)
        told = [one for one in heard if isinstance(one, Changed) and one.name == name]
        words = " ".join(text for one in heard if (text := getattr(one, "message", "")))
        return Told(all(one.state is not State.ALERT for one in told), words)

    async def _pointed(self, mode: str, place: Apparent) -> Told:
        return await self.give(
            "EQUATORIAL_EOD_COORD",
            orders.new_switches("east", "ON_COORD_SET", {mode: True}),
            orders.new_numbers(
                "east", "EQUATORIAL_EOD_COORD", {"RA": place.ra_deg / 15.0, "DEC": place.dec_deg}
            ),
        )

    async def goto(self, place: Apparent) -> Told:
        return await self._pointed("TRACK", place)

    async def sync(self, place: Apparent) -> Told:
        return await self._pointed("SYNC", place)

    async def park(self) -> Told:
        return await self.give(
            "TELESCOPE_PARK", orders.new_switches("east", "TELESCOPE_PARK", {"PARK": True})
        )

    async def stop(self) -> Told:
        return await self.give(
            "TELESCOPE_ABORT_MOTION", orders.new_switches("east", "TELESCOPE_ABORT_MOTION", {"ABORT": True})
        )


class Lx200Hand:
    """An app such as SkySafari."""

    face = "lx200"

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def say(self, text: str) -> None:
        """Send what has no answer."""
        self.writer.write(text.encode("latin-1"))
        await self.writer.drain()

    async def ask(self, text: str, *, digits: int = 0) -> str:
        """Send, and read an answer: so many bare characters, or up to its `#`."""
        await self.say(text)
        async with asyncio.timeout(PATIENCE_S):
            if digits:
                return (await self.reader.readexactly(digits)).decode("latin-1")
            return (await self.reader.readuntil(b"#")).decode("latin-1")

    async def aim(self, place: Apparent) -> None:
        """Set the target."""
        seconds = round(place.ra_deg * 240.0) % 86_400
        ra = f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
        arcsec = round(abs(place.dec_deg) * 3600.0)
        sign = "-" if place.dec_deg < 0 else "+"
        dec = f"{sign}{arcsec // 3600:02d}*{arcsec // 60 % 60:02d}:{arcsec % 60:02d}"
        assert await self.ask(f":Sr{ra}#", digits=1) == "1"
        assert await self.ask(f":Sd{dec}#", digits=1) == "1"

    async def goto(self, place: Apparent) -> Told:
        await self.aim(place)
        first = await self.ask(":MS#", digits=1)
        if first == "0":
            return Told(True, "")
        return Told(False, (await self.reader.readuntil(b"#")).decode("latin-1"))

    async def sync(self, place: Apparent) -> Told:
        await self.aim(place)
        words = await self.ask(":CM#")
        return Told(not words.startswith("N"), words)

    async def park(self) -> Told:
        await self.ask(":hP#:GVP#")
        return Told(None, "")

    async def stop(self) -> Told:
        await self.ask(":Q#:GVP#")
        return Told(None, "")


class StellariumHand:
    """Stellarium: it can only go somewhere, and is never answered."""

    face = "stellarium"

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def goto(self, place: Apparent) -> Told:
        self.writer.write(goto_message(Goto(apparent_to_icrs(place), 0)))
        await self.writer.drain()
        return Told(None, "")

    async def sync(self, place: Apparent) -> Told:
        return Told(None, "has no word for it")

    async def park(self) -> Told:
        return Told(None, "has no word for it")

    async def stop(self) -> Told:
        return Told(None, "has no word for it")


@asynccontextmanager
async def hands(stand: Standing) -> AsyncIterator[dict[str, Any]]:
    """A program at each face."""
    async with AsyncExitStack() as stack:
        http = await stack.enter_async_context(
            httpx.AsyncClient(base_url=f"http://127.0.0.1:{stand.port}", timeout=PATIENCE_S)
        )
        indi = IndiHand(*await _connected(stack, stand, "indi"))
        await indi.ask()
        yield {
            "rest": RestHand(http),
            "alpaca": AlpacaHand(http),
            "indi": indi,
            "lx200": Lx200Hand(*await _connected(stack, stand, "lx200")),
            "stellarium": StellariumHand(*await _connected(stack, stand, "stellarium")),
        }


async def _connected(
    stack: AsyncExitStack, stand: Standing, door: str
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    reader, writer = await asyncio.open_connection(*stand.door(door))

    async def let_go() -> None:
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()

    stack.push_async_callback(let_go)
    return reader, writer


__all__ = [
    "EAST",
    "FACES",
    "AlpacaHand",
    "Hand",
    "IndiHand",
    "Lx200Hand",
    "RestHand",
    "StellariumHand",
    "Told",
]
