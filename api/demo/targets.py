"""Five targets for the demo: named stars that are up now, spread over the sky."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise, permutations

from mountnav.catalog.stars import Catalog
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from mountnav.units import julian_year

ALTITUDES_DEG = (30.0, 75.0)
"""Between which targets are chosen. chosen: lower ones stand in thick air and near horizons, and near the
zenith an azimuth means little. With the named stars five are up between them at each hour
(tests/api/demo/test_targets.py)."""
SEARCH_RADIUS_DEG = 0.1
"""Round the rough position of a named star. It is good to 0.001°, and the fastest of them moves by 2.3″ a
year; a wider circle could hold another star as bright."""
FAINTEST_MAG = 5.0
"""Of that search: the named stars are brighter than V = 3.5, and their neighbors are left out."""
# Rough ICRS positions (IAU star names); the catalog gives the exact ones of date.
# All are brighter than V = 3.5.
NAMED_STARS: dict[str, tuple[float, float]] = {
    "Alpheratz": (2.097, 29.090),
    "Caph": (2.295, 59.150),
    "Diphda": (10.897, -17.987),
    "Mirach": (17.433, 35.621),
    "Almach": (30.975, 42.330),
    "Hamal": (31.793, 23.462),
    "Menkar": (45.570, 4.090),
    "Mirfak": (51.081, 49.861),
    "Alcyone": (56.871, 24.105),
    "Aldebaran": (68.980, 16.509),
    "Capella": (79.172, 45.998),
    "Bellatrix": (81.283, 6.350),
    "Elnath": (81.573, 28.608),
    "Alnilam": (84.053, -1.202),
    "Menkalinan": (89.882, 44.947),
    "Alhena": (99.428, 16.399),
    "Castor": (113.650, 31.888),
    "Procyon": (114.826, 5.225),
    "Pollux": (116.329, 28.026),
    "Alphard": (141.897, -8.659),
    "Regulus": (152.093, 11.967),
    "Algieba": (154.993, 19.842),
    "Merak": (165.460, 56.382),
    "Dubhe": (165.932, 61.751),
    "Denebola": (177.265, 14.572),
    "Phecda": (178.458, 53.695),
    "Alioth": (193.507, 55.960),
    "Cor Caroli": (194.007, 38.318),
    "Vindemiatrix": (195.544, 10.959),
    "Spica": (201.298, -11.161),
    "Alkaid": (206.885, 49.313),
    "Arcturus": (213.915, 19.182),
    "Izar": (221.247, 27.074),
    "Kochab": (222.676, 74.156),
    "Alphecca": (233.672, 26.715),
    "Unukalhai": (236.067, 6.426),
    "Kornephoros": (247.555, 21.490),
    "Rasalhague": (263.734, 12.560),
    "Eltanin": (269.152, 51.489),
    "Vega": (279.235, 38.784),
    "Albireo": (292.680, 27.960),
    "Altair": (297.696, 8.868),
    "Sadr": (305.557, 40.257),
    "Deneb": (310.358, 45.280),
    "Alderamin": (319.645, 62.586),
    "Enif": (326.047, 9.875),
    "Scheat": (345.944, 28.083),
    "Markab": (346.190, 15.205),
}


@dataclass(frozen=True, slots=True)
class Target:
    """A named star at its position of date."""

    name: str
    position: Icrs
    altitude_deg: float
    azimuth_deg: float


def targets_up_now(
    utc: datetime,
    site: Site,
    air: Air,
    catalog: Catalog,
    *,
    count: int = 5,
    altitudes_deg: tuple[float, float] = ALTITUDES_DEG,
) -> list[Target]:
    """`count` named stars between two altitudes, spread as widely as they allow.

    The first is the one nearest the south, each further one the star farthest from those already chosen.

    Returns
    -------
    list of Target
        In the order whose shortest slew is the longest: a sync at one says least about the next.
    """
    up = [star for star in _placed(utc, site, air, catalog) if _between(star.altitude_deg, altitudes_deg)]
    up.sort(key=lambda star: abs(star.azimuth_deg - 180.0))
    chosen = up[:1]
    while len(chosen) < min(count, len(up)):
        chosen.append(
            max(
                (star for star in up if star not in chosen),
                key=lambda star: min(separation_arcsec(star.position, other.position) for other in chosen),
            )
        )
    orders: list[tuple[Target, ...]] = list(permutations(chosen))
    longest: tuple[Target, ...] = max(orders, key=_shortest_slew_arcsec)
    return list(longest)


def _shortest_slew_arcsec(order: Sequence[Target]) -> float:
    return min((separation_arcsec(a.position, b.position) for a, b in pairwise(order)), default=0.0)


def _placed(utc: datetime, site: Site, air: Air, catalog: Catalog) -> list[Target]:
    stars = []
    for name, (ra_deg, dec_deg) in NAMED_STARS.items():
        near = catalog.cone(
            Icrs(ra_deg, dec_deg), SEARCH_RADIUS_DEG, epoch_yr=julian_year(utc), mag_limit=FAINTEST_MAG
        )
        if len(near) == 0:
            continue
        position = Icrs(float(near.ra_deg[0]), float(near.dec_deg[0]))
        seen = icrs_to_observed(position, utc, site, air)
        stars.append(Target(name, position, seen.alt_deg, seen.az_deg))
    return stars


def _between(value: float, bounds: tuple[float, float]) -> bool:
    return bounds[0] <= value <= bounds[1]
