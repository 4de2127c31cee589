"""`[[telescope.point]]`, `[telescope.rotator]`: where on the camera targets are brought, what turns it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from mountnav.settings.section import Section

if TYPE_CHECKING:
    from mountnav.navigation.aim_points import AimPoint
    from mountnav.navigation.rotator import RotatorRules

__all__ = ["MOST_POINTS", "SIMULATED_ROTATOR", "PointSettings", "RotatorSettings"]

MOST_POINTS = 50
"""So many points a telescope has at most. Doubled, a page of a hundred names."""
SIMULATED_ROTATOR = "simulated://"
"""URL of the rotator that turns a simulated camera."""


class PointSettings(Section):
    """`[[telescope.point]]`: a point beside the frame's middle to which targets may be brought.

    Either a pixel of the look camera, or another tube on the same mount.

    Attributes
    ----------
    x_px, y_px : float
        From 0: whole numbers are centers of pixels, (0, 0) the center of the file's first one (FITS: 1, 1).
    width_px, height_px, binning : int
        Of the frame in which it was measured.
    east_arcsec, north_arcsec, at_rotation_deg : float
        Of another tube: where its middle was on the sky, from the look camera's middle, when that camera's
        solved rotation was `at_rotation_deg`.
    turned_deg : float
        Position angle of the point's own direction (a slit's length) minus that of the image's +y.
    """

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 _.-]{0,39}$")
    x_px: float | None = Field(default=None, ge=-0.5, le=100_000)
    y_px: float | None = Field(default=None, ge=-0.5, le=100_000)
    width_px: int | None = Field(default=None, ge=16, le=100_000)
    height_px: int | None = Field(default=None, ge=16, le=100_000)
    binning: int | None = Field(default=None, ge=1, le=16)
    east_arcsec: float | None = Field(default=None, ge=-72_000, le=72_000)
    north_arcsec: float | None = Field(default=None, ge=-72_000, le=72_000)
    at_rotation_deg: float | None = Field(default=None, ge=-360, le=360)
    turned_deg: float = Field(default=0.0, ge=-360, le=360)

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        pixel = (self.x_px, self.y_px)
        offset = (self.east_arcsec, self.north_arcsec, self.at_rotation_deg)
        of_the_frame = (self.width_px, self.height_px, self.binning)
        whole_pixel = None not in pixel and offset == (None, None, None)
        whole_offset = None not in offset and pixel == (None, None) and of_the_frame == (None, None, None)
        if not (whole_pixel or whole_offset):
            raise PydanticCustomError(
                "no_point",
                "{name} is neither a pixel nor another tube",
                {
                    "name": self.name,
                    "fix": "give x_px and y_px (and the frame's width_px, height_px); or east_arcsec, "
                    "north_arcsec and at_rotation_deg",
                },
            )
        if (self.width_px is None) is not (self.height_px is None):
            raise PydanticCustomError(
                "half_a_frame",
                "{name} tells one side of its frame",
                {"name": self.name, "fix": "give width_px and height_px, or neither"},
            )
        return self

    @property
    def point(self) -> AimPoint:
        """As navigation takes it."""
        # a settings file is read, and complained of, without all that moves mounts
        from mountnav.navigation.aim_points import OffsetPoint, PixelPoint

        if self.x_px is not None and self.y_px is not None:
            return PixelPoint(
                self.name,
                self.x_px,
                self.y_px,
                self.width_px,
                self.height_px,
                self.binning,
                self.turned_deg,
            )
        assert self.east_arcsec is not None
        assert self.north_arcsec is not None
        assert self.at_rotation_deg is not None
        return OffsetPoint(
            self.name, self.east_arcsec, self.north_arcsec, self.at_rotation_deg, self.turned_deg
        )


class RotatorSettings(Section):
    """`[telescope.rotator]`: what turns the camera that looks.

    Attributes
    ----------
    url : str
        ``indi://host:7624/Device``, ``alpaca+http://host:11111/rotator/0``, or ``simulated://`` for a
        simulated camera.
    least_deg, most_deg : float
        Cable limits of its mechanism's angle, at most a turn apart; its readings are brought between them.
    never_through_deg : float
        Instead of both: an angle that it is never turned through.
    sense : {1, -1}
        Whether position angles grow with its angle; left out, solves show it.
    tolerance_deg : float
        A position angle so near counts as reached.
    derotate : bool
        Whether it turns with the field of an alt-azimuth mount while a target is followed or held; false
        where another program does that.
    """

    url: str = Field(pattern=r"^(indi://|alpaca\+https?://|simulated://$)")
    least_deg: float | None = Field(default=None, ge=-720, le=720)
    most_deg: float | None = Field(default=None, ge=-720, le=720)
    never_through_deg: float | None = Field(default=None, ge=-360, le=360)
    sense: Literal[1, -1] | None = None
    tolerance_deg: float = Field(default=0.5, gt=0, le=45)
    derotate: bool = True

    @model_validator(mode="after")
    def _limits_once(self) -> Self:
        both = (self.least_deg, self.most_deg)
        if self.never_through_deg is not None and both != (None, None):
            raise PydanticCustomError(
                "limits_twice",
                "never_through_deg and least_deg or most_deg say the same twice",
                {"key": "never_through_deg", "fix": "give either, not both"},
            )
        if (self.least_deg is None) is not (self.most_deg is None):
            raise PydanticCustomError(
                "half_the_limits", "one cable limit alone", {"fix": "give least_deg and most_deg"}
            )
        least, most = self.least_deg, self.most_deg
        if least is not None and most is not None and not 0.0 < most - least <= 360.0:
            raise PydanticCustomError(
                "no_limits",
                "cable limits {least}° to {most}°",
                {
                    "least": least,
                    "most": most,
                    "key": "most_deg",
                    "fix": "the lower one first, and at most a turn (360°) apart",
                },
            )
        return self

    @property
    def rules(self) -> RotatorRules:
        """As navigation takes it."""
        from mountnav.navigation.rotator import RotatorRules

        least, most = self.least_deg, self.most_deg
        if least is None or most is None:
            least = self.never_through_deg or 0.0
            most = least + 360.0
        return RotatorRules(least, most, self.sense, self.tolerance_deg, self.derotate)
