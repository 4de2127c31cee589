"""The order `solve`: a frame that lies on this machine, or one that is exposed for it. Moves nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from api.access.allowed_folders import allowed_file
from api.http.hints import make_hint
from api.http.longer_views import SolvedView
from api.http.places import mount_place, place
from api.orders.orders import SolveOrder
from api.solver.solve_record import solve_record
from api.solver.solver import Solver
from api.solver.solver_work import Upload
from mountnav.errors import BadFrame, NotSolved
from mountnav.files import open_plain
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.reports import Look
from mountnav.sky.coordinates import utc_now
from mountnav.solution import Reason


async def solve_frame(
    navigator: Navigator, order: SolveOrder, *, solver: Solver, folders: Sequence[Path]
) -> SolvedView | Look:
    """Carry it out.

    Parameters
    ----------
    navigator : Navigator
    order : SolveOrder
    solver : Solver
    folders : sequence of Path
        That frames may be taken from.

    Raises
    ------
    BadRequest, Unknown
        The file may not be read, or isn't there; half a hint.
    BadFrame, NotSolved
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
        verdict = await solver.solve_upload(Upload(path.name, file.fileno()), hint, settings)
    if verdict.reason is Reason.BAD_FRAME:
        raise BadFrame(verdict.detail or str(verdict.reason), device=str(path))
    solution = verdict.solution
    if solution is None:
        why = str(verdict.reason or "not solved")
        raise NotSolved(
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


__all__ = ["solve_frame"]
