"""The table of pixel centers is what astropy-healpix says."""

from __future__ import annotations

from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy_healpix import HEALPix

from mountnav.catalog.packed import pixel_centers as module
from mountnav.catalog.packed.pixel_centers import TABLE_NSIDE, computed_centers, pixel_centers


@pytest.mark.parametrize("nside", [1, 8, TABLE_NSIDE])
def test_every_center_is_that_of_the_library(nside: int) -> None:
    numbers = np.arange(12 * nside**2)
    lon, lat = HEALPix(nside=nside, order="nested").healpix_to_lonlat(numbers)
    x, y, z = pixel_centers(nside)
    assert np.allclose(np.arctan2(y, x) % (2 * np.pi), lon.to_value(u.rad), rtol=0, atol=1e-14)
    assert np.allclose(z, np.sin(lat.to_value(u.rad)), rtol=0, atol=1e-15)
    assert np.allclose(x**2 + y**2 + z**2, 1.0, rtol=0, atol=1e-15)


def test_the_table_is_shipped() -> None:
    assert np.array_equal(np.load(module.TABLE_PATH), computed_centers(TABLE_NSIDE))


@pytest.mark.parametrize("content", [None, b"", b"\x93NUMPY\x01\x00v\x00", "other shape"])
def test_without_a_sound_table_the_library_is_asked(
    content: bytes | str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / "table.npy"
    if isinstance(content, bytes):
        table.write_bytes(content)
    elif content:
        np.save(table, np.zeros((3, 12)))
    monkeypatch.setattr(module, "TABLE_PATH", table)
    assert np.array_equal(pixel_centers(TABLE_NSIDE), computed_centers(TABLE_NSIDE))
