"""A client that a generator makes of the frozen interface has every route, and works with a real service."""

from __future__ import annotations

import asyncio
import json
import os
import re
import subprocess
import sys
import venv
from pathlib import Path

import pytest
import uvicorn

from api.http.app import create_app
from api.http.openapi import FROZEN_PATH
from mountnav.settings.observatory import Settings
from tests.api.nights.night_site import night_toml

GENERATOR = "openapi-python-client==0.29.1"
"""In an environment of its own: it asks for an older typer than ours."""
INSTALL_S = 300.0
"""So long a registry may take; without one there is no test."""

CLIENT = """
import json, sys
from made import Client
from made.api.night import get_night, pause_night, start_night
from made.api.orders import offset_telescope
from made.api.jobs import get_job
from made.api.telescopes import list_telescopes
from made.models import JobView, NightView, OffsetBody, Problem, WhyBody

client = Client(base_url=sys.argv[1], raise_on_unexpected_status=True)
told = {"telescopes": [one.id for one in list_telescopes.sync(client=client)]}
# a body that may be left out is left out
night = start_night.sync("east", client=client)
assert isinstance(night, NightView), night
told["started"] = str(night.phase)
paused = pause_night.sync("east", client=client, body=WhyBody(why="a visitor"))
told["holds"] = pause_night.sync("east", client=client).holds
assert told["holds"] == paused.holds
told["night"] = get_night.sync("east", client=client).to_dict()["telescope"]
nobody = get_night.sync("west", client=client)
assert isinstance(nobody, Problem), nobody
told["problem"] = nobody.status
job = offset_telescope.sync("east", client=client, body=OffsetBody(east_arcsec=30.0, north_arcsec=0.0))
assert isinstance(job, JobView), job
told["job"] = str(get_job.sync(job.id, client=client, wait=60.0).state)
print(json.dumps(told))
"""


def run(
    *command: str, timeout_s: float | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a program; its output is the caller's to judge."""
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        env={**os.environ, **environment},
        check=False,
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The generator's Python, and the folder in which the client's package `made` lies."""
    folder = tmp_path_factory.mktemp("generated")
    venv.create(folder / "own", with_pip=True)
    scripts = folder / "own" / ("Scripts" if sys.platform == "win32" else "bin")
    try:
        installed = run(str(scripts / "pip"), "install", "-q", GENERATOR, timeout_s=INSTALL_S)
    except subprocess.TimeoutExpired:
        pytest.skip(f"no registry gave {GENERATOR} within {INSTALL_S:.0f} s")
    if installed.returncode != 0:
        pytest.skip(f"{GENERATOR} can't be installed here: {installed.stderr.strip().splitlines()[-1:]}")
    path = f"{scripts}{os.pathsep}{os.environ['PATH']}"
    done = run(
        *(str(scripts / "openapi-python-client"), "generate", "--path", str(FROZEN_PATH)),
        *("--meta", "none", "--output-path", str(folder / "made")),
        PATH=path,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return scripts / "python", folder


@pytest.mark.long
async def test_a_generated_client_has_every_route_and_works(made: tuple[Path, Path], tmp_path: Path) -> None:
    python, folder = made
    paths = json.loads(FROZEN_PATH.read_text(encoding="utf-8"))["paths"]
    names = {operation["operationId"] for path in paths.values() for operation in path.values()}
    routes = {path.stem for path in (folder / "made" / "api").glob("*/*.py")} - {"__init__"}
    # a route that the generator doesn't understand is left out with a warning, and nobody reads that
    assert routes == {re.sub(r"\W", "_", name) for name in names}
    for name in ("frames", "recordings"):
        (tmp_path / name).mkdir()
    toml = night_toml(tmp_path / "frames", tmp_path / "recordings", tmp_path / "safety.txt")
    toml = toml.replace("enabled = true", "enabled = true\nbegin_sun_below_deg = -90", 1)
    (tmp_path / "safety.txt").write_text("safe")
    server = uvicorn.Server(uvicorn.Config(create_app(Settings.parse(toml)), port=0, log_level="error"))
    server.install_signal_handlers = lambda: None  # type: ignore[attr-defined]
    serving = asyncio.create_task(server.serve())
    try:
        while not server.started:
            assert not serving.done(), serving.exception()
            await asyncio.sleep(0.01)
        port = server.servers[0].sockets[0].getsockname()[1]
        said = await asyncio.to_thread(
            run, str(python), "-c", CLIENT, f"http://127.0.0.1:{port}", PYTHONPATH=str(folder)
        )
    finally:
        server.should_exit = True
        await serving
    assert said.returncode == 0, said.stderr
    assert json.loads(said.stdout) == {
        "telescopes": ["east", "west"],
        "started": "calibrating",
        "holds": ["paused by an operator"],
        "night": "east",
        "problem": 404,
        "job": "succeeded",
    }
