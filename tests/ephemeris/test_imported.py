"""Imported catalogs: found by name, written at once or not at all, damaged ones told."""

from __future__ import annotations

import gzip
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from mountnav.ephemeris import SolarSystemBody
from mountnav.ephemeris.imported import (
    Imports,
    _quick_key,
    ephemerides_folder,
    forget,
    import_file,
    slug_of,
    use_imports,
)
from mountnav.ephemeris.named import ephemeris_of_name, found_of_name
from mountnav.ephemeris.satellite import SatelliteElements
from mountnav.errors import BadRequest, NotFound
from mountnav.sky.kernel import SHIPPED_PATH, use_kernels
from mountnav.sky.named import NamedObject, name_key
from tests.conftest import ROOT
from tests.ephemeris.samples import (
    CERES_2024,
    CERES_2025,
    HALLEY,
    HOWELL,
    ISS,
    ISS_1,
    ISS_2,
    PALLAS_2024,
    SITE,
    with_checksum,
)
from tests.ephemeris.test_mpc import COMET, RECORD

HEADER = f"MINOR PLANET CENTER ORBIT DATABASE (MPCORB)\n\nof a test\n{'-' * 160}\n"
NOW = datetime(2025, 6, 1, tzinfo=UTC)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    where = tmp_path / "ephemerides"
    use_imports(where)
    yield where
    use_imports()
    use_kernels(())


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_a_catalog_is_found_by_name_number_and_designation(folder: Path, tmp_path: Path) -> None:
    done = import_file(written(tmp_path / "MPCORB.DAT", f"{HEADER}{CERES_2025}\n\n{PALLAS_2024}\n"), folder)
    assert (done.slug, done.objects, done.refused) == ("mpcorb", 2, 0)
    for name in ("Ceres", "ceres", "1 Ceres", "(1) Ceres", "1"):
        found = found_of_name(name)
        assert found.name == "1 Ceres"
    assert found_of_name("2").name == "2 Pallas"
    place = ephemeris_of_name("Ceres", NOW, SITE).icrs(NOW, SITE)
    assert 0.0 <= place.ra_deg < 360.0
    # what is bundled goes before what is imported
    assert isinstance(found_of_name("Vega"), NamedObject)


def test_comets_satellites_and_json(folder: Path, tmp_path: Path) -> None:
    import_file(written(tmp_path / "CometEls.txt", f"{HALLEY}\n{HOWELL}\n"), folder)
    import_file(written(tmp_path / "stations.txt", ISS), folder)
    packed = tmp_path / "mpcorb_extended.json.gz"
    packed.write_bytes(gzip.compress(json.dumps([RECORD, COMET], indent=1).encode()))
    done = import_file(packed, folder)
    assert (done.slug, done.objects) == ("mpcorb_extended", 2)
    assert found_of_name("1P").name == "1P/Halley"
    assert found_of_name("Halley").name == "1P/Halley"
    assert found_of_name("C/2023 A3").name == "C/2023 A3 (Tsuchinshan-ATLAS)"
    assert found_of_name("1898 DQ").name == "433 Eros"
    station = found_of_name("NORAD 25544")
    assert station.name == "ISS (ZARYA)"
    assert isinstance(getattr(station, "elements", None), SatelliteElements)
    assert {one.slug for one in Imports(folder).all()} == {"cometels", "stations", "mpcorb_extended"}


def test_of_two_imports_the_newer_elements_count(folder: Path, tmp_path: Path) -> None:
    import_file(written(tmp_path / "new.dat", CERES_2025), folder)
    import_file(written(tmp_path / "old.dat", CERES_2024), folder)
    found = Imports(folder).find("Ceres")
    assert [(one.slug, getattr(one.elements, "epoch_jd", None)) for one in found] == [("new", 2460800.5)]


def test_of_several_of_one_name_none_is_taken(folder: Path, tmp_path: Path) -> None:
    other_1, other_2 = (line[:2] + "25545" + line[7:68] for line in (ISS_1, ISS_2))
    twice = f"DEBRIS\n{ISS_1}\n{ISS_2}\nDEBRIS\n{with_checksum(other_1)}\n{with_checksum(other_2)}\n"
    import_file(written(tmp_path / "debris.txt", twice), folder)
    with pytest.raises(BadRequest, match="2 objects are called 'debris'"):
        found_of_name("debris")
    assert found_of_name("NORAD 25545").name == "DEBRIS"


def test_search_finds_what_begins_so(folder: Path, tmp_path: Path) -> None:
    lines = [
        CERES_2025[:166] + f"({number}) Starlike{number}".ljust(28) + "20260103"
        for number in range(5000, 5400)
    ]
    import_file(written(tmp_path / "many.dat", "\n".join([*lines, PALLAS_2024])), folder)
    imports = Imports(folder)
    assert [one.name for one in imports.search("pal")] == ["2 Pallas"]
    assert len(imports.search("starlike", 7)) == 7
    assert imports.search("") == []
    assert imports.search("%") == []
    assert imports.find("x' OR '1'='1") == []


def test_an_import_replaces_its_forerunner_at_once(folder: Path, tmp_path: Path) -> None:
    import_file(written(tmp_path / "mine.dat", CERES_2024), folder)
    imports = Imports(folder)
    assert imports.find("Ceres")[0].elements.epoch_jd == 2460400.5  # type: ignore[union-attr]
    import_file(written(tmp_path / "mine.dat", CERES_2025), folder)
    assert imports.find("Ceres")[0].elements.epoch_jd == 2460800.5  # type: ignore[union-attr]
    with pytest.raises(BadRequest, match="no elements"):
        import_file(written(tmp_path / "mine.dat", "\n\n"), folder)
    assert imports.find("Ceres")
    assert forget(folder, "mine").objects == 1
    assert not imports.find("Ceres")
    with pytest.raises(NotFound, match="no import is called 'mine'"):
        forget(folder, "mine")
    assert [path.name for path in folder.iterdir()] == [".lock"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("no elements at all", "can't be read"),
        ("\n".join([CERES_2025] * 20 + [CERES_2025[:60]] * 5), "5 of 25 entries"),
        ("[", "broken or cut off"),
        ('[{"Epoch": 1}]', "can't be read"),
        ("[1, 2]", "can't be read"),
        ("", "no elements"),
    ],
)
def test_a_file_that_is_none_changes_nothing(folder: Path, tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(BadRequest, match=says):
        import_file(written(tmp_path / "wrong.dat", text), folder)
    assert not Imports(folder).all()
    assert [path.name for path in folder.iterdir()] == [".lock"]


def test_a_damaged_gzip_and_a_missing_file_are_told(folder: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.json.gz"
    cut.write_bytes(gzip.compress(json.dumps([RECORD] * 2000).encode())[:300])
    with pytest.raises(BadRequest, match=r"cut\.json\.gz"):
        import_file(cut, folder)
    with pytest.raises(BadRequest, match=r"none\.dat can't be imported"):
        import_file(tmp_path / "none.dat", folder)
    with pytest.raises(BadRequest, match="not a name of an import"):
        import_file(cut, folder, "../../etc")


def test_a_few_wrong_lines_are_told_and_left_out(folder: Path, tmp_path: Path) -> None:
    done = import_file(written(tmp_path / "a.dat", "\n".join([CERES_2025] * 150 + [CERES_2025[:60]])), folder)
    assert (done.objects, done.refused) == (150, 1)
    assert "line 151 has 60 letters" in done.first_refused[0]


def test_a_damaged_index_is_told_and_the_others_serve(folder: Path, tmp_path: Path) -> None:
    import_file(written(tmp_path / "good.dat", CERES_2025), folder)
    (folder / "bad.mne").write_bytes(b"SQLite format 3\x00" + bytes(5000))
    (folder / "worse.mne").write_text("nothing")
    told = {one.slug: one.problem for one in Imports(folder).all()}
    assert told["good"] is None
    assert told["bad"] is not None
    assert told["worse"] is not None
    assert Imports(folder).find("Ceres")


def test_an_spk_file_is_imported_and_serves(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "DE.bsp"
    shutil.copy(SHIPPED_PATH, copy)
    done = import_file(copy, folder)
    assert (done.slug, done.objects) == ("de", 14)
    assert [(one.slug, one.what, one.objects) for one in Imports(folder).all()] == [("de", "kernel", 14)]
    use_imports(folder)
    assert SolarSystemBody("mars").icrs(NOW, SITE)
    with pytest.raises(BadRequest, match=r"x\.bsp"):
        import_file(written(tmp_path / "x.bsp", "nothing"), folder)


@pytest.mark.parametrize(
    "name", ["1 Ceres", "C/2023 A3", "(433) Eros", "0012 P-L", "Ma'at", "2004 QZ", "3 And", "Müller"]
)
def test_the_quick_way_to_compare_a_name_is_the_same(name: str) -> None:
    assert _quick_key(name) == name_key(name)


def test_names_of_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert slug_of(Path("MPCORB.DAT.gz")) == "mpcorb"
    assert slug_of(Path("…")) == "import"
    assert ephemerides_folder(tmp_path) == tmp_path
    monkeypatch.delenv("MOUNTNAV_EPHEMERIDES")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert ephemerides_folder() == tmp_path / "mountnav" / "ephemerides"


@pytest.mark.long
def test_whoever_is_killed_in_an_import_leaves_the_old_one(folder: Path, tmp_path: Path) -> None:
    import_file(written(tmp_path / "mine.dat", CERES_2024), folder)
    long = tmp_path / "long.dat"
    long.write_text("\n".join([CERES_2025] * 60_000))
    code = (
        "import sys; from pathlib import Path; from mountnav.ephemeris.imported import import_file; "
        "import_file(Path(sys.argv[1]), Path(sys.argv[2]), 'mine', lambda count: print(count, flush=True))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(long), str(folder)],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"20000\n"
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    assert Imports(folder).find("Ceres")[0].elements.epoch_jd == 2460400.5  # type: ignore[union-attr]
    # and the next import isn't held up by it, and clears what it left
    assert import_file(written(tmp_path / "mine.dat", CERES_2025), folder).objects == 1
    assert sorted(path.name for path in folder.iterdir()) == [".lock", "mine.mne"]


def test_a_moon_and_a_minor_planet_of_one_name_are_told_apart(folder: Path, tmp_path: Path) -> None:
    assert found_of_name("Europa") == SolarSystemBody("europa")
    europa = CERES_2025[:166] + "(52) Europa".ljust(28) + "20260103"
    import_file(written(tmp_path / "a.dat", europa), folder)
    with pytest.raises(BadRequest, match=r"Europa \(which is also Jupiter II\), 52 Europa"):
        found_of_name("Europa")
    assert found_of_name("Jupiter II") == SolarSystemBody("europa")
    assert found_of_name("52 Europa").name == "52 Europa"
