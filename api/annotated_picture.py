"""A picture of a solved frame: stars that were identified, the center, where north and east are."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mountnav.frames import Frame
from mountnav.solution import Solution, Verdict

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont

LONGEST_SIDE_PX = 2400
"""Of the picture: larger frames are shrunk. Doubled, a picture takes four times as long and as many bytes."""
BLACK_SIGMA, WHITE_SIGMA = -1.5, 80.0
"""Brightness that becomes black and white, in units of the noise above the sky; chosen by hand: faint stars
are seen, and bright ones keep their size."""
STRETCH = 20.0
"""How steep asinh lifts what is faint; chosen by hand. Doubled, noise looks like stars."""
MAD_TO_SIGMA = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""
RING_PX = 9
"""Radius of a star's ring in the picture; chosen by hand, a few widths of a star."""
ARROW_SHARE = 0.08
"""Length of the arrows north and east, as a share of the shorter side; chosen by hand."""
TEXT_SHARE = 60
"""Parts of the shorter side that a line of text is high; chosen by hand: readable when it fills a screen."""

USED, REJECTED, MIDDLE = (80, 230, 120), (255, 150, 60), (255, 220, 90)
"""Colors of stars in the fit, of those thrown out of it, and of center and text."""


def annotated_png(frame: Frame, verdict: Verdict, solution: Solution) -> bytes:
    """Draw a frame with its stars; FITS with row 1 at the bottom, pictures as they are.

    Parameters
    ----------
    frame : Frame
        Without a mosaic.
    verdict : Verdict
        What was found there.
    solution : Solution
        The same verdict's.

    Returns
    -------
    bytes
        PNG.
    """
    from PIL import Image, ImageDraw, ImageFont

    shrink = max(1, math.ceil(max(frame.width_px, frame.height_px) / LONGEST_SIDE_PX))
    upwards = bool(frame.header) and str(frame.header.get("ROWORDER", "")).strip().upper() != "TOP-DOWN"
    gray = _stretched(_shrunk(frame.pixels, shrink))
    picture = Image.fromarray(gray[::-1] if upwards else gray).convert("RGB")
    draw = ImageDraw.Draw(picture)
    high = gray.shape[0]

    def at(x_px: float, y_px: float) -> tuple[float, float]:
        x, y = (x_px + 0.5) / shrink, (y_px + 0.5) / shrink
        return x, high - y if upwards else y

    pairs = solution.identified
    for x_px, y_px, used in zip(pairs.x_px, pairs.y_px, pairs.used, strict=True):
        x, y = at(float(x_px), float(y_px))
        draw.ellipse((x - RING_PX, y - RING_PX, x + RING_PX, y + RING_PX), outline=USED if used else REJECTED)
    middle = ((frame.width_px - 1) / 2.0, (frame.height_px - 1) / 2.0)
    x, y = at(*middle)
    draw.line((x - 2 * RING_PX, y, x + 2 * RING_PX, y), fill=MIDDLE)
    draw.line((x, y - 2 * RING_PX, x, y + 2 * RING_PX), fill=MIDDLE)
    shorter = min(picture.size)
    size = max(12, shorter // TEXT_SHARE)
    font = ImageFont.load_default(size)
    _compass(draw, solution, at, middle, shrink * ARROW_SHARE * shorter, font)
    text = (
        f"{frame.source}\n"
        f"RA {solution.center.ra_deg:.5f}°  Dec {solution.center.dec_deg:+.5f}°  "
        f'{solution.scale_arcsec_px:.3f}"/px  rotation {solution.rotation_deg:.2f}°\n'
        f'{solution.pairs} stars, rms {solution.rms_arcsec:.2f}", '
        f"false with probability {solution.false_probability:.0e}; {verdict.measured} sources"
    )
    draw.multiline_text((size // 2, size // 2), text, fill=MIDDLE, font=font, stroke_width=2, stroke_fill=0)
    content = io.BytesIO()
    picture.save(content, "PNG")
    return content.getvalue()


def _compass(
    draw: ImageDraw,
    solution: Solution,
    at: Callable[[float, float], tuple[float, float]],
    middle: tuple[float, float],
    long_px: float,
    font: FreeTypeFont | ImageFont,
) -> None:
    """Arrows from the center to the north and to the east."""
    cards = solution.wcs
    matrix = np.array([[float(cards[f"CD{row}_{column}"]) for column in (1, 2)] for row in (1, 2)])
    to_pixels = np.linalg.inv(matrix)
    for name, direction in (("E", (1.0, 0.0)), ("N", (0.0, 1.0))):
        step = to_pixels @ direction
        step *= long_px / math.hypot(*step)
        begin, end = at(*middle), at(middle[0] + step[0], middle[1] + step[1])
        draw.line((*begin, *end), fill=MIDDLE, width=2)
        draw.text(end, name, fill=MIDDLE, font=font, stroke_width=2, stroke_fill=0)


def _shrunk(pixels: NDArray[np.generic], times: int) -> NDArray[np.float32]:
    """Means of squares of pixels; what is left over at two edges is cut off."""
    high, wide = (side // times for side in pixels.shape)
    cut = pixels[: high * times, : wide * times]
    squares = cut.reshape(high, times, wide, times).astype(np.float32)
    return np.asarray(np.nanmean(squares, axis=(1, 3)), dtype=np.float32)


def _stretched(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    known = values[np.isfinite(values)]
    sky = float(np.median(known)) if known.size else 0.0
    noise = MAD_TO_SIGMA * float(np.median(np.abs(known - sky))) if known.size else 0.0
    noise = max(noise, 1e-3 * float(np.ptp(known)) if known.size else 0.0, 1e-9)
    share = (np.nan_to_num(values, nan=sky) - sky - BLACK_SIGMA * noise) / (
        (WHITE_SIGMA - BLACK_SIGMA) * noise
    )
    curve = np.arcsinh(STRETCH * np.clip(share, 0.0, 1.0)) / math.asinh(STRETCH)
    return np.asarray(255.0 * curve, dtype=np.uint8)
