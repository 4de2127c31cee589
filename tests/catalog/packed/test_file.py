"""Packed files: the same bytes each time; damaged ones are refused and the message tells where."""

from __future__ import annotations

import hashlib
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.file import PackedFile
from mountnav.catalog.packed.format import MAGIC, Header, decode_header, encode_header
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog, BadSettings
from mountnav.sky.coordinates import Icrs
from tests.catalog.packed.packing_version_1 import pack_version_1


def few_columns(count: int = 200) -> CatalogColumns:
    rng = np.random.default_rng(5)
    e, epoch = np.full(count, 30.0), np.full(count, 1990.0)
    pm = rng.normal(0, 10, (2, count)).round(1)
    pm[:, 0] = -798.8, 10277.3
    return CatalogColumns(
        rng.uniform(0, 360, count),
        rng.uniform(-90, 90, count),
        pm[0],
        pm[1],
        rng.uniform(2, 12, count),
        error_curve((e, e), (e / 10, e / 10), (epoch, epoch)),
        rng.normal(1, 0.3, count),
        np.full(count, StarFlag.DOUBTFUL, dtype=np.uint8),
    )


def write(path: Path, version: int, nside: int = 2) -> Path:
    if version == 1:
        pack_version_1(few_columns(), path, name="few", band="V", epoch_yr=2000.0, nside=nside)
    else:
        pack(
            few_columns(),
            path,
            name="few",
            band="V",
            epoch_yr=2000.0,
            nside=nside,
            color_name="B-V",
            made_from="a random generator",
        )
    return path


@pytest.fixture(params=[1, 2])
def packed(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    return write(tmp_path / "few.mnc", request.param)


@pytest.mark.parametrize("version", [1, 2])
def test_packing_twice_gives_the_same_bytes(version: int, tmp_path: Path) -> None:
    first = write(tmp_path / "few.mnc", version).read_bytes()
    assert write(tmp_path / "again.mnc", version).read_bytes() == first
    assert not list(tmp_path.glob("*.part"))


def test_coarse_pixels_lose_no_star(packed: Path) -> None:
    assert len(PackedStore(packed).cone(Icrs(10, 10), 180, epoch_yr=2026.9)) == 200


def test_a_store_goes_to_another_process_as_its_path(packed: Path) -> None:
    sent = pickle.dumps(PackedStore(packed))
    assert len(sent) < 1000
    assert len(pickle.loads(sent)) == 200


@pytest.mark.parametrize("keep", [0, 7, 15, 16, 100, 300, 900, 4095, 4096, 4100, -1])
def test_a_truncated_file_is_refused(packed: Path, keep: int) -> None:
    packed.write_bytes(packed.read_bytes()[: min(keep, packed.stat().st_size - 1)])
    with pytest.raises(BadSettings, match=r"at byte \d+: expected .*, found "):
        PackedStore(packed)


def test_a_longer_file_is_refused(packed: Path) -> None:
    size = packed.stat().st_size
    packed.write_bytes(packed.read_bytes() + b"x")
    with pytest.raises(BadSettings, match=f"at byte {size}: expected {size} bytes in all, found {size + 1}"):
        PackedStore(packed)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadSettings, match="can't be opened"):
        PackedStore(tmp_path / "none.mnc")


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadSettings, match="can't be opened"):
        PackedStore(tmp_path)


@pytest.mark.parametrize(
    ("at", "byte", "message"),
    [
        (0, b"X", "at byte 0: expected the magic"),
        (8, b"\x07", "at byte 8: expected version 1 or 2, found version 7"),
    ],
)
def test_a_foreign_file_is_refused(packed: Path, at: int, byte: bytes, message: str) -> None:
    content = bytearray(packed.read_bytes())
    content[at : at + 1] = byte
    packed.write_bytes(content)
    with pytest.raises(BadSettings, match=message):
        PackedStore(packed)


def test_a_broken_offset_table_is_refused(packed: Path) -> None:
    content = bytearray(packed.read_bytes())
    _, start = decode_header(bytes(content), file="few")
    content[start + 4 : start + 8] = b"\xff\xff\xff\xff"
    packed.write_bytes(content)
    with pytest.raises(BadCatalog, match=f"at byte {start}: expected an offset table"):
        PackedStore(packed)


def test_a_fine_offset_table_is_checked_where_it_is_used(tmp_path: Path) -> None:
    path = write(tmp_path / "few.mnc", 2, nside=256)
    content = bytearray(path.read_bytes())
    header, start = decode_header(bytes(content), file="few")
    at = start + header.layout()["offsets"][0]
    offsets = np.frombuffer(content, dtype="<u4", count=header.pixels + 1, offset=at)
    pixel = int(np.flatnonzero(np.diff(offsets))[100])
    offsets[pixel + 1] = 0
    path.write_bytes(content)
    store = PackedStore(path)
    with pytest.raises(BadCatalog, match=f"at byte {at}: expected an offset table that rises"):
        store.cone(Icrs(0, 0), 180.0, epoch_yr=2000.0, mag_limit=15.0)
    with pytest.raises(BadCatalog, match="section offsets of sha256"):
        store.verify()


def test_verify_finds_a_flipped_bit(packed: Path) -> None:
    PackedStore(packed).verify()
    content = bytearray(packed.read_bytes())
    content[-3] ^= 1
    packed.write_bytes(content)
    store = PackedStore(packed)
    with pytest.raises(BadCatalog, match="sha256"):
        store.verify()


@pytest.mark.long
@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(share=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_no_flipped_bit_escapes_version_2(sound: bytes, tmp_path: Path, share: float, bit: int) -> None:
    content = bytearray(sound)
    at = int(share * len(content))
    content[at] ^= 1 << bit
    path = tmp_path / "flipped.mnc"
    path.write_bytes(content)
    with pytest.raises(BadCatalog, match=r"at byte \d+: expected .*, found "):
        PackedStore(path).verify()


def test_no_flipped_bit_of_the_header_lets_a_file_of_version_2_be_opened(sound: bytes) -> None:
    decode_header(sound, file="few")
    for at in range(4096):
        content = bytearray(sound[:4096])
        content[at] ^= 1 << at % 8
        with pytest.raises(BadCatalog, match=r"at byte \d+: expected .*, found "):
            decode_header(bytes(content), file="few")


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write(tmp_path_factory.mktemp("sound") / "few.mnc", 2).read_bytes()


def test_verify_names_the_section_and_tells_how_far_it_is(tmp_path: Path) -> None:
    path = write(tmp_path / "few.mnc", 2, nside=128)
    opened, _ = PackedFile.open(path)
    told: list[float] = []
    PackedStore(path).verify(hashlib.sha256(path.read_bytes()).hexdigest(), told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0
    header = PackedStore(path).header
    start = 4096
    for section in ("coarse", "offsets", "tops", "classes", "fast", "stars", "color", "flags"):
        content = bytearray(path.read_bytes())
        at, length = header.layout()[section]
        content[start + at + length - 1] ^= 128
        other = tmp_path / "other.mnc"
        other.write_bytes(content)
        # opened while it was sound: some of this is refused when it is opened
        damaged = replace(opened, path=other)
        with pytest.raises(BadCatalog, match=f"at byte {start + at}: expected section {section} of sha256"):
            damaged.verify(None, told.append)
    with pytest.raises(BadCatalog, match="at byte 0: expected a file of sha256 00"):
        PackedStore(path).verify("00")


def test_error_classes_and_fast_stars_that_are_not_there_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "few.mnc", 2)
    sound, header = path.read_bytes(), PackedStore(path).header
    stars, fast = (4096 + header.layout()[name][0] for name in ("stars", "fast"))
    assert header.class_count < 200
    content = bytearray(sound)
    content[stars + 14] = 250
    path.write_bytes(content)
    with pytest.raises(BadCatalog, match=f"at byte {stars}: expected error classes below"):
        PackedStore(path).cone(Icrs(0, 0), 180, epoch_yr=2000.0)
    content = bytearray(sound)
    number = int.from_bytes(content[fast : fast + 4], "little")
    content[fast : fast + 4] = ((number + 1) % header.count).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(BadCatalog, match="a star's proper motion is missing"):
        PackedStore(path).cone(Icrs(0, 0), 180, epoch_yr=2000.0)


@settings(max_examples=200)
@given(tail=st.binary(max_size=200))
def test_no_header_bytes_raise_anything_but_bad_settings(tail: bytes) -> None:
    for start in (tail, MAGIC + tail, MAGIC + b"\x01\0\0\0" + len(tail).to_bytes(4, "little") + tail):
        with pytest.raises(BadSettings):
            decode_header(start, file="noise")


def test_header_goes_round() -> None:
    header = Header("Tycho-2", "V", 2000.0, 64, 10, 3, 1, 10308.4, "00", version=1, slow_mas_yr=10308.4)
    encoded = encode_header(header)
    assert len(encoded) % 64 == 0
    assert decode_header(encoded + b"more", file="x") == (header, len(encoded))


def test_header_of_version_2_goes_round_and_takes_no_endless_text(tmp_path: Path) -> None:
    header = PackedStore(write(tmp_path / "few.mnc", 2)).header
    encoded = encode_header(header)
    assert len(encoded) == 4096
    assert decode_header(encoded + b"more", file="x") == (header, 4096)
    assert (header.made_from, header.color_name, header.has_flags) == ("a random generator", "B-V", True)
    with pytest.raises(ValueError, match="too long"):
        pack(few_columns(), tmp_path / "x.mnc", name="few", band="V", epoch_yr=2000.0, made_from="x" * 4000)
    assert [path.name for path in tmp_path.iterdir()] == ["few.mnc"]


def test_magnitudes_of_both_versions(tmp_path: Path) -> None:
    mag = few_columns().mag
    told = [PackedStore(write(tmp_path / f"{version}.mnc", version)).magnitudes for version in (1, 2)]
    assert told[0] == told[1]
    brightest, faintest, commonest = told[0]
    assert (brightest, faintest) == pytest.approx((mag.min(), mag.max()), abs=0.0006)
    assert brightest <= commonest <= faintest


def test_columns_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    columns = few_columns()
    columns.mag[3] = np.nan
    with pytest.raises(ValueError, match="magnitudes"):
        pack(columns, tmp_path / "bad.mnc", name="bad", band="V", epoch_yr=2000.0)
