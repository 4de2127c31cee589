"""What all tests share: where the measured data lies, and quiet IERS tables."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


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
