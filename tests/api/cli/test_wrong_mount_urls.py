"""Wrong mount URLs end in one line that names the right form, and exit code 2; nothing is opened for them."""

from __future__ import annotations

import configparser
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from api.main import main
from api.observatory.observatory import require_devices
from drivers.registry import drivers, open_mount, read_url
from mountnav.errors import BadRequest, BadSettings
from mountnav.settings.observatory import Settings
from mountnav.sky.coordinates import Site

HERE = Site(49.6, 36.9)
SERIAL = [one for one in drivers() if one not in ("alpaca", "indi")]

WRONG = [
    # the four that were found
    ("onstep+serial:///dev/ttyUSB0", "write lx200+serial:///dev/ttyUSB0?dialect=onstep"),
    ("lx200+tcp://192.168.1.1", "write lx200+tcp://192.168.1.1:9999"),
    ("lx200+serial://dev/ttyUSB0", "write three slashes: lx200+serial:///dev/ttyUSB0"),
    ("lx200+serial:///dev/ttyUSB0?boud=9600", "did you mean baud?"),
    # their sisters
    ("/dev/ttyUSB0", "write lx200+serial:///dev/ttyUSB0"),
    ("192.168.1.1:9999", "write lx200+tcp://192.168.1.1:9999"),
    ("lx200+serial:/dev/ttyUSB0", "write lx200+serial:///dev/ttyUSB0"),
    ("", "for example lx200"),
    ("lx200", "for example lx200"),
    ("lx200+serial://", "names no serial port"),
    ("lx200+serial:///", "names no serial port"),
    ("lx200:///dev/ttyUSB0", "write lx200+serial:///dev/ttyUSB0"),
    ("lx200://192.168.1.1:9999", "write lx200+tcp://192.168.1.1:9999"),
    ("lx200+usb:///dev/ttyUSB0", "write lx200+serial:///dev/ttyUSB0"),
    ("lx200+telnet://host:23", "write lx200+tcp://host:23"),
    ("lx200+udp://host:4030", "known for lx200: serial, socket, tcp"),
    ("lx200+tcp://", "names no host"),
    ("lx200+tcp://:9999", "write lx200+tcp://192.168.0.20:9999"),
    ("lx200+tcp://host:99999", "range"),
    ("lx200+tcp://host:0", "ports are from 1 to 65535"),
    ("lx200+tcp://host:-1", "can't be read"),
    ("lx200+tcp://host:nine", "can't be read"),
    ("lx200+tcp://[::1:9999", "can't be read"),
    ("lx200+tcp://host:9999/mount", "write lx200+tcp://host:9999"),
    ("lx200+tcp://me:secret@host:9999", "takes none"),
    ("lx200+tcp://host:9999?dtr=no", "serial ports"),
    ("lx200+serial:///dev/ttyUSB0?baud=9600&baud=19200", "once"),
    ("lx200+serial:///dev/ttyUSB0?baud=9600.5", "whole number"),
    ("lx200+serial:///dev/ttyUSB0?baud=", "whole number"),
    ("lx200+serial:///dev/ttyUSB0?baud", "can't be read"),
    ("lx200+serial:///dev/ttyUSB0?baud=-9600", "whole number"),
    ("lx200+serial:///dev/ttyUSB0?baud=99999999999999999999", "whole number"),
    ("lx200+serial:///dev/ttyUSB0?baud=9600#", "%23"),
    ("lx200+serial:///dev/tty USB0", "%20"),
    ("lx200+serial:///dev/ttyUSB0\n", "invisible"),
    ("lx200+serial:///dev/ttyUSB0?timeout_s=nan", "above 0"),
    ("lx200+serial:///dev/ttyUSB0?timeout_s=0", "above 0"),
    ("lx200+serial:///dev/ttyUSB0?settle_s=1e6", "at most 120"),
    ("lx200+serial:///dev/ttyUSB0?dtr=maybe", "yes or no"),
    ("lx200+serial:///dev/ttyUSB0?dialect=onestep", "known: onstep"),
    ("lx200+serial:///dev/ttyUSB0?epoch=J2000", "icrs"),
    ("lx20+serial:///dev/ttyUSB0", "did you mean lx200+serial:///dev/ttyUSB0"),
    ("celestron+serial:///dev/ttyUSB0", "did you mean nexstar+serial:///dev/ttyUSB0"),
    ("eqmod+serial:///dev/ttyUSB0", "did you mean skywatcher+serial:///dev/ttyUSB0"),
    ("am5+tcp://host:4030", "write lx200+tcp://host:4030?dialect=am5"),
    ("fake+lx200://", "mountnav fake-mount"),
    ("http://host/telescope/0", "known: alpaca"),
    ("indi://host", "write indi://host:7624/Telescope%20Simulator"),
    ("indi+tcp://host:7624/EQMod", "write indi://host:7624/EQMod"),
    ("indi:///EQMod", "write indi://host:7624/EQMod"),
    ("indi://me@host/EQMod", "takes none"),
    ("indi://host:70000/EQMod", "range"),
    ("alpaca://host:11111/telescope/0", "alpaca+http://"),
    ("alpaca+http://host:11111", "telescope/0"),
    ("alpaca+http://host:11111/camera/0", "telescope"),
    ("alpaca+http://host:11111/telescope/zero", "telescope/0"),
    ("skywatcher+udp://192.168.4.1", "write skywatcher+udp://192.168.4.1:11880"),
    ("skywatcher+serial:///dev/ttyUSB0?guide_rate=7", "0.05 to 0.95"),
    ("nexstar+serial:///dev/ttyUSB0?park_az_deg=10", "both park_az_deg"),
    ("ioptron+serial:///dev/ttyUSB0?dialect=v4", "known: v3"),
]


@pytest.mark.parametrize(("url", "told"), WRONG)
def test_it_is_told_with_the_right_form(url: str, told: str) -> None:
    with pytest.raises(BadSettings) as wrong:
        open_mount(url, site=HERE)
    assert told in str(wrong.value)
    assert wrong.value.advice
    assert "secret" not in str(wrong.value)
    assert len(str(wrong.value)) < 1000


@pytest.mark.parametrize("driver", SERIAL)
def test_every_family_tells_the_same(driver: str) -> None:
    for url, told in (
        (f"{driver}+serial://dev/ttyUSB0", f"{driver}+serial:///dev/ttyUSB0"),
        (f"{driver}+tcp://host", f"{driver}+tcp://host:"),
        (f"{driver}+serial:///dev/ttyUSB0?boud=1", "did you mean baud?"),
        (f"{driver}+serial:///dev/ttyUSB0?dtr=1&dtr=0", "once"),
        (f"{driver}://host:1", f"{driver}+tcp://host:1"),
    ):
        with pytest.raises(BadSettings) as wrong:
            open_mount(url, site=HERE)
        assert told in str(wrong.value)
    made = open_mount(f"{driver}+serial:///dev/ttyUSB0?dtr=no&rts=yes&settle_s=2.5&greeting_s=20", site=HERE)
    assert made.name == "/dev/ttyUSB0"


def test_the_right_forms_that_are_advised_are_right() -> None:
    for url in (
        "lx200+serial:///dev/ttyUSB0?dialect=onstep",
        "lx200+tcp://192.168.1.1:9999",
        "indi://host:7624/Telescope%20Simulator",
        "skywatcher+udp://192.168.4.1:11880",
    ):
        open_mount(url, site=HERE)
    assert read_url("alpaca+http://me:secret@host:11111/telescope/0").password == "secret"


SETTINGS = """\
[site]
latitude_deg = 49.6
longitude_deg = 36.9

[service]
port = 0

[journal]
url = "sqlite:///{folder}/journal.sqlite"

[[telescope]]
id = "main"

[telescope.mount]
url = "{url}"

[telescope.camera]
{camera}
"""
FOLDER = 'kind = "folder"\npath = "{folder}"'


def settings_file(folder: Path, url: str, camera: str = FOLDER) -> Path:
    file = folder / "observatory.toml"
    camera = camera.replace("{folder}", str(folder))
    file.write_text(SETTINGS.format(folder=folder, url=url, camera=camera), encoding="utf-8")
    return file


@pytest.mark.long
@pytest.mark.parametrize(
    ("url", "told"), [one for one in WRONG if "\n" not in one[0] and one[0][:4] != "fake"]
)
def test_the_settings_are_checked_before_anything_is_opened(tmp_path: Path, url: str, told: str) -> None:
    file = settings_file(tmp_path, url)
    with pytest.raises(BadSettings) as wrong:
        require_devices(Settings.load(file), file)
    assert str(wrong.value).startswith(f"{file}: line 15: telescope")
    assert told in str(wrong.value) or "lx200+serial://" in str(wrong.value)


@pytest.mark.parametrize(
    ("camera", "told"),
    [
        ('kind = "indi"\nurl = "indi://localhost:7624"', "names no device"),
        ('kind = "indi"\nurl = "indi://localhost/CCD?bining=2"', "did you mean binning?"),
    ],
)
def test_cameras_too(tmp_path: Path, camera: str, told: str) -> None:
    file = settings_file(tmp_path, "lx200+tcp://host:9999", camera)
    with pytest.raises(BadSettings, match="camera") as wrong:
        require_devices(Settings.load(file), file)
    assert told in str(wrong.value).replace("\\", "")


def test_a_fake_of_an_unknown_dialect(tmp_path: Path) -> None:
    file = settings_file(tmp_path, "fake+lx200://?dialect=onestep")
    with pytest.raises(BadSettings, match="there is: generic"):
        require_devices(Settings.load(file), file)


@dataclass(frozen=True)
class Ended:
    """What came of a command."""

    returncode: int
    stdout: str
    stderr: str


def command(*words: str) -> Ended:
    """Run it in a process of its own: it serves."""
    ran = subprocess.run(
        [sys.executable, "-m", "api.main", *words], capture_output=True, text=True, timeout=120, check=False
    )
    return Ended(ran.returncode, ran.stdout, ran.stderr)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Run it in this process: it ends before it does anything."""

    def run(*words: str) -> Ended:
        monkeypatch.setattr(sys, "argv", ["mountnav", *words])
        with pytest.raises(SystemExit) as end:
            main()
        told = capsys.readouterr()
        return Ended(int(end.value.code or 0), told.out, told.err)

    return run


def test_serve_says_one_line_and_ends_with_2(tmp_path: Path, here: Callable[..., Ended]) -> None:
    for url in ("onstep+serial:///dev/ttyUSB0", "lx200+serial:///dev/ttyUSB0?boud=9600"):
        ended = here("serve", "--config", str(settings_file(tmp_path, url)))
        assert ended.returncode == 2
        assert ended.stderr.count("\n") == 1
        assert "Traceback" not in ended.stdout + ended.stderr
        assert not (tmp_path / "journal.sqlite").exists(), "something was opened"


@pytest.mark.long
@pytest.mark.parametrize(
    ("more", "told"),
    [
        ('[telescope.limits]\nhorizon_file = "/nowhere/horizon.txt"\n', "horizon"),
        ('[catalogs]\nuse = ["nowhere"]\n', "nowhere"),
    ],
)
def test_what_only_the_start_can_find_out_is_told_as_plainly(tmp_path: Path, more: str, told: str) -> None:
    file = settings_file(tmp_path, "fake+lx200://")
    file.write_text(file.read_text(encoding="utf-8") + more, encoding="utf-8")
    ended = command("serve", "--config", str(file))
    assert ended.returncode == 2, ended.stderr
    assert "Traceback" not in ended.stdout + ended.stderr
    assert told in ended.stderr.splitlines()[-1]


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        ("wire", "onstep+serial:///dev/ttyUSB0"),
        ("bench", "lx200+tcp://192.168.1.1", "49.6", "36.9"),
        ("bench", "skywatcher+serial://dev/ttyUSB0", "49.6", "36.9"),
        ("ports", "--probe", "--port", "lx200+tcp://host"),
        ("ports", "--probe", "--port", "ftp://host:21"),
    ],
)
def test_other_commands_too(words: tuple[str, ...], here: Callable[..., Ended]) -> None:
    ended = here(*words)
    assert ended.returncode == 2, ended.stderr
    assert "Traceback" not in ended.stderr
    assert len(ended.stderr) < 1500


def test_wire_leaves_the_file_alone(tmp_path: Path) -> None:
    from api.cli.wire import wire

    kept = tmp_path / "kept.jsonl"
    kept.write_text("dear\n", encoding="utf-8")
    with pytest.raises((BadSettings, BadRequest)):
        wire("lx200+tcp://host", follow=False, dump=kept)
    assert kept.read_text(encoding="utf-8") == "dear\n"


def test_the_unit_starts_it_never_again_for_that() -> None:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.read(Path(__file__).parents[3] / "deploy" / "mountnav.service")
    assert "2" in unit["Service"]["RestartPreventExitStatus"].split()
