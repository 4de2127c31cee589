"""`mountnav catalog` as people and scripts use it: import, list, info, verify, cone, remove."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli.app import app
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.readers import CATALOGS
from mountnav.errors import BadCatalog, BadRequest, BadSettings, NotFound
from mountnav.sky.coordinates import Icrs
from tests.catalog.readers.ucac4_zones import star_count, write_zones
from tests.conftest import ROOT

MOUNTNAV = (sys.executable, "-m", "api.main")


@pytest.fixture(scope="module")
def zones(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_zones(tmp_path_factory.mktemp("cli") / "u4b")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of catalogs, by the environment."""
    monkeypatch.setenv("MOUNTNAV_CATALOGS", str(tmp_path / "catalogs"))
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "catalogs"


def _ask(*arguments: str | Path, answer: str | None = None) -> tuple[int, str, str]:
    """Run a command in this process; what it raises goes through, as to `api.main`."""
    done = CliRunner().invoke(app, ["catalog", *map(str, arguments)], input=answer)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, done.stdout, done.stderr


def _json(*arguments: str | Path) -> list[dict[str, Any]]:
    code, out, _ = _ask(*arguments, "--json")
    assert code == 0
    return [json.loads(line) for line in out.splitlines()]


def _run(*arguments: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*MOUNTNAV, "catalog", *map(str, arguments)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
        env=os.environ | environment,
    )


# import


def test_import_tells_in_plain_lines_what_it_did(zones: Path, folder: Path) -> None:
    code, out, err = _ask("import", "ucac4", zones)
    assert code == 0
    lines = out.splitlines()
    assert lines[0].startswith(f"ucac4: {star_count():,} stars of UCAC4, ")
    assert lines[1] == str(folder / "ucac4.mnc")
    assert re.fullmatch(r"\d+ stars of the source were looked for in it and found", lines[2])
    assert lines[3].startswith("terms: a work of the US Naval Observatory")
    told = err.splitlines()
    assert re.match(r"reading: 0 %  0 of 5 parts  0 kB of 186 kB  0 stars", told[0])
    assert [line.split(":")[0] for line in told] == ["reading", "sorting and writing", "checking"]
    assert "\x1b" not in out + err


def test_import_for_programs(zones: Path, folder: Path) -> None:
    (facts,) = _json("import", "ucac4", zones, "--name", "pole", "--dec-range", "-90", "-89.7")
    store = PackedStore(folder / "pole.mnc")
    assert facts["slug"] == "pole"
    assert facts["file"] == str(store.path)
    assert facts["stars"] == len(store)
    assert 206 < facts["stars"] < 866
    assert facts["resumed"] == 0
    assert facts["compared"] > 20
    assert facts["size_mb"] == round(store.path.stat().st_size / 1e6, 3)
    assert "Dec -90° to -89.7°" in store.header.made_from


@pytest.mark.long
def test_on_a_terminal_a_bar_is_drawn_on_stderr_alone(zones: Path, folder: Path) -> None:
    done = _run("import", "ucac4", zones, "--json", FORCE_COLOR="1", COLUMNS="160")
    assert done.returncode == 0
    assert json.loads(done.stdout)["stars"] == star_count()
    assert "\x1b[" in done.stderr
    assert "━" in done.stderr
    assert "of 5 parts" in done.stderr


INTERRUPTED = """
import signal, sys
from mountnav.catalog.readers.ucac4.reader import Ucac4Reader
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
plain, place = Ucac4Reader.read, sys.argv.pop(1)
def read(self, part):
    if part.name == place:
        signal.raise_signal(signal.SIGINT)  # in this very thread: another might swallow it
    yield from plain(self, part)
Ucac4Reader.read = read
from api.main import main
main()
"""


@pytest.mark.long
def test_ctrl_c_tells_how_to_go_on_and_the_same_command_goes_on(zones: Path, folder: Path) -> None:
    options = ["catalog", "import", "ucac4", str(zones), "--mag-limit", "15"]
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, "z899", *options],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 130
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    *_, told, command = done.stderr.splitlines()
    assert told == "interrupted: 3 of 5 parts are imported and kept. The same command continues:"
    assert command == f"  mountnav catalog import ucac4 {zones} --mag-limit 15"
    assert not (folder / "ucac4.mnc").exists()
    (row,) = [one for one in _json("list") if one["state"] == "unfinished"]
    assert row["slug"] == "ucac4"
    code, _, err = _ask(*command.split()[2:])
    assert code == 0
    assert err.splitlines()[0] == "resuming: 3 of 5 parts are imported"


@pytest.mark.long
def test_a_kill_from_outside_at_any_time_loses_nothing(tmp_path: Path, folder: Path) -> None:
    zones = tuple(range(20, 60))
    source = write_zones(tmp_path / "many", zones)
    arguments = ("import", "ucac4", source, "--json")
    assert _run(*arguments, "--folder", tmp_path / "whole").returncode == 0
    whole = (tmp_path / "whole" / "ucac4.mnc").read_bytes()
    kills = 0
    for parts in (1, 12, 30, 40):
        process = subprocess.Popen(
            [*MOUNTNAV, "catalog", *map(str, arguments)],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        spool = folder / "ucac4.import" / "spool"
        while process.poll() is None and len(list(spool.glob("*.stars"))) < parts:
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
        kills += process.wait() == -signal.SIGKILL
        assert not (folder / "ucac4.mnc").exists() or process.returncode == 0
    assert kills >= 3
    done = _run(*arguments, "--force")
    assert done.returncode == 0, done.stderr
    assert (folder / "ucac4.mnc").read_bytes() == whole


@pytest.mark.long
def test_what_is_wrong_ends_with_one_line_and_code_2(zones: Path, folder: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad"
    bad.mkdir()
    (bad / "z001").write_bytes((zones / "z001").read_bytes()[:-1])
    done = _run("import", "ucac4", bad)
    assert done.returncode == 2
    assert done.stdout == ""
    assert re.search(
        r"mountnav: z001: at byte 15990: expected a record of 78 bytes, found the end of the file after 77",
        done.stderr,
    )
    assert "Traceback" not in done.stderr


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "error", "told"),
    [
        (["ucac9", "."], BadRequest, "there are: ucac4, usno-b1, gaia"),
        (["ucac4", "nowhere"], BadCatalog, "no such file or folder"),
        (["ucac4", ".", "--name", "Up"], BadRequest, "can't be a catalog's name"),
        (["ucac4", ".", "--name", "tycho2"], BadRequest, "embedded catalog"),
        (["ucac4", ".", "--cone", "400", "0", "1"], BadRequest, "--cone RA DEC RADIUS"),
        (["ucac4", ".", "--cone", "10", "-30", "nan"], BadRequest, "radius"),
        (["ucac4", ".", "--dec-range", "10", "-10"], BadRequest, "lower first"),
        (["ucac4", ".", "--mag-limit", "99"], BadRequest, "-5 to 40"),
        (["ucac4", ".", "--config", "none.toml"], BadSettings, "can't be read"),
    ],
)
def test_wrong_usage_is_told(folder: Path, arguments: list[str], error: type[Exception], told: str) -> None:
    with pytest.raises(error, match=re.escape(told)):
        _ask("import", *arguments)
    assert not folder.exists()


def test_the_help_names_every_kind() -> None:
    code, out, _ = _ask("import", "--help")
    assert code == 0
    for kind in CATALOGS:
        assert kind in " ".join(out.split())


# settings

SETTINGS = """
[catalogs]
folder = "{folder}"
[[catalogs.online]]
name = "gaia-live"
url = "http://127.0.0.1:9/"
table = "I/355/gaiadr3"
band = "G"
epoch_yr = 2016.0
[nonsense]
other = "programs may keep their own here"
"""


@pytest.mark.long
def test_the_settings_file_names_folder_and_online_catalogs(
    zones: Path, folder: Path, tmp_path: Path
) -> None:
    config = tmp_path / "observatory.toml"
    config.write_text(SETTINGS.format(folder=tmp_path / "own"))
    (facts,) = _json("import", "ucac4", zones, "--config", config, "--mag-limit", "12")
    assert facts["file"] == str(tmp_path / "own" / "ucac4.mnc")
    assert [(row["slug"], row["state"]) for row in _json("list", "--config", config)] == [
        ("tycho2", "embedded"),
        ("ucac4", "imported"),
        ("gaia-live", "online"),
    ]
    assert [row["slug"] for row in _json("list")] == ["tycho2"]
    assert _json("info", "ucac4", "--config", config)[0]["stars"] == facts["stars"]
    assert _ask("verify", "ucac4", "--config", config)[0] == 0
    with pytest.raises(BadRequest, match="online catalog"):
        _ask("import", "ucac4", zones, "--config", config, "--name", "gaia-live")
    # the option goes before the file
    assert _json("list", "--config", config, "--folder", tmp_path / "none")[1]["slug"] == "gaia-live"
    config.write_text('[catalogs]\nfoldr = "x"\n')
    with pytest.raises(BadSettings, match="foldr"):
        _ask("list", "--config", config)


# list and info


@pytest.mark.long
def test_list_shows_the_damaged_one_with_its_problem(zones: Path, folder: Path) -> None:
    _json("import", "ucac4", zones)
    sound = (folder / "ucac4.mnc").read_bytes()
    (folder / "cut.mnc").write_bytes(sound[:-100])
    rows = {row["slug"]: row for row in _json("list")}
    assert list(rows) == ["tycho2", "cut", "ucac4"]
    assert rows["tycho2"]["stars"] == 2_550_960
    assert rows["tycho2"]["sky_percent"] == 100.0
    assert rows["ucac4"]["band"] == "UCAC"
    assert rows["ucac4"]["epoch_yr"] == 2000.0
    assert 16.4 < rows["ucac4"]["faintest_mag"] <= 16.5
    assert rows["ucac4"]["sky_percent"] < 2.0
    assert rows["cut"]["state"] == "damaged"
    assert "at byte" in rows["cut"]["problem"]
    code, out, _ = _ask("list")
    assert code == 0
    lines = out.splitlines()
    assert lines[0] == f"# imported catalogs are in {folder}"
    assert lines[1].split()[:4] == ["slug", "stars", "band", "commonest_mag"]
    assert lines[2].split()[:3] == ["tycho2", "2,550,960", "V"]
    assert lines[3].startswith("cut")
    assert "damaged: " in lines[3]


@pytest.mark.long
def test_info_of_an_import_agrees_with_its_source(zones: Path, folder: Path) -> None:
    _json("import", "ucac4", zones)
    (facts,) = _json("info", "ucac4")
    assert facts["name"] == "UCAC4"
    assert facts["stars"] == facts["sampled_stars"] == star_count()
    assert facts["made_from"].startswith("ucac4: UCAC4 (U.S. Naval Observatory")
    assert "Zacharias" in facts["credit"]
    assert facts["with_motion_percent"] == 100.0
    assert facts["with_color_percent"] == pytest.approx(33.3, abs=0.5)
    assert sum(one["share"] for one in facts["magnitudes"]) == pytest.approx(1.0, abs=1e-4)
    assert [one["mag"] for one in facts["magnitudes"]] == list(range(8, 17))
    # the zones' errors: 10 to 60 mas at 2002, proper motions known to 1 to 6 mas/yr
    years = facts["sigma_epoch_yr"] - 2002.0
    for one in facts["magnitudes"]:
        assert 0.025 < one["sigma_arcsec"] / np.hypot(1.0, years * 0.1) < 0.045
    code, out, _ = _ask("info", "ucac4")
    assert code == 0
    assert "stars/deg2" in out


@pytest.mark.long
def test_info_of_the_embedded_one_is_what_its_docs_say() -> None:
    (facts,) = _json("info")
    assert facts == _json("info", "tycho2")[0]
    assert facts["slug"] == "tycho2"
    assert facts["sky_percent"] == 100.0
    assert "BSD-2" in facts["terms"]
    assert facts["with_motion_percent"] == pytest.approx(95.2, abs=1.0)
    by_mag = {one["mag"]: one for one in facts["magnitudes"]}
    # docs/reference/catalog.md: 0.069″ at V 8-10.6, 0.113″ at 10.6-11.5
    assert 0.05 < by_mag[9]["sigma_arcsec"] < by_mag[11]["sigma_arcsec"] < 0.16
    # star counts of the whole file, by itself
    stars = embedded_catalog().cone(Icrs(0.0, 90.0), 180.0, epoch_yr=2000.0, mag_limit=9.9999)
    for mag in (8, 9):
        density = float(((stars.mag >= mag) & (stars.mag < mag + 1)).sum()) / 41252.96
        assert by_mag[mag]["density_deg2"] == pytest.approx(density, rel=0.15)


# verify


@pytest.mark.long
def test_verify_finds_a_flipped_bit_and_says_so_with_code_1(zones: Path, folder: Path) -> None:
    _json("import", "ucac4", zones)
    assert _ask("verify") == (0, "tycho2: sound\n", "")
    assert _ask("verify", "--all")[:2] == (0, "tycho2: sound\nucac4: sound\n")
    content = bytearray((folder / "ucac4.mnc").read_bytes())
    content[-2000] ^= 4
    (folder / "ucac4.mnc").write_bytes(content)
    assert _json("list")[1]["state"] == "imported"  # opening it doesn't tell
    code, out, _ = _ask("verify", "ucac4")
    assert code == 1
    assert re.match(r"ucac4: .*at byte \d+: expected .*sha256", out)
    (folder / "cut.mnc").write_bytes(content[:300])
    done = _run("verify", "--all", "--json")
    assert done.returncode == 1
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [(row["slug"], row["sound"]) for row in rows] == [
        ("tycho2", True),
        ("cut", False),
        ("ucac4", False),
    ]
    with pytest.raises(NotFound, match="there are: tycho2, cut, ucac4"):
        _ask("verify", "usno")
    with pytest.raises(BadRequest, match="--all"):
        _ask("verify", "ucac4", "--all")


# cone


@pytest.mark.long
def test_cone_of_an_import_prints_color_and_flags(zones: Path, folder: Path) -> None:
    _json("import", "ucac4", zones)
    place = ("--ra", "0", "--dec", "-90", "--radius", "0.1", "--epoch", "2000")
    rows = _json("cone", *place, "--catalog", "ucac4")
    store = PackedStore(folder / "ucac4.mnc")
    stars = store.cone(Icrs(0.0, -90.0), 0.1, epoch_yr=2000.0)
    assert len(rows) == len(stars) > 20
    assert [row["mag"] for row in rows] == stars.mag.tolist()
    assert {row["color_mag"] for row in rows} == {None, 0.0}
    assert all(row["flags"] == [] for row in rows)
    code, out, _ = _ask("cone", *place, "--catalog", "ucac4")
    assert code == 0
    assert out.splitlines()[0].endswith("stars of UCAC4, epoch J2000.00, mag in UCAC, color B-V")
    assert out.splitlines()[1].endswith("flags")
    with pytest.raises(NotFound, match="no catalog 'usno'"):
        _ask("cone", *place, "--catalog", "usno")
    (folder / "ucac4.mnc").write_bytes(b"MNAV")
    with pytest.raises(BadCatalog, match=r"ucac4: can't be used.*mountnav catalog remove ucac4"):
        _ask("cone", *place, "--catalog", "ucac4")


def test_cone_of_the_embedded_one_names_its_flags() -> None:
    # 61 Cygni A, one of the stars that Tycho-2 gives no proper motion for
    rows = _json("cone", "--ra", "316.7", "--dec", "38.75", "--radius", "0.1", "--mag", "6")
    flags = [row["flags"] for row in rows]
    assert ["no-proper-motion"] in flags


# remove


@pytest.mark.long
def test_remove_asks_once(zones: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _json("import", "ucac4", zones)
    with pytest.raises(BadRequest, match="--yes"):
        _ask("remove", "ucac4")
    monkeypatch.setattr("api.cli.catalog._is_interactive", lambda: True)
    assert _ask("remove", "ucac4", answer="n\n")[0] == 1
    assert (folder / "ucac4.mnc").exists()
    code, out, err = _ask("remove", "ucac4", answer="y\n")
    assert code == 0
    assert f"Remove {folder / 'ucac4.mnc'}?" in err
    assert re.search(r"^ucac4 is removed: 0\.\d MB are free again$", out, re.MULTILINE)
    assert list(folder.iterdir()) == []


@pytest.mark.long
def test_remove_of_what_isnt_there_or_stays(folder: Path) -> None:
    with pytest.raises(NotFound, match="no catalog 'ucac4'"):
        _ask("remove", "ucac4", "--yes")
    with pytest.raises(BadRequest, match="a part of mountnav"):
        _ask("remove", "tycho2", "--yes")
    folder.mkdir()
    (folder / "bad.mnc").write_bytes(b"noise")
    assert _ask("remove", "bad", "-y")[0] == 0
    (folder / "left.import").mkdir()
    assert _ask("remove", "left", "-y")[0] == 0
    assert list(folder.iterdir()) == []


DEAR = ("astropy", "pyarrow", "rich.progress", "mountnav.settings.catalogs")


@pytest.mark.long
def test_help_and_list_need_nothing_dear(folder: Path) -> None:
    told = "import json, sys; from api.main import main\ntry: main()\nexcept SystemExit: pass\n"
    told += f"print(json.dumps([name for name in {DEAR} if name in sys.modules]))"
    for arguments in (["import", "--help"], ["list"], ["verify", "--help"]):
        done = subprocess.run(
            [sys.executable, "-c", told, "catalog", *arguments],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        )
        assert json.loads(done.stdout.splitlines()[-1]) == []
