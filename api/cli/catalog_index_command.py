"""`mountnav catalog index`: builds the index for blind solving, or tells where it lies."""

from __future__ import annotations

import json
import sys
import time

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.packed import PackedStore
from mountnav.identification.blind.cache import cached_index
from mountnav.identification.blind.index import BlindIndex


def show_index(force: bool, as_json: bool) -> None:
    """Build the index if it isn't there (or anyhow, with `force`), and print where it is.

    Raises
    ------
    BadSettings
        The cache can't be written.
    """
    began = time.monotonic()
    index, built = _opened(embedded_catalog(), force=force)
    facts: dict[str, object] = {
        "file": str(index.path),
        "size_mb": round(index.path.stat().st_size / 1e6, 1),
        "quads": len(index),
        "catalog": index.header.catalog,
        "built": built,
        "took_s": round(time.monotonic() - began, 1),
    }
    if as_json:
        sys.stdout.write(json.dumps(facts) + "\n")
        return
    state = f"built in {facts['took_s']} s" if built else "was there already (--force builds it anew)"
    sys.stdout.write(
        f"{facts['file']}  {facts['size_mb']} MB  {len(index)} quads of {facts['catalog']}, {state}\n"
    )


def built_with_progress(catalog: PackedStore) -> BlindIndex:
    """Open the index of a catalog; if it has to be built first, under a progress bar on stderr.

    Raises
    ------
    BadSettings
        The cache can't be written.
    """
    return _opened(catalog, force=False)[0]


def _opened(catalog: PackedStore, *, force: bool) -> tuple[BlindIndex, bool]:
    """The index, and whether it was built here."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    told: list[float] = []
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("building the index for blind solving"),
        BarColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    task = bar.add_task("", total=1.0)

    def tell(share: float) -> None:
        if not told:
            bar.start()  # not before something is to be seen: an index that is there is opened silently
            if not console.is_terminal:
                sys.stderr.write("building the index for blind solving: once, about half a minute\n")
        told.append(share)
        bar.update(task, completed=share)

    try:
        index = cached_index(catalog, progress=tell, force=force)
    finally:
        if told:
            bar.stop()
    return index, bool(told)
