"""The quick median is numpy's."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mountnav.measuring.medians import FEW, median, medians_of_rows

FLOATS = hnp.arrays(
    st.sampled_from([np.float32, np.float64]),
    st.integers(1, 40),
    elements=st.floats(-(2.0**100), 2.0**100, width=32),
)
WHOLE = hnp.arrays(
    st.sampled_from([np.uint8, np.uint16, np.int64]), st.integers(1, 40), elements=st.integers(0, 255)
)


@given(FLOATS | WHOLE)
def test_it_is_numpys_and_changes_nothing(values):
    before = values.copy()
    assert median(values) == float(np.median(values))
    assert np.array_equal(values, before)


@given(FLOATS, st.integers(0, 39))
def test_one_nan_makes_it_nan(values, place):
    values[place % values.size] = np.nan
    assert math.isnan(median(values))


@pytest.mark.parametrize("shape", [(3, 4), (5, 5), (2, 3, 4)])
def test_of_all_values_whatever_their_shape(shape):
    values = np.random.default_rng(1).normal(size=shape)[::-1]
    assert median(values) == np.median(values)


def test_of_no_values_it_is_nan():
    assert math.isnan(median(np.zeros(0)))


@pytest.mark.parametrize("size", [FEW, FEW + 1, FEW + 2, 40_001])
@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.uint16])
def test_of_many_values_it_is_numpys_too(size, dtype):
    values = (1000.0 * np.random.default_rng(size).random(size)).astype(dtype)
    before = values.copy()
    assert median(values) == float(np.median(values))
    assert np.array_equal(values, before)
    if values.dtype.kind == "f":
        values[:: size // 3] = np.inf
        assert median(values) == float(np.median(values))
        values[size // 5] = np.nan
        assert math.isnan(median(values))


@pytest.mark.parametrize("shape", [(1, 1), (9, 2), (40, 47), (40, 48)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_medians_of_rows_are_numpys(shape, dtype):
    rows = np.random.default_rng(1).normal(size=shape).astype(dtype)
    assert np.array_equal(medians_of_rows(rows), np.median(rows, axis=1))
    rows[0, 0] = np.nan
    assert np.array_equal(medians_of_rows(rows), np.median(rows, axis=1), equal_nan=True)
