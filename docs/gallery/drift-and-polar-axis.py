"""Drift and polar alignment"""
# %% [markdown]
# A mount whose polar axis is 8′ off follows three stars, with a look each minute. The drift shows where the
# axis stands and how far to turn it, without a special procedure: looks of an ordinary night do.

# %%
from datetime import UTC, datetime, timedelta

import matplotlib.pyplot as plt
import numpy as np

import mountnav as mn
from mountnav.pointing.drift import drift_report
from mountnav.pointing.observation import PointingObservation
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.chain import hour_angle_to_apparent
from mountnav.sky.coordinates import GeometricHourAngle
from mountnav.sky.sphere import displaced

site, air = mn.Site(48.93, 22.27, 700.0), mn.Air(930.0)


def watch(faults: PointingErrors, minutes: int = 40) -> list[PointingObservation]:
    """Looks of a night that follows three stars, at three hour angles."""
    now = datetime(2026, 11, 21, 20, tzinfo=UTC)
    mount = Mechanics(site, air, faults, machine=Machine(), clock=lambda: now)
    random, looks = np.random.default_rng(1), []
    for ha_deg, dec_deg in [(0.0, 10.0), (-75.0, 35.0), (60.0, 20.0)]:
        mount.slew(hour_angle_to_apparent(GeometricHourAngle(ha_deg, dec_deg, now), site))
        while mount.slewing():
            now += timedelta(seconds=1)
        for _ in range(minutes):
            now += timedelta(minutes=1)
            east, north = random.normal(0, 0.3, 2)
            seen = displaced(mount.truth(), float(east), float(north))
            looks.append(
                PointingObservation(
                    utc=now, seen=seen, sigma_arcsec=0.3, reading=mount.reported(), segment_id="s", air=air
                )
            )
    return looks


before = PointingErrors(me_arcsec=300.0, ma_arcsec=-360.0, periodic_amplitude_arcsec=6.0)
report = drift_report(watch(before), site=site)
for stretch in report.stretches:
    rates = stretch.rates
    print(
        f"hour angle {stretch.ha_deg / 15:+.1f} h, declination {stretch.dec_deg:+.0f}°: "
        f"{rates.east_arcsec_h:+.0f} ± {rates.east_sigma_arcsec_h:.0f} ″/h east, "
        f"{rates.north_arcsec_h:+.0f} ± {rates.north_sigma_arcsec_h:.0f} ″/h north"
    )
print(report.polar.advice)
print(f"worm: ±{report.periodic.amplitude_arcsec:.1f}″ in {report.periodic.period_s:.0f} s")

# %% [markdown]
# ## Follow the advice

# %%
polar = report.polar
assert abs(polar.from_drift.me_arcsec - before.me_arcsec) < 4 * polar.from_drift.me_sigma_arcsec + 3
after = PointingErrors(
    me_arcsec=before.me_arcsec - polar.raise_arcmin * 60,
    ma_arcsec=before.ma_arcsec + polar.east_arcmin * 60 * np.cos(np.radians(site.latitude_deg)),
    periodic_amplitude_arcsec=6.0,
)
second = drift_report(watch(after), site=site)
print(f"the axis was {np.hypot(before.me_arcsec, before.ma_arcsec):.0f}″ off")
print(f"it is now {np.hypot(after.me_arcsec, after.ma_arcsec):.0f}″ off; {second.polar.advice}")
assert np.hypot(after.me_arcsec, after.ma_arcsec) < 60

# %%
figure, panels = plt.subplots(
    1, 2, figsize=(9, 3.5), sharey=True, num="The drift of three stars, before and after"
)
for axes, faults, title in zip(panels, (before, after), ("before", "after"), strict=True):
    looks = watch(faults)
    for start, name in ((0, "meridian"), (40, "5 h east"), (80, "4 h west")):
        stretch = looks[start : start + 40]
        first = stretch[0]
        drift = []
        for look in stretch:
            drift.append((look.seen.dec_deg - first.seen.dec_deg) * 3600)
        axes.plot(range(40), drift, label=name)
    axes.set_title(title)
    axes.set_xlabel("minutes")
panels[0].set_ylabel("drift in declination (″)")
panels[0].legend()

# %% [markdown]
# The same report for your own telescope: `mountnav drift` ([how](../how-to/drift.md)).
