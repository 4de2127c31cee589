"""Bright stars that carry the flag of "no peak": the index is asked with them before a frame is refused."""

from dataclasses import replace

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Hint
from mountnav.identification.search import Reach, identify
from mountnav.measuring.measurements import Flag
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Reason
from tests.identification.listed_sky import EPOCH, PLACES, drawn, listed

SCALE = 11.0 * 3600 / 1000
"""A field of 11° × 9°, arcsec per pixel."""


def flagged_sky(where, rng, *, noise_sources=60):
    """The stars to magnitude 7.5 as no stars, among noise that looks like stars and is fainter."""
    one = drawn(PLACES[where], rng, scale=SCALE, depth=7.5, junk=0, lost=0.0)
    m = one.measurements
    x = np.concatenate((m.x_px, rng.uniform(0, m.width_px, noise_sources)))
    y = np.concatenate((m.y_px, rng.uniform(0, m.height_px, noise_sources)))
    flux = np.concatenate((m.flux, m.flux.min() * rng.uniform(0.1, 0.9, noise_sources)))
    flags = np.zeros(x.size, dtype=np.int64)
    flags[: len(m)] = int(Flag.NO_PEAK)
    return one, listed(x, y, flux, m.width_px, m.height_px, flags)


def asked(measurements, index, hint=None):
    reach = Reach(index=index, blind="after" if hint else "only")
    return identify(measurements, embedded_catalog(), hint or Hint(), epoch_yr=EPOCH, reach=reach)


@pytest.mark.long
@pytest.mark.parametrize("where", ["anywhere", "crowded Milky Way", "near the poles"])
def test_flagged_stars_are_found_blind(sky_index, where):
    one, measured = flagged_sky(where, np.random.default_rng(3))
    got = asked(measured, sky_index)
    assert got.reference is not None, got.detail
    assert separation_arcsec(got.reference.plate.center(), one.center) < SCALE
    assert got.false_probability < 1e-9


@pytest.mark.long
def test_the_tries_without_the_flagged_ones_count_in_the_odds(sky_index):
    _, measured = flagged_sky("anywhere", np.random.default_rng(5))
    plain = asked(replace(measured, flags=np.zeros_like(measured.flags)), sky_index)
    flagged = asked(measured, sky_index)
    assert plain.reference is not None
    assert flagged.reference is not None
    assert flagged.tried > plain.tried


def test_it_is_the_last_thing_that_is_tried(sky_index):
    """A frame that is found without the flagged sources has the odds that it has without the second round."""
    one = drawn(PLACES["anywhere"], np.random.default_rng(6), scale=SCALE, depth=8.0)
    m = one.measurements
    some = np.where(np.arange(len(m)) % 5 == 4, int(Flag.NO_PEAK), 0)
    clean = np.flatnonzero(some == 0)
    columns = ("x_px", "y_px", "x_sigma_px", "y_sigma_px", "flux", "flux_sigma", "fwhm_px", "ellipticity")
    kept = replace(m, flags=some[clean], **{name: getattr(m, name)[clean] for name in columns})
    with_them, without = asked(replace(m, flags=some), sky_index), asked(kept, sky_index)
    assert with_them.reference is not None
    assert without.reference is not None
    assert with_them.tried == without.tried
    assert with_them.false_probability == without.false_probability


@pytest.mark.long
def test_flagged_noise_gives_no_answer(sky_index):
    rng = np.random.default_rng(7)
    for count in (20, 60, 200):
        flux = 10 ** rng.uniform(2, 5, count)
        flags = np.where(rng.random(count) < 0.4, int(Flag.NO_PEAK), 0)
        m = listed(rng.uniform(0, 1000, count), rng.uniform(0, 800, count), flux, 1000, 800, flags)
        got = asked(m, sky_index)
        assert got.reference is None, got.detail
        assert got.reason is not Reason.BAD_FRAME
