"""`mountnav catalog`: lists, describes, verifies and removes star catalogs, and lists stars."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from api.cli.chosen_catalogs import folder_of, named, online_sources, opened
from api.http.file_names import shown
from mountnav.catalog.credits import EMBEDDED, credit_of
from mountnav.catalog.embedded import EMBEDDED_PATH, embedded_catalog, verify_embedded
from mountnav.catalog.installed import (
    EMBEDDED_SLUG,
    Installed,
    find_installed,
    installed,
    remove,
    unfinished,
)
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.contents import contents
from mountnav.catalog.stars import StarFlag
from mountnav.clock import utc_now
from mountnav.errors import BadRequest, BadSettings
from mountnav.sky.coordinates import Icrs

if TYPE_CHECKING:
    from mountnav.settings.catalogs import OnlineSettings


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
        As `api.cli.chosen_catalogs.named`.
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


_LIST_COLUMNS = (
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
    rows = [_list_facts(one, "embedded") for one in (embedded,)]
    rows += [_list_facts(one, "imported") for one in installed(where)]
    rows += [
        {"slug": slug, "state": "unfinished", "problem": "an import that isn't ended: run it again"}
        for slug in unfinished(where)
    ]
    rows += [_online_facts(one) for one in online_sources(config)]
    if as_json:
        for row in rows:
            sys.stdout.write(json.dumps(row) + "\n")
        return
    sys.stdout.write(f"# imported catalogs are in {shown(where)}\n")
    table = [_LIST_COLUMNS, *(_list_cells(row) for row in rows)]
    widths = [max(len(row[column]) for row in table) for column in range(len(_LIST_COLUMNS))]
    for cells in table:
        left, *numbers, what = cells
        padded = [left.ljust(widths[0])]
        padded += [cell.rjust(width) for cell, width in zip(numbers, widths[1:-1], strict=True)]
        sys.stdout.write("  ".join([*padded, what]) + "\n")


def _list_facts(one: Installed, state: str) -> dict[str, object]:
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


def _online_facts(source: OnlineSettings) -> dict[str, object]:
    """What is configured, and what of it lies in the cache. Asks no server."""
    from mountnav.catalog.online import open_online

    cached = open_online(source.source(), behind=None).cached_tiles()
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


def _list_cells(row: dict[str, object]) -> tuple[str, ...]:
    what = str(row.get("name", ""))
    if row["state"] != "imported":
        what = f"{what} ({row['state']})" if what else str(row["state"])
    if "cached_stars" in row:
        what += f": {row['cached_stars']:,} stars in the cache"
    if row.get("problem"):
        what = f"{what}: {row['problem']}"
    cells = []
    for column in _LIST_COLUMNS[1:-1]:
        value = row.get(column)
        cells.append("-" if value is None else f"{value:,}" if column == "stars" else str(value))
    return (str(row["slug"]), *cells, what)


def show_verify(
    name: str | None, every: bool, folder: Path | None, config: Path | None, as_json: bool
) -> int:
    """Compare catalogs with their checksums; one line for each.

    Returns
    -------
    int
        0 if all are sound, 1 if one isn't.

    Raises
    ------
    BadRequest
        Both a name and `every`.
    Unknown
        There is no catalog of that name.
    BadSettings
        The settings file is wrong, or the folder can't be looked into.
    """
    if every and name is not None:
        raise BadRequest("both a name and --all", advice="give one of them")
    where = folder_of(folder, config)
    embedded = Installed(EMBEDDED_SLUG, EMBEDDED_PATH, None)
    if every:
        chosen = [embedded, *installed(where)]
    else:
        chosen = [embedded if name in (None, EMBEDDED_SLUG) else find_installed(where, str(name))]
    problems = 0
    for one in chosen:
        problem = _problem(one)
        problems += problem is not None
        if as_json:
            fact = {"slug": one.slug, "file": shown(one.path), "sound": problem is None, "problem": problem}
            sys.stdout.write(json.dumps(fact) + "\n")
        else:
            sys.stdout.write(f"{one.slug}: {'sound' if problem is None else problem}\n")
        sys.stdout.flush()
    return 1 if problems else 0


def show_remove(name: str, yes: bool, folder: Path | None, config: Path | None) -> int:
    """Remove a catalog, after asking once.

    Returns
    -------
    int
        0 when it is gone, 1 when the answer was no.

    Raises
    ------
    MountnavError
        As `mountnav.catalog.installed.remove`.
    BadRequest
        There is nobody to ask, and no --yes.
    """
    where = folder_of(folder, config)
    if name != EMBEDDED_SLUG and name not in unfinished(where):
        find_installed(where, name)  # a question about nothing is none
    if not yes and name != EMBEDDED_SLUG:
        if not _somebody_to_ask():
            raise BadRequest(f"{name} would be removed for good", advice="say so with --yes")
        import typer

        what = shown(where / f"{name}.mnc")
        if not typer.confirm(f"Remove {what}?", err=True):
            return 1
    freed = remove(where, name)
    sys.stdout.write(f"{name} is removed: {freed / 1e6:.1f} MB are free again\n")
    return 0


def _somebody_to_ask() -> bool:
    return sys.stdin.isatty()


def _verify(slug: str, store: PackedStore) -> None:
    """Under a progress bar, if somebody looks: some GB take some seconds."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(f"reading {slug}", total=1.0)
        store.verify(progress=lambda share: bar.update(task, completed=share))


def _problem(one: Installed) -> str | None:
    try:
        if one.slug == EMBEDDED_SLUG and one.path == EMBEDDED_PATH:
            verify_embedded()
        elif one.store is None:
            return one.problem
        else:
            _verify(one.slug, one.store)
    except (BadSettings, OSError) as error:
        return str(error)
    return None
