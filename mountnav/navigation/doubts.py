"""What stands against a sync: a look and what is known besides, in; named doubts with their numbers, out.

Pure functions: nothing here asks a mount, a clock or a disk.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime

from mountnav.errors import SyncDoubt
from mountnav.navigation.kinds import from_mount
from mountnav.navigation.reports import Look
from mountnav.navigation.sync_policy import SyncPolicy, SyncRule
from mountnav.pointing.in_force import Expected
from mountnav.pointing.plausible import too_far
from mountnav.sky.chain import hour_angle_to_observed, icrs_to_hour_angle
from mountnav.sky.coordinates import Air, Site
from mountnav.sky.sphere import separation_arcsec

GRAVEST_FIRST = (
    SyncDoubt.MOVED,
    SyncDoubt.OLDER_THAN_MOVE,
    SyncDoubt.NOT_TRACKING,
    SyncDoubt.ODDS,
    SyncDoubt.FEW_STARS,
    SyncDoubt.PARITY,
    SyncDoubt.SCALE,
    SyncDoubt.ROTATION,
    SyncDoubt.TOO_FAR,
    SyncDoubt.NOT_EXPECTED,
    SyncDoubt.WRONG_SIDE,
    SyncDoubt.TOO_LOW,
    SyncDoubt.NEAR_POLE,
    SyncDoubt.NEAR_MERIDIAN,
    SyncDoubt.TOO_OLD,
    SyncDoubt.POLICY_NEVER,
    SyncDoubt.NOT_FIRST,
    SyncDoubt.SAME_TARGET,
    SyncDoubt.NOT_OFF_ENOUGH,
    SyncDoubt.TOO_MANY,
)

AGAINST_THE_LOOK = frozenset(GRAVEST_FIRST[:10])
"""With one of these a look isn't good enough for any correction; the others leave an offset open."""

ADVICE: Mapping[SyncDoubt, str] = {
    SyncDoubt.MOVED: "look again when the mount rests; is it tracking? is somebody else moving it?",
    SyncDoubt.OLDER_THAN_MOVE: "look again: this frame shows where the tube pointed before the last order",
    SyncDoubt.NOT_TRACKING: "switch tracking on and look again",
    SyncDoubt.ODDS: "expose longer, or look again: the match is too weak",
    SyncDoubt.FEW_STARS: "expose longer, or choose a richer field",
    SyncDoubt.PARITY: "was a mirror added or taken away? some solves in a row that agree are believed",
    SyncDoubt.SCALE: "was the binning or the optics changed? some solves in a row that agree are believed",
    SyncDoubt.ROTATION: "was the camera turned? some solves in a row that agree are believed",
    SyncDoubt.TOO_FAR: "check the mount's alignment, date, time zone, longitude and epoch; if it is really "
    "that far off, order a recovery, or align it roughly by hand",
    SyncDoubt.NOT_EXPECTED: "look again: two looks that agree are believed in a recovery; did a clutch slip?",
    SyncDoubt.WRONG_SIDE: "compare the side of the pier that the mount tells with where the tube hangs",
    SyncDoubt.TOO_LOW: "sync on a higher field",
    SyncDoubt.NEAR_POLE: "sync on a field further from the pole: there a frame doesn't tell the hour angle",
    SyncDoubt.NEAR_MERIDIAN: "sync on a field further east or west",
    SyncDoubt.TOO_OLD: "look again",
    SyncDoubt.POLICY_NEVER: "the settings say sync.rule = never: correct by offset",
    SyncDoubt.NOT_FIRST: "the settings allow one sync a night: correct by offset",
    SyncDoubt.SAME_TARGET: "the settings allow one sync for each target: correct by offset",
    SyncDoubt.NOT_OFF_ENOUGH: "the mount is right within what the settings ask for: nothing is needed",
    SyncDoubt.TOO_MANY: "correct by offset; why does the mount need so many? backlash, slip, flexure?",
}


@dataclass(frozen=True, slots=True)
class Counts:
    """Syncs that were committed in this night."""

    tonight: int = 0
    on_target: int = 0


@dataclass(frozen=True, slots=True)
class SyncContext:
    """What is known besides the look.

    Attributes
    ----------
    now : datetime
    site, air : Site, Air
    resolution_arcsec : float
        The mount's.
    last_moved_utc : datetime or None
        End of the last order that moved the mount or changed what it believes.
    expected : Expected or None
        Offset that the pointing in force expects there; None if it can't say.
    lost : bool
        The mount's belief says nothing: it is to be recovered.
    polar : bool
        Whether the mount turns about a polar axis.
    trusted : bool
        Whether its own position counts.
    modeled : bool
        Whether that is a pointing model's.
    departures : mapping of SyncDoubt to str
        What the look shows of the camera that those before it didn't.
    counts : Counts
    """

    now: datetime
    site: Site
    air: Air
    resolution_arcsec: float
    last_moved_utc: datetime | None = None
    expected: Expected | None = None
    lost: bool = False
    polar: bool = True
    trusted: bool = True
    modeled: bool = False
    departures: Mapping[SyncDoubt, str] = field(default_factory=dict)
    counts: Counts = field(default_factory=Counts)


Doubts = dict[SyncDoubt, str]


def in_order(doubts: Mapping[SyncDoubt, str]) -> Doubts:
    """The gravest first."""
    return {kind: doubts[kind] for kind in GRAVEST_FIRST if kind in doubts}


def without(doubts: Mapping[SyncDoubt, str], kinds: Iterable[SyncDoubt]) -> Doubts:
    """Leave some out: they are not asked on this occasion."""
    left_out = set(kinds)
    return {kind: words for kind, words in doubts.items() if kind not in left_out}


def frame_doubts(found: Look, policy: SyncPolicy, context: SyncContext) -> Doubts:
    """Whether the mount rested, tracked, and has not been moved since; whether the frame is fresh."""
    doubts: Doubts = {}
    before, after = found.before, found.after
    wandered = separation_arcsec(from_mount(before.place), from_mount(after.place))
    allowed = policy.max_motion_arcsec + context.resolution_arcsec
    if before.slewing or after.slewing:
        doubts[SyncDoubt.MOVED] = "the mount was slewing while the frame was exposed"
    elif not wandered <= allowed:
        doubts[SyncDoubt.MOVED] = (
            f"the mount moved {wandered:.0f}″ while the frame was exposed (allowed {allowed:.0f}″)"
        )
    elif before.pier_side and after.pier_side and before.pier_side is not after.pier_side:
        doubts[SyncDoubt.MOVED] = f"the mount changed sides ({before.pier_side} → {after.pier_side})"
    moved = context.last_moved_utc
    if moved is not None and before.utc < moved:
        doubts[SyncDoubt.OLDER_THAN_MOVE] = (
            f"the frame was begun {(moved - before.utc).total_seconds():.1f} s before the end of the mount's "
            "last order"
        )
    if before.tracking is False or after.tracking is False:
        doubts[SyncDoubt.NOT_TRACKING] = "the mount didn't track: the sky has moved on since the frame"
    age_s = (context.now - after.utc).total_seconds()
    if not -policy.max_age_s <= age_s <= policy.max_age_s:
        doubts[SyncDoubt.TOO_OLD] = f"the frame is {age_s:.0f} s old (allowed {policy.max_age_s:.0f} s)"
    return doubts


def solution_doubts(found: Look, policy: SyncPolicy) -> Doubts:
    """Whether the solution could be chance."""
    doubts: Doubts = {}
    solution = found.solution
    if not solution.false_probability <= policy.max_false_probability:
        doubts[SyncDoubt.ODDS] = (
            f"a wrong place would look as good with a chance of {solution.false_probability:.1e} "
            f"(allowed {policy.max_false_probability:.0e})"
        )
    if solution.pairs < policy.min_pairs:
        doubts[SyncDoubt.FEW_STARS] = f"{solution.pairs} stars identified, {policy.min_pairs} are needed"
    return doubts


def place_doubts(found: Look, policy: SyncPolicy, context: SyncContext) -> Doubts:
    """Whether the mount can be that far off, and whether the place is one to sync at."""
    doubts: Doubts = {}
    words = too_far(found.offset, policy.max_arcsec)
    if words is not None:
        doubts[SyncDoubt.TOO_FAR] = words
    surprise, allowed = surprise_arcsec(found, policy, context)
    if context.trusted and surprise is not None and not surprise <= allowed:
        assert context.expected is not None
        expected, by = context.expected.offset, "the model" if context.modeled else "the last sync"
        doubts[SyncDoubt.NOT_EXPECTED] = (
            f"{surprise:.0f}″ from the offset to be expected by {by} ({expected.east_arcsec:+.0f}″ east, "
            f"{expected.north_arcsec:+.0f}″ north, sigma {context.expected.sigma_arcsec:.0f}″; "
            f"allowed {allowed:.0f}″)"
        )
    hour_angle = icrs_to_hour_angle(found.seen, found.mid_exposure_utc, context.site, context.air)
    altitude_deg = hour_angle_to_observed(hour_angle, context.site).alt_deg
    if altitude_deg < policy.min_altitude_deg:
        doubts[SyncDoubt.TOO_LOW] = (
            f"the solved place stands at altitude {altitude_deg:.1f}° (allowed {policy.min_altitude_deg:g}°)"
        )
    near_pole = _near_pole(found, hour_angle.dec_deg, policy, context)
    if near_pole is not None:
        doubts[SyncDoubt.NEAR_POLE] = near_pole
    from_meridian_deg = min(abs(hour_angle.ha_deg), 180.0 - abs(hour_angle.ha_deg))
    if from_meridian_deg < policy.min_meridian_deg:
        doubts[SyncDoubt.NEAR_MERIDIAN] = (
            f"{from_meridian_deg:.2f}° of hour angle from the meridian (allowed {policy.min_meridian_deg:g}°)"
        )
    return doubts


def _near_pole(found: Look, dec_deg: float, policy: SyncPolicy, context: SyncContext) -> str | None:
    """Why a sync there would put the hour angle of the whole sky wrong; None if it wouldn't.

    A pole that is off by ρ shows as an offset of ρ to the east at any declination. A sync takes it for an
    hour angle of ρ / cos δ, and so much the rest of the sky is turned.
    """
    if not context.polar:
        return None
    away_deg, cos = 90.0 - abs(dec_deg), math.cos(math.radians(dec_deg))
    if away_deg < policy.min_pole_deg:
        return (
            f"{away_deg:.1f}° from the pole, which tells no hour angle ({policy.min_pole_deg:g}° are needed)"
        )
    east = abs(found.offset.east_arcsec)
    turned = east / cos - east if cos > 0.0 else math.inf
    if not context.lost and turned > policy.max_turn_arcsec:
        return (
            f"{east:.0f}″ to the east would turn the hour angle by {east / cos:.0f}″ at declination "
            f"{dec_deg:.0f}° ({policy.max_turn_arcsec:.0f}″ more than what is seen are allowed)"
        )
    return None


def surprise_arcsec(found: Look, policy: SyncPolicy, context: SyncContext) -> tuple[float | None, float]:
    """How far the offset is from the expected one, and how far it may be: so many sigma, and a floor.

    Returns
    -------
    surprise_arcsec : float or None
        None where nothing is expected.
    allowed_arcsec : float
    """
    expected = context.expected
    if expected is None:
        return None, math.inf
    solve = found.solution.center_sigma_arcsec
    sigma = math.hypot(
        expected.sigma_arcsec, context.resolution_arcsec, solve if math.isfinite(solve) else 0.0
    )
    floor = policy.expected_floor_arcsec if context.modeled else policy.expected_floor_bare_arcsec
    off = math.hypot(
        found.offset.east_arcsec - expected.offset.east_arcsec,
        found.offset.north_arcsec - expected.offset.north_arcsec,
    )
    return off, policy.expected_sigmas * sigma + floor


def policy_doubts(found: Look, policy: SyncPolicy, context: SyncContext) -> Doubts:
    """Whether the rule and the caps on the number let this sync through."""
    doubts: Doubts = {}
    counts, off = context.counts, found.offset.total_arcsec
    match policy.rule:
        case SyncRule.NEVER:
            doubts[SyncDoubt.POLICY_NEVER] = "the settings never sync"
        case SyncRule.FIRST_OF_NIGHT if counts.tonight:
            doubts[SyncDoubt.NOT_FIRST] = f"{counts.tonight} sync(s) were committed in this night"
        case SyncRule.PER_TARGET if counts.on_target:
            doubts[SyncDoubt.SAME_TARGET] = f"this target had {counts.on_target} sync(s) in this night"
        case SyncRule.WHEN_OFF_BY:
            least = max(policy.off_by_arcsec, context.resolution_arcsec)
            if off < least:
                doubts[SyncDoubt.NOT_OFF_ENOUGH] = f"{off:.1f}″ off, less than {least:.1f}″"
    for count, most, of in (
        (counts.tonight, policy.max_per_night, "in this night"),
        (counts.on_target, policy.max_per_target, "on this target"),
    ):
        if most is not None and count >= most:
            doubts[SyncDoubt.TOO_MANY] = f"{count} sync(s) {of} (allowed {most})"
    return doubts


__all__ = [
    "ADVICE",
    "AGAINST_THE_LOOK",
    "GRAVEST_FIRST",
    "Counts",
    "Doubts",
    "SyncContext",
    "frame_doubts",
    "in_order",
    "place_doubts",
    "policy_doubts",
    "solution_doubts",
    "surprise_arcsec",
    "without",
]
