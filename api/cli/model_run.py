"""`mountnav model run`: points over the sky by a running service, then a model; it goes on where it was."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import httpx

from api.cli.model_command import fit_lines, fit_record, made_of, model_made, planned, print_json, terms_of
from api.cli.model_sources import Whose, source
from mountnav.client import Client, Json, ServiceError
from mountnav.clock import SystemClock
from mountnav.devices import PierSide
from mountnav.errors import MountnavError
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.model.planning import Outcome, RunFile, RunPoint, add, begin, mend, read_run
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.chain import observed_to_icrs
from mountnav.sky.coordinates import Air, Apparent, Icrs, Observed, Site

FAILURES_IN_A_ROW = 5
_WAIT_S = 30.0
_CONFLICT, _TRIES_WHEN_BUSY = 409, 3
_LEAST_SIGMA_ARCSEC = 0.1


class RunClient(Client):
    """The orders that a run gives."""

    def slew_to(self, telescope_id: str, ra_deg: float, dec_deg: float) -> Json:
        """Start a slew to an ICRS place; the job."""
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


def run(
    about: Whose,
    url: str,
    token: str | None,
    out: Path,
    *,
    points: int | None,
    kind: Literal["spiral", "random"],
    seed: int,
    model_out: Path | None,
    patience_s: float,
    as_json: bool,
) -> int:
    """Take the points that are left, then fit; 0 if the model is accepted, 1 if not or if it was given up.

    Raises
    ------
    MountnavError
        The plan can't be made, or nothing can be fitted.
    """
    tell = _silent if as_json else _say
    if not out.exists():
        found = planned(about, points, kind, seed)
        fresh = planned(about, about.model.fresh_points, "random", seed + 1).points
        first = len(found.points) + 1
        checks = [replace(one, number=first + index, held_out=False) for index, one in enumerate(fresh)]
        begin(out, about.telescope, [*found.points, *checks], (one.number for one in checks))
    mend(out)
    going = read_run(out)
    if going is None:
        raise MountnavError(f"{out} is there already and no model run", advice="give another --out")
    if going.telescope != about.telescope:
        raise MountnavError(f"{out} is a run of {going.telescope}, not of {about.telescope}")
    left = going.left
    if left and len(left) < len(going.points):
        tell(f"going on: {len(going.points) - len(left)} of {len(going.points)} points are done")
    with RunClient(url, token=token, timeout_s=60.0) as client:
        if not _taken(client, about, going, out, patience_s, tell):
            return 1
    read = source(str(out), about)
    old = None if about.model.file is None or not about.model.file.exists() else about.model.file
    made = made_of(read, about, terms_of(None, about), None if old is None else PointingModel.load(old))
    model = model_made(made, about, read.said)
    if model_out is not None and made.judged.accepted:
        model.save(model_out)
    if as_json:
        print_json(fit_record(made, model, model_out if made.judged.accepted else None))
    else:
        tell("\n".join(fit_lines(made, model)))
        if model_out is not None:
            tell(f"written to {model_out}" if made.judged.accepted else f"NOT written to {model_out}")
    return 0 if made.judged.accepted else 1


def _taken(
    client: RunClient, about: Whose, going: RunFile, out: Path, patience_s: float, tell: Callable[[str], None]
) -> bool:
    """Take the points that are left; False if it was given up."""
    assert about.site is not None
    failed = 0
    for one in going.left:
        try:
            seen = _point(client, about, one, patience_s)
        except httpx.HTTPError as error:
            # the service itself: this point is still to be taken
            tell(f"{one.number:4d}  the service doesn't answer ({error}); start the same command again later")
            return False
        except MountnavError as error:
            problem = error.what if not isinstance(error, ServiceError) else str(error)
            if isinstance(error, ServiceError) and error.status in (401, 403, 404):
                raise
            add(out, Outcome(one.number, None, problem), None)
            tell(f"{one.number:4d}  {problem}")
            failed += 1
            if failed >= FAILURES_IN_A_ROW:
                tell(f"{failed} points failed one after another: given up; start again to take the rest")
                return False
            continue
        failed = 0
        add(out, Outcome(one.number, seen.look_id), seen)
        tell(f"{one.number:4d}  az {one.az_deg:6.1f}° alt {one.alt_deg:5.1f}°  solved")
    return True


def _point(client: RunClient, about: Whose, one: RunPoint, patience_s: float) -> PointingObservation:
    assert about.site is not None
    target = place_of(one, about.site, about.air, SystemClock().utc())
    client.done(lambda: client.slew_to(about.telescope, target.ra_deg, target.dec_deg), patience_s=patience_s)
    job = client.done(lambda: client.look_there(about.telescope), patience_s=patience_s)
    return observation(job["result"], client.telescope(about.telescope), about.air)


def place_of(one: RunPoint, site: Site, air: Air, utc: datetime) -> Icrs:
    """Where a point of the plan lies at an instant."""
    return observed_to_icrs(Observed(one.az_deg, one.alt_deg, utc), site, air)


def observation(look: Json, telescope: Json, air: Air) -> PointingObservation:
    """Make an observation of a look's answer.

    Parameters
    ----------
    look : dict
        A `LookView`. What it doesn't tell of side and segment is taken from the telescope; a run that isn't
        synced meanwhile is one segment.
    telescope : dict
        The state right after the look.
    air : Air
    """
    utc = datetime.fromisoformat(str(look["mid_exposure_utc"]))
    side = look.get("pier_side") or telescope.get("pier_side") or "unknown"
    sigma = look.get("sigma_arcsec")
    return PointingObservation(
        utc=utc,
        seen=Icrs(float(look["seen"]["ra_deg"]), float(look["seen"]["dec_deg"])),
        sigma_arcsec=max(float(sigma), _LEAST_SIGMA_ARCSEC) if sigma is not None else 2.0,
        reading=_reading(look["believed"], utc),
        side=PierSide(side),
        segment_id=str(look.get("segment_id") or "run"),
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


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _silent(line: str) -> None:
    sys.stderr.write(line + "\n")
