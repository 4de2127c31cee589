"""Trails of satellites and planes, spikes of bright stars: lines in the smoothed frame [S23 §0.3]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.detection import Smoothed
from mountnav.measuring.lines import Segments, find_segments
from mountnav.measuring.trail import Trail
from mountnav.measuring.trail_following import CUT_SIGMA, Follower

Image = NDArray[np.float32]

_MOST_BINS = 448
_THRESHOLD = 6.0
_LEAST_LENGTH_PX = 50.0
_LEAST_LENGTH_FWHM = 12.0
_MOST_TRIALS = 25
_MOST_FAILURES = 10
_MOST_TRAILS = 20
_SAME_BINS = 5.0


def find_trails(smoothed: Smoothed, fwhm_px: float) -> list[Trail]:
    """Find the trails in a smoothed frame.

    Lines are sought in a coarse picture of the frame in which no bin counts more than a few sigma, so that
    stars hardly do; each is then followed through the smoothed frame, piece by piece, and believed if most
    pieces show a ridge of a star's width: the median along a piece doesn't see single stars.

    Parameters
    ----------
    smoothed : Smoothed
    fwhm_px : float
        The stars' width; a trail is at least twelve times as long, and 50 pixels.

    Returns
    -------
    list of Trail
        Clearest first.
    """
    picture = smoothed.significance
    share = max(2, -(-max(picture.shape) // _MOST_BINS))
    coarse = _coarse(picture, share)
    if min(coarse.shape) < 32:
        return []
    least_px = max(_LEAST_LENGTH_PX, _LEAST_LENGTH_FWHM * fwhm_px)
    segments = find_segments(coarse, least_px / (share * smoothed.bin_px) * 0.75, _THRESHOLD)
    follower = Follower(
        picture, fwhm_px / smoothed.bin_px, least_px / smoothed.bin_px, float(share), smoothed.bin_px
    )
    kept: list[Trail] = []
    left = np.ones(segments.x0.size, dtype=bool)
    failures = 0
    for _ in range(_MOST_TRIALS):
        if not left.any() or len(kept) == _MOST_TRAILS or failures == _MOST_FAILURES:
            break
        best = int(np.flatnonzero(left)[0])  # they come best first
        trail = follower.follow(*_ends(segments, best, share))
        left &= ~_alike(segments, best)
        if trail is None or any(_on(trail, other, follower.gap) for other in kept):
            failures += trail is None
            continue
        failures = 0
        kept.append(trail)
        for fraction in (0.2, 0.5, 0.8):
            # pieces that lie on a trail we have, or run through it: only those off it stay
            x = segments.x0 + fraction * (segments.x1 - segments.x0)
            y = segments.y0 + fraction * (segments.y1 - segments.y0)
            here = np.stack([x, y]) * share + 0.5 * (share - 1)
            left &= ~trail.touches(here[0], here[1], 2.0 * share)
    return [_in_frame(trail, smoothed.bin_px) for trail in kept]


def _on(trail: Trail, other: Trail, margin: float) -> bool:
    """Tell whether a trail runs mostly on another one."""
    along = np.linspace(trail.start_px, trail.end_px, 21)
    return bool(other.touches(*trail.places(along), margin).mean() > 0.4)


def _coarse(picture: Image, share: int) -> Image:
    """Mean over share × share bins of the picture, cut on both sides."""
    rows, columns = picture.shape[0] // share, picture.shape[1] // share
    cut = np.clip(picture[: rows * share, : columns * share], -CUT_SIGMA, CUT_SIGMA)
    lines = cut.reshape(rows, share, columns * share).sum(axis=1)
    return np.asarray(lines.reshape(rows, columns, share).mean(axis=2) / np.float32(share), dtype=np.float32)


def _ends(segments: Segments, best: int, share: int) -> tuple[float, float, float, float]:
    shift = 0.5 * (share - 1)
    x0, y0, x1, y1 = (
        float(v[best]) * share + shift for v in (segments.x0, segments.y0, segments.x1, segments.y1)
    )
    return x0, y0, x1, y1


def _alike(segments: Segments, best: int) -> NDArray[np.bool_]:
    """Tell which pieces are nearly the same as the best, or lie within it."""
    x0, y0 = segments.x0[best], segments.y0[best]
    dx, dy = segments.x1[best] - x0, segments.y1[best] - y0
    length = float(np.hypot(dx, dy))
    near = np.ones(segments.x0.size, dtype=bool)
    for x, y in ((segments.x0, segments.y0), (segments.x1, segments.y1)):
        across = np.abs((y - y0) * dx - (x - x0) * dy) / length
        along = ((x - x0) * dx + (y - y0) * dy) / length
        near &= (across < _SAME_BINS) & (along > -_SAME_BINS) & (along < length + _SAME_BINS)
    return near


def _in_frame(trail: Trail, bin_px: int) -> Trail:
    """Turn bins of the smoothed picture to pixels of the frame."""
    shift = 0.5 * (bin_px - 1)
    return Trail(
        x_px=trail.x_px * bin_px + shift,
        y_px=trail.y_px * bin_px + shift,
        along_x=trail.along_x,
        along_y=trail.along_y,
        bend=(trail.bend[0] * bin_px, trail.bend[1], trail.bend[2] / bin_px),
        start_px=trail.start_px * bin_px,
        end_px=trail.end_px * bin_px,
        half_width_px=trail.half_width_px * bin_px,
        height=trail.height,
        spike=trail.spike,
    )


__all__ = ["Trail", "find_trails"]
