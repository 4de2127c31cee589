"""What became of one telescope's night, by the journal alone: targets, errors, time, troubles, advice.

Everything is counted from what was written down; what isn't there is None, never 0. The numbers of the report
are plain values, so that Markdown, HTML, JSON and a webhook tell the same (`mountnav.night.report_pages`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, time, timedelta
from itertools import pairwise
from statistics import median
from typing import Any

from mountnav.errors import BadRequest
from mountnav.journal.job_rows import JobRow
from mountnav.journal.reading import JournalReader, Wanted
from mountnav.journal.records import Cause, CommandEnd, CommandRecord, Entry, EntryKind, LookRecord, Outcome
from mountnav.sky.coordinates import Site

__all__ = ["Centered", "MorningReport", "Trouble", "night_of", "report_of"]

_GAP_S = 900.0
"""Two things a telescope did that lie farther apart are a pause of the night, s: longer than usual exposures
between looks. Doubled, shorter pauses go untold."""
_FAR_ARCSEC = 300.0
"""A median pointing error above this is worth a pointing model, ″. Chosen by hand: half the width of a usual
narrow field. Doubled, a telescope that misses narrow fields gets no advice."""
_MANY = 0.3
"""A share of failures above this is no chance of single frames. Chosen by hand. Doubled, a cloudy night gets
no advice."""
_FEWEST = 5
"""Fewer looks or centerings than this say nothing of a share."""
_TROUBLES = frozenset({EntryKind.FAULT, EntryKind.LINK, EntryKind.REFUSAL, EntryKind.JOB})
_LOST, _BACK = "link-lost", ("link-back", "connected")
"""What the journal's rows of a link say."""
_MOVING = ("slew", "park", "home")
_CENTER = "center"
"""The kind of a job that centers one target."""


def night_of(date: str, site: Site) -> tuple[datetime, datetime]:
    """The night of an evening's date, from noon to noon by the Sun.

    Parameters
    ----------
    date : str
        As 2026-11-25.

    Raises
    ------
    BadRequest
    """
    try:
        day = datetime.strptime(date, "%Y-%m-%d").date()
    except ValueError as wrong:
        raise BadRequest(
            f"{date!r} is not a night", advice="the date of its evening, such as 2026-11-25"
        ) from wrong
    noon = datetime.combine(day, time(12), tzinfo=UTC) - timedelta(hours=site.longitude_deg / 15.0)
    return noon, noon + timedelta(days=1)


@dataclass(frozen=True, slots=True)
class Centered:
    """One centering.

    Attributes
    ----------
    utc : datetime
        When it ended.
    outcome : str
        ``centered``, or the slug of what kept it from that.
    error_before_arcsec, error_after_arcsec : float or None
        How far off it was at the first look and at the last one.
    expected_arcsec : float or None
        What the pointing model or earlier looks had promised for the first look.
    """

    utc: datetime
    ra_deg: float | None
    dec_deg: float | None
    outcome: str
    error_before_arcsec: float | None
    error_after_arcsec: float | None
    expected_arcsec: float | None
    tries: int
    elapsed_s: float | None
    flipped: bool

    @property
    def succeeded(self) -> bool:
        """Whether the target was in the middle at the end."""
        return self.outcome == "centered"


@dataclass(frozen=True, slots=True)
class Trouble:
    """Something that went wrong, however often.

    Attributes
    ----------
    kind : str
        Of the journal's rows: ``fault``, ``link``, ``refusal``; ``job``: an order that failed otherwise.
    what : str
        In words, of the first time.
    """

    kind: str
    what: str
    times: int
    first_utc: datetime
    last_utc: datetime


@dataclass(frozen=True, slots=True)
class MorningReport:
    """One telescope's night.

    Attributes
    ----------
    unsolved : mapping of str to int
        By the reason.
    fwhm_arcsec, limiting_mag : float or None
        Median over the solved looks.
    slewing_s, centering_s, lost_s : float
        Time in slews; in centerings; and of that in centerings that failed, and with a lost link.
    syncs : mapping of str to int
        By how each ended.
    pauses : tuple of (datetime, datetime)
        In which it did nothing.
    """

    telescope: str
    since_utc: datetime
    until_utc: datetime
    first_utc: datetime | None
    last_utc: datetime | None
    looks: int
    solved: int
    unsolved: Mapping[str, int]
    fwhm_arcsec: float | None
    limiting_mag: float | None
    centerings: tuple[Centered, ...]
    slewed: int
    slewing_s: float
    centering_s: float
    lost_s: float
    syncs: Mapping[str, int]
    open_commands: int
    runs: int
    troubles: tuple[Trouble, ...]
    pauses: tuple[tuple[datetime, datetime], ...]
    advice: tuple[str, ...] = field(default=())

    @property
    def centered(self) -> int:
        """Targets that were in the middle at the end."""
        return sum(one.succeeded for one in self.centerings)

    @property
    def error_before_arcsec(self) -> float | None:
        """Median pointing error at the first look of a centering: how well the mount points by itself."""
        return _median(one.error_before_arcsec for one in self.centerings)

    @property
    def error_after_arcsec(self) -> float | None:
        """Median error at the end of those that succeeded."""
        return _median(one.error_after_arcsec for one in self.centerings if one.succeeded)

    def as_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "telescope": self.telescope,
            "since_utc": _iso(self.since_utc),
            "until_utc": _iso(self.until_utc),
            "first_utc": _iso(self.first_utc),
            "last_utc": _iso(self.last_utc),
            "looks": self.looks,
            "solved": self.solved,
            "unsolved": dict(self.unsolved),
            "fwhm_arcsec": self.fwhm_arcsec,
            "limiting_mag": self.limiting_mag,
            "targets": len(self.centerings),
            "centered": self.centered,
            "error_before_arcsec": self.error_before_arcsec,
            "error_after_arcsec": self.error_after_arcsec,
            "centerings": [
                {
                    "utc": _iso(one.utc),
                    "ra_deg": one.ra_deg,
                    "dec_deg": one.dec_deg,
                    "outcome": one.outcome,
                    "error_before_arcsec": one.error_before_arcsec,
                    "error_after_arcsec": one.error_after_arcsec,
                    "expected_arcsec": one.expected_arcsec,
                    "tries": one.tries,
                    "elapsed_s": one.elapsed_s,
                    "flipped": one.flipped,
                }
                for one in self.centerings
            ],
            "slewed": self.slewed,
            "slewing_s": self.slewing_s,
            "centering_s": self.centering_s,
            "lost_s": self.lost_s,
            "syncs": dict(self.syncs),
            "open_commands": self.open_commands,
            "runs": self.runs,
            "troubles": [
                {
                    "kind": one.kind,
                    "what": one.what,
                    "times": one.times,
                    "first_utc": _iso(one.first_utc),
                    "last_utc": _iso(one.last_utc),
                }
                for one in self.troubles
            ],
            "pauses": [{"since_utc": _iso(since), "until_utc": _iso(until)} for since, until in self.pauses],
            "advice": list(self.advice),
        }


def report_of(reader: JournalReader, telescope: str, since: datetime, until: datetime) -> MorningReport:
    """Read a night of one telescope from the journal.

    Raises
    ------
    JournalFailed, BadSettings, NotFound
        It can't be read; as `JournalReader`.
    """
    wanted = Wanted(telescope=telescope, since=since, until=until)
    looks, commands, entries = reader.looks(wanted), reader.commands(wanted), reader.entries(wanted)
    ended = reader.jobs(None, telescopes=frozenset({telescope}), since=since, until=until)
    centerings = tuple(_centerings(entries, ended))
    slews = [(record, end) for record, end in commands if record.order in _MOVING and end is not None]
    slewing_s = sum((end.utc - record.utc).total_seconds() for record, end in slews)
    # a link that is lost makes the centering fail as well: time is lost once
    lost = [*_away(entries, until), *_in_vain(centerings)]
    times = sorted([*(one.utc for one in looks), *(record.utc for record, _ in commands)])
    solved = [one for one in looks if one.solved]
    runs = reader.runs(None, since=since, until=until)
    report = MorningReport(
        telescope=telescope,
        since_utc=since,
        until_utc=until,
        first_utc=times[0] if times else None,
        last_utc=times[-1] if times else None,
        looks=len(looks),
        solved=len(solved),
        unsolved=dict(Counter(one.reason or "not told" for one in looks if not one.solved)),
        fwhm_arcsec=_median(_fwhm_arcsec(one) for one in solved),
        limiting_mag=_median(one.limiting_mag for one in solved),
        centerings=centerings,
        slewed=sum(end.outcome is Outcome.DONE for _, end in slews),
        slewing_s=slewing_s,
        centering_s=sum(one.elapsed_s or 0.0 for one in centerings),
        lost_s=_covered_s(lost),
        syncs=dict(Counter(str(one.facts.get("outcome")) for one in entries if one.kind is EntryKind.SYNC)),
        open_commands=sum(end is None for _, end in commands),
        runs=len(runs),
        troubles=_troubles([*entries, *_failed(entries, ended)]),
        pauses=tuple(_pauses(times)),
    )
    return _advised(report, commands)


def _centerings(entries: Sequence[Entry], jobs: Iterable[JobRow]) -> Iterable[Centered]:
    """Those that told their end, and those that never came to it: no device, or the service died."""
    told = [one for one in entries if one.kind is EntryKind.CENTERING]
    known = {one.cause.job_id for one in told}
    untold = [
        _never_told(one) for one in jobs if one.kind == _CENTER and one.job_id not in known and _over(one)
    ]
    return sorted([*(_centered(one) for one in told), *untold], key=lambda one: one.utc)


def _over(job: JobRow) -> bool:
    return job.finished_utc is not None


def _never_told(job: JobRow) -> Centered:
    assert job.finished_utc is not None
    began = job.started_utc or job.created_utc
    elapsed_s = (job.finished_utc - began).total_seconds()
    target = job.request.get("target")
    asked = target if isinstance(target, Mapping) else job.request
    return Centered(
        utc=job.finished_utc,
        ra_deg=_number(asked.get("ra_deg")),
        dec_deg=_number(asked.get("dec_deg")),
        outcome=_slug(job),
        error_before_arcsec=None,
        error_after_arcsec=None,
        expected_arcsec=None,
        tries=len(job.attempts),
        # the clock may have been set back meanwhile
        elapsed_s=max(0.0, elapsed_s),
        flipped=False,
    )


def _slug(job: JobRow) -> str:
    """What kept it from its end: `device-missing` of urn:mountnav:problem:device-missing."""
    told = (job.problem or {}).get("type")
    return told.rpartition(":")[2] if isinstance(told, str) and told else job.state


def _failed(entries: Sequence[Entry], jobs: Iterable[JobRow]) -> Iterable[Entry]:
    """Other orders that failed, of which no row of another kind tells."""
    known = {one.cause.job_id for one in entries if one.kind in _TROUBLES}
    for one in jobs:
        if one.kind == _CENTER or one.state != "failed" or one.job_id in known or one.finished_utc is None:
            continue
        detail = (one.problem or {}).get("detail")
        why = detail if isinstance(detail, str) and detail else _slug(one)
        what = f"the order {one.kind} failed"
        yield Entry(one.finished_utc, one.telescope, EntryKind.JOB, what, {"why": why}, Cause(one.job_id))


def _centered(entry: Entry) -> Centered:
    facts = entry.facts
    tries = facts.get("tries")
    told: Sequence[Mapping[str, Any]] = tries if isinstance(tries, list) else []
    before, after = _number(facts.get("error_before_arcsec")), _number(facts.get("error_after_arcsec"))
    if told and before is None:
        # of one that failed only its tries tell
        before, after = _number(told[0].get("error_arcsec")), _number(told[-1].get("error_arcsec"))
    elapsed = _number(facts.get("elapsed_s"))
    if elapsed is None and told:
        elapsed = _number(told[-1].get("elapsed_s"))
    return Centered(
        utc=entry.utc,
        ra_deg=_number(facts.get("target_ra_deg")),
        dec_deg=_number(facts.get("target_dec_deg")),
        outcome=str(facts.get("outcome", "unknown")),
        error_before_arcsec=before,
        error_after_arcsec=after,
        expected_arcsec=_number(facts.get("expected_error_arcsec")),
        tries=len(told),
        elapsed_s=elapsed,
        flipped=facts.get("flipped") is True,
    )


def _troubles(entries: Iterable[Entry]) -> tuple[Trouble, ...]:
    """What went wrong, alike things together, in the order of the first time."""
    found: dict[tuple[str, str], Trouble] = {}
    for entry in sorted(entries, key=lambda one: one.utc):
        if entry.kind not in _TROUBLES:
            continue
        if entry.kind is EntryKind.LINK and entry.what != _LOST:
            continue
        why = entry.facts.get("why")
        words = f"{entry.what}: {why}" if isinstance(why, str) and why not in entry.what else entry.what
        # numbers in the words differ from time to time; the first of them are told
        alike = str(entry.kind), "".join(letter for letter in words if not letter.isdigit())
        before = found.get(alike)
        found[alike] = Trouble(
            str(entry.kind),
            words if before is None else before.what,
            1 if before is None else before.times + 1,
            entry.utc if before is None else before.first_utc,
            entry.utc,
        )
    return tuple(found.values())


def _away(entries: Iterable[Entry], until: datetime) -> Iterable[tuple[datetime, datetime]]:
    """When the mount's link was lost."""
    lost: datetime | None = None
    for entry in entries:
        if entry.kind is not EntryKind.LINK:
            continue
        if entry.what == _LOST:
            lost = lost or entry.utc
        elif lost is not None and entry.what in _BACK:
            yield lost, entry.utc
            lost = None
    if lost is not None:
        yield lost, until


def _in_vain(centerings: Iterable[Centered]) -> Iterable[tuple[datetime, datetime]]:
    """When targets were tried that were not centered."""
    for one in centerings:
        if not one.succeeded and one.elapsed_s:
            yield one.utc - timedelta(seconds=one.elapsed_s), one.utc


def _covered_s(spans: Iterable[tuple[datetime, datetime]]) -> float:
    """How long all of them last together; what several cover counts once."""
    total_s, reached = 0.0, datetime.min.replace(tzinfo=UTC)
    for since, until in sorted(spans):
        total_s += max(0.0, (until - max(since, reached)).total_seconds())
        reached = max(reached, until)
    return total_s


def _pauses(times: Sequence[datetime]) -> Iterable[tuple[datetime, datetime]]:
    for earlier, later in pairwise(times):
        if (later - earlier).total_seconds() > _GAP_S:
            yield earlier, later


def _fwhm_arcsec(one: LookRecord) -> float | None:
    if one.fwhm_px is None or one.scale_arcsec_px is None:
        return None
    return one.fwhm_px * one.scale_arcsec_px


def _advised(
    report: MorningReport, commands: Sequence[tuple[CommandRecord, CommandEnd | None]]
) -> MorningReport:
    """The report with what an operator should do about it."""
    said = []
    failed = report.looks - report.solved
    if report.looks >= _FEWEST and failed > _MANY * report.looks:
        reason, times = max(report.unsolved.items(), key=lambda one: one[1])
        said.append(
            f"{failed} of {report.looks} looks were not solved, {times} of them for: {reason}. Look at the "
            f"sky, the focus and the exposure before the next night"
        )
    before = report.error_before_arcsec
    if before is not None and before > _FAR_ARCSEC and len(report.centerings) >= _FEWEST:
        said.append(
            f"the first look of a centering was {before:.0f}″ off in the median: order a model-run on a "
            f"clear night, and look at the polar axis (mountnav drift)"
        )
    missed = len(report.centerings) - report.centered
    if missed:
        outcomes = Counter(one.outcome for one in report.centerings if not one.succeeded)
        words = ", ".join(f"{outcome} ({times})" for outcome, times in outcomes.most_common())
        said.append(f"{missed} of {_counted(len(report.centerings), 'target')} not centered: {words}")
    not_taken = sum(times for end, times in report.syncs.items() if "ignored" in end or "another" in end)
    if not_taken:
        said.append(
            f"the mount did not take {_counted(not_taken, 'sync')} as sent: try mountnav bench, or "
            f'correct_by = "offset"'
        )
    stalled = sum(end is not None and end.outcome is Outcome.STALLED for _, end in commands)
    if stalled:
        said.append(f"{_counted(stalled, 'slew')} stalled: look at the mount's axes, cables and balance")
    links = sum(one.times for one in report.troubles if one.kind == "link")
    if links:
        said.append(
            f"the mount's link was lost {_counted(links, 'time')}: look at its cable, its power, the USB hub"
        )
    if report.open_commands:
        said.append(
            f"{_counted(report.open_commands, 'order')} without an outcome: the service ended meanwhile"
        )
    if report.runs > 1:
        said.append(f"the service was started {report.runs} times: its log says why")
    return replace(report, advice=tuple(said))


def _counted(number: int, what: str) -> str:
    """A count in words: 1 sync, 2 syncs."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None and math.isfinite(value)]
    return median(known) if known else None


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def _iso(utc: datetime | None) -> str | None:
    return None if utc is None else utc.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
