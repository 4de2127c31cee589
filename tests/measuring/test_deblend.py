"""Two stars in one another's light: both found at their positions and flagged; lone stars stay one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from mountnav.measuring.deblend import typical_shape
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag
from mountnav.measuring.psf import Psf
from mountnav.measuring.psf_fitting import Profiles
from tests.measuring.painted import as_frame, painted, scattered
from tests.short_part import one_in


@pytest.mark.long
@pytest.mark.parametrize(("fwhm_px", "beta"), [(2.5, 0.0), (3.5, 3.0)])
@pytest.mark.parametrize(
    ("apart_fwhm", "ratio"), one_in(2, [(0.9, 1.0), (1.0, 0.3), (1.3, 0.3), (1.5, 1.0), (2.0, 0.3)])
)
def test_both_stars_of_a_blend_are_where_they_are(
    fwhm_px: float, beta: float, apart_fwhm: float, ratio: float
) -> None:
    size, count, pairs = (640, 640), 81, 16
    x, y = scattered(count, size, seed=41, margin=30.0)
    turn = np.random.default_rng(42).uniform(0.0, 2.0 * np.pi, pairs)
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    double = np.random.default_rng(43).permutation(count)[:pairs]
    first = np.c_[x, y][double]
    second = first + apart_fwhm * fwhm_px * along
    image = painted(
        np.r_[x, second[:, 0]],
        np.r_[y, second[:, 1]],
        np.r_[np.full(count, 5e4), np.full(pairs, 5e4 * ratio)],
        fwhm_px=fwhm_px,
        beta=beta,
        size=size,
        seed=44,
    )
    found = measure(as_frame(image))
    tree = KDTree(np.c_[found.x_px, found.y_px])
    blended = (found.flags & int(Flag.BLENDED)) > 0
    for positions, electrons in ((first, 5e4), (second, 5e4 * ratio)):
        distance, index = tree.query(positions)
        assert np.mean(distance < 0.3 * fwhm_px) >= 0.9
        good = distance < 0.3 * fwhm_px
        off = (np.c_[found.x_px, found.y_px][index] - positions)[good]
        sigma = np.c_[found.x_sigma_px, found.y_sigma_px][index][good]
        outward = (off * along[good]).sum(axis=1)
        sure = np.sqrt((sigma**2).mean(axis=1))
        # unbiased: the mean along the line that joins them is zero within its error
        assert abs(outward.mean()) < 4.0 * max(outward.std(), sure.mean()) / np.sqrt(np.sum(good)) + 0.003
        assert np.sqrt(np.mean((off / sigma) ** 2)) < 2.2
        assert np.median(found.flux[index][good]) == pytest.approx(electrons, rel=0.05)
        if apart_fwhm <= 1.3:
            assert blended[index][good].all()
    lone = np.setdiff1d(np.arange(count), double)
    distance, index = tree.query(np.c_[x, y][lone])
    assert np.max(distance) < 0.1
    assert not blended[index].any()
    assert len(found) <= count + pairs + 2


def test_stars_of_many_shapes_have_no_typical_one() -> None:
    # drawn out along y, along x and along the diagonal: the medians of p, q and r are 0.2, 0.3 and 0.2
    psf = Psf()
    shapes = [((1.0, 0.3), (0.3, 0.1)), ((0.1, 0.3), (0.3, 1.0)), ((0.2, 0.19), (0.19, 0.2))] * 4
    values, vectors = np.linalg.eigh(np.array(shapes))
    ones = np.ones(len(shapes))
    fits = Profiles(
        x_px=ones,
        y_px=ones,
        x_sigma_px=ones,
        y_sigma_px=ones,
        amplitude=ones,
        flux=1000.0 * ones,
        flux_sigma=ones,
        minor_fwhm_px=psf.fwhm_per_width / np.sqrt(values[:, 1]),
        major_fwhm_px=psf.fwhm_per_width / np.sqrt(values[:, 0]),
        angle_deg=np.degrees(np.arctan2(vectors[:, 1, 0], vectors[:, 0, 0])),
        misfit=0.0 * ones,
        chi2=ones,
        converged=ones > 0,
    )
    wide_px = float(np.median(np.sqrt(fits.minor_fwhm_px * fits.major_fwhm_px)))
    alike = Profiles(**{name: getattr(fits, name)[2::3].repeat(3) for name in Profiles.__dataclass_fields__})
    every = ones > 0
    assert typical_shape(alike, every, wide_px, psf) is not None
    assert typical_shape(fits, every, wide_px, psf) is None
