"""`following` of a telescope: bounds of rates beside the stars' and of axes moved by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from mountnav.settings.section import Section

if TYPE_CHECKING:
    from mountnav.mount.following_policy import FollowingPolicy


class FollowingSettings(Section):
    """`following` of a telescope: how it follows targets that move and is moved by hand.

    The rules: docs/explanation/following.md.

    Attributes
    ----------
    on_loss
        What is left at the end of rates, and when their program is gone: ``sidereal``: it tracks as
        for a star; ``stop``: it stands still.
    guard
        Whether a small process beside the service ends rates and moved axes when the service dies. Without
        it they go on then, until the service is started again.
    most_s
        So long rates may be ordered for at once, s.
    most_arcsec_s
        Fastest way over the sky beside the stars', ″/s.
    most_axis_deg_s
        Fastest speed at which an axis is moved by hand, °/s.
    most_axis_s
        So long an axis goes on after each order to move it, s.
    axis_braking_deg_s2
        At least so fast an axis brakes, °/s²: how far before a limit it is ended.
    """

    on_loss: Literal["sidereal", "stop"] = "sidereal"
    guard: bool = True
    most_s: float = Field(default=43_200.0, gt=0, le=86_400)
    most_arcsec_s: float = Field(default=7_200.0, gt=0, le=36_000)
    most_axis_deg_s: float = Field(default=4.0, gt=0, le=20)
    most_axis_s: float = Field(default=5.0, gt=0, le=60)
    axis_braking_deg_s2: float = Field(default=1.0, ge=0.05, le=100)

    @property
    def policy(self) -> FollowingPolicy:
        """As the room of the mount takes them."""
        # a settings file is read, and complained of, without the journal's database and all that moves mounts
        from mountnav.mount.following_policy import FollowingPolicy

        return FollowingPolicy(
            on_loss=self.on_loss,
            most_s=self.most_s,
            most_arcsec_s=self.most_arcsec_s,
            most_axis_deg_s=self.most_axis_deg_s,
            most_axis_s=self.most_axis_s,
            axis_braking_deg_s2=self.axis_braking_deg_s2,
        )
