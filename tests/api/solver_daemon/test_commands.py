"""The installed commands as programs call them: through the daemon, through the service, and alone."""

from __future__ import annotations

import json
import os
import re
import select
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from api.solver.process import as_fits
from api.solver_daemon import stub
from api.solver_daemon.installing import install
from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.sky.wcs import icrs_at_pixel

pytestmark = pytest.mark.long

PLACE = Icrs(85.0, 30.0)
OPTICS = SimulatedOptics(900, 700, 6.0, rotation_deg=33.0)
NEAR_PX = 0.01
"""All ways in give one center to this."""


@dataclass
class Commands:
    """The commands in a folder, and a frame to solve."""

    bin: Path
    folder: Path
    environment: dict[str, str]

    def called(self, *line: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(self.bin / line[0]), *line[1:]],
            cwd=self.folder,
            env={**os.environ, **self.environment},
            capture_output=True,
            text=True,
            timeout=300,
        )

    def told(self, *line: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "api.main", "solver", *line],
            env={**os.environ, **self.environment},
            capture_output=True,
            text=True,
            timeout=300,
        )

    @property
    def socket(self) -> str:
        return os.path.join(self.environment["MOUNTNAV_RUN"], "solver.sock")


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drawn frame, and one of noise."""
    folder = tmp_path_factory.mktemp("frames")
    frame = draw_frame(
        PLACE,
        OPTICS,
        embedded_catalog(),
        exposure_s=2.0,
        mid_exposure_utc=datetime(2026, 1, 1, tzinfo=UTC),
        seed=(1, 2),
    )
    (folder / "sky.fits").write_bytes(as_fits(frame))
    noise = np.random.default_rng(3).normal(1000.0, 20.0, (700, 900))
    (folder / "noise.fits").write_bytes(as_fits(Frame(pixels=noise)))
    return folder


@pytest.fixture
def commands(tmp_path: Path, frames: Path) -> Iterator[Commands]:
    """Commands that know of no solver yet."""
    install(tmp_path / "bin")
    for name in ("sky.fits", "noise.fits"):
        (tmp_path / name).write_bytes((frames / name).read_bytes())
    found = Commands(
        tmp_path / "bin", tmp_path, {"MOUNTNAV_RUN": str(tmp_path / "run"), "MOUNTNAV_SOLVER": ""}
    )
    yield found
    found.told("stop")


def ini(path: Path) -> dict[str, str]:
    """As N.I.N.A. reads it."""
    return dict(line.split("=", 1) for line in path.read_text().splitlines() if line.strip())


def center_of(cards: fits.Header) -> Icrs:
    """Through a `.wcs`, at the frame's middle."""
    plain = {key: value for key, value in cards.items() if isinstance(value, str | int | float)}
    return icrs_at_pixel(plain, (OPTICS.width_px - 1) / 2.0, (OPTICS.height_px - 1) / 2.0)


def off_px(place: Icrs, other: Icrs) -> float:
    return separation_arcsec(place, other) / OPTICS.scale_arcsec_px


def test_every_command_gives_the_same_center_through_the_daemon(commands: Commands) -> None:
    assert commands.told("status").returncode == 1
    started = commands.told("start")
    assert started.returncode == 0, started.stderr
    assert "pid:" in started.stdout
    asked = commands.called("astap", "-f", "sky.fits", "-r", "180", "-wcs")
    assert asked.returncode == 0, asked.stdout + asked.stderr
    found = ini(commands.folder / "sky.ini")
    assert found["PLTSOLVD"] == "T"
    first = Icrs(float(found["CRVAL1"]), float(found["CRVAL2"]))
    assert off_px(first, PLACE) < 0.5
    with fits.open(commands.folder / "sky.wcs") as opened:
        assert off_px(center_of(opened[0].header), first) < NEAR_PX
    asked = commands.called("solve-field", "-O", "--no-plots", "sky.fits")
    assert asked.returncode == 0, asked.stderr
    (told,) = re.findall(r"Field center: \(RA,Dec\) = \(([\d.]+), ([-\d.]+)\) deg", asked.stdout)
    # printed to a millionth of a degree
    assert off_px(Icrs(float(told[0]), float(told[1])), first) < NEAR_PX
    with fits.open(commands.folder / "sky.wcs") as opened:
        assert off_px(center_of(opened[0].header), first) < NEAR_PX
    told_wcs = dict(
        line.split(" ", 1)
        for line in commands.called("wcsinfo", "sky.wcs").stdout.splitlines()
        if " " in line
    )
    assert float(told_wcs["pixscale"]) == pytest.approx(OPTICS.scale_arcsec_px, rel=1e-3)
    asked = commands.called("watney-solve", "blind", "-i", "sky.fits")
    place = json.loads(asked.stdout)
    assert off_px(Icrs(place["ra"], place["dec"]), first) < NEAR_PX
    commands.called("PlateSolve3", "sky.fits", "0", "0", "0", "0")
    lines = (commands.folder / "sky_PS3.txt").read_text().splitlines()
    assert lines[0] == "True"
    ra, dec = (float(np.degrees(float(one))) for one in lines[1].split(","))
    assert off_px(Icrs(ra % 360.0, dec), first) < NEAR_PX
    # none of them did it by itself
    log = (Path(commands.environment["MOUNTNAV_RUN"]) / "solver.log").read_text()
    assert "solver ready" in log


def test_the_first_call_solves_alone_and_starts_the_daemon(commands: Commands) -> None:
    asked = commands.called("astap", "-f", "sky.fits")
    assert asked.returncode == 0, asked.stderr
    assert ini(commands.folder / "sky.ini")["PLTSOLVD"] == "T"
    # it listens soon; `start` waits for that, and begins none of its own
    began = commands.told("start")
    pid = re.findall(r"pid: (\d+)", began.stdout)
    assert pid, began
    assert re.findall(r"pid: (\d+)", commands.told("status").stdout) == pid
    assert commands.told("stop").stdout == "stopped\n"


def test_alone_and_through_the_daemon_the_files_are_the_same(commands: Commands) -> None:
    commands.told("start")
    commands.called("astap", "-f", "sky.fits", "-o", "warm")
    off = Commands(commands.bin, commands.folder, {**commands.environment, "MOUNTNAV_SOLVER": "off"})
    off.called("astap", "-f", "sky.fits", "-o", "alone")
    warm, alone = (ini(commands.folder / f"{name}.ini") for name in ("warm", "alone"))
    assert warm.pop("CMDLINE") != alone.pop("CMDLINE")
    assert warm.keys() == alone.keys()
    # sums of many numbers depend in their last digits on where these lie in memory
    for key in ("CRVAL1", "CRVAL2", "CD1_1", "CD1_2", "CD2_1", "CD2_2", "CROTA1", "CDELT1"):
        assert float(warm[key]) == pytest.approx(float(alone[key]), rel=1e-9), key


def test_noise_is_solved_by_no_command(commands: Commands) -> None:
    commands.told("start")
    assert commands.called("astap", "-f", "noise.fits").returncode != 0
    assert (commands.folder / "noise.ini").read_text().startswith("PLTSOLVD=F\n")
    asked = commands.called("solve-field", "noise.fits")
    assert asked.returncode == 0
    assert "Did not solve" in asked.stdout
    assert "Field center" not in asked.stdout
    assert not (commands.folder / "noise.wcs").exists()
    assert json.loads(commands.called("watney-solve", "blind", "-i", "noise.fits").stdout)["success"] is False
    commands.called("PlateSolve3", "noise.fits", "0", "0", "0", "0")
    assert (commands.folder / "noise_PS3.txt").read_text().startswith("False")


def test_many_calls_at_once_are_all_answered(commands: Commands) -> None:
    commands.told("start")
    with ThreadPoolExecutor(8) as pool:
        calls = [
            pool.submit(commands.called, "astap", "-f", "sky.fits", "-o", f"out{number}")
            for number in range(16)
        ]
        assert [call.result().returncode for call in calls] == [0] * 16
    found = [float(ini(commands.folder / f"out{number}.ini")["CRVAL1"]) for number in range(16)]
    assert np.ptp(found) < 1e-9


def test_a_daemon_that_is_killed_hinders_nobody(commands: Commands) -> None:
    (pid,) = re.findall(r"pid: (\d+)", commands.told("start").stdout)
    os.kill(int(pid), 9)
    assert commands.called("astap", "-f", "sky.fits").returncode == 0
    assert Path(commands.socket).exists()
    (again,) = re.findall(r"pid: (\d+)", commands.told("start").stdout)
    assert again != pid


def test_an_idle_daemon_ends_and_leaves_nothing(commands: Commands) -> None:
    started = commands.told("start", "--idle-s", "0.1")
    (pid,) = re.findall(r"pid: (\d+)", started.stdout)
    # its own clock decides; the descriptor tells when it has ended
    with open(os.pidfd_open(int(pid)), "rb", buffering=0, closefd=True) as ended:
        assert select.select([ended], [], [], 60)[0]
    assert not Path(commands.socket).exists()
    assert stub.asked(commands.socket, "status") == b""


def test_the_service_takes_the_daemons_place_and_answers(commands: Commands) -> None:
    (pid,) = re.findall(r"pid: (\d+)", commands.told("start").stdout)
    journal = {"MOUNTNAV_JOURNAL": str(commands.folder / "journal.sqlite")}
    served = subprocess.Popen(
        [sys.executable, "-m", "api.main", "serve", "--demo", "--port", "0"],
        env={**os.environ, **commands.environment, **journal},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        assert served.stdout is not None
        for line in served.stdout:
            if "http://" in line:
                break
        with open(os.pidfd_open(int(pid)), "rb", buffering=0) as ended:
            assert select.select([ended], [], [], 60)[0]
    except ProcessLookupError:
        pass  # it has ended already
    finally:
        asked = commands.called("astap", "-f", "sky.fits")
        log = (Path(commands.environment["MOUNTNAV_RUN"]) / "solver.log").read_text()
        served.terminate()
        served.communicate(timeout=60)
    assert asked.returncode == 0, asked.stderr
    # no other daemon was started for it
    assert log.count("listening on") == 1


@pytest.mark.parametrize("how", ["", "off"])
def test_a_whole_path_is_enough_where_the_current_folder_is_gone(commands: Commands, how: str) -> None:
    commands.environment["MOUNTNAV_SOLVER"] = how
    if not how:
        commands.told("start")
    (commands.folder / "gone").mkdir()
    line = f'cd gone && rmdir ../gone && exec "{commands.bin}/astap" -f "{commands.folder}/sky.fits"'
    done = subprocess.run(
        ["sh", "-c", line],
        cwd=commands.folder,
        env={**os.environ, **commands.environment},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert ini(commands.folder / "sky.ini")["PLTSOLVD"] == "T"
