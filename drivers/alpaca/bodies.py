"""An answer's body, read as it comes and no further than it may be long, packed or not.

A server may send without end, and 1 MB of gzip unpacks to 1 GB: neither may take the memory, nor
keep the loop from a stop.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping

import httpx

from drivers.alpaca.codec import Malformed
from mountnav.reading.unpacking import MOST_BYTES

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
    client : httpx.AsyncClient
    method, url : str
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
    # whoever packs all the same is read, too: some proxies do
    asked = {"Accept-Encoding": "identity"} | dict(headers or {})
    async with client.stream(method, url, headers=asked, data=said) as response:
        packing = response.headers.get("content-encoding", "").strip().lower()
        if packing not in (*_PLAIN, *_PACKED):
            raise Malformed(f"an answer that is packed as {packing[:40]!r}")
        unpacking = zlib.decompressobj(_EITHER_WRAPPING) if packing in _PACKED else None
        body = bytearray()
        async for piece in response.aiter_raw():
            if unpacking is not None:
                try:
                    piece = unpacking.decompress(piece, most_bytes - len(body) + 1)
                except zlib.error as broken:
                    raise Malformed(f"an answer whose packing is damaged: {broken}") from broken
            body += piece
            if len(body) > most_bytes:
                raise Malformed(f"an answer of more than {most_bytes} bytes")
        if unpacking is not None and body and not unpacking.eof:
            raise Malformed("a packed answer that ends in the middle")
    left = [(name, value) for name, value in response.headers.items() if name != "content-encoding"]
    return httpx.Response(response.status_code, headers=left, content=bytes(body))


__all__ = ["MOST_ANSWER_BYTES", "MOST_IMAGE_BYTES", "answered"]
