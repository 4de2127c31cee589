"""`mountnav catalog info` and `cone`: what a catalog holds, and its stars round a place."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

from api.cli.catalog_folder import folder_of, named, opened
from api.http.file_names import shown
from mountnav.catalog.credits import EMBEDDED, credit_of
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.installed import EMBEDDED_SLUG
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.contents import contents
from mountnav.catalog.stars import StarFlag
from mountnav.sky.coordinates import Icrs, utc_now

_J2000_UNIX_S = 946_728_000.0
_JULIAN_YEAR_S = 365.25 * 86400.0


def show_info(name: str | None, folder: Path | None, config: Path | None, as_json: bool) -> None:
    """Print what a catalog says of itself, what a sample of its stars says, and whose work it is.

    Raises
    ------
    Unknown
        There is none of that name.
    BadSettings
        It is damaged, or the settings file is wrong.
    """
    store = opened(name, folder_of(folder, config))
    facts = _facts(name or EMBEDDED_SLUG, store)
    if as_json:
        sys.stdout.write(json.dumps(facts) + "\n")
        return
    bins = facts.pop("magnitudes")
    width = max(len(key) for key in facts)
    for key, value in facts.items():
        sys.stdout.write(f"{key:{width}}  {'-' if value is None else value}\n")
    sys.stdout.write(f"\n{'mag':>5}  {'share':>7}  {'stars/deg2':>10}  sigma at {facts['sigma_epoch_yr']}\n")
    assert isinstance(bins, list)
    for one in bins:
        sys.stdout.write(
            f"{one['mag']:>2}-{one['mag'] + 1:<2}  {100.0 * one['share']:>5.1f} %  "
            f"{one['density_deg2']:>10.4g}  {one['sigma_arcsec']:.2g}″\n"
        )


def show_cone(
    ra_deg: float,
    dec_deg: float,
    radius_deg: float,
    mag_limit: float | None,
    epoch_yr: float | None,
    as_json: bool,
    *,
    catalog: str | None = None,
    folder: Path | None = None,
    config: Path | None = None,
) -> None:
    """Print the stars round a place; JSON lines with `as_json`.

    Raises
    ------
    MountnavError
        As `api.cli.catalog_folder.named`.
    """
    stars = named(catalog, folder, config).cone(
        Icrs(ra_deg % 360.0, dec_deg),
        radius_deg,
        epoch_yr=_now_yr() if epoch_yr is None else epoch_yr,
        mag_limit=mag_limit,
    )
    columns = {
        "ra_deg": (stars.ra_deg, 7),
        "dec_deg": (stars.dec_deg, 7),
        "mag": (stars.mag, 2),
        "sigma_arcsec": (stars.sigma_arcsec, 3),
        "pm_ra_cosdec_mas_yr": (stars.pm_ra_cosdec_mas_yr, 1),
        "pm_dec_mas_yr": (stars.pm_dec_mas_yr, 1),
        "color_mag": (stars.color_mag, 2),
    }
    if as_json:
        for row in range(len(stars)):
            values = {name: float(column[row]) for name, (column, _) in columns.items()}
            record: dict[str, object] = {
                name: value if math.isfinite(value) else None for name, value in values.items()
            }
            sys.stdout.write(json.dumps(record | {"flags": _flag_names(int(stars.flags[row]))}) + "\n")
        return
    color = f", color {stars.color_name}" if stars.color_name else ""
    sys.stdout.write(
        f"# {len(stars)} stars of {stars.source}, epoch J{stars.epoch_yr:.2f}, mag in {stars.band}{color}\n"
    )
    for step in stars.steps:
        sys.stdout.write(f"# {step}\n")
    sys.stdout.write("  ".join(f"{name:>12}" for name in columns) + "  flags\n")
    for row in range(len(stars)):
        cells = (
            f"{column[row]:>{max(12, len(name))}.{digits}f}" for name, (column, digits) in columns.items()
        )
        sys.stdout.write("  ".join([*cells, " ".join(_flag_names(int(stars.flags[row])))]).rstrip() + "\n")


def _facts(slug: str, store: PackedStore) -> dict[str, object]:
    header, epoch_yr = store.header, round(_now_yr(), 1)
    held = contents(store, epoch_yr=epoch_yr)
    made_from = header.made_from or "mountnav's own recipe: tools/build_tycho2.py"
    credit = EMBEDDED if store is embedded_catalog() else credit_of(made_from)
    return {
        "name": store.name,
        "slug": slug,
        "stars": len(store),
        "file": shown(store.path),
        "size_mb": round(store.path.stat().st_size / 1e6, 2),
        "band": header.band,
        "color": store.color_name or None,
        "brightest_mag": round(store.magnitudes[0], 2),
        "faintest_mag": round(store.magnitudes[1], 2),
        "commonest_mag": round(store.magnitudes[2], 2),
        "epoch_yr": header.epoch_yr,
        "fastest_mas_yr": header.fastest_mas_yr,
        "with_motion_percent": round(100.0 * held.with_motion, 1),
        "with_color_percent": round(100.0 * held.with_color, 1),
        "sky_percent": float(f"{100.0 * held.sky_share:.3g}"),
        "made_from": made_from,
        "terms": None if credit is None else credit.terms,
        "credit": None if credit is None else credit.credit,
        "sha256_of_sections": header.sections_sha256,
        "healpix_nside": header.nside,
        "sampled_stars": held.sampled,
        "sigma_epoch_yr": epoch_yr,
        "magnitudes": [
            {
                "mag": one.mag,
                "share": round(one.share, 5),
                "density_deg2": round(one.density_deg2, 3),
                "sigma_arcsec": round(one.sigma_arcsec, 6),
            }
            for one in held.bins
        ],
    }


def _flag_names(flags: int) -> list[str]:
    return [(one.name or "").lower().replace("_", "-") for one in StarFlag if flags & one]


def _now_yr() -> float:
    """The Julian year now."""
    return 2000.0 + (utc_now().timestamp() - _J2000_UNIX_S) / _JULIAN_YEAR_S
