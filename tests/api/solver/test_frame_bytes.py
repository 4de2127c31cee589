"""Pixels cross a network without loss, and what is damaged is told."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as of_numpy

from api.solver.frame_bytes import DamagedPixels, pack_pixels, unpack_pixels

_PIXELS = of_numpy.arrays(
    st.sampled_from(["<u2", ">u2", "|u1", "<i4", "<f4", ">f8"]),
    of_numpy.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=20),
)


@settings(max_examples=60, deadline=None)
@given(_PIXELS)
def test_pixels_come_back_bit_by_bit(pixels: np.ndarray) -> None:
    back = unpack_pixels(pack_pixels(pixels), pixels.dtype, pixels.shape)
    assert back.dtype == pixels.dtype
    assert back.tobytes() == np.ascontiguousarray(pixels).tobytes()


@settings(max_examples=60, deadline=None)
@given(_PIXELS, st.data())
def test_what_is_cut_or_changed_never_takes_more_room_or_passes_for_another_size(
    pixels: np.ndarray,
    data: st.DataObject,
) -> None:
    content = bytearray(pack_pixels(pixels))
    cut = bytes(content[: data.draw(st.integers(0, len(content) - 1))])
    with pytest.raises(DamagedPixels):
        unpack_pixels(cut, pixels.dtype, pixels.shape)
    with pytest.raises(DamagedPixels):
        unpack_pixels(bytes(content), pixels.dtype, (pixels.shape[0] + 1, pixels.shape[1]))
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= data.draw(st.integers(1, 255))
    try:
        changed = unpack_pixels(bytes(content), pixels.dtype, pixels.shape)
    except DamagedPixels:
        return
    assert changed.shape == pixels.shape


def test_a_frame_of_the_sky_is_less_than_half_as_long() -> None:
    sky = np.random.default_rng(1).normal(1000, 12, (300, 400)).astype("<u2")
    assert len(pack_pixels(sky)) < 0.45 * sky.nbytes
