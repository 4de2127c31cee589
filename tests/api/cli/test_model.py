"""`mountnav model` as people use it: fit, show, export, import, plan, and a run by a service."""

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from api.cli.model import model_app
from mountnav.clock import utc_now
from mountnav.errors import BadRequest, MountnavError, NotFound
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.model.planning import read_run
from mountnav.pointing.model.tpoint_file import read_coefficients
from mountnav.pointing.observation import write_observations
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.chain import apparent_to_icrs, icrs_to_apparent, icrs_to_observed
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.sky.sphere import displaced
from tests.pointing.model.test_model_in_force import TRUTH, Telescope
from tests.present import present

SETTINGS = """
[site]
latitude_deg = 48.93
longitude_deg = 22.27
height_m = 700.0
[air]
pressure_hpa = 930.0
temperature_c = 5.0
relative_humidity = 0.7
[[telescope]]
id = "east"
mount = { url = "fake+lx200://", mounting = "german" }
camera = { kind = "simulated" }
limits = { min_altitude_deg = 20.0 }
model = { run_points = 15 }
"""


def mountnav(*arguments, code=0):
    app = typer.Typer()
    app.add_typer(model_app, name="model")
    found = CliRunner().invoke(app, ["model", *map(str, arguments)], catch_exceptions=True)
    if found.exception is not None and not isinstance(found.exception, SystemExit):
        raise found.exception
    assert found.exit_code == code, found.output
    return found.output


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "observatory.toml"
    path.write_text(SETTINGS)
    return path


@pytest.fixture(scope="module")
def looks(tmp_path_factory):
    path = tmp_path_factory.mktemp("looks") / "looks.jsonl"
    write_observations(path, Telescope(**TRUTH).looks(30))
    return path


@pytest.mark.long
def test_pmfits_file(shared, tmp_path):
    out = tmp_path / "model.json"
    said = mountnav(
        "fit", shared / "data/pointing/pmfit_equat.dat", "--terms", "IH,ID,CH,ME,MA,TF", "-o", out
    )
    assert "sky RMS (n-k), as PMFIT" in said
    assert "36.25″" in said
    assert "5.78″" in said
    assert "accepted" in said
    assert "NOT" not in said
    model = PointingModel.load(out)
    assert model.sky_rms_arcsec == pytest.approx(5.782, abs=0.01)
    assert "tube sags with sin z" in mountnav("show", out)
    assert json.loads(mountnav("show", out, "--json"))["id"] == model.id
    auto = json.loads(mountnav("fit", shared / "data/pointing/pmfit_equat.dat", "--json"))
    assert auto["accepted"] is True
    assert auto["loo_arcsec"] < 2.2
    assert auto["judgement"]["held_out"] == 39
    assert len(auto["residuals_arcsec"]) == 39


@pytest.mark.long
def test_looks_need_to_know_where_the_telescope_stands(looks, config, tmp_path):
    with pytest.raises(BadRequest, match="--site LATITUDE LONGITUDE"):
        mountnav("fit", looks)
    told = json.loads(mountnav("fit", looks, "-c", config, "--terms", "CH,NP,ME,MA,TF", "--json"))
    model = dict(zip(told["model"]["terms"], told["model"]["coefficients_arcsec"], strict=True))
    assert model["CH"] == pytest.approx(TRUTH["ch"], abs=5.0)
    assert model["ME"] == pytest.approx(TRUTH["me"], abs=5.0)
    assert told["model"]["telescope"] == "east"
    assert told["after"]["sky_rms_arcsec"] < 2.5
    by_options = json.loads(mountnav("fit", looks, "--site", 48.93, 22.27, "--mounting", "german", "--json"))
    assert by_options["accepted"] is True
    with pytest.raises(NotFound, match="west"):
        mountnav("fit", looks, "-c", config, "--telescope", "west")


@pytest.mark.long
def test_a_worse_model_changes_nothing(looks, config, tmp_path):
    out = tmp_path / "model.json"
    mountnav("fit", looks, "-c", config, "--terms", "CH,NP,ME,MA,TF", "-o", out)
    before = out.read_text()
    said = mountnav("fit", looks, "-c", config, "--terms", "TF", "-o", out, code=1)
    assert "NOT accepted; the old one stays" in said
    assert out.read_text() == before
    mountnav("fit", looks, "-c", config, "--terms", "TF", "-o", out, "--anyway", code=1)
    assert any("written though" in note for note in PointingModel.load(out).notes)


@pytest.mark.long
def test_to_tpoint_and_back(looks, config, tmp_path):
    out, mod, back = tmp_path / "model.json", tmp_path / "east.mod", tmp_path / "back.json"
    mountnav("fit", looks, "-c", config, "-o", out)
    mountnav("export", out, "-o", mod)
    assert read_coefficients(mod.read_text()).values_arcsec["CH"] == pytest.approx(TRUTH["ch"], abs=5.0)
    assert mountnav("export", out) == mod.read_text()
    with pytest.raises(BadRequest, match="latitude"):
        mountnav("import", mod, "-o", back)
    mountnav("import", mod, "-o", back, "-c", config)
    one, other = PointingModel.load(out), PointingModel.load(back)
    assert other.terms == one.terms
    assert other.coefficients_arcsec == pytest.approx(one.coefficients_arcsec, abs=1e-3)
    assert other.site_latitude_deg == 48.93
    assert "correlations" in other.notes[0]


def test_a_plan(config):
    told = json.loads(mountnav("plan", "-c", config, "--points", 20, "--json"))
    assert len(told["points"]) == 20
    assert {one["side"] for one in told["points"]} == {"east", "west"}
    assert min(one["alt_deg"] for one in told["points"]) >= 21.0
    assert "15 points; the axes turn" in mountnav("plan", "-c", config)


class Service(BaseHTTPRequestHandler):
    """As much of the API as a run needs, over the simulator's mechanics; slews take no time."""

    mount: Mechanics
    jobs: dict[str, dict[str, Any]]
    troubles: list[str | None]
    rng: np.random.Generator

    def log_message(self, *arguments):
        pass

    def do_POST(self):
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"] or 0)) or b"{}")
        kind = self.path.rsplit("/", 1)[1]
        number = len(self.jobs)
        trouble = self.troubles.pop(0) if self.troubles and kind == "look" else None
        job: dict[str, Any] = {
            "id": str(number),
            "kind": kind,
            "state": "succeeded",
            "result": {},
            "problem": None,
        }
        if trouble == "down":
            self.connection.close()
            return
        if trouble:
            job |= {"state": "failed", "problem": {"detail": trouble}}
        elif kind == "slew":
            place = icrs_to_apparent(Icrs(body["ra_deg"], body["dec_deg"]), utc_now())
            assert self.mount.slew(place) is None
        else:
            job["result"] = self._look(number)
        self.jobs[str(number)] = job
        self._answer(job)

    def _look(self, number):
        while self.mount.slewing():
            pass
        now = utc_now()
        seen = displaced(self.mount.truth(now), *self.rng.normal(0.0, 1.0, 2))
        believed = apparent_to_icrs(self.mount.reported(now))
        return {
            "look_id": f"look {number}",
            "mid_exposure_utc": now.isoformat(),
            "seen": {"ra_deg": seen.ra_deg, "dec_deg": seen.dec_deg, "frame": "icrs"},
            "believed": {"ra_deg": believed.ra_deg, "dec_deg": believed.dec_deg, "frame": "icrs"},
            "sigma_arcsec": 1.0,
            "rotation_deg": 3.0,
            "scale_arcsec_px": 2.0,
            "parity": 1,
        }

    def do_GET(self):
        if "/jobs/" in self.path:
            self._answer(self.jobs[self.path.split("/jobs/")[1].split("?")[0]])
        else:
            self._answer({"id": "east", "pier_side": str(self.mount.pier_side())})

    def _answer(self, record):
        content = json.dumps(record).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)


@pytest.fixture
def service():
    site, air = Site(48.93, 22.27, 700.0), Air(930.0, 5.0, 0.7)
    mount = Mechanics(
        site,
        air,
        PointingErrors(**{f"{name}_arcsec": value for name, value in TRUTH.items()}),
        machine=Machine(mounting="german", slew_rate_deg_s=1e5, acceleration_deg_s2=1e8),
        clock=utc_now,
    )
    handler = type(
        "Here", (Service,), {"mount": mount, "jobs": {}, "troubles": [], "rng": np.random.default_rng(2)}
    )
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield handler, f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.mark.long
def test_a_run_that_is_interrupted_goes_on(service, config, tmp_path):
    handler, url = service
    out, model = tmp_path / "run.jsonl", tmp_path / "model.json"
    handler.troubles = [None, None, "cloud", None, "down"]
    said = mountnav("run", "-c", config, "--url", url, "-o", out, "--model", model, code=1)
    assert "cloud" in said
    assert "start the same command again" in said
    assert not model.exists()
    going = present(read_run(out))
    assert len(going.outcomes) == 4
    assert len(going.points) == 15 + 4
    handler.troubles = []
    said = mountnav("run", "-c", config, "--url", url, "-o", out, "--model", model)
    assert "going on: 4 of 19 points are done" in said
    assert "accepted" in said
    assert "fresh points agree" in said
    run = present(read_run(out))
    assert not run.left
    assert {one.side for one in run.observations} == {"east", "west"}
    assert [len(run.of_part(part)) for part in ("fit", "held-out", "fresh")] in (
        [11, 3, 4],
        [12, 2, 4],
    )
    found = PointingModel.load(model)
    assert present(found.loo_arcsec) < 8.0
    assert present(found.before_arcsec) > 100.0
    assert found.n == 14
    # what was looked at is what was planned
    for one, point in zip(run.outcomes, run.points, strict=True):
        seen = next((look for look in run.observations if look.look_id == one.look_id), None)
        if seen is not None:
            there = icrs_to_observed(seen.seen, seen.utc, Site(48.93, 22.27, 700.0), Air(930.0, 5.0, 0.7))
            assert there.alt_deg == pytest.approx(point.alt_deg, abs=1.0)
    # once more: nothing is left to do but the fit
    handler.jobs.clear()
    mountnav("run", "-c", config, "--url", url, "-o", out)
    assert not handler.jobs


@pytest.mark.long
def test_a_run_gives_up(service, config, tmp_path):
    handler, url = service
    handler.troubles = ["cloud"] * 9
    said = mountnav("run", "-c", config, "--url", url, "-o", tmp_path / "run.jsonl", code=1)
    assert "5 points failed one after another" in said
    other = tmp_path / "other.jsonl"
    write_observations(other, Telescope(**TRUTH).looks(1))
    with pytest.raises(MountnavError, match="no model run"):
        mountnav("run", "-c", config, "--url", url, "-o", other)


def test_a_journal_needs_a_telescope(tmp_path):
    with pytest.raises(BadRequest, match="several telescopes"):
        mountnav("fit", f"sqlite:///{tmp_path}/journal.sqlite", "--site", 48.93, 22.27)
