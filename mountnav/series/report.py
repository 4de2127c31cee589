"""Summing up a series: its centers in order of time, cut at jumps, each segment with its drift."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from mountnav.series.drift import LEAST_FRAMES, Drift, Track, fit_drift, joined, jumps
from mountnav.series.persistence import PersistentSources
from mountnav.series.results import FrameResult, Segment, SeriesReport, SeriesSettings
from mountnav.series.shift import scale_sigma
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset, offset_arcsec


def series_report(
    frames: tuple[FrameResult, ...],
    settings: SeriesSettings,
    *,
    persistent: PersistentSources | None = None,
    anchor: int | None = None,
) -> SeriesReport:
    """Sum up a series.

    Parameters
    ----------
    anchor : int, optional
        The frame that `persistent` is given in.

    Returns
    -------
    SeriesReport
        Frames without a time or a center take no part in the drift.
    """
    placed = [frame for frame in frames if frame.solution is not None]
    timed = [frame for frame in placed if frame.mid_exposure_utc is not None]
    if not timed:
        reason = "no frame tells when it was taken" if placed else "no frame was solved"
        return SeriesReport(frames, (), None, reason, persistent, anchor)
    timed.sort(key=lambda one: (one.mid_exposure_utc, one.number))
    track = _track(timed)
    scales = [frame.solution.scale_arcsec_px for frame in timed if frame.solution is not None]
    edges = [0, *jumps(track, settings.jump_px * float(np.median(scales))), len(timed)]
    bounds = list(pairwise(edges))
    parts = [fit_drift(track.part(start, stop)) for start, stop in bounds]
    whole = joined([drift for drift in parts if drift is not None])
    segments = [
        Segment(
            frames=tuple(frame.number for frame in timed[start:stop]),
            drift=drift,
            reason="" if drift else _no_drift(stop - start),
            jump=_jump(track, timed, start, whole) if start else None,
        )
        for (start, stop), drift in zip(bounds, parts, strict=True)
    ]
    reason = ""
    if whole is None:
        missing = len(placed) - len(timed)
        reason = _no_drift(max(len(segment.frames) for segment in segments))
        if missing:
            reason += f"; {missing} frames don't say when they were taken"
    return SeriesReport(frames, tuple(segments), whole, reason, persistent, anchor)


def _no_drift(frames: int) -> str:
    if frames < LEAST_FRAMES:
        return f"{frames} timed frames without a jump between them, {LEAST_FRAMES} are needed"
    return "all frames are of one instant"


def _jump(track: Track, timed: list[FrameResult], to: int, drift: Drift | None) -> Offset:
    """How far the center went to a point beyond what the drift took it."""
    step = offset_arcsec(_center(timed[to]), _center(timed[to - 1]))
    if drift is None:
        return step
    gap = float(track.minutes[to] - track.minutes[to - 1])
    return Offset(
        step.east_arcsec - drift.ra_arcsec_min * gap, step.north_arcsec - drift.dec_arcsec_min * gap
    )


def _center(frame: FrameResult) -> Icrs:
    """The center as followed, so that neighbors share their anchor's error; else as solved."""
    if frame.followed is not None:
        return frame.followed
    assert frame.solution is not None
    return frame.solution.center


def _track(timed: list[FrameResult]) -> Track:
    start = timed[0].mid_exposure_utc
    by_number = {frame.number: frame for frame in timed}
    minutes, ra, dec, sigma, anchor, anchor_sigma = [], [], [], [], [], []
    for frame in timed:
        assert frame.mid_exposure_utc is not None
        assert start is not None
        assert frame.solution is not None
        place = _center(frame)
        minutes.append((frame.mid_exposure_utc - start).total_seconds() / 60.0)
        ra.append(place.ra_deg)
        dec.append(place.dec_deg)
        if frame.followed is not None and frame.shift is not None:
            anchor.append(frame.shift.anchor)
            of = by_number.get(frame.shift.anchor)
            own = frame.solution.center_sigma_arcsec
            anchor_sigma.append(of.solution.center_sigma_arcsec if of and of.solution else own)
            error_px = 0.5 * (frame.shift.dx_sigma_px + frame.shift.dy_sigma_px)
            sigma.append(error_px * frame.solution.scale_arcsec_px)
        else:
            anchor.append(frame.number)
            anchor_sigma.append(frame.solution.center_sigma_arcsec)
            sigma.append(
                0.01 * frame.solution.scale_arcsec_px
            )  # followed from itself: its own noise is the anchor's
    return Track(
        np.array(minutes),
        np.array(ra),
        np.array(dec),
        np.array(sigma),
        np.array(anchor, dtype=np.int64),
        np.array(anchor_sigma),
        _scale_sigma(timed),
    )


def _scale_sigma(timed: list[FrameResult]) -> float:
    """Relative error of the anchors' scale: the largest one, since one anchor may be followed all night."""
    anchors = [frame.solution for frame in timed if frame.followed is None and frame.solution is not None]
    return max((scale_sigma(anchor) for anchor in anchors), default=0.0)
