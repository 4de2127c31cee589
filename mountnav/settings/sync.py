"""`sync` of a telescope: when the mount is told where it points."""

from __future__ import annotations

import dataclasses

from pydantic import Field

from mountnav.navigation.sync_policy import SyncPolicy, SyncRule
from mountnav.settings.section import Section


class SyncSettings(Section):
    """`sync` of a telescope: when the mount is told where it points, and what a look must show for that.

    An observatory that sets nothing syncs when a centering or a night finds the tube more than 10″ (and the
    mount's resolution) from where the mount believes it, and never by more than 2°.

    Attributes
    ----------
    rule : {"never", "first-of-night", "per-target", "when-off-by", "always"}
        How often it syncs of its own accord. What an operator orders by name doesn't ask for it.
    off_by_arcsec : float
        Of "when-off-by".
    max_arcsec : float
        Cap on the size.
    max_per_night : int
        Cap on the number between noon and noon; 0 sets none.
    max_per_target : int
        Cap on the number for a target and a night; 0 sets none.
    min_meridian_deg : float
        Nothing is synced at hour angles nearer to the meridian; 0 doesn't ask.
    min_pole_deg : float
        Nothing is synced nearer to the pole: a frame there doesn't tell the hour angle axis.
    max_turn_arcsec : float
        How much more than the offset that is seen a sync may turn the hour angle.
    min_altitude_deg : float
        Nothing is synced on a place below this altitude.
    max_age_s : float
        Oldest frame, from the end of its exposure.
    min_pairs : int
        Fewest identified stars.
    max_false_probability : float
        Worst odds.
    scale_tolerance : float
        How far the scale may be from its running median, as a fraction.
    rotation_tolerance_deg : float
        How far the camera's angle may be from its running median.
    polar_error_deg : float
        How far the mount's pole may be from the sky's: the rotation means less near the pole.
    expected_sigmas : float
        How many sigma an offset may be from what the pointing model expects.
    expected_floor_arcsec : float
        Added to that.
    read_back_s : float
        How long a sync may take to show before it counts as ignored.
    confirm : bool
        A second look must agree before a sync that nothing known can judge: the first ones of a night.
    confirm_above_arcsec : float
        How far off a look must be for that.
    verify : bool
        A second look confirms each sync, or it is undone.
    verify_arcsec : float
        How near solved place and reading must be in that look.
    told_max_arcsec : float
        How far a planetarium's sync, coordinates that nobody has solved, may be from what the mount believes,
        and all of a night together; 0 takes none.
    """

    rule: SyncRule = SyncRule.WHEN_OFF_BY
    off_by_arcsec: float = Field(default=10.0, ge=0, le=180 * 3600)
    max_arcsec: float = Field(default=7200.0, gt=0, le=180 * 3600)
    max_per_night: int = Field(default=500, ge=0, le=100_000)
    max_per_target: int = Field(default=0, ge=0, le=100_000)
    min_meridian_deg: float = Field(default=0.0, ge=0, le=90)
    min_pole_deg: float = Field(default=5.0, ge=0, le=45)
    max_turn_arcsec: float = Field(default=1800.0, ge=0, le=180 * 3600)
    min_altitude_deg: float = Field(default=5.0, ge=-5, le=90)
    max_age_s: float = Field(default=120.0, gt=0, le=3600)
    min_pairs: int = Field(default=4, ge=3, le=1000)
    max_false_probability: float = Field(default=1e-9, gt=0, le=1e-3)
    scale_tolerance: float = Field(default=0.02, gt=0, le=0.5)
    rotation_tolerance_deg: float = Field(default=5.0, gt=0, le=45)
    polar_error_deg: float = Field(default=1.0, ge=0, le=30)
    expected_sigmas: float = Field(default=5.0, gt=0, le=100)
    expected_floor_arcsec: float = Field(default=120.0, ge=0, le=180 * 3600)
    read_back_s: float = Field(default=8.0, ge=0, le=60)
    confirm: bool = True
    confirm_above_arcsec: float = Field(default=120.0, ge=0, le=180 * 3600)
    verify: bool = False
    verify_arcsec: float = Field(default=30.0, gt=0, le=3600)
    told_max_arcsec: float = Field(default=7200.0, ge=0, le=180 * 3600)

    @property
    def policy(self) -> SyncPolicy:
        """As navigation takes it."""
        given = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(SyncPolicy)
            if field.name in type(self).model_fields
        }
        # in TOML there is no None
        caps = {name: given[name] or None for name in ("max_per_night", "max_per_target")}
        bare = max(SyncPolicy().expected_floor_bare_arcsec, self.expected_floor_arcsec)
        return SyncPolicy(**(given | caps | {"expected_floor_bare_arcsec": bare}))
