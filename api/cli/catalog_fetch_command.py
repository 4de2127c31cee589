"""`mountnav catalog fetch`: an area of an online catalog into the cache, for a night without network."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from api.cli.catalog_folder import online_catalog
from mountnav.sky.coordinates import Icrs


def show_fetch(
    name: str,
    config: Path,
    *,
    ra_deg: float,
    dec_deg: float,
    radius_deg: float,
    mag_limit: float | None,
    timeout_s: float | None,
    as_json: bool,
) -> int:
    """Fetch what isn't in the cache yet, and print what came.

    Returns
    -------
    int
        0 if the whole area is in the cache now, 1 if some of it didn't come.

    Raises
    ------
    Unknown
        The settings file has no online catalog of that name.
    BadRequest
        The area is too large.
    BadSettings
        The settings file is wrong.
    """
    catalog = online_catalog(name, config)
    center = Icrs(ra_deg % 360.0, dec_deg)
    with _shown(f"asking {catalog.source.host}") as tell:
        came = catalog.prefetch(center, radius_deg, mag_limit=mag_limit, timeout_s=timeout_s, progress=tell)
    cached = catalog.cached_tiles()
    if as_json:
        facts = {
            "name": name,
            "tiles": came.tiles,
            "fetched": came.fetched,
            "problem": came.problem,
            "cached_stars": cached.stars,
            "cached_mb": round(cached.size_bytes / 1e6, 3),
        }
        sys.stdout.write(json.dumps(facts) + "\n")
    else:
        sys.stdout.write(
            f"{name}: {came.fetched} tiles came, the area has {came.tiles}; in the cache are now "
            f"{cached.tiles} tiles, {cached.stars:,} stars, {cached.size_bytes / 1e6:.1f} MB\n"
        )
        if came.problem is not None:
            sys.stdout.write(
                f"not all of it: {came.problem}. The same command goes on where it ended"
                f"{'; --timeout gives a slow server more time' if 'within' in came.problem else ''}\n"
            )
    return 0 if came.problem is None else 1


@contextmanager
def _shown(what: str) -> Iterator[Callable[[int, int], None]]:
    """Say on stderr how many tiles came: a progress bar to a person, else a line for each."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda came, wanted: print(f"{what}: {came} of {wanted} tiles", file=sys.stderr, flush=True)
        return
    # the time goes on while a slow server is waited for
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda came, wanted: bar.update(task, completed=came, total=wanted)
