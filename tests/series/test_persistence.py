"""Three frames make a source; what does not come again drops out."""

from __future__ import annotations

import numpy as np

from mountnav.series.persistence import PATIENCE, Persistence


def test_stars_persist_and_rays_and_satellites_drop_out() -> None:
    rng = np.random.default_rng(1)
    stars = rng.uniform(0, 1000, (200, 2))
    memory = Persistence()
    for frame in range(6):
        rays = rng.uniform(0, 1000, (30, 2))
        satellite = np.array([[100.0 + 120.0 * frame, 300.0 + 50.0 * frame]])
        seen = np.vstack((stars + rng.normal(0, 0.1, stars.shape), rays, satellite))
        ids = memory.add(seen[:, 0], seen[:, 1], np.ones(len(seen)), 1.5)
        known = memory.persistent(ids)
        assert known[:200].all() == (frame >= 2)
        assert not known[200:].any()
    sources = memory.sources()
    assert len(sources) == 200
    assert (sources.frames == 6).all()
    order = np.lexsort((sources.y_px, sources.x_px))
    true = stars[np.lexsort((stars[:, 1], stars[:, 0]))]
    assert np.abs(sources.x_px[order] - true[:, 0]).max() < 0.3


def test_a_source_may_miss_frames() -> None:
    memory = Persistence()
    x, y, flux = np.array([10.0]), np.array([20.0]), np.array([5.0])
    nothing = np.zeros(0)
    for seen in (True, False, False, True, False, True):
        ids = memory.add(x, y, flux, 1.5) if seen else memory.add(nothing, nothing, nothing, 1.5)
    assert memory.persistent(ids).all()
    assert memory.sources().frames.tolist() == [3]


def test_what_was_seen_once_is_forgotten_and_memory_stays_small() -> None:
    rng = np.random.default_rng(2)
    memory = Persistence()
    for _ in range(5 * PATIENCE):
        x, y = rng.uniform(0, 1e6, (2, 50))
        memory.add(x, y, np.ones(50), 1.5)
    assert memory._x.size <= 50 * PATIENCE
    assert len(memory.sources()) == 0


def test_going_over_to_another_frames_pixels_keeps_counts() -> None:
    memory = Persistence()
    x, y, flux = np.array([10.0, 500.0]), np.array([20.0, 600.0]), np.array([5.0, 6.0])
    first = memory.add(x, y, flux, 1.5)
    memory.add(x, y, flux, 1.5)
    memory.change_pixels(lambda x, y: (1000.0 - x, 1000.0 - y))
    ids = memory.add(1000.0 - x, 1000.0 - y, flux, 1.5)
    assert ids.tolist() == first.tolist()
    assert memory.persistent(ids).all()


def test_two_sightings_never_share_a_source() -> None:
    memory = Persistence()
    memory.add(np.array([10.0]), np.array([10.0]), np.ones(1), 2.0)
    ids = memory.add(np.array([9.5, 10.8]), np.array([10.0, 10.0]), np.ones(2), 2.0)
    assert len(set(ids.tolist())) == 2
