"""Half the stars missing, three times as many false ones: the same center. Turned frames: the same sky."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.frames import read, rendered
from benchmarks.wrong_answers import displaced_hints, listed, noise_frames, random_lists
from mountnav.catalog.embedded import embedded_catalog
from mountnav.errors import BadFrame
from mountnav.identification.search import identify
from mountnav.identification.wcs import wcs_cards
from mountnav.measuring.measure import measure
from mountnav.sky.sphere import separation_arcsec
from mountnav.sky.wcs import icrs_at_pixel


def disturbed(m, rng):
    """Every other measurement gone, and three false ones for each that there was, as bright as they."""
    kept = np.flatnonzero(rng.random(len(m)) < 0.5)
    count = 3 * len(m)
    copied = rng.integers(0, len(m), count)

    def both(values, false):
        return np.concatenate((values[kept], false))

    flux = both(m.flux, m.flux[copied] * 10 ** (0.4 * rng.normal(0, 0.3, count)))
    order = np.argsort(-flux, kind="stable")
    columns = {
        "x_px": both(m.x_px, rng.uniform(0, m.width_px - 1, count)),
        "y_px": both(m.y_px, rng.uniform(0, m.height_px - 1, count)),
        "flux": flux,
        "flags": both(m.flags, np.zeros(count, dtype=np.int64)),
    }
    for name in ("x_sigma_px", "y_sigma_px", "flux_sigma", "fwhm_px", "ellipticity"):
        columns[name] = both(getattr(m, name), getattr(m, name)[copied])
    return replace(m, elongation_deg=None, **{name: values[order] for name, values in columns.items()})


@pytest.mark.shared
@pytest.mark.parametrize(
    "names", [("A02",), pytest.param(("E00", "B01", "C00", "E03"), marks=pytest.mark.long)]
)
def test_half_the_stars_and_three_times_as_many_false_ones(shared, names):
    chosen = [known for known in rendered(shared) if known.path.name[:3] in names]
    assert len(chosen) == len(names)
    for known in chosen:
        frame = read(known)
        assert not isinstance(frame, BadFrame)
        assert known.center is not None
        assert known.scale_arcsec_px is not None
        m = disturbed(measure(frame), np.random.default_rng(17))
        got = identify(m, embedded_catalog(), known.hint, epoch_yr=2000.0)
        assert got.reference is not None, (known.path.name, got.detail)
        off = separation_arcsec(got.reference.plate.center(), known.center) / known.scale_arcsec_px
        print(f"{known.path.name}: {off:.3f} px, {got.detail}, odds {got.false_probability:.0e}")
        assert off < 0.1, (known.path.name, off, got.detail)


@pytest.mark.long
@pytest.mark.shared
def test_a_turned_frame_shows_the_same_sky(shared):
    """One pixel of the sky keeps its place, however the file is turned or mirrored."""
    known = next(one for one in rendered(shared) if one.path.name.startswith("E03"))
    frame = read(known)
    assert not isinstance(frame, BadFrame)
    assert known.scale_arcsec_px is not None
    size, at = 2048, (700.0, 1200.0)
    places, parities = [], []
    for turned, x, y in (
        (frame.pixels, at[0], at[1]),
        (np.rot90(frame.pixels), at[1], size - 1 - at[0]),
        (np.fliplr(frame.pixels), size - 1 - at[0], at[1]),
    ):
        m = measure(replace(frame, pixels=np.ascontiguousarray(turned)))
        got = identify(m, embedded_catalog(), known.hint, epoch_yr=2000.0)
        assert got.reference is not None, got.detail
        cards = wcs_cards(got.reference.plate, width_px=size, height_px=size)
        places.append(icrs_at_pixel(cards, x, y))
        parities.append(got.reference.plate.parity)
    for other in places[1:]:
        assert separation_arcsec(places[0], other) < 0.05 * known.scale_arcsec_px
    assert parities[1] == parities[0] == -parities[2]


@pytest.mark.long
@pytest.mark.shared
def test_hints_that_point_elsewhere_give_no_wrong_answer(shared):
    tiny = listed(shared, "tiny") + listed(shared, "orion2")
    assert len(tiny) == 2
    for one in displaced_hints(tiny, 10, 0.3, seed=1):
        assert one.result != "wrong", one


@pytest.mark.long
def test_lists_and_noise_that_are_no_sky_give_no_answer():
    outcomes = [*random_lists(10, 0.3, seed=2), *noise_frames(2, 0.3, seed=3)]
    assert len(outcomes) == 12
    assert not [one for one in outcomes if one.result in ("wrong", "right")]


@pytest.mark.first
@pytest.mark.long
@pytest.mark.shared
def test_twenty_hints_that_point_elsewhere(shared):
    outcomes = list(displaced_hints(listed(shared), 20, 1.0, seed=4))
    assert not [one for one in outcomes if one.result == "wrong"]
    assert sum(one.result != "right" for one in outcomes) > 15
