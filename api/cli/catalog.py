"""`mountnav catalog`: lists, describes, verifies and removes star catalogs, and lists stars.

The commands that take long are in `catalog_import`, the doctor in `catalog_doctor`.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.catalog_doctor import doctor
from api.cli.catalog_import import fetch, import_, index
from api.cli.chosen_catalogs import (
    CatalogsConfig,
    Folder,
    Name,
    folder_of,
    named_catalog,
    online_sources,
    opened_catalog,
)
from api.cli.options import DEC_OPTION, RA_OPTION, Json
from api.cli.output import print_json
from mountnav.errors import BadRequest, BadSettings
from mountnav.units import julian_year

if TYPE_CHECKING:
    from mountnav.catalog.installed import Installed
    from mountnav.catalog.packed import PackedStore
    from mountnav.settings.catalogs import OnlineSettings

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

catalog_app = typer.Typer(
    help="Star catalogs: the embedded one, imported ones, online ones.", no_args_is_help=True
)
catalog_app.command("import")(import_)


@catalog_app.command("list")
def list_(folder: Folder = None, config: CatalogsConfig = None, as_json: Json = False) -> None:
    """List the catalogs of this machine: embedded, imported, damaged, unfinished; online with --config."""
    from api.http.file_names import shown
    from mountnav.catalog.embedded import EMBEDDED_PATH, embedded_catalog
    from mountnav.catalog.installed import EMBEDDED_SLUG, Installed, installed, unfinished

    where = folder_of(folder, config)
    embedded = Installed(EMBEDDED_SLUG, EMBEDDED_PATH, embedded_catalog())
    rows = [_list_facts(embedded, "embedded")]
    rows += [_list_facts(found, "imported") for found in installed(where)]
    rows += [
        {"slug": slug, "state": "unfinished", "problem": "an unfinished import: run it again"}
        for slug in unfinished(where)
    ]
    rows += [_online_facts(source) for source in online_sources(config)]
    if as_json:
        for row in rows:
            print_json(row)
        return
    sys.stdout.write(f"# imported catalogs are in {shown(where)}\n")
    table = [_LIST_COLUMNS, *(_list_cells(row) for row in rows)]
    widths = [max(len(row[column]) for row in table) for column in range(len(_LIST_COLUMNS))]
    for cells in table:
        left, *numbers, what = cells
        padded = [left.ljust(widths[0])]
        padded += [cell.rjust(width) for cell, width in zip(numbers, widths[1:-1], strict=True)]
        sys.stdout.write("  ".join([*padded, what]) + "\n")


@catalog_app.command()
def info(
    name: Name = None, folder: Folder = None, config: CatalogsConfig = None, as_json: Json = False
) -> None:
    """Show what a catalog holds: stars, errors today by magnitude, source, terms."""
    from mountnav.catalog.installed import EMBEDDED_SLUG

    store = opened_catalog(name, folder_of(folder, config))
    facts = _info_facts(name or EMBEDDED_SLUG, store)
    if as_json:
        print_json(facts)
        return
    bins = facts.pop("magnitudes")
    width = max(len(key) for key in facts)
    for key, value in facts.items():
        sys.stdout.write(f"{key:{width}}  {'-' if value is None else value}\n")
    sys.stdout.write(f"\n{'mag':>5}  {'share':>7}  {'stars/deg2':>10}  sigma at {facts['sigma_epoch_yr']}\n")
    assert isinstance(bins, list)
    for magnitude in bins:
        sys.stdout.write(
            f"{magnitude['mag']:>2}-{magnitude['mag'] + 1:<2}  {100.0 * magnitude['share']:>5.1f} %  "
            f"{magnitude['density_deg2']:>10.4g}  {magnitude['sigma_arcsec']:.2g}″\n"
        )


@catalog_app.command()
def verify(
    name: Name = None,
    every: Annotated[bool, typer.Option("--all", help="All that are on this machine.")] = False,
    folder: Folder = None,
    config: CatalogsConfig = None,
    as_json: Json = False,
) -> None:
    """Read every byte of a catalog and compare its checksum; exit code 1 if it is damaged."""
    from api.http.file_names import shown
    from mountnav.catalog.embedded import EMBEDDED_PATH
    from mountnav.catalog.installed import EMBEDDED_SLUG, Installed, find_installed, installed

    if every and name is not None:
        raise BadRequest("both a name and --all", advice="give one of them")
    where = folder_of(folder, config)
    embedded = Installed(EMBEDDED_SLUG, EMBEDDED_PATH, None)
    if every:
        chosen = [embedded, *installed(where)]
    else:
        chosen = [embedded if name in (None, EMBEDDED_SLUG) else find_installed(where, str(name))]
    problems = 0
    for found in chosen:
        problem = _problem(found)
        problems += problem is not None
        if as_json:
            fact = {
                "slug": found.slug,
                "file": shown(found.path),
                "sound": problem is None,
                "problem": problem,
            }
            print_json(fact)
        else:
            sys.stdout.write(f"{found.slug}: {'sound' if problem is None else problem}\n")
        sys.stdout.flush()
    raise typer.Exit(1 if problems else 0)


@catalog_app.command()
def remove(
    name: Annotated[str, typer.Argument(help="As `list` has it; an unfinished import too.")],
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Don't ask.")] = False,
    folder: Folder = None,
    config: CatalogsConfig = None,
) -> None:
    """Remove an imported catalog, or what an unfinished import left."""
    from api.http.file_names import shown
    from mountnav.catalog.installed import EMBEDDED_SLUG, find_installed, unfinished
    from mountnav.catalog.installed import remove as remove_catalog

    where = folder_of(folder, config)
    if name != EMBEDDED_SLUG and name not in unfinished(where):
        find_installed(where, name)  # refuses a name that there isn't, before anything is asked
    if not yes and name != EMBEDDED_SLUG:
        if not _is_interactive():
            raise BadRequest(f"{name} would be removed for good", advice="confirm it with --yes")
        what = shown(where / f"{name}.mnc")
        if not typer.confirm(f"Remove {what}?", err=True):
            raise typer.Exit(1)
    freed_bytes = remove_catalog(where, name)
    sys.stdout.write(f"{name} is removed: {freed_bytes / 1e6:.1f} MB are free again\n")


@catalog_app.command()
def cone(
    ra: Annotated[float, RA_OPTION],
    dec: Annotated[float, DEC_OPTION],
    radius: Annotated[float, typer.Option(min=0, max=180, help="Degrees.")],
    mag: Annotated[float | None, typer.Option(help="Faintest magnitude.")] = None,
    epoch: Annotated[
        float | None, typer.Option(min=1000, max=3000, help="Julian year; now if not given.")
    ] = None,
    catalog: Annotated[
        str | None, typer.Option(help="As `list` has it; the embedded one if not given.")
    ] = None,
    folder: Folder = None,
    config: CatalogsConfig = None,
    as_json: Json = False,
) -> None:
    """List the stars round a place, brightest first."""
    from mountnav.sky.coordinates import Icrs

    stars = named_catalog(catalog, folder, config).cone(
        Icrs(ra % 360.0, dec),
        radius,
        epoch_yr=_now_yr() if epoch is None else epoch,
        mag_limit=mag,
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
            values: dict[str, object] = {name: float(column[row]) for name, (column, _) in columns.items()}
            print_json(values | {"flags": _flag_names(int(stars.flags[row]))})
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


catalog_app.command("fetch")(fetch)
catalog_app.command("doctor")(doctor)
catalog_app.command("index")(index)


def _info_facts(slug: str, store: PackedStore) -> dict[str, object]:
    from api.http.file_names import shown
    from mountnav.catalog.credits import EMBEDDED, credit_of
    from mountnav.catalog.embedded import embedded_catalog
    from mountnav.catalog.packed.contents import contents

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
                "mag": magnitude.mag,
                "share": round(magnitude.share, 5),
                "density_deg2": round(magnitude.density_deg2, 3),
                "sigma_arcsec": round(magnitude.sigma_arcsec, 6),
            }
            for magnitude in held.bins
        ],
    }


def _flag_names(flags: int) -> list[str]:
    from mountnav.catalog.stars import StarFlag

    return [(flag.name or "").lower().replace("_", "-") for flag in StarFlag if flags & flag]


def _now_yr() -> float:
    """The Julian year now."""
    from mountnav.clock import utc_now

    return julian_year(utc_now())


def _list_facts(found: Installed, state: str) -> dict[str, object]:
    from api.http.file_names import shown

    facts: dict[str, object] = {
        "slug": found.slug,
        "state": "damaged" if found.store is None else state,
        "file": shown(found.path),
    }
    try:
        facts["size_mb"] = round(found.path.stat().st_size / 1e6, 3)
    except OSError:  # a link whose target has gone
        facts["size_mb"] = None
    if found.store is None:
        return facts | {"problem": found.problem}
    header = found.store.header
    return facts | {
        "name": header.name,
        "stars": header.count,
        "band": header.band,
        "commonest_mag": round(found.store.magnitudes[2], 2),
        "faintest_mag": round(found.store.magnitudes[1], 2),
        "epoch_yr": header.epoch_yr,
        "sky_percent": float(f"{100.0 * found.store.sky_share():.3g}"),
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


def _is_interactive() -> bool:
    return sys.stdin.isatty()


def _verify(slug: str, store: PackedStore) -> None:
    """Read a catalog, under a progress bar on a terminal: some GB take some seconds."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(f"reading {slug}", total=1.0)
        store.verify(progress=lambda share: bar.update(task, completed=share))


def _problem(found: Installed) -> str | None:
    """Why a catalog is not sound; None if it is."""
    from mountnav.catalog.embedded import EMBEDDED_PATH, verify_embedded
    from mountnav.catalog.installed import EMBEDDED_SLUG

    try:
        if found.slug == EMBEDDED_SLUG and found.path == EMBEDDED_PATH:
            verify_embedded()
        elif found.store is None:
            return found.problem
        else:
            _verify(found.slug, found.store)
    except (BadSettings, OSError) as error:
        return str(error)
    return None
