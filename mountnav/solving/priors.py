"""What solved frames teach of the next one of the same camera: its scale, so that it hasn't to be sought.

A prior is tried first and alone; a frame that it doesn't solve is solved as if there were none. Only the
scale is taken: measured, the rest of a plate saves nothing (docs/explanation/archives.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from mountnav.frames import Hint

SAVES_FROM = 1.5
"""A prior is used where the scale is known no better than by this factor, or is believed to be another.
Measured: bounds of 5 % and of 0.3 % cost the same. Doubled, some frames with vague headers search in vain."""


@dataclass(frozen=True, slots=True)
class CameraPrior:
    """The scale of a camera on its telescope, as solved frames have it.

    Attributes
    ----------
    instrument, telescope : str
        INSTRUME and TELESCOP of its frames; empty where they name none.
    width_px, height_px : int
        Size of its frames: binned ones are another camera's.
    scale_low_arcsec_px, scale_high_arcsec_px : float
        Between what bounds their scales lie, some room included.
    frames : int
        How many frames it was learned from.
    """

    instrument: str
    telescope: str
    width_px: int
    height_px: int
    scale_low_arcsec_px: float
    scale_high_arcsec_px: float
    frames: int

    @property
    def hint(self) -> Hint:
        """As a hint of the scale alone."""
        return Hint(
            scale_low_arcsec_px=self.scale_low_arcsec_px,
            scale_high_arcsec_px=self.scale_high_arcsec_px,
            scale_source=f"the camera's prior of {self.frames} frames",
        )

    def narrowed(self, believed: Hint) -> Hint | None:
        """What is believed, with the scale of the prior.

        Returns
        -------
        Hint or None
            None where nothing is saved so: no place is known (the index of the sky tells the scale as it
            finds the frame), or the scale is.
        """
        placed = [one for one in (believed, *believed.alternatives) if one.center is not None]
        if not placed or self._is_known(believed):
            return None
        ours = self.hint
        readings = dict.fromkeys(
            replace(
                one,
                scale_low_arcsec_px=ours.scale_low_arcsec_px,
                scale_high_arcsec_px=ours.scale_high_arcsec_px,
                scale_source=ours.scale_source,
                alternatives=(),
            )
            for one in placed
        )
        first, *others = readings
        return replace(first, alternatives=tuple(others))

    def _is_known(self, believed: Hint) -> bool:
        low, high = believed.scale_low_arcsec_px, believed.scale_high_arcsec_px
        if low is None or high is None or not 0.0 < low <= high:
            return False
        apart = low > self.scale_high_arcsec_px or high < self.scale_low_arcsec_px
        return not apart and high <= SAVES_FROM * low


def prior_of(
    priors: tuple[CameraPrior, ...], instrument: str, telescope: str, width_px: int, height_px: int
) -> CameraPrior | None:
    """The prior of the camera that a frame is of, if there is one."""
    key = (instrument, telescope, width_px, height_px)
    for one in priors:
        if (one.instrument, one.telescope, one.width_px, one.height_px) == key:
            return one
    return None
