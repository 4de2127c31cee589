"""The arguments that programs really give, whole lists of them, and what each then looks for and reads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from astropy.io import fits

from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.solver_commands import readers
from tests.api.solver_commands.fields import (
    CENTER,
    HEIGHT_PX,
    SCALE_ARCSEC_PX,
    WIDTH_PX,
    call,
    fits_field,
    pixels,
)
from tests.api.solver_commands.program_readers import ccdciel_wcs, nina_ini, stellarsolver_ini

pytestmark = pytest.mark.filterwarnings("ignore::astropy.wcs.wcs.FITSFixedWarning")

HEIGHT_DEG, WIDTH_DEG = HEIGHT_PX * SCALE_ARCSEC_PX / 3600.0, WIDTH_PX * SCALE_ARCSEC_PX / 3600.0
HOURS, SPD = f"{(CENTER.ra_deg + 0.3) / 15}", f"{CENTER.dec_deg + 90.2}"
RA, DEC = f"{CENTER.ra_deg + 0.3}", f"{CENTER.dec_deg - 0.2}"
LOW, HIGH = f"{0.9 * SCALE_ARCSEC_PX}", f"{1.1 * SCALE_ARCSEC_PX}"
NONE = ["--index-xyls", "none", "--match", "none", "--rdls", "none", "--corr", "none"]
Place = tuple[float, float]


@dataclass(frozen=True)
class Program:
    """A call of a program.

    Attributes
    ----------
    name : str
        Of the program, for people.
    command : str
    arguments : list of str
        FILE and FOLDER stand for the frame's path and the folder that it lies in.
    read : callable
        What it makes of the printed text and the folder: a place.
    written : tuple of str
        All files that are there afterwards beside the frame.
    """

    name: str
    command: str
    arguments: list[str]
    read: Callable[[str, Path], Place]
    written: tuple[str, ...]


def _ini(read: Callable[[str], object], name: str = "field.ini") -> Callable[[str, Path], Place]:
    def place(out: str, folder: Path) -> Place:
        seen = read((folder / name).read_text("ascii"))
        assert seen is not None
        return seen.ra_deg, seen.dec_deg  # type: ignore[attr-defined]

    return place


def _center_of(header: fits.Header, width: int, height: int) -> Place:
    from astropy.wcs import WCS

    ra, dec = WCS(header).all_pix2world([[(width - 1) / 2, (height - 1) / 2]], 0)[0]
    return float(ra), float(dec)


def _lines_of_wcs(out: str, folder: Path) -> Place:
    cards, shown = ccdciel_wcs((folder / "field.wcs").read_bytes())
    assert shown == ""
    header = fits.Header.fromstring("".join(cards))
    return _center_of(header, WIDTH_PX, HEIGHT_PX)


def _cards_of_wcs(out: str, folder: Path) -> Place:
    with fits.open(folder / "field.wcs") as opened:
        opened.verify("exception")
        return _center_of(opened[0].header, WIDTH_PX, HEIGHT_PX)


def _by_wcsinfo(out: str, folder: Path) -> Place:
    code, told, _ = call("wcsinfo", folder / "field.wcs")
    read = readers.stellarsolver(told)
    assert code == 0
    assert read is not None
    return read.ra_deg, read.dec_deg


def _of_new(out: str, folder: Path) -> Place:
    """panoptes-utils: the new file takes the frame's place, its WCS is read from there."""
    with fits.open(folder / "field.new") as opened:
        assert opened[0].data.shape == (HEIGHT_PX, WIDTH_PX)
        return _center_of(opened[0].header, WIDTH_PX, HEIGHT_PX)


def _of_lines(out: str, folder: Path) -> Place:
    read = readers.indi(out)
    assert read is not None
    return read.ra_deg, read.dec_deg


PROGRAMS = [
    Program(
        "N.I.N.A.",
        "astap",
        [
            *("-f", "FILE", "-fov", f"{HEIGHT_DEG}", "-z", "0", "-s", "500"),
            *("-r", "30", "-ra", HOURS, "-spd", SPD),
        ],
        _ini(nina_ini),
        ("field.ini", "field.wcs"),
    ),
    Program(
        "N.I.N.A. blind",
        "astap",
        ["-f", "FILE", "-fov", f"{HEIGHT_DEG}", "-z", "2", "-s", "500", "-r", "180"],
        _ini(nina_ini),
        ("field.ini", "field.wcs"),
    ),
    Program(
        "CCDciel",
        "astap",
        ["-log", "-z", "0", "-r", "180", "-f", "FILE"],
        _lines_of_wcs,
        ("field.ini", "field.log", "field.wcs"),
    ),
    Program(
        "MountWizzard4",
        "astap_cli",
        [
            *("-f", "FILE", "-o", "FOLDER/field", "-wcs", "-r", "10", "-t", "0.005", "-z", "0"),
            *("-d", "/no/such/folder"),
        ],
        _cards_of_wcs,
        ("field.ini", "field.wcs"),
    ),
    Program(
        "Ekos",
        "astap",
        [
            *("-o", "FOLDER/internal_1.ini", "-speed", "auto", "-f", "FILE", "-wcs", "-z", "2"),
            *("-fov", f"{HEIGHT_DEG}", "-ra", HOURS, "-spd", SPD, "-r", "15", "-log"),
        ],
        _ini(stellarsolver_ini, "internal_1.ini"),
        ("internal_1.ini", "internal_1.log", "internal_1.wcs"),
    ),
    Program(
        "N.I.N.A. by cygwin",
        "solve-field",
        [
            *("--overwrite", *NONE, "--new-fits", "none", "--solved", "none", "-center", "--no-plots"),
            *("--objs", "500", "-u", "arcsecperpix", "-L", LOW, "-H", HIGH, "--no-verify"),
            *("--ra", RA, "--dec", DEC, "--radius", "10", "FILE"),
        ],
        _by_wcsinfo,
        ("field.axy", "field.wcs"),
    ),
    Program(
        "CCDciel",
        "solve-field",
        [
            *("--overwrite", "--scale-low", LOW, "--scale-high", HIGH, "--scale-units", "arcsecperpix"),
            *(
                "--ra",
                RA,
                "--dec",
                DEC,
                "--radius",
                "15",
                "--downsample",
                "4",
                "--objs",
                "1000",
                "--no-plots",
            ),
            *(*NONE, "--new-fits", "none", "--no-remove-lines", "--uniformize", "0", "FILE"),
        ],
        _cards_of_wcs,
        ("field.axy", "field.solved", "field.wcs"),
    ),
    Program(
        "Ekos",
        "solve-field",
        [
            *("-O", "--no-plots", "--no-verify", "--crpix-center", "--match", "none", "--corr", "none"),
            *("--new-fits", "none", "--rdls", "none", "--resort", "--depth", "20,50,100"),
            *("--odds-to-solve", "1e9", "--odds-to-tune-up", "1e6", "-L", LOW, "-H", HIGH, "-u", "app"),
            *("-3", RA, "-4", DEC, "-5", "15", "--cancel", "FOLDER/stop", "-W", "FOLDER/field.wcs", "FILE"),
        ],
        _by_wcsinfo,
        ("field-indx.xyls", "field.axy", "field.solved", "field.wcs"),
    ),
    Program(
        "POCS",
        "solve-field",
        [
            *("--guess-scale", "--cpulimit", "90", "--no-verify", "--crpix-center", "--temp-axy"),
            *("--index-xyls", "none", "--solved", "none", "--match", "none", "--rdls", "none"),
            *(
                "--corr",
                "none",
                "--downsample",
                "4",
                "--no-plots",
                "--ra",
                RA,
                "--dec",
                DEC,
                "--radius",
                "15",
            ),
            *("--overwrite", "FILE"),
        ],
        _of_new,
        ("field.new", "field.wcs"),
    ),
    Program(
        "INDI",
        "solve-field",
        [
            *("--no-verify", "--no-plots", "--no-fits2fits", "--resort", "--downsample", "2", "-O"),
            *("-3", RA, "-4", DEC, "-5", "30", "-W", "FOLDER/solution.wcs", "FILE"),
        ],
        _of_lines,
        (
            *("field-indx.xyls", "field.axy", "field.corr", "field.match", "field.new", "field.rdls"),
            *("field.solved", "solution.wcs"),
        ),
    ),
]


@pytest.mark.long
@pytest.mark.usefixtures("sky_index")
@pytest.mark.parametrize("program", PROGRAMS, ids=lambda one: f"{one.name} by {one.command}")
def test_a_program_finds_what_it_looks_for(program: Program, tmp_path: Path) -> None:
    field = fits_field(tmp_path / "field.fits", pixels())
    given = {"FILE": str(field)}
    arguments = [given.get(one, one.replace("FOLDER", str(tmp_path))) for one in program.arguments]
    code, out, err = call(program.command, *arguments)
    assert (code, err) == (0, "")
    found = Icrs(*program.read(out, tmp_path))
    assert separation_arcsec(found, CENTER) < 0.05 * SCALE_ARCSEC_PX
    assert tuple(sorted(one.name for one in tmp_path.iterdir())) == tuple(
        sorted(("field.fits", *program.written))
    )


@pytest.mark.long
@pytest.mark.usefixtures("sky_index")
@pytest.mark.parametrize("program", PROGRAMS, ids=lambda one: f"{one.name} by {one.command}")
def test_a_program_finds_no_solution_where_there_is_none(program: Program, tmp_path: Path) -> None:
    field = fits_field(tmp_path / "field.fits", pixels()[::8, ::8].copy())
    given = {"FILE": str(field)}
    arguments = [given.get(one, one.replace("FOLDER", str(tmp_path))) for one in program.arguments]
    code, out, _ = call(program.command, *arguments)
    assert (code != 0) == program.command.startswith("astap")
    assert "Field center" not in out
    assert not [one.name for one in tmp_path.iterdir() if one.suffix in (".wcs", ".solved", ".new")]
    assert all("PLTSOLVD=T" not in one.read_text("ascii") for one in tmp_path.glob("*.ini"))
