"""The orders that a telescope takes, the same by every face; the kind of an order is the kind of its job."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from api.access.callers import Role
from api.http.hints import make_hint
from api.orders.bodies import Tagged
from api.orders.targets import Target
from mountnav.errors import BadRequest

_Planned = Annotated[
    float | None,
    Field(
        gt=0,
        le=86_400,
        description="How long it is to be followed: the answer tells which limit comes before that",
    ),
]
_Exposure = Annotated[float | None, Field(gt=0, le=600)]


class SlewOrder(Tagged):
    """Go to a place as the mount believes it; nothing is looked at."""

    kind: Literal["slew"] = "slew"
    target: Target


class CenterOrder(Tagged):
    """Slew, look, correct, and slew again until the target is at the frame's center."""

    kind: Literal["center"] = "center"
    target: Target
    tolerance_arcsec: float | None = Field(default=None, gt=0, le=3600)
    max_tries: int | None = Field(default=None, ge=1, le=50)
    timeout_s: float | None = Field(default=None, gt=0, le=7200)
    correct_by: Literal["sync", "offset", "model"] | None = None
    planned_s: _Planned = None


class LookOrder(Tagged):
    """Expose and solve: where it truly points. Moves and syncs nothing."""

    kind: Literal["look"] = "look"
    exposure_s: _Exposure = None
    persistent: bool = Field(default=False, description="Try all that is allowed and moves nothing")


class SyncOrder(Tagged):
    """Look, and tell the mount where it truly points."""

    kind: Literal["sync"] = "sync"


class SyncToOrder(Tagged):
    """Tell the mount that it points at these coordinates: a planetarium's sync, believed within bounds."""

    kind: Literal["sync-to"] = "sync-to"
    target: Target


class OffsetOrder(Tagged):
    """Nudge: slew by so much on the sky, east and north positive."""

    kind: Literal["offset"] = "offset"
    east_arcsec: float = Field(ge=-36_000, le=36_000)
    north_arcsec: float = Field(ge=-36_000, le=36_000)


class FlipOrder(Tagged):
    """Let a German mount change sides, and center the target anew."""

    kind: Literal["flip"] = "flip"
    target: Target
    planned_s: _Planned = None


class ParkOrder(Tagged):
    """Go to the park position and stay."""

    kind: Literal["park"] = "park"


class UnparkOrder(Tagged):
    """Be ready to move again."""

    kind: Literal["unpark"] = "unpark"


class SetParkOrder(Tagged):
    """Take the present place for the park position."""

    kind: Literal["set-park"] = "set-park"


class HomeOrder(Tagged):
    """Go home, or find it by its sensors."""

    kind: Literal["home"] = "home"


class TrackingOrder(Tagged):
    """Follow the sky, or rest."""

    kind: Literal["tracking"] = "tracking"
    on: bool
    rate: Literal["sidereal", "lunar", "solar", "king"] = "sidereal"


class GuideOrder(Tagged):
    """Move at the guide rate for a moment."""

    kind: Literal["guide"] = "guide"
    direction: Literal["n", "s", "e", "w"]
    duration_s: float = Field(gt=0, le=60)


class TrustOrder(Tagged):
    """An operator's word that the mount's position is right: whoever says so has looked."""

    kind: Literal["trust"] = "trust"


class SetSiteTimeOrder(Tagged):
    """Set the mount's site and clock to this service's. Moves nothing; its position may count no more."""

    kind: Literal["set-site-time"] = "set-site-time"


class AcceptSiteTimeOrder(Tagged):
    """Accept that mount and settings contradict each other on site or time, until that changes."""

    kind: Literal["accept-site-time"] = "accept-site-time"


class RecoverOrder(Tagged):
    """Tell a lost mount where it points: two looks anywhere in the sky that agree, then a sync."""

    kind: Literal["recover"] = "recover"
    exposure_s: _Exposure = None


class FirstLightOrder(Tagged):
    """Tell a telescope set up by eye where it points, and learn its camera: looks and small moves."""

    kind: Literal["first-light"] = "first-light"
    exposure_s: _Exposure = None


class SolveOrder(Tagged):
    """Solve a frame that lies on this machine; or expose one and solve it. Moves nothing."""

    kind: Literal["solve"] = "solve"
    path: str | None = Field(
        default=None,
        min_length=1,
        max_length=4096,
        description="In one of the folders that frames may be taken from (`[telescope.night]` folder, "
        "allowed_folders). Left out: a frame is exposed",
    )
    exposure_s: _Exposure = Field(default=None, description="Without a path")
    ra_deg: float | None = Field(default=None, ge=0, lt=360, description="Believed ICRS center, with a path")
    dec_deg: float | None = Field(default=None, ge=-90, le=90, description="With ra_deg")
    radius_deg: float | None = Field(default=None, gt=0, le=180, description="How wrong that may be")
    scale_low_arcsec_px: float | None = Field(default=None, gt=0, le=3600, description="With a path")
    scale_high_arcsec_px: float | None = Field(default=None, gt=0, le=3600, description="With a path")
    blind: Literal["after", "only", "never"] | None = Field(
        default=None, description="With a path: search the whole sky; else as the settings have it"
    )
    budget_s: float | None = Field(default=None, gt=0, le=120, description="With a path")

    @model_validator(mode="after")
    def _nothing_in_vain(self) -> Self:
        """Refuse what would be left out of account: who sends it believes that it counts."""
        try:
            hint = make_hint(
                self.ra_deg,
                self.dec_deg,
                self.radius_deg,
                self.scale_low_arcsec_px,
                self.scale_high_arcsec_px,
            )
        except BadRequest as wrong:
            raise ValueError(f"{wrong.what}: {wrong.advice}") from wrong
        if self.path is not None and self.exposure_s is not None:
            raise ValueError("either path or exposure_s: a file is not exposed")
        of_a_file = hint is not None or self.blind is not None or self.budget_s is not None
        if self.path is None and of_a_file:
            raise ValueError("a place, a scale, blind and budget_s are for a file: give its path, too")
        return self


class SeriesOrder(Tagged):
    """Look again and again while it tracks: how the field drifts, with errors."""

    kind: Literal["series"] = "series"
    target: Target | None = Field(default=None, description="Slewed to first; left out: where it stands")
    looks: int = Field(default=10, ge=3, le=1000)
    every_s: float = Field(
        default=0.0, ge=0, le=3600, description="From the beginning of a look to that of the next, at least"
    )
    exposure_s: _Exposure = None


class ModelRunOrder(Tagged):
    """Look at points over the allowed sky, one after the other; make a pointing model, and judge it."""

    kind: Literal["model-run"] = "model-run"
    points: int | None = Field(
        default=None, ge=5, le=1000, description="About so many, and those of the last check besides"
    )
    spread: Literal["spiral", "random"] = "spiral"
    seed: int = Field(default=0, ge=0, le=2**31 - 1, description="The same plan for the same seed")
    exposure_s: _Exposure = None
    put_in_force: bool = Field(
        default=False,
        description="Write it to `[telescope.model]` file and aim by it, if it is accepted. Needs configure",
    )


LongerOrder = SolveOrder | SeriesOrder | ModelRunOrder
"""Orders that need more than a navigator; `api.orders.longer_orders` carries them out."""

Order = Annotated[
    SlewOrder
    | CenterOrder
    | LookOrder
    | SyncOrder
    | SyncToOrder
    | OffsetOrder
    | FlipOrder
    | ParkOrder
    | UnparkOrder
    | SetParkOrder
    | HomeOrder
    | TrackingOrder
    | GuideOrder
    | TrustOrder
    | SetSiteTimeOrder
    | AcceptSiteTimeOrder
    | RecoverOrder
    | FirstLightOrder
    | SolveOrder
    | SeriesOrder
    | ModelRunOrder,
    Field(discriminator="kind"),
]

KINDS: dict[str, type[Tagged]] = {
    str(one.model_fields["kind"].default): one
    for one in (
        SlewOrder,
        CenterOrder,
        LookOrder,
        SyncOrder,
        SyncToOrder,
        OffsetOrder,
        FlipOrder,
        ParkOrder,
        UnparkOrder,
        SetParkOrder,
        HomeOrder,
        TrackingOrder,
        GuideOrder,
        TrustOrder,
        SetSiteTimeOrder,
        AcceptSiteTimeOrder,
        RecoverOrder,
        FirstLightOrder,
        SolveOrder,
        SeriesOrder,
        ModelRunOrder,
    )
}
"""Each kind of order, and so of job, with its body."""

MOVING = frozenset({"slew", "center", "offset", "flip", "park", "home", "model-run", "first-light"})
"""Kinds of orders that slew the mount: from the moment one is taken the telescope counts as slewing."""


OVERRULING = (TrustOrder, AcceptSiteTimeOrder)
"""Orders that are somebody's word against what the guards know by themselves."""


def role_for(order: Order) -> Role:
    """Which role an order needs, by whatever face it comes: what overrules the guards needs more."""
    overrules = isinstance(order, OVERRULING) or (isinstance(order, ModelRunOrder) and order.put_in_force)
    return Role.CONFIGURE if overrules else Role.OPERATE


__all__ = [
    "KINDS",
    "MOVING",
    "OVERRULING",
    "AcceptSiteTimeOrder",
    "CenterOrder",
    "FirstLightOrder",
    "FlipOrder",
    "GuideOrder",
    "HomeOrder",
    "LongerOrder",
    "LookOrder",
    "ModelRunOrder",
    "OffsetOrder",
    "Order",
    "ParkOrder",
    "RecoverOrder",
    "SeriesOrder",
    "SetParkOrder",
    "SetSiteTimeOrder",
    "SlewOrder",
    "SolveOrder",
    "SyncOrder",
    "SyncToOrder",
    "TrackingOrder",
    "TrustOrder",
    "UnparkOrder",
    "role_for",
]
