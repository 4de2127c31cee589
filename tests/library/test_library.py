"""`import mountnav as mn`: what goes in, what comes out, and what is refused."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.nddata import CCDData

import mountnav as mn
from mountnav.errors import BadFrame, BadRequest, BadSettings
from mountnav.library.images import read


def test_importing_the_library_imports_nothing_heavy() -> None:
    code = (
        "import mountnav, sys; print(sorted({'numpy', 'astropy', 'scipy', 'matplotlib'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


def test_every_public_name_is_there_and_no_other() -> None:
    for name in mn.__all__:
        assert getattr(mn, name) is not None
    assert set(mn.__all__) <= set(dir(mn))
    with pytest.raises(AttributeError, match="no attribute 'slove'"):
        _ = mn.slove


@pytest.fixture(scope="module")
def rendered(shared: Path) -> Path:
    return shared / "data" / "rendered" / "E00.fits.fz"


@pytest.fixture(scope="module")
def solved(rendered: Path) -> mn.SolvedFrame:
    return mn.solve(rendered)


@pytest.mark.shared
def test_all_kinds_of_images_are_solved_alike(rendered: Path, solved: mn.SolvedFrame) -> None:
    with fits.open(rendered) as hdus:
        image = next(one for one in hdus if one.header.get("NAXIS", 0) == 2 and one.data is not None)
        data, header = np.array(image.data), image.header.copy()
        for given in (hdus, image, CCDData(data, unit="adu", header=header), fits.PrimaryHDU(data, header)):
            again = mn.solve(given)
            assert again.center.separation(solved.center).arcsec < 0.01
    plain = mn.solve(data, center=solved.center, radius_deg=1.0, scale_arcsec_px=solved.scale_arcsec_px)
    # without its date the frame's stars are where they are today
    assert plain.center.separation(solved.center).arcsec < 2.0


@pytest.mark.shared
def test_the_wcs_of_astropy_and_ours_agree(solved: mn.SolvedFrame) -> None:
    for x, y in ((0.0, 0.0), (100.5, 37.25), (solved.frame.width_px - 1.0, 11.0)):
        ours, theirs = solved.position_of(x, y), solved.wcs.pixel_to_world(x, y)
        assert ours.separation(theirs).arcsec < 1e-3
        assert np.hypot(*np.subtract(solved.pixel_of(ours), (x, y))) < 0.02


@pytest.mark.shared
def test_residuals_point_from_the_catalog_to_the_measurement(solved: mn.SolvedFrame) -> None:
    stars = solved.stars[solved.stars["used"]]
    x, y = solved.wcs.world_to_pixel(SkyCoord(stars["ra"], stars["dec"]))
    dx, dy = solved._residuals_px()
    used = solved.solution.identified.used
    assert np.allclose(stars["x"].value - x, dx[used], atol=0.02)
    assert np.allclose(stars["y"].value - y, dy[used], atol=0.02)


@pytest.mark.shared
def test_a_solved_frame_tells_itself_in_text_and_html(solved: mn.SolvedFrame) -> None:
    assert "stars, rms" in repr(solved)
    assert "<table>" in solved._repr_html_()
    assert "odds of a mistake" in solved._repr_html_()


def test_what_is_no_image_is_refused() -> None:
    with pytest.raises(BadFrame):
        mn.read(np.zeros(7))
    with pytest.raises(BadFrame):
        mn.read(fits.HDUList([fits.PrimaryHDU()]))
    with pytest.raises(BadFrame):
        mn.read(fits.PrimaryHDU())


def test_frames_are_read_once() -> None:
    frame = mn.Frame(np.zeros((20, 20)))
    assert read(frame) is frame


@pytest.mark.parametrize("scale", [0.0, -1.0, (2.0, 1.0), float("nan")])
def test_senseless_scales_are_refused(scale: float | tuple[float, float]) -> None:
    with pytest.raises(BadRequest, match="scale_arcsec_px"):
        mn.solve(np.zeros((64, 64)), scale_arcsec_px=scale)


def test_a_field_without_stars_is_refused_with_the_reason() -> None:
    noise = np.random.default_rng(3).normal(1000.0, 10.0, (200, 200))
    with pytest.raises(mn.SolveFailed) as refused:
        mn.solve(noise, blind=False)
    assert refused.value.reason


def test_cones_are_moved_to_their_epoch() -> None:
    barnard = SkyCoord("17h57m48.5s +04d41m36s")
    then, now = (mn.cone(barnard, 0.5, at=year, mag_limit=10.0) for year in (2000.0, 2025.0))
    fastest = int(np.argmax(np.hypot(now["pm_ra_cosdec"], now["pm_dec"])))
    moved = SkyCoord(now["ra"][fastest], now["dec"][fastest], unit="deg")
    nearest = moved.separation(SkyCoord(then["ra"], then["dec"])).arcsec.min()
    assert 250 < nearest < 270  # 10.4″ a year


@pytest.mark.parametrize("radius", [0.0, -1.0, 91.0])
def test_senseless_cones_are_refused(radius: float) -> None:
    with pytest.raises(BadRequest, match="radius_deg"):
        mn.cone(mn.Icrs(10.0, 20.0), radius)


def test_a_fake_mount_is_slewed_by_a_script() -> None:
    async def there(url: str) -> str:
        async with mn.open_mount(url) as mount:
            reading = await mount.reading()
            return type(reading.place).__name__

    with mn.fake_mount("nexstar") as url:
        assert asyncio.run(there(url)) in ("Apparent", "Icrs")


def test_a_script_that_breaks_off_leaves_no_slew_behind() -> None:
    async def broken_off(url: str) -> None:
        async with mn.open_mount(url) as mount:
            place = (await mount.reading()).place
            assert isinstance(place, mn.Apparent)
            away = mn.Apparent((place.ra_deg + 60.0) % 360.0, 0.3 * place.dec_deg, place.utc)
            slew = asyncio.ensure_future(mount.slew(away))
            while not (await mount.reading()).slewing:
                assert not slew.done()
            raise ValueError("the script is wrong")

    async def slews(url: str) -> bool | None:
        async with mn.open_mount(url) as mount:
            return (await mount.reading()).slewing

    with mn.fake_mount("lx200", "onstep") as url:
        with pytest.raises(ValueError, match="the script"):
            asyncio.run(broken_off(url))
        assert asyncio.run(slews(url)) is False


def test_fakes_and_urls_that_are_none_are_refused() -> None:
    with pytest.raises(BadRequest, match="no fake"), mn.fake_mount("nonsense"):
        pass

    async def opened() -> None:
        async with mn.open_mount("nonsense://"):
            pass

    with pytest.raises(BadSettings):
        asyncio.run(opened())


def test_observations_need_a_site() -> None:
    with pytest.raises(BadRequest, match="site"):
        mn.fit_pointing([])
