"""A telescope's night: its state and its drift, started, stopped, paused; what schedulers and sensors say."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Body, Depends, Request

from api.http.night_views import BusyBody, NightView, SafetyBody, WhyBody, night_view
from api.nights.nights import NightRunner, Nights
from api.problems import responses
from api.service import TheTelescope
from mountnav.night.events import Word

router = APIRouter(prefix="/telescopes", tags=["night"])


async def _night(request: Request, telescope: TheTelescope) -> NightRunner:
    nights: Nights = request.app.state.service.nights
    return nights.of(telescope.id)


TheNight = Annotated[NightRunner, Depends(_night)]
Why = Annotated[WhyBody | None, Body()]


@router.get("/{telescope_id}/night", responses=responses(404, 409))
async def get_night(night: TheNight) -> NightView:
    """The night: phase, what was measured and corrected, and the drift so far."""
    return _view(night)


@router.post("/{telescope_id}/night/start", responses=responses(404, 409))
async def start_night(night: TheNight, body: Why = None) -> NightView:
    """Begin the night now, wherever the Sun stands. A night that has begun goes on: twice is fine."""
    return await _said(night, Word.START, body)


@router.post("/{telescope_id}/night/stop", responses=responses(404, 409))
async def stop_night(night: TheNight, body: Why = None) -> NightView:
    """End this night; a correction under way is stopped. The next night begins by itself."""
    return await _said(night, Word.STOP, body)


@router.post("/{telescope_id}/night/pause", responses=responses(404, 409))
async def pause_night(night: TheNight, body: Why = None) -> NightView:
    """Make no corrections until `resume`. Frames are still measured."""
    return await _said(night, Word.PAUSE, body)


@router.post("/{telescope_id}/night/resume", responses=responses(404, 409))
async def resume_night(night: TheNight, body: Why = None) -> NightView:
    """Make corrections again, after `pause`."""
    return await _said(night, Word.RESUME, body)


@router.post("/{telescope_id}/night/busy", responses=responses(404, 409))
async def say_busy(night: TheNight, body: BusyBody) -> NightView:
    """Say whether an exposure runs: nothing is corrected during one."""
    if body.busy:
        await night.session.say(Word.BUSY, for_s=body.for_s)
    else:
        await night.session.say(Word.FREE)
    return _view(night)


@router.post("/{telescope_id}/night/safety", responses=responses(404, 409))
async def say_safety(night: TheNight, body: SafetyBody) -> NightView:
    """Say whether it is safe. What was said last holds until it is said otherwise, or for `for_s`."""
    await night.session.say(Word.SAFE if body.safe else Word.UNSAFE, body.why, for_s=body.for_s)
    return _view(night)


async def _said(night: NightRunner, word: Word, body: WhyBody | None) -> NightView:
    await night.session.say(word, body.why if body is not None else "")
    return _view(night)


def _view(night: NightRunner) -> NightView:
    settings = night.parts.settings
    return night_view(
        night.session.report(),
        night.parts.telescope_id,
        correct_by=settings.correct_by,
        folder=None if settings.folder is None else str(settings.folder),
        folder_problem="" if night.watcher is None else night.watcher.problem,
        recording_problem="" if night.parts.recording is None else night.parts.recording.problem,
    )
