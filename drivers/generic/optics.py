"""The scale of a frame by pixel size, binning and focal length, as a hint; no I/O."""

from __future__ import annotations

from dataclasses import replace

from mountnav.frames import Frame

_ARCSEC_PER_RADIAN = 206264.806
_MARGIN = 0.1


def optics_scale_arcsec_px(
    pixel_um: float | None, binning: float, focal_length_mm: float | None
) -> float | None:
    """Scale of a binned pixel, or None where pixel size or focal length isn't known."""
    if not pixel_um or not focal_length_mm:
        return None
    return _ARCSEC_PER_RADIAN * pixel_um * binning / 1000.0 / focal_length_mm


def with_scale(frame: Frame, scale: float | None, source: str) -> Frame:
    """Add a scale to a frame's hints, with a margin, where its header doesn't tell one.

    Parameters
    ----------
    frame : Frame
    scale : float or None
        In arcseconds per pixel.
    source : str
        Where it is from, in words.
    """
    if scale is None or frame.hint.scale_low_arcsec_px is not None:
        return frame
    hint = replace(
        frame.hint,
        scale_low_arcsec_px=scale * (1.0 - _MARGIN),
        scale_high_arcsec_px=scale * (1.0 + _MARGIN),
        scale_source=source,
    )
    return replace(frame, hint=hint)
