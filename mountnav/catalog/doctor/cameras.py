"""The cameras of the settings, as the doctor of catalogs needs them: field, depth, and where each is from."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

from mountnav.catalog.doctor.counts import FrameSize
from mountnav.catalog.doctor.diagnosis import CameraFacts
from mountnav.errors import BadFrame
from mountnav.settings.telescope import (
    AlpacaCameraSettings,
    FolderCameraSettings,
    IndiCameraSettings,
    SimulatedCameraSettings,
    TelescopeSettings,
)

_NEWEST = 3
"""So many files are tried for one that can be read."""
_SKY_MAG_ARCSEC2 = 20.5
_FOCAL_RATIO = 6.0
_PIXEL_MM = 0.009
_ELECTRONS_S_CM2 = 1e6
"""Of a star of magnitude 0, in an unfiltered camera, all losses included."""
_READ_NOISE_E = 7.0
_IMAGE_PX2 = 20.0
"""Area over which the noise of a star's image adds up: 4π σ², images three pixels wide."""
_SURE_SNR = 10.0
_LESS_THAN_IDEAL_MAG = 1.0
"""For moonlight, thin cloud, seeing and focus."""


@dataclass(frozen=True, slots=True)
class _Seen:
    """A frame of the folder."""

    name: str
    width_px: int
    height_px: int
    scale_arcsec_px: float | None
    scale_source: str


def camera_facts(telescope: TelescopeSettings) -> CameraFacts:
    """Find out a camera's field and depth.

    Parameters
    ----------
    telescope : TelescopeSettings
        A simulated camera tells itself. For a folder the settings count first; what they leave out is taken
        from the newest frame that can be read there.

    Returns
    -------
    CameraFacts
        With `problem` in place of the frame where size or scale are not known.
    """
    camera = telescope.camera
    if isinstance(camera, SimulatedCameraSettings):
        facts = CameraFacts(
            telescope.id,
            None,
            camera.width_px,
            camera.height_px,
            camera.scale_arcsec_px,
            size_from="the simulated camera",
            scale_from="the simulated camera",
        )
        return _with_frame(facts, telescope, simulated=camera)
    facts = _told(telescope, camera)
    if isinstance(camera, FolderCameraSettings) and (facts.width_px is None or facts.scale_arcsec_px is None):
        facts = _seen_too(facts, _newest(camera.path, camera.pattern))
    missing = [
        wanted
        for wanted, value in (
            ("width_px and height_px of the camera", facts.width_px),
            ("scale_arcsec_px of the telescope", facts.scale_arcsec_px),
        )
        if value is None
    ]
    if missing:
        where = f" (no frame in {camera.path} tells it)" if isinstance(camera, FolderCameraSettings) else ""
        return replace(facts, problem=f"unknown: set {' and '.join(missing)}{where}")
    return _with_frame(facts, telescope)


def estimated_depth_mag(scale_arcsec_px: float, exposure_s: float) -> float:
    """Magnitude that an ordinary camera of this scale measures.

    Parameters
    ----------
    scale_arcsec_px : float
    exposure_s : float

    Returns
    -------
    float
        Where a star is 10 times its noise, less a magnitude for an ordinary night. The aperture is guessed:
        pixels of 9 µm behind f/6, 0.10 m at 3 ″/px, 0.56 m at 0.55 ″/px. Off by one or two magnitudes for
        anything else.
    """
    aperture_cm = 0.1 * _PIXEL_MM * 206265.0 / scale_arcsec_px / _FOCAL_RATIO
    flux = _ELECTRONS_S_CM2 * math.pi * aperture_cm**2 / 4.0
    sky = flux * 10.0 ** (-0.4 * _SKY_MAG_ARCSEC2) * scale_arcsec_px**2
    return _depth_mag(flux * exposure_s, sky * exposure_s, _READ_NOISE_E, _IMAGE_PX2) - _LESS_THAN_IDEAL_MAG


def simulated_depth_mag(camera: SimulatedCameraSettings, exposure_s: float) -> float:
    """Magnitude at which a star of the simulated camera is 10 times its noise.

    Parameters
    ----------
    camera : SimulatedCameraSettings
    exposure_s : float

    Returns
    -------
    float
    """
    from mountnav.simulation.optics import SimulatedOptics

    optics = SimulatedOptics(**camera.model_dump(exclude={"kind"}))
    flux = 10.0 ** (0.4 * optics.zero_point_mag) * optics.gain_e_adu
    sky = optics.sky_adu_s * optics.gain_e_adu
    area = 4.0 * math.pi * (optics.fwhm_px / 2.3548) ** 2
    return _depth_mag(flux * exposure_s, sky * exposure_s, optics.read_noise_adu * optics.gain_e_adu, area)


def _depth_mag(zero_mag_e: float, sky_e_px: float, read_noise_e: float, area_px2: float) -> float:
    """Solve S = snr · √(S + A (sky + read noise²)) for the star's electrons S."""
    noise2 = area_px2 * (sky_e_px + read_noise_e**2)
    electrons = 0.5 * _SURE_SNR**2 * (1.0 + math.sqrt(1.0 + 4.0 * noise2 / _SURE_SNR**2))
    return 2.5 * math.log10(zero_mag_e / electrons)


def _told(
    telescope: TelescopeSettings, camera: AlpacaCameraSettings | FolderCameraSettings | IndiCameraSettings
) -> CameraFacts:
    told = camera.width_px is not None and camera.height_px is not None
    return CameraFacts(
        telescope.id,
        None,
        camera.width_px if told else None,
        camera.height_px if told else None,
        telescope.scale_arcsec_px,
        size_from="the settings" if told else "",
        scale_from="the settings" if telescope.scale_arcsec_px is not None else "",
    )


def _seen_too(facts: CameraFacts, seen: _Seen | None) -> CameraFacts:
    if seen is None:
        return facts
    if facts.width_px is None:
        facts = replace(facts, width_px=seen.width_px, height_px=seen.height_px, size_from=seen.name)
    elif facts.scale_arcsec_px is None and facts.width_px != seen.width_px:
        # binned otherwise than the settings say: its scale is another one too
        return facts
    if facts.scale_arcsec_px is None and seen.scale_arcsec_px is not None:
        source = f"{seen.scale_source} of {seen.name}"
        facts = replace(facts, scale_arcsec_px=seen.scale_arcsec_px, scale_from=source)
    return facts


def _with_frame(
    facts: CameraFacts, telescope: TelescopeSettings, *, simulated: SimulatedCameraSettings | None = None
) -> CameraFacts:
    width, height, scale = facts.width_px, facts.height_px, facts.scale_arcsec_px
    assert width is not None, "the caller has looked"
    assert height is not None, "the caller has looked"
    assert scale is not None, "the caller has looked"
    estimate = False
    if telescope.limiting_mag is not None:
        depth, source = telescope.limiting_mag, "limiting_mag of the settings"
    elif simulated is not None:
        depth = simulated_depth_mag(simulated, telescope.exposure_s)
        source = f"the simulated camera at {telescope.exposure_s:g} s"
    else:
        depth = estimated_depth_mag(scale, telescope.exposure_s)
        source = f"an estimate from scale and {telescope.exposure_s:g} s"
        estimate = True
    frame = FrameSize(width * scale / 3600.0, height * scale / 3600.0, depth)
    return replace(facts, frame=frame, depth_from=source, depth_is_estimate=estimate)


def _newest(folder: Path, pattern: str) -> _Seen | None:
    """The newest frame that can be read, or nothing: a folder that isn't there is no news here."""
    from mountnav.reading import read_frame

    for path in _files(folder, pattern)[:_NEWEST]:
        try:
            frame = read_frame(path, raw=True)
        except (BadFrame, OSError):
            continue
        low, high = frame.hint.scale_low_arcsec_px, frame.hint.scale_high_arcsec_px
        known = low is not None and high is not None and 0.0 < low <= high
        scale = math.sqrt((low or 1.0) * (high or 1.0)) if known else None
        return _Seen(
            path.name, frame.width_px, frame.height_px, scale, frame.hint.scale_source or "the header"
        )
    return None


def _files(folder: Path, pattern: str) -> list[Path]:
    found = []
    try:
        for path in folder.glob(pattern):
            try:
                if path.is_file():
                    found.append((path.stat().st_mtime_ns, path))
            except OSError:
                continue
    except OSError:
        return []
    return [path for _, path in sorted(found, reverse=True)]
