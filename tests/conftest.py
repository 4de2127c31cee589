"""What all tests share: where the measured data lies, and quiet IERS tables."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
# the index of the sky is built once per checkout, apart from the user's own
os.environ.setdefault("MOUNTNAV_CACHE", str(ROOT / ".cache"))


def shared_folder() -> Path:
    """The folder of measured data; it may not exist."""
    return Path(os.environ.get("MOUNTNAV_SHARED", ROOT.parent / "shared"))


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of measured data, or a skip with a plain reason."""
    folder = shared_folder()
    if not (folder / "data").is_dir():
        pytest.skip("the shared data are not there: set MOUNTNAV_SHARED to their folder")
    return folder


@pytest.fixture(scope="session", autouse=True)
def _no_network_for_iers() -> None:
    from mountnav.sky.iers import prepare

    prepare()


@pytest.fixture(scope="session")
def sky_index():
    """The index of the whole sky over the embedded catalog; built by the first test that needs it."""
    from mountnav.catalog.embedded import embedded_catalog
    from mountnav.identification.blind.cache import cached_index

    return cached_index(embedded_catalog())
