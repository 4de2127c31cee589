"""From what level on a pixel has stopped counting, told by a card or by the pile-up at the top."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.background import Image

_BELOW_CARD = 0.995
_PILE_SHARE = 0.004
_PILE_PIXELS = 12
_PILE_PIXELS_EXACT = 4
_CLEAR_STEPS = 30.0
_TYPE_SHARE = 0.985


def saturation_level(
    pixels: NDArray[np.generic], image: Image, sky: float, noise: float, card: float | None
) -> float:
    """Return the level from which pixels count as saturated; infinity if none is known.

    A card is believed as an upper bound. Otherwise, pixels that pile up at the frame's very maximum, far
    above the sky, tell of a full well or a full converter.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        As read, for the type.
    image : ndarray of float32, shape (height, width)
        The same as floats; NaN marks missing pixels.
    sky, noise : float
        Median level of the sky, and its noise per pixel.
    card : float or None
        `Frame.saturation_adu`.

    Returns
    -------
    float
    """
    level = np.inf if card is None else _BELOW_CARD * card
    if pixels.dtype.kind == "u" or (pixels.dtype.kind == "i" and pixels.dtype.itemsize <= 2):
        level = min(
            level, _TYPE_SHARE * (2.0 ** (8 * pixels.dtype.itemsize - (pixels.dtype.kind == "i")) - 1.0)
        )
    top = float(np.nanmax(image))
    if top - sky < max(_CLEAR_STEPS, 20.0 * noise):
        return level
    exact = int(np.count_nonzero(image == top))
    margin = _PILE_SHARE * (top - sky)
    near = int(np.count_nonzero(image >= top - margin))
    if near >= _PILE_PIXELS or exact >= _PILE_PIXELS_EXACT:
        level = min(level, top - margin)
    return level
