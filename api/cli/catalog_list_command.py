"""`mountnav catalog list`: the catalogs at hand, the damaged ones, the unfinished imports, those online."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from api.cli.catalog_folder import folder_of, online_sources
from api.http.file_names import shown
from mountnav.catalog.embedded import EMBEDDED_PATH, embedded_catalog
from mountnav.catalog.installed import EMBEDDED_SLUG, Installed, installed, unfinished

if TYPE_CHECKING:
    from mountnav.settings.catalogs import OnlineSettings

_COLUMNS = (
    "slug",
    "stars",
    "band",
    "commonest_mag",
    "faintest_mag",
    "epoch_yr",
    "sky_percent",
    "size_mb",
    "what",
)


def show_list(folder: Path | None, config: Path | None, as_json: bool) -> None:
    """Print one line for each catalog: the embedded one, the imported ones, then the online ones.

    Raises
    ------
    BadSettings
        The settings file is wrong, or the folder can't be looked into.
    """
    where = folder_of(folder, config)
    embedded = Installed(EMBEDDED_SLUG, EMBEDDED_PATH, embedded_catalog())
    rows = [_facts(one, "embedded") for one in (embedded,)]
    rows += [_facts(one, "imported") for one in installed(where)]
    rows += [
        {"slug": slug, "state": "unfinished", "problem": "an import that isn't ended: run it again"}
        for slug in unfinished(where)
    ]
    rows += [_online(one) for one in online_sources(config)]
    if as_json:
        for row in rows:
            sys.stdout.write(json.dumps(row) + "\n")
        return
    sys.stdout.write(f"# imported catalogs are in {shown(where)}\n")
    table = [_COLUMNS, *(_cells(row) for row in rows)]
    widths = [max(len(row[column]) for row in table) for column in range(len(_COLUMNS))]
    for cells in table:
        left, *numbers, what = cells
        padded = [left.ljust(widths[0])]
        padded += [cell.rjust(width) for cell, width in zip(numbers, widths[1:-1], strict=True)]
        sys.stdout.write("  ".join([*padded, what]) + "\n")


def _facts(one: Installed, state: str) -> dict[str, object]:
    facts: dict[str, object] = {
        "slug": one.slug,
        "state": "damaged" if one.store is None else state,
        "file": shown(one.path),
    }
    try:
        facts["size_mb"] = round(one.path.stat().st_size / 1e6, 3)
    except OSError:  # a link whose target has gone
        facts["size_mb"] = None
    if one.store is None:
        return facts | {"problem": one.problem}
    header = one.store.header
    return facts | {
        "name": header.name,
        "stars": header.count,
        "band": header.band,
        "commonest_mag": round(one.store.magnitudes[2], 2),
        "faintest_mag": round(one.store.magnitudes[1], 2),
        "epoch_yr": header.epoch_yr,
        "sky_percent": float(f"{100.0 * one.store.sky_share():.3g}"),
    }


def _online(source: OnlineSettings) -> dict[str, object]:
    """What is configured, and what of it lies in the cache. Asks no server."""
    from mountnav.catalog.online import open_online

    cached = open_online(source, behind=None).cached_tiles()
    return {
        "slug": source.name,
        "state": "online",
        "name": source.table or source.url,
        "band": source.band,
        "faintest_mag": source.mag_limit,
        "epoch_yr": source.epoch_yr,
        "url": source.url,
        "cached_stars": cached.stars,
        "cached_deg2": round(cached.area_deg2, 2),
        "cached_from": cached.oldest or None,
        "size_mb": round(cached.size_bytes / 1e6, 3),
    }


def _cells(row: dict[str, object]) -> tuple[str, ...]:
    what = str(row.get("name", ""))
    if row["state"] != "imported":
        what = f"{what} ({row['state']})" if what else str(row["state"])
    if "cached_stars" in row:
        what += f": {row['cached_stars']:,} stars in the cache"
    if row.get("problem"):
        what = f"{what}: {row['problem']}"
    cells = []
    for column in _COLUMNS[1:-1]:
        value = row.get(column)
        cells.append("-" if value is None else f"{value:,}" if column == "stars" else str(value))
    return (str(row["slug"]), *cells, what)
