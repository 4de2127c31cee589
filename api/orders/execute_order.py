"""What each order is to a navigator: the one place where orders of all faces become the telescope's."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from datetime import datetime, timedelta
from typing import assert_never

from api.orders.results import RatesView
from api.orders.targets import Target, ephemeris_of, icrs_of, moves, require_filter
from api.orders.vocabulary import (
    AcceptSiteTimeOrder,
    CenterOrder,
    FirstLightOrder,
    FlipOrder,
    FollowOrder,
    ForgetRatesOrder,
    GuideOrder,
    HomeOrder,
    LookOrder,
    NavigatorOrder,
    OffsetOrder,
    OffsetRatesOrder,
    ParkOrder,
    PixelAt,
    RecoverOrder,
    RotateOrder,
    SetParkOrder,
    SetSiteTimeOrder,
    SlewOrder,
    SpiralSearchOrder,
    SyncOrder,
    SyncToOrder,
    TrackingOrder,
    TrustOrder,
    UnparkOrder,
)
from mountnav.clock import utc_now
from mountnav.devices import Direction, OffsetRates, TrackingRate
from mountnav.ephemeris import Ephemeris
from mountnav.navigation.aim_points import AimPoint, PixelPoint
from mountnav.navigation.follow_report import FollowReport
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.rotating import FieldAngle
from mountnav.navigation.searching import SearchBounds
from mountnav.sky.coordinates import Icrs

Work = Callable[[Navigator], Awaitable[object]]


def work_of(order: NavigatorOrder) -> Work:
    """An order as something to do with a navigator."""

    async def work(navigator: Navigator) -> object:
        return await execute_order(navigator, order)

    return work


async def execute_order(navigator: Navigator, order: NavigatorOrder) -> object:
    """Do it.

    Returns
    -------
    object
        A report of `mountnav.navigation.reports`, an outcome, or None.

    Raises
    ------
    MountnavError
        As the navigator's.
    """
    match order:
        case SlewOrder():
            return await navigator.slew(goal(navigator, order.target), at=point_of(order.at))
        case CenterOrder():
            return await navigator.center(
                goal(navigator, order.target),
                tolerance_arcsec=order.tolerance_arcsec,
                max_tries=order.max_tries,
                timeout_s=order.timeout_s,
                correct_by=order.correct_by,
                planned_s=order.planned_s,
                at=point_of(order.at),
                angle=None if order.position_angle_deg is None else _angle(order.position_angle_deg, order),
            )
        case LookOrder():
            return await navigator.look(order.exposure_s, persistent=order.persistent, at=point_of(order.at))
        case SyncOrder():
            return await navigator.sync()
        case SyncToOrder():
            return await navigator.sync_to(there(navigator, order.target))
        case OffsetOrder():
            return await navigator.offset(order.east_arcsec, order.north_arcsec)
        case FlipOrder():
            return await navigator.flip(
                goal(navigator, order.target), planned_s=order.planned_s, at=point_of(order.at)
            )
        case RotateOrder():
            angle = _angle(order.position_angle_deg, order)
            return await navigator.rotate(angle, exposure_s=order.exposure_s, trust_count=order.trust_count)
        case SpiralSearchOrder():
            return await navigator.spiral_search(
                goal(navigator, order.target),
                SearchBounds(
                    order.radius_deg, order.step_share, order.field_deg, order.most_looks, order.most_s
                ),
                exposure_s=order.exposure_s,
            )
        case FollowOrder():
            return await _follow(navigator, order)
        case RecoverOrder():
            return await navigator.recover(order.exposure_s)
        case FirstLightOrder():
            return await navigator.first_light(order.exposure_s)
        case ParkOrder():
            return await navigator.park()
        case HomeOrder():
            return await navigator.home()
        case UnparkOrder():
            await navigator.unpark()
        case SetParkOrder():
            await navigator.set_park()
        case TrackingOrder():
            await navigator.set_tracking(order.on, TrackingRate(order.rate))
        case GuideOrder():
            await navigator.guide(Direction(order.direction), order.duration_s)
        case OffsetRatesOrder():
            return await set_rates(navigator, order)
        case ForgetRatesOrder():
            await navigator.forget_rates()
        case TrustOrder():
            navigator.trust()
        case SetSiteTimeOrder():
            await navigator.set_site_and_time()
        case AcceptSiteTimeOrder():
            navigator.accept_site_and_time()
        case _:
            assert_never(order)
    return None


async def set_rates(navigator: Navigator, order: OffsetRatesOrder) -> RatesView:
    """Track at these rates up to their end, or as for a star again; which ones are in force then."""
    mount = navigator.mount
    rates = OffsetRates(order.ra_arcsec_s, order.dec_arcsec_s)
    if rates.none:
        await mount.end_offset_rates()
    else:
        await mount.set_offset_rates(rates, ends_utc=utc_now() + timedelta(seconds=order.for_s))
    force = mount.offset_rates_in_force
    if force is None:
        return RatesView(ra_arcsec_s=0.0, dec_arcsec_s=0.0, ends_utc=None)
    return RatesView(
        ra_arcsec_s=force.rates.ra_arcsec_s, dec_arcsec_s=force.rates.dec_arcsec_s, ends_utc=force.ends_utc
    )


def point_of(at: str | PixelAt | None) -> AimPoint | str | None:
    """To which point, as navigation takes it."""
    return PixelPoint("", at.x_px, at.y_px) if isinstance(at, PixelAt) else at


def _angle(position_angle_deg: float, order: CenterOrder | RotateOrder) -> FieldAngle:
    return FieldAngle(position_angle_deg, order.angle_tolerance_deg, order.either_way)


def there(navigator: Navigator, target: Target) -> Icrs:
    """Where a target is now. Raises `BadRequest`, and `OutsideLimits` for the Sun without a filter."""
    mount = navigator.mount
    require_filter(target, solar_filter=navigator.limits.solar_filter)
    return icrs_of(target, utc_now(), mount.site, mount.air)


def goal(navigator: Navigator, target: Target) -> Icrs | Ephemeris:
    """A target as navigation takes it: one that moves among the stars with all its path.

    Raises
    ------
    BadRequest
    OutsideLimits
        The Sun, and there is no filter.
    """
    if not moves(target):
        return there(navigator, target)
    mount = navigator.mount
    require_filter(target, solar_filter=navigator.limits.solar_filter)
    return ephemeris_of(target, utc_now(), mount.site, mount.air)


async def _follow(navigator: Navigator, order: FollowOrder) -> FollowReport:
    mount, now = navigator.mount, utc_now()
    require_filter(order.target, solar_filter=navigator.limits.solar_filter)
    # a fixed place is followed as one that doesn't move: its looks judge how the mount tracks
    target = ephemeris_of(order.target, now, mount.site, mount.air)
    if order.until_utc is not None:
        until = datetime.fromisoformat(order.until_utc)
    else:
        assert order.duration_s is not None
        until = now + timedelta(seconds=order.duration_s)
    return await navigator.follow(
        target,
        until_utc=until,
        tolerance_arcsec=order.tolerance_arcsec,
        exposure_s=order.exposure_s,
        look_every_s=order.look_every_s,
        at=point_of(order.at),
    )


__all__ = ["Work", "execute_order", "goal", "point_of", "there", "work_of"]
