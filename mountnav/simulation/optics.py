"""What a simulated telescope and its camera make of the sky; the telescopes of [S23 §3.1] as presets."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from mountnav.errors import BadSettings
from mountnav.units import pixel_scale_arcsec

PROJECTIONS = ("gnomonic", "equidistant", "equisolid", "stereographic")
"""Lenses by how they project the sky; the last three are those of fisheyes."""


@dataclass(frozen=True, slots=True)
class SimulatedOptics:
    """Telescope and camera.

    Attributes
    ----------
    width_px, height_px : int
        Size of the frame.
    scale_arcsec_px : float
        At the center, > 0.
    rotation_deg : float
        Position angle of the image's +y axis, east of north (as in `mountnav.solution.Solution`).
    parity : int
        +1: with north up and y upwards, east is left; -1: mirrored.
    fwhm_px : float
        Of the Gaussian star profile.
    pixel_um : float
        Size of a pixel; with the scale it gives the focal length in the header.
    distortion_px2 : float
        Cubic radial distortion: a star at distance r from the center appears at r·(1 + distortion_px2·r²).
    zero_point_mag : float
        Magnitude of a star that gives 1 ADU/s.
    gain_e_adu : float
        Electrons per ADU.
    sky_adu_s : float
        Sky background per pixel and second.
    bias_adu, read_noise_adu : float
        Level and noise of a frame without light.
    bits : int
        Of the converter; a pixel saturates at 2**bits - 1, at most 65535.
    faint_stars_deg2 : float
        Uncatalogued stars per square degree, always at the same places in the sky.
    faint_brightest_mag : float
        Brightest of them; their number doubles each magnitude, over 4 magnitudes.
    projection : {"gnomonic", "equidistant", "equisolid", "stereographic"}
        How far from the axis a star at an angle θ falls: tan θ, θ, 2 sin θ/2 or 2 tan θ/2 focal lengths.
    instrument : str
        For the header.

    Raises
    ------
    BadSettings
        When a value makes no camera.
    """

    width_px: int
    height_px: int
    scale_arcsec_px: float
    rotation_deg: float = 0.0
    parity: int = 1
    fwhm_px: float = 2.8
    pixel_um: float = 9.0
    distortion_px2: float = 0.0
    zero_point_mag: float = 20.0
    gain_e_adu: float = 1.5
    sky_adu_s: float = 20.0
    bias_adu: float = 300.0
    read_noise_adu: float = 6.0
    bits: int = 16
    faint_stars_deg2: float = 0.0
    faint_brightest_mag: float = 12.0
    projection: str = "gnomonic"
    instrument: str = "mountnav simulator"

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise BadSettings(f"simulated optics: {field.name} = {value} is not a number")
        for name in (
            "width_px", "height_px", "scale_arcsec_px", "fwhm_px", "pixel_um", "gain_e_adu"
        ):  # fmt: skip
            if getattr(self, name) <= 0:
                raise BadSettings(f"simulated optics: {name} = {getattr(self, name)}", advice="> 0")
        for name in ("sky_adu_s", "bias_adu", "read_noise_adu", "faint_stars_deg2"):
            if getattr(self, name) < 0:
                raise BadSettings(f"simulated optics: {name} = {getattr(self, name)}", advice=">= 0")
        if self.projection not in PROJECTIONS:
            known = ", ".join(PROJECTIONS)
            raise BadSettings(
                f"simulated optics: projection = {self.projection!r}", advice=f"one of: {known}"
            )
        if self.parity not in (1, -1):
            raise BadSettings(f"simulated optics: parity = {self.parity}", advice="1 or -1")
        if not 1 <= self.bits <= 16:
            raise BadSettings(f"simulated optics: bits = {self.bits}", advice="1 to 16")

    @property
    def focal_length_mm(self) -> float:
        """Focal length that gives this scale with these pixels."""
        return pixel_scale_arcsec(self.pixel_um, self.scale_arcsec_px)

    @property
    def saturation_adu(self) -> int:
        """Level at which a pixel is full."""
        return int(2**self.bits - 1)

    @property
    def half_diagonal_deg(self) -> float:
        """From the frame's center to its corner."""
        corner_deg = math.hypot(self.width_px, self.height_px) / 2.0 * self.scale_arcsec_px / 3600.0
        if self.projection in ("gnomonic", "equidistant"):
            return corner_deg  # of a gnomonic one rather more than it is
        half = math.radians(corner_deg) / 2.0
        if self.projection == "equisolid":
            return 2.0 * math.degrees(math.asin(min(half, 1.0)))
        return 2.0 * math.degrees(math.atan(half))


def _of_telescope(
    instrument: str,
    focal_length_mm: float,
    width_px: int,
    height_px: int,
    pixel_um: float,
    *,
    fwhm_px: float,
    zero_point_mag: float,
    sky_adu_s: float,
) -> SimulatedOptics:
    scale = pixel_scale_arcsec(pixel_um, focal_length_mm)
    return SimulatedOptics(
        width_px,
        height_px,
        scale,
        fwhm_px=fwhm_px,
        pixel_um=pixel_um,
        zero_point_mag=zero_point_mag,
        sky_adu_s=sky_adu_s,
        read_noise_adu=8.0,
        instrument=instrument,
    )


# Focal length, sensor and pixels are from [S23 §3.1]; the rest is an estimate. Zero points: an unfiltered CCD
# that makes 1e6 electrons per second and cm² of a star of magnitude 0, behind 0.40, 0.61, 1.0 and 0.48 m.
# Skies: 21.3, 21.8, 21.3 and 20.0 mag per square arcsecond. Star images: 5.8″, 1.7″, 2.5″ and 3.1″.
PRESETS: dict[str, SimulatedOptics] = {
    "ison-nm": _of_telescope(
        "ISON-NM SANTEL-400AN", 1197.37, 3056, 3056, 12.0, fwhm_px=2.8, zero_point_mag=22.3, sky_adu_s=11.0
    ),
    "prompt-8": _of_telescope(
        "PROMPT-8", 4201.035, 2048, 2048, 13.5, fwhm_px=2.6, zero_point_mag=23.2, sky_adu_s=1.6
    ),
    # the FLI PL1001E's pixels are 24 µm; the 4.8 µm in print would make the field 0.9′ [METHODS §4]
    "vihorlat-vnt": _of_telescope(
        "Vihorlat VNT", 8958.50, 512, 512, 24.0, fwhm_px=4.5, zero_point_mag=24.3, sky_adu_s=4.8
    ),
    "mayaki-azt-3": _of_telescope(
        "Mayaki AZT-3", 2025.0, 795, 596, 12.0, fwhm_px=2.5, zero_point_mag=22.7, sky_adu_s=18.0
    ),
    "demo": SimulatedOptics(
        1500, 1000, 3.5, rotation_deg=12.0, faint_stars_deg2=150.0, instrument="mountnav demo"
    ),
}
"""Named telescopes: those of the paper, and a small one to play with."""


def optics_preset(name: str) -> SimulatedOptics:
    """Look up the preset of that name.

    Raises
    ------
    BadSettings
        When there is none; the message names those that exist.
    """
    try:
        return PRESETS[name.lower()]
    except KeyError:
        raise BadSettings(
            f"no simulated telescope named {name!r}", advice=f"there are: {', '.join(PRESETS)}"
        ) from None
