"""A frame from outside against what the mount said round it: from values alone, so that it can be redone."""

from __future__ import annotations

from datetime import datetime, timedelta

from mountnav.errors import SyncDoubt
from mountnav.frames import Frame
from mountnav.navigation.camera_identity import camera_of
from mountnav.navigation.looking import at_instant, look_of
from mountnav.navigation.readings_kept import Meanwhile
from mountnav.navigation.reports import FrameLook, Look
from mountnav.solution import Verdict

NOT_READ = "the mount was not read round this frame's exposure"


def compared(
    frame: Frame, verdict: Verdict, middle: datetime, meanwhile: Meanwhile, *, look_id: str
) -> FrameLook:
    """What a frame shows, and what stands against using it.

    Parameters
    ----------
    frame : Frame
    verdict : Verdict
    middle : datetime
        Of its exposure.
    meanwhile : Meanwhile
    look_id : str
    """
    doubts: list[SyncDoubt] = []
    words: list[str] = []
    around, moved_utc = meanwhile.around, meanwhile.moved_utc
    if around is None:
        words.append(NOT_READ)
    elif around.moved_arcsec > meanwhile.allowed_arcsec or around.slewing:
        doubts.append(SyncDoubt.MOVED)
        words.append(f"the mount moved {around.moved_arcsec:.0f}″ during its exposure")
    if moved_utc is not None and moved_utc > middle - half_exposure(frame):
        doubts.append(SyncDoubt.OLDER_THAN_MOVE)
        words.append("its exposure began before the mount last came to rest")
    if verdict.solution is None:
        return FrameLook(None, tuple(doubts), verdict.detail)
    found: Look | None = None
    if around is not None:
        found = look_of(
            frame,
            verdict,
            at_instant(around.before, around.after, middle),
            around.before,
            around.after,
            middle,
            look_id=look_id,
            segment_id=meanwhile.segment_id,
            model_id=meanwhile.model_id,
            camera=camera_of(frame),
        )
        if not doubts and meanwhile.not_fresh:
            doubts.append(SyncDoubt.NOT_FRESH)
            words.append(meanwhile.not_fresh)
    return FrameLook(found, tuple(doubts), "; ".join(words))


def half_exposure(frame: Frame) -> timedelta:
    """From a frame's middle to its begin or its end, as far as it is known."""
    return timedelta(seconds=0.5 * (frame.exposure_s or 0.0))


__all__ = ["NOT_READ", "compared", "half_exposure"]
