"""How a target is followed, and how it was: what listeners are told, and what the order comes to."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from mountnav.devices import (
    OffsetRates,
)
from mountnav.navigation.follow_plan import (
    FollowBy,
    FollowPlan,
)
from mountnav.navigation.rates_seen import (
    RateFault,
    RatesJudgement,
)
from mountnav.navigation.reports import CenterReport, finite_or_none
from mountnav.pointing.limits.along import SkyEvent


class FollowEnd(StrEnum):
    """Why following ended."""

    TIME = "time"
    EPHEMERIS = "ephemeris-ends"
    LIMIT = "limit-ahead"


@dataclass(frozen=True, slots=True)
class FollowProgress:
    """How it goes.

    Attributes
    ----------
    off_arcsec, off_sigma_arcsec : float or None
        From the target, as the last look saw it; None before one.
    judgement : RatesJudgement or None
        Of the rates, with what was measured.
    ordered : OffsetRates or None
        What the mount is to keep beside the sidereal rate.
    sent : OffsetRates or None
        What it was sent for that: other numbers where a correction is in force.
    left_s : float
        Until the end.
    next_event : str
        What comes next on the path, in words; empty if nothing does.
    words : str
        What has just happened.
    """

    utc: datetime
    phase: str
    by: FollowBy
    off_arcsec: float | None
    off_sigma_arcsec: float | None
    judgement: RatesJudgement | None
    ordered: OffsetRates | None
    sent: OffsetRates | None
    left_s: float
    next_event: str
    words: str


@dataclass(frozen=True, slots=True)
class FollowReport:
    """How a target was followed.

    Attributes
    ----------
    end : FollowEnd
        Every other end is an error.
    began_utc, ended_utc : datetime
        Of following itself.
    plan : FollowPlan
        As it was planned.
    by : FollowBy
        By what it was followed at last.
    centered : CenterReport or None
        None of a fast target, which is waited for.
    worst_arcsec, rms_arcsec, last_arcsec : float or None
        How far off the looks were from the second one on; None without.
    within : int
        So many of those were within the tolerance.
    stated_arcsec : float or None
        Of a fast target: how far off it may have been by all that was known, rms of one sigma; it is followed
        by the mount's readings. None of a slow one: its looks say it.
    renewed : int
        So often rates were ordered, or pulses, or slews.
    judgement : RatesJudgement or None
        The last one.
    fault : RateFault or None
        The last that was named.
    correction : str
        In force, in words; empty if none is.
    events : tuple of SkyEvent
        What was foretold.
    """

    end: FollowEnd
    target_name: str
    began_utc: datetime
    ended_utc: datetime
    plan: FollowPlan
    by: FollowBy
    centered: CenterReport | None
    looks: int
    unsolved: int
    worst_arcsec: float | None
    rms_arcsec: float | None
    last_arcsec: float | None
    within: int
    stated_arcsec: float | None
    tolerance_arcsec: float
    renewed: int
    judgement: RatesJudgement | None
    fault: RateFault | None
    correction: str
    events: tuple[SkyEvent, ...]
    notes: tuple[str, ...]
    elapsed_s: float


def progress_facts(progress: FollowProgress) -> dict[str, object]:
    """How it goes, for listeners: finite numbers or None."""
    judged = progress.judgement
    seen = None if judged is None else judged.measured
    ordered, sent = progress.ordered, progress.sent
    return {
        "utc": progress.utc.isoformat(),
        "phase": progress.phase,
        "by": str(progress.by),
        "off_arcsec": progress.off_arcsec,
        "off_sigma_arcsec": None
        if progress.off_sigma_arcsec is None
        else finite_or_none(progress.off_sigma_arcsec),
        "verdict": None if judged is None else judged.verdict,
        "fault": None if judged is None or judged.fault is None else str(judged.fault),
        "seen_ra_arcsec_s": None if seen is None else seen.rates.ra_arcsec_s,
        "seen_dec_arcsec_s": None if seen is None else seen.rates.dec_arcsec_s,
        "seen_ra_sigma_arcsec_s": None if seen is None else seen.ra_sigma_arcsec_s,
        "seen_dec_sigma_arcsec_s": None if seen is None else seen.dec_sigma_arcsec_s,
        "ordered_ra_arcsec_s": None if ordered is None else ordered.ra_arcsec_s,
        "ordered_dec_arcsec_s": None if ordered is None else ordered.dec_arcsec_s,
        "sent_ra_arcsec_s": None if sent is None else sent.ra_arcsec_s,
        "sent_dec_arcsec_s": None if sent is None else sent.dec_arcsec_s,
        "left_s": progress.left_s,
        "next_event": progress.next_event,
        "words": progress.words,
    }
