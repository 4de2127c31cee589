"""Photometric zero points of a night"""
# %% [markdown]
# Each solved frame brings its zero point: the magnitude of a star of 1 ADU. Through a night it shows haze
# and clouds, and it makes magnitudes of stars that are in no catalog.

# %%
from datetime import UTC, datetime, timedelta

import matplotlib.pyplot as plt
import numpy as np

import mountnav as mn
from mountnav.catalog.embedded import embedded_catalog
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame

field = mn.Icrs(314.25, 44.33)
begin = datetime(2026, 10, 1, 19, tzinfo=UTC)
minutes = np.arange(0, 240, 10)
# a clear evening, a cloud of 0.8 mag about the second hour, haze toward the end
absorbed = 0.8 * np.exp(-(((minutes - 110) / 18) ** 2)) + 0.25 * np.clip((minutes - 180) / 60, 0, 1)
zero_points, limits = [], []
for number, (minute, dimmed) in enumerate(zip(minutes, absorbed, strict=True)):
    camera = SimulatedOptics(900, 700, 3.5, zero_point_mag=20.0 - dimmed)
    frame = draw_frame(
        field,
        camera,
        embedded_catalog(),
        exposure_s=10,
        mid_exposure_utc=begin + timedelta(minutes=int(minute)),
        seed=number,
    )
    quality = mn.solve(frame, center=field, blind=False).quality
    zero_points.append(quality.zero_point_mag)
    limits.append(quality.limiting_mag)
zero_points, limits = np.array(zero_points), np.array(limits)
print(f"{len(zero_points)} frames; clear sky: {np.median(zero_points[:6]):.2f} mag for 1 ADU in 10 s")

# %%
figure, axes = plt.subplots(figsize=(8, 3.5), num="Zero point and limiting magnitude through a night")
axes.plot(
    minutes / 60, zero_points - np.median(zero_points[:6]), "o-", label="zero point, against the evening's"
)
axes.plot(minutes / 60, -absorbed, c="gray", lw=1, label="what was drawn")
axes.set_xlabel("hours since 19:00 UTC")
axes.set_ylabel("mag")
axes.legend(loc="lower left")
second = axes.twinx()
second.plot(minutes / 60, limits, "x", c="C3")
second.set_ylabel("limiting magnitude (x)")

# %% [markdown]
# The zero points follow what was drawn, and so does the limit. These stars have no colors and their catalog
# no errors; on real frames zero points are good to hundredths.

# %%
left = (zero_points - np.median(zero_points[:6])) + absorbed
print(f"zero points are right to {np.std(left):.3f} mag, worst {np.abs(left).max():.3f}")
assert np.std(left) < 0.05

# %% [markdown]
# `mountnav accuracy FRAMES` prints the zero point and its color term for each of your frames; how they are
# made: [photometry](../explanation/photometry.md).
