"""A spool: whatever order the parts come in and whenever it is killed, the same file comes out."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.catalog.packed.spool import PackedFacts, Spool, nside_for
from mountnav.catalog.stars import Stars
from mountnav.errors import BadCatalog, BadSettings
from mountnav.sky.coordinates import Icrs

FACTS = PackedFacts("made up", "G", 2016.0, "BP-RP", "a test")
PART_STARS = 1500
PARTS = 6


def part_columns(number: int, count: int = PART_STARS) -> CatalogColumns:
    rng = np.random.default_rng([20261121, number])
    ra, dec = rng.uniform(0, 360, count), np.degrees(np.arcsin(rng.uniform(-1, 1, count)))
    ra[: count // 2], dec[: count // 2] = (
        rng.normal(0, 0.2, count // 2) % 360,
        rng.normal(40, 0.2, count // 2),
    )
    pm = rng.normal(0, 30, (2, count)).round(1)
    pm[:, :: max(count // 5, 1)] = [[4000.0], [-900.0]]
    pm[:, 3::9] = np.nan
    e, e_pm = rng.lognormal(2, 1, count), rng.lognormal(0, 1, count)
    epoch = rng.uniform(1950, 2016, count)
    color = rng.normal(1, 0.5, count)
    color[::7] = np.nan
    return CatalogColumns(
        ra,
        dec,
        pm[0],
        pm[1],
        # many of one magnitude, so that ties must be broken
        rng.integers(8, 12, count).astype(np.float64),
        error_curve((e, e), (e_pm, e_pm), (epoch, epoch)),
        color,
        rng.integers(0, 128, count).astype(np.uint8),
    )


def chunks(number: int, size: int = 400) -> Iterator[CatalogColumns]:
    whole = part_columns(number)
    for begin in range(0, PART_STARS, size):
        yield CatalogColumns(
            *(getattr(whole, name)[begin : begin + size] for name in CatalogColumns.__dataclass_fields__)
        )


def filled(folder: Path, numbers: Iterator[int] | range | list[int] = range(PARTS)) -> Spool:
    spool = Spool.open(folder, FACTS)
    for number in numbers:
        assert spool.add(f"part {number}", chunks(number)) == PART_STARS
    return spool


def everything(path: Path, epoch_yr: float = 2026.9) -> Stars:
    stars = PackedStore(path).cone(Icrs(0, 0), 180.0, epoch_yr=epoch_yr)
    return stars.only(np.lexsort((stars.ra_deg, stars.dec_deg)))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    filled(folder / "spool").finish(folder / "all.mnc")
    return folder / "all.mnc"


def test_a_spool_gives_what_packing_at_once_gives(finished: Path, tmp_path: Path) -> None:
    parts = [part_columns(number) for number in range(PARTS)]
    columns = CatalogColumns(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in CatalogColumns.__dataclass_fields__
        )
    )
    at_once = tmp_path / "at-once.mnc"
    pack(columns, at_once, name="made up", band="G", epoch_yr=2016.0, color_name="BP-RP", made_from="a test")
    spooled, packed = everything(finished), everything(at_once)
    assert len(spooled) == len(packed) == PARTS * PART_STARS
    for name in ("ra_deg", "dec_deg", "mag", "pm_ra_cosdec_mas_yr", "pm_dec_mas_yr", "color_mag", "flags"):
        np.testing.assert_allclose(getattr(spooled, name), getattr(packed, name), atol=1e-6, err_msg=name)
    # classes are made in two ways
    ratio = spooled.sigma_arcsec / packed.sigma_arcsec
    assert 0.5 < ratio.min() < np.median(ratio) < 1.05
    assert ratio.max() < 2.0


def test_header_tells_what_went_in(finished: Path) -> None:
    header = PackedStore(finished).header
    assert (header.name, header.band, header.epoch_yr) == ("made up", "G", 2016.0)
    assert (header.color_name, header.made_from, header.has_flags) == ("BP-RP", "a test", True)
    assert (header.brightest_mag, header.faintest_mag) == (8.0, 11.0)
    assert header.fast_count == 5 * PARTS - sum(
        int(np.isnan(part_columns(n).pm_dec_mas_yr[:: PART_STARS // 5]).sum()) for n in range(PARTS)
    )
    assert header.fastest_mas_yr == pytest.approx(np.hypot(4000, 900), abs=0.2)
    assert header.slow_mas_yr <= 500.0
    PackedStore(finished).verify()


@pytest.mark.long
def test_order_of_parts_chunks_and_memory_change_no_byte(finished: Path, tmp_path: Path) -> None:
    for seed, at_once in ((1, 10_000_000), (2, 500), (3, 60)):
        numbers = random.Random(seed).sample(range(PARTS), PARTS)
        spool = Spool.open(tmp_path / f"spool{seed}", FACTS)
        for number in numbers:
            spool.add(f"part {number}", chunks(number, 100 + 37 * seed))
        spool.finish(tmp_path / "again.mnc", stars_at_once=at_once)
        assert (tmp_path / "again.mnc").read_bytes() == finished.read_bytes()


def test_a_spool_is_resumed_and_finished_twice(finished: Path, tmp_path: Path) -> None:
    filled(tmp_path / "spool", [0, 1, 2])
    spool = Spool.open(tmp_path / "spool", FACTS)
    assert spool.done == {"part 0", "part 1", "part 2"}
    assert spool.count == 3 * PART_STARS

    def untouched() -> Iterator[CatalogColumns]:
        raise AssertionError("a part that is in is read again")
        yield

    assert spool.add("part 1", untouched()) == PART_STARS
    spool = filled(tmp_path / "spool", [5, 4, 3])
    told: list[float] = []
    for _ in range(2):
        spool.finish(tmp_path / "all.mnc", progress=told.append)
        assert (tmp_path / "all.mnc").read_bytes() == finished.read_bytes()
    assert told[0] == 0.0
    assert told[-1] == 1.0
    assert all(0.0 <= share <= 1.0 for share in told)
    spool.discard()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["all.mnc"]


def test_other_facts_start_anew(tmp_path: Path) -> None:
    filled(tmp_path, [0])
    for facts in (replace(FACTS, epoch_yr=2000.0), replace(FACTS, made_from="another folder")):
        assert Spool.open(tmp_path, facts).done == frozenset()
        assert not list(tmp_path.glob("*.stars"))


def test_a_part_that_breaks_off_leaves_nothing(tmp_path: Path) -> None:
    spool = filled(tmp_path, [0])
    before = sorted(tmp_path.iterdir())

    def broken() -> Iterator[CatalogColumns]:
        yield part_columns(1)
        raise BadCatalog("at byte 12: expected a star, found none")

    with pytest.raises(BadCatalog, match="at byte 12"):
        spool.add("part 1", broken())
    senseless = part_columns(2)
    senseless.mag[7] = np.nan
    with pytest.raises(BadCatalog, match="part 2 can't be packed: magnitudes"):
        spool.add("part 2", [part_columns(1), senseless])
    assert spool.done == {"part 0"}
    assert sorted(tmp_path.iterdir()) == before
    assert Spool.open(tmp_path, FACTS).count == PART_STARS


@pytest.mark.parametrize("variance_mas2", [np.inf, 1e50])
def test_an_error_that_32_bits_cannot_hold_is_refused(variance_mas2: float, tmp_path: Path) -> None:
    senseless = part_columns(0)
    senseless.error_curve[7, 2] = variance_mas2
    spool = Spool.open(tmp_path, FACTS)
    with pytest.raises(BadCatalog, match="part 0 can't be packed: error curves"):
        spool.add("part 0", [senseless])
    assert not spool.done


@pytest.mark.parametrize("keep", [0, 5, 1000, -1, -13])
def test_a_part_that_is_damaged_is_read_again(tmp_path: Path, keep: int) -> None:
    filled(tmp_path, [0, 1])
    path = sorted(tmp_path.glob("*.stars"))[0]
    path.write_bytes(path.read_bytes()[:keep])
    spool = Spool.open(tmp_path, FACTS)
    assert len(spool.done) == 1
    assert not path.exists()


def test_empty_parts_count_as_done_but_make_no_catalog(tmp_path: Path) -> None:
    spool = Spool.open(tmp_path / "spool", FACTS)
    assert spool.add("nothing", []) == 0
    assert spool.add("no stars", [part_columns(0, 0)]) == 0
    assert Spool.open(tmp_path / "spool", FACTS).done == {"nothing", "no stars"}
    with pytest.raises(BadCatalog, match="0 stars can't be packed"):
        spool.finish(tmp_path / "none.mnc")
    spool.add("part 0", chunks(0))
    spool.finish(tmp_path / "one.mnc")
    assert len(PackedStore(tmp_path / "one.mnc")) == PART_STARS


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(BadSettings, match="can't be stored during the import: Not a directory"):
        Spool.open(tmp_path / "file" / "spool", FACTS)
    spool = filled(tmp_path / "spool", [0])
    with pytest.raises(BadSettings, match="can't be written: No such file or directory"):
        spool.finish(tmp_path / "nowhere" / "all.mnc")


# a process that fills and finishes a spool, and kills itself at the n-th of all fsync and rename calls
WORK = textwrap.dedent(
    """
    import os, pathlib, signal, sys
    sys.path[:0] = [sys.argv[1]]
    from test_spool import FACTS, PARTS, Spool, chunks
    left = int(sys.argv[3])
    def hooked(call):
        def run(*arguments, **named):
            global left
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            result = call(*arguments, **named)
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return result
        return run
    os.fsync, pathlib.Path.replace = hooked(os.fsync), hooked(pathlib.Path.replace)
    folder = pathlib.Path(sys.argv[2])
    spool = Spool.open(folder / "spool", FACTS)
    for number in range(PARTS):
        spool.add(f"part {number}", chunks(number))
        print(number, flush=True)
    spool.finish(folder / "all.mnc")
    print("finished", flush=True)
    """
)


def worker(folder: Path, calls: int) -> subprocess.Popen[str]:
    here = str(Path(__file__).parent)
    command = [sys.executable, "-c", WORK, here, str(folder), str(calls)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def require_sound(folder: Path, said: list[str], finished: Path) -> None:
    """What was said to be in is in, and what comes out in the end is the same."""
    spool = Spool.open(folder / "spool", FACTS)
    told = {f"part {number}" for number in said if number != "finished"}
    assert told <= spool.done
    assert len(spool.done) <= len(told) + 1
    assert spool.count == len(spool.done) * PART_STARS
    if (folder / "all.mnc").exists():
        assert (folder / "all.mnc").read_bytes() == finished.read_bytes()
    else:
        assert "finished" not in said
    filled(folder / "spool").finish(folder / "all.mnc")
    assert (folder / "all.mnc").read_bytes() == finished.read_bytes()
    assert not list(folder.glob("*.part"))


@pytest.mark.long
@pytest.mark.parametrize("calls", [3, 8, 42])
def test_killed_at_a_step_it_goes_on(tmp_path: Path, finished: Path, calls: int) -> None:
    killed = worker(tmp_path, calls)
    said, _ = killed.communicate()
    assert killed.returncode == -signal.SIGKILL
    require_sound(tmp_path, said.split(), finished)


@pytest.mark.long
def test_killed_at_any_step_or_moment_it_goes_on(tmp_path: Path, finished: Path) -> None:
    for calls in range(1, 80, 2):
        folder = tmp_path / str(calls)
        folder.mkdir()
        killed = worker(folder, calls)
        said, _ = killed.communicate()
        require_sound(folder, said.split(), finished)
        if killed.returncode == 0:
            break
    assert killed.returncode == 0  # there are no more steps than were tried
    dice = random.Random(5)
    for number in range(6):
        folder = tmp_path / f"moment{number}"
        folder.mkdir()
        killed = worker(folder, 0)
        time.sleep(dice.uniform(0.2, 1.2))
        killed.kill()
        said, _ = killed.communicate()
        require_sound(folder, said.split(), finished)


FULL = textwrap.dedent(
    """
    import pathlib, resource, sys
    sys.path[:0] = [sys.argv[1]]
    from test_spool import FACTS, PARTS, BadSettings, Spool, chunks
    folder = pathlib.Path(sys.argv[2])
    spool = Spool.open(folder / "spool", FACTS)
    for number in range(PARTS):
        spool.add(f"part {number}", chunks(number))
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
    for do in (lambda: spool.add("more", chunks(0)), lambda: spool.finish(folder / "all.mnc")):
        try:
            do()
        except BadSettings as told:
            print(told)
    """
)


@pytest.mark.long
def test_a_disk_that_takes_no_more_is_told_and_nothing_is_half_made(tmp_path: Path) -> None:
    here = str(Path(__file__).parent)
    ran = subprocess.run(
        [sys.executable, "-c", FULL, here, str(tmp_path), "40000"], capture_output=True, text=True, check=True
    )
    lines = ran.stdout.splitlines()
    assert len(lines) == 2
    assert "can't be stored during the import: File too large" in lines[0]
    assert "41 bytes a star" in lines[0]
    assert "can't be written: File too large" in lines[1]
    assert "MB there" in lines[1]
    assert [path.name for path in tmp_path.iterdir()] == ["spool"]
    assert len(list((tmp_path / "spool").glob("*.stars"))) == PARTS
    assert not list((tmp_path / "spool").glob("*.unfinished"))


def test_resolution_follows_the_density() -> None:
    assert nside_for(2_550_960) == 64
    assert nside_for(113_000_000) == 512
    assert nside_for(300_000_000) == 512
    assert nside_for(1_000_000_000) == 1024
    assert nside_for(1) == 1
    # a million stars in a square degree: as fine as the tables' size allows
    assert nside_for(1_000_000, 1 / 41253) == 128
    for count in (10, 10_000, 1_000_000, 100_000_000):
        for share in (1e-5, 0.01, 1.0):
            assert nside_for(count, share) <= max(1, np.sqrt(0.6 * count / 12))


MEMORY = textwrap.dedent(
    """
    import sys
    from pathlib import Path
    sys.path[:0] = [sys.argv[1]]
    from test_spool import FACTS, Spool, part_columns
    def peak_kb():
        # ru_maxrss would begin with the memory of the process that started this one
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    spool = Spool.open(Path(sys.argv[2]) / "spool", FACTS)
    for number in range(16):
        spool.add(f"part {number}", [part_columns(number, 50_000)])
    for stars_at_once in (20_000, 20_000, 1_000_000):
        before = peak_kb()
        spool.finish(Path(sys.argv[2]) / "out.mnc", nside=64, stars_at_once=stars_at_once)
        print(peak_kb() - before)
    """
)


@pytest.mark.long
def test_no_more_stars_are_in_memory_than_allowed(tmp_path: Path) -> None:
    here = str(Path(__file__).parent)
    ran = subprocess.run(
        [sys.executable, "-c", MEMORY, here, str(tmp_path)], capture_output=True, text=True, check=True
    )
    first_mb, bounded_mb, whole_mb = (int(line) / 1024 for line in ran.stdout.split())
    # the count of error cells is a table of 170 MB at most; all 800,000 stars at once come on top of it
    assert first_mb < 170
    assert bounded_mb < 10
    assert whole_mb > 50
