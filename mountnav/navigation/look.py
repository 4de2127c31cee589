"""A look: read the mount, expose, read again, solve, compare: one frame at one instant.

Whatever comes of it is written down before anything is decided by it: absolute values at one instant, as
models take them [POINTING §6].
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Literal

from mountnav.devices import Epoch, MountReading, PierSide, for_mount, from_mount
from mountnav.errors import BadFrame, CameraStale, MountMoved, SyncDoubt
from mountnav.frames import Frame, Hint
from mountnav.journal.records import EntryKind, LookRecord, because, cause, new_id
from mountnav.measuring.measurements import SkyQuality
from mountnav.mount.kill_points import kill_point
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.frames_seen import LAGS, Sight, fingerprint, takes_long
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.reports import CameraIdentity, Look, camera_of, finite_or_none
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Air, Icrs
from mountnav.sky.iers import earth_orientation
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec
from mountnav.solution import Solution, Verdict

__all__ = [
    "LookOptions",
    "LookResult",
    "RepeatedFrame",
    "at_instant",
    "camera_stale",
    "covariance_of",
    "expose_and_solve",
    "judge_freshness",
    "look_of",
    "not_solved_facts",
    "observation_of",
    "record_of",
    "report_stale",
    "solved_facts",
]


def record_of(
    equipment: Equipment,
    *,
    look_id: str,
    utc: datetime,
    before: MountReading,
    after: MountReading,
    frame: Frame,
    exposure_s: float,
    used: str,
    segment_id: str,
    model_id: str | None,
    verdict: Verdict | None = None,
    look: Look | None = None,
    refused: tuple[str, str] | None = None,
) -> LookRecord:
    """The row of a look, solved or not.

    Parameters
    ----------
    utc : datetime
        Mid-exposure; of the second reading where the frame has none.
    segment_id, model_id : str, str or None
        As they were when the frame was exposed.
    verdict : Verdict, optional
        None when the frame was not even solved, since it can't be used.
    look : Look, optional
        When it was solved.
    refused : (reason, detail), optional
        Why it can't be used.
    """
    solution = None if look is None else look.solution
    quality = None if verdict is None else verdict.quality
    reason, detail = refused or ("", "")
    if verdict is not None and solution is None and refused is None:
        reason, detail = str(verdict.reason), verdict.detail
    return LookRecord(
        look_id=look_id,
        telescope=equipment.name,
        utc=utc,
        solved=solution is not None,
        before=before,
        after=after,
        segment_id=segment_id,
        air=equipment.air,
        reason=reason,
        detail=detail,
        seen=None if look is None else look.seen,
        covariance_arcsec2=None if solution is None else covariance_of(solution),
        model_id=model_id,
        dut1_s=earth_orientation(utc).dut1_s,
        camera=equipment.camera.name,
        source=frame.source,
        exposure_s=frame.exposure_s if frame.exposure_s is not None else exposure_s,
        mode="" if solution is None else solution.mode,
        catalog="" if solution is None else solution.catalog,
        pairs=0 if solution is None else solution.pairs,
        rms_arcsec=None if solution is None else finite_or_none(solution.rms_arcsec),
        false_probability=None if solution is None else finite_or_none(solution.false_probability),
        scale_arcsec_px=None if solution is None else solution.scale_arcsec_px,
        rotation_deg=None if solution is None else solution.rotation_deg,
        parity=None if solution is None else solution.parity,
        fwhm_px=None if quality is None else quality.fwhm_px,
        limiting_mag=None if quality is None else quality.limiting_mag,
        sky_adu=None if quality is None else quality.sky_adu,
        measured=0 if verdict is None else verdict.measured,
        used=used,
        cause=cause(),
    )


def observation_of(
    look: Look, *, epoch: Epoch, air: Air, segment_id: str, model_id: str | None = None
) -> PointingObservation:
    """A look as models, the doctor and the drift report take it."""
    solution = look.solution
    sides = {look.before.pier_side, look.after.pier_side}
    side = sides.pop() if len(sides) == 1 else None
    return PointingObservation(
        utc=look.mid_exposure_utc,
        seen=look.seen,
        sigma_arcsec=look.sigma_arcsec,
        reading=for_mount(look.believed, epoch, look.mid_exposure_utc),
        side=side or PierSide.UNKNOWN,
        segment_id=segment_id,
        air=air,
        rotation_deg=solution.rotation_deg,
        scale_arcsec_px=solution.scale_arcsec_px,
        parity=solution.parity,
        model_id=model_id,
        look_id=look.look_id,
    )


def covariance_of(solution: Solution) -> tuple[float, float, float] | None:
    """East-east, east-north and north-north; None where they are no numbers."""
    matrix = solution.center_covariance_arcsec2
    if matrix.shape != (2, 2):
        return None
    values = (float(matrix[0, 0]), float(matrix[0, 1]), float(matrix[1, 1]))
    return values if all(map(math.isfinite, values)) else None


CONFIRMED_LATER = frozenset({"look", "recovery", "first light"})
"""Looks by which alone nothing is moved or synced: the last two ask for frames that agree themselves."""


class RepeatedFrame(BadFrame):
    """The pixels of a frame are those of an earlier one."""


@dataclass(frozen=True, slots=True)
class LookOptions:
    """How one frame is taken and searched.

    Attributes
    ----------
    radius_deg : float
        How far from the mount's belief it is sought.
    blind : {"after", "only", "never"} or None
        Instead of the solver's settings.
    scale : {"learned", "settings", "any"}
        What is believed of the scale.
    used : str
        What it is for, as the journal keeps it.
    teaches : bool
        Whether what is known of camera and pointing learns from it.
    following_arcsec : float or None
        The mount follows a target that moves among the stars, so far during the exposure: its reading may
        move by that much more, and what the frames before it showed proves nothing. None: it doesn't.
    """

    exposure_s: float
    radius_deg: float
    blind: Literal["after", "only", "never"] | None = None
    scale: Literal["learned", "settings", "any"] = "learned"
    used: str = "look"
    teaches: bool = True
    following_arcsec: float | None = None


@dataclass(frozen=True, slots=True)
class LookResult:
    """A frame that could be used; solved when `look` is set.

    Attributes
    ----------
    doubt : str
        Why nothing may be done by the look before another one was taken, in words; empty if it is believed.
    """

    verdict: Verdict
    believed: Icrs
    width_px: int
    look: Look | None
    doubt: str = ""


async def expose_and_solve(
    equipment: Equipment, policy: CenteringPolicy, shot: LookOptions, *, attempt: int = 1
) -> LookResult:
    """Expose and solve one frame, with the mount read before and after the exposure.

    Parameters
    ----------
    attempt : int
        For those who listen.

    Raises
    ------
    MountMoved
        The mount's readings before and after differ by more than its own resolution and the policy allow,
        it says that it is slewing, or it was ordered to move meanwhile.
    BadFrame
        The frame has no time of exposure, or one that doesn't lie between the two readings; or its pixels
        are those of an earlier frame (`RepeatedFrame`).
    CameraStale
        The camera was caught again with a frame from before the last slew.
    DeviceError, JournalFailed
    """
    look_id = new_id()
    with because(look_id=look_id):
        equipment.listen("exposing", {"exposure_s": shot.exposure_s, "attempt": attempt})
        segment_id, model_id = equipment.mount.segment_id, equipment.pointing.model_id
        kill_point("look begin")
        before = await equipment.mount.reading()
        kill_point("look read")
        frame = await equipment.camera.expose(shot.exposure_s)
        kill_point("look exposed")
        equipment.guard.looks_through(camera_of(frame, equipment.camera.name))
        after = await equipment.mount.reading()
        kill_point("look read again")

        async def write(
            verdict: Verdict | None, found: Look | None, refused: tuple[str, str] | None = None
        ) -> None:
            utc = after.utc if frame.mid_exposure_utc is None else frame.mid_exposure_utc
            record = record_of(
                equipment,
                look_id=look_id,
                utc=utc,
                before=before,
                after=after,
                frame=frame,
                exposure_s=shot.exposure_s,
                used=shot.used,
                segment_id=segment_id,
                model_id=model_id,
                verdict=verdict,
                look=found,
                refused=refused,
            )
            await equipment.journal.look(record)
            kill_point("look written")

        try:
            middle = _mid_exposure(frame, shot.exposure_s, policy, before, after)
            _refuse_motion(equipment, policy, before, after, shot.following_arcsec or 0.0)
            await _refuse_repeated(equipment, frame)
        except (BadFrame, MountMoved) as error:
            await write(None, None, (error.slug, error.what))
            raise
        believed = at_instant(before, after, middle)
        equipment.listen("solving", {"source": frame.source})
        verdict = await _solved(equipment, policy, shot, frame, believed)
        kill_point("look solved")
        if verdict.solution is None:
            await write(verdict, None)
            equipment.listen("not-solved", not_solved_facts(verdict))
            return LookResult(verdict, believed, frame.width_px, None)
        found = look_of(
            frame,
            verdict,
            believed,
            before,
            after,
            middle,
            look_id=look_id,
            segment_id=segment_id,
            model_id=model_id,
            camera=camera_of(frame, equipment.camera.name),
            tolerance_arcsec=policy.tolerance_arcsec,
        )
        sight = Sight()
        if shot.following_arcsec is None:
            sight = judge_freshness(equipment, policy, found, confirmed_later=shot.used in CONFIRMED_LATER)
        await write(verdict, found, (str(SyncDoubt.NOT_FRESH), sight.doubt) if sight.doubt else None)
        equipment.listen("solved", solved_facts(found))
        if sight.doubt:
            return LookResult(verdict, believed, frame.width_px, found, sight.doubt)
        for look in (*sight.agreed, found) if shot.teaches else ():
            await equipment.guard.learn(look)
        kill_point("look learned")
        if sight.lagged:
            await _blame(equipment, found, sight.lagged)
        return LookResult(verdict, believed, frame.width_px, found)


def judge_freshness(
    equipment: Equipment, policy: CenteringPolicy, found: Look, *, confirmed_later: bool
) -> Sight:
    """Whether a solved frame shows the sky of now, by those that its camera gave before."""
    assert found.camera is not None
    return equipment.frames.of(found.camera).judge(
        found,
        allowed_arcsec=policy.max_motion_arcsec,
        resolution_arcsec=equipment.mount.resolution_arcsec,
        moved_utc=equipment.mount.last_motion_utc,
        synced=equipment.guard.synced,
        confirmed_later=confirmed_later,
    )


async def _blame(equipment: Equipment, found: Look, words: str) -> None:
    """Tell that the camera gave an old frame; end the look when it wasn't the first time."""
    assert found.camera is not None
    lags = equipment.frames.of(found.camera).lags
    await report_stale(equipment, words, look_id=found.look_id, times=lags)
    if lags >= LAGS:
        raise camera_stale(equipment, f"{words} ({lags} times now)")


async def report_stale(equipment: Equipment, words: str, **facts: object) -> None:
    """Report to listeners and journal that the camera gave an old frame."""
    told: dict[str, object] = {"camera": equipment.camera.name, "why": words, **facts}
    equipment.listen("camera-stale", told)
    await equipment.note(EntryKind.FAULT, f"the camera {equipment.camera.name}: {words}", told)


def camera_stale(equipment: Equipment, words: str) -> CameraStale:
    """What is raised when the camera can't be believed."""
    return CameraStale(
        words,
        device=equipment.camera.name,
        advice="nothing was synced by it; restart the camera or its driver, switch off its streaming or "
        "buffering, and order again",
    )


async def _refuse_repeated(equipment: Equipment, frame: Frame) -> None:
    """Refuse a frame whose pixels were there before."""
    if takes_long(frame.pixels):
        print_ = await asyncio.to_thread(fingerprint, frame.pixels)
    else:
        print_ = fingerprint(frame.pixels)
    if equipment.frames.of(camera_of(frame, equipment.camera.name)).repeats(frame, print_):
        raise RepeatedFrame(
            f"{frame.source}: identical, pixel for pixel, to an earlier frame, but with a new time",
            advice="restart the camera or its driver: no two exposures are identical",
        )


def look_of(
    frame: Frame,
    verdict: Verdict,
    believed: Icrs,
    before: MountReading,
    after: MountReading,
    middle: datetime,
    *,
    look_id: str,
    segment_id: str,
    model_id: str | None,
    camera: CameraIdentity,
    tolerance_arcsec: float = math.inf,
) -> Look:
    """A solved frame against the readings round it."""
    assert verdict.solution is not None
    seen = verdict.solution.icrs_at((frame.width_px - 1) / 2, (frame.height_px - 1) / 2)
    return Look(
        look_id=look_id,
        verdict=verdict,
        solution=verdict.solution,
        seen=seen,
        believed=believed,
        offset=offset_arcsec(seen, believed),
        before=before,
        after=after,
        mid_exposure_utc=middle,
        exposure_s=frame.exposure_s,
        width_px=frame.width_px,
        height_px=frame.height_px,
        segment_id=segment_id,
        model_id=model_id,
        camera=camera,
        tolerance_arcsec=tolerance_arcsec,
    )


async def _solved(
    equipment: Equipment, policy: CenteringPolicy, shot: LookOptions, frame: Frame, believed: Icrs
) -> Verdict:
    solving = equipment.solving if shot.blind is None else replace(equipment.solving, blind=shot.blind)
    hint = Hint(center=believed, radius_deg=shot.radius_deg, center_source="the mount's reading")
    if shot.scale != "any" and policy.scale_arcsec_px is not None:
        low, high = (policy.scale_arcsec_px * (1 + sign * policy.scale_tolerance) for sign in (-1, 1))
        hint = replace(hint, scale_low_arcsec_px=low, scale_high_arcsec_px=high, scale_source="the settings")
    if shot.scale == "learned":
        hint = equipment.guard.learned.hint(hint)
    return await equipment.solve(frame, hint, solving)


def _mid_exposure(
    frame: Frame, asked_s: float, policy: CenteringPolicy, before: MountReading, after: MountReading
) -> datetime:
    """The frame's mid-exposure; a frame of another time, say from before the last slew, is never used."""
    if frame.mid_exposure_utc is None:
        raise BadFrame(
            f"{frame.source}: no time of exposure in the frame",
            advice="make the camera write DATE-OBS and EXPTIME: without them a look "
            "can't be compared with the mount",
        )
    middle = frame.mid_exposure_utc
    half = timedelta(seconds=0.5 * (asked_s if frame.exposure_s is None else frame.exposure_s))
    for early, late in (
        ((before.utc - middle).total_seconds(), (middle - after.utc).total_seconds()),
        ((before.utc - (middle - half)).total_seconds(), (middle + half - after.utc).total_seconds()),
    ):
        if max(early, late) > policy.max_clock_error_s:
            when = f"{early:.1f} s before" if early > late else f"{late:.1f} s after"
            raise BadFrame(
                f"{frame.source}: exposed {when} the time it was asked for",
                advice="is it an older frame, or does the camera's clock differ from this machine's?",
            )
    return middle


def _refuse_motion(
    equipment: Equipment,
    policy: CenteringPolicy,
    before: MountReading,
    after: MountReading,
    following_arcsec: float,
) -> None:
    mount = equipment.mount
    moved = separation_arcsec(from_mount(before.place), from_mount(after.place))
    allowed = policy.max_motion_arcsec + mount.resolution_arcsec + following_arcsec
    ordered = mount.last_motion_utc is not None and mount.last_motion_utc > before.utc
    if moved > allowed or before.slewing or after.slewing or ordered:
        raise MountMoved(
            f"the mount moved {moved:.0f}″ during the exposure (allowed {allowed:.0f}″)",
            device=mount.name,
            advice="is it tracking? is somebody else moving it?",
        )


def at_instant(before: MountReading, after: MountReading, instant: datetime) -> Icrs:
    """The reading at mid-exposure, on the great circle between the two readings' places."""
    first, second = from_mount(before.place), from_mount(after.place)
    span_s = (after.utc - before.utc).total_seconds()
    share = 0.5 if span_s <= 0 else min(1.0, max(0.0, (instant - before.utc).total_seconds() / span_s))
    way = offset_arcsec(second, first)
    return displaced(first, share * way.east_arcsec, share * way.north_arcsec)


def not_solved_facts(verdict: Verdict) -> dict[str, object]:
    """The facts of an unsolved frame, for listeners."""
    return {"reason": str(verdict.reason), "detail": verdict.detail, "measured": verdict.measured}


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


def solved_facts(found: Look) -> dict[str, object]:
    """The facts of a solved look, for listeners."""
    solution = found.solution
    sigma = solution.center_sigma_arcsec
    return {
        "look_id": found.look_id,
        "ra_deg": found.seen.ra_deg,
        "dec_deg": found.seen.dec_deg,
        "sigma_arcsec": finite_or_none(sigma),
        "pairs": solution.pairs,
        "rms_arcsec": solution.rms_arcsec,
        "false_probability": solution.false_probability,
        "blind": found.blind,
        "offset_east_arcsec": found.offset.east_arcsec,
        "offset_north_arcsec": found.offset.north_arcsec,
        "offset_arcsec": found.offset.total_arcsec,
        "mid_exposure_utc": found.mid_exposure_utc.isoformat(),
        "solve_s": found.verdict.times.total_s,
        "contradictions": [str(contradiction) for contradiction in found.verdict.contradictions],
        **_sky(found.verdict.quality),
    }
