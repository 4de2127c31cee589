"""Who judges a look: what is known of the mount, the camera, the pointing and the night, put together."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta

from mountnav.clock import Clock
from mountnav.devices import MountReading, for_mount, from_mount
from mountnav.errors import ModelRefused, SyncDoubt
from mountnav.mount import CheckedMount
from mountnav.navigation.camera import CameraSample, camera_sample
from mountnav.navigation.learned import Learned
from mountnav.navigation.reports import CameraIdentity, Look
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.navigation.sync_trigger import SyncDecision, SyncTrigger, decided
from mountnav.navigation.vetoes import (
    AGAINST_THE_LOOK,
    Claim,
    Counts,
    SyncContext,
    Vetoes,
    claimed,
    frame_vetoes,
    in_order,
    place_vetoes,
    policy_vetoes,
    solution_vetoes,
    to_be_confirmed,
    without,
)
from mountnav.pointing.model.in_force import Expected, Pointing
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.sky.sphere import separation_arcsec

__all__ = ["Judge", "SyncCounts", "all_vetoes", "decide", "night_of"]


def night_of(utc: datetime, site: Site) -> str:
    """The date on which the night began, by mean solar time of the site: 2026-11-21 until the next noon."""
    local = utc.astimezone(UTC) + timedelta(hours=site.longitude_deg / 15.0 - 12.0)
    return local.date().isoformat()


@dataclass(frozen=True, slots=True)
class _Counted:
    night: str
    target: str | None
    place: Icrs


class SyncCounts:
    """Counts committed syncs of the present night.

    Parameters
    ----------
    same_target_deg : float
        Targets without a name are told apart by their place.
    """

    def __init__(self, site: Site, same_target_deg: float) -> None:
        self._site = site
        self._same_target_deg = same_target_deg
        self._counted: list[_Counted] = []

    def add(self, utc: datetime, target: str | None, place: Icrs) -> None:
        """Count one; those of other nights are forgotten."""
        night = night_of(utc, self._site)
        self._counted = [sync for sync in self._counted if sync.night == night]
        self._counted.append(_Counted(night, target, place))

    def at(self, utc: datetime, target: str | None, place: Icrs) -> Counts:
        """How many there were in the night of `utc`, and for a target."""
        night = night_of(utc, self._site)
        tonight = [sync for sync in self._counted if sync.night == night]
        return Counts(len(tonight), sum(self._same(sync, target, place) for sync in tonight))

    def _same(self, one: _Counted, target: str | None, place: Icrs) -> bool:
        if one.target is not None and target is not None:
            return one.target == target
        return separation_arcsec(one.place, place) <= self._same_target_deg * 3600.0


@dataclass(slots=True)
class Judge:
    """Judges looks; sends and writes nothing.

    Attributes
    ----------
    moved_utc : datetime or None
        End of the last order that moved the mount, as far as the mount doesn't know it itself.
    camera : str
        Whose `learned` is: the one that looks; empty until a frame has shown it.
    others : dict of str to Learned
        What is known of other cameras on the same mount, those of frames from outside.
    """

    mount: CheckedMount
    policy: SyncPolicy
    learned: Learned
    pointing: Pointing
    clock: Clock
    counts: SyncCounts
    moved_utc: datetime | None = field(default=None)
    camera: str = ""
    others: dict[str, Learned] = field(default_factory=dict)

    @property
    def site(self) -> Site:
        """Where the mount stands."""
        return self.mount.site

    @property
    def air(self) -> Air:
        """The air there."""
        return self.mount.air

    def looks_through(self, camera: CameraIdentity) -> None:
        """Let `learned` be what is known of the camera that looks: each has its own, by its binning too."""
        key = str(camera)
        if self.camera not in ("", key):
            self.others[self.camera] = self.learned
            self.learned = self.others.pop(key) if key in self.others else self.learned.of_another()
        self.camera = key

    def learned_of(self, found: Look) -> Learned:
        """What is known of the camera of a look."""
        if found.camera is None:
            return self.learned
        key = str(found.camera)
        self.camera = self.camera or key
        if key == self.camera:
            return self.learned
        if key not in self.others:
            self.others[key] = self.learned.of_another()
        return self.others[key]

    def note_move(self, utc: datetime) -> None:
        """Frames that were begun before `utc` don't count any more."""
        self.moved_utc = utc if self.moved_utc is None else max(utc, self.moved_utc)

    def sample(self, found: Look, *, lost: bool = False) -> CameraSample:
        """What a look shows of the camera."""
        return camera_sample(found, self.site, self.air, self.learned.rules.mounting, lost=lost)

    def context(self, found: Look, trigger: SyncTrigger, target: str | None = None) -> SyncContext:
        """What is known besides a look."""
        sample = self.sample(found, lost=trigger.lost)
        return replace(
            self.surroundings(claimed(found), target),
            expected=self._expected(found),
            lost=trigger.lost,
            departures=self.learned_of(found).departures(sample),
        )

    def surroundings(self, claim: Claim, target: str | None = None) -> SyncContext:
        """What is known besides what somebody says of a place, camera and expectation left out."""
        now = self.clock.utc()
        ended = [utc for utc in (self.moved_utc, self.mount.last_motion_utc) if utc is not None]
        return SyncContext(
            now=now,
            site=self.site,
            air=self.air,
            resolution_arcsec=self.mount.resolution_arcsec,
            last_moved_utc=max(ended, default=None),
            polar=self.learned.rules.mounting != "altaz",
            trusted=self.mount.trusted,
            modeled=self.pointing.model_id is not None,
            counts=self.counts.at(now, target, claim.seen),
        )

    def _expected(self, found: Look) -> Expected | None:
        # at the believed place: a false solution must not choose where it is judged
        try:
            return self.pointing.expected(found.believed, found.mid_exposure_utc, found.after.side)
        except ModelRefused:
            return None

    def consider(self, found: Look, trigger: SyncTrigger, target: str | None = None) -> SyncDecision:
        """Whether a look is synced on, by what is known now."""
        return decide(found, trigger, self.policy, self.context(found, trigger, target))

    def vetoes(self, found: Look, context: SyncContext) -> Vetoes:
        """All that stands against a look, the policy's rule left out."""
        return all_vetoes(found, self.policy, context)

    def no_good(self, found: Look) -> tuple[SyncDoubt, str] | None:
        """The gravest doubt about a look by itself, wherever the mount believes to be."""
        vetoes = self.vetoes(found, self.context(found, SyncTrigger.RECOVERY))
        for kind, words in in_order(without(vetoes, SyncTrigger.RECOVERY.not_asked)).items():
            if kind in AGAINST_THE_LOOK:
                return kind, words
        return None

    def needs_second_look(self, found: Look, context: SyncContext) -> bool:
        """Whether what is known is too little to believe one look alone."""
        judged = self.learned_of(found).judges_rotation(self.sample(found))
        return to_be_confirmed(found, self.policy, context, judged)

    def unmoved(self, found: Look, now: MountReading) -> SyncDecision:
        """Whether the mount still believes to be where it was when the frame was exposed."""
        since = separation_arcsec(from_mount(now.place), found.believed)
        allowed = self.policy.max_motion_arcsec + self.mount.resolution_arcsec
        vetoes: Vetoes = {}
        if now.slewing or not since <= allowed:
            vetoes[SyncDoubt.MOVED] = (
                f"the mount moved {since:.0f}″ between the frame and the sync (allowed {allowed:.0f}″)"
            )
        return decided(vetoes, found)

    def observation(self, found: Look) -> PointingObservation:
        """A look of the present segment, as the pointing takes it."""
        return PointingObservation(
            utc=found.mid_exposure_utc,
            seen=found.seen,
            sigma_arcsec=found.sigma_arcsec,
            reading=for_mount(found.believed, self.mount.epoch, found.mid_exposure_utc),
            side=found.after.side,
            segment_id=self.mount.segment_id,
            air=self.air,
            rotation_deg=found.solution.rotation_deg,
            scale_arcsec_px=found.solution.scale_arcsec_px,
            parity=found.solution.parity,
            model_id=self.pointing.model_id,
            look_id=found.look_id,
        )


def decide(found: Look, trigger: SyncTrigger, policy: SyncPolicy, context: SyncContext) -> SyncDecision:
    """Whether a look is synced on: a function of its values, so that it can be judged again."""
    vetoes = all_vetoes(found, policy, context)
    if trigger.by_rule:
        vetoes |= policy_vetoes(found, policy, context)
        if not context.trusted:
            # one look must not make it count again
            vetoes[SyncDoubt.NOT_EXPECTED] = "the mount's position is not trusted: it needs a recovery"
    return decided(without(vetoes, trigger.not_asked), found, context)


def all_vetoes(found: Look, policy: SyncPolicy, context: SyncContext) -> Vetoes:
    """All that stands against a look, the policy's rule left out."""
    return {
        **frame_vetoes(found, policy, context),
        **solution_vetoes(found, policy),
        **context.departures,
        **place_vetoes(claimed(found), policy, context),
    }
