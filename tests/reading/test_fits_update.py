"""WCS cards in FITS files: data and foreign cards stay as they are, astropy reads and believes the rest."""

from __future__ import annotations

import bz2
import gzip
import io
import os
import warnings
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS, FITSFixedWarning
from hypothesis import given
from hypothesis import strategies as st

from mountnav.errors import BadFrame
from mountnav.reading import read_frame
from mountnav.reading.fits_update import fits_of_frame, update_file, updated_fits, wcs_header

CARDS: dict[str, str | int | float] = {
    "WCSAXES": 2,
    "CTYPE1": "RA---TAN-SIP",
    "CTYPE2": "DEC--TAN-SIP",
    "CUNIT1": "deg",
    "CUNIT2": "deg",
    "RADESYS": "ICRS",
    "CRPIX1": 32.5,
    "CRPIX2": 24.5,
    "CRVAL1": 123.45678901234567,
    "CRVAL2": -12.345678901234567,
    "CD1_1": -1.2345678901234567e-4,
    "CD1_2": 1.1e-6,
    "CD2_1": 1.2e-6,
    "CD2_2": 1.2345e-4,
    "IMAGEW": 64,
    "IMAGEH": 48,
    "A_ORDER": 2,
    "B_ORDER": 2,
    "A_2_0": 1.5e-7,
    "B_0_2": -2.5e-7,
}
PIXELS = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64)


def _odd_file() -> bytes:
    """A file with an older plate, and cards that break the standard or are hard to keep."""
    header = fits.Header()
    header["OBJECT"] = ("M 51", "what was meant")
    header["CTYPE1"], header["CRVAL1"], header["CDELT1"], header["CROTA2"] = "RA---TPV", 1.0, 0.1, 12.0
    header["CTYPE2"], header["CRVAL2"], header["CDELT2"], header["PV1_1"] = "DEC--TPV", 2.0, 0.1, 1.0
    header["CRVAL1P"] = (7.0, "of a second WCS")
    header["LONGSTR"] = "long " * 40
    header["HIERARCH ESO TEL ALT"] = (45.5, "altitude")
    header["EQUINOX"] = 2023.5
    header.add_comment("a comment of the camera's program")
    header.add_history("dark subtracted")
    header["PC001001"] = 1.0
    header["AFTER"] = True
    file = io.BytesIO()
    fits.PrimaryHDU(PIXELS, header).writeto(file)
    odd = b"ODD CARD= unquoted text / breaks the standard".ljust(80)
    content = file.getvalue()
    at = content.index(b"AFTER   ")
    # there is room for one more card before END in the last block
    end = content.index(b"END".ljust(80))
    return content[:at] + odd + content[at : end + 80] + content[end + 160 :]


def _cards(content: bytes) -> list[bytes]:
    end = content.index(b"END".ljust(80))
    return [content[at : at + 80] for at in range(0, end, 80)]


def _wcs_of(header: fits.Header) -> WCS:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FITSFixedWarning)
        return WCS(header)


def test_all_but_the_plate_is_kept_card_by_card() -> None:
    before = _odd_file()
    after = updated_fits(before, CARDS, history=["solved by mountnav", "x" * 100, "½ pixel"])
    old = ("CTYPE", "CRVAL1 ", "CRVAL2 ", "CDELT", "CROTA", "PV1_1", "PC001001")
    kept = [card for card in _cards(before) if not card.decode().startswith(old)]
    fresh = [card for card in _cards(after) if card in kept]
    assert fresh == kept
    assert len(_cards(after)) == len(kept) + len(CARDS) - 2 + 4
    assert after[-2880 * 3 :] == before[-2880 * 3 :]
    assert len(after) % 2880 == 0
    header = fits.getheader(io.BytesIO(after))
    assert header["CRVAL1"] == CARDS["CRVAL1"]
    assert "IMAGEW" not in header
    assert list(header["HISTORY"])[-4:] == ["solved by mountnav", "x" * 72, "x" * 28, "? pixel"]
    assert (fits.getdata(io.BytesIO(after)) == PIXELS).all()


def test_astropy_reads_the_same_place_that_the_cards_say() -> None:
    even = _odd_file().replace(b"ODD CARD= unquoted text", b"ODDCARD =             5")
    wcs = _wcs_of(fits.getheader(io.BytesIO(updated_fits(even, CARDS))))
    sky = wcs.all_pix2world([[31.5, 23.5]], 0)[0]
    assert sky == pytest.approx([CARDS["CRVAL1"], CARDS["CRVAL2"]], abs=1e-12)
    assert wcs.sip.a_order == 2


def test_twice_is_as_once_but_for_the_history() -> None:
    once = updated_fits(_odd_file(), CARDS)
    assert updated_fits(once, CARDS) == once


@pytest.mark.parametrize("kind", ["u1", "u2", "i2", "f4", "f8", "i4"])
def test_sums_are_those_that_astropy_checks(kind: str) -> None:
    file = io.BytesIO()
    fits.PrimaryHDU((np.arange(35 * 41) % 251).reshape(35, 41).astype(kind)).writeto(file)
    after = updated_fits(file.getvalue(), CARDS, history=["with sums"], checksum=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with fits.open(io.BytesIO(after), checksum=True) as hdus:
            hdus.verify("exception")
            assert hdus[0].header["CHECKSUM"] != "0" * 16
            assert hdus[0].verify_checksum() == 1
            assert hdus[0].verify_datasum() == 1


@pytest.mark.long
@given(st.binary(min_size=1, max_size=200))
def test_sums_are_right_for_any_data(data: bytes) -> None:
    pixels = np.frombuffer(data, np.uint8).reshape(1, -1)
    with fits.open(io.BytesIO(fits_of_frame(pixels, CARDS)), checksum=False) as hdus:
        assert hdus[0].verify_checksum() == 1
        assert hdus[0].verify_datasum() == 1


def test_sums_that_are_there_are_brought_up_to_date() -> None:
    file = io.BytesIO()
    fits.PrimaryHDU(PIXELS).writeto(file, checksum=True)
    with fits.open(io.BytesIO(updated_fits(file.getvalue(), CARDS))) as hdus:
        assert hdus[0].verify_checksum() == 1
    plain = updated_fits(_odd_file(), CARDS)
    assert b"CHECKSUM" not in plain


def test_a_compressed_image_gets_them_into_the_header_of_its_table() -> None:
    file = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(PIXELS)]).writeto(file, checksum=True)
    before = file.getvalue()
    after = updated_fits(before, CARDS, history=["packed"])
    with fits.open(io.BytesIO(after)) as hdus:
        assert (hdus[1].data == PIXELS).all()
        assert hdus[1].header["CRVAL2"] == CARDS["CRVAL2"]
    with fits.open(io.BytesIO(after), disable_image_compression=True) as hdus:
        assert hdus[1].verify_checksum() == 1
    assert after[:2880] == before[:2880]
    assert after[-2880:] == before[-2880:]


def test_only_the_extension_that_was_solved_is_changed() -> None:
    file = io.BytesIO()
    one, two = fits.ImageHDU(PIXELS, name="SCI"), fits.ImageHDU(PIXELS[::-1], name="SCI2")
    fits.HDUList([fits.PrimaryHDU(), one, two]).writeto(file)
    before = file.getvalue() + b"notes of some program"
    after = updated_fits(before, CARDS, hdu="SCI2")
    assert after.endswith(b"notes of some program")
    with fits.open(io.BytesIO(after), ignore_missing_end=True) as hdus:
        assert "CRVAL1" not in hdus[1].header
        assert hdus[2].header["CRVAL1"] == CARDS["CRVAL1"]
        assert (hdus[2].data == PIXELS[::-1]).all()


@pytest.mark.parametrize("packer", [gzip, bz2])
def test_what_was_packed_as_a_whole_is_packed_again(packer: ModuleType) -> None:
    after = updated_fits(packer.compress(_odd_file()), CARDS)
    assert packer.decompress(after) == updated_fits(_odd_file(), CARDS)


@pytest.mark.long
def test_what_is_no_fits_or_damaged_is_refused() -> None:
    with pytest.raises(BadFrame, match="not a FITS file"):
        updated_fits(b"\x89PNG" + bytes(100), CARDS)
    with pytest.raises(BadFrame, match="damaged"):
        updated_fits(gzip.compress(_odd_file())[:-100], CARDS)
    with pytest.raises(BadFrame, match="no FITS card can hold CD1_1"):
        updated_fits(_odd_file(), CARDS | {"CD1_1": float("nan")})
    with pytest.raises(BadFrame, match="no extension"):
        updated_fits(_odd_file(), CARDS, hdu=4)
    with pytest.raises(BadFrame, match="absurd"):
        updated_fits(gzip.compress(_odd_file() + bytes(100_000_000)), CARDS)


@pytest.mark.parametrize("shape", [(48, 64), (3, 48, 64), (48, 64, 3), (48, 64, 4)])
@pytest.mark.parametrize("kind", ["u1", "u2", "f4"])
def test_a_picture_becomes_a_fits_that_reads_the_same(shape: tuple[int, ...], kind: str) -> None:
    pixels = (np.arange(np.prod(shape)) % 255).reshape(shape).astype(kind)
    content = fits_of_frame(pixels, CARDS, header={"OBJECT": "M 51", "BZERO": 5.0}, history=["a picture"])
    with fits.open(io.BytesIO(content), checksum=True) as hdus:
        hdus.verify("exception")
        data, header = hdus[0].data, hdus[0].header
    wanted = np.moveaxis(pixels[..., :3], 2, 0) if shape[-1] in (3, 4) else pixels
    assert data.dtype == pixels.dtype.newbyteorder("=") or kind == "f4"
    assert (data == wanted).all()
    assert header["OBJECT"] == "M 51"
    assert header["CRVAL1"] == CARDS["CRVAL1"]
    assert read_frame(content).pixels.shape == (48, 64)


def test_pixels_of_no_shape_or_kind_are_refused() -> None:
    for pixels in (np.zeros(5), np.zeros((4, 4), dtype=complex), np.zeros((0, 5)), np.zeros((2, 3, 4, 5))):
        with pytest.raises(BadFrame, match="make no FITS image"):
            fits_of_frame(pixels, CARDS)


def test_a_header_alone_keeps_the_size_and_what_the_frame_said() -> None:
    alone = wcs_header(CARDS)
    assert len(alone) == 2880
    header = fits.Header.fromstring(alone)
    assert (header["NAXIS"], header["IMAGEW"], header["IMAGEH"]) == (0, 64, 48)
    assert _wcs_of(header).wcs.crval[0] == CARDS["CRVAL1"]
    both = wcs_header(CARDS, frame=_odd_file(), history=["solved"])
    header = fits.getheader(io.BytesIO(both))
    assert (header["NAXIS"], header["OBJECT"], header["LONGSTR"]) == (0, "M 51", ("long " * 40).rstrip())
    assert "NAXIS1" not in header
    assert "BZERO" not in header
    assert "CROTA2" not in header


def test_a_file_is_replaced_whole_and_keeps_its_mode(tmp_path: Path) -> None:
    path = tmp_path / "frame.fits"
    path.write_bytes(_odd_file())
    path.chmod(0o640)
    link = tmp_path / "link.fits"
    link.symlink_to(path)
    update_file(link, CARDS, history=["solved"])
    assert link.is_symlink()
    assert path.read_bytes() == updated_fits(_odd_file(), CARDS, history=["solved"])
    assert path.stat().st_mode & 0o777 == 0o640
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["frame.fits", "link.fits"]


def test_a_file_that_is_refused_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "frame.fits"
    path.write_bytes(_odd_file()[:2000])
    with pytest.raises(BadFrame):
        update_file(path, CARDS)
    assert path.read_bytes() == _odd_file()[:2000]
    assert os.listdir(tmp_path) == ["frame.fits"]
