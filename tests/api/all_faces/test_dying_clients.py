"""Clients die while the mount goes on by their order: a few of `benchmarks.dying_clients`."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest

from tests.api.all_faces.deaths import Observed, allowed_s, observed, outlives_s

pytestmark = [pytest.mark.long, pytest.mark.first]  # they wait for mounts: not at the end


@pytest.fixture(scope="module")
def at(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Observed]:
    with observed(tmp_path_factory.mktemp("dying")) as one:
        yield one


@pytest.mark.parametrize(
    ("face", "what", "death"),
    [
        ("http-leased", "rates", "killed"),
        ("alpaca", "axis", "silent"),
        ("indi", "rates", "suspended"),
        ("indi-mute", "axis", "reset"),
        # indiserver lives on, and so does its connection
        ("indiserver", "rates", "killed"),
        ("lx200", "axis", "silent"),
    ],
)
def test_nothing_outlives_its_client(at: Observed, face: str, what: str, death: str) -> None:
    if face == "indiserver" and shutil.which("indiserver") is None:
        pytest.skip("indiserver is not installed: it comes with the package indi-bin")
    at.rested()
    # it ends, however slow the machine is; how late, only an unloaded one can tell: the benchmark does
    assert outlives_s(at, face, what, death, give_up_s=20.0 * allowed_s(face, what, death)) is not None
