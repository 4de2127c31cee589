"""The cameras of the settings as the doctor of catalogs takes them."""

from __future__ import annotations

from dataclasses import replace

from mountnav.catalog.doctor.cameras import CameraNoise, DescribedCamera
from mountnav.settings.telescope import FolderCameraSettings, SimulatedCameraSettings, TelescopeSettings


def described_camera(telescope: TelescopeSettings) -> DescribedCamera:
    """What the settings say of a telescope's camera."""
    camera = telescope.camera
    described = DescribedCamera(
        telescope=telescope.id,
        exposure_s=telescope.exposure_s,
        width_px=camera.width_px,
        height_px=camera.height_px,
        scale_arcsec_px=telescope.scale_arcsec_px,
        limiting_mag=telescope.limiting_mag,
    )
    if isinstance(camera, SimulatedCameraSettings):
        return replace(described, scale_arcsec_px=camera.scale_arcsec_px, noise=_noise(camera))
    if isinstance(camera, FolderCameraSettings):
        return replace(described, folder=camera.path, pattern=camera.pattern)
    return described


def _noise(camera: SimulatedCameraSettings) -> CameraNoise:
    from mountnav.simulation.optics import SimulatedOptics

    optics = SimulatedOptics(**camera.model_dump(exclude={"kind"}))
    return CameraNoise(
        zero_mag_e_s=10.0 ** (0.4 * optics.zero_point_mag) * optics.gain_e_adu,
        sky_e_s_px=optics.sky_adu_s * optics.gain_e_adu,
        read_noise_e=optics.read_noise_adu * optics.gain_e_adu,
        fwhm_px=optics.fwhm_px,
    )
