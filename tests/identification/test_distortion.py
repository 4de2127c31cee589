"""Normal equations under beliefs: elimination in blocks against the plain formulae, strength by strength."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.identification.distortion import (
    BASES,
    EXTRA_PX,
    EXTRA_SPREAD,
    LEAST_SHARE,
    STRENGTHS,
    NormalEquations,
)
from mountnav.identification.plate import powers, products

UNIT_PX, FLOOR_PX = 1000.0, 0.03


def drawn(seed, count, degree):
    """Places, what is to be explained (in units), known squared errors and weights."""
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(-1, 1, (2, count))
    true = rng.normal(0, 3e-4, len(BASES[degree].kind))
    off = BASES[degree].displacements(true) @ products(u, v, degree) + rng.normal(0, 1e-4, (2, count))
    return u, v, off, rng.uniform(0.02, 0.2, count) ** 2 / UNIT_PX**2, rng.uniform(0.3, 1.0, count)


def plainly(u, v, off, known2, trust, degree):
    """Evidence, parameters and inverse of every strength at every extra error [MacKay 1992]."""
    rows = np.stack([u**i * v**j for i, j in powers(degree)], axis=1)
    design = np.concatenate((rows @ BASES[degree].x, rows @ BASES[degree].y))
    head, tail = STRENGTHS[degree].head, STRENGTHS[degree].tail
    h, s, r, b = tail.shape
    widths = np.concatenate((np.repeat(head, s * r, axis=0), tail.reshape(h * s * r, b)), axis=1)
    out = []
    for extra_px in EXTRA_PX:
        sigma2 = known2 + (extra_px / UNIT_PX) ** 2
        weight = np.tile(trust / sigma2, 2)
        normal, right = design.T @ (weight[:, None] * design), design.T @ (weight * off.ravel())
        evidence, parameters, inverses = [], [], []
        for width in widths:
            scaled = width[:, None] * normal * width + np.eye(width.size)
            inverse = width[:, None] * np.linalg.inv(scaled) * width
            unexplained = weight @ off.ravel() ** 2 - right @ inverse @ right
            evidence.append(-0.5 * unexplained - 0.5 * np.linalg.slogdet(scaled)[1] - np.log(sigma2).sum())
            parameters.append(inverse @ right)
            inverses.append(inverse)
        out.append((np.array(evidence), np.array(parameters), np.array(inverses)))
    return out


@pytest.mark.long
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@given(seed=st.integers(0, 2**32 - 1), count=st.sampled_from([5, 12, 80]))
@settings(max_examples=12, deadline=None)
def test_belief_parameters_and_covariance_are_those_of_the_plain_formulae(degree, seed, count):
    u, v, off, known2, trust = drawn(seed, count, degree)
    equations = NormalEquations(u, v, off, known2, UNIT_PX, degree)
    belief = equations.most_probable(trust, FLOOR_PX, None)
    every = plainly(u, v, off, known2, trust, degree)
    total = [
        one.max()
        + np.log(np.exp(one - one.max()).mean())
        - 0.5 * (np.log(extra_px / FLOOR_PX) / EXTRA_SPREAD) ** 2
        for (one, _, _), extra_px in zip(every, EXTRA_PX, strict=True)
    ]
    best = EXTRA_PX.index(belief.extra_px)
    assert total[best] == pytest.approx(max(total), abs=1e-4)
    evidence, parameters, inverses = every[best]
    share = np.exp(evidence - evidence.max())
    share = np.where(share > LEAST_SHARE, share, 0.0)
    share /= share.sum()
    assert np.sort(belief.share[belief.share > 0]) == pytest.approx(np.sort(share[share > 0]), rel=1e-3)
    mean, smoother = share @ parameters, np.tensordot(share, inverses, 1)
    size = np.sqrt(np.diag(smoother))
    got = equations.parameters(trust, belief)
    assert np.abs((got - mean) / size).max() < 1e-3
    apart = parameters - mean
    covariance = smoother + (apart.T * share) @ apart
    answer = equations.answer(trust, belief)
    assert np.abs((answer.smoother - smoother) / np.outer(size, size)).max() < 1e-3
    assert np.abs((answer.covariance - covariance) / np.outer(size, size)).max() < 1e-2
    left = off - BASES[degree].displacements(mean) @ products(u, v, degree)
    assert np.abs(equations.left_over(got) - left).max() < 1e-2 * np.sqrt(known2).min()


@pytest.mark.parametrize("degree", [1, 3])
def test_some_of_the_pairs_are_equations_of_their_own(degree):
    u, v, off, known2, trust = drawn(5, 40, degree)
    some = np.arange(40) % 3 > 0
    whole = NormalEquations(u, v, off, known2, UNIT_PX, degree)
    whole.most_probable(trust, FLOOR_PX, None)
    part = whole.those(some)
    alone = NormalEquations(u[some], v[some], off[:, some], known2[some], UNIT_PX, degree)
    belief = alone.most_probable(trust[some], FLOOR_PX, None)
    assert part.most_probable(trust[some], FLOOR_PX, None).extra_px == belief.extra_px
    assert np.allclose(part.parameters(trust[some], belief), alone.parameters(trust[some], belief), rtol=1e-9)
