"""One Alpaca exposure: its image into an array, when its middle was; no I/O [Alpaca §7].

Both hold a picture as [X][Y] or [X][Y][plane], the last index running fastest. Arrays here have rows first:
shape (height, width), or (planes, height, width).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from drivers.alpaca.codec.base import Answer, Malformed, alpaca_number, excerpt, read_answer
from drivers.generic.exposure import ExposureTimes, TimeSource, lasted_otherwise

IMAGE_BYTES = "application/imagebytes"
_HEADER = struct.Struct("<iiIIiiiiiii")
_TYPES: dict[int, np.dtype[np.generic]] = {
    1: np.dtype("<i2"),
    2: np.dtype("<i4"),
    3: np.dtype("<f8"),
    4: np.dtype("<f4"),
    5: np.dtype("<u8"),
    6: np.dtype("u1"),
    7: np.dtype("<i8"),
    8: np.dtype("<u2"),
    9: np.dtype("<u4"),
}
"""Element types of ImageBytes by their numbers [Alpaca ImageArrayElementTypes]."""
_MOST_PIXELS = 1 << 31
"""Images of more pixels are refused before memory is taken for them. Chosen by hand: far above any
sensor."""

Pixels = NDArray[np.generic]


@dataclass(frozen=True, slots=True)
class ImageAnswer:
    """An image, or the error in its place.

    Attributes
    ----------
    pixels : ndarray or None
        Rows first; a view of the answer's bytes where that is possible.
    answer : Answer
        Its `value` is always None.
    """

    pixels: Pixels | None
    answer: Answer


def read_image(body: bytes, content_type: str, transaction_id: int) -> ImageAnswer:
    """Read the answer to ImageArray, by what its Content-Type says it is.

    Raises
    ------
    Malformed
        If it is no image and no error, or of another question.
    """
    if content_type.partition(";")[0].strip().lower() == IMAGE_BYTES:
        return _binary(body, transaction_id)
    return _json(body, content_type, transaction_id)


def _binary(body: bytes, transaction_id: int) -> ImageAnswer:
    if len(body) < _HEADER.size:
        raise Malformed(f"only {len(body)} bytes of ImageBytes")
    version, error, client_id, _, start, _, sent, rank, *sides = _HEADER.unpack_from(body)
    if version != 1:
        raise Malformed(f"ImageBytes of version {version}; 1 is known")
    if client_id not in (0, transaction_id):
        raise Malformed(f"the image for question {client_id}, not for {transaction_id}")
    if not _HEADER.size <= start <= len(body):
        raise Malformed(f"ImageBytes whose data begin at {start} of {len(body)}")
    if error:
        return ImageAnswer(None, Answer(None, alpaca_number(error), body[start:].decode("utf-8", "replace")))
    if rank not in (2, 3):
        raise Malformed(f"an image of {rank} axes")
    if sent not in _TYPES:
        raise Malformed(f"an image of elements of type {sent}")
    shape = tuple(sides[:rank])
    return ImageAnswer(_rows_first(_elements(body, start, _TYPES[sent], shape)), Answer(None))


def _elements(body: bytes, start: int, kind: np.dtype[np.generic], shape: tuple[int, ...]) -> Pixels:
    count = 1
    for side in shape:
        if side < 1:
            raise Malformed(f"an image of {' × '.join(map(str, shape))}")
        count *= side
    if count > _MOST_PIXELS or len(body) - start != count * kind.itemsize:
        raise Malformed(
            f"{len(body) - start} bytes for an image of {' × '.join(map(str, shape))} "
            f"elements of {kind.itemsize} bytes"
        )
    return np.frombuffer(body, kind, count, start).reshape(shape)


def _rows_first(image: Pixels) -> Pixels:
    """From [X][Y] to rows, from [X][Y][plane] to planes of rows."""
    return image.transpose()


def _json(body: bytes, content_type: str, transaction_id: int) -> ImageAnswer:
    answer = read_answer(body, content_type, transaction_id)
    if answer.error_number:
        return ImageAnswer(None, Answer(None, answer.error_number, answer.error_message))
    try:
        image = np.array(answer.value)
    except ValueError as fault:
        raise Malformed(f"an image of ragged rows ({fault})") from fault
    if image.ndim not in (2, 3) or image.dtype.kind not in "if" or image.size == 0:
        raise Malformed(f"no image: {excerpt(body)}")
    return ImageAnswer(_rows_first(_narrowed(image)), Answer(None))


def _narrowed(image: Pixels) -> Pixels:
    """JSON's whole numbers in the least bytes that hold them: cameras of 16 bits are usual."""
    if image.dtype.kind != "i":
        return image
    low, high = int(image.min()), int(image.max())
    for kind in (np.dtype(np.uint16), np.dtype(np.int32)):
        span = np.iinfo(kind)
        if span.min <= low and high <= span.max:
            return image.astype(kind)
    return image


_CLOCK = TimeSource("the camera's clock", "the camera gives no time", "the camera's is")
_MOST_SNAPPED = 2.0
"""A camera that knows certain exposure times only takes the nearest: by at most this factor, or the image
is not ours. Chosen by hand, for steps of factor two."""


@dataclass(frozen=True, slots=True)
class Told:
    """What a camera reports of its last exposure.

    Attributes
    ----------
    start : datetime or None
        By its own clock, aware UTC.
    """

    start: datetime | None = None
    duration_s: float | None = None


@dataclass(frozen=True, slots=True)
class Exposure:
    """What was ordered, and when, by our clock.

    Attributes
    ----------
    ordered : datetime
        When the order went out.
    accepted : datetime
        When it was answered.
    before : Told
        What the camera reported of the exposure before this one.
    """

    exposure_s: float
    ordered: datetime
    accepted: datetime
    before: Told = Told()

    def is_new(self, told: Told) -> bool:
        """Whether the camera reports a beginning that it did not report before."""
        return told.start is not None and told.start != self.before.start

    def is_of_another(
        self,
        told: Told,
        came: datetime | None = None,
        tolerance_s: float = 1.0,
        *,
        clocks_agree: bool = False,
    ) -> bool:
        """Whether the image that is ready is of an earlier exposure, or of another program's.

        Parameters
        ----------
        came : datetime, optional
            When it was seen to be ready, by our clock; without it times are not compared.
        clocks_agree : bool
            Whether the camera's clock agreed with ours lately.
        """
        if told.start is not None and told.start.microsecond and told.start == self.before.start:
            # whole seconds are no fingerprint
            return True
        middle = self.told_middle(told)
        moments = None if came is None or middle is None else self._moments(came)
        if clocks_agree and moments and middle and moments.are_after(middle, tolerance_s):
            return True
        if not lasted_otherwise(told.duration_s, self.exposure_s):
            return False
        # some cameras know certain exposures only, and take the nearest
        near = told.duration_s is not None and (
            1.0 / _MOST_SNAPPED <= told.duration_s / self.exposure_s <= _MOST_SNAPPED
        )
        fits = moments and middle and moments.allow(middle, tolerance_s)
        return not (near and fits and self.is_new(told))

    def middle(self, told: Told, came: datetime, tolerance_s: float) -> tuple[datetime, str]:
        """Mid-exposure, and whose clock says so; see `Moments.middle`.

        Parameters
        ----------
        came : datetime
            When the image was seen to be ready, by our clock.
        tolerance_s : float
            How far the camera's time may lie outside what our clock allows.
        """
        return self._moments(came).middle(self.told_middle(told), tolerance_s, _CLOCK)

    def told_middle(self, told: Told) -> datetime | None:
        """Mid-exposure by the camera's clock."""
        if told.start is None:
            return None
        return told.start + timedelta(seconds=(told.duration_s or self.exposure_s) / 2.0)

    def _moments(self, came: datetime) -> ExposureTimes:
        begun = self.ordered + (self.accepted - self.ordered) / 2
        return ExposureTimes(self.exposure_s, self.ordered, begun, came)
