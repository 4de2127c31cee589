"""The settings of ephemerides: where imports lie, which SPK files count, and what is wrong with them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from mountnav.ephemeris.imported import imports, use_imports
from mountnav.errors import BadSettings
from mountnav.settings.observatory import Settings
from mountnav.sky.coordinates import Site
from mountnav.sky.kernel import SHIPPED_PATH, kernels_in_use, use_kernels

HEAD = """
[site]
latitude_deg = 48.93
longitude_deg = 22.27
[[telescope]]
id = "t"
mount = { url = "fake+lx200://" }
camera = { kind = "simulated" }
"""


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    yield
    use_imports()
    use_kernels(())


def test_folder_and_files_are_used(tmp_path: Path) -> None:
    copy = tmp_path / "mine.bsp"
    shutil.copy(SHIPPED_PATH, copy)
    text = f'{HEAD}[ephemerides]\nfolder = "{tmp_path}/here"\nfiles = ["{copy}"]\n'
    Settings.parse(text).ephemerides.use()
    assert imports().folder == tmp_path / "here"
    assert kernels_in_use()[0].path == copy


def test_a_file_that_is_none_is_told_with_the_setting(tmp_path: Path) -> None:
    (tmp_path / "wrong.bsp").write_text("nothing")
    for name in ("wrong.bsp", "none.bsp"):
        settings = Settings.parse(f'{HEAD}[ephemerides]\nfiles = ["{tmp_path}/{name}"]\n')
        with pytest.raises(BadSettings, match=rf"ephemerides\.files: {name}"):
            settings.ephemerides.use()


def test_a_file_may_hold_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "alone.toml"
    path.write_text("[site]\nlatitude_deg = 1.0\nlongitude_deg = 2.0\n")
    found, site, air = Settings.load_ephemerides(path)
    assert (found.folder, site, air.pressure_hpa) == (None, Site(1.0, 2.0, 0.0), 1010.0)
    path.write_text("[ephemerides]\nfolders = 1\n")
    with pytest.raises(BadSettings, match="folders"):
        Settings.load_ephemerides(path)
