"""`centering` of a telescope: how a target is centered, when it is done, and when it gives up."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mountnav.navigation.policy import Approach, CenteringPolicy, CorrectBy, Persistence, Tactic
from mountnav.settings.section import Section


class UnsolvedSettings(Section):
    """`centering.when_unsolved`: what is tried when a frame could not be identified, and for how long.

    Attributes
    ----------
    tactics : list of str
        Those that are allowed: "another-frame", "longer-exposure", "shorter-exposure", "wider-search",
        "blind", "neighbor-field" (a small slew and back), "wait". What was wrong tells which is tried.
    max_frames : int
        Frames per look, the first one included.
    max_s : float
        Time per look, waiting included. A centering's `timeout_s` bounds it too.
    longest_exposure_s : float
        Exposures are not made longer than this.
    longer_by : float
        Factor of each longer exposure.
    wider_by : float
        Factor of the radius that is searched.
    neighbor_fields : float
        How far away the neighbor field is, in widths of a frame.
    first_wait_s, longest_wait_s : float
        Waits for clouds: the first one; each further is twice as long, up to the longest.
    """

    tactics: tuple[Tactic, ...] = tuple(Tactic)
    max_frames: int = Field(default=12, ge=1, le=1000)
    max_s: float = Field(default=600.0, ge=0, le=86_400)
    longest_exposure_s: float = Field(default=60.0, gt=0, le=3600)
    longer_by: float = Field(default=3.0, gt=1, le=20)
    wider_by: float = Field(default=3.0, gt=1, le=90)
    neighbor_fields: float = Field(default=1.5, gt=0, le=20)
    first_wait_s: float = Field(default=20.0, gt=0, le=3600)
    longest_wait_s: float = Field(default=180.0, gt=0, le=7200)

    @property
    def persistence(self) -> Persistence:
        """As navigation takes it."""
        return Persistence(
            tactics=frozenset(self.tactics),
            max_frames=self.max_frames,
            max_s=self.max_s,
            longest_exposure_s=self.longest_exposure_s,
            longer_by=self.longer_by,
            wider_by=self.wider_by,
            neighbor_fields=self.neighbor_fields,
            first_wait_s=self.first_wait_s,
            longest_wait_s=self.longest_wait_s,
        )


class CenteringSettings(Section):
    """`centering` of a telescope: how a target is centered, when it is done, and when it gives up.

    Attributes
    ----------
    tolerance_arcsec : float
        A target this near to the frame's center is centered. Where the mount's own steps are coarser, what
        they allow is taken instead, and the answer says so.
    max_tries : int
        Looks per centering.
    timeout_s : float
        Time per centering; then the mount is stopped.
    max_sync_arcsec : float
        A place solved further than this from where the mount believes to be is neither synced on nor moved
        by: a recovery must be ordered.
    settle_s : float
        Wait between a slew and the next exposure.
    correct_by : {"sync", "offset", "model"}
        "sync" tells the mount where it points and sends it again, and goes by offset where a sync is refused,
        ignored or not allowed; "offset" sends it beside the target; "model" aims by the pointing model and
        goes on by offset; the last two never sync.
    approach : {"never", "when-needed", "always"}
        Whether the last leg of a correction comes from the same side, against backlash. "when-needed" begins
        with it when the tube did not follow a correction.
    approach_arcsec : float
        Length of that leg; more than the backlash.
    pole_deg : float
        Nearer to the pole than this a centering goes by offsets, never by syncs.
    moved_retries : int
        Frames taken again because the mount was still moving in one.
    """

    tolerance_arcsec: float = Field(default=30.0, gt=0, le=3600)
    max_tries: int = Field(default=5, ge=1, le=50)
    timeout_s: float = Field(default=300.0, gt=0, le=7200)
    max_sync_arcsec: float = Field(default=7200.0, gt=0, le=180 * 3600)
    settle_s: float = Field(default=1.0, ge=0, le=120)
    correct_by: Literal["sync", "offset", "model"] = "sync"
    approach: Literal["never", "when-needed", "always"] = "when-needed"
    approach_arcsec: float = Field(default=300.0, gt=0, le=3600)
    pole_deg: float = Field(default=4.0, ge=0, le=45)
    moved_retries: int = Field(default=2, ge=0, le=20)
    when_unsolved: UnsolvedSettings = UnsolvedSettings()

    def policy(
        self,
        *,
        exposure_s: float,
        scale_arcsec_px: float | None,
        scale_tolerance: float,
        min_altitude_deg: float = 15.0,
    ) -> CenteringPolicy:
        """As navigation takes it.

        Parameters
        ----------
        scale_arcsec_px : float or None
            None: not known.
        scale_tolerance : float
            These are settings of the telescope.
        min_altitude_deg : float
            For a navigator without limits of its own.
        """
        return CenteringPolicy(
            exposure_s=exposure_s,
            tolerance_arcsec=self.tolerance_arcsec,
            max_tries=self.max_tries,
            timeout_s=self.timeout_s,
            max_sync_arcsec=self.max_sync_arcsec,
            settle_s=self.settle_s,
            scale_arcsec_px=scale_arcsec_px,
            scale_tolerance=scale_tolerance,
            min_altitude_deg=min_altitude_deg,
            correct_by=CorrectBy(self.correct_by),
            approach=Approach(self.approach),
            approach_arcsec=self.approach_arcsec,
            pole_deg=self.pole_deg,
            moved_retries=self.moved_retries,
            persistence=self.when_unsolved.persistence,
        )
