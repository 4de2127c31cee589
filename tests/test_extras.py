"""What only some users need is not installed with the rest: what is missing is told with what brings it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mountnav.errors import BadCatalog, BadRequest
from mountnav.extras import extra


def test_a_missing_package_is_told_with_the_extra_that_brings_it() -> None:
    with pytest.raises(BadRequest, match="tables need nowhere, which is not installed") as told:  # noqa: SIM117
        with extra("parquet", "tables"):
            import nowhere.at.all  # type: ignore[import-not-found]  # noqa: F401
    assert told.value.advice == "pip install 'mountnav[parquet]'"


def test_it_is_told_by_the_error_that_the_caller_expects() -> None:
    with pytest.raises(BadCatalog), extra("parquet", "tables", BadCatalog):
        raise ImportError(name="pyarrow.parquet")


WITHOUT = """
import sys
for missing in ("pyarrow", "matplotlib"):
    sys.modules[missing] = None
from api.main import main
sys.argv = ["mountnav", *sys.argv[1:]]
main()
"""


def _without(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """A command where neither pyarrow nor matplotlib is installed."""
    told = [sys.executable, "-c", WITHOUT, *map(str, arguments)]
    return subprocess.run(told, capture_output=True, text=True, timeout=300)


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "extra_name"),
    [
        (("solve", "FRAME", "--parquet", "OUT.parquet"), "parquet"),
        (("accuracy", "FRAME", "--plot", "OUT"), "plots"),
    ],
)
def test_commands_say_which_extra_they_need_before_they_work(
    arguments: tuple[str, ...], extra_name: str, tmp_path: Path
) -> None:
    frame = tmp_path / "frame.fits"
    frame.write_bytes(b"SIMPLE  = T")
    given = [str(frame) if one == "FRAME" else one.replace("OUT", str(tmp_path / "out")) for one in arguments]
    done = _without(*given)
    said = " ".join(done.stderr.split())
    assert done.returncode == 2, done.stderr
    assert f"pip install 'mountnav[{extra_name}]'" in said
    assert "Traceback" not in said


@pytest.mark.long
def test_the_rest_works_without_them() -> None:
    assert _without("catalog", "list").returncode == 0
