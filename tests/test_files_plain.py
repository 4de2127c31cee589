"""Pipes, devices, sockets and folders are refused at once wherever a user names a file."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.cli.app import app
from drivers.fakes.faults import read_faults
from drivers.fakes.recording import read_dialogue
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.readers import open_reader
from mountnav.errors import MountnavError
from mountnav.files import open_plain, read_bytes, read_text
from mountnav.identification.blind.index import BlindIndex
from mountnav.measuring.calibration.raw_files import open_raw
from mountnav.night.recording import read_recording
from mountnav.pointing.limits.horizon import Horizon
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.model.planning import read_run
from mountnav.pointing.observation import read_observations
from mountnav.reading import read_frame
from mountnav.settings.observatory import Settings
from mountnav.simulation.machine_file import MachineFile
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.simulation.sky_script import SkyScript

KINDS = ("pipe", "device", "endless", "socket", "folder")
CATALOGS = ("gaia", "ucac4", "usno-b1", "astrometry-net", "astap", "siril", "gaia-bright")


@pytest.fixture(autouse=True)
def _no_waiting() -> Iterator[None]:
    """Whoever waits for a pipe, or reads a device to its end, is interrupted."""

    def interrupted(*_: object) -> None:
        raise AssertionError("it waits for ever")

    before = signal.signal(signal.SIGALRM, interrupted)
    signal.alarm(60)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@pytest.fixture(params=KINDS)
def odd(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / "odd"
    match request.param:
        case "pipe":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/null")
        case "endless":
            path.symlink_to("/dev/zero")
        case "socket":
            with socket.socket(socket.AF_UNIX) as bound:
                bound.bind(str(path))
        case "folder":
            path.mkdir()
    return path


READERS: dict[str, Callable[[Path], object]] = {
    "frame": read_frame,
    "settings": Settings.load,
    "solving": Settings.load_solving,
    "catalogs": Settings.load_catalogs,
    "faults": read_faults,
    "dialogue": read_dialogue,
    "night": read_recording,
    "horizon": Horizon.read,
    "model": PointingModel.load,
    "run": read_run,
    "observations": read_observations,
    "machine": MachineFile.from_toml,
    "errors": PointingErrors.from_toml,
    "sky": SkyScript.from_toml,
    "packed": PackedStore,
    "index": BlindIndex.open,
    "raw": lambda path: open_raw(path, path.parent),
    **{f"catalog {kind}": partial(open_reader, kind) for kind in CATALOGS},
}


@pytest.mark.parametrize("name", READERS)
def test_our_own_error_tells_it(name: str, odd: Path) -> None:
    with pytest.raises(MountnavError, match="odd"):
        READERS[name](odd)


def test_what_it_is_stands_in_the_error(odd: Path, request: pytest.FixtureRequest) -> None:
    with pytest.raises(OSError) as told:
        open_plain(odd).close()
    if "socket" not in request.node.name:  # which the kernel doesn't open: no such device or address
        assert "not a file" in str(told.value)


@pytest.mark.long
def test_a_command_refuses_it(odd: Path) -> None:
    answer = CliRunner().invoke(app, ["solve", str(odd), "--json"])
    assert answer.exit_code != 0 or '"solved": false' in answer.output or "no frames" in answer.output


def test_plain_files_are_read_no_further_than_asked(tmp_path: Path) -> None:
    path = tmp_path / "one"
    path.write_bytes(b"a\r\nb\rc\n\xc3\xa4")
    assert read_bytes(path) == path.read_bytes()
    assert read_text(path) == path.read_text(encoding="utf-8")
    assert read_bytes(path, 9) == path.read_bytes()
    with pytest.raises(OSError, match="longer than"):
        read_bytes(path, 8)
    (tmp_path / "link").symlink_to(path)
    assert read_bytes(tmp_path / "link") == path.read_bytes()
