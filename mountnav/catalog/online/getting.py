"""One GET with a hard end: in time whatever the server does, in size, and in where it may lead."""

from __future__ import annotations

import time
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import urljoin, urlsplit

from mountnav.catalog.online.refusals import NotAnswered, Unusable, quoted

if TYPE_CHECKING:
    import httpx

MOST_BYTES = 32_000_000
"""Of an answer, unpacked."""
MOST_REDIRECTS = 3
_AGENT = "mountnav (star catalog client)"
_LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})


@dataclass(frozen=True, slots=True)
class Got:
    """An answer.

    Attributes
    ----------
    status : int
        Of HTTP.
    content_type : str
    body : bytes
        Unpacked.
    """

    status: int
    content_type: str
    body: bytes


def new_client(url: str, timeout_s: float) -> httpx.Client:
    """A client for one cone: its connections are shared by the tiles, and gone afterwards.

    Proxies and certificates are taken from the environment (HTTPS_PROXY, NO_PROXY, SSL_CERT_FILE), as
    observatories have them; a server on this machine is never asked by way of a proxy.
    """
    import httpx

    return httpx.Client(
        headers={"User-Agent": _AGENT, "Accept-Encoding": "gzip"},
        timeout=timeout_s,
        follow_redirects=False,
        trust_env=urlsplit(url).hostname not in _LOOPBACK,
    )


def get(client: httpx.Client, url: str, *, end: float) -> Got:
    """Get what is at an address.

    Parameters
    ----------
    client : httpx.Client
    url : str
    end : float
        By `time.monotonic`: when it must be here. A server that sends its headers byte by byte may be waited
        for longer, so whoever must not wait asks from a thread, see `mountnav.catalog.online.fetching`.

    Returns
    -------
    Got
        Of any HTTP status.

    Raises
    ------
    NotAnswered
        Nothing, or not all of it, came.
    Unusable
        It is too large, or leads elsewhere.
    """
    import httpx

    asked = url
    try:
        for _ in range(MOST_REDIRECTS + 1):
            left_s = max(end - time.monotonic(), 0.001)
            with client.stream("GET", asked, timeout=left_s) as response:
                if response.has_redirect_location:
                    asked = _followed(asked, response.headers.get("location", ""))
                    continue
                body = _body(response, end)
            return Got(response.status_code, response.headers.get("content-type", ""), body)
    except httpx.TimeoutException as late:
        raise NotAnswered("no answer in time") from late
    except httpx.ConnectError as refused:
        raise NotAnswered(f"can't be reached: {quoted(str(refused))}") from refused
    except httpx.HTTPError as broken:
        raise NotAnswered(f"the connection broke: {quoted(str(broken)) or type(broken).__name__}") from broken
    except (httpx.InvalidURL, httpx.StreamError, RuntimeError, OSError) as broken:
        # a client that was closed because the time is over answers in several ways
        raise NotAnswered(f"the request failed: {quoted(str(broken))}") from broken
    raise Unusable(f"it redirects more than {MOST_REDIRECTS} times")


def _followed(asked: str, location: str) -> str:
    """Where a redirect leads: on the same server, or to its https side."""
    try:
        target = urljoin(asked, location)
        old, new = urlsplit(asked), urlsplit(target)
    except ValueError as fault:  # http://[
        raise Unusable(f"it redirects to what is no address: {quoted(location)}") from fault
    is_upgrade = old.scheme == "http" and new.scheme == "https" and new.hostname == old.hostname
    if not is_upgrade and (new.scheme, new.netloc) != (old.scheme, old.netloc):
        raise Unusable(f"it redirects to another server, {quoted(new.hostname or location)}: configure that")
    return target


def _body(response: httpx.Response, end: float) -> bytes:
    packing = response.headers.get("content-encoding", "identity").strip().lower()
    if packing not in ("identity", "", "gzip", "x-gzip"):
        raise Unusable(f"its answer is packed as {quoted(packing)}, which was not asked for")
    unpacking = zlib.decompressobj(wbits=31) if packing.endswith("gzip") else None
    parts: list[bytes] = []
    size = 0
    # raw bytes: a chunk of a bomb unpacks to a thousand times its size, so the size is limited while it does
    # and as they come: asked for in pieces of a size, httpx would wait for a whole one, whatever the deadline
    for chunk in response.iter_raw():
        if time.monotonic() > end:
            raise NotAnswered("no answer in time")
        if unpacking is not None:
            try:
                chunk = unpacking.decompress(chunk, MOST_BYTES - size + 1)
            except zlib.error as broken:
                raise Unusable("its packed answer is damaged") from broken
        size += len(chunk)
        if size > MOST_BYTES:
            raise Unusable(f"its answer is larger than {MOST_BYTES // 1_000_000} MB")
        parts.append(chunk)
    if unpacking is not None and not unpacking.eof:
        raise NotAnswered("the answer was cut in the middle")
    return b"".join(parts)
