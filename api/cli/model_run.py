"""The points of `mountnav model run`: a service slews and looks at each; an interrupted run goes on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import httpx

from api.pointing.models import ModelledTelescope, plan_run, position_of_point
from mountnav.client import Client, Json, ServiceError
from mountnav.clock import SystemClock
from mountnav.devices import PierSide
from mountnav.errors import MountnavError
from mountnav.pointing.model.planning import Outcome, RunFile, RunPoint, add, begin, mend, read_run
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Air, Apparent, Icrs

FAILURES_IN_A_ROW = 5
"""Points that fail one after another before a run is given up: clouds, or a camera that is lost, as in the
service's own run. chosen by hand: with fewer, a passing cloud ends the night; with more, a lost camera costs
it."""
_WAIT_S = 30.0
"""So long a question for a job's end is answered at the latest; then it is asked again. The service's own
bound is 60 s, and a proxy may give up an answer sooner."""
_CONFLICT = 409
"""HTTP status of an order that another job is in the way of."""
_TRIES_WHEN_BUSY = 3
"""Jobs of others that an order waits for. chosen by hand: a person who centers something in between is let
through; an observer who looks on all the time ends the run."""
_LEAST_SIGMA_ARCSEC = 0.1
"""Standard error of a look at the least: no frame is placed better than the catalogs and the air allow, and
an error of zero would weigh a point infinitely in the fit."""
_USUAL_SIGMA_ARCSEC = 2.0
"""Standard error of a look that comes without one. chosen by hand; it only weighs such a look against
others."""


class RunClient(Client):
    """The orders that a run gives."""

    def slew_to(self, telescope_id: str, ra_deg: float, dec_deg: float) -> Json:
        """Start a slew to an ICRS position; the job."""
        body = {"ra_deg": ra_deg, "dec_deg": dec_deg, "frame": "icrs"}
        return self._json("POST", f"/v1/telescopes/{telescope_id}/slew", json=body)

    def look_there(self, telescope_id: str) -> Json:
        """Start a look; the job."""
        return self._json("POST", f"/v1/telescopes/{telescope_id}/look", json={})

    def done(self, order: Callable[[], Json], *, patience_s: float) -> Json:
        """Give an order, after another job has ended if need be, and wait for its end."""
        for _ in range(_TRIES_WHEN_BUSY):
            try:
                return self.ended(order(), patience_s=patience_s)
            except ServiceError as error:
                holder = error.problem.get("job_id")
                if error.status != _CONFLICT or not holder:
                    raise
                self.job(str(holder), wait_s=_WAIT_S)
        return self.ended(order(), patience_s=patience_s)

    def ended(self, job: Json, *, patience_s: float) -> Json:
        """Wait for a job's end.

        Raises
        ------
        MountnavError
            It failed, was cancelled, or isn't over within that time (it is cancelled then).
        """
        waited_s = 0.0
        while job["state"] not in ("succeeded", "failed", "cancelled"):
            if waited_s >= patience_s:
                self.cancel(str(job["id"]))
                raise MountnavError(f"the {job['kind']} wasn't over within {patience_s:.0f} s")
            job = self.job(str(job["id"]), wait_s=_WAIT_S)
            waited_s += _WAIT_S
        if job["state"] != "succeeded":
            found = job.get("problem") or {}
            raise MountnavError(str(found.get("detail") or found.get("title") or job["state"]))
        return job


def begin_or_go_on(
    about: ModelledTelescope,
    out: Path,
    *,
    points: int | None,
    spread: Literal["spiral", "random"],
    seed: int,
    say: Callable[[str], None],
) -> RunFile:
    """The run of a file, begun by a plan if there is no file yet.

    Raises
    ------
    MountnavError
        The plan can't be made, or the file is something else, or a run of another telescope.
    """
    if not out.exists():
        planned = plan_run(about, points, spread, seed)
        # points of another plan check the model at the end
        fresh = plan_run(about, about.model.fresh_points, "random", seed + 1).points
        first = len(planned.points) + 1
        checks = [replace(point, number=first + index, held_out=False) for index, point in enumerate(fresh)]
        begin(out, about.telescope, [*planned.points, *checks], (point.number for point in checks))
    mend(out)
    going = read_run(out)
    if going is None:
        raise MountnavError(f"{out} is there already and no model run", advice="give another --out")
    if going.telescope != about.telescope:
        raise MountnavError(f"{out} is a run of {going.telescope}, not of {about.telescope}")
    left = going.left
    if left and len(left) < len(going.points):
        say(f"going on: {len(going.points) - len(left)} of {len(going.points)} points are done")
    return going


def take_points(
    client: RunClient,
    about: ModelledTelescope,
    going: RunFile,
    out: Path,
    patience_s: float,
    say: Callable[[str], None],
) -> bool:
    """Take the points that are left; False if it was given up."""
    assert about.site is not None
    failed = 0
    for point in going.left:
        try:
            seen = _point(client, about, point, patience_s)
        except httpx.HTTPError as error:
            # the service itself: this point is still to be taken
            say(
                f"{point.number:4d}  the service doesn't answer ({error}); start the same command again later"
            )
            return False
        except MountnavError as error:
            problem = error.what if not isinstance(error, ServiceError) else str(error)
            if isinstance(error, ServiceError) and error.status in (401, 403, 404):
                raise
            add(out, Outcome(point.number, None, problem), None)
            say(f"{point.number:4d}  {problem}")
            failed += 1
            if failed >= FAILURES_IN_A_ROW:
                say(f"{failed} points failed one after another: given up; start again to take the rest")
                return False
            continue
        failed = 0
        add(out, Outcome(point.number, seen.look_id), seen)
        say(f"{point.number:4d}  az {point.az_deg:6.1f}° alt {point.alt_deg:5.1f}°  solved")
    return True


def _point(
    client: RunClient, about: ModelledTelescope, point: RunPoint, patience_s: float
) -> PointingObservation:
    assert about.site is not None
    target = position_of_point(point, about.site, about.air, SystemClock().utc())
    client.done(lambda: client.slew_to(about.telescope, target.ra_deg, target.dec_deg), patience_s=patience_s)
    job = client.done(lambda: client.look_there(about.telescope), patience_s=patience_s)
    return observation(job["result"], client.telescope(about.telescope), about.air)


def observation(look: Json, telescope: Json, air: Air) -> PointingObservation:
    """Make an observation of a look's answer.

    Parameters
    ----------
    look : dict
        A `LookView`. What it doesn't tell of side and segment is taken from the telescope; a run that isn't
        synced meanwhile is one segment.
    telescope : dict
        The state right after the look.
    """
    utc = datetime.fromisoformat(str(look["mid_exposure_utc"]))
    side = look.get("pier_side") or telescope.get("pier_side") or "unknown"
    sigma = look.get("sigma_arcsec")
    return PointingObservation(
        utc=utc,
        seen=Icrs(float(look["seen"]["ra_deg"]), float(look["seen"]["dec_deg"])),
        sigma_arcsec=max(float(sigma), _LEAST_SIGMA_ARCSEC) if sigma is not None else _USUAL_SIGMA_ARCSEC,
        reading=_reading(look["believed"], utc),
        side=PierSide(side),
        segment_id=str(look.get("segment_id") or "run_model"),
        air=air,
        rotation_deg=look.get("rotation_deg"),
        scale_arcsec_px=look.get("scale_arcsec_px"),
        parity=look.get("parity"),
        model_id=look.get("model_id"),
        look_id=str(look["look_id"]),
    )


def _reading(place: dict[str, Any], utc: datetime) -> Apparent | Icrs:
    ra_deg, dec_deg = float(place["ra_deg"]), float(place["dec_deg"])
    return Icrs(ra_deg, dec_deg) if place["frame"] == "icrs" else Apparent(ra_deg, dec_deg, utc)
