"""The first settings are written from a few answers, and checked whole before anything runs."""

from __future__ import annotations

import contextlib
import io
import json
import os
import pty
import socket
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from api.main import main
from mountnav.settings.observatory import Settings
from tests.api.cli.test_fake_mount import ended, serving

MOUNTNAV = [sys.executable, "-m", "api.main"]
SITE = ("--latitude", "47.27", "--longitude", "11:24:15", "--height", "600", "--no-look")


@dataclass(frozen=True)
class _Done:
    returncode: int
    stdout: str
    stderr: str


def _run(*arguments: object, folder: Path) -> _Done:
    """A command in this process: each one of its own takes seconds to import."""
    out, err = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        patch.setenv("MOUNTNAV_JOURNAL", str(folder / "journal.sqlite"))
        patch.setattr(sys, "argv", ["mountnav", *map(str, arguments)])
        patch.setattr(sys, "stdin", io.StringIO())
        try:
            main()
            code = 0
        except SystemExit as left:
            code = int(left.code or 0)
    return _Done(code, out.getvalue(), err.getvalue())


def _findings(folder: Path, *arguments: object) -> dict[str, dict[str, str]]:
    done = _run("check", "--json", *arguments, folder=folder)
    told = json.loads(done.stdout)
    assert done.returncode == (2 if told["wrong"] else 0), done.stderr
    return {one["about"]: one for one in told["findings"]}


def test_what_init_writes_from_flags_is_right(tmp_path: Path) -> None:
    done = _run("init", *SITE, "--mount", "fake", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "mountnav check --connect" in done.stdout
    settings = Settings.load(tmp_path / "observatory.toml")
    assert settings.site.longitude_deg == pytest.approx(11 + 24 / 60 + 15 / 3600)
    assert settings.air.pressure_hpa == pytest.approx(943, abs=2)
    assert settings.telescope[0].mount.is_fake
    checked = _run("check", folder=tmp_path)
    assert checked.returncode == 0, checked.stdout + checked.stderr


@pytest.mark.long
def test_it_writes_over_nothing_and_asks_nobody_without_a_terminal(tmp_path: Path) -> None:
    (tmp_path / "observatory.toml").write_text("precious")
    assert _run("init", *SITE, folder=tmp_path).returncode == 2
    assert (tmp_path / "observatory.toml").read_text() == "precious"
    done = _run("init", "--latitude", "47", "--out", "other.toml", folder=tmp_path)
    assert done.returncode == 2
    assert "--longitude" in done.stderr
    assert not (tmp_path / "other.toml").exists()


@pytest.mark.long
@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--latitude", "95"), "a latitude of 95°"),
        (("--longitude", "11:75"), "is not a longitude"),
        (("--longitude", "west"), "is not a longitude"),
        (("--latitude", "north"), "'north' is not a latitude"),
        (("--height", "inf"), "a height in m of inf"),
        (("--scale", "nan"), "a scale in arcseconds per pixel of nan"),
        (("--mount", "morse+serial:///dev/ttyUSB0"), "names no known driver"),
        (("--mount", "ttyUSB0"), "names no driver"),
        (("--mount", "fake+morse://"), "there is no fake mount of 'morse'"),
        (("--mounting", "dobson"), "mounting"),
        (("--camera", 'a"b\\c\x01'), "control character"),
    ],
)
def test_an_answer_that_makes_no_sense_writes_nothing(
    flags: tuple[str, str], words: str, tmp_path: Path
) -> None:
    given = dict(zip(SITE[0:6:2], SITE[1:6:2], strict=True)) | {flags[0]: flags[1]}
    done = _run("init", "--no-look", *(part for pair in given.items() for part in pair), folder=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert not (tmp_path / "observatory.toml").exists()


@pytest.mark.long
def test_it_asks_on_a_terminal(tmp_path: Path) -> None:
    near, far = pty.openpty()
    process = subprocess.Popen(
        [*MOUNTNAV, "init", "--no-look"], cwd=tmp_path, stdin=far, stdout=far, stderr=far,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    os.close(far)
    answers = [b"south", b"-33.5", b"-70:42:00", b"high", b"1200", b"ttyUSB0", b"1", b"tripod", b"german"]
    answers += [b"simulated", b"fine", b"0"]
    os.write(near, b"".join(answer + b"\n" for answer in answers))  # typed ahead
    said = b""
    while True:
        try:
            said += os.read(near, 4096)
        except OSError:  # the other end is closed
            break
    assert process.wait() == 0, said.decode()
    # what makes no sense is asked for again
    for words in ("not a latitude", "not a height", "names no driver", "no mounting", "not a scale"):
        assert words in said.decode()
    settings = Settings.load(tmp_path / "observatory.toml")
    assert (settings.site.latitude_deg, settings.site.longitude_deg) == (-33.5, pytest.approx(-70.7))
    assert settings.telescope[0].mount.url == "fake+lx200://"


@pytest.mark.long
def test_check_tells_each_thing_that_is_wrong_with_its_fix(tmp_path: Path) -> None:
    assert _run("init", *SITE, "--mount", "lx200+serial:///dev/null", "--camera", "frames",
                folder=tmp_path).returncode == 0  # fmt: skip
    found = _findings(tmp_path)
    assert found["main: camera"]["state"] == "wrong"
    assert "frames" in found["main: camera"]["what"]
    assert found["main: camera"]["fix"]
    (tmp_path / "frames").mkdir()
    assert _findings(tmp_path)["main: camera"]["state"] == "right"
    text = (tmp_path / "observatory.toml").read_text()
    (tmp_path / "observatory.toml").write_text(text + '\n[telescope.model]\nfile = "none.json"\n')
    assert _findings(tmp_path)["main: model"]["state"] == "wrong"
    (tmp_path / "observatory.toml").write_text(text + '\n[catalogs]\nuse = ["gaia-dr9"]\n')
    assert _findings(tmp_path)["catalogs"]["state"] == "wrong"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (Path.mkdir, "it is a folder, not a file"),
        (lambda path: path.write_text("a long text that is no database"), "is not a journal"),
        (lambda path: path.symlink_to("/dev/null"), "it is a device, not a file"),
    ],
    ids=["folder", "text", "device"],
)
def test_check_tells_what_is_no_journal(make: Callable[[Path], object], words: str, tmp_path: Path) -> None:
    assert _run("init", *SITE, "--mount", "fake", folder=tmp_path).returncode == 0
    assert _findings(tmp_path)["journal"]["state"] == "right"
    make(tmp_path / "journal.sqlite")
    found = _findings(tmp_path)["journal"]
    assert found["state"] == "wrong"
    assert words in found["what"]
    assert found["fix"]


def test_an_empty_file_may_become_a_journal(tmp_path: Path) -> None:
    assert _run("init", *SITE, "--mount", "fake", folder=tmp_path).returncode == 0
    (tmp_path / "journal.sqlite").touch()
    assert _findings(tmp_path)["journal"]["state"] == "right"


def test_check_tells_a_port_that_is_taken(tmp_path: Path) -> None:
    assert _run("init", *SITE, "--mount", "fake", folder=tmp_path).returncode == 0
    file = tmp_path / "observatory.toml"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        file.write_text(file.read_text().replace("port = 8000", f"port = {number}"))
        found = _findings(tmp_path)["service"]
    assert found["state"] == "doubtful"
    assert str(number) in found["what"]


@pytest.mark.long
def test_check_with_connect_says_what_answers_and_sets_nothing(tmp_path: Path) -> None:
    link = tmp_path / "mount"
    with serving("--protocol", "lx200", "--dialect", "onstep", "--link", link) as (process, _):
        url = f"lx200+serial://{link}?set_clock=yes&baud=9600"
        assert _run("init", *SITE, "--mount", url, "--camera", tmp_path, folder=tmp_path).returncode == 0
        done = _run("check", "--connect", folder=tmp_path)
        assert "On-Step" in done.stdout or "OnStep" in done.stdout, done.stdout
        ended(process)
    done = _run("check", "--connect", folder=tmp_path)
    assert done.returncode == 2
    assert "main: mount" in done.stdout


@pytest.mark.parametrize(
    ("latitude", "longitude", "means"),
    [
        ("48.93", "-70.4", (48.93, -70.4)),
        ("33 51 35 S", "151 12 E", (-33.859722, 151.2)),
        ("33.86S", "70.4 W", (-33.86, -70.4)),
        ("48°51′24″", "2d21m3s", (48.856667, 2.350833)),
        ("−33:51", "11° 24' 15\"", (-33.85, 11.404167)),
    ],
)
def test_angles_of_a_site_as_people_type_them(
    tmp_path: Path, latitude: str, longitude: str, means: tuple[float, float]
) -> None:
    flags = ("--latitude", latitude, "--longitude", longitude, "--mount", "fake", "--mounting", "german")
    more = ("--height", "0", "--scale", "2", "--camera", "simulated", "--no-look")
    done = _run("init", *flags, *more, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    site = tomllib.loads((tmp_path / "observatory.toml").read_text())["site"]
    assert (site["latitude_deg"], site["longitude_deg"]) == pytest.approx(means, abs=1e-5)


@pytest.mark.parametrize("latitude", ["48.5.1", "48 51 24 E", "-48 N", "48 75", "11,404", "٤٨ 51"])
def test_angles_that_are_none_or_contradict_themselves_are_refused(tmp_path: Path, latitude: str) -> None:
    done = _run("init", "--latitude", latitude, "--longitude", "11", "--no-look", folder=tmp_path)
    assert done.returncode == 2
    assert "is not a latitude" in done.stderr
