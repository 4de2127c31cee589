"""Drawn frames: stars fall where an independent WCS puts them, noise and header are what they claim."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from astropy.wcs import WCS

from mountnav.catalog.stars import Stars
from mountnav.errors import BadSettings
from mountnav.frames import Frame
from mountnav.simulation.faint_stars import faint_stars
from mountnav.simulation.optics import PRESETS, SimulatedOptics, optics_preset
from mountnav.simulation.render import draw_frame, project
from mountnav.sky.coordinates import Icrs
from mountnav.units import julian_year

WHEN = datetime(2026, 11, 21, 22, tzinfo=UTC)
CENTER = Icrs(211.3, 54.2)
SMALL = SimulatedOptics(640, 480, 6.0, fwhm_px=3.0, sky_adu_s=5.0)


@dataclass
class MemoryCatalog:
    """A few stars round a place, moved by their proper motions from J2000."""

    ra_deg: np.ndarray
    dec_deg: np.ndarray
    mag: np.ndarray
    pm_ra: np.ndarray
    pm_dec: np.ndarray
    name: str = "memory"

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        years = (epoch_yr - 2000.0) / 3.6e6
        order = np.argsort(self.mag)
        ra = self.ra_deg + self.pm_ra * years / np.cos(np.radians(self.dec_deg))
        dec = self.dec_deg + self.pm_dec * years
        return Stars(
            ra[order],
            dec[order],
            np.full(ra.size, 0.01),
            self.mag[order],
            self.pm_ra[order],
            self.pm_dec[order],
            epoch_yr,
            "V",
            self.name,
        )


def one_star(place: Icrs, mag: float) -> MemoryCatalog:
    still = np.zeros(1)
    return MemoryCatalog(np.array([place.ra_deg]), np.array([place.dec_deg]), np.array([mag]), still, still)


NOTHING = MemoryCatalog(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0))


def catalog_round(center: Icrs, *, n: int = 25, spread_deg: float = 0.6, pm: float = 0.0) -> MemoryCatalog:
    """Make `n` stars evenly strewn round a place (on a jittered grid, so that none are blended)."""
    rng = np.random.default_rng(3)
    side = int(np.ceil(np.sqrt(n)))
    gx, gy = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    step = 2.0 / side
    east = (gx.ravel()[:n] + rng.uniform(-0.2, 0.2, n) * step) * spread_deg
    north = (gy.ravel()[:n] + rng.uniform(-0.2, 0.2, n) * step) * spread_deg
    dec = center.dec_deg + north
    ra = (center.ra_deg + east / np.cos(np.radians(dec))) % 360.0
    return MemoryCatalog(ra, dec, rng.uniform(7.0, 9.0, n), np.full(n, pm), np.full(n, -pm))


def drawn(optics: SimulatedOptics, catalog: MemoryCatalog, center: Icrs = CENTER, **changes) -> Frame:
    settings: dict[str, Any] = {"exposure_s": 2.0, "mid_exposure_utc": WHEN, "seed": 5} | changes
    return draw_frame(center, optics, catalog, **settings)


def wcs_of(center: Icrs, optics: SimulatedOptics) -> WCS:
    """Make the WCS from the words of the contract: CD from the image's axes as seen on the sky."""
    angle = math.radians(optics.rotation_deg)
    up = np.array([math.sin(angle), math.cos(angle)])  # (east, north) of +y
    right = optics.parity * np.array([-math.cos(angle), math.sin(angle)])
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval = [center.ra_deg, center.dec_deg]
    wcs.wcs.crpix = [(optics.width_px + 1) / 2, (optics.height_px + 1) / 2]
    wcs.wcs.cd = np.column_stack([right, up]) * optics.scale_arcsec_px / 3600.0
    return wcs


def centroid(frame: Frame, x: float, y: float, reach: int = 8) -> tuple[float, float]:
    column, row = round(x), round(y)
    rows, columns = np.mgrid[row - reach : row + reach + 1, column - reach : column + reach + 1]
    pixels = frame.pixels.astype(float)
    stamp = pixels[rows, columns] - np.median(pixels)
    weight = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 8.0)
    for _ in range(30):  # weighted centroid, moved until it stands
        total = (stamp * weight).sum()
        cx, cy = (stamp * weight * columns).sum() / total, (stamp * weight * rows).sum() / total
        weight = np.exp(-((columns - cx) ** 2 + (rows - cy) ** 2) / 8.0)
    return cx, cy


@pytest.mark.long
@pytest.mark.parametrize("parity", [1, -1])
@pytest.mark.parametrize("rotation_deg", [0.0, 37.0, 90.0, 201.5, 359.0])
def test_stars_fall_where_astropy_puts_them(parity: int, rotation_deg: float) -> None:
    optics = replace(SMALL, parity=parity, rotation_deg=rotation_deg)
    catalog = catalog_round(CENTER, spread_deg=0.35)
    frame = drawn(optics, catalog)
    assert frame.pixels.shape == (480, 640)
    checked = 0
    pixels = wcs_of(CENTER, optics).all_world2pix(catalog.ra_deg, catalog.dec_deg, 0)
    for x, y in zip(*pixels, strict=True):
        if 12 < x < 627 and 12 < y < 467:
            assert centroid(frame, x, y) == pytest.approx((x, y), abs=0.05)
            checked += 1
    assert checked >= 15


def test_with_north_up_east_is_left_and_row_0_is_the_bottom() -> None:
    for place, brighter in ((Icrs(CENTER.ra_deg, CENTER.dec_deg + 0.2), "top"), (Icrs(211.5, 54.2), "left")):
        star = one_star(place, 8.0)
        row, column = np.unravel_index(drawn(SMALL, star).pixels.argmax(), (480, 640))
        assert row > 300 if brighter == "top" else column < 280


def test_stars_stand_at_the_epoch_of_date() -> None:
    catalog = catalog_round(CENTER, spread_deg=0.35, pm=20_000.0)
    years = julian_year(WHEN) - 2000.0
    assert years == pytest.approx(26.89, abs=0.01)
    moved = catalog.cone(CENTER, 1.0, epoch_yr=julian_year(WHEN))
    wcs = wcs_of(CENTER, SMALL)
    x, y = wcs.all_world2pix(moved.ra_deg, moved.dec_deg, 0)
    old_x, old_y = wcs.all_world2pix(catalog.ra_deg, catalog.dec_deg, 0)
    assert math.hypot(np.mean(x) - old_x.mean(), np.mean(y) - old_y.mean()) > 50.0
    frame = drawn(SMALL, catalog)
    inside = (x > 12) & (x < 627) & (y > 12) & (y < 467)
    assert inside.sum() > 8
    for a, b in zip(x[inside], y[inside], strict=True):
        assert centroid(frame, a, b) == pytest.approx((a, b), abs=0.05)


def test_distortion_is_cubic_and_radial() -> None:
    bent = replace(SMALL, distortion_px2=2e-7)
    catalog = catalog_round(CENTER)
    x, y = project(CENTER, SMALL, catalog.ra_deg, catalog.dec_deg)
    xd, yd = project(CENTER, bent, catalog.ra_deg, catalog.dec_deg)
    r, rd = np.hypot(x - 319.5, y - 239.5), np.hypot(xd - 319.5, yd - 239.5)
    assert rd == pytest.approx(r * (1 + 2e-7 * r**2))
    assert np.arctan2(yd - 239.5, xd - 319.5) == pytest.approx(np.arctan2(y - 239.5, x - 319.5))


def test_across_ra_zero_and_round_the_pole() -> None:
    for center in (Icrs(0.01, 5.0), Icrs(100.0, 89.9), Icrs(10.0, -89.95)):
        catalog = MemoryCatalog(
            np.array([359.9, 0.1, 190.0]),
            np.array([5.1, center.dec_deg, center.dec_deg]),
            mag=np.full(3, 8.0),
            pm_ra=np.zeros(3),
            pm_dec=np.zeros(3),
        )
        frame = drawn(SMALL, catalog, center)
        x, y = wcs_of(center, SMALL).all_world2pix([0.1], [center.dec_deg], 0)
        assert centroid(frame, x[0], y[0]) == pytest.approx((x[0], y[0]), abs=0.05)


def test_flux_sky_noise_and_saturation() -> None:
    star = one_star(CENTER, 9.0)
    frame = drawn(SMALL, star, exposure_s=4.0)
    light = frame.pixels.astype(float)
    sky = SMALL.bias_adu + 4.0 * SMALL.sky_adu_s
    corner = light[:150]
    assert corner.mean() == pytest.approx(sky, abs=0.2)
    expected_noise = math.hypot(math.sqrt(20.0 / SMALL.gain_e_adu), SMALL.read_noise_adu)
    assert corner.std() == pytest.approx(expected_noise, rel=0.02)
    flux = (light[220:260, 300:340] - sky).sum()
    assert flux == pytest.approx(4.0 * 10 ** (0.4 * (SMALL.zero_point_mag - 9.0)), rel=0.01)
    for bits in (16, 12):
        full = drawn(replace(SMALL, bits=bits), replace(star, mag=np.array([2.0])))
        assert full.pixels.dtype == np.uint16
        assert full.pixels.max() == full.saturation_adu == 2**bits - 1


def test_same_seed_same_frame() -> None:
    catalog = catalog_round(CENTER)
    first, again, other = (drawn(SMALL, catalog, seed=seed).pixels for seed in ((1, 2), (1, 2), (1, 3)))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_an_empty_sky_is_drawn() -> None:
    nothing = NOTHING
    assert drawn(SMALL, nothing).pixels.std() < 10.0


def test_faint_stars_keep_their_places() -> None:
    ra, dec, mag = faint_stars(CENTER, 0.5, 200.0, 12.0)
    shifted = faint_stars(Icrs(CENTER.ra_deg + 0.4, CENTER.dec_deg), 0.5, 200.0, 12.0)
    near = np.hypot((ra - CENTER.ra_deg) * math.cos(math.radians(CENTER.dec_deg)), dec - CENTER.dec_deg) < 0.5
    places = set(zip(*shifted[:2], strict=True))
    both = [place in places for place in zip(ra[near], dec[near], strict=True)]
    assert near.sum() == pytest.approx(200.0 * math.pi * 0.25, rel=0.25)
    assert all(both)
    assert mag.min() >= 12.0
    assert mag.max() <= 16.0
    nothing = NOTHING
    with_faint = drawn(replace(SMALL, faint_stars_deg2=200.0), nothing, exposure_s=20.0)
    assert with_faint.pixels.max() > drawn(SMALL, nothing, exposure_s=20.0).pixels.max() + 100


def test_header_and_hint() -> None:
    frame = drawn(SMALL, catalog_round(CENTER), exposure_s=3.0)
    start = datetime.fromisoformat(str(frame.header["DATE-OBS"])).replace(tzinfo=UTC)
    assert start + timedelta(seconds=1.5) == WHEN == frame.mid_exposure_utc
    assert frame.header["EXPTIME"] == frame.exposure_s == 3.0
    scale = 206.264806 * float(frame.header["XPIXSZ"]) / float(frame.header["FOCALLEN"])
    assert scale == pytest.approx(SMALL.scale_arcsec_px, rel=1e-5)
    assert (frame.hint.scale_low_arcsec_px, frame.hint.scale_high_arcsec_px) == pytest.approx((5.7, 6.3))
    assert frame.hint.center is None
    assert "OBJCTRA" not in frame.header


@pytest.mark.parametrize(
    ("told", "ra", "dec"),
    [
        (Icrs(211.3, 54.2), "14 05 12.00", "+54 12 00.0"),
        (Icrs(359.99999, -0.00001), "00 00 00.00", "-00 00 00.0"),
        (Icrs(15.0, -12.51), "01 00 00.00", "-12 30 36.0"),
    ],
)
def test_the_told_place_is_in_the_header(told: Icrs, ra: str, dec: str) -> None:
    header = drawn(SMALL, catalog_round(CENTER), told=told).header
    assert (header["OBJCTRA"], header["OBJCTDEC"]) == (ra, dec)


@pytest.mark.parametrize(
    ("name", "scale", "width"),
    [
        ("ison-nm", 2.067, 3056),
        ("PROMPT-8", 0.663, 2048),
        ("vihorlat-vnt", 0.553, 512),
        ("mayaki-azt-3", 1.222, 795),
        ("demo", 3.5, 1500),
    ],
)
def test_presets_are_the_papers_telescopes(name: str, scale: float, width: int) -> None:
    optics = optics_preset(name)
    assert (optics.scale_arcsec_px, optics.width_px) == pytest.approx((scale, width), abs=6e-4)


def test_ison_nm_has_its_focal_length_and_field() -> None:
    optics = PRESETS["ison-nm"]
    assert optics.focal_length_mm == pytest.approx(1197.37)
    assert optics.width_px * optics.scale_arcsec_px / 3600.0 == pytest.approx(1.755, abs=5e-4)


def test_impossible_optics_are_refused() -> None:
    with pytest.raises(BadSettings, match="there are: ison-nm"):
        optics_preset("hubble")
    for change in ({"parity": 0}, {"width_px": 0}, {"scale_arcsec_px": math.nan}, {"bits": 17}):
        with pytest.raises(BadSettings, match=next(iter(change))):
            replace(SMALL, **change)
    with pytest.raises(BadSettings, match="sky_adu_s"):
        replace(SMALL, sky_adu_s=-1.0)
