"""The comparison of solvers: what it draws, how it measures a command, what it counts as right."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.wcs import WCS

from benchmarks.peers.astap import Astap
from benchmarks.peers.astap_stars import RING_AREAS, ring_tops_deg, write_database
from benchmarks.peers.drawing import PRESETS, Preset, drawn, hint_near
from benchmarks.peers.running import Attempt, Found, Job, run
from benchmarks.peers.solve_field import SolveField
from benchmarks.peers.table import Done, rows
from benchmarks.peers.wcs_files import claimed
from benchmarks.solve import main
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Stars
from mountnav.frames import Hint
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec

SMALL = Preset(900, 800, 6.0, 20.0, (30, 40), 5, (2.2, 2.6), (1e-10, 2e-10), (100, 200))


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setitem(PRESETS, "S", SMALL)


def job(**changes) -> Job:
    told = Job("one", "S", Path("one.fits"), 900, 800, Icrs(100.0, 20.0), 6.0, Hint())
    return replace(told, **changes)


class Region:
    """The catalog as if the sky ended 12° from a place."""

    name = "region"

    def __init__(self, center: Icrs) -> None:
        self._center = center

    def cone(self, center, radius_deg, *, epoch_yr, mag_limit=None) -> Stars:
        if radius_deg > 90:
            return embedded_catalog().cone(self._center, 12.0, epoch_yr=epoch_yr)
        return embedded_catalog().cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)


@pytest.mark.long
def test_a_frame_is_drawn_solved_and_told_and_nothing_is_left(small, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    code = main(["--preset", "S", "--frames", "1", "--hinted", "--peers", "resident"])
    lines = capsys.readouterr().out.splitlines()
    cells = [cell.strip() for cell in lines[-1].split("|")[1:-1]]
    assert code == 0
    assert len(lines) == 3
    assert cells[:5] == ["S", "hinted", "mountnav resident", "1/1", "0"]
    assert float(cells[5]) > 0.0
    assert float(cells[6]) == 1.0
    assert float(cells[-1]) < 0.1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_solve_field_and_astap_find_a_drawn_frame(small, tmp_path):
    here = [one for one in (SolveField, Astap) if not one.missing()]
    if not here:
        pytest.skip("neither solve-field nor astap_cli is installed")
    one = drawn("S", 1, 3, embedded_catalog(), tmp_path)
    assert one.center is not None
    for kind in here:
        solver = SolveField(tmp_path) if kind is SolveField else Astap(tmp_path, Region(one.center))
        attempt = solver.solve(one, blind=False)
        error = attempt.error_px(one)
        assert error is not None, f"{solver.name}: {attempt.note}"
        assert error < 2.0
        assert not attempt.wrong(one)
        assert attempt.cpu_s > 0.0


def test_the_same_number_draws_the_same_frame_and_the_file_gives_no_place_away(small, tmp_path):
    files = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        files.append(drawn("S", 0, 9, embedded_catalog(), folder).path)
    assert files[0].read_bytes() == files[1].read_bytes()
    header = fits.getheader(files[0])
    told = {"SIMPLE", "BITPIX", "NAXIS", "NAXIS1", "NAXIS2", "BSCALE", "BZERO", "DATE-OBS", "EXPTIME"}
    assert set(header) <= told
    assert header["BITPIX"] == 16
    assert header["BZERO"] == 32768


def test_fields_for_few_stars_hold_few_stars(tmp_path):
    one = drawn("E", 1, 5, embedded_catalog(), tmp_path)
    assert 7 <= one.catalog_stars <= 16


def test_hints_are_off_by_no_more_than_they_say():
    rng = np.random.default_rng(8)
    center = Icrs(359.9, 71.0)
    off = []
    for _ in range(200):
        hint = hint_near(center, 2.0, rng)
        assert hint.center is not None
        assert hint.scale_low_arcsec_px is not None
        assert hint.scale_high_arcsec_px is not None
        assert hint.scale_low_arcsec_px < 2.0 < hint.scale_high_arcsec_px
        off.append(separation_arcsec(hint.center, center) / 3600)
    assert max(off) <= 1.0
    assert max(off) > 0.9


@pytest.mark.long
def test_a_command_is_measured_with_what_it_starts(tmp_path):
    burn = "import time\nwhile time.process_time() < 0.4: pass"
    inner = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {burn!r}]); print('done')"
    ran = run([sys.executable, "-c", inner], tmp_path, limit_s=60)
    assert ran.status == 0
    assert not ran.late
    assert ran.output == "done\n"
    assert ran.cpu_s >= 0.4
    # this process holds far more than a bare interpreter, and none of it is counted
    assert 1.0 < ran.peak_mb < 40.0


def test_a_command_that_needs_too_long_is_ended_with_what_it_started(tmp_path):
    ran = run(["sh", "-c", "sleep 60 & echo $!; wait"], tmp_path, limit_s=1)
    assert ran.late
    status = Path("/proc", ran.output.strip(), "status")
    for _ in range(50):
        # ended, though its new parent may not have taken notice yet
        if not status.exists() or "State:\tZ" in status.read_text():
            break
        time.sleep(0.1)
    else:
        pytest.fail("what the command started is still running")


@pytest.mark.parametrize(
    ("off_arcsec", "scale", "wrong"),
    [(0.0, 6.0, False), (17.0, 6.0, False), (19.0, 6.0, True), (0.0, 6.05, False), (0.0, 6.07, True)],
)
def test_wrong_is_more_than_three_pixels_or_one_percent(off_arcsec, scale, wrong):
    one = job()
    assert one.center is not None
    attempt = Attempt(Found(displaced(one.center, off_arcsec, 0.0), scale), 1.0, 1.0, 1.0)
    assert attempt.wrong(one) is wrong


def test_any_answer_to_a_frame_without_sky_is_wrong():
    attempt = Attempt(Found(Icrs(1.0, 2.0), 6.0), 1.0, 1.0, 1.0)
    assert attempt.wrong(job(center=None, scale_arcsec_px=None))
    assert not Attempt(None, 1.0, 1.0, 1.0).wrong(job(center=None))


def test_the_table_counts_right_and_wrong_and_compares_with_the_resident():
    one = job()
    assert one.center is not None
    right, false = Found(one.center, 6.0), Found(Icrs(10.0, 0.0), 6.0)
    done = [
        Done(one, False, name, Attempt(found, cpu_s, 2 * cpu_s, 50.0))
        for name, found, cpu_s in (
            ("mountnav resident", right, 0.1),
            ("other", right, 0.4),
            ("other", false, 0.5),
            ("other", None, 0.6),
        )
    ]
    ours, theirs = ([cell.strip() for cell in line.split("|")[1:-1]] for line in rows(done)[2:])
    assert ours[3:7] == ["1/1", "0", "0.100", "1.0"]
    assert theirs[3:8] == ["1/3", "1", "0.500", "5.0", "1.000"]


def test_the_claimed_center_is_that_of_the_frame_with_its_distortion():
    header = fits.Header()
    header["NAXIS1"], header["NAXIS2"] = 1000, 700
    header["CTYPE1"], header["CTYPE2"] = "RA---TAN-SIP", "DEC--TAN-SIP"
    header["CRPIX1"], header["CRPIX2"], header["CRVAL1"], header["CRVAL2"] = 100.0, 80.0, 359.9, 60.0
    header["CD1_1"], header["CD1_2"], header["CD2_1"], header["CD2_2"] = -0.001, 0.0, 0.0, 0.001
    header["A_ORDER"], header["B_ORDER"], header["A_2_0"], header["B_0_2"] = 2, 2, 2e-5, -1e-5
    found = claimed(header, 1000, 700)
    assert found is not None
    there = SkyCoord(WCS(header).pixel_to_world(499.5, 349.5))
    assert separation_arcsec(found.center, Icrs(there.ra.deg, there.dec.deg)) < 1e-3
    # 400 px from the reference point the quadratic terms stretch x by 1.6 % and shrink y by 0.5 %
    assert found.scale_arcsec_px == pytest.approx(3.6 * np.sqrt(1.01602 * 0.99459), rel=2e-3)


@pytest.mark.long
def test_the_star_database_for_astap_holds_every_star_in_its_area(tmp_path):
    center = Icrs(10.0, 65.0)
    count = write_database(Region(center), tmp_path, epoch_yr=2026.0)
    files = sorted(tmp_path.iterdir())
    assert len(files) == sum(RING_AREAS) == 290
    places, mags = [], []
    tops = ring_tops_deg()
    for path in files:
        ring, part = int(path.stem[-4:-2]) - 1, int(path.stem[-2:]) - 1
        content = path.read_bytes()
        assert content[109] == 5
        upper, mag, last = 0, 0.0, -99.0
        for start in range(110, len(content), 5):
            a, b, c, d, e = content[start : start + 5]
            if (a, b, c) == (255, 255, 255):
                upper, mag = d - 128, (e - 16) / 10
                assert mag >= last
                last = mag
                continue
            ra = (a + 256 * b + 65536 * c) * 360.0 / (256**3 - 1)
            dec = (65536 * upper + 256 * e + d) * 90.0 / (128 * 256**2 - 1)
            assert (tops[ring - 1] if ring else -90.0) - 1e-5 <= dec <= tops[ring] + 1e-5
            assert abs(ra - (part + 0.5) * 360 / RING_AREAS[ring]) <= 180 / RING_AREAS[ring] + 1e-4
            places.append((ra, dec))
            mags.append(mag)
    stars = embedded_catalog().cone(center, 12.0, epoch_yr=2026.0)
    assert len(places) == count == len(stars)
    written, true = np.array(sorted(places, key=lambda one: one[1])), np.sort(stars.dec_deg)
    assert np.abs(written[:, 1] - true).max() < 2e-5
    assert np.sort(mags) == pytest.approx(np.sort(stars.mag), abs=0.051, nan_ok=True)
