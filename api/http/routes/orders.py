"""Orders to telescopes: any kind as a job's body, and a short form for each of the usual ones."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Body

from api.http.job_requests import STARTING, TheOrdering
from api.orders.job_views import JobView
from api.orders.vocabulary import (
    JOB_EXAMPLES,
    PLACE_EXAMPLES,
    CenterBody,
    CenterOrder,
    DitherOrder,
    ExposureBody,
    FirstLightOrder,
    FlipBody,
    FlipOrder,
    FollowBody,
    FollowOrder,
    HoldOrder,
    HomeOrder,
    LookBody,
    LookOrder,
    MosaicBody,
    MosaicOrder,
    MoveAxisBody,
    MoveAxisOrder,
    OffsetBody,
    OffsetOrder,
    OffsetRatesBody,
    OffsetRatesOrder,
    Order,
    ParkOrder,
    RecoverOrder,
    RotateBody,
    RotateOrder,
    SearchBody,
    SlewBody,
    SlewOrder,
    SpiralSearchOrder,
    SyncOrder,
    TrackingBody,
    TrackingOrder,
    TrustOrder,
    UnparkOrder,
)

router = APIRouter(prefix="/telescopes/{telescope_id}", tags=["orders"])

_Order = Annotated[Order, Body(openapi_examples=JOB_EXAMPLES)]
_Slew = Annotated[SlewBody, Body(openapi_examples=PLACE_EXAMPLES)]
_Center = Annotated[CenterBody, Body(openapi_examples=PLACE_EXAMPLES)]
_Look = Annotated[LookBody | None, Body()]
_Exposure = Annotated[ExposureBody | None, Body()]
_Hold = Annotated[HoldOrder | None, Body()]
_Dither = Annotated[DitherOrder | None, Body()]


@router.post("/jobs", status_code=202, responses=STARTING)
async def start_job(ordering: TheOrdering, body: _Order) -> JobView:
    """Order anything that a telescope does; `kind` says what. The job has begun when this is answered."""
    return await ordering.take(body)


@router.post("/slew", status_code=202, responses=STARTING)
async def slew_telescope(ordering: TheOrdering, body: _Slew) -> JobView:
    """Slew to a place by the mount's own pointing and the model in force. No frame is taken."""
    return await ordering.take(body.order(SlewOrder))


@router.post("/center", status_code=202, responses=STARTING)
async def center_telescope(ordering: TheOrdering, body: _Center) -> JobView:
    """Slew, look, sync, and slew again until the target is at the frame's center."""
    return await ordering.take(body.order(CenterOrder))


@router.post("/flip", status_code=202, responses=STARTING)
async def flip_telescope(ordering: TheOrdering, body: FlipBody) -> JobView:
    """Let a German mount change sides, and center the target again, whatever was synced before."""
    return await ordering.take(body.order(FlipOrder))


@router.post("/rotate", status_code=202, responses=STARTING)
async def rotate_telescope(ordering: TheOrdering, body: RotateBody) -> JobView:
    """Turn the field to a position angle where the telescope stands; looks confirm it."""
    return await ordering.take(body.order(RotateOrder))


@router.post("/mosaic", status_code=202, responses=STARTING)
async def mosaic_telescope(ordering: TheOrdering, body: MosaicBody) -> JobView:
    """Center each panel of a mosaic, one after the other, and leave it to the camera until it is done there.

    With `until` = next each panel is kept until `POST /v1/jobs/{id}/next` was called `frames` times.
    """
    return await ordering.take(body.order(MosaicOrder))


@router.post("/spiral-search", status_code=202, responses=STARTING)
async def search_with_telescope(ordering: TheOrdering, body: SearchBody) -> JobView:
    """Look round a place, step by step, until a frame is solved, and center the place; else go back."""
    return await ordering.take(body.order(SpiralSearchOrder))


@router.post("/follow", status_code=202, responses=STARTING)
async def follow_telescope(ordering: TheOrdering, body: FollowBody) -> JobView:
    """Center a target that moves among the stars, and track it until an end; looks confirm its rates.

    By rates where the mount takes them, else by guide pulses or small slews; a target that is too fast for it
    is refused with the numbers. However it ends, the mount has no rates of its own afterwards.
    """
    return await ordering.take(body.order(FollowOrder))


@router.post("/look", status_code=202, responses=STARTING)
async def look_telescope(ordering: TheOrdering, body: _Look = None) -> JobView:
    """Take a frame and solve it: where the telescope truly points. Moves and syncs nothing.

    The body may be left out.
    """
    return await ordering.take(LookOrder() if body is None else body.order(LookOrder))


@router.post("/sync", status_code=202, responses=STARTING)
async def sync_telescope(ordering: TheOrdering) -> JobView:
    """Take a frame, solve it, and tell the mount where it truly points. Needs no body."""
    return await ordering.take(SyncOrder())


@router.post("/recover", status_code=202, responses=STARTING)
async def recover_telescope(ordering: TheOrdering, body: _Exposure = None) -> JobView:
    """Tell a lost mount where it points: two looks anywhere in the sky that agree, then a sync. Never moves.

    However far the place is from what the mount believes; it must stand within the telescope's limits now.
    The body may be left out.
    """
    return await ordering.take(RecoverOrder() if body is None else body.order(RecoverOrder))


@router.post("/first-light", status_code=202, responses=STARTING)
async def first_light_telescope(ordering: TheOrdering, body: _Exposure = None) -> JobView:
    """Tell a telescope that was set up by eye where it points, and learn its camera: the first night's order.

    Looks, a small move within the limits that shows in which posture the mount stands, a sync, and two more
    small moves. Up to 10° off. The body may be left out.
    """
    return await ordering.take(FirstLightOrder() if body is None else body.order(FirstLightOrder))


@router.post("/hold", status_code=202, responses=STARTING)
async def hold_telescope(ordering: TheOrdering, body: _Hold = None) -> JobView:
    """Keep the target still by looks, until the time is over or the job is cancelled. It tracks on.

    The body may be left out. Each look is an event; one a minute is kept with the job.
    """
    return await ordering.take(HoldOrder() if body is None else body)


@router.post("/dither", status_code=202, responses=STARTING)
async def dither_telescope(ordering: TheOrdering, body: _Dither = None) -> JobView:
    """Move by the next step of a dither pattern; the job succeeds when looks show it settled.

    A hold that is under way goes on at the new place. The body may be left out.
    """
    return await ordering.take(DitherOrder() if body is None else body)


@router.post("/offset", status_code=202, responses=STARTING)
async def offset_telescope(ordering: TheOrdering, body: OffsetBody) -> JobView:
    """Slew by a small distance on the sky, east and north positive. No frame is taken."""
    return await ordering.take(body.order(OffsetOrder))


@router.post("/move-axis", status_code=202, responses=STARTING)
async def move_telescope_axis(ordering: TheOrdering, body: MoveAxisBody) -> JobView:
    """Move an axis while a key is held: send it again and again. It ends after `for_s`, or by rate 0.

    One job holds both axes. Further orders of the same caller go into it: they prolong the motion, or change
    its speed. A key of theirs counts once as well: an order that comes again moves nothing again.
    """
    return await ordering.take(body.order(MoveAxisOrder))


@router.post("/offset-rates", status_code=202, responses=STARTING)
async def set_telescope_rates(ordering: TheOrdering, body: OffsetRatesBody) -> JobView:
    """Track at rates beside the sidereal one, up to an end; limits are checked up to it. 0 and 0 end them."""
    return await ordering.take(body.order(OffsetRatesOrder))


@router.post("/tracking", status_code=202, responses=STARTING)
async def track_telescope(ordering: TheOrdering, body: TrackingBody) -> JobView:
    """Let the mount track the sky at a rate, or stand still. Nothing is slewed."""
    return await ordering.take(body.order(TrackingOrder))


@router.post("/park", status_code=202, responses=STARTING)
async def park_telescope(ordering: TheOrdering) -> JobView:
    """Slew to the park position and stay there, not tracking. Needs no body."""
    return await ordering.take(ParkOrder())


@router.post("/unpark", status_code=202, responses=STARTING)
async def unpark_telescope(ordering: TheOrdering) -> JobView:
    """Take a parked mount back into use; it stays where it is. Needs no body."""
    return await ordering.take(UnparkOrder())


@router.post("/home", status_code=202, responses=STARTING)
async def home_telescope(ordering: TheOrdering) -> JobView:
    """Slew to the home position, or find it by the mount's sensors. Needs no body."""
    return await ordering.take(HomeOrder())


@router.post("/trust", status_code=202, responses=STARTING)
async def trust_telescope(ordering: TheOrdering) -> JobView:
    """Say, as an operator, that the mount's position is right. Give this word after a look. Needs no body."""
    return await ordering.take(TrustOrder())
