"""Least squares of two unknowns that are not negative, against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from mountnav.measuring.bell import nonnegative_pair


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 20), positive=st.booleans())
def test_as_scipy_has_it(seed: int, count: int, *, positive: bool) -> None:
    rng = np.random.default_rng(seed)
    table = rng.normal(size=(count, 2)) * 10.0 ** rng.uniform(-3, 3, 2)
    if positive:  # as the table of a bell is: brightness and its square
        table = np.abs(table)
    right = 10.0 * rng.normal(size=count)
    ours = np.array(nonnegative_pair(table, right))
    theirs, misfit = nnls(table, right)
    assert (ours >= 0.0).all()
    assert np.linalg.norm(table @ ours - right) == pytest.approx(misfit, rel=1e-9, abs=1e-9)
    assert np.allclose(table @ ours, table @ theirs, rtol=1e-6, atol=1e-6)


def test_nothing_explains_what_only_falls() -> None:
    assert nonnegative_pair(np.array([[1.0, 1.0], [1.0, 2.0]]), np.array([-1.0, -2.0])) == (0.0, 0.0)


def test_a_column_of_zeros_gets_nothing() -> None:
    assert nonnegative_pair(np.array([[0.0, 1.0], [0.0, 2.0]]), np.array([3.0, 6.0])) == pytest.approx(
        (0.0, 3.0)
    )
