"""What `solve` can, the other commands that solve can too: search blind, and refuse what is no frame."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mountnav.identification.blind.index import BlindIndex
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.batch.conftest import PLACE, SCALE_ARCSEC_PX
from tests.api.command_here import run_here
from tests.reading.raw_files import dng
from tests.reading.test_camera_raw import MOSAIC


@pytest.mark.long
@pytest.mark.parametrize("command", ["accuracy", "series"])
def test_frames_without_any_hint_are_found(command: str, folder: Path, sky_index: BlindIndex) -> None:
    done = run_here(command, folder / "a.fits", folder / "below" / "b.fits", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert all(frame["solved"] for frame in told["frames"])
    if command == "series":
        first = told["frames"][0]
        assert separation_arcsec(Icrs(first["ra_deg"], first["dec_deg"]), PLACE) < SCALE_ARCSEC_PX


@pytest.mark.long
@pytest.mark.parametrize(
    ("command", "kind", "why"),
    [
        ("solve", "endless", "it is a device, not a file"),
        ("accuracy", "pipe", "it is a pipe, not a file"),
        ("series", "pipe", "it is a pipe, not a file"),
        ("solve", "raw", "the raw file is damaged, cut short or of an unknown camera"),
        ("series", "cr2", "the raw file is damaged, cut short or of an unknown camera"),
    ],
)
def test_what_is_no_frame_is_refused_in_one_line(command: str, kind: str, why: str, tmp_path: Path) -> None:
    if kind in ("raw", "cr2"):
        pytest.importorskip("rawpy", reason="raw files need the extra mountnav[raw]")
    path = Path("/dev/zero") if kind == "endless" else tmp_path / f"odd.{kind}"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "raw":
        path.write_bytes(dng(MOSAIC)[:2000])
    elif kind == "cr2":
        path.write_bytes(b"II*\0\x10\0\0\0CR\2\0" + bytes(range(256)) * 40)
    # a process of its own: a pipe or /dev/zero that was opened after all would never end
    done = subprocess.run(
        [sys.executable, "-m", "api.main", command, str(path), "--ra", "85", "--dec", "30"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    said = done.stdout + done.stderr
    if command != "series":  # whose table has no room for reasons
        assert why in said
    assert len([line for line in said.splitlines() if why in line]) <= 1
