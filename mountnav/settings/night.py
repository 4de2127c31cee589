"""`night` of a telescope: what it does from dusk to dawn, by rules."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from mountnav.settings.section import Section

if TYPE_CHECKING:
    from mountnav.night.rules import NightRules


class NightSettings(Section):
    """`night` of a telescope: what it does from dusk to dawn, by rules.

    Nothing is watched and nothing corrected unless it is set here.

    Attributes
    ----------
    enabled : bool
        Whether there are nights at all.
    folder : Path or None
        Where another program writes its science frames. None: they come by HTTP alone.
    pattern : str
        Which files of the folder count, as a glob; `**/` goes into folders below.
    poll_s : float
        Between two looks into the folder; a file is whole when two looks see the same.
    allowed_folders : tuple of Path
        Folders, beside `folder`, that a frame sent by its path may lie in.
    correct_by : {"nothing", "sync", "offset", "model"}
        How the mount is corrected by what frames show. "nothing" measures only. "sync" tells the mount where
        it points and moves nothing; "offset" moves the tube by what it is off; "model" sends it where the
        pointing model says.
    correct_when_off_by_arcsec : float
        Nothing is corrected by less than this.
    max_correction_arcsec : float
        Nothing is corrected by more than this: a person should look.
    agree_arcsec : float
        How near two frames in a row must agree about what the mount is off, before it is corrected.
    frames_that_agree : int
        How many frames must agree; never fewer than two: a satellite or a false solution comes alone.
    evidence_max_age_s : float
        Frames further apart than this say nothing together.
    quiet_s : float
        After a frame has arrived the scheduler is taken to leave the mount alone so long; a correction begins
        then or not at all. A frame that is sent with `hold` keeps the time quiet until it is answered. 0:
        only with `hold`, or when the scheduler says that it is free.
    settle_s : float
        After a correction so long passes before a frame counts again.
    calibration_frames : int
        Frames that open a session: each is identified fully, and their plates must agree before shifts are
        trusted [S23: three].
    scale_agrees : float
        How near (a share) the scales of these frames must agree, and later ones must agree with them.
    rotation_agrees_deg : float
        The same for the rotation; half a turn is allowed, for meridian flips.
    audit_every : int
        Every so many frames that are followed by shift one is identified fully.
    begin_sun_below_deg, end_sun_above_deg : float
        A night begins when the Sun is lower than the first, and ends when it is higher than the second.
    pause_after_unsolved : int
        After so many frames in a row that were not identified it is taken for cloud: it is told, and what was
        known before the cloud doesn't count any more.
    safety_file : Path or None
        Its first word says whether it is safe (`safe`, `1`, `true`, `yes`) or not. A file that is missing or
        too old means it is not.
    when_unsafe : {"pause", "park"}
        "pause" ends a correction that is under way, stops what it moved, and corrects nothing more until it
        is safe again; "park" parks besides.
    park_at_end : bool
        Whether the mount is parked when the night ends by daylight.
    resume : bool
        Whether a night goes on after a restart of the service, and the next one begins by itself.
    read_mount_every_s : float
        How often the mount is read, to know what it believed when a frame was exposed.
    frames_waiting : int
        Frames that may wait to be identified; more are refused, and read from the folder later.
    record : Path or None
        Folder for recordings, which `mountnav replay` reads; one file a night, with the wire of the mount.
    record_keep_days : float
        Recordings of this telescope that are older are removed when a new one begins; 0 keeps all.
    record_max_mb : float
        The oldest of them are removed when all together have more; 0 for no bound.
    """

    enabled: bool = False
    folder: Path | None = None
    pattern: str = Field(default="*.fit*", min_length=1, max_length=200)
    poll_s: float = Field(default=1.0, gt=0, le=600)
    allowed_folders: tuple[Path, ...] = ()
    correct_by: Literal["nothing", "sync", "offset", "model"] = "nothing"
    correct_when_off_by_arcsec: float = Field(default=30.0, gt=0, le=36000)
    max_correction_arcsec: float = Field(default=1800.0, gt=0, le=36000)
    max_corrections_per_hour: int = Field(default=6, ge=0, le=1000)
    max_corrections_per_night: int = Field(default=40, ge=0, le=10000)
    agree_arcsec: float = Field(default=10.0, gt=0, le=3600)
    frames_that_agree: int = Field(default=2, ge=2, le=20)
    evidence_max_age_s: float = Field(default=900.0, gt=0, le=86400)
    quiet_s: float = Field(default=10.0, ge=0, le=3600)
    settle_s: float = Field(default=2.0, ge=0, le=600)
    calibration_frames: int = Field(default=3, ge=1, le=50)
    scale_agrees: float = Field(default=0.005, gt=0, le=0.2)
    rotation_agrees_deg: float = Field(default=1.0, gt=0, le=45)
    audit_every: int = Field(default=10, ge=1, le=1000)
    begin_sun_below_deg: float = Field(default=-12.0, ge=-90, le=90)
    end_sun_above_deg: float = Field(default=-10.0, ge=-90, le=90)
    pause_after_unsolved: int = Field(default=5, ge=1, le=1000)
    safety_file: Path | None = None
    safety_max_age_s: float = Field(default=300.0, gt=0, le=86400)
    when_unsafe: Literal["pause", "park"] = "pause"
    park_at_end: bool = False
    resume: bool = True
    read_mount_every_s: float = Field(default=2.0, gt=0, le=60)
    frames_waiting: int = Field(default=50, ge=1, le=10000)
    record: Path | None = None
    record_keep_days: float = Field(default=0.0, ge=0, le=100_000)
    record_max_mb: float = Field(default=0.0, ge=0, le=100_000_000)

    @model_validator(mode="after")
    def _begins_before_it_ends(self) -> Self:
        if self.begin_sun_below_deg > self.end_sun_above_deg:
            raise PydanticCustomError(
                "night_ends_first",
                "the night would begin at {begin}° of the Sun, after it has ended at {end}°",
                {
                    "begin": self.begin_sun_below_deg,
                    "end": self.end_sun_above_deg,
                    "key": "begin_sun_below_deg",
                    "fix": "set begin_sun_below_deg no higher than end_sun_above_deg",
                },
            )
        if self.correct_when_off_by_arcsec > self.max_correction_arcsec:
            raise PydanticCustomError(
                "night_never_corrects",
                "nothing below {low}″ and nothing above {high}″ is corrected: nothing ever is",
                {
                    "low": self.correct_when_off_by_arcsec,
                    "high": self.max_correction_arcsec,
                    "key": "correct_when_off_by_arcsec",
                    "fix": 'raise max_correction_arcsec, or set correct_by = "nothing"',
                },
            )
        return self

    @property
    def rules(self) -> NightRules:
        """As the night takes them."""
        from mountnav.night.rules import NightRules

        names = NightRules.__dataclass_fields__
        return NightRules(**{name: getattr(self, name) for name in names})

    @property
    def folders(self) -> tuple[Path, ...]:
        """Folders that a frame sent by its path may lie in."""
        return self.allowed_folders if self.folder is None else (self.folder, *self.allowed_folders)
