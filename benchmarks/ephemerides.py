"""How right the places of moving targets are, against other people's programs and lists.

Run it as ``python -m benchmarks.ephemerides``. With ``--whole de440.bsp`` planets are compared with
skyfield's by the whole DE440 instead of the shipped excerpt. With ``--python OTHER`` orbits are also compared
with REBOUND's IAS15, in another environment's Python that has `rebound`. Skyfield is a development
dependency.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from skyfield.api import EarthSatellite as SkyfieldSatellite
from skyfield.api import Loader, load_file, wgs84

from mountnav.ephemeris.any_text import read_elements
from mountnav.ephemeris.elements import OrbitElements, by_mean_anomaly
from mountnav.ephemeris.satellite import EarthSatellite, _teme_to_gcrs
from mountnav.ephemeris.small_body import SmallBody, _Way
from mountnav.ephemeris.tle import checksum, read_tle
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.iers import earth_orientation
from mountnav.sky.kernel import SHIPPED_PATH, barycentric_state_km
from mountnav.sky.observer import site_geocentric_km
from mountnav.sky.planets import BODIES, position_of_body
from mountnav.sky.sphere import separation_arcsec
from mountnav.units import AU_KM

SITE = Site(40.0, -105.0, 1600.0)
SYSTEMS = ("mars", "jupiter", "saturn", "uranus", "neptune", "pluto")
ORBITS = (
    ("main belt", 2.7660, 0.0785, 145.85, 10.587, 80.255, 73.42),
    ("Amor", 1.4583, 0.2227, 310.55, 10.828, 304.29, 178.9),
    ("Aten", 0.9227, 0.1911, 180.0, 3.33, 204.4, 126.4),
    ("Apollo near the Sun", 1.078, 0.8269, 50.0, 22.8, 88.0, 31.4),
    ("Trojan", 5.2, 0.147, 10.0, 10.3, 316.5, 133.0),
)
MPC = (
    "00001    3.33  0.15 K232P  17.21569   73.47045   80.26013   10.58634  0.0788175  0.21411523   2.7671817"
    "  0 MPO719049  7258 123 1801-2022 0.65 M-v 30l MPCLINUX   0000      (1) Ceres              20220916",
    "00001    3.34  0.15 K243V 102.95074   73.36090   80.25352   10.58760  0.0790273  0.21412733   2.7670775"
    "  0 E2024-C06  7335 124 1801-2023 0.65 M-v 30k MPCLINUX   0000      (1) Ceres              20230618",
    "00001    3.34  0.15 K2555 188.70269   73.27343   80.25221   10.58780  0.0794013  0.21424651   2.7660512"
    "  0 E2024-V47  7330 125 1801-2024 0.80 M-v 30k MPCLINUX   4000      (1) Ceres              20241101",
)
"""Lines of MPCORB.DAT of three years."""

REBOUND = """
import json, sys, rebound
told = json.loads(sys.stdin.read())
sim = rebound.Simulation(); sim.G = 1.0; sim.integrator = "ias15"
for gm, p, v in told["bodies"]:
    sim.add(m=gm, x=p[0], y=p[1], z=p[2], vx=v[0], vy=v[1], vz=v[2])
last = len(told["bodies"]) - 1
def einstein(reb):
    P = reb.contents.particles; a, b = P[last], P[0]
    r = [a.x - b.x, a.y - b.y, a.z - b.z]; v = [a.vx - b.vx, a.vy - b.vy, a.vz - b.vz]
    d = sum(x * x for x in r) ** 0.5; gm = told["bodies"][0][0]; c = 173.14463267424034
    rv = sum(x * y for x, y in zip(r, v)); vv = sum(x * x for x in v)
    k = gm / (c * c * d ** 3)
    a.ax += k * ((4 * gm / d - vv) * r[0] + 4 * rv * v[0])
    a.ay += k * ((4 * gm / d - vv) * r[1] + 4 * rv * v[1])
    a.az += k * ((4 * gm / d - vv) * r[2] + 4 * rv * v[2])
sim.additional_forces = einstein; sim.force_is_velocity_dependent = 1
out = []
for day in told["days"]:
    sim.integrate(day); p = sim.particles[last]; out.append([p.x, p.y, p.z])
print(json.dumps(out))
"""


def planets(whole: Path | None) -> None:
    with tempfile.TemporaryDirectory() as folder:
        timescale = Loader(folder).timescale(builtin=True)
    ephemeris = load_file(str(whole or SHIPPED_PATH))
    here = ephemeris["earth"] + wgs84.latlon(SITE.latitude_deg, SITE.longitude_deg, SITE.height_m)
    days = np.random.default_rng(7).uniform(1.0, 4200.0, 200)
    source = "the whole DE440" if whole else "the excerpt"
    print(f"against skyfield with {source}, {len(days)} instants, 2015 to 2026")
    for name in BODIES:
        body = ephemeris[f"{name} barycenter" if name in SYSTEMS else name]
        worst = 0.0
        for day in days:
            utc = datetime(2015, 1, 2, tzinfo=UTC) + timedelta(days=float(day))
            ra, dec, _ = here.at(timescale.from_datetime(utc)).observe(body).radec()
            there = Icrs(float(ra.hours) * 15.0, float(dec.degrees))
            worst = max(worst, separation_arcsec(there, position_of_body(name, utc, SITE)))
        print(f"  {name:<8} {worst:8.4f}″")


def minor_planets(python: Path | None) -> None:
    print("elements of Ceres of the MPC, a year and more apart: the farthest two places")
    bodies = [SmallBody(read_elements(line)[0]) for line in MPC]
    for day in (
        datetime(2024, 3, 31, tzinfo=UTC),
        datetime(2025, 5, 5, tzinfo=UTC),
        datetime(2026, 5, 5, tzinfo=UTC),
    ):
        places = [body.icrs(day, SITE) for body in bodies]
        worst = max(separation_arcsec(a, b) for a in places for b in places)
        print(f"  {day:%Y-%m-%d} {worst:8.3f}″")
    begin = time.perf_counter()
    SmallBody(read_elements(MPC[1])[0]).icrs(datetime(2025, 3, 31, tzinfo=UTC), SITE)
    print(f"  a year integrated in {time.perf_counter() - begin:.2f} s")
    if python is None:
        return
    print("against REBOUND's IAS15 with all planets as bodies, as seen from 1 au")
    days = [30.0, 180.0, 365.25, 730.5]
    for name, a, e, anomaly, incl, node, peri in ORBITS:
        q, tp = by_mean_anomaly(a, e, anomaly, 2460200.5)
        elements = OrbitElements(name, 2460200.5, q, e, incl, node, peri, tp)
        told = json.dumps({"bodies": _bodies(elements), "days": days})
        out = subprocess.run(
            [python, "-c", REBOUND], input=told, capture_output=True, text=True, check=True, env={}
        )
        way = _Way(elements, forward=True)
        apart = [
            float(np.linalg.norm(way.state(day)[:3] - np.array(there))) * 206_265.0
            for day, there in zip(days, json.loads(out.stdout), strict=True)
        ]
        print(
            f"  {name:<20}" + "".join(f"  {day:g} d {one:.5f}″" for day, one in zip(days, apart, strict=True))
        )


def _bodies(elements: OrbitElements) -> list[tuple[float, list[float], list[float]]]:
    from mountnav.ephemeris.small_body import _GM

    found = []
    for number, gm in _GM.items():
        state = barycentric_state_km(number, elements.epoch_jd, 0.0)
        assert state is not None
        found.append((gm, list(state[0] / AU_KM), list(state[1] / AU_KM)))
    place, velocity = elements.heliocentric(elements.epoch_jd)
    sun = found[0]
    found.append((0.0, list(place + np.array(sun[1])), list(velocity + np.array(sun[2]))))
    return found


def satellites() -> None:
    print("Earth satellites from a site, against skyfield with our polar motion")
    lines = [
        line.ljust(68) + str(checksum(line.ljust(68)))
        for line in (
            "1 25544U 98067A   24170.53020833  .00016717  00000-0  30000-3 0  999",
            "2 25544  51.6400 208.9163 0006317  69.9862 290.2231 15.4981557145",
        )
    ]
    with tempfile.TemporaryDirectory() as folder:
        timescale = Loader(folder).timescale(builtin=True)
    satellite = EarthSatellite(read_tle("\n".join(lines))[0])
    other = SkyfieldSatellite(*lines, "x", timescale)
    here = wgs84.latlon(SITE.latitude_deg, SITE.longitude_deg, SITE.height_m)
    worst = 0.0
    for minutes in np.linspace(-4000.0, 4000.0, 200):
        utc = satellite.elements.epoch_utc + timedelta(minutes=float(minutes))
        earth = earth_orientation(utc)
        timescale.polar_motion_table = (
            np.array([0.0, 1e9]),
            np.array([earth.polar_x_arcsec] * 2),
            np.array([earth.polar_y_arcsec] * 2),
        )
        wanted = (other - here).at(timescale.from_datetime(utc)).position.km
        found = _teme_to_gcrs(utc, earth) @ satellite.teme_km(utc) - site_geocentric_km(utc, SITE)[0]
        worst = max(worst, float(np.linalg.norm(found - wanted)) * 1000.0)
    print(f"  200 instants: {worst:.2f} m, {worst / 400_000 * 206_265:.2f}″ of the space station overhead")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--whole", type=Path, help="de440.bsp")
    parser.add_argument("--python", type=Path, help="a Python that has rebound")
    args = parser.parse_args()
    planets(args.whole)
    minor_planets(args.python)
    satellites()


if __name__ == "__main__":
    main()
