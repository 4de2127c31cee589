"""The settings files of the paper's four telescopes load, and say what [S23 §3.1] says."""

from __future__ import annotations

import pytest

from mountnav.catalog.doctor.cameras import camera_facts
from mountnav.settings.described_cameras import described_camera
from mountnav.settings.observatory import Settings
from mountnav.settings.telescope import FolderCameraSettings, SimulatedCameraSettings
from mountnav.simulation.optics import optics_preset
from tests.conftest import ROOT

FOLDER = ROOT / "deploy" / "telescopes"
PUBLISHED = {  # field in degrees, pixels, arcsec per pixel [METHODS §4]
    "ison-nm": ((1.755, 1.755), (3056, 3056), 2.067),
    "prompt-8": ((0.377, 0.377), (2048, 2048), 0.663),
    "vihorlat-vnt": ((0.079, 0.079), (512, 512), 0.553),
    "mayaki-azt-3": ((0.270, 0.202), (795, 596), 1.222),
}


def test_there_is_a_file_for_each_telescope() -> None:
    assert {path.stem for path in FOLDER.glob("*.toml")} == set(PUBLISHED)


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_file_is_the_published_telescope(name: str) -> None:
    field_deg, (width, height), scale = PUBLISHED[name]
    settings = Settings.load(FOLDER / f"{name}.toml")
    real, simulated = settings.telescope
    assert (real.id, simulated.id) == (name, f"{name}-simulated")
    assert not real.mount.is_fake
    assert simulated.mount.is_fake
    camera = simulated.camera
    assert isinstance(camera, SimulatedCameraSettings)
    assert (camera.width_px, camera.height_px) == (width, height)
    folder = real.camera
    assert isinstance(folder, FolderCameraSettings)
    assert (folder.width_px, folder.height_px) == (width, height)
    for told in (real.scale_arcsec_px, simulated.scale_arcsec_px, camera.scale_arcsec_px):
        assert told is not None
        assert told == pytest.approx(scale, abs=6e-4)
        assert (width * told / 3600, height * told / 3600) == pytest.approx(field_deg, abs=6e-4)


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_simulators_preset_is_the_same_telescope(name: str) -> None:
    optics, camera = optics_preset(name), Settings.load(FOLDER / f"{name}.toml").telescope[1].camera
    assert isinstance(camera, SimulatedCameraSettings)
    assert (optics.width_px, optics.height_px, optics.fwhm_px) == (
        camera.width_px,
        camera.height_px,
        camera.fwhm_px,
    )
    assert optics.scale_arcsec_px == pytest.approx(camera.scale_arcsec_px, abs=1e-4)


def test_the_telescopes_stand_where_they_stand() -> None:
    sites = {name: Settings.load(FOLDER / f"{name}.toml").site for name in PUBLISHED}
    # hemispheres: a sign lost here is the commonest fault of a settings file
    assert {name: (s.latitude_deg > 0, s.longitude_deg > 0) for name, s in sites.items()} == {
        "ison-nm": (True, False),
        "prompt-8": (False, False),
        "vihorlat-vnt": (True, True),
        "mayaki-azt-3": (True, True),
    }


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_doctor_needs_no_frame_to_know_the_camera(name: str) -> None:
    real = Settings.load(FOLDER / f"{name}.toml").telescope[0]
    facts = camera_facts(described_camera(real))
    assert facts.frame is not None
    assert (facts.frame.width_deg, facts.frame.height_deg) == pytest.approx(PUBLISHED[name][0], abs=6e-4)
    assert facts.frame.depth_mag == real.limiting_mag
    assert not facts.depth_is_estimate
