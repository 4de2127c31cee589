"""The state of telescopes over HTTP: made once for each reading, however many ask, and no device is asked.

The entity tag names the reading, so that a client that has it already is answered 304 without a body.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from fastapi import Request, Response

from api.http.headline_views import on_target
from api.http.sky_views import aim_of, has_target
from api.observatory.observatory import Telescope
from api.orders.held_axes import HeldAxes
from api.orders.job import Job
from api.orders.job_views import (
    AxisMovesView,
    FollowingView,
    NextLimitView,
    OnTargetView,
    RatesInForceView,
    TelescopeView,
)
from api.orders.results import place
from api.orders.watching import Snapshot
from api.service import Service
from mountnav.clock import utc_now
from mountnav.devices import MountReading
from mountnav.mount import CheckedMount
from mountnav.sky.chain import icrs_to_hour_angle, sidereal_time_deg
from mountnav.sky.coordinates import SIDEREAL_DEG_S

__all__ = ["Answer", "StateAnswers", "answered", "knows", "state_answers", "telescope_view"]


_WITHIN_S = 12 * 3600.0
"""How far ahead the next limit is searched, s: whatever is up sets, or comes to the meridian, within 12 h.
Halved, limits in the second half of a night are not shown."""


def telescope_view(
    telescope: Telescope,
    snapshot: Snapshot,
    warnings: Sequence[str] = (),
    held: HeldAxes | None = None,
    jobs: Iterable[Job] = (),
) -> TelescopeView:
    """View of a telescope as it was read last. Asks no device.

    Parameters
    ----------
    held : HeldAxes, optional
        Its axes that somebody moves by hand.
    jobs : iterable of Job
        Those of all telescopes, newest first; what it is on is told by them.
    warnings : sequence of str
        Of the service; those of the telescope come before.
    """
    state, navigator = snapshot.state, telescope.navigator
    reading, mount = state.reading, navigator.mount
    own = navigator.learned.warnings(
        configured_scale_arcsec_px=navigator.policy.scale_arcsec_px,
        tolerance=navigator.policy.scale_tolerance,
    )
    limit = None if reading is None else _next_limit(mount, reading)
    here = None
    if reading is not None and state.icrs is not None:
        here = icrs_to_hour_angle(state.icrs, reading.utc, mount.site, mount.air)
    return TelescopeView(
        id=state.name,
        connected=state.connected,
        activity=state.activity,
        mount=telescope.mount_address,
        reading=None if reading is None else place(reading.place),
        icrs=None if state.icrs is None else place(state.icrs),
        read_utc=None if reading is None else reading.utc,
        altitude_deg=state.altitude_deg,
        azimuth_deg=state.azimuth_deg,
        hour_angle_deg=None if here is None else here.ha_deg,
        local_sidereal_time_deg=None if reading is None else sidereal_time_deg(reading.utc, mount.site),
        slewing=snapshot.slewing or (None if reading is None else reading.slewing),
        job_id=None if snapshot.job is None else snapshot.job.id,
        job_kind=None if snapshot.job is None else snapshot.job.kind,
        on=_on_view(telescope, snapshot, jobs),
        problem=state.problem,
        trusted=state.trusted,
        contradiction=mount.contradiction if state.connected else None,
        link=state.link,
        slew_state=state.slew_state,
        tracking=None if reading is None else reading.tracking,
        parked=None if reading is None else reading.parked,
        pier_side=str(reading.pier_side) if reading is not None and reading.pier_side else None,
        still_since_utc=snapshot.still_since_utc,
        time_to_meridian_s=None if here is None else -here.ha_deg / SIDEREAL_DEG_S,
        time_to_limit_s=None if limit is None else limit.after_s,
        next_limit=limit,
        rates=rates_view(mount),
        following=following_view(snapshot.job),
        axes_moved=[] if held is None else axes_view(held),
        following_problem=mount.following_problem,
        learned=navigator.learned.words,
        rates_kept=navigator.rates.words,
        warnings=[*own, *warnings],
    )


def _on_view(telescope: Telescope, snapshot: Snapshot, jobs: Iterable[Job]) -> OnTargetView | None:
    running, mount = snapshot.job, telescope.navigator.mount
    if running is not None:
        aimed = running if has_target(running) else None
    else:
        aimed = next((job for job in jobs if job.telescope == telescope.id and has_target(job)), None)
    if aimed is None:
        return None
    # a body that moves has a name; where it stands now takes too long to be asked with every reading
    aim = aim_of(aimed, utc_now(), mount.site, mount.air, bodies_too=False)
    on = on_target(snapshot.state, running, aimed, aim)
    if on is None:
        return None
    return OnTargetView(
        name=on.name,
        job_id=on.job.id,
        arrived=on.arrived,
        error_arcsec=on.error_arcsec,
        error_utc=on.error_utc,
    )


def rates_view(mount: CheckedMount) -> RatesInForceView | None:
    """The rates of a moving target that are in force."""
    force = mount.offset_rates_in_force
    if force is None:
        return None
    return RatesInForceView(
        ra_arcsec_s=force.rates.ra_arcsec_s,
        dec_arcsec_s=force.rates.dec_arcsec_s,
        since_utc=force.since_utc,
        ends_utc=force.ends_utc,
    )


def following_view(job: Job | None) -> FollowingView | None:
    """What a job follows, with what was told of it last; None of any other job."""
    if job is None or job.kind != "follow" or job.is_over:
        return None
    now = job.progress
    told = {name: now[name] for name in FollowingView.model_fields if now.get(name) is not None}
    return FollowingView.model_validate({"name": _target_name(job), "until_utc": _until(job), **told})


def _target_name(job: Job) -> str:
    target = job.request.get("target")
    if not isinstance(target, Mapping):
        return "a target"
    return str(target.get("name") or target.get("text") or f"a target by {target.get('kind')}")


def _until(job: Job) -> datetime | None:
    until, lasts_s = job.request.get("until_utc"), job.request.get("duration_s")
    if isinstance(until, str):
        return datetime.fromisoformat(until)
    began = job.started_utc or job.created_utc
    return began + timedelta(seconds=lasts_s) if isinstance(lasts_s, int | float) else None


def axes_view(held: HeldAxes) -> list[AxisMovesView]:
    """The axes that somebody moves by hand."""
    return [
        AxisMovesView(axis=axis, rate_deg_s=rate_deg_s, left_s=round(left_s, 2))
        for axis, (rate_deg_s, left_s) in held.rates().items()
    ]


def _next_limit(mount: CheckedMount, reading: MountReading) -> NextLimitView | None:
    """Which limit tracking on leads to; a mount that doesn't say whether it tracks is taken to."""
    if reading.tracking is False or reading.parked:
        return None
    soon = mount.reached(reading, within_s=_WITHIN_S)
    if soon is None:
        return None
    return NextLimitView(
        limit=str(soon.limit),
        after_s=soon.after_s,
        utc=reading.utc + timedelta(seconds=soon.after_s),
        altitude_deg=soon.alt_deg,
        azimuth_deg=soon.az_deg,
    )


_JSON = "application/json"


@dataclass(frozen=True, slots=True)
class Answer:
    """A body and its tag."""

    tag: str
    body: bytes


class StateAnswers:
    """Keeps the latest answer of each telescope."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._kept: dict[str, Answer] = {}
        self._of: dict[str, Telescope] = {}

    def of(self, telescope: Telescope) -> Answer:
        """The answer of one telescope."""
        snapshot = self._service.dispatcher.watch(telescope.id).latest
        job = "" if snapshot.job is None else snapshot.job.id[:12]
        # the service's id: after a restart the counting begins again
        tag = f'"{self._service.events.run}-{snapshot.revision}-{job}{self._beside(telescope)}"'
        kept = self._kept.get(telescope.id)
        if kept is None or kept.tag != tag or self._of[telescope.id] is not telescope:
            self._of[telescope.id] = telescope
            problem = self._service.restored.problem
            held = self._service.dispatcher.held(telescope.id)
            warnings = () if problem is None else (problem,)
            view = telescope_view(telescope, snapshot, warnings, held, self._service.jobs.all())
            kept = self._kept[telescope.id] = Answer(tag, view.model_dump_json().encode())
        return kept

    def _beside(self, telescope: Telescope) -> str:
        """What changes between readings, for the tag: the end of rates, speeds of axes."""
        force = telescope.navigator.mount.offset_rates_in_force
        axes = self._service.dispatcher.held(telescope.id).rates()
        told = [] if force is None else [f"{force.rates}{force.ends_utc.timestamp():.0f}"]
        job = self._service.dispatcher.watch(telescope.id).latest.job
        told += [] if job is None or job.kind != "follow" else [f"{job.progress.get('utc')}"]
        told += [f"{axis}{rate_deg_s}" for axis, (rate_deg_s, _) in axes.items()]
        return f"-{hashlib.sha256(''.join(told).encode()).hexdigest()[:8]}" if told else ""

    def all(self, of: frozenset[str] | None = None) -> Answer:
        """The answer of all telescopes, as a list; `of`: of these alone."""
        each = [
            self.of(telescope)
            for telescope in self._service.dispatcher.telescopes
            if of is None or telescope.id in of
        ]
        tag = hashlib.sha256("".join(answer.tag for answer in each).encode()).hexdigest()[:24]
        return Answer(f'"{tag}"', b"[" + b",".join(answer.body for answer in each) + b"]")


def answered(request: Request, answer: Answer) -> Response:
    """200 with the body and its tag; 304 to a client that has it."""
    headers = {"ETag": answer.tag, "Cache-Control": "no-cache"}
    if knows(request.headers.get("if-none-match"), answer.tag):
        return Response(status_code=304, headers=headers)
    return Response(answer.body, media_type=_JSON, headers=headers)


def knows(if_none_match: str | None, tag: str) -> bool:
    """Whether a client that sent `If-None-Match` has the answer of that tag [RFC 9110 §13.1.2]."""
    if if_none_match is None:
        return False
    told = [part.strip().removeprefix("W/") for part in if_none_match.split(",")]
    return "*" in told or tag in told


async def state_answers(request: Request) -> StateAnswers:
    """Those of the service that a request came to."""
    state = request.app.state
    found: StateAnswers | None = getattr(state, "state_answers", None)
    if found is None or found._service is not state.service:
        found = state.state_answers = StateAnswers(state.service)
    return found
