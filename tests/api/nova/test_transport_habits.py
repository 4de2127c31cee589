"""How clients of the nova API speak HTTP, byte for byte: old versions, chunks, odd addresses and types."""

from __future__ import annotations

import asyncio
import json
from urllib.parse import urlsplit

import pytest

from tests.api.nova.nova_service import Standing, escaped_login, raw_form, unescaped_login

pytestmark = pytest.mark.asyncio(loop_scope="module")
FORM = "Content-Type: application/x-www-form-urlencoded\r\n"
BOUNDARY = "---------------------------8dd1234567890ab"
LIST = b"10 20 300\r\n20 400 200\r\n"
"""A list of stars that can't be solved: what is asked here is whether it arrives."""


class Wire:
    """One connection, kept open."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer

    @classmethod
    async def to(cls, nova: Standing) -> Wire:
        """Connect."""
        where = urlsplit(nova.url)
        return cls(*await asyncio.open_connection(where.hostname, where.port))

    async def send(self, head: str, body: bytes = b"") -> None:
        """Send the lines of a head, without the empty one at its end, and a body."""
        self._writer.write(head.encode() + b"\r\n" + body)
        await self._writer.drain()

    async def send_body(self, body: bytes) -> None:
        """Send a body that waited for leave."""
        self._writer.write(body)
        await self._writer.drain()

    async def answered(self) -> tuple[int, dict[str, str], bytes]:
        """Status, fields of the head in lower case, body."""
        status, fields = await self.head()
        return status, fields, await self._reader.readexactly(int(fields.get("content-length", "0")))

    async def ended(self) -> bool:
        """Whether the other end has closed it."""
        return await self._reader.read(1) == b""

    async def __aenter__(self) -> Wire:
        return self

    async def __aexit__(self, *fault: object) -> None:
        self._writer.close()
        await self._writer.wait_closed()

    async def head(self) -> tuple[int, dict[str, str]]:
        """Status and fields of an answer, whose body is not read."""
        lines = (await self._reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
        parts = (line.partition(":") for line in lines[1:] if line)
        return int(lines[0].split()[1]), {name.lower(): value.strip() for name, _, value in parts}


def posted(path: str, body: str | bytes, fields: str = FORM, version: str = "1.1") -> tuple[str, bytes]:
    """Head and body of a request that says its length."""
    content = body.encode() if isinstance(body, str) else body
    return (
        f"POST {path} HTTP/{version}\r\nHost: localhost:8080\r\n{fields}Content-Length: {len(content)}\r\n",
        content,
    )


def in_chunks(body: bytes, size: int) -> bytes:
    """A body whose length isn't said before, as Java's and Go's clients send files."""
    pieces = [body[at : at + size] for at in range(0, len(body), size)]
    return b"".join(f"{len(one):x};x=y\r\n".encode() + one + b"\r\n" for one in pieces) + b"0\r\n\r\n"


def upload_of(session: str) -> bytes:
    """The body of an upload."""
    return raw_form(
        [
            ("", 'form-data; name="request-json"', json.dumps({"session": session}).encode()),
            ("Content-Type: text/plain\r\n", 'form-data; name="file"; filename="maxima.tbl"', LIST),
        ],
        BOUNDARY,
        "\r\n",
    )


def told(answer: tuple[int, dict[str, str], bytes]) -> dict[str, object]:
    """The JSON of a success."""
    status, fields, body = answer
    assert body, answer
    found = json.loads(body)
    assert (status, found.get("status")) == (200, "success"), answer
    assert fields["content-type"].startswith("text/plain")
    return dict(found)


async def session_by(nova: Standing, head: str, body: bytes) -> str:
    """Log in by a request on a connection of its own."""
    async with await Wire.to(nova) as wire:
        await wire.send(head, body)
        return str(told(await wire.answered())["session"])


async def test_logins_in_all_versions_and_addresses(nova: Standing) -> None:
    """The address that a person types may end with a slash, and Synapse speaks HTTP/1.0."""
    for path in ("/api/login", "/api/login/", "//api/login/", "/api//login", "//api//login//"):
        assert await session_by(nova, *posted(path, escaped_login("key")))
    assert await session_by(nova, *posted("/api/login", unescaped_login("key"), version="1.0"))
    assert await session_by(nova, *posted(f"{nova.url}/api/login", escaped_login("key")))  # as by a proxy
    assert await session_by(nova, *posted("/api/login?lang=en", escaped_login("key") + "\r\n"))


async def test_types_of_a_login_that_are_none_or_wrong(nova: Standing) -> None:
    for fields in (
        "",
        "Content-Type: \r\n",
        "Content-Type: text/plain\r\n",
        "Content-Type: application/x-www-form-urlencoded; charset=UTF-8\r\n",
        "Content-type: APPLICATION/X-WWW-FORM-URLENCODED\r\nAccept: image/png\r\nAccept-Encoding: br\r\n",
        "Content-Type: application/json\r\n",
    ):
        assert await session_by(nova, *posted("/api/login", escaped_login("key"), fields))
    form = raw_form([("", 'form-data; name="request-json"', b'{"apikey": "key"}')], BOUNDARY, "\r\n")
    kind = f"Content-Type: multipart/form-data; boundary={BOUNDARY}\r\n"
    assert await session_by(nova, *posted("/api/login", form, kind))


async def test_one_connection_serves_a_whole_dialogue(nova: Standing) -> None:
    async with await Wire.to(nova) as wire:
        await wire.send(*posted("/api/login/", escaped_login("key")))
        session = str(told(await wire.answered())["session"])
        kind = f'Content-Type: multipart/form-data; boundary="{BOUNDARY}"\r\n'
        await wire.send(*posted("/api/upload/", upload_of(session), kind))
        number = told(await wire.answered())["subid"]
        for method in ("GET", "HEAD", "GET"):
            await wire.send(f"{method} /api/submissions/{number}/?x=1 HTTP/1.1\r\nHost: 127.0.0.1\r\n")
            if method == "HEAD":
                status, fields = await wire.head()
                assert (status, int(fields["content-length"]) > 0) == (200, True)
            else:
                assert json.loads((await wire.answered())[2])["jobs"]
        # two questions at once on one connection are answered in turn
        ask = f"GET /api/submissions/{number} HTTP/1.1\r\nHost: 127.0.0.1\r\n"
        await wire.send(f"{ask}\r\n{ask}")
        assert [(await wire.answered())[0] for _ in range(2)] == [200, 200]
        await wire.send(f"GET /api/submissions/{number} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n")
        assert (await wire.answered())[0] == 200
        assert await wire.ended()


async def test_uploads_in_chunks_and_those_that_wait_for_leave(nova: Standing) -> None:
    """.NET and curl ask for leave before a large body; what is in chunks says no length."""
    session = await nova.login()
    body, kind = upload_of(session), f"Content-Type: multipart/form-data; boundary={BOUNDARY}\r\n"
    for size in (7, 1000):
        async with await Wire.to(nova) as wire:
            head = f"POST /api/upload HTTP/1.1\r\nHost: 127.0.0.1\r\n{kind}Transfer-Encoding: chunked\r\n"
            await wire.send(head, in_chunks(body, size))
            assert told(await wire.answered())["subid"]
    async with await Wire.to(nova) as wire:
        head, content = posted("/api/upload", body, f"{kind}Expect: 100-continue\r\n")
        await wire.send(head)
        status, _, _ = await wire.answered()
        assert status == 100
        await wire.send_body(content)
        assert told(await wire.answered())["subid"]
    # an old client says its length and hangs up when it has its answer
    async with await Wire.to(nova) as wire:
        await wire.send(*posted("/api/upload", body, kind, version="1.0"))
        assert told(await wire.answered())["subid"]
        assert await wire.ended()


async def test_a_small_file_may_come_before_its_session_and_odd_fields_are_passed_over(
    nova: Standing,
) -> None:
    session = await nova.login()
    asked = json.dumps({"session": session, "publicly_visible": "y", "unknown": {"a": [1]}}).encode()
    body = raw_form(
        [
            ("Content-Type: image/fits\r\n", "form-data; filename=maxima.tbl; name=file", LIST),
            ("", 'form-data; name="submit"', b"Upload"),
            ("Content-Type: application/json\r\n", 'form-data; name="request-json"', asked),
        ],
        BOUNDARY,
        "\r\n",
    )
    async with await Wire.to(nova) as wire:
        await wire.send(
            *posted("/api/upload", body, f"Content-Type: multipart/form-data; boundary={BOUNDARY}\r\n")
        )
        assert told(await wire.answered())["subid"]


async def test_a_session_counts_in_the_json_alone(nova: Standing) -> None:
    """As at nova's own: what stands in the address, in a cookie or a head shows no session, and says so."""
    session = await nova.login()
    asked = f"request-json=%7B%22session%22%3A%22{session}%22%7D"
    for path, fields, body in (
        (f"/api/myjobs?session={session}", FORM, "request-json={}"),
        (f"/api/myjobs?{asked}", FORM, ""),
        ("/api/myjobs", f"{FORM}Cookie: session={session}\r\nAuthorization: Bearer {session}\r\n", ""),
    ):
        async with await Wire.to(nova) as wire:
            await wire.send(*posted(path, body, fields))
            status, _, answer = await wire.answered()
            assert (status, json.loads(answer)["status"]) == (200, "error")
