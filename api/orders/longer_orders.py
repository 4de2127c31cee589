"""The orders that need more than a navigator: solve, series, hold, dither and model-run."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from api.access.security import allowed_file
from api.observatory.observatory import Heard, Observatory
from api.orders.execute_order import Work, point_of, there
from api.orders.hold_orders import run_dither, run_hold
from api.orders.results import (
    DriftView,
    MosaicView,
    PanelView,
    SeriesLookView,
    SeriesView,
    SolvedView,
    mount_place,
    place,
)
from api.orders.vocabulary import (
    DitherOrder,
    HoldOrder,
    LongerOrder,
    ModelRunOrder,
    MosaicOrder,
    SeriesOrder,
    SolveOrder,
)
from api.solver.hints import make_hint
from api.solver.link import Upload
from api.solver.solve_record import solve_record
from api.solver.solver import Solver
from mountnav.clock import Clock, SystemClock, utc_now
from mountnav.errors import BadFrame, BadRequest, MountMoved, SolveFailed
from mountnav.files import open_plain
from mountnav.navigation.mosaicking import MosaicWait, PanelReport
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.reports import Look
from mountnav.series.drift import LEAST_FRAMES, Drift, Track, fit_drift, joined, jumps
from mountnav.settings.observatory import Settings
from mountnav.sky.coordinates import Icrs
from mountnav.sky.patterns import Panel, mosaic, offsets
from mountnav.sky.sphere import offset_arcsec
from mountnav.solution import Reason

__all__ = ["FAILURES_IN_A_ROW", "LongerOrders", "Tell", "drift_of", "run_series", "solve_frame"]


async def solve_frame(
    navigator: Navigator, order: SolveOrder, *, solver: Solver, folders: Sequence[Path]
) -> SolvedView | Look:
    """Carry it out.

    Parameters
    ----------
    folders : sequence of Path
        That frames may be taken from.

    Raises
    ------
    BadRequest, Unknown
        The file may not be read, or isn't there; half a hint.
    BadFrame, SolveFailed
    """
    if order.path is None:
        return await navigator.look(order.exposure_s)
    hint = make_hint(
        order.ra_deg, order.dec_deg, order.radius_deg, order.scale_low_arcsec_px, order.scale_high_arcsec_px
    )
    path = await asyncio.to_thread(allowed_file, Path(order.path), folders, telescope_id=navigator.name)
    settings = navigator.solving
    settings = replace(
        settings, blind=order.blind or settings.blind, budget_s=order.budget_s or settings.budget_s
    )
    try:
        file = await asyncio.to_thread(open_plain, path)
    except OSError as trouble:
        raise BadFrame(f"the file can't be read: {trouble.strerror}", device=str(path)) from trouble
    with file:
        verdict = await solver.solve_upload(
            Upload(path.name, file.fileno()), hint, settings, owner=navigator.name
        )
    if verdict.reason is Reason.BAD_FRAME:
        raise BadFrame(verdict.detail or str(verdict.reason), device=str(path))
    solution = verdict.solution
    if solution is None:
        why = str(verdict.reason or "not solved")
        raise SolveFailed(
            f"{path.name}: {why}" + (f": {verdict.detail}" if verdict.detail else ""),
            device=navigator.name,
            advice="give a place and a scale, or blind = after",
            reason=why,
        )
    return SolvedView(
        path=str(path),
        seen=place(solution.center),
        seen_mount=mount_place(solution.center, navigator.mount.epoch, utc_now()),
        record=solve_record(path.name, verdict),
    )


Tell = Callable[[dict[str, object]], None]
"""Called with each attempt."""

FAILURES_IN_A_ROW = 5
"""Looks that may fail one after the other before a series or a model run is given up, as under clouds;
chosen by hand. Doubled, it takes five more exposures until then."""
LEAST_JUMP_PX = 3.0
"""No smaller departure from the usual rate is called a jump; as for series of frames."""


@dataclass(frozen=True, slots=True)
class _Seen:
    number: int
    look: Look


async def run_series(
    navigator: Navigator, order: SeriesOrder, tell: Tell, clock: Clock | None = None
) -> SeriesView:
    """Carry it out.

    Parameters
    ----------
    tell : callable
        Told of each look.

    Raises
    ------
    SolveFailed
        Five looks in a row were not solved.
    OutsideLimits, TargetNotReached, DeviceError, JournalFailed
        Of the slew, or of the camera.
    """
    clock = clock or SystemClock()
    target: Icrs | None = None
    if order.target is not None:
        target = there(navigator, order.target)
        await navigator.slew(target)
    began_utc = clock.utc()
    seen: list[_Seen] = []
    failed = 0
    for number in range(1, order.looks + 1):
        began_s = clock.monotonic_s()
        try:
            look = await navigator.look(order.exposure_s)
        except (SolveFailed, MountMoved, BadFrame) as error:
            failed += 1
            view = SeriesLookView(number=number, solved=False, problem=error.what)
        else:
            failed = 0
            seen.append(_Seen(number, look))
            view = _view(number, look, seen[0].look)
        tell(view.model_copy(update={"elapsed_s": clock.monotonic_s() - began_s}).model_dump(mode="json"))
        if failed >= FAILURES_IN_A_ROW:
            raise SolveFailed(
                f"{failed} looks in a row were not solved: stopped after {number} of {order.looks}",
                device=navigator.name,
                advice="check for clouds, dew and focus; the solved looks are in the journal",
                reason="given up",
            )
        left_s = order.every_s - (clock.monotonic_s() - began_s)
        if left_s > 0 and number < order.looks:
            await clock.sleep(left_s)
    if not seen:
        raise SolveFailed(
            "no look was solved",
            device=navigator.name,
            advice="check for clouds, dew and focus",
            reason="none",
        )
    # the first fit loads scipy: not in the loop, where a stop would wait for that
    drift, at = await asyncio.to_thread(drift_of, [taken.look for taken in seen])
    return _summed_up(navigator, order, target, seen, drift, at, began_utc, clock)


def _view(number: int, look: Look, first: Look) -> SeriesLookView:
    off = offset_arcsec(look.seen, first.seen)
    return SeriesLookView(
        number=number,
        solved=True,
        mid_exposure_utc=look.mid_exposure_utc,
        ra_deg=look.seen.ra_deg,
        dec_deg=look.seen.dec_deg,
        sigma_arcsec=look.solution.center_sigma_arcsec,
        east_arcsec=off.east_arcsec,
        north_arcsec=off.north_arcsec,
        pairs=look.solution.pairs,
        look_id=look.look_id,
    )


def _summed_up(
    navigator: Navigator,
    order: SeriesOrder,
    target: Icrs | None,
    seen: list[_Seen],
    drift: Drift | None,
    at: list[int],
    began_utc: datetime,
    clock: Clock,
) -> SeriesView:
    epoch = navigator.mount.epoch
    first, last = seen[0].look, seen[-1].look
    reason = None
    if drift is None:
        reason = f"{len(seen)} looks solved without a jump between them; {LEAST_FRAMES} are needed"
    return SeriesView(
        target=None if target is None else place(target),
        target_mount=None if target is None else mount_place(target, epoch, began_utc),
        first=place(first.seen),
        first_mount=mount_place(first.seen, epoch, first.mid_exposure_utc),
        last=place(last.seen),
        last_mount=mount_place(last.seen, epoch, last.mid_exposure_utc),
        looks=order.looks,
        solved=len(seen),
        began_utc=began_utc,
        ended_utc=clock.utc(),
        drift=None if drift is None else _drift_view(drift),
        jumps=[seen[index].number for index in at],
        reason=reason,
    )


def drift_of(looks: list[Look]) -> tuple[Drift | None, list[int]]:
    """Fit the drift of solved looks, jumps left out.

    Parameters
    ----------
    looks : list of Look
        In order of time.

    Returns
    -------
    Drift or None
        None for fewer than three looks between two jumps.
    list of int
        Indices of the looks that a jump led to.
    """
    start = looks[0].mid_exposure_utc
    sigma = np.array([max(look.solution.center_sigma_arcsec, 1e-3) for look in looks])
    track = Track(
        minutes=np.array([(look.mid_exposure_utc - start).total_seconds() / 60.0 for look in looks]),
        ra_deg=np.array([look.seen.ra_deg for look in looks]),
        dec_deg=np.array([look.seen.dec_deg for look in looks]),
        sigma_arcsec=sigma,
        # each look is solved by itself: its error is its own
        anchor=np.zeros(len(looks), dtype=np.int64),
        anchor_sigma_arcsec=np.zeros(len(looks)),
    )
    scale = float(np.median([look.solution.scale_arcsec_px for look in looks]))
    at = jumps(track, LEAST_JUMP_PX * scale)
    edges = [0, *at, len(looks)]
    parts = [fit_drift(track.part(low, high)) for low, high in pairwise(edges)]
    return joined([part for part in parts if part is not None]), at


def _drift_view(drift: Drift) -> DriftView:
    return DriftView(
        ra_cosdec_arcsec_min=drift.ra_arcsec_min,
        ra_cosdec_sigma_arcsec_min=drift.ra_sigma_arcsec_min,
        dec_arcsec_min=drift.dec_arcsec_min,
        dec_sigma_arcsec_min=drift.dec_sigma_arcsec_min,
        rms_arcsec=drift.rms_arcsec,
        looks=drift.frames,
        outliers=drift.outliers,
    )


async def run_mosaic(navigator: Navigator, order: MosaicOrder, tell: Tell) -> MosaicView:
    """Carry it out.

    Parameters
    ----------
    tell : callable
        Told of each panel when it is centered, and when it ends.

    Raises
    ------
    BadRequest
        How large the field is isn't known, or it makes no mosaic; nothing moved.
    OutsideLimits, TargetNotReached, DeviceError, JournalFailed
    """
    panels = panels_of(navigator, order)
    wait = MosaicWait(order.until, order.dwell_s or 0.0, order.frames, order.most_s)
    began_utc = utc_now()

    def heard(report: PanelReport) -> None:
        tell(panel_view(report, len(panels)).model_dump(mode="json"))

    report = await navigator.mosaic(
        panels,
        wait=wait,
        from_panel=order.from_panel,
        turned=order.turn_field,
        angle_tolerance_deg=order.angle_tolerance_deg,
        tolerance_arcsec=order.tolerance_arcsec,
        at=point_of(order.at),
        heard=heard,
    )
    return MosaicView(
        panels=[panel_view(one, len(panels)) for one in report.panels],
        missing=list(report.missing),
        notes=list(report.notes),
        began_utc=began_utc,
        ended_utc=utc_now(),
        elapsed_s=report.elapsed_s,
    )


def panels_of(navigator: Navigator, order: MosaicOrder) -> tuple[Panel, ...]:
    """The panels of an order. Raises `BadRequest`."""
    center = there(navigator, order.target)
    if order.offsets_arcsec is not None:
        return offsets(center, order.offsets_arcsec, order.pattern_angle_deg)
    assert order.across is not None
    assert order.down is not None
    size = navigator.field_deg
    if order.width_deg is not None and order.height_deg is not None:
        size = order.width_deg, order.height_deg
    if size is None:
        raise BadRequest(
            "how large the field is isn't known: no frame was solved with this camera yet",
            device=navigator.name,
            advice="look once, or give width_deg and height_deg",
        )
    return mosaic(
        center,
        across=order.across,
        down=order.down,
        width_deg=size[0],
        height_deg=size[1],
        overlap=order.overlap,
        position_angle_deg=order.pattern_angle_deg,
        snake=order.snake,
    )


def panel_view(report: PanelReport, of: int) -> PanelView:
    """View of a panel."""
    return PanelView(
        number=report.panel.number,
        of=of,
        column=report.panel.column,
        row=report.panel.row,
        ra_deg=report.panel.place.ra_deg,
        dec_deg=report.panel.place.dec_deg,
        position_angle_deg=report.panel.position_angle_deg,
        end=report.end.value,
        error_arcsec=report.error_arcsec,
        rotation_deg=report.rotation_deg,
        centered_utc=report.centered_utc,
        left_utc=report.left_utc,
        words=report.words,
    )


class LongerOrders:
    """Makes work of them.

    Parameters
    ----------
    heard : callable
        ``heard(telescope_id, kind, data)``: called with each attempt.
    """

    def __init__(self, settings: Settings, observatory: Observatory, solver: Solver, heard: Heard) -> None:
        self._telescopes = {telescope.id: telescope for telescope in settings.telescope}
        self._settings = settings
        self._observatory = observatory
        self._solver = solver
        self._heard = heard

    def know(self, settings: Settings) -> None:
        """Go by these settings from now on."""
        self._telescopes = {telescope.id: telescope for telescope in settings.telescope}
        self._settings = settings

    def work_of(self, telescope_id: str, order: LongerOrder) -> Work:
        """An order as something to do with a navigator."""
        one = self._telescopes[telescope_id]

        def tell(attempt: dict[str, object]) -> None:
            self._heard(telescope_id, "attempt", attempt)

        async def work(navigator: Navigator) -> object:
            match order:
                case MosaicOrder():
                    return await run_mosaic(navigator, order, tell)
                case SolveOrder():
                    return await solve_frame(navigator, order, solver=self._solver, folders=one.night.folders)
                case SeriesOrder():
                    return await run_series(navigator, order, tell)
                case HoldOrder():
                    return await run_hold(navigator, order, partial(self._heard, telescope_id))
                case DitherOrder():
                    return await run_dither(navigator, order, partial(self._heard, telescope_id))
                case ModelRunOrder():
                    # fitting is expensive to import, and few need it
                    from api.orders.model_run import run_model

                    return await run_model(
                        navigator,
                        order,
                        tell,
                        settings=self._settings,
                        one=one,
                        journal=self._observatory.telescope(telescope_id).journal,
                    )

        return work

    @staticmethod
    def needs_devices(order: LongerOrder) -> bool:
        """Whether the telescope must be open for it: a file is solved without."""
        return not (isinstance(order, SolveOrder) and order.path is not None)
