"""What all tests share: where the measured data lies, and quiet IERS tables."""

from __future__ import annotations

import gc
import os
import signal
from pathlib import Path
from typing import Any

import hypothesis
import pytest

ROOT = Path(__file__).resolve().parent.parent
# the index of the sky is built once per checkout, apart from the user's own
os.environ.setdefault("MOUNTNAV_CACHE", str(ROOT / ".cache"))
# new examples are for those who can look into them: CI's answer depends on the commit alone
# a loaded machine makes no property false: neither an example nor making one has a limit of time
PATIENT: dict[str, Any] = {"deadline": None, "suppress_health_check": [hypothesis.HealthCheck.too_slow]}
hypothesis.settings.register_profile("patient", **PATIENT)
hypothesis.settings.register_profile("ci", derandomize=True, **PATIENT)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "patient")
# services of different processes of tests answer no commands of each other
os.environ["MOUNTNAV_RUN"] = str(ROOT / ".cache" / f"run-of-tests-{os.getpid()}")
# what the user has imported is none of the tests' business
os.environ["MOUNTNAV_CATALOGS"] = str(ROOT / ".cache" / "no-catalogs")
os.environ["MOUNTNAV_EPHEMERIDES"] = str(ROOT / ".cache" / "no-ephemerides")
# a service in a test never writes into the user's journal; a process of tests has its own
os.environ["MOUNTNAV_JOURNAL"] = str(ROOT / ".cache" / f"journal-of-tests-{os.getpid()}.sqlite")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # begun in the background by a script: every process that a test begins would take no Ctrl-C either
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(trylast=True)  # when what this run leaves out is gone
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin what takes minutes before all else, each process with its part of it.

    xdist's `worksteal` gives the processes runs of equal length; who has done his steals from others' ends.
    """
    first = [item for item in items if item.get_closest_marker("first") is not None]
    rest = [item for item in items if item.get_closest_marker("first") is None]
    left, processes = len(items), int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    items.clear()
    for remaining in range(processes, 0, -1):
        share = left // remaining
        dear = first[: min(share, -(-len(first) // remaining))]
        items += dear + rest[: share - len(dear)]
        del first[: len(dear)], rest[: share - len(dear)]
        left -= share


def pytest_collection_finish() -> None:
    """Leave what was imported and collected out of the search for garbage: none of it ever is.

    Over 659 tests that saved a tenth of the CPU time.
    """
    gc.collect()
    gc.freeze()


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
