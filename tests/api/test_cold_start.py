"""What the command line imports: what is dear stays out where it is no use. Times: benchmarks/start_up.py."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from astropy.io import fits

from api.cli.app import app
from api.cli.commands import COMMANDS, GROUPS, app_of
from mountnav.start_up import BY_ONE_THREAD

DEAR = (
    *("astropy", "astropy_healpix", "PIL", "matplotlib", "rich", "fastapi", "uvicorn", "httpx", "asyncio"),
    *("scipy.optimize", "scipy.interpolate", "scipy.stats", "scipy.signal", "scipy.integrate"),
    *("mountnav.settings.observatory", "mountnav.simulation", "mountnav.measuring.calibration"),
)
UNUSED = (
    *("unittest", "numpy.f2py.crackfortran", "numpy.testing._private.utils"),
    *("numpy.polynomial.chebyshev", "api.solver.solve_record", "api.http.app"),
    *("scipy.sparse._base", "scipy.linalg._basic", "scipy.spatial.transform", "scipy.spatial._qhull"),
    *("scipy.special._orthogonal", "scipy._lib.array_api_compat.numpy.linalg"),
)
"""What scipy names and a solve doesn't use (`mountnav.start_up`); and the models of the service."""
RUN = """
import json, sys
from api.main import main
sys.argv = ["mountnav", *sys.argv[1:]]
try:
    main()
except SystemExit:
    pass
print(json.dumps(sorted(sys.modules)), file=sys.stderr)
"""


def _imported(*arguments: str | Path, cache: Path) -> tuple[set[str], str]:
    """The modules that a command imports, and what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"MOUNTNAV_CACHE": str(cache)},
    )
    return set(json.loads(done.stderr.splitlines()[-1])), done.stdout


def _among(dear: tuple[str, ...], imported: set[str]) -> list[str]:
    return [name for name in dear if name in imported]


@pytest.fixture(scope="module")
def plain(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A rendered frame as a camera writes it, and the options of its hint."""
    folder = shared / "data" / "rendered"
    truth = next(
        one for one in json.loads((folder / "truth.json").read_text()) if one["file"].startswith("A01")
    )
    file = tmp_path_factory.mktemp("plain") / "a01.fits"
    with fits.open(folder / truth["file"]) as opened:
        image = next(hdu for hdu in opened if hdu.data is not None)
        fits.PrimaryHDU(image.data).writeto(file)
    hint = truth["hint"]
    options = [f"--{name}={value}" for name, value in (*hint.items(), ("radius", 1))]
    return file, options


@pytest.mark.long
@pytest.mark.shared
def test_a_hinted_plain_fits_file_is_solved_without_what_is_dear(
    plain: tuple[Path, list[str]], tmp_path: Path
) -> None:
    file, options = plain
    imported, printed = _imported("solve", file, *options, "--no-blind", "--json", cache=tmp_path)
    assert json.loads(printed)["solved"]
    assert _among((*DEAR, *UNUSED), imported) == []
    assert "mountnav.measuring.measure" not in imported  # a glance was enough


@pytest.mark.long
@pytest.mark.shared
def test_looking_for_the_index_of_the_sky_costs_no_astropy(
    plain: tuple[Path, list[str]], tmp_path: Path
) -> None:
    file, options = plain
    imported, printed = _imported("solve", file, *options, "--json", cache=tmp_path)
    assert json.loads(printed)["solved"]
    assert _among(("astropy", "astropy_healpix"), imported) == []
    assert list(tmp_path.iterdir()) == []  # nothing was built


@pytest.mark.long
@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["solve", "--help"]])
def test_help_comes_without_numpy(arguments: list[str], tmp_path: Path) -> None:
    imported, printed = _imported(*arguments, cache=tmp_path)
    assert "mountnav" in printed
    assert _among(("numpy", "scipy", *DEAR[:4], "mountnav.solving.solve"), imported) == []


@pytest.mark.long
@pytest.mark.parametrize("command", [["ports", "--help"], ["solve", "--help"], ["key", "--help"]])
def test_a_command_imports_no_other_command(command: list[str], tmp_path: Path) -> None:
    imported, _ = _imported(*command, cache=tmp_path)
    files = {name.removeprefix("api.cli.") for name in imported if name.startswith("api.cli.")}
    shared = {"app", "commands", "options", "output", "chosen_catalogs"}
    assert files - shared == {(COMMANDS | GROUPS)[command[0]].file}


@pytest.mark.parametrize("words", [[], ["--help"], ["nothing"], ["--version"]])
def test_all_commands_are_there_where_none_of_them_is_named(words: list[str]) -> None:
    whole = typer.main.get_command(app_of(words))
    assert isinstance(whole, typer.core.TyperGroup)
    assert list(whole.commands) == list(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
    assert {*whole.commands} == {*COMMANDS, *GROUPS}


@pytest.mark.long
def test_a_fake_mount_is_served_without_astropy(tmp_path: Path) -> None:
    """Up to where it tells that its port is taken: all that it needs is there by then."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        imported, _ = _imported("fake-mount", "--tcp", address, cache=tmp_path)
    assert "mountnav.sky.iers" in imported
    assert _among(("astropy", "astropy_healpix", "scipy", "fastapi"), imported) == []


@pytest.mark.long
@pytest.mark.parametrize(
    ("module", "dear"),
    [
        ("mountnav", ("numpy", "importlib.metadata")),
        ("mountnav.sky.coordinates", ("numpy", "erfa", "astropy_iers_data")),
        ("mountnav.reading", ("scipy", "erfa", *DEAR)),
        ("mountnav.catalog.embedded", ("scipy", *DEAR)),
        ("mountnav.solving.solve", DEAR),
        ("api.http.app", ("scipy", "astropy", "astropy_healpix", "matplotlib", "pyarrow")),
        ("mountnav.identification.blind.index", DEAR),
        ("mountnav.identification.blind.cache", DEAR),
        ("api.batch.pool", ("pydantic", *(name for name in DEAR if name != "asyncio"))),
        ("api.solver_daemon.daemon", ("pydantic", *(name for name in DEAR if name != "asyncio"))),
    ],
)
def test_modules_bring_little_with_them(module: str, dear: tuple[str, ...]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f"import json, sys, {module}; print(json.dumps(sorted(sys.modules)))"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert _among(dear, set(json.loads(done.stdout))) == []


@pytest.mark.long
def test_an_index_that_is_there_is_opened_without_rich(sky_index: object) -> None:
    lines = (
        "import json, sys",
        "from api.cli.catalog_import import built_with_progress",
        "from mountnav.catalog.embedded import embedded_catalog",
        "assert built_with_progress(embedded_catalog()).path",
        "print(json.dumps(sorted(sys.modules)))",
    )
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=True
    )
    assert _among(("rich", "pydantic", "asyncio"), set(json.loads(done.stdout))) == []
    assert done.stderr == ""


def test_the_public_names_of_the_sky_are_all_there() -> None:
    import mountnav.sky

    for name in mountnav.sky.__all__:
        assert getattr(mountnav.sky, name).__name__ == name
    with pytest.raises(AttributeError, match="nothing"):
        mountnav.sky.nothing  # noqa: B018


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="threads are counted by Linux's /proc")
@pytest.mark.parametrize(("given", "threads"), [({}, 1), ({"OPENBLAS_NUM_THREADS": "3"}, 3)])
def test_a_command_computes_by_one_thread_unless_told_otherwise(given: dict[str, str], threads: int) -> None:
    """Threads on matrices as small as a solve's cost twice the CPU; they are made when numpy is imported."""
    count = "import numpy, re; print(re.search(r'Threads:\\s+(\\d+)', open('/proc/self/status').read())[1])"
    environment = {name: value for name, value in os.environ.items() if name not in BY_ONE_THREAD}
    done = subprocess.run(
        [sys.executable, "-c", f"{RUN}\n{count}", "ports", "--help"],
        capture_output=True,
        text=True,
        check=True,
        env=environment | given,
    )
    assert min(int(done.stdout.splitlines()[-1]), os.cpu_count() or 1) == min(threads, os.cpu_count() or 1)
