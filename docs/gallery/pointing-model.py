"""A pointing model from a night"""
# %% [markdown]
# A mount with known faults is sent over the sky as on an ordinary night, with a sync in the middle. From
# the looks alone the faults are found again.

# %%
from datetime import UTC, datetime, timedelta

import matplotlib.pyplot as plt
import numpy as np

import mountnav as mn
from mountnav.pointing.observation import PointingObservation
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.chain import hour_angle_to_apparent
from mountnav.sky.coordinates import GeometricHourAngle
from mountnav.sky.sphere import displaced

site, air = mn.Site(48.93, 22.27, 700.0), mn.Air(930.0)
faults = PointingErrors(
    ih_arcsec=400, id_arcsec=-250, ch_arcsec=150, np_arcsec=-60, me_arcsec=220, ma_arcsec=-310, tf_arcsec=45
)
now = datetime(2026, 11, 21, 19, tzinfo=UTC)
mount = Mechanics(site, air, faults, machine=Machine(), clock=lambda: now)

# %% [markdown]
# ## The night
#
# Sixty targets, each looked at once. A look says where the tube truly looks (to 0.5″ here) and what the
# mount believed.

# %%
random = np.random.default_rng(4)
looks = []
for number in range(60):
    ha_deg, dec_deg = random.uniform(-70, 70), random.uniform(-10, 75)
    mount.slew(hour_angle_to_apparent(GeometricHourAngle(ha_deg, dec_deg, now), site))
    while mount.slewing():
        now += timedelta(seconds=5)
    now += timedelta(minutes=4)
    east, north = random.normal(0, 0.5, 2)
    seen = displaced(mount.truth(), float(east), float(north))
    if number == 30:
        mount.sync(hour_angle_to_apparent(GeometricHourAngle(ha_deg, dec_deg, now), site))
        continue
    segment = "evening" if number < 30 else "after the sync"
    looks.append(
        PointingObservation(
            utc=now, seen=seen, sigma_arcsec=0.5, reading=mount.reported(), segment_id=segment, air=air
        )
    )
print(f"{len(looks)} looks from {looks[0].utc:%H:%M} to {looks[-1].utc:%H:%M}")

# %% [markdown]
# ## The fit
#
# The terms are those of TPOINT. Zero points belong to a stretch between two syncs, so that the sync in the
# middle does no harm.

# %%
fitted = mn.fit_pointing(looks, site=site)
terms = fitted.terms
terms["value"].info.format = terms["sigma"].info.format = ".1f"
print(terms)
print(f"rms {fitted.rms_arcsec:.2f}″; unseen targets are predicted to {fitted.leave_one_out_arcsec:.2f}″")

# %%
axes = fitted.plot()
axes.figure.set_label("What the model leaves over")

# %% [markdown]
# ## Was it right?

# %%
truth = {"CH": 150, "NP": -60, "ME": 220, "MA": -310, "TF": 45}
rows = {row["term"]: (row["value"], row["sigma"]) for row in fitted.terms}
for name, value in truth.items():
    found, sigma = rows[name]
    print(f"{name}: {value:5d}″ planted, {found:7.1f} ± {sigma:.1f} found")
    assert abs(found - value) < 5 * sigma + 1.0, name

# %%
hours, declinations = np.meshgrid(np.linspace(-75, 75, 16), np.linspace(-10, 75, 12))
moved = np.array([fitted.seen(h, d) for h, d in zip(hours.ravel(), declinations.ravel(), strict=True)])
turned = moved - np.stack([hours.ravel(), declinations.ravel()], axis=1)
turned -= np.median(turned, axis=0)  # the zero points: a sync takes them off
east = turned[:, 0] * np.cos(np.radians(declinations.ravel())) * 60
north = turned[:, 1] * 60
figure, axes = plt.subplots(
    figsize=(7, 4), num="The model over the sky without its zero points: where the tube looks, as arrows"
)
arrows = axes.quiver(
    hours.ravel() / 15, declinations.ravel(), east, north, np.hypot(east, north), cmap="viridis"
)
figure.colorbar(arrows, label="arcmin")
axes.set_xlabel("hour angle (h, west positive)")
axes.set_ylabel("declination (°)")

# %% [markdown]
# `fitted.model.save("model.json")` writes the file that the settings name; from then on slews and syncs go
# by it. On a running service `mountnav model fit` does the same with the journal's looks ([pointing
# models](../explanation/pointing-model.md)).
