"""The command line as others script it: what it prints, and with which exit code it ends."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial
from astropy.io import fits

from mountnav import __version__
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.command_here import run_here

MOUNTNAV = (sys.executable, "-m", "api.main")
KEYS = [
    "file",
    "solved",
    "ra_deg",
    "dec_deg",
    "scale_arcsec_px",
    "rotation_deg",
    "parity",
    "rms_arcsec",
    "pairs",
    "false_probability",
    "mode",
    "time_s",
    "wcs",
    "reason",
    "center_sigma_arcsec",
    "rejected_by",
    "reason_code",
    "numbers",
    "contradictions",
    "notes",
    "quality",
    "catalog",
    "catalog_steps",
    "errors_arcsec",
]


def _run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [*MOUNTNAV, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)


@contextmanager
def _serving(*arguments: str | Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run a command that prints its address when it is ready; interrupted in the end if still there."""
    process = subprocess.Popen([*MOUNTNAV, *map(str, arguments)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process, process.stdout.readline().strip()
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.wait()
        process.stdout.close()


@pytest.fixture(scope="module")
def frame(shared: Path) -> tuple[Path, dict[str, Any]]:
    """A rendered frame and its truth."""
    folder = shared / "data" / "rendered"
    truths = json.loads((folder / "truth.json").read_text())
    truth: dict[str, Any] = next(one for one in truths if one["file"].startswith("E02"))
    return folder / truth["file"], truth


def test_version_of_the_installed_script() -> None:
    script = Path(sys.executable).parent / "mountnav"
    done = subprocess.run([str(script), "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"mountnav {__version__}\n"


@pytest.mark.long
def test_solve_prints_one_object_a_file_in_order_and_does_the_others_too(
    frame: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    path, truth = frame
    no_image = tmp_path / "notes.fits"
    no_image.write_text("these are my notes")
    truncated = tmp_path / "truncated.fits"
    truncated.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    files: list[str | Path] = [no_image, path, truncated, tmp_path / "none.fits"]
    hint = truth["hint"]
    done = _run(
        "solve",
        "--json",
        *files,
        *(
            "--ra",
            str(hint["ra"]),
            "--dec",
            str(hint["dec"]),
            "--radius",
            "1.5",
            "--scale",
            str(hint["scale"]),
        ),
    )
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("1 of 4 frames solved in ")
    assert done.stderr.count("\n") == 2
    records = [json.loads(line) for line in done.stdout.splitlines()]
    assert [record["file"] for record in records] == [str(file) for file in files]
    assert [record["solved"] for record in records] == [False, True, False, False]
    for record in records:
        assert list(record) == KEYS
        assert list(record["time_s"]) == ["read", "measure", "identify", "total"]
        assert (record["reason"] is None) == (record["reason_code"] is None) == record["solved"]
    solved = records[1]
    miss_arcsec = separation_arcsec(
        Icrs(solved["ra_deg"], solved["dec_deg"]), Icrs(truth["ra"], truth["dec"])
    )
    assert miss_arcsec < truth["scale"]
    assert solved["scale_arcsec_px"] == pytest.approx(truth["scale"], rel=0.005)
    assert solved["parity"] in {1, -1}
    assert solved["wcs"]["CTYPE1"].startswith("RA---TAN")
    assert 0 < solved["center_sigma_arcsec"] < 0.1 * truth["scale"]
    assert solved["contradictions"] == []
    quality = solved["quality"]
    assert quality["images"] == "well sampled"
    assert quality["fwhm_px"] == pytest.approx(truth["fwhm"], rel=0.1)
    assert quality["fwhm_arcsec"] == pytest.approx(quality["fwhm_px"] * truth["scale"], rel=0.01)
    assert 12.0 < quality["limiting_mag"] < 22.0
    assert quality["sky_mag_arcsec2"] is None  # without a bias nothing tells how much of the level is sky


@pytest.mark.long
def test_solve_for_people_exits_0_when_all_are_solved(frame: tuple[Path, dict[str, Any]]) -> None:
    path, truth = frame
    hint = truth["hint"]
    low, high = str(0.95 * hint["scale"]), str(1.05 * hint["scale"])
    done = _run(
        *("solve", path, "--ra", str(hint["ra"]), "--dec", str(hint["dec"]), "--radius", "1.5"),
        *("--scale-low", low, "--scale-high", high),
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert path.name in done.stdout
    assert "″/px" in done.stdout


IN_A_PROCESS = (["solve"], ["serve", "--config", "/there/is/none.toml"], ["fake-mount", "--tcp", "nowhere"])


@pytest.mark.long
@pytest.mark.parametrize(
    "arguments",
    [
        ["solve"],
        ["solve", "x.fits", "--ra", "ten"],
        ["solve", "x.fits", "--ra", "10"],
        ["solve", "x.fits", "--ra", "nan", "--dec", "0"],
        ["solve", "x.fits", "--ra", "10", "--dec", "91"],
        ["solve", "x.fits", "--radius", "1"],
        ["solve", "x.fits", "--scale", "2", "--scale-low", "1"],
        ["solve", "x.fits", "--scale-low", "3", "--scale-high", "2"],
        ["solve", "x.fits", "--scale", "-1"],
        ["solve", "x.fits", "--nonsense"],
        ["nonsense"],
        ["serve"],
        ["serve", "--config", "/there/is/none.toml"],
        ["fake-mount", "--protocol", "morse"],
        ["fake-mount", "--tcp", "nowhere"],
        ["fake-mount", "--tcp", "localhost:1", "--link", "x"],
        ["fake-mount", "--errors", "/there/is/none.toml"],
        ["catalog", "cone", "--ra", "1"],
        ["catalog", "cone", "--ra", "nan", "--dec", "0", "--radius", "1"],
    ],
)
def test_bad_usage_exits_2_and_says_why(arguments: list[str]) -> None:
    done = (_run if arguments in IN_A_PROCESS else run_here)(*arguments)
    assert done.returncode == 2, done.stdout + done.stderr
    assert done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


@pytest.mark.long
def test_a_broken_config_names_line_and_fix_in_one_line(tmp_path: Path) -> None:
    config = tmp_path / "observatory.toml"
    config.write_text("[site]\nlatitude_deg = 97\nlongitude_deg = 11\n[[telescope]]\n")
    config.write_text(
        config.read_text() + 'id = "t"\nmount = { url = "fake+lx200://" }\ncamera = { kind = "simulated" }\n'
    )
    done = _run("serve", "--config", config)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert f"{config}: line 2: site.latitude_deg" in done.stderr


@pytest.mark.long
def test_serve_goes_down_cleanly_on_sigterm(tmp_path: Path, observatory_toml: str) -> None:
    config = tmp_path / "observatory.toml"
    config.write_text(observatory_toml)
    process = subprocess.Popen([*MOUNTNAV, "serve", "--config", config], stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    with process.stderr as log:
        told = ""
        while "startup complete" not in told:
            line = log.readline()
            assert line, told
            told += line
        process.send_signal(signal.SIGTERM)
        told += log.read()
    # uvicorn raises the signal again once all is at rest, so that the caller sees why it ended
    assert process.wait() in {0, -signal.SIGTERM}, told
    assert "shutdown complete" in told
    assert "Traceback" not in told


@pytest.mark.long
def test_a_fake_mount_on_a_pseudo_terminal_answers_and_tidies_up(tmp_path: Path) -> None:
    link = tmp_path / "mount"
    errors = tmp_path / "errors.toml"
    errors.write_text("ih_arcsec = 300.0\n")
    with _serving("fake-mount", "--protocol", "lx200", "--link", link, "--errors", errors) as (
        process,
        address,
    ):
        assert address == str(link)
        assert link.is_symlink()
        with serial.Serial(address, 9600, timeout=10) as port:
            port.write(b":GD#")
            assert port.read_until(b"#").endswith(b"#")
        process.send_signal(signal.SIGTERM)
        assert process.wait() == 0
    assert not link.is_symlink()


@pytest.mark.long
def test_a_fake_mount_on_tcp_tells_its_port() -> None:
    with _serving("fake-mount", "--tcp", "127.0.0.1:0") as (process, address):
        with serial.serial_for_url(address, timeout=10) as port:
            port.write(b":GR#")
            assert port.read_until(b"#").endswith(b"#")
        process.send_signal(signal.SIGINT)
        assert process.wait() == 0


@pytest.mark.long
def test_a_link_over_a_file_is_refused(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("keep")
    assert _run("fake-mount", "--link", precious).returncode == 2
    assert precious.read_text() == "keep"


@pytest.mark.long
def test_the_catalog_tells_what_it_holds() -> None:
    facts = json.loads(_run("catalog", "info", "--json").stdout)
    assert facts["stars"] > 2_500_000
    vega = _run(
        "catalog", "cone", "--ra", "279.2347", "--dec", "38.7837", "--radius", "0.1", "--mag", "2", "--json"
    )
    star = json.loads(vega.stdout)
    assert star["mag"] < 0.5
    table = _run(
        "catalog", "cone", "--ra", "279.2347", "--dec", "38.7837", "--radius", "0.1", "--epoch", "2000"
    )
    assert "ra_deg" in table.stdout
    assert "J2000.00" in table.stdout


@pytest.mark.long
def test_output_into_a_closed_pipe_is_no_crash() -> None:
    command = [*MOUNTNAV, "catalog", "cone", "--ra", "280", "--dec", "38", "--radius", "4", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    select.select([process.stdout], [], [])
    os.read(process.stdout.fileno(), 10)
    process.stdout.close()
    with process.stderr as trouble:
        assert "Traceback" not in trouble.read()
    process.wait()


@pytest.mark.long
def test_solve_tells_of_a_wrong_hint_and_takes_the_paper_profile(frame: tuple[Path, dict[str, Any]]) -> None:
    path, truth = frame
    hint = truth["hint"]
    done = _run(
        *("solve", "--json", path, "--ra", str(hint["ra"]), "--dec", str(hint["dec"]), "--radius", "1.5"),
        *("--scale", str(1.2 * truth["scale"])),
    )
    record = json.loads(done.stdout)
    assert record["solved"], record["reason"]
    assert len(record["contradictions"]) == 1
    assert record["contradictions"][0].startswith("scale: caller says")
    for options, told in (
        (["--profile", "papr"], "measured or paper"),
        (["--config", "none.toml"], "none.toml"),
    ):
        done = _run("solve", path, *options)
        assert done.returncode == 2, done.stderr
        assert told in done.stderr


@pytest.mark.long
def test_names_of_any_bytes_and_full_disks_are_borne(
    frame: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    odd = tmp_path / os.fsdecode(b"odd\xff\x1b[31m.fits")
    odd.write_bytes(b"no image")
    done = _run("solve", "--json", odd)
    assert done.returncode == 1
    assert json.loads(done.stdout)["file"].endswith("odd\ufffd\ufffd[31m.fits")
    with Path("/dev/full").open("w") as full:
        command = [*MOUNTNAV, "solve", "--json", str(odd)]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "mountnav: No space left on device\n"


@pytest.mark.long
def test_masters_that_do_not_fit_are_told(frame: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    path, truth = frame
    rng = np.random.default_rng(1)
    for number in range(3):
        bias = rng.normal(300.0, 5.0, (64, 64)).astype(np.uint16)
        fits.PrimaryHDU(bias, fits.Header([("IMAGETYP", "Bias Frame"), ("EXPTIME", 0.0)])).writeto(
            tmp_path / f"b{number}.fits"
        )
    masters = tmp_path / "masters"
    built = _run("calibrate", "build", "--bias", tmp_path / "b0.fits", tmp_path / "b1.fits", "--out", masters)
    assert built.returncode == 0, built.stderr
    hint = truth["hint"]
    asked = (
        "--ra",
        str(hint["ra"]),
        "--dec",
        str(hint["dec"]),
        "--radius",
        "1.5",
        "--scale",
        str(hint["scale"]),
    )
    done = _run("solve", "--json", path, *asked, "--calibration", masters)
    record = json.loads(done.stdout)
    assert record["solved"]
    assert any("bias" in note for note in record["notes"])
