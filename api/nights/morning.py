"""The morning report on its way: once a night, after sunrise, into a folder and to webhooks.

It runs beside the night in a task of its own; nothing waits for it. An address that fails is tried again for
hours; what came of each is told by an event, a line of the journal and the log, without the address's path,
which is a secret. What was sent is known after a restart from the journal.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import tenacity

from mountnav import clock
from mountnav.errors import MountnavError
from mountnav.files import replace_bytes
from mountnav.journal.reading import Wanted
from mountnav.journal.records import Cause, Entry, EntryKind
from mountnav.journal.sql_journal import SqlJournal
from mountnav.night.daylight import sun_altitude_deg
from mountnav.night.morning_report import MorningReport, night_of, report_of
from mountnav.night.report_messages import body_of, words_of
from mountnav.night.report_pages import as_html, as_markdown
from mountnav.settings.observatory import Settings
from mountnav.settings.report import WebhookSettings
from mountnav.tasks import begun, fault_words, waited_for

__all__ = ["MorningPosts", "Sent", "night_due"]

_log = logging.getLogger(__name__)

_LOOK_S = 60.0
"""Between two looks whether it is morning, s. Doubled, a report comes a minute later."""
_PATIENCE_S = 20.0
"""What an address has to take a report, s. Doubled, one that hangs is tried half as often."""
_FIRST_WAIT_S, _LONGEST_WAIT_S = 5.0, 900.0
"""Wait after the first failure, doubled after each, and the longest, s. Doubled, a report comes later after
the network was gone."""
_LATEST_H = 23.75
"""By the Sun, hours after noon: where the Sun doesn't rise, the report comes then, before the next night."""
_WHAT = "morning report"
_ENDINGS = {"html": ".html", "markdown": ".md", "json": ".json"}

Tell = Callable[[str, dict[str, object]], object]


@dataclass(frozen=True, slots=True)
class Sent:
    """What came of one way of a report.

    Attributes
    ----------
    to : str
        A folder, or the host of an address, with its place in the settings: never its path.
    """

    to: str
    night: str
    ok: bool
    detail: str = ""


def night_due(utc: datetime, settings: Settings) -> str | None:
    """The night whose report is due: the one that ended this morning; None before sunrise and after noon.

    Returns
    -------
    str or None
        The date of its evening.
    """
    site = settings.site.site
    by_the_sun = utc.astimezone(UTC) + timedelta(hours=site.longitude_deg / 15.0 - 12.0)
    hours = by_the_sun.hour + by_the_sun.minute / 60.0
    if hours < 12.0 or (hours < _LATEST_H and sun_altitude_deg(utc, site) < 0.0):
        return None
    return by_the_sun.date().isoformat()


class MorningPosts:
    """Sends reports. Used from the event loop's thread alone.

    Parameters
    ----------
    tell : callable
        Publishes an event.
    client : httpx.AsyncClient, optional
        Instead of one of its own.
    """

    def __init__(
        self, settings: Settings, journal: SqlJournal, tell: Tell, client: httpx.AsyncClient | None = None
    ) -> None:
        self._settings, self._journal, self._tell = settings, journal, tell
        self._client = client
        self._done: set[tuple[str, str]] | None = None
        self._under_way: dict[tuple[str, str], asyncio.Task[None]] = {}
        self._looking: asyncio.Task[None] | None = None
        self.failed: dict[str, str] = {}
        """Why each way failed last; empty when all went well."""

    def know(self, settings: Settings) -> None:
        """Go by these settings from now on."""
        self._settings = settings

    def start(self) -> None:
        """Begin to look for mornings; nothing is done where the settings want nothing."""
        if self._settings.report.wanted and self._looking is None:
            self._looking = begun(self._look(), "morning reports", died=self._died)

    async def close(self) -> None:
        """End; what is under way is given up, and done after the next start. Twice is fine."""
        tasks = [one for one in (self._looking, *self._under_way.values()) if one is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def due(self, utc: datetime) -> list[asyncio.Task[None]]:
        """Begin what is due, and return it; nothing is begun twice. Raises `MountnavError`."""
        night = night_due(utc, self._settings)
        if night is None:
            return []
        if self._done is None:
            self._done = await asyncio.to_thread(self._known, utc)
        ways = [one for one in self._ways() if (one, night) not in self._done]
        ways = [one for one in ways if (one, night) not in self._under_way]
        if not ways:
            return []
        reports, words = await asyncio.to_thread(self._made, night)
        begun_now = []
        for way in ways:
            task = waited_for(self._send(way, night, reports, words), f"{_WHAT} to {way}")
            self._under_way[way, night] = task
            task.add_done_callback(partial(self._over, (way, night)))
            begun_now.append(task)
        return begun_now

    def _over(self, which: tuple[str, str], _: object) -> None:
        self._under_way.pop(which, None)

    async def _look(self) -> None:
        while True:
            try:
                await self.due(clock.utc_now())
            except MountnavError as trouble:
                # the journal can't be read: it is tried again
                _log.warning("the %s can't be made: %s", _WHAT, trouble)
            await asyncio.sleep(clock.real_s(_LOOK_S))

    def _ways(self) -> dict[str, WebhookSettings | Path]:
        report = self._settings.report
        ways: dict[str, WebhookSettings | Path] = {}
        if report.folder is not None:
            ways[f"folder {report.folder}"] = report.folder
        for number, webhook in enumerate(report.webhook, 1):
            ways[f"webhook {number} ({urlsplit(webhook.url).hostname})"] = webhook
        return ways

    def _known(self, utc: datetime) -> set[tuple[str, str]]:
        """What the journal tells of the last days. Blocks."""
        wanted = Wanted(kinds=frozenset({EntryKind.NOTE}), since=utc - timedelta(days=3), text=_WHAT)
        found = set()
        for one in self._journal.reader.entries(wanted, limit=1000):
            if one.facts.get("report_ok") is True:
                found.add((str(one.facts.get("report_to")), str(one.facts.get("report_night"))))
        return found

    def _made(self, night: str) -> tuple[list[MorningReport], dict[str, str]]:
        """The reports of a night, of telescopes that did something if any did. Blocks."""
        since, until = night_of(night, self._settings.site.site)
        reader = self._journal.reader
        reports = [report_of(reader, one.id, since, until) for one in self._settings.telescope]
        if any(one.first_utc is not None for one in reports):
            reports = [one for one in reports if one.first_utc is not None]
        head = reader.audit_head()
        return reports, words_of(reports, night, str(head or ""))

    async def _send(
        self, way: str, night: str, reports: Sequence[MorningReport], words: dict[str, str]
    ) -> None:
        target = self._ways()[way]
        try:
            if isinstance(target, Path):
                await asyncio.to_thread(self._write, target, night, reports)
                detail = ""
            else:
                detail = await self._post(target, reports, words)
            sent = Sent(way, night, True, detail)
        except Exception as trouble:  # whatever it is, the night goes on
            sent = Sent(way, night, False, _why(trouble))
        self._said(sent)

    def _write(self, folder: Path, night: str, reports: Sequence[MorningReport]) -> None:
        """Write it; old ones go. Blocks."""
        report = self._settings.report
        folder.mkdir(parents=True, exist_ok=True)
        texts = {
            "html": lambda: "\n".join(as_html(one) for one in reports),
            "markdown": lambda: "\n".join(as_markdown(one) for one in reports),
            "json": lambda: json.dumps([one.as_dict() for one in reports], indent=2, allow_nan=False) + "\n",
        }
        for form in report.forms:
            replace_bytes(folder / f"{night}{_ENDINGS[form]}", texts[form]().encode())
        if report.keep_days > 0:
            first = (datetime.fromisoformat(night) - timedelta(days=report.keep_days)).date().isoformat()
            for ending in _ENDINGS.values():
                for old in folder.glob(f"????-??-??{ending}"):
                    if old.stem < first:
                        old.unlink(missing_ok=True)

    async def _post(
        self, webhook: WebhookSettings, reports: Sequence[MorningReport], words: dict[str, str]
    ) -> str:
        """Post it, again and again while that may help; what the address answered. Raises what ended it."""
        body: Any = body_of(webhook.kind, reports, words, template=webhook.template, topic=webhook.topic)
        retrying = tenacity.AsyncRetrying(
            retry=tenacity.retry_if_exception(_may_pass),
            wait=tenacity.wait_random_exponential(multiplier=_FIRST_WAIT_S, max=_LONGEST_WAIT_S),
            stop=tenacity.stop_after_delay(self._settings.report.retry_h * 3600.0),
            reraise=True,
        )
        async for attempt in retrying:
            with attempt:
                async with self._session() as client:
                    answer = await client.post(
                        webhook.url, json=body, headers=webhook.headers, timeout=_PATIENCE_S
                    )
                answer.raise_for_status()
                return f"HTTP {answer.status_code}"
        raise AssertionError("tenacity ends by a return or an exception")

    @contextlib.asynccontextmanager
    async def _session(self) -> Any:
        if self._client is not None:
            yield self._client
            return
        async with httpx.AsyncClient(follow_redirects=False) as client:
            yield client

    def _said(self, sent: Sent) -> None:
        assert self._done is not None
        facts: dict[str, object] = {
            "report_to": sent.to,
            "report_night": sent.night,
            "report_ok": sent.ok,
            "detail": sent.detail,
        }
        words = f"the {_WHAT} of {sent.night} " + (
            f"went to {sent.to}" if sent.ok else f"could not be sent to {sent.to}: {sent.detail}"
        )
        # given up as well: it is not begun again each minute
        self._done.add((sent.to, sent.night))
        if sent.ok:
            self.failed.pop(sent.to, None)
            _log.info("%s", words)
        else:
            self.failed[sent.to] = words
            _log.error("%s", words)
        self._journal.note_now(Entry(clock.utc_now(), "", EntryKind.NOTE, words, facts, Cause()))
        self._tell("report-sent" if sent.ok else "report-failed", facts)

    def _died(self, fault: Exception) -> None:
        self.failed["the reports"] = f"no {_WHAT} is sent any more: {fault_words(fault)}"
        _log.error("no %s is sent any more: %s", _WHAT, fault_words(fault))


def _may_pass(trouble: BaseException) -> bool:
    """Whether it may go well later: the network, a server's own trouble, too many at once."""
    if isinstance(trouble, httpx.HTTPStatusError):
        return trouble.response.status_code in (408, 425, 429) or trouble.response.status_code >= 500
    return isinstance(trouble, httpx.TransportError)


def _why(trouble: Exception) -> str:
    """Without the address, which httpx puts into its words."""
    if isinstance(trouble, httpx.HTTPStatusError):
        return f"it answered HTTP {trouble.response.status_code}"
    if isinstance(trouble, httpx.HTTPError):
        return f"it can't be reached ({type(trouble).__name__})"
    if isinstance(trouble, OSError):
        return trouble.strerror or type(trouble).__name__
    return fault_words(trouble) if not isinstance(trouble, MountnavError) else str(trouble)
