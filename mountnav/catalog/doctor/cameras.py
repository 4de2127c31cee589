"""A camera as the doctor of catalogs needs it: field, depth, and where each is known from."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

from mountnav.catalog.doctor.counts import FrameSize
from mountnav.catalog.doctor.diagnosis import CameraFacts
from mountnav.errors import BadFrame
from mountnav.units import ARCSEC_PER_RAD

_NEWEST = 3
"""So many files are tried for one that can be read."""
_SKY_MAG_ARCSEC2 = 20.5
"""Brightness of the sky's background, V magnitudes in a square arcsecond: a suburb's; chosen for the estimate
of a camera that nobody described. One magnitude darker, the estimated depth grows by half a magnitude."""
_FOCAL_RATIO = 6.0
"""Focal length over aperture of the assumed telescope; chosen by hand. Halved, the assumed aperture doubles
and the depth grows by 0.75 to 1.5 mag."""
_PIXEL_MM = 0.009
"""Side of the assumed camera's pixels, 9 µm; chosen by hand. It enters as pixel over focal ratio only."""
_ELECTRONS_S_CM2 = 1e6
"""Of a star of magnitude 0, in an unfiltered camera, all losses included."""
_READ_NOISE_E = 7.0
"""Electrons of read noise per pixel of the assumed camera; chosen by hand. Doubled, only short exposures
under a dark sky come out shallower."""
_IMAGE_PX2 = 20.0
"""Area over which the noise of a star's image adds up: 4π σ², images three pixels wide."""
_SURE_SNR = 10.0
"""A star counts as measured when it is so many times its noise; the same 10 that `estimated_depth_mag` and
docs/how-to/catalog-doctor.md state. Halved, estimated depths grow by 0.75 to 1.5 mag."""
_LESS_THAN_IDEAL_MAG = 1.0
"""For moonlight, thin cloud, seeing and focus."""


_FWHM_SIGMAS = 2.3548
"""Full width at half maximum of a Gaussian in units of its sigma: 2 √(2 ln 2)."""


@dataclass(frozen=True, slots=True)
class _Seen:
    """A frame of the folder."""

    name: str
    width_px: int
    height_px: int
    scale_arcsec_px: float | None
    scale_source: str


@dataclass(frozen=True, slots=True)
class CameraNoise:
    """What decides how faint a star a camera measures; known of a simulated camera only.

    Attributes
    ----------
    zero_mag_e_s : float
        Electrons per second of a star of magnitude 0.
    sky_e_s_px : float
        Electrons per second of the sky's background in a pixel.
    read_noise_e : float
        Per pixel and frame.
    fwhm_px : float
        Of a star's image.
    """

    zero_mag_e_s: float
    sky_e_s_px: float
    read_noise_e: float
    fwhm_px: float

    def depth_mag(self, exposure_s: float) -> float:
        """Magnitude at which a star is 10 times its noise."""
        area_px2 = 4.0 * math.pi * (self.fwhm_px / _FWHM_SIGMAS) ** 2
        return _depth_mag(
            self.zero_mag_e_s * exposure_s, self.sky_e_s_px * exposure_s, self.read_noise_e, area_px2
        )


@dataclass(frozen=True, slots=True)
class DescribedCamera:
    """A camera as the operator describes it: what isn't given is None.

    Attributes
    ----------
    telescope : str
        Its name.
    exposure_s : float
        Of a usual frame.
    width_px, height_px : int or None
        None: not known.
    scale_arcsec_px : float or None
        None: not known.
    limiting_mag : float or None
        Faintest star of a usual frame.
    folder : Path or None
        Where its frames appear, if they do: the newest one gives what is missing.
    pattern : str
        Of the files in `folder`.
    noise : CameraNoise or None
        Of a simulated camera, whose size and scale are given.
    """

    telescope: str
    exposure_s: float
    width_px: int | None = None
    height_px: int | None = None
    scale_arcsec_px: float | None = None
    limiting_mag: float | None = None
    folder: Path | None = None
    pattern: str = "*"
    noise: CameraNoise | None = None


def camera_facts(camera: DescribedCamera) -> CameraFacts:
    """Find out a camera's field and depth.

    Parameters
    ----------
    camera : DescribedCamera
        What is given counts first; what isn't is taken from the newest frame that can be read in its folder.

    Returns
    -------
    CameraFacts
        With `problem` in place of the frame where size or scale are not known.
    """
    given_by = "the settings" if camera.noise is None else "the simulated camera"
    has_size = camera.width_px is not None and camera.height_px is not None
    facts = CameraFacts(
        camera.telescope,
        None,
        camera.width_px if has_size else None,
        camera.height_px if has_size else None,
        camera.scale_arcsec_px,
        size_from=given_by if has_size else "",
        scale_from=given_by if camera.scale_arcsec_px is not None else "",
    )
    if camera.folder is not None and (facts.width_px is None or facts.scale_arcsec_px is None):
        facts = _seen_too(facts, _newest(camera.folder, camera.pattern))
    missing = [
        wanted
        for wanted, value in (
            ("width_px and height_px of the camera", facts.width_px),
            ("scale_arcsec_px of the telescope", facts.scale_arcsec_px),
        )
        if value is None
    ]
    if missing:
        where = f" (no frame in {camera.folder} tells it)" if camera.folder is not None else ""
        return replace(facts, problem=f"unknown: set {' and '.join(missing)}{where}")
    return _with_frame(facts, camera)


def estimated_depth_mag(scale_arcsec_px: float, exposure_s: float) -> float:
    """Magnitude that an ordinary camera of this scale measures.

    Returns
    -------
    float
        Where a star is 10 times its noise, less a magnitude for an ordinary night. The aperture is guessed:
        pixels of 9 µm behind f/6, 0.10 m at 3 ″/px, 0.56 m at 0.55 ″/px. Off by one or two magnitudes for
        anything else.
    """
    aperture_cm = 0.1 * _PIXEL_MM * ARCSEC_PER_RAD / scale_arcsec_px / _FOCAL_RATIO
    flux = _ELECTRONS_S_CM2 * math.pi * aperture_cm**2 / 4.0
    sky = flux * 10.0 ** (-0.4 * _SKY_MAG_ARCSEC2) * scale_arcsec_px**2
    return _depth_mag(flux * exposure_s, sky * exposure_s, _READ_NOISE_E, _IMAGE_PX2) - _LESS_THAN_IDEAL_MAG


def _depth_mag(zero_mag_e: float, sky_e_px: float, read_noise_e: float, area_px2: float) -> float:
    """Solve S = snr · √(S + A (sky + read noise²)) for the star's electrons S."""
    noise2 = area_px2 * (sky_e_px + read_noise_e**2)
    electrons = 0.5 * _SURE_SNR**2 * (1.0 + math.sqrt(1.0 + 4.0 * noise2 / _SURE_SNR**2))
    return 2.5 * math.log10(zero_mag_e / electrons)


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


def _with_frame(facts: CameraFacts, camera: DescribedCamera) -> CameraFacts:
    width, height, scale = facts.width_px, facts.height_px, facts.scale_arcsec_px
    assert width is not None, "the caller has looked"
    assert height is not None, "the caller has looked"
    assert scale is not None, "the caller has looked"
    estimate = False
    if camera.limiting_mag is not None:
        depth, source = camera.limiting_mag, "limiting_mag of the settings"
    elif camera.noise is not None:
        depth = camera.noise.depth_mag(camera.exposure_s)
        source = f"the simulated camera at {camera.exposure_s:g} s"
    else:
        depth = estimated_depth_mag(scale, camera.exposure_s)
        source = f"an estimate from scale and {camera.exposure_s:g} s"
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
