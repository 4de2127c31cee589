"""A kind of catalog is added in one folder and one entry: done with a toy (docs/how-to/add-a-catalog.md)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from mountnav.catalog.credits import credit_of
from mountnav.catalog.doctor.obtainable import obtainable_catalogs
from mountnav.catalog.importing.job import import_catalog, stars_in_files
from mountnav.catalog.importing.order import ImportOrder
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.readers import CATALOGS, open_reader
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog, BadRequest
from mountnav.sky.coordinates import Icrs
from tests.catalog import toy_catalog
from tests.conftest import ROOT

PAGE = ROOT / "docs" / "how-to" / "add-a-catalog.md"
STARS = np.array([[10.0, 20.0, 5.0], [10.01, 20.01, 7.25], [200.0, -45.0, 9.0]])


@pytest.fixture
def _listed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one entry elsewhere."""
    monkeypatch.setitem(CATALOGS, "toy", toy_catalog.CATALOG)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two files of the toy catalog."""
    (tmp_path / "toys").mkdir()
    for name, rows in (("a.toy", STARS[:2]), ("b.toy", STARS[2:])):
        lines = [f"{ra:010.6f} {dec:+010.6f} {mag:04.1f}\n" for ra, dec, mag in rows]
        (tmp_path / "toys" / name).write_text("".join(lines))
    return tmp_path / "toys"


@pytest.mark.usefixtures("_listed")
def test_a_toy_is_imported_and_answers_a_cone(folder: Path, tmp_path: Path) -> None:
    imported = import_catalog(ImportOrder("toy", folder, "toy", tmp_path / "catalogs"))
    assert (imported.parts, imported.compared) == (2, 3)
    store = PackedStore(imported.path)
    stars = store.cone(Icrs(10.0, 20.0), 0.1, epoch_yr=2000.0)
    assert sorted(stars.mag) == pytest.approx([5.0, 7.2], abs=0.06)
    assert np.all(stars.flags & StarFlag.NO_PROPER_MOTION)
    # 0.5″ in 2000, and 20 mas more for each year since
    assert store.cone(Icrs(200.0, -45.0), 0.1, epoch_yr=2000.0).sigma_arcsec == pytest.approx([0.5], rel=1e-3)
    later = store.cone(Icrs(200.0, -45.0), 0.1, epoch_yr=2025.0).sigma_arcsec
    assert later == pytest.approx([np.hypot(0.5, 25 * 0.02)], rel=1e-3)


@pytest.mark.usefixtures("_listed")
def test_what_is_declared_is_known_everywhere(folder: Path, tmp_path: Path) -> None:
    imported = import_catalog(ImportOrder("toy", folder, "toy", tmp_path / "catalogs"))
    assert credit_of(imported.header.made_from) is toy_catalog.CATALOG.credit
    size_bytes = sum(path.stat().st_size for path in folder.iterdir())
    assert stars_in_files("toy", size_bytes) == 3
    (toy,) = (one for one in obtainable_catalogs() if one.kind == "toy")
    assert (toy.command, toy.terms) == ("mountnav catalog import toy FOLDER", "public domain")
    with pytest.raises(BadRequest, match="no kind of catalog") as refused:
        open_reader("nosuch", folder)
    assert "toy" in str(refused.value.advice)


@pytest.mark.usefixtures("_listed")
def test_what_isnt_a_toy_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadCatalog, match="no toy files"):
        open_reader("toy", tmp_path)
    (tmp_path / "bad.toy").write_text("10.0 twenty 5.0\n")
    reader = open_reader("toy", tmp_path)
    with pytest.raises(BadCatalog, match="twenty"):
        list(reader.read(reader.parts()[0]))


def test_sizes_of_records_are_those_of_the_layouts() -> None:
    """Declared where nothing heavy is imported, so written down a second time."""
    from mountnav.catalog.readers.siril.layout import STAR as SIRIL
    from mountnav.catalog.readers.ucac4.record import RECORD as UCAC4
    from mountnav.catalog.readers.usno_b1.record import RECORD as USNO_B1

    declared = {name: kind.source_bytes_per_star for name, kind in CATALOGS.items()}
    assert declared["ucac4"] == UCAC4.itemsize
    assert declared["usno-b1"] == USNO_B1.itemsize
    assert declared["siril"] == SIRIL.itemsize


def test_the_page_quotes_the_toy() -> None:
    quoted = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(quoted) == 2
    here = Path(toy_catalog.__file__).parent
    assert quoted[0] == (here / "__init__.py").read_text(encoding="utf-8")
    assert quoted[1] == (here / "reader.py").read_text(encoding="utf-8")
