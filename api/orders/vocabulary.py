"""The orders that a telescope takes from any face, their short REST bodies, and their examples.

The kind of an order is the kind of its job. `Order` is the one list; roles, what moves, the capabilities
and the short bodies (`POST /v1/telescopes/{id}/slew` and the like) follow from its classes.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, get_args

from pydantic import ConfigDict, Field, model_validator

from api.access.callers import Role
from api.orders.targets import ApparentTarget, Body, IcrsTarget, Instant, Tagged, Target
from api.solver.hints import make_hint
from mountnav.errors import BadRequest
from mountnav.sky.patterns import MOST_PANELS

__all__ = [
    "JOB_EXAMPLES",
    "KINDS",
    "LONGEST_HELD_S",
    "LONGEST_PULSE_S",
    "LONGEST_RATES_S",
    "MOVING",
    "PLACE_EXAMPLES",
    "AcceptSiteTimeOrder",
    "CenterBody",
    "CenterOrder",
    "DitherOrder",
    "ExposureBody",
    "FirstLightOrder",
    "FlipBody",
    "FlipOrder",
    "FollowBody",
    "FollowOrder",
    "ForgetRatesOrder",
    "GuideOrder",
    "HoldOrder",
    "HomeOrder",
    "LongerOrder",
    "LookBody",
    "LookOrder",
    "ModelRunOrder",
    "MosaicBody",
    "MosaicOrder",
    "MoveAxisBody",
    "MoveAxisOrder",
    "NavigatorOrder",
    "OffsetBody",
    "OffsetOrder",
    "OffsetRatesBody",
    "OffsetRatesOrder",
    "Order",
    "OrderBody",
    "OrderKind",
    "ParkOrder",
    "PixelAt",
    "RateWord",
    "RecoverOrder",
    "RotateBody",
    "RotateOrder",
    "SearchBody",
    "SeriesOrder",
    "SetParkOrder",
    "SetSiteTimeOrder",
    "SlewBody",
    "SlewOrder",
    "SolveOrder",
    "SpiralSearchOrder",
    "SyncOrder",
    "SyncToOrder",
    "TrackingBody",
    "TrackingOrder",
    "TrustOrder",
    "UnparkOrder",
    "role_for",
]


_Planned = Annotated[
    float | None,
    Field(
        gt=0,
        le=86_400,
        description="How long it is to be followed: the answer tells which limit comes before that",
    ),
]
_Exposure = Annotated[float | None, Field(gt=0, le=600)]
LONGEST_PULSE_S = 60
"""Longest guide pulse, s; part of the interface (docs/openapi.json). Doubled, a mistyped one moves
the mount at guide rate for two minutes."""
RateWord = Literal["sidereal", "lunar", "solar", "king"]
LONGEST_HELD_S = 10.0
"""Longest time, s, for which one order moves an axis on without a further one; part of the interface
(docs/openapi.json). Doubled, a mount whose client has died turns for 20 s, at 4 °/s by 80°."""
_USUAL_HELD_S = 1.0
"""The same where nothing is said: a client that repeats it twice or thrice a second loses one answer without
an effect. Doubled, an axis turns for another second after its client has died."""
_FASTEST_DEG_S = 20.0
"""Fastest motion of an axis that can be written down, °/s; the mount's own limits are narrower. Doubled, a
mistyped number is refused by the mount alone."""
LONGEST_RATES_S = 14_400.0
"""Longest time, s, for which rates can be ordered at once: a long series of exposures. Doubled, rates that
nobody wants any more lead a telescope off its target for a whole night."""
_USUAL_RATES_S = 900.0
"""The same where nothing is said: as long as a long exposure. Doubled, forgotten rates last half an hour."""
_FASTEST_ARCSEC_S = 36_000.0
"""Largest rate that can be written down, ″/s: 10 °/s; the mount's own limits are narrower. Doubled, as
above."""


class PixelAt(Body):
    """A pixel of the look camera's frames as they are, from 0: (0, 0) is the center of the first one."""

    x_px: float = Field(ge=-0.5, le=100_000)
    y_px: float = Field(ge=-0.5, le=100_000)


_At = Annotated[
    Annotated[str, Field(min_length=1, max_length=40)] | PixelAt | None,
    Field(
        description="To which point of the camera the target is brought: a name of `[[telescope.point]]`, or "
        "a pixel; left out: the frame's middle"
    ),
]


_PositionAngle = Annotated[float, Field(ge=0, lt=360)]
_POSITION_ANGLE = (
    "Position angle of the image's +y, north through east; of a named point its own direction. A rotator "
    "turns it there, and looks confirm it"
)


class AngleFields(Body):
    """How near to a position angle the image is to stand."""

    angle_tolerance_deg: float | None = Field(default=None, gt=0, le=90)
    either_way: bool = Field(default=False, description="It may stand on its head as well")


class OrderBody(Tagged):
    """One kind of order: its body, and what is decided by its kind alone."""

    moves: ClassVar[bool] = False
    """It slews the mount: from the moment it is taken the telescope counts as slewing."""
    overrules: ClassVar[bool] = False
    """It is somebody's word against what the guards know by themselves, and needs the role configure."""


class SlewOrder(OrderBody):
    """Go to a place as the mount believes it; nothing is looked at."""

    moves = True
    kind: Literal["slew"] = "slew"
    target: Target
    at: _At = None


class CenterFields(AngleFields):
    """How near to come and by which means; bounds not given are the telescope's settings."""

    tolerance_arcsec: float | None = Field(default=None, gt=0, le=3600)
    max_tries: int | None = Field(default=None, ge=1, le=50)
    timeout_s: float | None = Field(default=None, gt=0, le=7200)
    correct_by: Literal["sync", "offset", "model"] | None = None
    planned_s: _Planned = None
    at: _At = None
    position_angle_deg: _PositionAngle | None = Field(default=None, description=_POSITION_ANGLE)

    @model_validator(mode="after")
    def _an_angle_to_be_near_to(self) -> Self:
        if self.position_angle_deg is None and (self.angle_tolerance_deg is not None or self.either_way):
            raise ValueError("angle_tolerance_deg and either_way are for a position_angle_deg")
        return self


class CenterOrder(CenterFields, OrderBody):
    """Slew, look, correct, and slew again until the target is at the frame's center, or at a point."""

    moves = True
    kind: Literal["center"] = "center"
    target: Target


class LookFields(Body):
    """How to look."""

    exposure_s: _Exposure = None
    persistent: bool = Field(
        default=False, description="Of a look: try all that is allowed and moves nothing, waiting included"
    )
    at: _At = Field(default=None, description="Of a look: tell where this point looks, too")


class LookOrder(LookFields, OrderBody):
    """Expose and solve: where it truly points. Moves and syncs nothing."""

    kind: Literal["look"] = "look"


class SyncOrder(OrderBody):
    """Look, and tell the mount where it truly points."""

    kind: Literal["sync"] = "sync"


class SyncToOrder(OrderBody):
    """Tell the mount that it points at these coordinates: a planetarium's sync, believed within bounds."""

    kind: Literal["sync-to"] = "sync-to"
    target: Target


class OffsetFields(Body):
    """How far to nudge, on the sky."""

    east_arcsec: float = Field(ge=-36_000, le=36_000)
    north_arcsec: float = Field(ge=-36_000, le=36_000)


class OffsetOrder(OffsetFields, OrderBody):
    """Nudge: slew by so much on the sky, east and north positive."""

    moves = True
    kind: Literal["offset"] = "offset"


class FlipOrder(OrderBody):
    """Let a German mount change sides, and center the target again."""

    moves = True
    kind: Literal["flip"] = "flip"
    target: Target
    planned_s: _Planned = None
    at: _At = None


class RotateFields(AngleFields):
    """To which angle the field is turned."""

    position_angle_deg: _PositionAngle = Field(description=_POSITION_ANGLE)
    exposure_s: _Exposure = None
    trust_count: bool = Field(
        default=False,
        description="An operator's word that the rotator's cables lie as its count says. Needs configure",
    )


class RotateOrder(RotateFields, OrderBody):
    """Turn the field to a position angle where the telescope stands; looks confirm it."""

    kind: Literal["rotate"] = "rotate"


_Pair = Annotated[tuple[float, float], Field(strict=False)]
"""JSON has lists alone: a strict tuple refuses every one of them. Its numbers stay strict."""


class MosaicFields(Body):
    """Which panels, how each is centered, and what it is left for."""

    across: int | None = Field(default=None, ge=1, le=100, description="Panels in a row; with `down`")
    down: int | None = Field(default=None, ge=1, le=100)
    overlap: float = Field(default=0.1, ge=0, le=0.9, description="Of neighbors, as a share of the field")
    width_deg: float | None = Field(
        default=None, gt=0, le=40, description="Of the field; left out: the look camera's, by solves"
    )
    height_deg: float | None = Field(default=None, gt=0, le=40)
    offsets_arcsec: list[_Pair] | None = Field(
        default=None,
        min_length=1,
        max_length=MOST_PANELS,
        description="Instead of across and down: places beside the target, each to the right and upwards",
    )
    pattern_angle_deg: float = Field(
        default=0.0, ge=0, lt=360, description="Position angle of the pattern's upward direction"
    )
    turn_field: bool = Field(
        default=False, description="Turn each image to its panel's angle; needs a rotator"
    )
    angle_tolerance_deg: float | None = Field(default=None, gt=0, le=90)
    snake: bool = Field(default=True, description="Every other row backwards")
    from_panel: int = Field(default=1, ge=1, le=10_000, description="What was done before isn't done again")
    until: Literal["next", "dwell"] = Field(
        default="next",
        description="next: each panel is kept until `POST /v1/jobs/{id}/next`; dwell: for dwell_s",
    )
    frames: int = Field(default=1, ge=1, le=10_000, description="So many `next` for each panel")
    dwell_s: float | None = Field(default=None, gt=0, le=43_200)
    most_s: float = Field(
        default=7200.0, gt=0, le=43_200, description="A camera program silent for so long has died"
    )
    tolerance_arcsec: float | None = Field(default=None, gt=0, le=3600)
    at: _At = None

    @model_validator(mode="after")
    def _one_pattern(self) -> Self:
        grid = self.across is not None and self.down is not None
        if grid is (self.offsets_arcsec is not None) or (self.across is None) is not (self.down is None):
            raise ValueError("either across and down, or offsets_arcsec")
        if (self.width_deg is None) is not (self.height_deg is None):
            raise ValueError("width_deg and height_deg, or neither")
        if (self.until == "dwell") is (self.dwell_s is None):
            raise ValueError("dwell_s is for until = dwell, and needed with it")
        return self


class MosaicOrder(MosaicFields, OrderBody):
    """Center each panel of a mosaic round the target, one after the other, and leave it to the camera."""

    moves = True
    kind: Literal["mosaic"] = "mosaic"
    target: Target


class SearchFields(Body):
    """How far a search goes."""

    radius_deg: float = Field(default=1.0, gt=0, le=10)
    step_share: float = Field(default=0.7, ge=0.1, le=1, description="Of the field's shorter side")
    field_deg: float | None = Field(
        default=None, ge=0.001, le=60, description="That side; left out: by what is known of the camera"
    )
    most_looks: int = Field(default=50, ge=1, le=1000)
    most_s: float = Field(default=1800.0, gt=0, le=14_400)
    exposure_s: _Exposure = None


class SpiralSearchOrder(SearchFields, OrderBody):
    """Look round the target, step by step, until a frame is solved, and center it; else go back."""

    moves = True
    kind: Literal["spiral-search"] = "spiral-search"
    target: Target


LONGEST_FOLLOW_S = 86_400
"""Longest time, s, for which one order follows a target; part of the interface (docs/openapi.json). Doubled,
a telescope follows into the night after."""


class FollowFields(Body):
    """Until when to follow a target, how near, and how often it is looked at."""

    duration_s: float | None = Field(
        default=None, gt=0, le=LONGEST_FOLLOW_S, description="For so long from now on; or until_utc"
    )
    until_utc: Instant | None = Field(
        default=None, description="Until then, at most a day ahead; or duration_s"
    )
    tolerance_arcsec: float | None = Field(default=None, gt=0, le=3600)
    exposure_s: _Exposure = Field(default=None, description="Of the looks")
    look_every_s: float | None = Field(
        default=None, ge=5, le=3600, description="Between two looks while all is well; left out: a minute"
    )
    at: _At = Field(default=None, description="To which point it is brought, by what solves have taught")

    @model_validator(mode="after")
    def _one_end(self) -> Self:
        if (self.duration_s is None) is (self.until_utc is None):
            raise ValueError("either duration_s or until_utc: following has an end")
        return self


class FollowOrder(FollowFields, OrderBody):
    """Center a target that moves among the stars, and track it until an end; looks confirm its rates.

    It ends earlier where its ephemeris ends or a limit is ahead. However it ends, the mount has no rates of
    its own afterwards.
    """

    moves = True
    kind: Literal["follow"] = "follow"
    target: Target


class ForgetRatesOrder(OrderBody):
    """Forget what looks have taught of how the mount keeps rates: they are sent as they are again."""

    kind: Literal["forget-rates"] = "forget-rates"


class ParkOrder(OrderBody):
    """Go to the park position and stay."""

    moves = True
    kind: Literal["park"] = "park"


class UnparkOrder(OrderBody):
    """Be ready to move again."""

    kind: Literal["unpark"] = "unpark"


class SetParkOrder(OrderBody):
    """Take the present place for the park position."""

    kind: Literal["set-park"] = "set-park"


class HomeOrder(OrderBody):
    """Go home, or find it by its sensors."""

    moves = True
    kind: Literal["home"] = "home"


class TrackingFields(Body):
    """Whether to follow the sky, and at which rate."""

    on: bool
    rate: RateWord = "sidereal"


class TrackingOrder(TrackingFields, OrderBody):
    """Follow the sky, or rest."""

    kind: Literal["tracking"] = "tracking"


class GuideOrder(OrderBody):
    """Move at the guide rate for a moment."""

    kind: Literal["guide"] = "guide"
    direction: Literal["n", "s", "e", "w"]
    duration_s: float = Field(gt=0, le=LONGEST_PULSE_S)


class MoveAxisFields(Body):
    """Which axis to move on, how fast, and for how long if nothing more is heard."""

    axis: Literal["primary", "secondary"] = Field(
        description="primary: right ascension, or azimuth; secondary: declination, or altitude"
    )
    rate_deg_s: float = Field(
        ge=-_FASTEST_DEG_S,
        le=_FASTEST_DEG_S,
        description="Degrees per second, on top of tracking. Positive: to greater right ascension (azimuth), "
        "to greater declination (altitude); 0 ends it. Speeds that the mount hasn't are refused",
    )
    for_s: float = Field(
        default=_USUAL_HELD_S,
        gt=0,
        le=LONGEST_HELD_S,
        description="It ends by itself after so many seconds, if no further order prolongs it",
    )
    job_id: str | None = Field(
        default=None,
        min_length=1,
        max_length=64,
        description="Goes into this job alone, the one that the first order of a motion began: refused once "
        "that has ended, so that an order that comes late moves nothing",
    )


class MoveAxisOrder(MoveAxisFields, OrderBody):
    """Move an axis on at a speed while somebody holds it; it ends by itself if no further order comes.

    A further one of the same caller prolongs the motion, or changes its speed, in the same job; 0 ends it.
    """

    moves = True
    kind: Literal["move-axis"] = "move-axis"


class OffsetRatesFields(Body):
    """At which rates to track beside the sidereal one, and until when; 0 and 0 end them."""

    ra_arcsec_s: float = Field(
        ge=-_FASTEST_ARCSEC_S,
        le=_FASTEST_ARCSEC_S,
        description="Change of the right ascension, arcseconds per second of the clock, not times cos(dec); "
        "positive to the east. In the mount's own coordinates",
    )
    dec_arcsec_s: float = Field(
        ge=-_FASTEST_ARCSEC_S,
        le=_FASTEST_ARCSEC_S,
        description="Change of the declination, arcseconds per second; positive to the north",
    )
    for_s: float = Field(
        default=_USUAL_RATES_S,
        gt=0,
        le=LONGEST_RATES_S,
        description="They end by themselves after so many seconds; limits are checked up to then",
    )


class OffsetRatesOrder(OffsetRatesFields, OrderBody):
    """Track at rates beside the sidereal one, up to an end: it goes back to a star's by itself then.

    The job ends when the mount has taken them; the rates go on. A further order changes or prolongs them, 0
    and 0 end them; so do a stop, a slew and a park.
    """

    kind: Literal["offset-rates"] = "offset-rates"


class TrustOrder(OrderBody):
    """An operator's word that the mount's position is right: give it after a look."""

    overrules = True
    kind: Literal["trust"] = "trust"


class SetSiteTimeOrder(OrderBody):
    """Set the mount's site and clock to this service's. Moves nothing; its position may count no more."""

    kind: Literal["set-site-time"] = "set-site-time"


class AcceptSiteTimeOrder(OrderBody):
    """Accept that mount and settings contradict each other on site or time, until that changes."""

    overrules = True
    kind: Literal["accept-site-time"] = "accept-site-time"


class RecoverOrder(OrderBody):
    """Tell a lost mount where it points: two looks anywhere in the sky that agree, then a sync."""

    kind: Literal["recover"] = "recover"
    exposure_s: _Exposure = None


class FirstLightOrder(OrderBody):
    """Tell a telescope set up by eye where it points, and learn its camera: looks and small moves."""

    moves = True
    kind: Literal["first-light"] = "first-light"
    exposure_s: _Exposure = None


class SolveOrder(OrderBody):
    """Solve a frame that lies on the service's machine; or expose one and solve it. Moves nothing."""

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
            raise ValueError("give give either path or exposure_s: a file is not exposed")
        of_a_file = hint is not None or self.blind is not None or self.budget_s is not None
        if self.path is None and of_a_file:
            raise ValueError("center, scale, blind and budget_s are for a file: give its path, too")
        return self


class SeriesOrder(OrderBody):
    """Look again and again while it tracks: how the field drifts, with errors."""

    kind: Literal["series"] = "series"
    target: Target | None = Field(default=None, description="Slewed to first; left out: where it stands")
    looks: int = Field(default=10, ge=3, le=1000)
    every_s: float = Field(
        default=0.0, ge=0, le=3600, description="From the beginning of a look to that of the next, at least"
    )
    exposure_s: _Exposure = None


_Within = Annotated[float, Field(gt=0, le=600)]


class HoldOrder(OrderBody):
    """Hold still by looks: drift, periodic error and flexure are corrected by guide pulses or rates."""

    kind: Literal["hold"] = "hold"
    target: Target | None = Field(
        default=None, description="Where the center should be; left out: where the first look finds it"
    )
    for_s: float | None = Field(
        default=None, ge=1, le=86_400, description="How long; left out: until it is cancelled or stopped"
    )
    every_s: float = Field(default=20.0, ge=0.5, le=3600, description="From look to look, at least")
    exposure_s: _Exposure = None
    by: Literal["pulses", "rates", "both"] | None = Field(
        default=None, description="Left out: pulses where the mount takes them, else rates"
    )
    looks: Literal["camera", "frames"] = Field(
        default="camera", description="The telescope's own, or the frames that are sent to it"
    )
    period_s: float | None = Field(
        default=None, ge=10, le=7200, description="Of the worm, if known; else it is found"
    )
    play_arcsec: float | None = Field(
        default=None, ge=0, le=600, description="Backlash in declination, if known; else it is learned"
    )


class DitherOrder(OrderBody):
    """Look elsewhere by a pattern's step; done when looks show that it has settled. Also while it holds."""

    kind: Literal["dither"] = "dither"
    pattern: Literal["random", "spiral", "ring"] = "random"
    bound: float = Field(default=10.0, gt=0, le=600, description="No step is farther from where it began")
    unit: Literal["arcsec", "px"] = Field(default="arcsec", description="Of bound and settle_within")
    steps: int = Field(default=9, ge=2, le=1000, description="Of a turn of the ring, or of a spiral")
    seed: int = Field(default=0, ge=0, le=2**31 - 1, description="The same steps for the same seed")
    number: int | None = Field(
        default=None, ge=0, le=100_000, description="Which step, 0 where it began; left out: the next one"
    )
    settle_within: _Within = 1.5
    settle_looks: int = Field(default=2, ge=1, le=20, description="So many in a row must be within that")
    timeout_s: float = Field(default=300.0, ge=1, le=7200)


class ModelRunOrder(OrderBody):
    """Look at points over the allowed sky, one after the other; make a pointing model, and judge it."""

    moves = True
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


NavigatorOrder = (
    SlewOrder
    | CenterOrder
    | LookOrder
    | SyncOrder
    | SyncToOrder
    | OffsetOrder
    | FlipOrder
    | FollowOrder
    | ForgetRatesOrder
    | ParkOrder
    | UnparkOrder
    | SetParkOrder
    | HomeOrder
    | TrackingOrder
    | GuideOrder
    | OffsetRatesOrder
    | TrustOrder
    | SetSiteTimeOrder
    | AcceptSiteTimeOrder
    | RecoverOrder
    | FirstLightOrder
    | RotateOrder
    | SpiralSearchOrder
)
"""Orders that a navigator carries out by itself: `api.orders.execute_order`."""

LongerOrder = SolveOrder | SeriesOrder | HoldOrder | DitherOrder | ModelRunOrder | MosaicOrder
"""Orders that need more than a navigator: `api.orders.longer_orders`."""

Order = Annotated[NavigatorOrder | LongerOrder | MoveAxisOrder, Field(discriminator="kind")]
"""Any order; the one list of them."""

KINDS: dict[str, type[OrderBody]] = {
    body.model_fields["kind"].default: body for body in get_args(get_args(Order)[0])
}
"""Each kind of order, and so of job, with its body: the members of `Order`."""

OrderKind = Annotated[str, Field(json_schema_extra={"enum": list(KINDS)})]
"""A kind where it is shown."""

MOVING = frozenset(kind for kind, body in KINDS.items() if body.moves)
"""Kinds of orders that slew the mount."""


def role_for(order: Order) -> Role:
    """Which role an order needs, by whatever face it comes: what overrules the guards needs more."""
    overrules = (
        order.overrules
        or (isinstance(order, ModelRunOrder) and order.put_in_force)
        or (isinstance(order, RotateOrder) and order.trust_count)
    )
    return Role.CONFIGURE if overrules else Role.OPERATE


def _place_or_target(schema: dict[str, Any]) -> None:
    """Say in the schema what `SlewBody` checks: a place, or a target, and no null for either."""
    for name in ("ra_deg", "dec_deg", "target"):
        written = schema["properties"][name]
        kept = next(one for one in written.pop("anyOf") if one.get("type") != "null")
        written.pop("default", None)
        schema["properties"][name] = {**kept, **written}
    schema["oneOf"] = [
        {"required": ["ra_deg", "dec_deg"], "not": {"required": ["target"]}},
        {
            "required": ["target"],
            "not": {"anyOf": [{"required": [name]} for name in ("ra_deg", "dec_deg", "frame")]},
        },
    ]


MadeOrder = TypeVar("MadeOrder", bound=OrderBody)


class ShortBody(Body):
    """A short REST form of an order: an order of that kind is made of those of its fields that it has."""

    def order(self, kind: type[MadeOrder]) -> MadeOrder:
        """As an order of this kind."""
        return kind(**{name: value for name, value in self._fields().items() if name in kind.model_fields})

    def _fields(self) -> dict[str, Any]:
        return dict(self)


class SlewBody(ShortBody):
    """Where to go: `ra_deg`, `dec_deg` and perhaps `frame`, or a `target`."""

    model_config = ConfigDict(json_schema_extra=_place_or_target)

    ra_deg: float | None = Field(default=None, ge=0, lt=360)
    dec_deg: float | None = Field(default=None, ge=-90, le=90)
    frame: Literal["icrs", "jnow-apparent"] = Field(
        default="icrs",
        description="jnow-apparent: true equator and equinox of now, geocentric, no refraction",
    )
    target: Target | None = Field(default=None, description="Instead of ra_deg and dec_deg")
    at: _At = None

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        flat = self.model_fields_set & {"ra_deg", "dec_deg", "frame"}
        for name in ("ra_deg", "dec_deg", "target"):
            if name in self.model_fields_set and getattr(self, name) is None:
                raise ValueError(f"{name} is null: leave it out")
        whole = self.ra_deg is not None and self.dec_deg is not None
        if self.target is None and not whole:
            raise ValueError("ra_deg and dec_deg are needed, or a target")
        if self.target is not None and flat:
            raise ValueError("either ra_deg and dec_deg, or a target: not both")
        return self

    @property
    def place(self) -> Target:
        """The target, however it was written."""
        if self.target is not None:
            return self.target
        assert self.ra_deg is not None
        assert self.dec_deg is not None
        if self.frame == "icrs":
            return IcrsTarget(ra_deg=self.ra_deg, dec_deg=self.dec_deg)
        return ApparentTarget(ra_deg=self.ra_deg, dec_deg=self.dec_deg)

    def _fields(self) -> dict[str, Any]:
        return {**dict(self), "target": self.place}


class CenterBody(CenterFields, SlewBody):
    """What to center; bounds not given are the telescope's settings."""


class FlipBody(SlewBody):
    """What to center on the other side of the pier."""

    planned_s: float | None = Field(default=None, gt=0, le=86_400)


class FollowBody(FollowFields, SlewBody):
    """What to follow, and until when."""


class RotateBody(RotateFields, ShortBody):
    """To which angle the field is turned."""


class MosaicBody(MosaicFields, SlewBody):
    """Which mosaic, and where its middle is."""


class SearchBody(SearchFields, SlewBody):
    """Round which place to search, and how far."""


class OffsetBody(OffsetFields, ShortBody):
    """How far to nudge, on the sky."""


class TrackingBody(TrackingFields, ShortBody):
    """Whether to follow the sky, and at which rate."""


class MoveAxisBody(MoveAxisFields, ShortBody):
    """Which axis to move on, how fast, and for how long if nothing more is heard."""


class OffsetRatesBody(OffsetRatesFields, ShortBody):
    """At which rates to track beside the sidereal one, and until when; 0 and 0 end them."""


class LookBody(LookFields, ShortBody):
    """How to look."""


class ExposureBody(ShortBody):
    """How long to expose, for orders that know themselves how to look."""

    exposure_s: _Exposure = None


def _example(summary: str, **value: Any) -> dict[str, Any]:
    return {"summary": summary, "value": value}


def _kind(kind: str, summary: str, **value: Any) -> dict[str, Any]:
    return _example(summary, kind=kind, **value)


_BARNARD = {
    "kind": "icrs",
    "ra_deg": 269.452,
    "dec_deg": 4.693,
    "pm_ra_cosdec_masyr": -798.6,
    "pm_dec_masyr": 10328.1,
    "parallax_mas": 548.3,
    "epoch_yr": 2000.0,
}

JOB_EXAMPLES: dict[str, Any] = {
    "center": _kind(
        "center",
        "Center an object by its name",
        target={"kind": "name", "name": "M31"},
        tolerance_arcsec=20.0,
    ),
    "slew": _kind("slew", "Go to a star that moves", target=_BARNARD),
    "slew-apparent": _kind(
        "slew", "Go to a place of date", target={"kind": "apparent", "ra_deg": 83.9, "dec_deg": -5.4}
    ),
    "slew-altaz": _kind(
        "slew", "Go to a direction", target={"kind": "altaz", "alt_deg": 60.0, "az_deg": 170.0}
    ),
    "look": _kind("look", "Where does it truly point?", exposure_s=2.0),
    "sync": _kind("sync", "Look, and tell the mount"),
    "solve": _kind("solve", "Expose and solve", exposure_s=2.0),
    "series": _kind("series", "Twenty looks, one a minute: the drift", looks=20, every_s=60.0),
    "hold": _kind("hold", "Hold still for an hour, a look each 20 s", for_s=3600.0, every_s=20.0),
    "dither": _kind("dither", "Ten pixels at the most, settled within one", bound=10.0, unit="px"),
    "model-run": _kind("model-run", "A pointing model of thirty points", points=30),
    "tracking": _kind("tracking", "Follow the Moon", on=True, rate="lunar"),
    "offset-rates": _kind(
        "offset-rates",
        "Track a comet by its rates, for half an hour",
        ra_arcsec_s=0.031,
        dec_arcsec_s=-0.012,
        for_s=1800.0,
    ),
    "move-axis": _kind(
        "move-axis",
        "Turn to the north by half a degree a second, as long as this comes again and again",
        axis="secondary",
        rate_deg_s=0.5,
        for_s=1.0,
    ),
    "follow": _kind(
        "follow",
        "Follow the Moon for an hour",
        target={"kind": "name", "name": "Moon"},
        duration_s=3600.0,
        tolerance_arcsec=10.0,
    ),
    "center-slit": _kind(
        "center",
        "Bring a star to the slit, and the slit along an angle",
        target={"kind": "name", "name": "Vega"},
        at="slit",
        position_angle_deg=35.0,
    ),
    "rotate": _kind("rotate", "North up, or on its head", position_angle_deg=0.0, either_way=True),
    "mosaic": _kind(
        "mosaic",
        "Two by three panels, twenty frames each",
        target={"kind": "name", "name": "M31"},
        across=2,
        down=3,
        overlap=0.15,
        frames=20,
    ),
    "spiral-search": _kind(
        "spiral-search", "Look round a place", target=_BARNARD, radius_deg=1.5, exposure_s=20.0
    ),
    "park": _kind("park", "Park"),
    "home": _kind("home", "Go home"),
    "unpark": _kind("unpark", "Be ready to move again"),
}

PLACE_EXAMPLES: dict[str, Any] = {
    "icrs": _example("A place in the ICRS", ra_deg=10.6847, dec_deg=41.2688),
    "apparent": _example("A place of date", ra_deg=11.05, dec_deg=41.41, frame="jnow-apparent"),
    "target": _example("A target", target={"kind": "name", "name": "Vega"}),
}
