"""Images as the library takes them: files, arrays, astropy's HDUs and CCDData; each becomes a `Frame`."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.frames import Frame
from mountnav.reading import frame_from_array, read_frame


@runtime_checkable
class WithHeader(Protocol):
    """An image with a FITS header: an HDU of astropy.io.fits, or an astropy.nddata.CCDData."""

    data: Any
    header: Any


Image: TypeAlias = "str | PathLike[str] | NDArray[Any] | WithHeader | Frame"
"""What `solve` and `read` take."""


def read(image: Image, *, hdu: int | str | None = None) -> Frame:
    """Make a `Frame` of an image.

    Parameters
    ----------
    image : path, ndarray, HDU, HDUList, CCDData or Frame
        A file (FITS, compressed or not, or a picture), pixels of shape (height, width), one of astropy's
        images with its header, or a frame, which is returned as it is.
    hdu : int or str, optional
        Which extension of a FITS file; the first image by default.

    Returns
    -------
    Frame
        The image, with what its header says of time, exposure and position.

    Raises
    ------
    BadFrame
        It holds no image.
    """
    if isinstance(image, Frame):
        return image
    if isinstance(image, (str, PathLike)):
        return read_frame(Path(image), hdu=hdu)
    if isinstance(image, list) and image and all(isinstance(one, WithHeader) for one in image):
        return read(_first_image(image, hdu))
    if isinstance(image, WithHeader) and not isinstance(image, np.ndarray):
        if image.data is None:
            raise BadFrame("the HDU holds no image", advice="give the HDU that does")
        mask = getattr(image, "mask", None)
        pixels = image.data if mask is None else np.ma.masked_array(image.data, mask)
        return frame_from_array(pixels, _cards(image.header), name=type(image).__name__)
    return frame_from_array(np.asanyarray(image))


def _first_image(hdus: Any, hdu: int | str | None) -> WithHeader:
    """Of an HDUList: the one that was asked for, else the first with pixels in two dimensions or more."""
    if hdu is not None:
        found: WithHeader = hdus[hdu]  # an HDUList takes names as well
        return found
    for one in hdus:
        if one.header.get("NAXIS", 0) >= 2 and one.data is not None:
            image: WithHeader = one
            return image
    raise BadFrame("no HDU of this list holds an image", advice="name one by `hdu`")


def _cards(header: Any) -> dict[str, str | int | float | bool]:
    """A header's plain values; comments and history are left out."""
    cards = dict(header.items())
    return {
        str(key): value
        for key, value in cards.items()
        if key and isinstance(value, (str, int, float, bool)) and key not in ("COMMENT", "HISTORY")
    }
