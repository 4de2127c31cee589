"""`mountnav catalog`: what the embedded catalog holds, and its stars round a place."""

from __future__ import annotations

import json
import math
import sys

from mountnav.catalog.embedded import EMBEDDED_PATH, embedded_catalog
from mountnav.sky.coordinates import Icrs, utc_now

_J2000_UNIX_S = 946_728_000.0
_JULIAN_YEAR_S = 365.25 * 86400.0


def show_info(as_json: bool) -> None:
    """Print name, number of stars, file and size."""
    catalog = embedded_catalog()
    facts: dict[str, object] = {
        "name": catalog.name,
        "stars": len(catalog),
        "file": str(EMBEDDED_PATH),
        "size_mb": round(EMBEDDED_PATH.stat().st_size / 1e6, 2),
    }
    if as_json:
        sys.stdout.write(json.dumps(facts) + "\n")
        return
    for name, value in facts.items():
        sys.stdout.write(f"{name:8} {value}\n")


def show_cone(
    ra_deg: float,
    dec_deg: float,
    radius_deg: float,
    mag_limit: float | None,
    epoch_yr: float | None,
    as_json: bool,
) -> None:
    """Print the stars round a place; JSON lines with `as_json`."""
    when_yr = (
        2000.0 + (utc_now().timestamp() - _J2000_UNIX_S) / _JULIAN_YEAR_S if epoch_yr is None else epoch_yr
    )
    stars = embedded_catalog().cone(
        Icrs(ra_deg % 360.0, dec_deg), radius_deg, epoch_yr=when_yr, mag_limit=mag_limit
    )
    columns = {
        "ra_deg": (stars.ra_deg, 7),
        "dec_deg": (stars.dec_deg, 7),
        "mag": (stars.mag, 2),
        "sigma_arcsec": (stars.sigma_arcsec, 3),
        "pm_ra_cosdec_mas_yr": (stars.pm_ra_cosdec_mas_yr, 1),
        "pm_dec_mas_yr": (stars.pm_dec_mas_yr, 1),
    }
    if as_json:
        for row in range(len(stars)):
            values = {name: float(column[row]) for name, (column, _) in columns.items()}
            finite = {name: value if math.isfinite(value) else None for name, value in values.items()}
            sys.stdout.write(json.dumps(finite) + "\n")
        return
    sys.stdout.write(
        f"# {len(stars)} stars of {stars.source}, epoch J{stars.epoch_yr:.2f}, mag in {stars.band}\n"
    )
    sys.stdout.write("  ".join(f"{name:>12}" for name in columns) + "\n")
    for row in range(len(stars)):
        cells = (
            f"{column[row]:>{max(12, len(name))}.{digits}f}" for name, (column, digits) in columns.items()
        )
        sys.stdout.write("  ".join(cells) + "\n")
