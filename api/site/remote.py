"""One service of a site: asked in the background, stopped by order, believed in nothing it says.

Three requests are made here and no others: its health, its telescopes, and STOP ALL. An answer is bounded in
time and length and read by the fields we know; texts are cut, and the key is masked where it is echoed. So a
service that is dead, slow or hostile costs its own tile and nothing else.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
import math
import ssl
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal

import httpx

from mountnav.clock import utc_now
from mountnav.errors import BadSettings
from mountnav.masking import masked
from mountnav.settings.site_file import SiteServiceSettings
from mountnav.tasks import begun, fault_words, waited_for

_log = logging.getLogger(__name__)

ASKED_S = 4.0
"""For one look at a service, connecting included. Doubled, a dead one is told twice as late."""

STOP_KNOWN_S = 1.8
"""Until the outcome of a stop is told, or that it isn't known: an answer within 2 s needs the rest. A service
itself answers a stop within 2 s and mostly in milliseconds."""

STOP_TRIED_S = 15.0
"""A stop that isn't known in time is waited for so long besides, and told on the page then."""

MOST_BYTES = 512_000
"""Of an answer. One telescope's state is 2 kB; doubled, a hostile service costs twice the memory."""

MOST_TELESCOPES, MOST_WORDS, MOST_LINES = 100, 300, 20
"""Telescopes of a service, characters of a text, lines of a list: what is more is left out."""

Health = Literal["waiting", "ok", "degraded", "silent", "refused", "strange"]


class StrangeAnswer(Exception):
    """What came is no answer of a mountnav service."""


@dataclass(frozen=True, slots=True)
class TelescopeSeen:
    """A telescope as its service tells of it; None where it doesn't."""

    id: str
    connected: bool | None = None
    activity: str | None = None
    tracking: bool | None = None
    parked: bool | None = None
    slewing: bool | None = None
    ra_deg: float | None = None
    dec_deg: float | None = None
    altitude_deg: float | None = None
    azimuth_deg: float | None = None
    problem: str | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class StopTold:
    """What came of a stop of all at one service.

    Attributes
    ----------
    stopped : bool or None
        None: not known.
    telescopes : tuple of (str, bool or None, str or None)
        Id, whether it was stopped, and what is said of it.
    """

    given_utc: datetime
    stopped: bool | None
    problem: str | None = None
    telescopes: tuple[tuple[str, bool | None, str | None], ...] = ()


@dataclass(frozen=True, slots=True)
class Seen:
    """How a service was seen last."""

    state: Health = "waiting"
    problem: str | None = None
    answered_utc: datetime | None = None
    version: str | None = None
    concerns: tuple[str, ...] = ()
    telescopes: tuple[TelescopeSeen, ...] = ()


class _PinnedObject(ssl.SSLObject):
    """TLS that is broken off before anything is sent, unless the certificate is the one that is known."""

    def do_handshake(self) -> None:
        super().do_handshake()
        context = self.context
        assert isinstance(context, _Pinned)
        certificate = self.getpeercert(binary_form=True) or b""
        if hashlib.sha256(certificate).hexdigest() != context.fingerprint:
            raise ssl.SSLCertVerificationError(1, "it has another fingerprint")


class _Pinned(ssl.SSLContext):
    sslobject_class = _PinnedObject
    fingerprint = ""


def tls_of(settings: SiteServiceSettings) -> ssl.SSLContext | bool:
    """How its certificate is checked. Blocks.

    Raises
    ------
    BadSettings
        `ca_file` can't be read.
    """
    if settings.fingerprint_sha256 is not None:
        pinned = _Pinned(ssl.PROTOCOL_TLS_CLIENT)
        pinned.check_hostname, pinned.verify_mode = False, ssl.CERT_NONE
        pinned.minimum_version = ssl.TLSVersion.TLSv1_2
        pinned.fingerprint = settings.fingerprint_sha256.replace(":", "").lower()
        return pinned
    if settings.ca_file is None:
        return True
    try:
        return ssl.create_default_context(cafile=str(settings.ca_file))
    except (OSError, ssl.SSLError) as error:
        raise BadSettings(
            f"the certificates for {settings.name} can't be read: {error.strerror or error}",
            device=str(settings.ca_file),
            advice="ca_file names a PEM file",
        ) from error


@dataclass(slots=True)
class Remote:
    """One service of the site.

    Parameters
    ----------
    changed : callable
        Told when it was seen in another state.
    """

    settings: SiteServiceSettings
    changed: Callable[[Remote], object] = lambda _: None
    seen: Seen = field(default_factory=Seen)
    stop: StopTold | None = None
    _client: httpx.AsyncClient | None = None
    _tasks: set[asyncio.Task[Any]] = field(default_factory=set)

    def open(self, poll_s: float) -> None:
        """Begin to ask it, each `poll_s`. Raises `BadSettings`."""
        self._client = httpx.AsyncClient(
            base_url=self.settings.url,
            verify=tls_of(self.settings),
            trust_env=False,
            follow_redirects=False,
            timeout=httpx.Timeout(STOP_TRIED_S),
            # one for its looks, others for stops: none waits for a look that hangs
            limits=httpx.Limits(max_connections=8, max_keepalive_connections=2),
            headers={
                "accept": "application/json",
                "accept-encoding": "identity",
                "user-agent": "mountnav-site",
            },
        )
        self._kept(begun(self._asked_each(poll_s), f"site {self.settings.name}", died=self._died))

    async def close(self) -> None:
        """Let it go."""
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._client is not None:
            with suppress(Exception):
                await self._client.aclose()

    async def stop_all(self) -> StopTold:
        """Give STOP ALL, and tell what came of it in time for the answer. Never raises."""
        given_utc = utc_now()
        self.stop = StopTold(given_utc, None, "not known yet")
        task = waited_for(self._stopped(given_utc), f"stop {self.settings.name}")
        self._kept(task)
        await asyncio.wait({task}, timeout=STOP_KNOWN_S)
        if task.done() and not task.cancelled():
            return task.result()
        late = f"not known yet: no answer within {STOP_KNOWN_S:g} s; look at the telescopes"
        return StopTold(given_utc, None, late)

    def _kept(self, task: asyncio.Task[Any]) -> None:
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _died(self, fault: Exception) -> None:
        self._see(Seen("silent", fault_words(fault)))

    async def _stopped(self, given_utc: datetime) -> StopTold:
        try:
            async with asyncio.timeout(STOP_TRIED_S):
                told = await self._stop_given(given_utc)
        except Exception as error:
            # what was never connected was never sent; of all else nobody knows
            unsent = isinstance(error, httpx.ConnectError | httpx.ConnectTimeout | BadSettings)
            why = self._why(error, STOP_TRIED_S)
            words = f"NOT SENT: {why}" if unsent else f"not known: {why}"
            told = StopTold(given_utc, False if unsent else None, words)
        if self.stop is None or self.stop.given_utc <= given_utc:
            self.stop = told
        (_log.info if told.stopped else _log.warning)(
            "STOP ALL at %s: %s", self.settings.name, "stopped" if told.stopped else told.problem
        )
        return told

    async def _stop_given(self, given_utc: datetime) -> StopTold:
        key = await asyncio.to_thread(self.settings.key)
        try:
            status, told = await self._told("POST", "/v1/stop", key)
        except (httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError):
            # an idle connection that the other end had closed: a stop may be given twice
            status, told = await self._told("POST", "/v1/stop", key)
        if status in (200, 202) and isinstance(told, dict):
            rows = tuple(
                (
                    _words(one.get("telescope"), key) or "?",
                    _truth(one.get("stopped")),
                    _words(one.get("problem"), key),
                )
                for one in _list(told.get("telescopes"))[:MOST_TELESCOPES]
                if isinstance(one, dict)
            )
            stopped = _truth(told.get("stopped"))
            problem = (
                None if stopped else "; ".join(f"{id_}: {words}" for id_, _, words in rows if words) or None
            )
            return StopTold(given_utc, stopped, problem or (None if stopped else "not known"), rows)
        return StopTold(given_utc, False, f"NOT STOPPED: {_refusal(status, told, key)}")

    async def _asked_each(self, poll_s: float) -> None:
        while True:
            try:
                async with asyncio.timeout(ASKED_S):
                    self._see(await self._looked_at())
            except Exception as error:  # whatever a stranger's answer brings about is the stranger's
                state: Health = "strange" if isinstance(error, StrangeAnswer) else "silent"
                last = self.seen
                self._see(
                    Seen(
                        state, self._why(error, ASKED_S), last.answered_utc, last.version, (), last.telescopes
                    )
                )
            await asyncio.sleep(poll_s)

    async def _looked_at(self) -> Seen:
        key = await asyncio.to_thread(self.settings.key)
        # each to its own end: a handshake that the other's fault cuts off leaves its socket to the collector
        both = await asyncio.gather(
            self._told("GET", "/v1/health", None),
            self._told("GET", "/v1/telescopes", key),
            return_exceptions=True,
        )
        for one in both:
            if isinstance(one, BaseException):
                raise one
        (health_status, health), (status, telescopes) = (one for one in both if isinstance(one, tuple))
        if status in (401, 403):
            return Seen("refused", _refusal(status, telescopes, key), utc_now())
        if health_status not in (200, 503) or not isinstance(health, dict):
            raise StrangeAnswer(f"its health is answered by {health_status}")
        if status != 200 or not isinstance(telescopes, list):
            raise StrangeAnswer(f"its telescopes are answered by {status}")
        ok = health.get("status") == "ok" and health.get("ready") is True
        concerns = [*_list(health.get("why_not")), *_list(health.get("concerns"))][:MOST_LINES]
        return Seen(
            "ok" if ok else "degraded",
            None,
            utc_now(),
            _words(health.get("version"), key),
            tuple(words for one in concerns if (words := _words(one, key))),
            tuple(_telescope(one, key) for one in telescopes[:MOST_TELESCOPES] if isinstance(one, dict)),
        )

    def _see(self, seen: Seen) -> None:
        before, self.seen = self.seen, seen
        if (before.state, before.problem) != (seen.state, seen.problem):
            (_log.info if seen.state == "ok" else _log.warning)(
                "%s is %s%s", self.settings.name, seen.state, f": {seen.problem}" if seen.problem else ""
            )
            self.changed(self)

    async def _told(self, method: str, path: str, key: str | None) -> tuple[int, Any]:
        """The status and the JSON of an answer. Raises `StrangeAnswer`, `httpx.HTTPError`."""
        assert self._client is not None
        headers = {} if key is None else {"X-API-Key": key}
        async with self._client.stream(method, path, headers=headers) as answer:
            if answer.headers.get("content-encoding", "identity") != "identity":
                raise StrangeAnswer("it is compressed, which was not asked for")
            content = bytearray()
            async for piece in answer.aiter_raw():
                content += piece
                if len(content) > MOST_BYTES:
                    raise StrangeAnswer(f"an answer is longer than {MOST_BYTES} bytes")
        try:
            return answer.status_code, json.loads(content)
        except (ValueError, RecursionError) as error:
            raise StrangeAnswer(f"{path} is answered by no JSON (status {answer.status_code})") from error

    def _why(self, error: Exception, waited_s: float) -> str:
        if isinstance(error, TimeoutError | httpx.TimeoutException):
            return f"no answer within {waited_s:g} s"
        if (of_tls := _of_tls(error)) is not None:
            return masked(f"its certificate isn't taken: {of_tls.strerror or of_tls}")[:MOST_WORDS]
        if isinstance(error, BadSettings):
            return masked(error.what)[:MOST_WORDS]
        if isinstance(error, StrangeAnswer):
            return masked(str(error))[:MOST_WORDS]
        return masked(f"it can't be reached: {error or type(error).__name__}")[:MOST_WORDS]


def _of_tls(error: BaseException | None) -> ssl.SSLError | None:
    """What TLS had against a connection, wherever it stands behind an error."""
    while error is not None:
        if isinstance(error, ssl.SSLError):
            return error
        error = error.__cause__ or error.__context__
    return None


def _telescope(told: dict[str, Any], key: str | None) -> TelescopeSeen:
    icrs = told.get("icrs")
    place = icrs if isinstance(icrs, dict) else {}
    return TelescopeSeen(
        id=_words(told.get("id"), key) or "?",
        connected=_truth(told.get("connected")),
        activity=_words(told.get("activity"), key),
        tracking=_truth(told.get("tracking")),
        parked=_truth(told.get("parked")),
        slewing=_truth(told.get("slewing")),
        ra_deg=_number(place.get("ra_deg")),
        dec_deg=_number(place.get("dec_deg")),
        altitude_deg=_number(told.get("altitude_deg")),
        azimuth_deg=_number(told.get("azimuth_deg")),
        problem=_words(told.get("problem"), key) or _words(told.get("contradiction"), key),
        warnings=tuple(w for one in _list(told.get("warnings"))[:MOST_LINES] if (w := _words(one, key))),
    )


def _refusal(status: int, told: Any, key: str | None) -> str:
    detail = _words(told.get("detail"), key) if isinstance(told, dict) else None
    return f"it answers {status}" + (f": {detail}" if detail else "")


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _truth(value: Any) -> bool | None:
    return value if isinstance(value, bool) else None


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    number = float(value) if abs(value) < 1e9 else math.nan
    return number if math.isfinite(number) else None


def _words(value: Any, key: str | None) -> str | None:
    """A text of theirs: cut, without our key, without what isn't printed."""
    if not isinstance(value, str):
        return None
    text = value[: 4 * MOST_WORDS]
    if key is not None:
        text = text.replace(key, "***")
    text = "".join(letter if letter.isprintable() else " " for letter in text)
    return masked(text)[:MOST_WORDS]
