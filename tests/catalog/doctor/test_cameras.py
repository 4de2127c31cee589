"""What the doctor knows of a camera: from the settings, from the newest frame of its folder, or nothing."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from mountnav.catalog.doctor.cameras import camera_facts, estimated_depth_mag
from mountnav.catalog.doctor.diagnosis import CameraFacts
from mountnav.settings.described_cameras import described_camera
from mountnav.settings.telescope import SimulatedCameraSettings, TelescopeSettings
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame

REAL = {"id": "t", "mount": {"url": "lx200+socket://127.0.0.1:4030"}}


def telescope(folder: Path, *, camera: dict[str, object] | None = None, **more: object) -> TelescopeSettings:
    camera = {"kind": "folder", "path": str(folder), **(camera or {})}
    return TelescopeSettings.model_validate({**REAL, "camera": camera, **more})


def facts_of(settings: TelescopeSettings) -> CameraFacts:
    return camera_facts(described_camera(settings))


def written(path: Path, width: int, height: int, when_s: int, **cards: float) -> None:
    header = fits.Header()
    for key, value in cards.items():
        header[key] = value
    fits.PrimaryHDU(np.zeros((height, width), np.uint16), header).writeto(path)
    os.utime(path, (when_s, when_s))


def test_the_settings_come_first(tmp_path: Path) -> None:
    written(tmp_path / "a.fits", 64, 48, 1000, FOCALLEN=1000.0, XPIXSZ=5.0)
    facts = facts_of(
        telescope(
            tmp_path,
            camera={"width_px": 2000, "height_px": 1000},
            scale_arcsec_px=1.8,
            limiting_mag=15.0,
        )
    )
    assert facts.frame is not None
    assert (facts.frame.width_deg, facts.frame.height_deg) == pytest.approx((1.0, 0.5))
    assert facts.frame.depth_mag == 15.0
    assert facts.size_from == facts.scale_from == "the settings"
    assert not facts.depth_is_estimate


def test_the_newest_readable_frame_tells_the_rest(tmp_path: Path) -> None:
    written(tmp_path / "old.fits", 320, 200, 1000, FOCALLEN=500.0, XPIXSZ=5.0, YPIXSZ=5.0)
    written(tmp_path / "new.fits", 640, 480, 2000, FOCALLEN=1000.0, XPIXSZ=5.0, YPIXSZ=5.0)
    (tmp_path / "cut.fits").write_bytes(b"SIMPLE  =                    T")
    os.utime(tmp_path / "cut.fits", (3000, 3000))
    facts = facts_of(telescope(tmp_path))
    assert (facts.width_px, facts.height_px, facts.size_from) == (640, 480, "new.fits")
    # 206.265 × 5 µm / 1000 mm; the bounds of a hint lie evenly about it, their geometric mean a little lower
    assert facts.scale_arcsec_px == pytest.approx(1.0313, rel=0.01)
    assert "new.fits" in facts.scale_from
    assert facts.frame is not None
    assert facts.depth_is_estimate


@pytest.mark.parametrize(
    ("camera", "more", "missing"),
    [
        ({}, {"scale_arcsec_px": 1.0}, ["width_px and height_px"]),
        ({"width_px": 640, "height_px": 480}, {}, ["scale_arcsec_px"]),
        ({}, {}, ["width_px and height_px", "scale_arcsec_px"]),
        ({"width_px": 640}, {"scale_arcsec_px": 1.0}, ["width_px and height_px"]),
    ],
)
def test_what_nobody_tells_is_asked_for(
    tmp_path: Path, camera: dict[str, object], more: dict[str, object], missing: list[str]
) -> None:
    for folder in (tmp_path, tmp_path / "not there"):
        facts = facts_of(telescope(folder, camera=camera, **more))
        assert facts.frame is None
        assert facts.problem is not None
        assert facts.problem.startswith("unknown: set ")
        assert all(word in facts.problem for word in missing)
        assert ("scale_arcsec_px" in facts.problem) == ("scale_arcsec_px" in missing)


def test_the_scale_of_a_frame_of_another_size_is_not_taken(tmp_path: Path) -> None:
    written(tmp_path / "binned.fits", 320, 240, 1000, FOCALLEN=1000.0, XPIXSZ=10.0, YPIXSZ=10.0)
    facts = facts_of(telescope(tmp_path, camera={"width_px": 640, "height_px": 480}))
    assert facts.scale_arcsec_px is None
    assert facts.problem is not None


def test_a_simulated_camera_tells_itself() -> None:
    facts = facts_of(
        TelescopeSettings.model_validate(
            {
                "id": "t",
                "mount": {"url": "fake+lx200://"},
                "camera": {"kind": "simulated", "width_px": 800, "height_px": 600, "scale_arcsec_px": 4.5},
            }
        )
    )
    assert facts.frame is not None
    assert (facts.frame.width_deg, facts.frame.height_deg) == pytest.approx((1.0, 0.75))
    assert not facts.depth_is_estimate


def test_the_simulated_depth_is_where_the_simulator_drowns_a_star() -> None:
    from mountnav.catalog.stars import Stars
    from mountnav.clock import utc_now
    from mountnav.sky.coordinates import Icrs

    camera = SimulatedCameraSettings(kind="simulated", width_px=64, height_px=64, fwhm_px=3.0)
    described = described_camera(
        TelescopeSettings.model_validate({"id": "t", "mount": {"url": "fake+lx200://"}, "camera": camera})
    )
    assert described.noise is not None
    depth = described.noise.depth_mag(4.0)

    class One:
        name = "one star"

        def cone(
            self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
        ) -> Stars:
            value = np.array([0.0])
            return Stars(
                value + 10.0, value + 20.0, value, value + depth, value, value, epoch_yr, "V", self.name
            )

    optics = SimulatedOptics(**camera.model_dump(exclude={"kind"}))
    y, x = np.mgrid[:64, :64]
    # the best weights for a star at the center under a flat sky: its own profile
    profile = np.exp(-4.0 * np.log(2.0) * ((x - 31.5) ** 2 + (y - 31.5) ** 2) / 3.0**2)
    found = []
    for seed in range(120):
        frame = draw_frame(
            Icrs(10.0, 20.0), optics, One(), exposure_s=4.0, mid_exposure_utc=utc_now(), seed=(1, seed)
        )
        pixels = np.asarray(frame.pixels, float)
        found.append(float(((pixels - np.median(pixels)) * profile).sum()))
    assert np.mean(found) / np.std(found) == pytest.approx(10.0, rel=0.2)


def test_the_estimate_is_deeper_for_larger_and_longer() -> None:
    scales = [0.5, 1.0, 2.0, 4.0, 30.0, 100.0]
    depths = [estimated_depth_mag(scale, 5.0) for scale in scales]
    assert depths == sorted(depths, reverse=True)
    assert estimated_depth_mag(1.0, 60.0) > estimated_depth_mag(1.0, 5.0) + 1.0
    # short lenses as identification's own promise has it: 8.1 at 30 ″/px
    assert estimated_depth_mag(30.0, 2.0) == pytest.approx(8.1, abs=0.7)
