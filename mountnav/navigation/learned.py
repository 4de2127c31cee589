"""What solves have taught of the camera on the mount: running medians that one false solve can't move.

A wrong focal length in the settings is then only a warning, and a solve that shows another scale, parity
or rotation than all before it is doubted [POINTING §9]. When the camera was really turned or changed, some
solves in a row that agree with each other become the new normal.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from mountnav.devices import PierSide
from mountnav.errors import BadSettings, SyncDoubt
from mountnav.frames import Hint
from mountnav.navigation.camera import (
    CameraRules,
    CameraSample,
    Mounting,
    Normal,
    apart_deg,
    normal_of,
    sample_row,
    samples_of_rows,
    sound,
)
from mountnav.navigation.sync_policy import SyncPolicy

_FORMAT = 1
"""Version of what `as_dict` gives; rows of another one in the journal are passed over."""
_WRITTEN_EACH = 10
"""So many solves from one row of the journal to the next. Chosen by hand. Doubled, a restart forgets up to 19
solves instead of 9; the medians hardly change by them."""


class LessonKind(StrEnum):
    """What became of a solve that was offered."""

    LEARNED = "learned"
    ASIDE = "kept aside"
    """It shows something else than those before it; if the next ones agree with it, it counts."""
    NEW_NORMAL = "new normal"
    REFUSED = "refused"
    """It was doubtful: nothing is learned from it."""


@dataclass(frozen=True, slots=True)
class Lesson:
    """The answer to an offered solve.

    Attributes
    ----------
    words : str
        With the numbers; for a new normal, what changed.
    departures : mapping of SyncDoubt to str
        What it shows that the ones before it didn't.
    worth_writing : bool
        Whether the journal should keep the present state.
    """

    kind: LessonKind
    words: str
    departures: Mapping[SyncDoubt, str] = field(default_factory=dict)
    worth_writing: bool = False


class Learned:
    """What is known of one telescope's camera.

    Parameters
    ----------
    mounting : {"german", "fork", "altaz"} or None
        German mounts turn the camera by 180° on the other side of the pier.
    policy : SyncPolicy, optional
        For its tolerances of scale, rotation and pole.
    window : int
        Solves that are kept.
    enough : int
        So many must agree, and more than half of those kept, before they count.
    anew : int
        So many in a row that agree on something else are the new normal.

    Notes
    -----
    As long as nothing changes on the telescope the medians don't depend on the order of the solves.
    """

    def __init__(
        self,
        *,
        mounting: Mounting | None = None,
        policy: SyncPolicy | None = None,
        window: int = 50,
        enough: int = 3,
        anew: int = 5,
    ) -> None:
        if not (1 <= enough <= window and max(2, enough) <= anew <= window):
            raise BadSettings(
                f"learning from {enough} and anew from {anew} of {window} solves",
                advice="1 <= enough <= anew <= window, and anew at least 2",
            )
        policy = policy or SyncPolicy()
        self.rules = CameraRules(
            mounting, policy.scale_tolerance, policy.rotation_tolerance_deg, policy.polar_error_deg, enough
        )
        self._window = window
        self._anew = anew
        self._kept: list[CameraSample] = []
        self._aside: list[CameraSample] = []
        self._normal: Normal | None = None
        self._taken = 0

    @property
    def normal(self) -> Normal | None:
        """The medians; None until enough solves agree."""
        return self._normal

    @property
    def waiting(self) -> int:
        """Solves in a row that showed something else; as many as make a new normal at most."""
        return len(self._aside)

    def forget(self) -> None:
        """Begin again: somebody has worked on the camera."""
        self._kept, self._aside, self._normal = [], [], None

    def turned(self, by_deg: float | None) -> None:
        """Take note that the camera was turned, and so its images are, from now on.

        Parameters
        ----------
        by_deg : float or None
            On the sky, from north through east; None: by an unknown angle, then it is learned anew.
        """
        self._aside = []
        if by_deg is None:
            # as if taken at the pole, where an angle says nothing
            self._kept = [replace(sample, cos_latitude=0.0) for sample in self._kept]
        else:
            self._kept = [
                replace(sample, axis_angle_deg=(sample.axis_angle_deg + by_deg) % 360.0)
                for sample in self._kept
            ]
        self._normal = normal_of(self._kept, self.rules)

    def of_another(self) -> Learned:
        """One for another camera, by the same rules, that knows nothing yet."""
        made = copy(self)
        made.forget()
        made._taken = 0
        return made

    # -- judging -----------------------------------------------------------------------------------

    def departures(self, sample: CameraSample) -> dict[SyncDoubt, str]:
        """What a solve shows that those before it didn't, in words; empty also while nothing is known."""
        normal, found = self._normal, dict[SyncDoubt, str]()
        if normal is None:
            return found
        if sample.parity != normal.parity:
            found[SyncDoubt.PARITY] = (
                f"the image is {_parity(sample.parity)}, {normal.solves} solves before it were "
                f"{_parity(normal.parity)}"
            )
        if not self.rules.same_scale(sample.scale_arcsec_px, normal.scale_arcsec_px):
            found[SyncDoubt.SCALE] = (
                f"scale {sample.scale_arcsec_px:.4g}″/px, {normal.solves} solves before it say "
                f"{normal.scale_arcsec_px:.4g}″/px"
            )
        return found | self._turned(sample, normal)

    def _turned(self, sample: CameraSample, normal: Normal) -> dict[SyncDoubt, str]:
        allowed_deg = self.rules.allowed_rotation_deg(sample)
        if allowed_deg is None or normal.camera_angle_deg is None:
            return {}
        modulo_deg = min(normal.modulo_deg, self.rules.modulo_deg(sample))
        off_deg = apart_deg(self.rules.upright_deg(sample), normal.camera_angle_deg, modulo_deg)
        if abs(off_deg) <= allowed_deg:
            return {}
        on_its_head = modulo_deg == 360.0 and abs(apart_deg(off_deg, 180.0)) <= allowed_deg
        if on_its_head and self.rules.sided(sample):
            return {
                SyncDoubt.WRONG_SIDE: f"the mount says {sample.side}, and the image stands on its head "
                f"(turned by {off_deg:+.1f}° from what it is on that side)"
            }
        return {
            SyncDoubt.ROTATION: f"the camera is turned by {off_deg:+.1f}° from what {normal.solves} solves "
            f"before it say ({allowed_deg:.1f}° are allowed at this declination)"
        }

    def side_seen(self, sample: CameraSample) -> PierSide:
        """On which side of the pier the tube hangs, by the solved rotation; unknown if it can't say."""
        normal, allowed_deg = self._normal, self.rules.allowed_rotation_deg(sample)
        if normal is None or normal.camera_angle_deg is None or allowed_deg is None:
            return PierSide.UNKNOWN
        if normal.modulo_deg < 360.0 or self.rules.mounting in ("fork", "altaz"):
            return PierSide.UNKNOWN
        off_deg = apart_deg(sample.axis_angle_deg, normal.camera_angle_deg)
        if abs(off_deg) <= allowed_deg:
            return PierSide.EAST
        return PierSide.WEST if abs(apart_deg(off_deg, 180.0)) <= allowed_deg else PierSide.UNKNOWN

    def angle_on(self, side: PierSide) -> float | None:
        """Angle of the image's +y from the mount's north on that side of the pier; None where it isn't known.

        Parameters
        ----------
        side : PierSide
            Of no account for a fork and an alt-azimuth mount.
        """
        normal = self._normal
        if normal is None or normal.camera_angle_deg is None:
            return None
        if self.rules.mounting in ("fork", "altaz"):
            return normal.camera_angle_deg
        if side is PierSide.UNKNOWN or normal.modulo_deg < 360.0:
            return None
        return (normal.camera_angle_deg + (180.0 if side is PierSide.WEST else 0.0)) % 360.0

    def judges_rotation(self, sample: CameraSample) -> bool:
        """Whether the camera's angle is known, and means something at the sample's place."""
        normal = self._normal
        known = normal is not None and normal.camera_angle_deg is not None
        return known and self.rules.allowed_rotation_deg(sample) is not None

    # -- learning ----------------------------------------------------------------------------------

    def learn(self, sample: CameraSample) -> Lesson:
        """Take a solve that nothing else stands against; see `LessonKind`."""
        if not sound(sample):
            return Lesson(LessonKind.REFUSED, "its scale, angle or parity is none")
        departures = self.departures(sample)
        if departures:
            return self._keep_aside(sample, departures)
        self._taken += 1
        before, self._aside = self._normal, []
        self._kept = [*self._kept, sample][-self._window :]
        self._normal = normal_of(self._kept, self.rules)
        first = before is None and self._normal is not None
        writing = first or (self._normal is not None and self._taken % _WRITTEN_EACH == 0)
        return Lesson(LessonKind.LEARNED, self.words, worth_writing=writing)

    def _keep_aside(self, sample: CameraSample, departures: Mapping[SyncDoubt, str]) -> Lesson:
        self._aside = [*self._aside, sample][-self._anew :]
        aside = Lesson(LessonKind.ASIDE, "; ".join(departures.values()), departures)
        # a camera is seldom turned by just half a turn, and a side is easily misreported
        if set(departures) == {SyncDoubt.WRONG_SIDE} or len(self._aside) < self._anew:
            return aside
        before, after = self._normal, normal_of(self._aside, replace(self.rules, enough=self._anew))
        if before is None or after is None or not self._differs(before, after):
            return aside
        self._kept, self._aside, self._normal = self._aside, [], after
        return Lesson(LessonKind.NEW_NORMAL, self._changed(before, after), departures, worth_writing=True)

    def _differs(self, before: Normal, after: Normal) -> bool:
        """Whether it is the solves' agreement that departs, and not each of them in its own way."""
        if before.parity != after.parity:
            return True
        if not self.rules.same_scale(before.scale_arcsec_px, after.scale_arcsec_px):
            return True
        return after.camera_angle_deg is not None

    def _changed(self, before: Normal, after: Normal) -> str:
        changed = []
        if before.parity != after.parity:
            changed.append(f"the image is now {_parity(after.parity)}")
        if not self.rules.same_scale(before.scale_arcsec_px, after.scale_arcsec_px):
            changed.append(f"scale {before.scale_arcsec_px:.4g} → {after.scale_arcsec_px:.4g}″/px")
        if before.camera_angle_deg is not None and after.camera_angle_deg is not None:
            changed.append(f"camera angle {before.camera_angle_deg:.1f}° → {after.camera_angle_deg:.1f}°")
        return f"{after.solves} solves in a row agree on a new normal: " + ", ".join(changed)

    # -- what it is good for -----------------------------------------------------------------------

    @property
    def words(self) -> str:
        """What is known, for people."""
        normal = self._normal
        if normal is None:
            return f"{len(self._kept)} solve(s), too few that agree"
        told = f"{normal.solves} solves: {normal.scale_arcsec_px:.4g}″/px, {_parity(normal.parity)}"
        if normal.camera_angle_deg is not None:
            but = " (or half a turn more)" if normal.modulo_deg < 360.0 else ""
            told += f", camera angle {normal.camera_angle_deg:.1f}°{but}"
        return told

    @property
    def scale_window(self) -> tuple[float, float] | None:
        """Lowest and highest scale (arcsec per pixel) that is to be expected; None while nothing is known."""
        normal = self._normal
        if normal is None:
            return None
        scale = normal.scale_arcsec_px
        share = min(0.2, max(self.rules.scale_tolerance, 5.0 * normal.scale_sigma_arcsec_px / scale))
        return scale * (1.0 - share), scale * (1.0 + share)

    def hint(self, hint: Hint) -> Hint:
        """The hint with the scale that was learned; unchanged while nothing is."""
        if self._normal is None or self.scale_window is None:
            return hint
        low, high = self.scale_window
        source = f"{self._normal.solves} solves"
        return replace(hint, scale_low_arcsec_px=low, scale_high_arcsec_px=high, scale_source=source)

    def warnings(
        self,
        *,
        configured_scale_arcsec_px: float | None = None,
        tolerance: float = 0.05,
        focal_length_mm: float | None = None,
    ) -> tuple[str, ...]:
        """What an operator should know, in words with numbers.

        Parameters
        ----------
        configured_scale_arcsec_px : float, optional
            What the settings or the header say.
        tolerance : float
            How wrong that may be, as a fraction.
        focal_length_mm : float, optional
            What they say, for the message what it must be.
        """
        normal, said, told = self._normal, configured_scale_arcsec_px, []
        if normal is not None and said is not None and abs(normal.scale_arcsec_px / said - 1.0) > tolerance:
            length = truth = ""
            if focal_length_mm is not None:
                length = f"{focal_length_mm:.0f} mm, "
                truth = f" ({focal_length_mm * said / normal.scale_arcsec_px:.0f} mm with these pixels)"
            told.append(
                f"the settings say {length}{said:.4g}″/px; {normal.solves} solves say "
                f"{normal.scale_arcsec_px:.4g}″/px{truth}: correct focal length, pixel size or binning"
            )
        if self._aside:
            seen = "; ".join(self.departures(self._aside[-1]).values())
            told.append(f"the last {len(self._aside)} solve(s) differ from those before: {seen}")
        return tuple(told)

    # -- keeping -----------------------------------------------------------------------------------

    def as_dict(self) -> dict[str, Any]:
        """All that is known, as JSON values."""
        return {
            "format": _FORMAT,
            "kept": [sample_row(sample) for sample in self._kept],
            "aside": [sample_row(sample) for sample in self._aside],
        }

    def restore(self, data: Mapping[str, Any]) -> None:
        """Take over what `as_dict` gave; what can't be read is left out."""
        if data.get("format") != _FORMAT:
            return
        self._kept = samples_of_rows(data.get("kept"))[-self._window :]
        self._aside = samples_of_rows(data.get("aside"))[-self._anew :]
        self._normal = normal_of(self._kept, self.rules)


def _parity(parity: int) -> str:
    return "not mirrored" if parity > 0 else "mirrored"


__all__ = ["Learned", "Lesson", "LessonKind", "Normal"]
