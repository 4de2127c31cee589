"""How accurate is a frame?"""
# %% [markdown]
# A frame is drawn at a known place, solved, and compared with the truth. So three things can be told apart:
# how far the stars lie from the catalog, how far off the center is, and whether the stated error is honest.

# %%
from datetime import UTC, datetime

import matplotlib.pyplot as plt
import numpy as np

import mountnav as mn
from mountnav.catalog.embedded import embedded_catalog
from mountnav.simulation.catalog_errors import ErringCatalog
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame

camera = SimulatedOptics(1200, 900, 3.5, rotation_deg=12.0, distortion_px2=2e-9)
sky = ErringCatalog(embedded_catalog(), seed=1)  # each star as far off as the catalog says of itself
when = datetime(2026, 12, 1, 22, 0, tzinfo=UTC)


def drawn(center: mn.Icrs, seed: int) -> mn.Frame:
    """A frame of 10 s whose center looks exactly there."""
    return draw_frame(center, camera, sky, exposure_s=10, mid_exposure_utc=when, seed=seed)


truth = mn.Icrs(314.25, 44.33)
solved = mn.solve(drawn(truth, seed=1), center=truth, blind=False)
print(
    f"{solved.solution.pairs} stars, rms {solved.solution.rms_arcsec:.2f}″ "
    f"at {solved.scale_arcsec_px:.3f} ″/px"
)

# %% [markdown]
# ## The stars
#
# Each arrow is a star, measured minus catalog, enlarged. A good plate leaves no pattern: no common
# direction, no turning, nothing that grows toward the corners.

# %%
axes = solved.plot()
axes.figure.set_label("The frame with its stars and their residuals")

# %%
stars = solved.stars
used = stars["used"]
figure, axes = plt.subplots(figsize=(7, 3), num="Residuals by magnitude")
axes.scatter(stars["mag"][used], stars["residual_east"][used], s=10, label="east")
axes.scatter(stars["mag"][used], stars["residual_north"][used], s=10, label="north")
axes.axhline(0, lw=0.8, c="gray")
axes.set_xlabel("magnitude")
axes.set_ylabel("measured minus catalog (″)")
axes.legend()

# %% [markdown]
# Most of the scatter is the catalog's: the proper motions of faint stars are not known well. The center
# rests on all stars together, so it is far better than one star.
#
# ## The center
#
# Thirty frames of thirty fields, each with its own noise. The distance from the truth, divided by the
# stated error, must be one sigma per coordinate: that is what "honest" means here.

# %%
random = np.random.default_rng(7)
off, stated = [], []
for seed in range(30):
    place = mn.Icrs(float(random.uniform(0, 360)), float(random.uniform(-10, 70)))
    found = mn.solve(drawn(place, seed), center=place, blind=False)
    seen = found.center
    off.append((seen.ra.deg - place.ra_deg) * np.cos(np.radians(place.dec_deg)) * 3600)
    off.append((seen.dec.deg - place.dec_deg) * 3600)
    stated += 2 * [found.center_sigma_arcsec]
off, stated = np.array(off), np.array(stated)
print(f"the centers are off by {np.std(off):.2f}″ per coordinate")
print(f"{np.median(stated):.2f}″ were stated")
print(f"off / stated: {np.sqrt(np.mean((off / stated) ** 2)):.1f} rms")

# %%
figure, axes = plt.subplots(figsize=(7, 3), num="Errors of the center, in units of the stated error")
axes.hist(off / stated, bins=np.arange(-4, 4.5, 0.5))
axes.set_xlabel("error of the center / stated error")
axes.set_ylabel("coordinates")
assert np.std(off) < 1.0, "the center of a frame is known to a fraction of an arcsecond"
assert np.sqrt(np.mean((off / stated) ** 2)) < 2.0, "the stated errors are honest"

# %% [markdown]
# A mount that points to 10″ is a good one. The frame is not what limits it. For real frames there is a
# command that makes the same figures: [measure accuracy](../how-to/accuracy.md).
