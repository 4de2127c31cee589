"""`solve-field`: its files, its words and its exit codes; what callers read of it is in its own file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from api.solver_commands.host import LocalHost
from api.solver_commands.in_process import SolverInProcess
from api.solver_commands.registry import command
from api.solver_commands.solve_field_options import options_wanted
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.solver_commands.fields import (
    CENTER,
    HEIGHT_PX,
    SCALE_ARCSEC_PX,
    WIDTH_PX,
    call,
    fits_field,
    list_field,
    pixels,
    png_field,
    solver,
)

pytestmark = pytest.mark.filterwarnings("ignore::astropy.wcs.wcs.FITSFixedWarning")

NOT_SOLVED = "Did not solve (or no WCS file was written)."
WIDTH_DEG = WIDTH_PX * SCALE_ARCSEC_PX / 3600.0


def assert_found(out: str, within_deg: float = 3e-5) -> None:
    """The field's center is printed, and is the true one."""
    match = re.search(r"^Field center: \(RA,Dec\) = \((\S+), (\S+)\) deg\.$", out, re.M)
    assert match is not None
    found = Icrs(float(match[1]), float(match[2]))
    assert separation_arcsec(found, CENTER) < 3600.0 * within_deg


def table(path: Path) -> fits.BinTableHDU:
    """The table of a file."""
    with fits.open(path, memmap=False) as opened:
        return opened[1].copy()


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a field and all that is written of it."""
    folder = tmp_path_factory.mktemp("solved")
    fits_field(folder / "m1.fits", pixels())
    code, out, err = call("solve-field", folder / "m1.fits")
    assert (code, err) == (0, "")
    assert_found(out)
    return folder


@pytest.fixture
def field(tmp_path: Path) -> Path:
    """A field without hints."""
    return fits_field(tmp_path / "field.fits", pixels())


def test_all_files_are_there_and_say_the_same(solved: Path) -> None:
    endings = {"-indx.xyls", ".axy", ".corr", ".fits", ".match", ".new", ".rdls", ".solved", ".wcs"}
    assert {path.name for path in solved.iterdir()} == {f"m1{ending}" for ending in endings}
    header = fits.getheader(solved / "m1.wcs")
    assert (header["IMAGEW"], header["IMAGEH"], header["NAXIS"]) == (WIDTH_PX, HEIGHT_PX, 0)
    assert header["EQUINOX"] == 2000.0
    wcs = WCS(header)
    ra, dec = wcs.all_pix2world(*[[0.5 * (WIDTH_PX - 1)], [0.5 * (HEIGHT_PX - 1)]], 0)
    assert float(ra[0]) == pytest.approx(CENTER.ra_deg, abs=3e-5)
    assert float(dec[0]) == pytest.approx(CENTER.dec_deg, abs=3e-5)
    assert (solved / "m1.solved").read_bytes() == b"\x01"
    np.testing.assert_array_equal(fits.getdata(solved / "m1.new"), fits.getdata(solved / "m1.fits"))
    new = fits.getheader(solved / "m1.new")
    assert WCS(new).wcs.crval == pytest.approx(wcs.wcs.crval)
    assert new["DATE-OBS"] == "2026-11-21T19:59:55"


def test_the_tables_have_the_originals_columns_and_agree(solved: Path) -> None:
    axy, rdls, corr, index = (
        table(solved / name) for name in ("m1.axy", "m1.rdls", "m1.corr", "m1-indx.xyls")
    )
    assert axy.columns.names == ["X", "Y", "FLUX", "BACKGROUND"]
    assert axy.columns.formats == ["E"] * 4
    assert (axy.header["IMAGEW"], axy.header["IMAGEH"]) == (WIDTH_PX, HEIGHT_PX)
    assert np.all(np.diff(axy.data["FLUX"]) <= 0.0)
    assert corr.columns.names == [
        "field_x", "field_y", "field_ra", "field_dec", "index_x", "index_y", "index_ra", "index_dec",
        "index_id", "field_id", "match_weight", "FLUX", "BACKGROUND",
    ]  # fmt: skip
    wcs = WCS(fits.getheader(solved / "m1.wcs"))
    ra, dec = wcs.all_pix2world(corr.data["field_x"], corr.data["field_y"], 1)
    np.testing.assert_allclose(ra, corr.data["field_ra"], atol=1e-9)
    np.testing.assert_allclose(dec, corr.data["field_dec"], atol=1e-9)
    x, y = wcs.all_world2pix(corr.data["index_ra"], corr.data["index_dec"], 1)
    np.testing.assert_allclose(x, corr.data["index_x"], atol=1e-3)
    np.testing.assert_allclose(y, corr.data["index_y"], atol=1e-3)
    rows = corr.data["index_id"]
    np.testing.assert_array_equal(rdls.data["RA"][rows], corr.data["index_ra"])
    np.testing.assert_array_equal(index.data["X"][rows], corr.data["index_x"])
    seen = corr.data["field_id"] >= 0
    assert seen.sum() > 20
    assert (
        np.hypot(
            axy.data["X"][corr.data["field_id"][seen]] - corr.data["field_x"][seen],
            axy.data["Y"][corr.data["field_id"][seen]] - corr.data["field_y"][seen],
        ).max()
        < 2.0
    )
    match = table(solved / "m1.match").data[0]
    assert match["NMATCH"] == len(corr.data)
    assert match["CRVAL"] == pytest.approx(wcs.wcs.crval)
    assert match["LOGODDS"] > 20.0


def test_files_are_called_as_asked_or_not_written(field: Path, tmp_path: Path) -> None:
    code, out, _ = call(
        "solve-field", "-p", "-Nnone", "-R", "none", "--match=none", "--corr", "none", "-U", "none", "--axy",
        "none", "-Snone", "-W", tmp_path / "the solution.wcs", field, "--crpix-center", "--keep-xyl",
        "%s.xyls",
    )  # fmt: skip
    assert code == 0
    assert "Plots" not in out
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"field.fits", "the solution.wcs", "field.xyls"}


def test_names_are_made_of_folder_and_base(field: Path, tmp_path: Path) -> None:
    folder = tmp_path / "made" / "out"
    few = ["-p", "-N", "none", "-R", "none", "-M", "none", "-B", "none", "-U", "none", "--temp-axy"]
    assert call("solve-field", *few, "-D", folder, "-o", "n%i", field)[0] == 0
    assert {path.name for path in folder.iterdir()} == {"n1.wcs", "n1.solved"}
    assert call("solve-field", *few, "-o", folder / "base.long.tif", field)[0] == 0
    assert (folder / "base.long.wcs").exists()


def test_without_overwrite_an_output_that_is_there_stays(field: Path, tmp_path: Path) -> None:
    wcs = tmp_path / "field.wcs"
    wcs.write_bytes(b"mine")
    code, out, _ = call("solve-field", field)
    assert code == 0
    assert f'Output file already exists: "{wcs}"' in out
    assert "Field center" not in out
    assert wcs.read_bytes() == b"mine"
    assert call("solve-field", "--continue", field)[0] == 0
    assert wcs.read_bytes() != b"mine"


def test_overwrite_leaves_no_old_solution_of_a_frame_that_fails(tmp_path: Path) -> None:
    noise = np.random.default_rng(3).normal(1000.0, 10.0, (HEIGHT_PX, WIDTH_PX)).astype(np.float32)
    field = fits_field(tmp_path / "noise.fits", noise)
    for ending in ("wcs", "solved", "new", "corr"):
        (tmp_path / f"noise.{ending}").write_bytes(b"old")
    code, out, _ = call("solve-field", "-O", field)
    assert code == 0
    assert NOT_SOLVED in out.splitlines()
    assert "Field center" not in out
    assert {path.name for path in tmp_path.iterdir()} == {"noise.fits", "noise.axy"}


def test_solved_and_canceled_files(field: Path, tmp_path: Path) -> None:
    (tmp_path / "field.solved").write_bytes(b"\x01")
    code, out, _ = call("solve-field", "--skip-solved", field)
    assert (code, "skipping this input file" in out) == (0, True)
    stop = tmp_path / "stop"
    stop.touch()
    code, out, _ = call("solve-field", "-K", "-C", stop, field)
    assert (code, NOT_SOLVED in out) == (0, True)
    code, out, _ = call("solve-field", "-O", "-C", stop, field)
    assert "Field center" in out
    assert not stop.exists()


def test_an_output_never_takes_the_place_of_its_input(tmp_path: Path) -> None:
    field = fits_field(tmp_path / "field.new", pixels())
    before = field.read_bytes()
    code, out, _ = call("solve-field", "-O", field)
    assert (code, "Refusing to continue" in out) == (0, True)
    assert field.read_bytes() == before


@pytest.mark.long
def test_several_files_one_of_them_unreadable(field: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.fits"
    broken.write_bytes(field.read_bytes()[:5000])
    code, out, err = call("solve-field", "-O", broken, tmp_path / "none.fits", field)
    assert code == 255
    assert err.count("solve-field: ") == err.count("\n") == 2
    assert "input file 3 of 3" in out
    assert "Field center" in out
    code, out, _ = call("solve-field", "-O", field, field)
    assert (code, out.count("Field center: (RA,Dec)")) == (0, 2)


def test_a_folder_that_is_not_there_is_an_error_in_one_line(field: Path, tmp_path: Path) -> None:
    code, _, err = call("solve-field", "-W", tmp_path / "no" / "x.wcs", field)
    assert code == 255
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--version"], 0, "0."),
        (["--help"], 0, "Usage: solve-field"),
        ([], 0, "You didn't specify any files"),
        (["--bogus", "x"], 255, "unrecognized option '--bogus'"),
        (["--ra", "north", "x"], 255, "north"),
        (["--ra", "1", "--dec", "91", "x"], 255, "91"),
        (["--parity", "both", "x"], 255, "both"),
        (["-u", "parsec", "x"], 255, "parsec"),
        (["-L", "3", "-H", "2", "x"], 255, "swap"),
    ],
)
def test_words_and_exit_codes_without_a_file(arguments: list[str], code: int, words: str) -> None:
    if arguments[:1] == ["--ra"] and len(arguments) == 3:
        arguments = [*arguments, "--dec", "1"]
    found, out, err = call("solve-field", *arguments)
    assert found == code
    assert words in out + err
    if arguments == ["--version"]:
        assert out.count("\n") == 1


class _Here(LocalHost):
    def __init__(self, given: bytes) -> None:
        self.given = given
        self.printed = ""

    def read_input(self) -> bytes:
        return self.given

    def out(self, text: str) -> None:
        self.printed += text


def test_names_come_from_standard_input(field: Path) -> None:
    host = _Here(f"{field}\n\n".encode())
    assert command("solve-field")(["-O", "-f"], host, solver()) == 0
    assert "Field center" in host.printed


class _GoneAfterTheScale(LocalHost):
    """INDI's driver closes its end as soon as it has read what it wants."""

    def out(self, text: str) -> None:
        if "pixel scale" in text:
            raise BrokenPipeError


def test_a_reader_that_leaves_early_gets_its_files(field: Path, tmp_path: Path) -> None:
    assert command("solve-field")(["-O", str(field)], _GoneAfterTheScale(), solver()) == 0
    assert (tmp_path / "field.solved").exists()


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "solved_within"),
    [
        (["--ra", "83.0", "--dec", "21.5", "--radius", "2"], True),
        (["--ra", "5:32:48", "--dec=+21:24:00", "--radius", "0"], True),
        (["-3", "443.2", "-4", "21.4", "-5", "1"], True),
        (["--ra", "90", "--dec", "21.5", "--radius", "2"], True),
        (["--ra", "90", "--dec", "-21.5"], True),
        (["--ra", "90"], True),
        (["-u", "arcsecperpix", "-L", "9.5", "-H", "10.5"], True),
        (["-u", "app", "-L", "3", "-H", "9"], False),
        (["-u", "app", "-L", "11"], False),
        (["-L", "2", "-H", "2.5"], True),
        (["-L", f"{WIDTH_DEG * 1.1}", "-H", "5"], False),
        (["-u", "amw", "-H", f"{WIDTH_DEG * 60 * 1.05}", "--scale-low=100"], True),
        (["-u", "focalmm", "-L", "900", "-H", "950"], True),
        (["-u", "focalmm", "-L", "100", "-H", "200"], False),
        (["--parity", "pos"], True),
        (["--parity", "neg"], False),
    ],
)
def test_what_is_asked_binds(tmp_path: Path, field: Path, arguments: list[str], solved_within: bool) -> None:
    code, out, err = call("solve-field", "-O", *arguments, field)
    assert (code, err) == (0, "")
    assert ("Field center" in out, NOT_SOLVED in out) == (solved_within, not solved_within)
    assert (tmp_path / "field.wcs").exists() == solved_within
    assert (tmp_path / "field.solved").exists() == solved_within


@pytest.mark.long
def test_a_place_that_is_wrong_is_told_and_the_true_one_found(field: Path) -> None:
    _, out, _ = call("solve-field", "-O", "--ra", "180", "--dec", "-40", "--radius", "2", field)
    assert_found(out)
    assert "A hint was wrong: center: caller says RA 180" in out


@pytest.mark.long
def test_the_headers_hints_bind_nothing_and_are_asked_only_if_wanted(tmp_path: Path) -> None:
    wrong = {"OBJCTRA": "12 00 00", "OBJCTDEC": "-40 00 00", "FOCALLEN": 50.0, "XPIXSZ": 9.0}
    field = fits_field(tmp_path / "field.fits", pixels(), **wrong)
    for arguments in ([], ["--guess-scale"]):
        _, out, _ = call("solve-field", "-O", *arguments, field)
        assert_found(out)


def test_half_a_place_is_none_and_numbers_are_read_as_c_reads_them() -> None:
    _, wanted = options_wanted(["--ra", "12:00:00", "-L", "1.5x", "-H", "abc", "-l", "30s", "-t", "1"])
    assert wanted.center is None
    assert (wanted.scale_low, wanted.scale_high, wanted.cpu_limit_s) == (1.5, None, 30.0)
    assert not wanted.sip
    _, wanted = options_wanted(["--ra", "-10", "--dec", "-0:30:00", "--radius", "nought"])
    assert wanted.center is not None
    assert (wanted.center.ra_deg, wanted.center.dec_deg) == (350.0, -0.5)
    assert wanted.radius_deg is None
    with pytest.raises(BadRequest):
        options_wanted(["--ra", "1e999", "--dec", "0"])


@pytest.mark.long
def test_tan_or_sip_as_asked(tmp_path: Path) -> None:
    drawn = pixels(distortion_px2=2e-8)
    field = fits_field(tmp_path / "field.fits", drawn)
    centers = []
    for arguments, kind in (([], "RA---TAN-SIP"), (["-T"], "RA---TAN")):
        assert call("solve-field", "-O", *arguments, field)[0] == 0
        header = fits.getheader(tmp_path / "field.wcs")
        assert header["CTYPE1"] == kind
        assert ("A_ORDER" in header) == (kind == "RA---TAN-SIP")
        centers.append(WCS(header).all_pix2world([[0.5 * (WIDTH_PX - 1), 0.5 * (HEIGHT_PX - 1)]], 0)[0])
        corr = fits.getdata(tmp_path / "field.corr")
        x, y = WCS(header).all_world2pix(corr["index_ra"], corr["index_dec"], 1)
        np.testing.assert_allclose(x, corr["index_x"], atol=0.01)
        np.testing.assert_allclose(y, corr["index_y"], atol=0.01)
    np.testing.assert_allclose(centers[0], centers[1], atol=1e-9)


@pytest.mark.long
def test_a_picture_becomes_a_new_fits_file(tmp_path: Path) -> None:
    field = png_field(tmp_path / "field.png", pixels())
    assert call("solve-field", "-p", field, "-L", "2", "-H", "3")[0] == 0
    with fits.open(tmp_path / "field.new") as new:
        assert new[0].data.shape == (HEIGHT_PX, WIDTH_PX)
        assert WCS(new[0].header).is_celestial


@pytest.mark.long
def test_a_packed_file_becomes_a_plain_one(tmp_path: Path) -> None:
    import gzip

    plain = fits_field(tmp_path / "plain.fits", pixels()).read_bytes()
    (tmp_path / "field.fits.gz").write_bytes(gzip.compress(plain))
    assert call("solve-field", "-p", tmp_path / "field.fits.gz", "-L", "2", "-H", "3")[0] == 0
    assert (tmp_path / "field.new").read_bytes()[:6] == b"SIMPLE"


@pytest.fixture(scope="module")
def stars(solved: Path) -> np.ndarray:
    """The stars of the field: x, y, flux."""
    data = fits.getdata(solved / "m1.axy")
    return np.column_stack([data["X"], data["Y"], data["FLUX"]]).astype(float)


@pytest.mark.long
def test_lists_of_stars_of_all_callers(tmp_path: Path, stars: np.ndarray) -> None:
    siril = list_field(tmp_path / "siril.xyls", stars)
    code, out, err = call(
        "solve-field", "-C", tmp_path / "stop", "--temp-axy", "-p", "-O", "-N", "none", "-R", "none", "-M",
        "none", "-B", "none", "-U", "none", "-S", "none", "--crpix-center", "-s", "FLUX", "-u",
        "arcsecperpix", "-L", "8.000", "-H", "12.000", "-l", "30", "-t", "3", "--ra", "83.000000", "--dec",
        "21.500000", "--radius", "10.0", siril,
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert_found(out)
    assert {path.name for path in tmp_path.iterdir()} == {"siril.xyls", "siril.wcs"}
    columns = [
        fits.Column(name="X_IMAGE", format="E", array=stars[:, 0]),
        fits.Column(name="Y_IMAGE", format="E", array=stars[:, 1]),
        fits.Column(name="MAG_AUTO", format="E", array=-2.5 * np.log10(np.maximum(stars[:, 2], 1.0))),
    ]
    fits.BinTableHDU.from_columns(columns).writeto(tmp_path / "ekos.xyls")
    code, out, _ = call(
        "solve-field", "--x-column", "X_IMAGE", "--y-column", "Y_IMAGE", "--sort-column", "MAG_AUTO",
        "--sort-ascending", "--width", str(WIDTH_PX), "--height", str(HEIGHT_PX), "-O",
        tmp_path / "ekos.xyls",
    )  # fmt: skip
    assert code == 0
    assert_found(out)
    assert fits.getheader(tmp_path / "ekos.wcs")["IMAGEW"] == WIDTH_PX
    text = "\n".join(f"{x:.3f}\t{y:.3f}" for x, y, _ in stars)
    (tmp_path / "maxima.tbl").write_text(text)
    size = ("-w", str(WIDTH_PX), "-e", str(HEIGHT_PX))
    assert_found(call("solve-field", "-O", *size, tmp_path / "maxima.tbl")[1], 1e-4)
    code, _, err = call("solve-field", "-O", "-s", "NONE", siril)
    assert (code, "there is no column NONE" in err) == (255, True)


def test_a_list_gives_no_new_fits_file_and_its_own_stars(tmp_path: Path, stars: np.ndarray) -> None:
    shuffled = stars[np.random.default_rng(1).permutation(len(stars))]
    field = list_field(tmp_path / "stars.xyls", shuffled)
    assert call("solve-field", field)[0] == 0
    assert not (tmp_path / "stars.new").exists()
    axy, corr = fits.getdata(tmp_path / "stars.axy"), fits.getdata(tmp_path / "stars.corr")
    np.testing.assert_allclose(axy["X"], stars[:, 0], atol=1e-3)
    rows = corr["field_id"]
    assert rows.min() >= 0
    np.testing.assert_allclose(axy["X"][rows], corr["field_x"], atol=1e-3)


@pytest.mark.long
def test_sources_alone(field: Path, tmp_path: Path) -> None:
    assert call("solve-field", "--just-augment", field)[0] == 0
    assert {path.name for path in tmp_path.iterdir()} == {"field.fits", "field.axy"}
    _, out, _ = call("solve-field", "-O", tmp_path / "field.axy", "-o", "again")
    assert_found(out)


@pytest.mark.long
def test_image2xy_and_then_solve_field(field: Path, tmp_path: Path) -> None:
    written = tmp_path / "temp.xy"
    code, out, _ = call("image2xy", "-O", "-o", written, field)
    assert code == 0
    assert out.startswith("simplexy: found ")
    hdu = table(written)
    assert hdu.columns.names == ["X", "Y", "FLUX", "BACKGROUND"]
    assert np.all(np.diff(hdu.data["FLUX"]) <= 0.0)
    _, out, _ = call("solve-field", "-O", written)
    assert_found(out)
    code, _, err = call("image2xy", "-o", written, field)
    assert (code, "is there already" in err) == (255, True)
    assert call("image2xy", field)[0] == 0
    assert (tmp_path / "field.xy.fits").exists()
    assert call("image2xy")[0] == 255
    assert call("image2xy", "-h")[0] == 0
    assert call("image2xy", "--bogus", field)[0] == 0
    assert call("image2xy", tmp_path / "none.fits")[0] == 255


def test_without_an_index_a_frame_is_not_solved_and_that_is_said(field: Path, tmp_path: Path) -> None:
    class Nothing(SolverInProcess):
        def _index(self, catalog: object) -> None:
            return None

    host = _Here(b"")
    assert command("solve-field")(["-O", str(field)], host, Nothing()) == 0
    assert NOT_SOLVED in host.printed
    assert not (tmp_path / "field.wcs").exists()
