"""A look: read the mount, expose, read again, solve, compare: one frame, one instant, one kind of place."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Protocol
from uuid import uuid4

from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame, MountMoved, NotSolved
from mountnav.frames import Frame, Hint
from mountnav.measuring.quality import SkyQuality
from mountnav.navigation.devices import Camera, Mount, MountReading
from mountnav.navigation.kinds import from_mount
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.reports import Look
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec
from mountnav.solution import Verdict
from mountnav.solve_settings import SolveSettings

Listener = Callable[[str, dict[str, object]], None]


class Solve(Protocol):
    """Finds out where a frame was taken, while everything else goes on: a stop never waits for it."""

    async def __call__(self, frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
        """Answer with a verdict, as `mountnav.solve.solve` does."""
        ...


def in_thread(catalog: Catalog) -> Solve:
    """Solve in a thread of this process, for whoever has no solver of his own.

    Parameters
    ----------
    catalog : Catalog

    Returns
    -------
    Solve
        Cancelling it frees the caller at once; the thread goes on to its end.
    """
    from mountnav.solve import solve  # a service that has a solver needs none of its parts

    async def solve_in_thread(frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
        return await asyncio.to_thread(solve, frame, catalog, hint=hint, settings=settings)

    return solve_in_thread


@dataclass(frozen=True, slots=True)
class Instruments:
    """The devices, the solver and the settings of solving that a look needs."""

    mount: Mount
    camera: Camera
    solve: Solve
    solving: SolveSettings


async def look(
    instruments: Instruments, policy: CenteringPolicy, listen: Listener, *, exposure_s: float | None = None
) -> Look:
    """Expose and solve, with the mount read before and after the exposure.

    Parameters
    ----------
    instruments : Instruments
    policy : CenteringPolicy
    listen : callable
        Told of each step: ``listen(kind, data)``.
    exposure_s : float, optional
        Instead of the policy's.

    Returns
    -------
    Look

    Raises
    ------
    MountMoved
        The mount's readings before and after differ by more than its own resolution and the policy allow,
        or it says that it is slewing.
    BadFrame
        The frame tells no time of exposure, or one that doesn't lie between the two readings.
    NotSolved
        `policy.solve_retries` frames in a row gave no solution; nothing was moved.
    """
    seconds = policy.exposure_s if exposure_s is None else exposure_s
    last: Verdict | None = None
    for attempt in range(1, policy.solve_retries + 1):
        listen("exposing", {"exposure_s": seconds, "attempt": attempt})
        before = await instruments.mount.reading()
        frame = await instruments.camera.expose(seconds)
        after = await instruments.mount.reading()
        middle = _mid_exposure(frame, policy, before, after)
        _refuse_motion(instruments.mount, policy, before, after)
        believed = _at_instant(before, after, middle)
        hint = _hint(believed, policy)
        listen("solving", {"source": frame.source})
        last = await instruments.solve(frame, hint, instruments.solving)
        if last.solution is not None:
            seen = last.solution.icrs_at((frame.width_px - 1) / 2, (frame.height_px - 1) / 2)
            found = Look(
                look_id=uuid4().hex,
                verdict=last,
                solution=last.solution,
                seen=seen,
                believed=believed,
                offset=offset_arcsec(seen, believed),
                before=before,
                after=after,
                mid_exposure_utc=middle,
            )
            listen("solved", _solved_facts(found))
            return found
        listen("not-solved", {"reason": str(last.reason), "detail": last.detail, "measured": last.measured})
    assert last is not None
    raise NotSolved(
        f"{policy.solve_retries} frame(s) could not be identified: {last.reason} ({last.detail})",
        device=instruments.camera.name,
        advice="nothing was moved or synced; check focus, cloud, exposure and the configured scale",
    )


def _mid_exposure(
    frame: Frame, policy: CenteringPolicy, before: MountReading, after: MountReading
) -> datetime:
    """The frame's mid-exposure; a frame of another time, say from before the last slew, is never used."""
    if frame.mid_exposure_utc is None:
        raise BadFrame(
            f"{frame.source}: no time of exposure in the frame",
            advice="let the camera write DATE-OBS and EXPTIME: without them a look can't be compared",
        )
    middle = frame.mid_exposure_utc
    early_s = (before.utc - middle).total_seconds()
    late_s = (middle - after.utc).total_seconds()
    if max(early_s, late_s) > policy.max_clock_error_s:
        when = f"{early_s:.1f} s before" if early_s > 0 else f"{late_s:.1f} s after"
        raise BadFrame(
            f"{frame.source}: exposed {when} the time it was asked for",
            advice="is it an older frame, or does the camera's clock differ from this machine's?",
        )
    return middle


def _refuse_motion(mount: Mount, policy: CenteringPolicy, before: MountReading, after: MountReading) -> None:
    moved = separation_arcsec(from_mount(before.place), from_mount(after.place))
    allowed = policy.max_motion_arcsec + mount.resolution_arcsec
    if moved > allowed or before.slewing or after.slewing:
        raise MountMoved(
            f"the mount moved {moved:.0f}″ during the exposure (allowed {allowed:.0f}″)",
            device=mount.name,
            advice="is it tracking? is somebody else moving it?",
        )


def _at_instant(before: MountReading, after: MountReading, instant: datetime) -> Icrs:
    """The reading at mid-exposure, on the great circle between the two readings' places."""
    first, second = from_mount(before.place), from_mount(after.place)
    span_s = (after.utc - before.utc).total_seconds()
    share = 0.5 if span_s <= 0 else min(1.0, max(0.0, (instant - before.utc).total_seconds() / span_s))
    way = offset_arcsec(second, first)
    return displaced(first, share * way.east_arcsec, share * way.north_arcsec)


def _hint(believed: Icrs, policy: CenteringPolicy) -> Hint:
    """What the mount believes about the frame's center; the policy's scale where it is set."""
    hint = Hint(center=believed, radius_deg=policy.search_radius_deg, center_source="the mount's reading")
    if policy.scale_arcsec_px is not None:
        low, high = (policy.scale_arcsec_px * (1 + sign * policy.scale_tolerance) for sign in (-1, 1))
        hint = replace(hint, scale_low_arcsec_px=low, scale_high_arcsec_px=high, scale_source="the settings")
    return hint


def _sky(quality: SkyQuality | None) -> dict[str, object]:
    """What a scheduler wants to know of the night."""
    if quality is None:
        return {}
    return {
        "fwhm_arcsec": quality.fwhm_arcsec,
        "ellipticity": quality.ellipticity,
        "sky_adu": quality.sky_adu,
        "limiting_mag": quality.limiting_mag,
    }


def _solved_facts(found: Look) -> dict[str, object]:
    solution = found.solution
    sigma = solution.center_sigma_arcsec
    return {
        "look_id": found.look_id,
        "ra_deg": found.seen.ra_deg,
        "dec_deg": found.seen.dec_deg,
        "sigma_arcsec": sigma if math.isfinite(sigma) else None,
        "pairs": solution.pairs,
        "rms_arcsec": solution.rms_arcsec,
        "false_probability": solution.false_probability,
        "blind": found.blind,
        "offset_east_arcsec": found.offset.east_arcsec,
        "offset_north_arcsec": found.offset.north_arcsec,
        "offset_arcsec": found.offset.total_arcsec,
        "mid_exposure_utc": found.mid_exposure_utc.isoformat(),
        "solve_s": found.verdict.times.total_s,
        "contradictions": [str(one) for one in found.verdict.contradictions],
        **_sky(found.verdict.quality),
    }
