"""Who judges a look: what is known of the mount, the camera, the pointing and the night, put together."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime

from mountnav.clock import Clock
from mountnav.errors import ModelRefused, SyncDoubt
from mountnav.navigation.camera_samples import CameraSample, camera_sample
from mountnav.navigation.checked_mount import CheckedMount
from mountnav.navigation.confirming import to_be_confirmed
from mountnav.navigation.devices import MountReading, PierSide
from mountnav.navigation.doubts import (
    AGAINST_THE_LOOK,
    Doubts,
    SyncContext,
    frame_doubts,
    in_order,
    place_doubts,
    policy_doubts,
    solution_doubts,
    without,
)
from mountnav.navigation.kinds import for_mount, from_mount
from mountnav.navigation.learned import Learned
from mountnav.navigation.reports import Look
from mountnav.navigation.sync_counts import SyncCounts
from mountnav.navigation.sync_occasions import Occasion, SyncDecision, decided
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.pointing.in_force import Expected, Pointing
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Air, Site
from mountnav.sky.sphere import separation_arcsec


@dataclass(slots=True)
class Judge:
    """Judges looks; sends and writes nothing.

    Attributes
    ----------
    mount : CheckedMount
    policy : SyncPolicy
    learned : Learned
    pointing : Pointing
    site, air : Site, Air
    clock : Clock
    counts : SyncCounts
    moved_utc : datetime or None
        End of the last order that moved the mount, as far as it was told and the mount doesn't know itself.
    """

    mount: CheckedMount
    policy: SyncPolicy
    learned: Learned
    pointing: Pointing
    site: Site
    air: Air
    clock: Clock
    counts: SyncCounts
    moved_utc: datetime | None = field(default=None)

    def note_move(self, utc: datetime) -> None:
        """Frames that were begun before `utc` don't count any more."""
        self.moved_utc = utc if self.moved_utc is None else max(utc, self.moved_utc)

    def sample(self, found: Look, *, lost: bool = False) -> CameraSample:
        """What a look tells of the camera."""
        return camera_sample(found, self.site, self.air, self.learned.rules.mounting, lost=lost)

    def context(self, found: Look, occasion: Occasion, target: str | None = None) -> SyncContext:
        """What is known besides a look."""
        now = self.clock.utc()
        ended = [one for one in (self.moved_utc, self.mount.last_motion_utc) if one is not None]
        sample = self.sample(found, lost=occasion.lost)
        return SyncContext(
            now=now,
            site=self.site,
            air=self.air,
            resolution_arcsec=self.mount.resolution_arcsec,
            last_moved_utc=max(ended, default=None),
            expected=self._expected(found),
            lost=occasion.lost,
            polar=self.learned.rules.mounting != "altaz",
            trusted=self.mount.trusted,
            modeled=self.pointing.model_id is not None,
            departures=self.learned.departures(sample),
            counts=self.counts.at(now, target, found.seen),
        )

    def _expected(self, found: Look) -> Expected | None:
        # at the believed place: a false solution must not choose where it is judged
        try:
            return self.pointing.expected(found.believed, found.mid_exposure_utc, side_of(found.after))
        except ModelRefused:
            return None

    def decide(self, found: Look, occasion: Occasion, context: SyncContext) -> SyncDecision:
        """Whether a look is synced on."""
        doubts = self.doubts(found, context)
        if occasion.by_rule:
            doubts |= policy_doubts(found, self.policy, context)
            if not context.trusted:
                # one look must not make it count again
                doubts[SyncDoubt.NOT_EXPECTED] = "the mount's position doesn't count: it needs a recovery"
        return decided(without(doubts, occasion.not_asked), found)

    def doubts(self, found: Look, context: SyncContext) -> Doubts:
        """All that stands against a look, the policy's rule left out."""
        return {
            **frame_doubts(found, self.policy, context),
            **solution_doubts(found, self.policy),
            **context.departures,
            **place_doubts(found, self.policy, context),
        }

    def no_good(self, found: Look) -> tuple[SyncDoubt, str] | None:
        """The gravest doubt about a look by itself, wherever the mount believes to be."""
        doubts = self.doubts(found, self.context(found, Occasion.RECOVERY))
        for kind, words in in_order(without(doubts, Occasion.RECOVERY.not_asked)).items():
            if kind in AGAINST_THE_LOOK:
                return kind, words
        return None

    def needs_second_look(self, found: Look, context: SyncContext) -> bool:
        """Whether what is known is too little to believe one look alone."""
        judged = self.learned.judges_rotation(self.sample(found))
        return to_be_confirmed(found, self.policy, context, judged)

    def unmoved(self, found: Look, now: MountReading) -> SyncDecision:
        """Whether the mount still believes to be where it was when the frame was exposed."""
        since = separation_arcsec(from_mount(now.place), found.believed)
        allowed = self.policy.max_motion_arcsec + self.mount.resolution_arcsec
        doubts: Doubts = {}
        if now.slewing or not since <= allowed:
            doubts[SyncDoubt.MOVED] = (
                f"the mount moved {since:.0f}″ between the frame and the sync (allowed {allowed:.0f}″)"
            )
        return decided(doubts, found)

    def observation(self, found: Look) -> PointingObservation:
        """A look of the present segment, as the pointing takes it."""
        return PointingObservation(
            utc=found.mid_exposure_utc,
            seen=found.seen,
            sigma_arcsec=found.solution.center_sigma_arcsec,
            reading=for_mount(found.believed, self.mount.epoch, found.mid_exposure_utc),
            side=side_of(found.after),
            segment_id=self.mount.segment_id,
            air=self.air,
            rotation_deg=found.solution.rotation_deg,
            scale_arcsec_px=found.solution.scale_arcsec_px,
            parity=found.solution.parity,
            model_id=self.pointing.model_id,
            look_id=found.look_id,
        )


def side_of(reading: MountReading) -> PierSide:
    """The side that a mount tells."""
    return reading.pier_side or PierSide.UNKNOWN


__all__ = ["Judge", "side_of"]
