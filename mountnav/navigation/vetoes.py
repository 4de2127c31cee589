"""What stands against a sync: a look and what is known besides, in; named vetoes with their numbers, out.

Pure functions: nothing here asks a mount, a clock or a disk. `ConfirmingLooks` finds the second look that a
sync needs where nothing known can judge the first; `SurprisingLooks` counts those that nobody expected: one
is a false solution, three that agree are a clutch that slipped.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime

from mountnav.errors import SyncDoubt
from mountnav.navigation.reports import Look
from mountnav.navigation.sync_policy import SyncPolicy, SyncRule
from mountnav.pointing.model.in_force import Expected
from mountnav.pointing.offset import too_far
from mountnav.sky.chain import hour_angle_to_observed, icrs_to_hour_angle
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import Offset, displaced, half_turn_deg, offset_arcsec, separation_arcsec

__all__ = [
    "ADVICE",
    "AGAINST_THE_LOOK",
    "GRAVEST_FIRST",
    "Claim",
    "ConfirmingLooks",
    "Counts",
    "SurprisingLooks",
    "SyncContext",
    "Vetoes",
    "apart_arcsec",
    "claimed",
    "disagreement",
    "frame_vetoes",
    "in_order",
    "place_vetoes",
    "policy_vetoes",
    "solution_vetoes",
    "surprise_arcsec",
    "to_be_confirmed",
    "without",
]


GRAVEST_FIRST = (
    SyncDoubt.MOVED,
    SyncDoubt.OLDER_THAN_MOVE,
    SyncDoubt.NOT_FRESH,
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
    SyncDoubt.TOLD_TOO_MUCH,
    SyncDoubt.NEAR_MERIDIAN,
    SyncDoubt.TOO_OLD,
    SyncDoubt.UNSURE,
    SyncDoubt.POLICY_NEVER,
    SyncDoubt.NOT_FIRST,
    SyncDoubt.SAME_TARGET,
    SyncDoubt.NOT_OFF_ENOUGH,
    SyncDoubt.TOO_MANY,
)

AGAINST_THE_LOOK = frozenset(GRAVEST_FIRST[:11])
"""With one of these a look isn't good enough for any correction; the others leave an offset open."""

ADVICE: Mapping[SyncDoubt, str] = {
    SyncDoubt.MOVED: "look again when the mount rests; is it tracking? is somebody else moving it?",
    SyncDoubt.OLDER_THAN_MOVE: "look again: this frame shows where the tube pointed before the last order",
    SyncDoubt.NOT_FRESH: "look again: two frames of one place that agree are believed; does the camera "
    "hand out the frame before?",
    SyncDoubt.NOT_TRACKING: "switch tracking on and look again",
    SyncDoubt.ODDS: "expose longer, or look again: the match is too weak",
    SyncDoubt.FEW_STARS: "expose longer, or choose a richer field",
    SyncDoubt.PARITY: "was a mirror added or taken away? some solves in a row that agree are believed",
    SyncDoubt.SCALE: "was the binning or the optics changed? some solves in a row that agree are believed",
    SyncDoubt.ROTATION: "was the camera turned? some solves in a row that agree are believed",
    SyncDoubt.TOO_FAR: "check the mount's date, time zone, longitude and epoch; if it is really that "
    "far off, as after it was set up again, order first light",
    SyncDoubt.NOT_EXPECTED: "look again: two looks that agree are believed in a recovery; did a clutch slip?",
    SyncDoubt.WRONG_SIDE: "compare the side of the pier that the mount reports with where the tube is: set "
    "swap_sides of the mount if it is the other one; if it is right, order first light",
    SyncDoubt.TOO_LOW: "sync on a higher field",
    SyncDoubt.NEAR_POLE: "sync on a field further from the pole: there a frame does not show the hour angle",
    SyncDoubt.TOLD_TOO_MUCH: "let it look (sync), let it find its home, or say trust",
    SyncDoubt.NEAR_MERIDIAN: "sync on a field further east or west",
    SyncDoubt.TOO_OLD: "look again",
    SyncDoubt.UNSURE: "look again with a shorter exposure, when the mount tracks and the tube keeps still; "
    "or ask for a larger tolerance",
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
class Claim:
    """Where the tube points by a frame or by given coordinates, and where the mount believes it.

    Attributes
    ----------
    utc : datetime
        For both.
    sigma_arcsec : float
        Of `offset`; 0 where nobody knows.
    told : bool
        Nobody has looked.
    """

    seen: Icrs
    believed: Icrs
    utc: datetime
    sigma_arcsec: float = 0.0
    told: bool = False

    @property
    def offset(self) -> Offset:
        """Seen minus believed."""
        return offset_arcsec(self.seen, self.believed)


def claimed(found: Look) -> Claim:
    """What a solved frame says."""
    return Claim(found.seen, found.believed, found.mid_exposure_utc, found.sigma_arcsec)


@dataclass(frozen=True, slots=True)
class SyncContext:
    """What is known besides the look.

    Attributes
    ----------
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
    expected_by : str
        Who expects it, if it is neither a model nor the last sync.
    departures : mapping of SyncDoubt to str
        What the look shows of the camera that those before it didn't.
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
    expected_by: str = ""
    departures: Mapping[SyncDoubt, str] = field(default_factory=dict)
    counts: Counts = field(default_factory=Counts)


Vetoes = dict[SyncDoubt, str]


def in_order(vetoes: Mapping[SyncDoubt, str]) -> Vetoes:
    """The gravest first."""
    return {kind: vetoes[kind] for kind in GRAVEST_FIRST if kind in vetoes}


def without(vetoes: Mapping[SyncDoubt, str], kinds: Iterable[SyncDoubt]) -> Vetoes:
    """Leave some out: they are not asked on this occasion."""
    left_out = set(kinds)
    return {kind: words for kind, words in vetoes.items() if kind not in left_out}


def frame_vetoes(found: Look, policy: SyncPolicy, context: SyncContext) -> Vetoes:
    """Whether the mount rested, tracked, and has not been moved since; whether the frame is fresh."""
    vetoes: Vetoes = {}
    before, after = found.before, found.after
    wandered = found.mount_moved_arcsec
    allowed = policy.max_motion_arcsec + context.resolution_arcsec
    if before.slewing or after.slewing:
        vetoes[SyncDoubt.MOVED] = "the mount was slewing while the frame was exposed"
    elif not wandered <= allowed:
        vetoes[SyncDoubt.MOVED] = (
            f"the mount moved {wandered:.0f}″ while the frame was exposed (allowed {allowed:.0f}″)"
        )
    elif not found.sky_moved_arcsec <= allowed:
        # the solution is the middle: the tube stands at either end now
        vetoes[SyncDoubt.MOVED] = (
            f"the sky moved {found.sky_moved_arcsec:.0f}″ in the frame while it was exposed "
            f"(allowed {allowed:.0f}″)"
        )
    elif before.pier_side and after.pier_side and before.pier_side is not after.pier_side:
        vetoes[SyncDoubt.MOVED] = f"the mount changed sides ({before.pier_side} → {after.pier_side})"
    unsure = _unsure(found, policy, context)
    if unsure and SyncDoubt.MOVED not in vetoes:
        vetoes[SyncDoubt.UNSURE] = unsure
    moved = context.last_moved_utc
    if moved is not None and before.utc < moved:
        vetoes[SyncDoubt.OLDER_THAN_MOVE] = (
            f"the frame was begun {(moved - before.utc).total_seconds():.1f} s before the end of the mount's "
            "last order"
        )
    if before.tracking is False or after.tracking is False:
        vetoes[SyncDoubt.NOT_TRACKING] = "the mount didn't track: the sky has moved on since the frame"
    age_s = (context.now - after.utc).total_seconds()
    if not -policy.max_age_s <= age_s <= policy.max_age_s:
        vetoes[SyncDoubt.TOO_OLD] = f"the frame is {age_s:.0f} s old (allowed {policy.max_age_s:.0f} s)"
    return vetoes


def _unsure(found: Look, policy: SyncPolicy, context: SyncContext) -> str:
    """Why a look shows the offset too badly for a sync that is to serve its work; empty if it doesn't.

    A sync puts the zero points where the look says, for all that comes after; a slew that corrects by the
    same look is looked at again.
    """
    allowed = min(policy.max_motion_arcsec, found.tolerance_arcsec) + context.resolution_arcsec
    for who, moved in (("mount", found.mount_moved_arcsec), ("sky", found.sky_moved_arcsec)):
        if not moved <= allowed:
            return f"the {who} moved {moved:.0f}″ during the exposure, and {allowed:.0f}″ are asked for"
    if not found.sigma_arcsec <= allowed:
        return (
            f"how far off it is is only known to {found.sigma_arcsec:.0f}″, and {allowed:.0f}″ are asked for"
        )
    return ""


def solution_vetoes(found: Look, policy: SyncPolicy) -> Vetoes:
    """Whether the solution could be chance."""
    vetoes: Vetoes = {}
    solution = found.solution
    if not solution.false_probability <= policy.max_false_probability:
        vetoes[SyncDoubt.ODDS] = (
            f"a wrong position would look as good with a probability of {solution.false_probability:.1e} "
            f"(allowed {policy.max_false_probability:.0e})"
        )
    if solution.pairs < policy.min_pairs:
        vetoes[SyncDoubt.FEW_STARS] = f"{solution.pairs} stars identified, {policy.min_pairs} are needed"
    return vetoes


def place_vetoes(claim: Claim, policy: SyncPolicy, context: SyncContext) -> Vetoes:
    """Whether the mount can be that far off, and whether the place is one to sync at."""
    vetoes: Vetoes = {}
    words = _too_far(claim, policy)
    if words is not None:
        vetoes[SyncDoubt.TOO_FAR] = words
        if not math.isfinite(claim.offset.total_arcsec):
            # no place at all: it stands nowhere in the sky
            return vetoes
    surprise, allowed = surprise_arcsec(claim, policy, context)
    if context.trusted and surprise is not None and not surprise <= allowed:
        assert context.expected is not None
        by = context.expected_by or ("the model" if context.modeled else "the last sync")
        expected = context.expected.offset
        vetoes[SyncDoubt.NOT_EXPECTED] = (
            f"{surprise:.0f}″ from the offset to be expected by {by} ({expected.east_arcsec:+.0f}″ east, "
            f"{expected.north_arcsec:+.0f}″ north, sigma {context.expected.sigma_arcsec:.0f}″; "
            f"allowed {allowed:.0f}″)"
        )
    hour_angle = icrs_to_hour_angle(claim.seen, claim.utc, context.site, context.air)
    altitude_deg = hour_angle_to_observed(hour_angle, context.site).alt_deg
    if not altitude_deg >= policy.min_altitude_deg:
        vetoes[SyncDoubt.TOO_LOW] = (
            f"the {_said(claim)} place stands at altitude {altitude_deg:.1f}° (allowed "
            f"{policy.min_altitude_deg:g}°)"
        )
    near_pole = _near_pole(claim, hour_angle, policy, context)
    if near_pole is not None:
        vetoes[SyncDoubt.NEAR_POLE] = near_pole
    from_meridian_deg = min(abs(hour_angle.ha_deg), 180.0 - abs(hour_angle.ha_deg))
    if from_meridian_deg < policy.min_meridian_deg:
        vetoes[SyncDoubt.NEAR_MERIDIAN] = (
            f"{from_meridian_deg:.2f}° of hour angle from the meridian (allowed {policy.min_meridian_deg:g}°)"
        )
    return vetoes


def _said(claim: Claim) -> str:
    return "told" if claim.told else "solved"


def _too_far(claim: Claim, policy: SyncPolicy) -> str | None:
    if not claim.told:
        return too_far(claim.offset, policy.max_arcsec)
    off_arcsec = claim.offset.total_arcsec
    if off_arcsec <= policy.told_max_arcsec:
        return None
    return (
        f"stated {off_arcsec / 3600.0:.2f}° from where it believes it points, more than the "
        f"{policy.told_max_arcsec / 3600.0:.2f}° that a sync on coordinates may move it"
    )


def _near_pole(claim: Claim, seen: HourAngle, policy: SyncPolicy, context: SyncContext) -> str | None:
    """Why a sync there would put the hour angle of the whole sky wrong; None if it wouldn't.

    A pole that is off by ρ shows as an offset of ρ to the east at any declination. A sync takes it for an
    hour angle of ρ / cos δ, and so much the rest of the sky is turned.
    """
    if not context.polar:
        return None
    away_deg = 90.0 - abs(seen.dec_deg)
    if away_deg < policy.min_pole_deg:
        return (
            f"{away_deg:.1f}° from the pole, too near to show the hour angle "
            f"({policy.min_pole_deg:g}° are needed)"
        )
    if context.lost:
        return None
    believed = icrs_to_hour_angle(claim.believed, claim.utc, context.site, context.air)
    # what the mount does with it: its hour angle axis gets a new zero
    turned = abs(half_turn_deg(seen.ha_deg - believed.ha_deg)) * 3600.0
    east = abs(claim.offset.east_arcsec)
    if not turned - east <= policy.max_turn_arcsec:
        return (
            f"{east:.0f}″ to the east would turn the hour angle by {turned:.0f}″ at declination "
            f"{seen.dec_deg:.0f}° ({policy.max_turn_arcsec:.0f}″ more than what is {_said(claim)} "
            "are allowed)"
        )
    return None


def surprise_arcsec(claim: Claim, policy: SyncPolicy, context: SyncContext) -> tuple[float | None, float]:
    """How far the offset is from the expected one, and how far it may be: so many sigma, and a floor.

    Returns
    -------
    surprise_arcsec : float or None
        None where nothing is expected.
    """
    expected = context.expected
    if expected is None:
        return None, math.inf
    own = claim.sigma_arcsec
    sigma = math.hypot(expected.sigma_arcsec, context.resolution_arcsec, own if math.isfinite(own) else 0.0)
    floor = policy.expected_floor_arcsec if context.modeled else policy.expected_floor_bare_arcsec
    offset = claim.offset
    off = math.hypot(
        offset.east_arcsec - expected.offset.east_arcsec,
        offset.north_arcsec - expected.offset.north_arcsec,
    )
    return off, policy.expected_sigmas * sigma + floor


def policy_vetoes(found: Look, policy: SyncPolicy, context: SyncContext) -> Vetoes:
    """Whether the rule and the caps on the number let this sync through."""
    vetoes: Vetoes = {}
    counts, off = context.counts, found.offset.total_arcsec
    match policy.rule:
        case SyncRule.NEVER:
            vetoes[SyncDoubt.POLICY_NEVER] = "the settings never sync"
        case SyncRule.FIRST_OF_NIGHT if counts.tonight:
            vetoes[SyncDoubt.NOT_FIRST] = f"{counts.tonight} sync(s) were committed in this night"
        case SyncRule.PER_TARGET if counts.on_target:
            vetoes[SyncDoubt.SAME_TARGET] = f"this target had {counts.on_target} sync(s) in this night"
        case SyncRule.WHEN_OFF_BY:
            own = found.sigma_arcsec
            # an offset within its own error is none
            least = max(policy.off_by_arcsec, context.resolution_arcsec, own if math.isfinite(own) else 0.0)
            if off < least:
                vetoes[SyncDoubt.NOT_OFF_ENOUGH] = f"{off:.1f}″ off, less than {least:.1f}″"
    for count, most, of in (
        (counts.tonight, policy.max_per_night, "in this night"),
        (counts.on_target, policy.max_per_target, "on this target"),
    ):
        if most is not None and count >= most:
            vetoes[SyncDoubt.TOO_MANY] = f"{count} sync(s) {of} (allowed {most})"
    return vetoes


_NEAR_DEG = 5.0
"""So near in the sky another look shows the same offset, °: what one sync leaves over within 5° is 7″ for
nine of ten [POINTING §4], within 10° 19″. Doubled, looks that are right would seem to disagree."""
_KEPT = 3
"""So many earlier looks may confirm one. Chosen by hand. Halved to one, a false look in between hides the one
that would agree."""


class ConfirmingLooks:
    """The last looks of the present segment, as they were learned from."""

    def __init__(self) -> None:
        self._looks: deque[Look] = deque(maxlen=_KEPT)

    def add(self, found: Look) -> None:
        """Keep a look that nothing but its place stands against."""
        self._looks.append(found)

    def forget(self) -> None:
        """Forget all: the zero points are others."""
        self._looks.clear()

    def for_look(self, found: Look, policy: SyncPolicy, resolution_arcsec: float) -> Look | None:
        """An earlier look, of this segment and near in the sky, that shows the same offset."""
        for other in reversed(self._looks):
            if other.mid_exposure_utc >= found.mid_exposure_utc:
                continue
            if separation_arcsec(other.believed, found.believed) > _NEAR_DEG * 3600.0:
                continue
            if apart_arcsec(other, found) <= policy.max_motion_arcsec + resolution_arcsec:
                return other
        return None


def to_be_confirmed(found: Look, policy: SyncPolicy, context: SyncContext, rotation_judged: bool) -> bool:
    """Whether a look needs a second one: it is far off, and what is known doesn't say whether it may be.

    Parameters
    ----------
    rotation_judged : bool
        Whether the camera's angle is known, and means something at that place.
    """
    if not policy.confirm:
        return False
    surprise, allowed = surprise_arcsec(claimed(found), policy, context)
    if surprise is None:
        surprise = found.offset.total_arcsec
    if surprise <= policy.confirm_above_arcsec:
        return False
    return not rotation_judged or allowed >= 0.5 * policy.max_arcsec


def disagreement(first: Look, again: Look, policy: SyncPolicy, resolution_arcsec: float) -> str | None:
    """Tell in words why a second look doesn't confirm the first one; None if it does."""
    if again.look_id == first.look_id or again.mid_exposure_utc <= first.mid_exposure_utc:
        return "the confirming look was not taken after the first one"
    allowed = policy.max_motion_arcsec + resolution_arcsec
    apart = apart_arcsec(first, again)
    if apart <= allowed:
        return None
    return f"two frames, one after the other, were solved {apart:.0f}″ apart (allowed {allowed:.0f}″)"


def apart_arcsec(first: Look, again: Look) -> float:
    """Distance between the solved places of two looks, the mount's own motion taken off."""
    motion = offset_arcsec(again.believed, first.believed)
    return separation_arcsec(again.seen, displaced(first.seen, motion.east_arcsec, motion.north_arcsec))


_IN_A_ROW = 3
"""So many looks that agree with each other and with nothing expected mean other zero points. Chosen by
hand: two false solutions of one field may agree. Doubled, a slip costs a centering most of its tries."""
_SHARE = 0.25
"""A slip of one axis shows differently at different declinations: so much of it may the looks differ. Chosen
by hand. Doubled, three false solutions agree more easily."""


class SurprisingLooks:
    """Remembers by how much the last looks were not what was expected."""

    def __init__(self) -> None:
        self._surprises: list[tuple[str, float, float]] = []

    def forget(self) -> None:
        """Forget all: a look was as expected, or the zero points are others."""
        self._surprises = []

    def agree(self, found: Look, expected: Offset, floor_arcsec: float) -> bool:
        """Add a look; whether it and those just before it agree on where the tube is instead."""
        east = found.offset.east_arcsec - expected.east_arcsec
        north = found.offset.north_arcsec - expected.north_arcsec
        others = [surprise for surprise in self._surprises if surprise[0] != found.look_id]
        self._surprises = [*others, (found.look_id, east, north)][-_IN_A_ROW:]
        if len(self._surprises) < _IN_A_ROW:
            return False
        allowed = max(floor_arcsec, _SHARE * math.hypot(east, north))
        return all(
            math.hypot(surprise[1] - east, surprise[2] - north) <= allowed for surprise in self._surprises
        )
