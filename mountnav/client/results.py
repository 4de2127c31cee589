"""What the service answers, as types; docs/openapi.json is the whole truth. Times are ISO texts, UTC."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NotRequired, TypedDict

Json = Mapping[str, Any]
"""Any object of an answer."""

JobState = Literal["queued", "running", "succeeded", "failed", "cancelled"]
ENDS = frozenset({"succeeded", "failed", "cancelled"})
"""States of a job that has ended."""


class Problem(TypedDict):
    """What went wrong [RFC 9457]."""

    type: str
    title: str
    status: int
    detail: str
    retryable: bool
    retry_after_s: NotRequired[float | None]
    device: NotRequired[str | None]
    advice: NotRequired[str | None]
    job_id: NotRequired[str | None]
    reasons: NotRequired[list[str] | None]
    errors: NotRequired[list[dict[str, str]] | None]
    superseded_by: NotRequired[str | None]


class Place(TypedDict):
    """A place in a frame that it names."""

    ra_deg: float
    dec_deg: float
    frame: str


class Job(TypedDict):
    """A job; `result` and `problem` are set when it has ended."""

    id: str
    kind: str
    telescope: str
    state: JobState
    phase: str
    request: dict[str, Any]
    attempts: list[dict[str, Any]]
    result: dict[str, Any] | None
    problem: Problem | None
    created_utc: str
    started_utc: str | None
    finished_utc: str | None


class NextPanel(TypedDict):
    """How a mosaic goes on: so many frames are wanted yet of its panel; 0: the next one begins."""

    left: int


class NextLimit(TypedDict):
    """The limit that tracking on leads to."""

    limit: str
    after_s: float
    utc: str
    altitude_deg: float | None
    azimuth_deg: float | None


class RatesInForce(TypedDict):
    """Rates beside the sidereal one at which it tracks; they end by themselves at `ends_utc`."""

    ra_arcsec_s: float
    dec_arcsec_s: float
    since_utc: str
    ends_utc: str


class FollowingState(TypedDict):
    """A target that is followed just now, and what the sky says of it; None where no look has said it yet."""

    name: str
    until_utc: str | None
    by: str | None
    off_arcsec: float | None
    off_sigma_arcsec: float | None
    verdict: str | None
    fault: str | None
    seen_ra_arcsec_s: float | None
    seen_dec_arcsec_s: float | None
    seen_ra_sigma_arcsec_s: float | None
    seen_dec_sigma_arcsec_s: float | None
    ordered_ra_arcsec_s: float | None
    ordered_dec_arcsec_s: float | None
    next_event: str
    words: str


class AxisMoves(TypedDict):
    """An axis that somebody moves by hand; it ends by itself after `left_s`."""

    axis: Literal["primary", "secondary"]
    rate_deg_s: float
    left_s: float


class SkyEvent(TypedDict):
    """Something that happens to a target: rises, sets, meridian, sun-near, limit, ..."""

    kind: str
    utc: str
    altitude_deg: float | None
    azimuth_deg: float | None
    limit: str | None
    words: str


class Forecast(TypedDict):
    """Where a target is now, how it moves, and what will happen to it."""

    telescope: str
    name: str
    moves: bool
    utc: str
    until_utc: str
    ends_utc: str | None
    place: Place
    altitude_deg: float | None
    azimuth_deg: float | None
    sigma_arcsec: float | None
    ra_arcsec_s: float | None
    dec_arcsec_s: float | None
    total_arcsec_s: float | None
    events: list[SkyEvent]


class OnTarget(TypedDict):
    """What a telescope is on, or goes to; `error_arcsec` is None once the mount has moved since the look."""

    name: str | None
    job_id: str
    arrived: bool
    error_arcsec: float | None
    error_utc: str | None


class TelescopeState(TypedDict):
    """What is known of a telescope now; None where unknown."""

    id: str
    connected: bool
    activity: str
    mount: str
    reading: Place | None
    icrs: Place | None
    read_utc: str | None
    altitude_deg: float | None
    azimuth_deg: float | None
    hour_angle_deg: float | None
    local_sidereal_time_deg: float | None
    slewing: bool | None
    job_id: str | None
    job_kind: str | None
    on: OnTarget | None
    problem: str | None
    trusted: bool | None
    contradiction: str | None
    link: str | None
    slew_state: str | None
    tracking: bool | None
    parked: bool | None
    pier_side: str | None
    still_since_utc: str | None
    time_to_meridian_s: float | None
    time_to_limit_s: float | None
    next_limit: NextLimit | None
    rates: RatesInForce | None
    following: FollowingState | None
    axes_moved: list[AxisMoves]
    following_problem: str | None
    learned: str | None
    rates_kept: str | None
    warnings: list[str]


class Stopped(TypedDict):
    """A stop that was given; `stopped` is None while it isn't known whether it was sent."""

    telescope: str
    stopped: bool | None
    cancelled_job_id: str | None


class StopAll(TypedDict):
    """What came of stopping all telescopes; `stopped` is None while it isn't known of one of them."""

    stopped: bool | None
    telescopes: list[dict[str, Any]]


class Reloaded(TypedDict):
    """Ids of telescopes by what reading the settings again has done, and tables that need a restart."""

    added: list[str]
    changed: list[str]
    removed: list[str]
    untouched: list[str]
    needs_restart: list[str]


class LeaseState(TypedDict):
    """Who holds a telescope."""

    telescope: str
    held: bool
    holder: str | None
    note: str | None
    on_expiry: str | None
    ttl_s: float | None
    seconds_left: float | None
    taken_utc: str | None
    until_utc: str | None
    lease: NotRequired[str]


class SkyObject(TypedDict):
    """Something bright that has a name."""

    name: str
    kind: Literal[
        "star", "messier", "planet", "moon", "sun", "minor-planet", "comet", "satellite", "planet-satellite"
    ]
    aliases: list[str]
    mag: float | None
    icrs: Place
    altitude_deg: float | None
    azimuth_deg: float | None
    moves: bool
    rate_arcsec_s: float | None
    sigma_arcsec: float | None
    problem: str | None


class Health(TypedDict):
    """Whether the service is ready, and if not, why not."""

    status: Literal["ok", "degraded"]
    ready: bool
    why_not: list[str]
    concerns: list[str]
    version: str
    telescopes: dict[str, bool]
    solver: str
    journal: str


class Capabilities(TypedDict):
    """What the service can do."""

    version: str
    kinds: list[dict[str, Any]]
    targets: list[str]
    telescopes: list[dict[str, Any]]
    faces: dict[str, Any]
    roles: list[str]
    your_role: str
    problems: list[str]
