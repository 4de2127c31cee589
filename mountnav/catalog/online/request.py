"""The request for a cone of stars in each protocol, the GET that sends it, and why a source gave none.

Why a source gave no stars: the words that an operator reads in a solution's provenance.

::

    SourceFailed
    ├── NotAnswered      no whole answer came: network, deadline, HTTP status
    ├── Unusable         an answer came that is none, or not one to rely on
    └── Overflow         more stars than one answer may hold: the tile is to be split
"""

from __future__ import annotations

import re
import time
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar
from urllib.parse import quote, urlencode, urljoin, urlsplit

from mountnav.catalog.online.source import OnlineSource, table_proper

if TYPE_CHECKING:
    import httpx


LONGEST_QUOTE = 160
"""Characters of a server's own words that a message quotes at most; chosen by hand."""


class SourceFailed(Exception):
    """One request came to nothing; `why` says it in words that follow the source's name."""

    is_servers_fault: ClassVar[bool] = True
    """The server won't do better a moment later: it is left alone for a while."""

    def __init__(self, why: str) -> None:
        self.why = why
        super().__init__(why)


class NotAnswered(SourceFailed):
    """No whole answer came."""


class Unusable(SourceFailed):
    """What came can't be relied on."""


class Overflow(SourceFailed):
    """The answer was cut by the server or by the number of rows asked for."""

    is_servers_fault = False


def quoted(text: str) -> str:
    """Somebody else's words, on one line and not too long.

    Returns
    -------
    str
        Without control characters, at most `LONGEST_QUOTE` characters.
    """
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return line if len(line) <= LONGEST_QUOTE else line[: LONGEST_QUOTE - 1] + "…"


MOST_ROWS = 40_000
"""Rows asked for at most; some 6 MB of XML. A tile that holds more is split."""
_UNIT = re.compile(r"\s*\[(?P<unit>[^\]]*)\]\s*$")
_PLAIN_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*$")
_RESERVED = frozenset({"of", "date", "time", "size", "position", "zone", "year", "class", "distance", "area"})
"""Names of columns that are in use and that ADQL wants in quotes."""


@dataclass(frozen=True, slots=True)
class Circle:
    """A circle of the sky.

    Attributes
    ----------
    ra_deg, dec_deg : float
        ICRS.
    """

    ra_deg: float
    dec_deg: float
    radius_deg: float


def question(source: OnlineSource, circle: Circle, mag_limit: float | None) -> str:
    """The address that asks for the stars of a circle.

    Parameters
    ----------
    mag_limit : float or None
        Only stars to this magnitude; what the service or the table can't limit is cut later.

    Returns
    -------
    str
        One plain GET.
    """
    return {"vizier": _vizier, "cone": _cone, "tap": _tap}[source.protocol](source, circle, mag_limit)


def named_columns(source: OnlineSource) -> dict[str, tuple[str, str]]:
    """Configured columns: role to (name, unit), the unit empty where it isn't given."""
    named: dict[str, tuple[str, str]] = {}
    for role, text in source.columns.items():
        unit = _UNIT.search(text)
        named[role] = (_UNIT.sub("", text).strip(), unit["unit"].strip() if unit else "")
    return named


def limit_column(source: OnlineSource) -> str:
    """The column by which the server can be asked for bright stars only; empty if there is none."""
    if source.protocol == "cone":
        return ""
    if "mag" in source.columns:
        return named_columns(source)["mag"][0]
    return source.known.limit_column if source.known else ""


def _vizier(source: OnlineSource, circle: Circle, mag_limit: float | None) -> str:
    # the ASU conventions of CDS: -c is a place, -c.rd a radius in degrees
    arguments = [
        ("-source", table_proper(source.table)),
        ("-c", f"{circle.ra_deg:.6f} {circle.dec_deg:+.6f}"),
        ("-c.eq", "J2000"),
        ("-c.rd", f"{circle.radius_deg:.6f}"),
        ("-out.max", str(MOST_ROWS)),
    ]
    arguments += [("-out", name) for name in _wanted(source, optional=True) or ["*"]]
    if mag_limit is not None and (column := limit_column(source)):
        arguments.append((column, f"<={mag_limit:g}"))
    address = source.url.rstrip("/")
    return _address(address if "/viz-bin/" in address else f"{address}/viz-bin/votable", arguments)


def _cone(source: OnlineSource, circle: Circle, mag_limit: float | None) -> str:
    # IVOA Simple Cone Search 1.03; MAXREC is of DALI 1.1, others ignore it
    del mag_limit
    arguments = [
        ("RA", f"{circle.ra_deg:.6f}"),
        ("DEC", f"{circle.dec_deg:.6f}"),
        ("SR", f"{circle.radius_deg:.6f}"),
        ("VERB", "3" if source.columns else "2"),
        ("MAXREC", str(MOST_ROWS)),
    ]
    return _address(source.url, arguments)


def _tap(source: OnlineSource, circle: Circle, mag_limit: float | None) -> str:
    # IVOA TAP 1.1, synchronous; ADQL 2.0
    wanted = _wanted(source, optional=False)
    named = named_columns(source)
    roles = source.known.roles if source.known else {}
    ra = named["ra"][0] if "ra" in named else roles.get("ra", ("ra",))[0]
    dec = named["dec"][0] if "dec" in named else roles.get("dec", ("dec",))[0]
    query = (
        f"SELECT {', '.join(_identifier(name) for name in wanted) or '*'} FROM {_table(source.table)} "
        f"WHERE 1=CONTAINS(POINT('ICRS', {_identifier(ra)}, {_identifier(dec)}), "
        f"CIRCLE('ICRS', {circle.ra_deg:.6f}, {circle.dec_deg:.6f}, {circle.radius_deg:.6f}))"
    )
    if mag_limit is not None and (column := limit_column(source)):
        query += f" AND {_identifier(column)} <= {mag_limit:g}"
    arguments = [
        ("REQUEST", "doQuery"),
        ("LANG", "ADQL"),
        ("FORMAT", "votable"),
        ("MAXREC", str(MOST_ROWS)),
        ("QUERY", query),
    ]
    address = source.url.rstrip("/")
    return _address(address if address.endswith("/sync") else f"{address}/sync", arguments)


def _wanted(source: OnlineSource, *, optional: bool) -> list[str]:
    """Columns to ask for; none means all."""
    named = named_columns(source)
    known = source.known
    if known is None:
        # what isn't configured is found by its UCD among all columns, unless nothing is left to find
        return []
    asked = [name for name in known.columns if optional or name not in known.may_lack]
    asked += [name for name, _ in named.values() if name]
    return list(dict.fromkeys(asked))


def _identifier(name: str) -> str:
    is_plain = _PLAIN_NAME.match(name) and name.lower() not in _RESERVED
    return name if is_plain else '"' + name.replace('"', '""') + '"'


def _table(name: str) -> str:
    """Quote a table whose name is no plain one: VizieR's own names have slashes."""
    proper = table_proper(name)
    parts = proper.split(".")
    return proper if all(_PLAIN_NAME.match(part) for part in parts) else _identifier(proper)


def _address(base: str, arguments: list[tuple[str, str]]) -> str:
    joint = "" if base.endswith(("?", "&")) else "&" if "?" in base else "?"
    return f"{base}{joint}{urlencode(arguments, quote_via=quote)}"


MOST_BYTES = 32_000_000
"""Of an answer, unpacked."""
MOST_REDIRECTS = 3
"""Redirects that one request follows; chosen by hand: a mirror's address takes one or two. Without a bound a
loop would last until the time limit."""
_AGENT = "mountnav (star catalog client)"
_LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})


@dataclass(frozen=True, slots=True)
class Got:
    """An answer.

    Attributes
    ----------
    status : int
        Of HTTP.
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
    end : float
        By `time.monotonic`: when it must be here. A server that sends its headers byte by byte may be waited
        for longer, so a caller that must not wait asks from a thread, see `mountnav.catalog.online.fetching`.

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
        raise Unusable(f"it redirects to what is not an address: {quoted(location)}") from fault
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
