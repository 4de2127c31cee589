"""The order `model-run`: points over the allowed sky, one after the other, and a pointing model of them."""

from __future__ import annotations

import asyncio
import json
from dataclasses import dataclass, replace
from pathlib import Path

from api.orders.longer_orders import FAILURES_IN_A_ROW, Tell
from api.orders.results import ModelRunView, PointView, TermView
from api.orders.vocabulary import ModelRunOrder
from api.pointing.models import (
    ModelledTelescope,
    ModelObservations,
    as_pointing_model,
    make_model,
    plan_run,
    position_of_point,
    read_terms,
)
from mountnav.clock import Clock, SystemClock
from mountnav.errors import (
    BadFrame,
    BadRequest,
    DeviceRefused,
    ModelRefused,
    MountMoved,
    MountnavError,
    OutsideLimits,
    SolveFailed,
    TargetNotReached,
)
from mountnav.journal.records import Entry, EntryKind, Journal
from mountnav.navigation.look import observation_of
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.reports import Look
from mountnav.pointing.model.acceptance import Made
from mountnav.pointing.model.mechanical import Conversion, Mechanical, mechanical
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.model.planning import Part, RunPoint
from mountnav.pointing.model.terms import term
from mountnav.pointing.observation import PointingObservation
from mountnav.settings.observatory import Settings
from mountnav.settings.telescope import TelescopeSettings

_MISSED = (BadFrame, DeviceRefused, MountMoved, SolveFailed, OutsideLimits, TargetNotReached)
"""What costs one point; anything else ends the run."""


@dataclass(frozen=True, slots=True)
class _Point:
    point: RunPoint
    part: Part


async def run_model(
    navigator: Navigator,
    order: ModelRunOrder,
    tell: Tell,
    *,
    settings: Settings,
    one: TelescopeSettings,
    journal: Journal,
    clock: Clock | None = None,
) -> ModelRunView:
    """Carry it out.

    Parameters
    ----------
    tell : callable
        Told of each point.
    settings : Settings
        Of the whole service.

    Raises
    ------
    BadRequest
        The allowed sky has no room for a run, or its points are too few; or there is no file to put a model
        in force by.
    ModelRefused
        The points determine no model.
    MountnavError
        Of the last of five points in a row that failed; or what ends any work, such as a lost device.
    """
    clock = clock or SystemClock()
    if order.put_in_force and one.model.file is None:
        raise BadRequest(
            "a model is put in force by its file, and none is set",
            device=navigator.name,
            advice="set file in [telescope.model], or leave put_in_force out",
        )
    about = _whose(navigator, settings, one)
    points = await asyncio.to_thread(_points, about, order)
    _require_enough(points, about)
    taken: dict[Part, list[PointingObservation]] = {"fit": [], "held-out": [], "fresh": []}
    failed = 0
    for each in points:
        began_s = clock.monotonic_s()
        view = _planned_view(each, len(points))
        trouble: MountnavError | None = None
        try:
            look = await _look_at(navigator, each.point, order, about, clock)
        except _MISSED as error:
            trouble = error
            failed += 1
            view = view.model_copy(update={"problem": error.what})
        else:
            failed = 0
            taken[each.part].append(_observation(navigator, look))
            view = _seen_view(view, look)
        tell(view.model_copy(update={"elapsed_s": clock.monotonic_s() - began_s}).model_dump(mode="json"))
        if trouble is not None and failed >= FAILURES_IN_A_ROW:
            raise trouble
    made, model = await asyncio.to_thread(_fitted, about, taken)
    written = await _in_force(navigator, order, one, settings, made, model, journal, clock)
    return _view(made, model, len(points), sum(map(len, taken.values())), written)


def _whose(navigator: Navigator, settings: Settings, one: TelescopeSettings) -> ModelledTelescope:
    # a fake mount is what it is made as, whatever the settings leave out
    mounting = navigator.mount.mounting
    known = one.model_copy(update={"mount": one.mount.model_copy(update={"mounting": mounting})})
    site, air = navigator.mount.site, navigator.mount.air
    conversion = Conversion(site, one.model.kind_of(mounting), one.model.does_refraction, mounting)
    return ModelledTelescope(one.id, site, air, conversion, one.model, known)


def _points(about: ModelledTelescope, order: ModelRunOrder) -> list[_Point]:
    """The plan; and points of another one for the last check."""
    run = plan_run(about, order.points, order.spread, order.seed).points
    fresh = plan_run(about, about.model.fresh_points, "random", order.seed + 1).points
    return [
        *(_Point(point, "held-out" if point.held_out else "fit") for point in run),
        *(_Point(replace(point, number=len(run) + 1 + index), "fresh") for index, point in enumerate(fresh)),
    ]


def _require_enough(points: list[_Point], about: ModelledTelescope) -> None:
    """Refuse a run that could make no model even if each of its points were solved. Raises `BadRequest`."""
    run = [each for each in points if each.part != "fresh"]
    fitted = sum(each.part == "fit" for each in run)
    if fitted < about.model.min_points:
        raise BadRequest(
            f"of {len(run)} points, {fitted} are to make the model: too few",
            device=about.telescope,
            advice=f"at least {about.model.min_points} are needed: order more points",
        )


async def _look_at(
    navigator: Navigator, point: RunPoint, order: ModelRunOrder, about: ModelledTelescope, clock: Clock
) -> Look:
    assert about.site is not None
    await navigator.slew(position_of_point(point, about.site, about.air, clock.utc()))
    return await navigator.look(order.exposure_s)


def _observation(navigator: Navigator, look: Look) -> PointingObservation:
    return observation_of(
        look,
        epoch=navigator.mount.epoch,
        air=navigator.mount.air,
        segment_id=look.segment_id or "run",
        model_id=look.model_id,
    )


def _fitted(
    about: ModelledTelescope, taken: dict[Part, list[PointingObservation]]
) -> tuple[Made, PointingModel]:
    if not taken["fit"]:
        raise ModelRefused("no point of the run was solved", advice="check for clouds, dew and focus")
    assert about.conversion is not None

    def part(name: Part) -> Mechanical | None:
        return mechanical(taken[name], about.conversion) if taken[name] and about.conversion else None

    source = ModelObservations(
        mechanical(taken["fit"], about.conversion),
        part("held-out"),
        part("fresh"),
        "a model run of the service",
    )
    file = about.model.file
    old = None if file is None or not file.exists() else PointingModel.load(file)
    made = make_model(source, about, read_terms(None, about), old)
    return made, as_pointing_model(made, about, source.said)


async def _in_force(
    navigator: Navigator,
    order: ModelRunOrder,
    one: TelescopeSettings,
    settings: Settings,
    made: Made,
    model: PointingModel,
    journal: Journal,
    clock: Clock,
) -> Path | None:
    """Write the model down and aim by it, if that was asked for and it is accepted."""
    file = one.model.file
    if not (order.put_in_force and made.judged.accepted) or file is None:
        return None
    await asyncio.to_thread(model.save, file)
    before = navigator.pointing.model_id
    navigator.pointing = await asyncio.to_thread(
        one.model.pointing,
        site=settings.site.site,
        air=settings.air.air,
        mounting=one.mount.mounting,
        resolution_arcsec=navigator.mount.resolution_arcsec,
    )
    facts = {"model_id": model.id, "before": before}
    await journal.note(Entry(clock.utc(), one.id, EntryKind.MODEL, "a pointing model is in force", facts))
    return file


def _planned_view(each: _Point, of: int) -> PointView:
    return PointView(
        number=each.point.number,
        of=of,
        part=each.part,
        az_deg=each.point.az_deg,
        alt_deg=each.point.alt_deg,
        solved=False,
    )


def _seen_view(view: PointView, look: Look) -> PointView:
    return view.model_copy(
        update={
            "solved": True,
            "ra_deg": look.seen.ra_deg,
            "dec_deg": look.seen.dec_deg,
            "east_arcsec": look.offset.east_arcsec,
            "north_arcsec": look.offset.north_arcsec,
            "error_arcsec": look.offset.total_arcsec,
            "sigma_arcsec": look.solution.center_sigma_arcsec,
            "pier_side": None if look.after.pier_side is None else str(look.after.pier_side),
            "look_id": look.look_id,
        }
    )


def _view(made: Made, model: PointingModel, points: int, solved: int, written: Path | None) -> ModelRunView:
    return ModelRunView(
        accepted=made.judged.accepted,
        reasons=list(made.judged.reasons),
        points=points,
        solved=solved,
        used=int(made.fit.used.sum()),
        terms=[
            TermView(
                name=name, value_arcsec=value, sigma_arcsec=sigma, meaning=term(model.kind, name).meaning
            )
            for name, value, sigma in zip(
                model.terms, model.coefficients_arcsec, model.sigma_arcsec, strict=True
            )
        ],
        sky_rms_arcsec=made.fit.after.sky_rms_arcsec,
        before_arcsec=made.fit.before.sky_rms_arcsec,
        loo_arcsec=made.fit.loo_arcsec,
        model_id=model.id,
        model=json.loads(model.to_json()),
        written_to=None if written is None else str(written),
        in_force=written is not None,
    )


__all__ = ["run_model"]
