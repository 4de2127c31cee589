"""The programs of astrometry.net beside ours, on the same drawn frames."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import half_turn_deg, separation_arcsec
from tests.api.solver_commands import readers
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
)

REAL = {name: shutil.which(name, path="/usr/bin") for name in ("solve-field", "wcsinfo", "image2xy")}
pytestmark = [
    pytest.mark.skipif(None in REAL.values(), reason="astrometry.net is not installed"),
    pytest.mark.skipif(
        not list(Path("/usr/share/astrometry").glob("index-tycho2-1*")),
        reason="its index of Tycho-2 is not installed",
    ),
    pytest.mark.filterwarnings("ignore::astropy.wcs.wcs.FITSFixedWarning"),
]

THEIR_ERROR_PX = 0.3
"""How far their center may lie from the truth: its noise with some 40 stars and a quadratic plate."""


def theirs(name: str, *arguments: str | Path) -> str:
    """Run the real one; what it printed."""
    command = [str(REAL[name]), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=900)
    assert done.returncode == 0, done.stderr
    return str(done.stdout)


def center_px(header: fits.Header, truth: Icrs) -> float:
    """How far a plate's center lies from the truth, pixels."""
    ra, dec = WCS(header).all_pix2world([[0.5 * (WIDTH_PX - 1), 0.5 * (HEIGHT_PX - 1)]], 0)[0]
    return separation_arcsec(Icrs(float(ra), float(dec)), truth) / SCALE_ARCSEC_PX


# each orientation in both parities, every other one as a picture: the original takes 5 to 10 s for each
COMBINATIONS = [
    (45.0 * eighth, parity, "png" if (eighth + (parity > 0)) % 2 else "fits")
    for eighth in range(8)
    for parity in (1, -1)
]


@pytest.mark.long
@pytest.mark.parametrize(("rotation_deg", "parity", "kind"), COMBINATIONS)
def test_both_say_the_same_of_a_frame(tmp_path: Path, rotation_deg: float, parity: int, kind: str) -> None:
    drawn = pixels(rotation_deg, parity)
    field = (png_field if kind == "png" else fits_field)(tmp_path / f"field.{kind}", drawn)
    options = ["-p", "-O", "--crpix-center", "-u", "app", "-L", "9", "-H", "11", "-t", "2"]
    if kind == "png" or rotation_deg > 45.0:  # blind the original may take ten times as long: two are enough
        options += ["-3", str(CENTER.ra_deg), "-4", str(CENTER.dec_deg), "-5", "1"]
    for folder in ("ours", "theirs"):
        (tmp_path / folder).mkdir()
    their_out = theirs("solve-field", *options, "-D", tmp_path / "theirs", field)
    code, our_out, err = call("solve-field", *options, "-D", tmp_path / "ours", field)
    assert (code, err) == (0, "")
    one, other = readers.indi(our_out), readers.indi(their_out)
    assert one is not None
    assert other is not None
    headers = [fits.getheader(tmp_path / folder / "field.wcs") for folder in ("ours", "theirs")]
    ours_off, theirs_off = (center_px(header, CENTER) for header in headers)
    assert ours_off < min(theirs_off + 0.01, 0.1)
    assert theirs_off < THEIR_ERROR_PX
    print(f"center off by: ours {ours_off:.4f} px, theirs {theirs_off:.4f} px")
    # of a quadratic plate the matrix at the center is known less well than the place
    assert one.scale_arcsec_px == pytest.approx(other.scale_arcsec_px, rel=5e-3)
    assert one.orientation_deg is not None
    assert other.orientation_deg is not None
    assert half_turn_deg(one.orientation_deg - other.orientation_deg) == pytest.approx(0.0, abs=0.1)
    for pattern in (r"^Field parity: (\w+)$", r"^Field size: \S+ x \S+ (\w+)$"):
        told = [re.search(pattern, out, re.M) for out in (our_out, their_out)]
        assert told[0] is not None
        assert told[1] is not None
        assert told[0][1] == told[1][1]


@pytest.mark.long
def test_their_wcsinfo_of_our_plate_says_what_ours_says(tmp_path: Path) -> None:
    for distortion in (0.0, 2e-8):
        field = fits_field(tmp_path / "field.fits", pixels(distortion_px2=distortion))
        assert call("solve-field", "-p", "-O", field)[0] == 0
        wcs = tmp_path / "field.wcs"
        ours = dict(line.split(" ", 1) for line in call("wcsinfo", wcs)[1].splitlines())
        other = dict(line.split(" ", 1) for line in theirs("wcsinfo", wcs).splitlines())
        readers.assert_same_wcsinfo(ours, other)


@pytest.mark.long
def test_each_reads_the_others_lists_and_has_the_same_columns(tmp_path: Path) -> None:
    field = fits_field(tmp_path / "field.fits", pixels())
    theirs("image2xy", "-O", "-o", tmp_path / "theirs.xy", field)
    assert call("image2xy", "-O", "-o", tmp_path / "ours.xy", field)[0] == 0
    places = []
    for name in ("theirs", "ours"):
        with fits.open(tmp_path / f"{name}.xy") as opened:
            data, header = opened[1].data, opened[1].header
            assert opened[1].columns.names == ["X", "Y", "FLUX", "BACKGROUND"]
            assert (header["IMAGEW"], header["IMAGEH"]) == (WIDTH_PX, HEIGHT_PX)
            places.append(np.column_stack([data["X"], data["Y"]]).astype(float)[np.argsort(-data["FLUX"])])
    # the bright stars of one are those of the other, at the same places: both count from 1
    off = [np.hypot(*(places[1] - place).T).min() for place in places[0][:50]]
    assert np.median(off) < 0.2
    options = ("-p", "-O", "-u", "app", "-L", "9", "-H", "11")
    assert readers.indi(call("solve-field", *options, tmp_path / "theirs.xy")[1]) is not None
    assert readers.indi(theirs("solve-field", *options, tmp_path / "ours.xy")) is not None
    assert call("solve-field", *options, field)[0] == 0
    assert readers.indi(theirs("solve-field", *options, "-o", "again", tmp_path / "field.axy")) is not None


@pytest.mark.long
def test_the_tables_have_their_columns(tmp_path: Path) -> None:
    field = fits_field(tmp_path / "field.fits", pixels())
    for folder in ("ours", "theirs"):
        (tmp_path / folder).mkdir()
    options = ("-p", "-O", "-u", "app", "-L", "9", "-H", "11")
    theirs("solve-field", *options, "-D", tmp_path / "theirs", field)
    assert call("solve-field", *options, "-D", tmp_path / "ours", field)[0] == 0
    assert {path.name for path in (tmp_path / "ours").iterdir()} == {
        path.name for path in (tmp_path / "theirs").iterdir()
    }
    for name in ("field.axy", "field.corr", "field.match", "field.rdls", "field-indx.xyls"):
        with fits.open(tmp_path / "ours" / name) as one, fits.open(tmp_path / "theirs" / name) as other:
            ours = dict(zip(one[1].columns.names, one[1].columns.formats, strict=True))
            for column, form in zip(other[1].columns.names, other[1].columns.formats, strict=True):
                assert ours[column].removeprefix("1") == form.removeprefix("1"), (name, column)
    assert (tmp_path / "ours" / "field.solved").read_bytes() == (
        tmp_path / "theirs" / "field.solved"
    ).read_bytes()


def test_all_their_options_are_known(tmp_path: Path) -> None:
    from api.solver_commands.solve_field_options import OPTIONS

    told = theirs("solve-field", "--help")
    known = {option.name: option for option in OPTIONS}
    found = re.findall(r"^  (?:-(\S) / )?--([a-z0-9-]+)( <)?", told, re.M)
    assert len(found) > 80
    for letter, name, value in found:
        assert name in known
        assert not letter or known[name].letter == letter, name
        assert known[name].value == ("needed" if value else "none"), name


@pytest.mark.long
@pytest.mark.parametrize(("parity", "solved"), [("pos", True), ("neg", False)])
def test_the_parity_binds_as_theirs_does(tmp_path: Path, parity: str, solved: bool) -> None:
    field = fits_field(tmp_path / "field.fits", pixels())
    place = ("--ra", "83", "--dec", "21.5", "--radius", "3")
    options = ("-p", "-O", "-l", "2", "-d", "1-30", *place, "-u", "app", "-L", "9", "-H", "11")
    for out in (
        theirs("solve-field", *options, "--parity", parity, field),
        call("solve-field", *options, "--parity", parity, field)[1],
    ):
        assert (readers.siril(out, tmp_path / "field.wcs") is not None) == solved
        assert ("Did not solve (or no WCS file was written)." in out.splitlines()) == (not solved)


@pytest.mark.long
def test_a_list_upside_down_is_the_mirrored_sky_to_both(tmp_path: Path) -> None:
    field = fits_field(tmp_path / "field.fits", pixels())
    assert call("solve-field", "--just-augment", field)[0] == 0
    data = fits.getdata(tmp_path / "field.axy")
    stars = np.column_stack([data["X"], HEIGHT_PX + 1 - data["Y"], data["FLUX"]]).astype(float)[:300]
    turned = list_field(tmp_path / "turned.xyls", stars)
    options = ("-p", "-O", "-u", "app", "-L", "9", "-H", "11")
    for out in (theirs("solve-field", *options, turned), call("solve-field", *options, turned)[1]):
        found = readers.indi(out)
        assert found is not None
        assert separation_arcsec(Icrs(found.ra_deg, found.dec_deg), CENTER) < 0.5 * SCALE_ARCSEC_PX
        assert "Field parity: neg" in out
