"""Packed files: the same bytes each time; damaged ones are refused and the message tells where."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.error_classes import error_curve
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed_format import MAGIC, Header, decode_header, encode_header
from mountnav.catalog.packing import CatalogColumns, pack
from mountnav.errors import BadSettings
from mountnav.sky.coordinates import Icrs


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
    )


@pytest.fixture
def packed(tmp_path: Path) -> Path:
    path = tmp_path / "few.mnc"
    pack(few_columns(), path, name="few", band="V", epoch_yr=2000.0, nside=2)
    return path


def test_packing_twice_gives_the_same_bytes(packed: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mnc"
    pack(few_columns(), again, name="few", band="V", epoch_yr=2000.0, nside=2)
    assert again.read_bytes() == packed.read_bytes()
    assert not list(tmp_path.glob("*.part"))


def test_coarse_pixels_lose_no_star(packed: Path) -> None:
    assert len(PackedStore(packed).cone(Icrs(10, 10), 180, epoch_yr=2026.9)) == 200


def test_a_store_goes_to_another_process_as_its_path(packed: Path) -> None:
    sent = pickle.dumps(PackedStore(packed))
    assert len(sent) < 1000
    assert len(pickle.loads(sent)) == 200


@pytest.mark.parametrize("keep", [0, 7, 15, 16, 100, 300, 900, -1])
def test_a_truncated_file_is_refused(packed: Path, keep: int) -> None:
    packed.write_bytes(packed.read_bytes()[:keep])
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
        (8, b"\x07", "at byte 8: expected version 1, found version 7"),
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
    with pytest.raises(BadSettings, match=f"at byte {start}: expected an offset table"):
        PackedStore(packed)


def test_verify_finds_a_flipped_bit(packed: Path) -> None:
    PackedStore(packed).verify()
    content = bytearray(packed.read_bytes())
    content[-3] ^= 1
    packed.write_bytes(content)
    store = PackedStore(packed)
    with pytest.raises(BadSettings, match="sha256"):
        store.verify()


@settings(max_examples=200)
@given(tail=st.binary(max_size=200))
def test_no_header_bytes_raise_anything_but_bad_settings(tail: bytes) -> None:
    for start in (tail, MAGIC + tail, MAGIC + b"\x01\0\0\0" + len(tail).to_bytes(4, "little") + tail):
        with pytest.raises(BadSettings):
            decode_header(start, file="noise")


def test_header_goes_round() -> None:
    header = Header("Tycho-2", "V", 2000.0, 64, 10, 3, 1, 10308.4, "00")
    encoded = encode_header(header)
    assert len(encoded) % 64 == 0
    assert decode_header(encoded + b"more", file="x") == (header, len(encoded))


def test_columns_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    columns = few_columns()
    columns.mag[3] = np.nan
    with pytest.raises(ValueError, match="magnitudes"):
        pack(columns, tmp_path / "bad.mnc", name="bad", band="V", epoch_yr=2000.0)
