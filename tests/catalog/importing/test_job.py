"""Imports: whole, in part, interrupted, killed, refused; what comes out is always the same."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mountnav.catalog.importing import job as importing
from mountnav.catalog.importing.job import import_catalog
from mountnav.catalog.importing.order import EVERYTHING, Imported, ImportOrder, ImportProgress, Selection
from mountnav.catalog.installed import unfinished_path
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers import open_reader
from mountnav.catalog.readers.kind import Part
from mountnav.catalog.readers.ucac4.reader import Ucac4Reader
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog, BadRequest, BadSettings, Busy, MountnavError
from mountnav.sky.coordinates import Icrs
from tests.catalog.readers.ucac4_zones import SMALL, star_count, write_zones
from tests.conftest import ROOT


@pytest.fixture(scope="module")
def zones(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five small zones, to be left as they are."""
    return write_zones(tmp_path_factory.mktemp("ucac4") / "u4b")


@pytest.fixture(scope="module")
def whole(zones: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """What an import of them gives if nothing comes between."""
    folder = tmp_path_factory.mktemp("whole")
    return import_catalog(_order(zones, folder)).path.read_bytes()


def _order(source: Path, folder: Path, slug: str = "ucac4", **others: object) -> ImportOrder:
    return replace(ImportOrder("ucac4", source, slug, folder), **others)  # type: ignore[arg-type]


def _import(order: ImportOrder) -> tuple[Imported, list[ImportProgress], list[str]]:
    told: list[ImportProgress] = []
    notes: list[str] = []
    return import_catalog(order, tell=told.append, note=notes.append), told, notes


def _columns(folder: Path, zones: tuple[int, ...] = SMALL) -> CatalogColumns:
    """All stars as the reader gives them."""
    reader = open_reader("ucac4", folder)
    chunks = [chunk for part in reader.parts() for chunk in reader.read(part)]
    names = ("ra_deg", "dec_deg", "pm_ra_cosdec_mas_yr", "pm_dec_mas_yr", "mag", "error_curve")
    return CatalogColumns(*(np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in names))


def _all_stars(store: PackedStore) -> np.ndarray:
    stars = store.cone(Icrs(0.0, 90.0), 180.0, epoch_yr=2000.0)
    return np.sort(np.rint(stars.mag * 1000).astype(int))


# what goes in comes out


def test_every_star_of_the_source_is_in_the_store(zones: Path, tmp_path: Path) -> None:
    imported, told, notes = _import(_order(zones, tmp_path))
    assert imported.path == tmp_path / "ucac4.mnc"
    assert (imported.parts, imported.resumed) == (5, 0)
    assert imported.header.count == star_count()
    assert imported.header.made_from.startswith("ucac4: UCAC4")
    assert imported.compared >= 40
    assert notes == []
    assert [path.name for path in tmp_path.iterdir()] == ["ucac4.mnc"]
    source, store = _columns(zones), PackedStore(imported.path)
    for row in range(0, source.ra_deg.size, 37):
        found = store.cone(Icrs(source.ra_deg[row], source.dec_deg[row]), 0.01 / 3600.0, epoch_yr=2000.0)
        assert found.mag[0] == pytest.approx(source.mag[row], abs=0.0011)
    assert np.array_equal(_all_stars(store), np.sort(np.rint(source.mag * 1000).astype(int)))
    stages = [progress.stage for progress in told]
    assert list(dict.fromkeys(stages)) == ["reading", "packing", "checking"]
    reading = [progress for progress in told if progress.stage == "reading"]
    assert reading[-1].parts_done == 5
    assert reading[-1].bytes_done == reading[-1].size_bytes == 78 * star_count()
    assert reading[-1].stars == star_count()
    for stage in set(stages):
        shares = [progress.share for progress in told if progress.stage == stage]
        assert shares == sorted(shares)
        assert 0.0 <= shares[0] <= shares[-1] <= 1.0


@pytest.mark.shared
def test_the_real_zone_of_ucac4(shared: Path, tmp_path: Path) -> None:
    imported = import_catalog(_order(shared / "data" / "catalogs" / "z001", tmp_path))
    assert imported.header.count == 206
    store = PackedStore(imported.path)
    # the first line of the catalog's own dump, z001.asc: RA and south polar distance in mas
    dump = (shared / "data" / "catalogs" / "z001.asc").read_text().split(",")
    ra_deg, dec_deg = int(dump[0]) / 3.6e6, int(dump[1]) / 3.6e6 - 90.0
    assert len(store.cone(Icrs(ra_deg, dec_deg), 0.01 / 3600.0, epoch_yr=2000.0)) == 1
    assert len(store.cone(Icrs(0.0, -90.0), 0.25, epoch_yr=2000.0)) == 206


@pytest.mark.shared
def test_the_real_file_of_usno_b1(shared: Path, tmp_path: Path) -> None:
    source = tmp_path / "000"
    source.mkdir()
    (source / "b0000.cat").write_bytes((shared / "data" / "catalogs" / "usnob_b0000.cat").read_bytes())
    order = ImportOrder("usno-b1", source, "usno-b1", tmp_path / "catalogs")
    imported, _, notes = _import(order)
    assert 200 < imported.header.count <= 322
    left_out = sum(int(note.split()[0]) for note in notes)
    assert imported.header.count + left_out == 322


# a part of it


def test_a_magnitude_limit_takes_the_bright_ones(zones: Path, tmp_path: Path) -> None:
    imported = import_catalog(_order(zones, tmp_path, selection=Selection(mag_limit=12.0)))
    source = _columns(zones)
    assert imported.header.count == int((source.mag <= 12.0).sum()) > 100
    assert _all_stars(PackedStore(imported.path)).max() <= 12_000
    assert imported.header.made_from.endswith("; to magnitude 12")


def test_a_magnitude_limit_leaves_out_stand_ins() -> None:
    count = 4
    flags = np.array([0, StarFlag.NO_MAGNITUDE, StarFlag.DOUBLE, 0], dtype=np.uint8)
    columns = CatalogColumns(
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
        np.array([9.0, 9.0, 9.0, 12.0]),
        np.ones((count, 3)),
        flags=flags,
    )
    assert Selection(mag_limit=10.0).of(columns).flags is not None
    assert Selection(mag_limit=10.0).of(columns).flags.tolist() == [0, StarFlag.DOUBLE]  # type: ignore[union-attr]


def test_a_cone_takes_the_near_ones(zones: Path, tmp_path: Path) -> None:
    chosen = Selection(center=Icrs(120.0, 89.7), radius_deg=0.2)
    imported = import_catalog(_order(zones, tmp_path, selection=chosen))
    both = import_catalog(_order(zones, tmp_path, "all"))
    near = PackedStore(both.path).cone(Icrs(120.0, 89.7), 0.2, epoch_yr=2000.0)
    assert imported.header.count == len(near) > 20


def test_a_range_of_declinations_takes_those_between(zones: Path, tmp_path: Path) -> None:
    chosen = Selection(dec_range_deg=(-90.0, -89.7))
    imported = import_catalog(_order(zones, tmp_path, selection=chosen))
    source = _columns(zones)
    assert imported.header.count == int((source.dec_deg <= -89.7).sum()) > 206


def test_zones_that_hold_nothing_of_it_arent_read(
    zones: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []
    plain = Ucac4Reader.read

    def watched(self: Ucac4Reader, part: Part) -> Iterator[CatalogColumns]:
        read.append(part.name)
        return plain(self, part)

    def dec_range_deg(self: Ucac4Reader, part: Part) -> tuple[float, float]:
        zone = int(part.name[1:])
        return -90.0 + 0.2 * (zone - 1), -90.0 + 0.2 * zone

    monkeypatch.setattr(Ucac4Reader, "read", watched)
    monkeypatch.setattr(Ucac4Reader, "dec_range_deg", dec_range_deg, raising=False)
    chosen = Selection(dec_range_deg=(80.0, 89.5))
    imported = import_catalog(_order(zones, tmp_path, selection=chosen))
    assert set(read) == {"z898"}
    source = _columns(zones)
    assert imported.header.count == int(((source.dec_deg >= 80) & (source.dec_deg <= 89.5)).sum())
    with pytest.raises(BadCatalog, match="holds nothing of what was asked for"):
        import_catalog(_order(zones, tmp_path, "none", selection=Selection(dec_range_deg=(0.0, 10.0))))


def test_nothing_left_is_no_catalog(zones: Path, tmp_path: Path) -> None:
    with pytest.raises(BadRequest, match=r"no star of .* remains"):
        import_catalog(_order(zones, tmp_path, selection=Selection(mag_limit=2.0)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "values",
    [
        {"mag_limit": float("nan")},
        {"mag_limit": 50.0},
        {"center": Icrs(1.0, 2.0)},
        {"center": Icrs(1.0, 2.0), "radius_deg": 0.0},
        {"center": Icrs(1.0, 2.0), "radius_deg": float("nan")},
        {"dec_range_deg": (10.0, 10.0)},
        {"dec_range_deg": (-91.0, 10.0)},
        {"dec_range_deg": (0.0, float("nan"))},
    ],
)
def test_a_selection_of_impossible_values_is_refused(values: dict[str, object]) -> None:
    with pytest.raises(BadRequest):
        Selection(**values)  # type: ignore[arg-type]


# interrupted, and gone on with

KILLER = """
import os, signal, sys
from pathlib import Path
from mountnav.catalog.importing import job as importing
from mountnav.catalog.importing.job import ImportOrder, import_catalog
from mountnav.catalog.readers.ucac4.reader import Ucac4Reader
from mountnav.catalog.packed.spool import Spool
source, folder, place = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
def die(*_): os.kill(os.getpid(), signal.SIGKILL)
plain_read, plain_finish = Ucac4Reader.read, Spool.finish
def read(self, part):
    if place == f"before {part.name}": die()
    yield from plain_read(self, part)
    if place == f"within {part.name}": die()
def finish(self, path, *, progress=None):
    if place == "before packing": die()
    header = plain_finish(self, path, progress=die if place == "packing" else progress)
    if place == "after packing": die()
    return header
Ucac4Reader.read, Spool.finish = read, finish
if place == "checking": importing.compare_with_source = die
if place == "renamed": importing._sync_folder = die
import_catalog(ImportOrder("ucac4", source, "ucac4", folder))
"""
PLACES = {
    "before z001": 0,
    "within z001": 0,
    "before z898": 2,
    "within z900": 4,
    "before packing": 5,
    "packing": 5,
    "after packing": 5,
    "checking": 5,
}


def _killed(source: Path, folder: Path, place: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", KILLER, str(source), str(folder), place], cwd=ROOT, check=False
    )
    assert done.returncode == -9


SLOWER = ("before z001", "within z001", "within z900", "before packing", "after packing")


@pytest.mark.parametrize(
    "place", [pytest.param(place, marks=pytest.mark.long if place in SLOWER else ()) for place in PLACES]
)
def test_a_killed_import_goes_on_and_gives_the_same_bytes(
    zones: Path, whole: bytes, tmp_path: Path, place: str
) -> None:
    _killed(zones, tmp_path, place)
    assert not (tmp_path / "ucac4.mnc").exists()
    imported, told, notes = _import(_order(zones, tmp_path))
    assert imported.resumed == PLACES[place]
    assert told[0].parts_done == PLACES[place]
    wanted = [f"resuming: {PLACES[place]} of 5 parts are imported"] if PLACES[place] else []
    assert notes == wanted
    assert imported.path.read_bytes() == whole
    assert [path.name for path in tmp_path.iterdir()] == ["ucac4.mnc"]


@pytest.mark.long
def test_killed_twice_and_killed_again(zones: Path, whole: bytes, tmp_path: Path) -> None:
    for place in ("within z002", "before z899", "packing"):
        _killed(zones, tmp_path, place)
    assert import_catalog(_order(zones, tmp_path)).path.read_bytes() == whole


@pytest.mark.long
def test_killed_after_the_rename_the_catalog_is_there_and_the_rest_can_be_swept(
    zones: Path, whole: bytes, tmp_path: Path
) -> None:
    _killed(zones, tmp_path, "renamed")
    assert (tmp_path / "ucac4.mnc").read_bytes() == whole
    with pytest.raises(BadRequest, match="already"):
        import_catalog(_order(zones, tmp_path))
    import_catalog(_order(zones, tmp_path, force=True))
    assert (tmp_path / "ucac4.mnc").read_bytes() == whole
    assert [path.name for path in tmp_path.iterdir()] == ["ucac4.mnc"]


def test_an_interrupt_keeps_the_parts_that_are_in(zones: Path, whole: bytes, tmp_path: Path) -> None:
    def interrupt(progress: ImportProgress) -> None:
        if progress.parts_done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_catalog(_order(zones, tmp_path), tell=interrupt)
    imported, _, notes = _import(_order(zones, tmp_path))
    assert notes == ["resuming: 3 of 5 parts are imported"]
    assert imported.path.read_bytes() == whole


def _break_off(order: ImportOrder, parts: int) -> None:
    def interrupt(progress: ImportProgress) -> None:
        if progress.parts_done == parts:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_catalog(order, tell=interrupt)


def test_other_options_begin_anew_and_say_so(zones: Path, tmp_path: Path) -> None:
    _break_off(_order(zones, tmp_path), 3)
    imported, _, notes = _import(_order(zones, tmp_path, selection=Selection(mag_limit=15.0)))
    assert notes == ["starting over: the earlier run had other options"]
    assert imported.resumed == 0
    assert imported.header.count == int((_columns(zones).mag <= 15.0).sum())


def test_a_file_that_is_in_and_was_changed_since_begins_anew(whole: bytes, tmp_path: Path) -> None:
    source = write_zones(tmp_path / "u4b")
    _break_off(_order(source, tmp_path), 3)
    other = write_zones(tmp_path / "other", (2,), seed=8)
    (source / "z002").write_bytes((other / "z002").read_bytes())
    imported, _, notes = _import(_order(source, tmp_path))
    assert notes == ["starting over: the file of z002, which was imported, has changed"]
    fresh = import_catalog(_order(source, tmp_path, "fresh"))
    assert imported.path.read_bytes() == fresh.path.read_bytes() != whole


def test_a_file_that_isnt_in_yet_may_be_copied_again(whole: bytes, tmp_path: Path) -> None:
    source = write_zones(tmp_path / "u4b")
    sound = (source / "z899").read_bytes()
    (source / "z899").write_bytes(sound[:-40])
    with pytest.raises(BadCatalog, match=r"z899.*at byte \d+: expected"):
        import_catalog(_order(source, tmp_path))
    (source / "z899").write_bytes(sound)
    imported, _, notes = _import(_order(source, tmp_path))
    assert notes == ["resuming: 3 of 5 parts are imported"]
    assert imported.path.read_bytes() == whole


@pytest.mark.long
def test_a_record_that_isnt_there_or_is_damaged_trusts_nothing(
    zones: Path, whole: bytes, tmp_path: Path
) -> None:
    for record in (None, b"", b'{"parts": {"z001": [1]}}'):
        _break_off(_order(zones, tmp_path, force=True), 2)
        path = unfinished_path(tmp_path, "ucac4") / "record.json"
        path.unlink() if record is None else path.write_bytes(record)
        imported, _, notes = _import(_order(zones, tmp_path, force=True))
        assert [note.split(":")[0] for note in notes] == ["starting over"]
        assert imported.path.read_bytes() == whole


def test_another_place_of_the_source_begins_anew(zones: Path, whole: bytes, tmp_path: Path) -> None:
    _break_off(_order(zones, tmp_path), 2)
    elsewhere = write_zones(tmp_path / "elsewhere")
    imported, _, notes = _import(_order(elsewhere, tmp_path))
    assert notes == ["starting over: the file of z001, which was imported, has changed"]
    assert imported.path.read_bytes() == whole


# what is wrong with the source


def test_a_byte_swapped_zone_ends_it_and_nothing_is_installed(tmp_path: Path) -> None:
    source = write_zones(tmp_path / "u4b", (1, 900))
    words = np.frombuffer((source / "z900").read_bytes(), dtype="<u2")
    (source / "z900").write_bytes(words.byteswap().tobytes())
    with pytest.raises(BadCatalog, match=r"z900: at byte \d+"):
        import_catalog(_order(source, tmp_path / "catalogs"))
    assert not (tmp_path / "catalogs" / "ucac4.mnc").exists()


def test_a_first_part_that_is_damaged_leaves_nothing_behind(tmp_path: Path) -> None:
    source = write_zones(tmp_path / "u4b", (1,))
    (source / "z001").write_bytes(b"")
    with pytest.raises(BadCatalog):
        import_catalog(_order(source, tmp_path / "catalogs"))
    assert list((tmp_path / "catalogs").iterdir()) == []


def test_no_such_kind_path_or_name(zones: Path, tmp_path: Path) -> None:
    with pytest.raises(BadRequest, match="no kind of catalog 'ucac9'"):
        import_catalog(replace(_order(zones, tmp_path), kind="ucac9"))
    with pytest.raises(BadCatalog, match="no such file or folder"):
        import_catalog(_order(tmp_path / "nowhere", tmp_path))
    with pytest.raises(BadRequest, match="embedded"):
        import_catalog(_order(zones, tmp_path, "tycho2"))
    with pytest.raises(BadRequest, match="can't be a catalog's name"):
        import_catalog(_order(zones, tmp_path, "../up"))
    assert list(tmp_path.iterdir()) == []


def test_a_file_changed_while_it_is_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = write_zones(tmp_path / "u4b")
    plain = Ucac4Reader.read

    def read(self: Ucac4Reader, part: Part) -> Iterator[CatalogColumns]:
        yield from plain(self, part)
        if part.name == "z898":
            os.utime(part.path, ns=(1, 1))

    monkeypatch.setattr(Ucac4Reader, "read", read)
    with pytest.raises(BadCatalog, match="changed while it was read"):
        import_catalog(_order(source, tmp_path))
    monkeypatch.undo()
    _, _, notes = _import(_order(source, tmp_path))
    assert notes == ["resuming: 2 of 5 parts are imported"]


def test_values_that_cant_be_packed_are_told_with_their_part(
    zones: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = Ucac4Reader.read

    def read(self: Ucac4Reader, part: Part) -> Iterator[CatalogColumns]:
        for columns in plain(self, part):
            if part.name == "z002":
                columns.mag[5] = np.nan
            yield columns

    monkeypatch.setattr(Ucac4Reader, "read", read)
    with pytest.raises(BadCatalog, match=r"z002 can't be packed: magnitudes"):
        import_catalog(_order(zones, tmp_path))


# the last look


@pytest.mark.long
@pytest.mark.parametrize(
    ("field", "shift"), [("mag", 0.01), ("dec_deg", 1e-5), ("pm_dec_mas_yr", 1.0), ("flags", 1)]
)
def test_a_store_that_isnt_its_source_is_not_installed(
    zones: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, field: str, shift: float
) -> None:
    """As if the writer had lost or changed something: the source says otherwise when it is asked again."""
    before = import_catalog(_order(zones, tmp_path)).path.read_bytes()
    plain, compared = Ucac4Reader.read, importing.compare_with_source

    def read(self: Ucac4Reader, part: Part) -> Iterator[CatalogColumns]:
        for columns in plain(self, part):
            if part.name == "z900":
                values = (getattr(columns, field) + shift).astype(getattr(columns, field).dtype)
                columns = replace(columns, **{field: values})
            yield columns

    def compare(*arguments: object) -> int:
        monkeypatch.setattr(Ucac4Reader, "read", read)
        return compared(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(importing, "compare_with_source", compare)
    with pytest.raises(BadCatalog, match="z900 isn't in the file"):
        import_catalog(_order(zones, tmp_path, force=True))
    assert (tmp_path / "ucac4.mnc").read_bytes() == before


# names, locks, disks


def test_a_name_that_is_taken_needs_force_and_the_old_one_stays_until_the_end(
    zones: Path, tmp_path: Path
) -> None:
    first = import_catalog(_order(zones, tmp_path, selection=Selection(mag_limit=11.0)))
    old, count = PackedStore(first.path), first.header.count
    with pytest.raises(BadRequest, match="there is a catalog 'ucac4' already"):
        import_catalog(_order(zones, tmp_path))

    def still_there(progress: ImportProgress) -> None:
        assert PackedStore(first.path).header.count == count

    second = import_catalog(_order(zones, tmp_path, force=True), tell=still_there)
    assert PackedStore(second.path).header.count == star_count() > count
    # a service that has it open keeps its map
    assert len(old.cone(Icrs(0.0, 90.0), 180.0, epoch_yr=2026.9)) == count


def test_two_at_once_of_one_name_are_refused(zones: Path, whole: bytes, tmp_path: Path) -> None:
    left = unfinished_path(tmp_path, "ucac4")
    left.mkdir()
    with (left / "lock").open("w") as lock:
        lock.write("4711")
        lock.flush()
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(Busy, match="process 4711"):
            import_catalog(_order(zones, tmp_path))
        assert import_catalog(_order(zones, tmp_path, "other")).path.read_bytes() == whole
    assert import_catalog(_order(zones, tmp_path)).path.read_bytes() == whole


def test_a_folder_that_cant_be_written_is_told(zones: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(BadSettings, match=r"--folder|check disk"):
        import_catalog(_order(zones, tmp_path / "file" / "catalogs"))


READ_ONLY = """
import os, sys
from pathlib import Path
from mountnav.catalog.importing.order import ImportOrder
from mountnav.catalog.importing.job import import_catalog
from mountnav.errors import BadSettings
source, folder = Path(sys.argv[1]), Path(sys.argv[2])
import_catalog(ImportOrder("ucac4", source, "first", folder))  # all modules are read while we may
folder.chmod(0o555)
if os.geteuid() == 0:  # whom no right stops
    os.seteuid(65534)
try:
    import_catalog(ImportOrder("ucac4", source, "second", folder))
except BadSettings as error:
    print(error)
    sys.exit(3)
"""


@pytest.mark.long
def test_a_folder_that_may_not_be_written_is_told() -> None:
    # not under tmp_path, into which nobody else may look
    with tempfile.TemporaryDirectory() as place:
        Path(place).chmod(0o755)
        source, folder = write_zones(Path(place) / "u4b", (1,)), Path(place) / "catalogs"
        done = subprocess.run(
            [sys.executable, "-c", READ_ONLY, str(source), str(folder)],
            cwd=ROOT,
            check=False,
            capture_output=True,
            text=True,
        )
        folder.chmod(0o755)
        assert done.returncode == 3, done.stderr
        assert "Permission denied" in done.stdout
        assert "--folder" in done.stdout
        assert [path.name for path in folder.iterdir()] == ["first.mnc"]


def test_too_small_a_disk_is_told_before_it_begins(
    zones: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = type("Usage", (), {"free": 50_000})
    monkeypatch.setattr("mountnav.catalog.importing.job.shutil.disk_usage", lambda path: usage)
    with pytest.raises(BadSettings, match=r"2,383 stars still need 0\.0 GB, and 0\.0 GB are free"):
        import_catalog(_order(zones, tmp_path))
    assert list(tmp_path.iterdir()) == []
    # of a part it isn't known how large it will be: it is tried, and told what is to be feared
    _, _, notes = _import(_order(zones, tmp_path, selection=Selection(mag_limit=16.4)))
    assert len(notes) == 1
    assert notes[0].startswith("the disk may get full")


FULL = """
import resource, signal, sys
from pathlib import Path
from mountnav.catalog.importing.job import ImportOrder, import_catalog
from mountnav.errors import BadSettings
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
try:
    import_catalog(ImportOrder("ucac4", Path(sys.argv[1]), "ucac4", Path(sys.argv[2])))
except BadSettings as error:
    print(error)
    sys.exit(3)
"""


@pytest.mark.parametrize(
    "when",
    [
        "within a part",
        *(pytest.param(one, marks=pytest.mark.long) for one in ("at the record", "while packing")),
    ],
)
def test_a_disk_that_gets_full_ends_it_and_later_it_goes_on(
    zones: Path, whole: bytes, tmp_path: Path, when: str
) -> None:
    limit = {"at the record": 300, "within a part": 20_000, "while packing": len(whole) - 1}[when]
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(zones), str(tmp_path), str(limit)],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 3, done.stderr
    assert "File too large" in done.stdout
    assert "--folder" in done.stdout
    assert not (tmp_path / "ucac4.mnc").exists()
    assert import_catalog(_order(zones, tmp_path)).path.read_bytes() == whole
    assert [path.name for path in tmp_path.iterdir()] == ["ucac4.mnc"]


def test_a_disk_that_fails_is_no_crash(zones: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: Ucac4Reader, part: Part) -> Iterator[CatalogColumns]:
        raise OSError(5, "Input/output error", str(part.path))

    monkeypatch.setattr(Ucac4Reader, "read", fail)
    with pytest.raises(MountnavError, match=r"Input/output error.*check disk and cable"):
        import_catalog(_order(zones, tmp_path))


def test_what_is_everything_is_left_as_it_is(zones: Path) -> None:
    columns = _columns(zones)
    assert EVERYTHING.of(columns) is columns
    assert Selection(mag_limit=39.0).of(columns) is columns


@pytest.mark.parametrize(
    ("chosen", "zone", "wanted"),
    [
        (EVERYTHING, (10.0, 10.2), True),
        (Selection(dec_range_deg=(10.25, 20.0)), (10.0, 10.2), True),  # a star may have left its zone
        (Selection(dec_range_deg=(10.35, 20.0)), (10.0, 10.2), False),
        (Selection(center=Icrs(5.0, 0.0), radius_deg=10.0), (10.0, 10.2), True),
        (Selection(center=Icrs(5.0, 0.0), radius_deg=9.0), (10.0, 10.2), False),
        (Selection(center=Icrs(5.0, 85.0), radius_deg=10.0), (89.0, 90.0), True),
    ],
)
def test_which_zones_are_wanted(chosen: Selection, zone: tuple[float, float], wanted: bool) -> None:
    assert chosen.wants_some_of(zone) is wanted
