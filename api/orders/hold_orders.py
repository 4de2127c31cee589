"""The orders hold and dither: plans made of their bodies, and what they tell and bring, as JSON models."""

from __future__ import annotations

from collections.abc import Callable

from api.orders.execute_order import there
from api.orders.results import (
    BendingView,
    DitherView,
    HoldKnownView,
    HoldLookView,
    HoldView,
    TrendView,
    mount_place,
    place,
)
from api.orders.vocabulary import DitherOrder, HoldOrder
from mountnav.clock import Clock, SystemClock
from mountnav.guiding.dither import DitherPlan
from mountnav.guiding.trends import Trend
from mountnav.navigation.holding import (
    DitherReport,
    DitherWish,
    HoldKnown,
    HoldPlan,
    HoldProgress,
)
from mountnav.navigation.navigator import Navigator

__all__ = ["KEPT_EVERY_S", "run_dither", "run_hold"]

KEPT_EVERY_S = 60.0
"""A look of a hold is kept with its job no oftener than this, s, but for those that tell of trouble; each is
an event. Halved, the row of a night's hold is twice as long."""
_KEPT_MOST = 1500
"""Looks that are kept with a job at the most: a day's, one a minute."""

Tell = Callable[[str, dict[str, object]], None]
"""Called with the kind of an event and its data."""


async def run_hold(
    navigator: Navigator, order: HoldOrder, tell: Tell, clock: Clock | None = None
) -> HoldView:
    """Carry it out.

    Parameters
    ----------
    tell : callable
        Told of each look as "hold-look", and of those that are kept as "attempt".

    Raises
    ------
    SolveFailed, MountMoved, DeviceRefused, OutsideLimits, DeviceError, JournalFailed
        As `mountnav.navigation.holding.Holding.run`.
    """
    plan = HoldPlan(
        target=None if order.target is None else there(navigator, order.target),
        for_s=order.for_s,
        every_s=order.every_s,
        exposure_s=order.exposure_s,
        by=order.by,
        looks=order.looks,
        period_s=order.period_s,
        play_arcsec=order.play_arcsec,
    )
    report = await navigator.hold(plan, _Telling(tell, clock or SystemClock()))
    return HoldView(
        target=place(report.target),
        target_mount=mount_place(report.target, navigator.mount.epoch, report.ended_utc),
        looks=report.looks,
        solved=report.solved,
        gated=report.gated,
        jumps=report.jumps,
        corrections=report.corrections,
        rms_arcsec=report.rms_arcsec,
        began_utc=report.began_utc,
        ended_utc=report.ended_utc,
        by=report.by,  # type: ignore[arg-type]
        known=_known(report.known),
    )


async def run_dither(
    navigator: Navigator, order: DitherOrder, tell: Tell, clock: Clock | None = None
) -> DitherView:
    """Carry it out: within the hold that is under way, or by itself.

    Raises
    ------
    Busy, Cancelled, TargetNotReached
    OutsideLimits, SolveFailed, DeviceError, JournalFailed
    """
    wish = DitherWish(
        plan=DitherPlan(order.pattern, order.bound, order.steps, order.seed),
        unit=order.unit,
        number=order.number,
        settle_within=order.settle_within,
        settle_looks=order.settle_looks,
        timeout_s=order.timeout_s,
    )
    report: DitherReport = await navigator.dither(wish, _Telling(tell, clock or SystemClock()))
    return DitherView(
        number=report.number,
        east_arcsec=report.east_arcsec,
        north_arcsec=report.north_arcsec,
        off_arcsec=report.off_arcsec,
        looks=report.looks,
        elapsed_s=report.elapsed_s,
    )


class _Telling:
    """Tells each step, and keeps some."""

    def __init__(self, tell: Tell, clock: Clock) -> None:
        self._tell, self._clock = tell, clock
        self._kept_s = -float("inf")
        self._kept = 0

    def __call__(self, step: HoldProgress) -> None:
        view = _look(step).model_dump(mode="json")
        now_s = self._clock.monotonic_s()
        due = now_s - self._kept_s >= KEPT_EVERY_S or step.fate in ("gated", "jump")
        if due and self._kept < _KEPT_MOST:
            self._kept_s, self._kept = now_s, self._kept + 1
            self._tell("attempt", view)
        else:
            self._tell("hold-look", view)


def _look(step: HoldProgress) -> HoldLookView:
    return HoldLookView(
        number=step.number,
        utc=step.utc,
        fate=step.fate,  # type: ignore[arg-type]
        east_arcsec=step.east_arcsec,
        north_arcsec=step.north_arcsec,
        sigma_arcsec=step.sigma_arcsec,
        step_east_arcsec=step.step_east_arcsec,
        step_north_arcsec=step.step_north_arcsec,
        rate_east_arcsec_s=step.rate_east_arcsec_s,
        rate_north_arcsec_s=step.rate_north_arcsec_s,
        rms_arcsec=step.rms_arcsec,
        dithered_east_arcsec=step.dithered[0],
        dithered_north_arcsec=step.dithered[1],
        settled=step.settled,
        problem=step.problem,
        known=None if step.known is None else _known(step.known),
    )


def _known(known: HoldKnown) -> HoldKnownView:
    bending = known.bending
    return HoldKnownView(
        drift_east_arcsec_min=known.drift_east_arcsec_min,
        drift_east_sigma_arcsec_min=known.drift_east_sigma_arcsec_min,
        drift_north_arcsec_min=known.drift_north_arcsec_min,
        drift_north_sigma_arcsec_min=known.drift_north_sigma_arcsec_min,
        period_s=known.period_s,
        amplitudes_arcsec=list(known.amplitudes_arcsec),
        amplitude_sigma_arcsec=known.amplitude_sigma_arcsec,
        noise_arcsec=known.noise_arcsec,
        gain=known.gain,
        gain_sigma=known.gain_sigma,
        play_arcsec=known.play_arcsec,
        play_sigma_arcsec=known.play_sigma_arcsec,
        rotation_deg=_trend(known.rotation),
        bending=None
        if bending is None
        else BendingView(east=_line(bending.east), north=_line(bending.north)),
    )


def _line(trend: Trend) -> TrendView:
    return TrendView(
        rate_per_h=trend.rate_per_h,
        sigma_per_h=trend.sigma_per_h,
        now=trend.now,
        scatter=trend.scatter,
        points=trend.points,
    )


def _trend(trend: Trend | None) -> TrendView | None:
    return None if trend is None else _line(trend)
