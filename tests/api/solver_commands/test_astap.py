"""`astap`: what programs make of its results, beside the original, and what is no success."""

from __future__ import annotations

import gzip
import math
import os
import shutil
import subprocess
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from api.solver_commands.astap import (
    BAD_STARS,
    FEW_STARS,
    NO_CATALOG,
    NO_IMAGE,
    NOT_UPDATED,
    SOLVED,
    UNSOLVED,
    Options,
    run,
)
from api.solver_commands.host import Asked, LocalHost, Solver
from api.solver_commands.in_process import SolverInProcess
from mountnav.catalog.embedded import embedded_catalog
from mountnav.errors import BadCatalog, MountnavError, StarsUnavailable
from mountnav.frames import Frame, Hint
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Solution, Verdict
from mountnav.solving.solve import solve
from tests.api.solver_commands.drawn_frames import (
    ANGLES_DEG,
    CENTER,
    HEIGHT_DEG,
    HEIGHT_PX,
    IN_TURNS,
    PARITIES,
    SCALE_ARCSEC,
    WIDTH_PX,
    as_fits,
    as_png,
    drawn,
)
from tests.api.solver_commands.program_readers import (
    NotRead,
    Seen,
    ccdciel_wcs,
    nina_ini,
    stellarsolver_ini,
)

AT = ["-ra", f"{CENTER.ra_deg / 15 + 0.02}", "-spd", f"{CENTER.dec_deg + 90.3}", "-r", "2"]
FOV = ["-fov", f"{HEIGHT_DEG:.4f}"]
ORDER = [
    "PLTSOLVD", "CRPIX1", "CRPIX2", "CRVAL1", "CRVAL2", "CDELT1", "CDELT2", "CROTA1", "CROTA2",
    "CD1_1", "CD1_2", "CD2_1", "CD2_2", "CMDLINE",
]  # fmt: skip


@pytest.fixture(scope="module")
def solver() -> SolverInProcess:
    return SolverInProcess()


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def _ini(path: str) -> Seen | None:
    return nina_ini(Path(path).read_text("ascii"))


def _ours(frame: Frame) -> Solution:
    """The frame solved by the library."""
    solution = solve(frame, embedded_catalog(), hint=Hint(center=CENTER)).solution
    assert solution is not None
    return solution


def _apart_px(seen: Seen, place: Icrs) -> float:
    return separation_arcsec(Icrs(seen.ra_deg, seen.dec_deg), place) / SCALE_ARCSEC


# -- what programs read --------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("parity", PARITIES)
@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_programs_see_one_field_in_all_orientations_and_kinds_of_files(
    angle_deg: float, parity: int, solver: SolverInProcess
) -> None:
    frame = drawn(angle_deg, parity)
    as_fits(Path("frame.fits"), frame)
    as_png(Path("picture.png"), frame)
    assert run(["-f", "frame.fits", *FOV, *AT, "-wcs"], LocalHost(), solver) == SOLVED
    assert run(["-f", "picture.png", *FOV, *AT, "-wcs"], LocalHost(), solver) == SOLVED
    ours = _ours(frame)
    up_deg = ours.rotation_deg  # position angle of FITS' last row
    for name in ("frame", "picture"):
        text = Path(f"{name}.ini").read_text("ascii")
        assert [line.partition("=")[0] for line in text.splitlines()][: len(ORDER)] == ORDER
        nina, ekos = nina_ini(text), stellarsolver_ini(text)
        assert nina is not None
        assert ekos is not None
        assert _apart_px(nina, ours.center) < 0.01
        assert _apart_px(nina, CENTER) < 0.1
        assert nina.scale_arcsec == pytest.approx(ours.scale_arcsec_px, rel=1e-4)
        assert _turn(nina.angle_deg, up_deg + 180.0) < 0.01  # N.I.N.A. shows the first row on top
        assert nina.flipped == (ours.parity == 1)
        assert ekos.scale_arcsec == pytest.approx(-ours.parity * ours.scale_arcsec_px, rel=1e-4)
        assert _turn(ekos.angle_deg, up_deg) < 0.01
        assert ekos.flipped == (ours.parity == -1)
        header = fits.Header.fromfile(f"{name}.wcs", sep="", endcard=True, padding=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            wcs = WCS(header)
        place = wcs.pixel_to_world_values((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2)
        assert separation_arcsec(Icrs(*map(float, place)), ours.center) / SCALE_ARCSEC < 0.01
        # a star far from the center lies where the frame has it, whichever row the file begins with
        corner = wcs.pixel_to_world_values(60.0, 50.0)
        assert separation_arcsec(Icrs(*map(float, corner)), ours.icrs_at(60.0, 50.0)) / SCALE_ARCSEC < 0.5


def _turn(one_deg: float, other_deg: float) -> float:
    return abs((one_deg - other_deg + 180.0) % 360.0 - 180.0)


def test_without_wcs_the_plate_is_lines_of_text_as_ccdciel_reads_it(solver: SolverInProcess) -> None:
    as_fits(Path("frame.fits"), OBJECT="M 37", OBSERVER="O'Neill", FOCALLEN=200.0)
    assert run(["-log", "-z", "0", "-f", "frame.fits", *FOV, *AT], LocalHost(), solver) == SOLVED
    cards, shown = ccdciel_wcs(Path("frame.wcs").read_bytes())
    assert shown == ""
    header = fits.Header.fromstring("".join(cards))
    assert header["CRPIX1"] == (WIDTH_PX + 1) / 2
    assert header["OBJECT"] == "M 37"
    assert header["OBSERVER"] == "O'Neill"
    assert header["NAXIS"] == 0
    assert "NAXIS1" not in header
    assert "Solution found" in Path("frame.log").read_text("ascii")


def test_the_header_of_wcs_verifies_whatever_the_frame_brings(solver: SolverInProcess) -> None:
    path = as_fits(Path("frame.fits"), OBJECT="x" * 67)
    content = bytearray(path.read_bytes())
    # cards that break the standard, as cameras write them
    odd = [b"bad key = 'no quote", b"NOVALUE =", b"CONTINUE  'alone'", b"FOO     = 1.2.3", b"WARNING = 'old'"]
    block = b"".join(card.ljust(80) for card in odd)
    at = content.index(b"END" + b" " * 77)
    content[at : at + len(block) + 80] = block + b"END".ljust(80)
    path.write_bytes(content)
    name = "frame.fits"
    long = "-o " + "y" * 200
    assert run(["-f", name, "-fov", "1.5", *AT, "-wcs", long], LocalHost(), solver) == SOLVED
    raw = Path("frame.wcs").read_bytes()
    assert len(raw) % 2880 == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hdu = fits.PrimaryHDU.fromstring(raw)
        hdu.verify("exception")
    assert hdu.header["WARNING"].startswith("Warning scale was inaccurate! Set FOV=1.60d")
    assert "CONTINUE" not in raw.decode("ascii")


@pytest.mark.long
def test_sip_is_written_only_where_it_is_wanted(solver: SolverInProcess) -> None:
    frame = drawn(distortion_px2=3e-8)
    as_png(Path("p.png"), frame)
    for option, wanted in (([], False), (["-sip"], True), (["-sip", "y"], True), (["-sip", "n"], False)):
        assert run(["-f", "p.png", *FOV, *AT, "-wcs", *option], LocalHost(), solver) == SOLVED
        header = fits.Header.fromfile("p.wcs", sep="", endcard=True, padding=True)
        assert (header["CTYPE1"] == "RA---TAN-SIP") == wanted
        assert ("A_ORDER" in header) == wanted
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            corner = WCS(header).all_pix2world(5.0, 8.0, 0)
        apart_px = separation_arcsec(Icrs(*map(float, corner)), _ours(frame).icrs_at(5.0, 8.0)) / SCALE_ARCSEC
        assert (apart_px < 0.05) == wanted


def test_sip_of_a_picture_is_turned_with_its_rows(solver: SolverInProcess) -> None:
    from api.solver_commands.image_facts import rows_up
    from mountnav.sky.wcs import places_at_pixels

    random = np.random.default_rng(3)
    cards: dict[str, str | int | float] = {
        "CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "CRPIX1": 320.5, "CRPIX2": 240.5,
        "CRVAL1": 10.0, "CRVAL2": 40.0, "CD1_1": -3e-3, "CD1_2": 1e-3, "CD2_1": 1e-3, "CD2_2": 3e-3,
        "A_ORDER": 3, "B_ORDER": 3,
    }  # fmt: skip
    for i in range(4):
        for j in range(4 - i):
            if i + j > 1:
                for letter in "AB":
                    cards[f"{letter}_{i}_{j}"] = float(random.normal() * 10.0 ** (-3 * (i + j - 1) - 1))
    x, y = random.uniform(0, 639, 50), random.uniform(0, 479, 50)
    turned = rows_up(cards, 480)
    np.testing.assert_allclose(
        np.stack(places_at_pixels(cards, x, y)), np.stack(places_at_pixels(turned, x, 479.0 - y)), rtol=1e-12
    )
    assert rows_up(turned, 480) == pytest.approx(cards)


@pytest.mark.long
def test_rows_of_each_kind_of_picture_count_as_in_the_original(solver: SolverInProcess) -> None:
    pixels = np.ascontiguousarray(drawn().pixels[::-1])
    gray = Image.fromarray(np.clip(pixels // 16, 0, 255).astype(np.uint8))
    gray.save("p.jpg", quality=98)
    gray.save("p.bmp")
    gray.save("p.pgm")
    Image.fromarray(pixels).save("p.tif")
    for name, up in (("p.jpg", 1), ("p.bmp", 1), ("p.tif", 1), ("p.pgm", -1)):
        assert run(["-f", name, *FOV, *AT], LocalHost(), solver) == SOLVED
        said = dict(line.split("=", 1) for line in Path("p.ini").read_text("ascii").splitlines())
        assert math.copysign(1.0, float(said["CD2_2"])) == up, name


# -- the header of the image itself --------------------------------------------------------------------------


def test_update_writes_the_plate_and_leaves_the_pixels(solver: SolverInProcess) -> None:
    path = as_fits(Path("frame.fits"), CTYPE1="RA---TAN", CRVAL1=1.0)
    before = fits.getdata(path)
    assert run(["-f", "frame.fits", *FOV, *AT, "-update"], LocalHost(), solver) == SOLVED
    with fits.open(path) as opened:
        opened.verify("exception")
        np.testing.assert_array_equal(opened[0].data, before)
        assert opened[0].header["PLTSOLVD"] is True
        assert opened[0].header["CRVAL1"] == pytest.approx(CENTER.ra_deg, abs=1e-3)
        assert opened[0].header["CDELT1"] < 0


def test_update_makes_fits_of_a_picture_with_its_rows_from_below(solver: SolverInProcess) -> None:
    as_png(Path("p.png"))
    before = Path("p.png").read_bytes()
    assert run(["-f", "p.png", *FOV, *AT, "-update"], LocalHost(), solver) == SOLVED
    np.testing.assert_array_equal(fits.getdata("p.fits"), drawn().pixels)
    assert fits.getheader("p.fits")["CD2_2"] > 0
    assert Path("p.png").read_bytes() == before


class _ReadOnly(LocalHost):
    """A host whose images can't be written."""

    def write(self, path: str, content: bytes) -> None:
        if path.endswith(".fits"):
            raise PermissionError(13, "Permission denied", path)
        super().write(path, content)


def test_what_cannot_be_updated_has_its_exit_code_and_is_told(solver: SolverInProcess) -> None:
    as_fits(Path("frame.fits"))
    before = Path("frame.fits").read_bytes()
    assert run(["-f", "frame.fits", *FOV, *AT, "-update"], _ReadOnly(), solver) == NOT_UPDATED
    assert _ini("frame.ini") is not None
    assert Path("frame.fits").read_bytes() == before


def test_no_result_is_written_over_the_image(solver: SolverInProcess) -> None:
    frame = as_fits(Path("frame.wcs")).read_bytes()
    assert run(["-f", "frame.wcs", *FOV, *AT], LocalHost(), solver) != SOLVED
    assert Path("frame.wcs").read_bytes() == frame


# -- what is no success --------------------------------------------------------------------------------------


def _noise(path: Path) -> None:
    pixels = np.random.default_rng(8).normal(1000.0, 10.0, (HEIGHT_PX, WIDTH_PX)).astype(np.uint16)
    fits.PrimaryHDU(pixels).writeto(path)


def _cut(path: Path) -> None:
    content = as_fits(path).read_bytes()
    path.write_bytes(content[: len(content) // 2])


def _random_stars(path: Path) -> None:
    random = np.random.default_rng(5)
    pixels = random.normal(1000.0, 8.0, (HEIGHT_PX, WIDTH_PX))
    rows, columns = np.mgrid[:HEIGHT_PX, :WIDTH_PX]
    for _ in range(60):
        x, y, flux = random.uniform(5, 635), random.uniform(5, 475), 10 ** random.uniform(2, 4)
        pixels += flux * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 2.4)
    fits.PrimaryHDU(pixels.astype(np.float32)).writeto(path)


BAD = {
    "noise": (_noise, (UNSOLVED, FEW_STARS)),
    "random stars": (_random_stars, (UNSOLVED,)),
    "empty": (lambda path: path.write_bytes(b""), (NO_IMAGE,)),
    "truncated": (_cut, (NO_IMAGE,)),
    "text": (lambda path: path.write_text("no image"), (NO_IMAGE,)),
    "fifo": (os.mkfifo, (NO_IMAGE,)),
    "folder": (lambda path: path.mkdir(), (NO_IMAGE,)),
    "missing": (lambda path: None, (NO_IMAGE,)),
}


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.long] * (kind == "random stars")) for kind in BAD]
)
def test_what_is_no_frame_of_the_sky_never_succeeds(kind: str, solver: SolverInProcess) -> None:
    make, codes = BAD[kind]
    make(Path("bad.fits"))
    assert run(["-f", "bad.fits", *FOV, *AT, "-wcs"], LocalHost(), solver) in codes
    text = Path("bad.ini").read_text("ascii")
    assert nina_ini(text) is None
    assert stellarsolver_ini(text) is None
    assert not Path("bad.wcs").exists()
    said = dict(line.split("=", 1) for line in text.splitlines())
    assert said["WARNING"]
    if NO_IMAGE in codes:
        assert said["ERROR"] == "Error reading image file."


@pytest.mark.long
def test_a_field_of_quite_another_size_is_no_success(solver: SolverInProcess) -> None:
    as_fits(Path("frame.fits"))
    assert run(["-f", "frame.fits", "-fov", f"{3 * HEIGHT_DEG}", *AT], LocalHost(), solver) == UNSOLVED
    assert _ini("frame.ini") is None
    assert run(["-f", "frame.fits", "-fov", f"{HEIGHT_DEG / 3}", *AT], LocalHost(), solver) == UNSOLVED
    assert _ini("frame.ini") is None


def test_a_field_that_is_off_by_some_percent_is_warned_of(solver: SolverInProcess) -> None:
    as_fits(Path("frame.fits"), XPIXSZ=3.76)
    assert run(["-f", "frame.fits", "-fov", f"{1.15 * HEIGHT_DEG}", *AT], LocalHost(), solver) == SOLVED
    said = dict(line.split("=", 1) for line in Path("frame.ini").read_text("ascii").splitlines())
    words = 'Warning scale was inaccurate! Set FOV=1.60d, scale=12.0", FL=65mm'
    assert said["WARNING"].startswith(words)
    assert ccdciel_wcs(Path("frame.wcs").read_bytes())[1].startswith(words[:60])


class _Broken:
    """A solver that can't be had."""

    def __init__(self, fault: MountnavError) -> None:
        self.fault = fault

    def solve(self, asked: Asked, *, cancelled: object = None) -> Verdict:
        raise self.fault

    def read(self, file: object, name: str) -> Frame:
        raise self.fault


@pytest.mark.parametrize(
    ("fault", "code", "error"),
    [
        (StarsUnavailable("no stars"), NO_CATALOG, "No star database found."),
        (BadCatalog("damaged"), BAD_STARS, "Error reading star database."),
        (MountnavError("the daemon\nhas gone\nPLTSOLVD=T"), UNSOLVED, None),
    ],
)
def test_without_a_solver_the_result_says_so(fault: MountnavError, code: int, error: str | None) -> None:
    as_fits(Path("frame.fits"))
    broken: Solver = _Broken(fault)
    assert run(["-f", "frame.fits"], LocalHost(), broken) == code
    text = Path("frame.ini").read_text("ascii")
    assert nina_ini(text) is None
    assert ("ERROR=" in text) == (error is not None)
    assert error is None or f"ERROR={error}\n" in text


def test_names_of_files_break_no_line(solver: SolverInProcess) -> None:
    name = "a\nPLTSOLVD=T\nCRVAL1=3 ä'.fits"
    assert run(["-f", name], LocalHost(), solver) == NO_IMAGE
    text = Path("a\nPLTSOLVD=T\nCRVAL1=3 ä'.ini").read_text("ascii")
    assert nina_ini(text) is None
    assert stellarsolver_ini(text) is None


# -- options -------------------------------------------------------------------------------------------------


def test_options_are_taken_with_one_dash_or_two_and_equals_signs(solver: SolverInProcess) -> None:
    as_fits(Path("frame.fits"))
    arguments = ["--f=frame.fits", f"-fov={HEIGHT_DEG:.4f}", "--ra", "6.6", "-spd=123,0", "-r", "5"]
    unknown = ["-nonsense", "7", "--more=8", "-z", "0", "-s", "500", "-D", "d50", "-d", "/nowhere"]
    out = ["-o", "deep/result.x.ini", "-speed", "auto"]
    Path("deep").mkdir()
    assert run([*arguments, *unknown, *out], LocalHost(), solver) == SOLVED
    assert _ini("deep/result.x.ini") is not None
    assert Path("deep/result.x.wcs").is_file()
    assert not Path("frame.ini").exists()


@pytest.mark.parametrize("arguments", [[], ["-h"], ["-f", "x.fits", "--help"], ["frame.fits"]])
def test_without_a_file_the_options_are_told(
    arguments: list[str], solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments, LocalHost(), solver) == SOLVED
    assert "-fov" in capsys.readouterr().out
    assert not list(Path().iterdir())


@pytest.mark.parametrize("option", ["stack", "p", "debug"])
def test_what_is_not_possible_is_refused(
    option: str, solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    as_fits(Path("frame.fits"))
    assert run(["-f", "frame.fits", f"-{option}", "x"], LocalHost(), solver) == UNSOLVED
    assert capsys.readouterr().err.count("\n") == 1
    assert not Path("frame.ini").exists()


@given(st.lists(st.text(max_size=8), max_size=6))
def test_any_arguments_are_taken_apart(arguments: list[str]) -> None:
    options = Options(arguments)
    for argument in arguments:
        name = argument.lstrip("-").partition("=")[0]
        if argument.startswith("-") and argument not in ("-", "--"):
            assert name in options
            assert not (options.text(name) or "").startswith("-") or "=" in "".join(arguments)


@pytest.mark.long
@pytest.mark.parametrize("value", ["nan", "inf", "-3", "x", ""])
def test_numbers_that_are_none_are_passed_over(value: str, solver: SolverInProcess) -> None:
    as_fits(Path("frame.fits"))
    options = ["-fov", value, "-ra", value, "-spd", value, "-r", value]
    code = run(["-f", "frame.fits", *options], LocalHost(), solver)
    assert code in (SOLVED, UNSOLVED)
    assert (_ini("frame.ini") is not None) == (code == SOLVED)


@pytest.mark.long
def test_without_any_hint_the_whole_sky_is_searched(solver: SolverInProcess, sky_index: object) -> None:
    as_png(Path("p.png"))
    assert run(["-f", "p.png", "-r", "180", "-fov", "0"], LocalHost(), solver) == SOLVED
    seen = _ini("p.ini")
    assert seen is not None
    assert _apart_px(seen, CENTER) < 0.1


@pytest.mark.long
def test_a_place_far_off_is_warned_of_and_the_true_one_is_told(
    solver: SolverInProcess, sky_index: object
) -> None:
    as_fits(Path("frame.fits"))
    far = ["-ra", "12", "-spd", "40", "-r", "3"]
    assert run(["-f", "frame.fits", *FOV, *far], LocalHost(), solver) == SOLVED
    seen = _ini("frame.ini")
    assert seen is not None
    assert _apart_px(seen, CENTER) < 0.1
    assert "WARNING=center: -ra and -spd says" in Path("frame.ini").read_text("ascii")


# -- stars ---------------------------------------------------------------------------------------------------


def test_analyse_prints_two_lines_and_writes_nothing(
    solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    as_fits(Path("frame.fits"))
    assert run(["-f", "frame.fits", "-analyse", "0"], LocalHost(), solver) == SOLVED
    said = dict(line.split("=") for line in capsys.readouterr().out.splitlines() if "=" in line)
    assert float(said["HFD_MEDIAN"]) == pytest.approx(2.9, abs=0.1)
    assert 50 < int(said["STARS"]) < 500
    assert not Path("frame.ini").exists()


@pytest.mark.long
def test_stars_are_listed_with_places_once_the_frame_is_solved(solver: SolverInProcess) -> None:
    as_png(Path("p.png"))
    assert run(["-f", "p.png", "-extract", "20"], LocalHost(), solver) == SOLVED
    bare = Path("p.csv").read_text("ascii").splitlines()
    assert bare[0] == "x,y,hfd,snr,flux,ra[0..360],dec[0..360]"
    assert all(line.count(",") == 4 for line in bare[1:])
    assert run(["-f", "p.png", "-extract2", "20", *FOV, *AT], LocalHost(), solver) == SOLVED
    rows = np.loadtxt("p.csv", delimiter=",", skiprows=1)
    assert len(rows) == len(bare) - 1
    ours = _ours(drawn())
    for x, y, _hfd, snr, _flux, ra, dec in rows[:40]:
        assert snr >= 20
        assert separation_arcsec(ours.icrs_at(x - 1.0, y - 1.0), Icrs(ra, dec)) / SCALE_ARCSEC < 0.05


def test_the_brightness_of_the_sky_is_that_of_the_drawing(solver: SolverInProcess) -> None:
    as_fits(Path("frame.fits"))
    # drawn: 20 ADU a second and pixel, zero point 20 mag, 300 ADU of bias
    assert run(["-f", "frame.fits", *FOV, *AT, "-sqm", "300"], LocalHost(), solver) == SOLVED
    said = dict(line.split("=", 1) for line in Path("frame.ini").read_text("ascii").splitlines())
    truth = 20.0 - 2.5 * np.log10(20.0 / SCALE_ARCSEC**2)
    assert float(said["SQM"]) == pytest.approx(truth, abs=0.1)


def test_tofits_makes_a_binned_frame_of_a_picture(solver: SolverInProcess) -> None:
    as_png(Path("p.png"))
    assert run(["-f", "p.png", *FOV, *AT, "-tofits", "2"], LocalHost(), solver) == SOLVED
    binned = np.asarray(drawn().pixels, float).reshape(HEIGHT_PX // 2, 2, WIDTH_PX // 2, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(fits.getdata("p.fit"), binned, atol=0.51)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["fits", "png"])
def test_annotate_draws_the_identified_stars_into_a_jpeg(kind: str, solver: SolverInProcess) -> None:
    (as_fits if kind == "fits" else as_png)(Path(f"frame.{kind}"))
    arguments = ["-f", f"frame.{kind}", *FOV, *AT, "-annotate", "-log", "-o", "out.x"]
    assert run(arguments, LocalHost(), solver) == SOLVED
    with Image.open("out_annotated.jpg") as picture:
        assert picture.format == "JPEG"
        assert picture.size == (WIDTH_PX, HEIGHT_PX)
        colors = np.asarray(picture).astype(int)
    assert np.count_nonzero(np.ptp(colors, axis=2) > 80) > 500  # rings, arrows, text: the sky is gray
    assert "no names" in Path("out.log").read_text("ascii")


def test_the_best_focus_lies_where_stars_are_smallest(
    solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, columns = np.mgrid[:200, :200]
    arguments = []
    for at, position in enumerate((4400, 4700, 5000, 5300, 5600), start=1):
        sigma = 1.3 * np.hypot(1.0, (position - 5100) / 200.0)
        random = np.random.default_rng(at)
        pixels = random.normal(500.0, 5.0, rows.shape)
        for x in range(30, 190, 35):
            for y in range(30, 190, 35):
                pixels += 60000 / sigma**2 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * sigma**2))
        header = fits.Header({"FOCUSPOS": position})
        fits.PrimaryHDU(pixels.astype(np.float32), header).writeto(f"{at}.fits")
        arguments += [f"-focus{at}", f"{at}.fits"]
    assert run(arguments, LocalHost(), solver) == SOLVED
    said = dict(line.split("=") for line in capsys.readouterr().out.splitlines())
    assert float(said["FOCUS"]) == pytest.approx(5100, abs=25)
    assert run(arguments[:4], LocalHost(), solver) == UNSOLVED


# -- beside the original -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def astap_stars(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from benchmarks.peers.astap_stars import write_database
    from mountnav.units import julian_year
    from tests.api.solver_commands.drawn_frames import TAKEN

    folder = tmp_path_factory.mktemp("stars")
    write_database(embedded_catalog(), folder, epoch_yr=julian_year(TAKEN))
    return folder


def _original(name: str, stars: Path, *options: str) -> Mapping[str, str] | None:
    """What the original says of a frame; None if it doesn't solve it."""
    command = ["astap_cli", "-f", name, "-d", str(stars), "-o", "original", "-speed", "slow", "-s", "80"]
    subprocess.run([*command, *FOV, *AT, *options], check=False, capture_output=True, timeout=120)
    lines = Path("original.ini").read_text("latin-1").splitlines()
    said = dict(line.split("=", 1) for line in lines if "=" in line)
    return said if said["PLTSOLVD"] == "T" else None


@pytest.mark.long
@pytest.mark.skipif(shutil.which("astap_cli") is None, reason="astap_cli is not installed")
@pytest.mark.parametrize(("angle_deg", "parity", "kind"), IN_TURNS)
def test_the_original_says_the_same(
    angle_deg: float, parity: int, kind: str, astap_stars: Path, solver: SolverInProcess
) -> None:
    frame = drawn(angle_deg, parity)
    name = str((as_fits if kind == "fits" else as_png)(Path(f"frame.{kind}"), frame))
    theirs = _original(name, astap_stars)
    assert theirs is not None
    assert run(["-f", name, *FOV, *AT], LocalHost(), solver) == SOLVED
    ours = dict(line.split("=", 1) for line in Path("frame.ini").read_text("ascii").splitlines())
    assert [key for key in ours if key != "DIMENSIONS"] == [key for key in theirs if key != "WARNING"]
    said = [Icrs(float(one["CRVAL1"]), float(one["CRVAL2"])) for one in (ours, theirs)]
    # the original's quads find the center to some hundredths of a pixel
    assert separation_arcsec(said[0], CENTER) / SCALE_ARCSEC < 0.03
    assert separation_arcsec(said[0], said[1]) / SCALE_ARCSEC < 0.12
    for key in ("CRPIX1", "CRPIX2"):
        assert float(ours[key]) == pytest.approx(float(theirs[key]))
    for key in ("CDELT1", "CDELT2", "CD1_1", "CD1_2", "CD2_1", "CD2_2"):
        assert float(ours[key]) == pytest.approx(float(theirs[key]), abs=2e-3 * SCALE_ARCSEC / 3600)
    for key in ("CROTA1", "CROTA2"):
        assert _turn(float(ours[key]), float(theirs[key])) < 0.15


def test_the_readers_of_this_file_refuse_what_the_programs_refuse() -> None:
    with pytest.raises(NotRead):
        nina_ini("PLTSOLVD=T\nno equals sign\n")
    with pytest.raises(NotRead):
        nina_ini("PLTSOLVD=F\nPLTSOLVD=T\n")
    with pytest.raises(NotRead):
        stellarsolver_ini("\nPLTSOLVD=F\n")
    with pytest.raises(NotRead):
        ccdciel_wcs(("x" * 81).encode())


# -- damaged files -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Small sound files of each kind: noise, so that nothing can be solved."""
    folder = tmp_path_factory.mktemp("whole")
    pixels = np.random.default_rng(3).integers(900, 1100, (40, 60)).astype(np.uint16)
    fits.PrimaryHDU(pixels).writeto(folder / "f.fits")
    hdus = fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(pixels)])
    hdus.writeto(folder / "f.fits.fz")
    Image.fromarray(pixels).save(folder / "p.png")
    Image.fromarray(pixels).save(folder / "p.tif")
    Image.fromarray((pixels // 8).astype(np.uint8)).save(folder / "p.jpg")
    Image.fromarray((pixels // 8).astype(np.uint8)).save(folder / "p.pgm")
    (folder / "f.fits.gz").write_bytes(gzip.compress((folder / "f.fits").read_bytes()))
    return {path.name: path.read_bytes() for path in folder.iterdir()}


PARTS = 10**6
"""Places in files are drawn as so many parts of their length."""
_place = st.integers(0, PARTS - 1)


@pytest.mark.long
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    kind=st.sampled_from(["f.fits", "f.fits.fz", "f.fits.gz", "p.png", "p.tif", "p.jpg", "p.pgm"]),
    changed=st.lists(st.tuples(_place, st.integers(0, 255)), max_size=4),
    end=st.none() | _place,
    options=st.sampled_from(["-fov 1", "-extract2 10 -sip", "-tofits -annotate"]),
)
def test_damaged_files_end_with_a_result_that_says_so(
    kind: str,
    changed: list[tuple[int, int]],
    end: int | None,
    options: str,
    whole: dict[str, bytes],
    solver: SolverInProcess,
) -> None:
    content = bytearray(whole[kind])
    for place, value in changed:
        content[place * len(content) // PARTS] = value
    if end is not None:
        del content[end * len(content) // PARTS :]
    Path(kind).write_bytes(content)
    code = run(["-f", kind, *AT, *options.split(), "-wcs", "-update"], LocalHost(), solver)
    assert code in (UNSOLVED, FEW_STARS, NO_IMAGE)
    text = Path(kind).with_suffix(".ini").read_text("ascii")
    assert nina_ini(text) is None
    assert stellarsolver_ini(text) is None
    assert Path(kind).read_bytes() == content
    assert run(["-f", kind, "-analyse", "10"], LocalHost(), solver) in (SOLVED, NO_IMAGE)
