"""Texts about moving targets under fuzz: elements, tables, satellites, and imported files."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime, timedelta
from pathlib import Path

from mountnav.ephemeris.any_text import ephemeris_of_text, read_elements, read_satellites, read_table
from mountnav.ephemeris.imported import import_file
from mountnav.ephemeris.satellite import EarthSatellite
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Site
from mountnav.sky.kernel import SHIPPED_PATH, Kernel
from tests.ephemeris import samples
from tests.ephemeris.test_mpc import COMET, ORB, RECORD
from tests.ephemeris.test_satellite import _forms, _omm
from tests.ephemeris.test_tables import horizons, plain
from tests.fuzz import files

_SITE = Site(47.0, 11.0, 600.0)


def satellites(data: bytes) -> None:
    """Elements of satellites; those that are read have a place at their epoch, or say why not."""
    for one in read_satellites(data.decode("utf-8", "replace")):
        target = EarthSatellite(one)
        place = target.icrs(one.epoch_utc, _SITE)
        assert math.isfinite(place.ra_deg)
        assert math.isfinite(target.sigma_arcsec(one.epoch_utc))


def elements(data: bytes) -> None:
    """Orbital elements; two-body motion goes on from any of them."""
    for one in read_elements(data.decode("utf-8", "replace")):
        for days in (-400.0, 0.0, 1.0, 3000.0):
            place, velocity = one.heliocentric(one.epoch_jd + days)
            assert all(map(math.isfinite, (*place, *velocity)))
        assert math.isfinite(one.along_arcsec(3.0))


def tables(data: bytes) -> None:
    """Ephemeris tables; whatever is read has places from end to end."""
    table = read_table(data.decode("utf-8", "replace"))
    for part in (0.0, 0.33, 1.0):
        utc = table.begins_utc + part * (table.ends_utc - table.begins_utc)
        place = table.icrs(utc, _SITE)
        assert math.isfinite(place.ra_deg)
        assert -90.0 <= place.dec_deg <= 90.0
        assert table.sigma_arcsec(utc) >= 0.0


def any_text(data: bytes) -> None:
    """Whatever it is, by its looks."""
    target = ephemeris_of_text(data.decode("utf-8", "replace"))
    utc = target.begins_utc or datetime(2026, 1, 1, tzinfo=UTC)
    try:
        target.icrs(utc + timedelta(seconds=1), _SITE)
    except BadRequest:
        return


def imports(path: Path) -> None:
    """A file of many."""
    folder = files.folder() / "ephemerides"
    import_file(path, folder, "fuzzed")


def kernels(path: Path) -> None:
    """An SPK file; what is read has places in its span."""
    for segment in Kernel(path).segments[:20]:
        place, velocity = segment.state(segment.first_jd, 0.5 * (segment.last_jd - segment.first_jd))
        assert place.shape == velocity.shape == (3,)


def satellite_seeds() -> list[bytes]:
    """Two lines and the forms of the OMM."""
    return [samples.ISS.encode(), *(text.encode() for text in _forms(_omm()).values())]


def element_seeds() -> list[bytes]:
    """Lines and records of the MPC, and an answer of SBDB."""
    lines = [samples.CERES_2023, samples.HALLEY, f"{samples.HOWELL}\n{samples.PALLAS_2024}"]
    records = [RECORD, [RECORD, COMET], ORB, {"mpc_orb": ORB}]
    sbdb = samples.astroquery_file("jplsbdb", "ceres.dat").encode()
    return [*(line.encode() for line in lines), *(json.dumps(one).encode() for one in records), sbdb]


def table_seeds() -> list[bytes]:
    """Tables of Horizons in several forms, plain ones, a page of the MPC."""
    kinds = ((False, False), (False, True), (True, False), (True, True))
    made = [
        horizons(csv=csv, degrees=degrees, apparent=False, center="site").encode() for csv, degrees in kinds
    ]
    page = samples.astroquery_file("mpc", "2P_ephemeris_500-a-t.html").encode()
    return [*made, plain().encode(), page]


def import_seeds() -> list[bytes]:
    """Catalogs of each kind."""
    header = f"MINOR PLANET CENTER ORBIT DATABASE (MPCORB)\n{'-' * 80}\n"
    return [
        f"{header}{samples.CERES_2023}\n{samples.PALLAS_2024}\n".encode(),
        (samples.ISS * 3).encode(),
        json.dumps([RECORD, COMET]).encode(),
        _forms(_omm())["csv"].encode(),
    ]


def kernel_seeds() -> list[bytes]:
    """The head of the shipped excerpt, which is enough to be wrong in many ways; and all of it."""
    whole = SHIPPED_PATH.read_bytes()
    return [whole[:20_000], whole]
