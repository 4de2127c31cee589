"""`mountnav catalog import`: reads a catalog as it came, and puts a packed one into the folder."""

from __future__ import annotations

import json
import shlex
import sys
import time
from pathlib import Path

from api.cli.catalog_folder import folder_of, online_sources
from api.cli.catalog_progress import ShownProgress
from api.http.file_names import shown
from mountnav.catalog.credits import credit_of
from mountnav.catalog.importing.job import import_catalog
from mountnav.catalog.importing.order import Imported, ImportOrder
from mountnav.catalog.importing.selection import Selection
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs


def show_import(
    kind: str,
    source: Path,
    *,
    name: str | None,
    folder: Path | None,
    config: Path | None,
    mag_limit: float | None,
    cone: tuple[float, float, float] | None,
    dec_range: tuple[float, float] | None,
    force: bool,
    as_json: bool,
) -> int:
    """Import a catalog under a progress bar on stderr, and print what came of it.

    Returns
    -------
    int
        The exit code: 0, or 130 when it was interrupted.

    Raises
    ------
    MountnavError
        As `mountnav.catalog.importing.job.import_catalog`.
    """
    slug = name if name is not None else kind
    if any(one.name == slug for one in online_sources(config)):
        raise BadRequest(
            f"{slug!r} is the name of an online catalog in {config}", advice="choose another with --name"
        )
    order = ImportOrder(
        kind=kind,
        source=source,
        slug=slug,
        folder=folder_of(folder, config),
        selection=_selection(mag_limit, cone, dec_range),
        force=force,
    )
    began_s = time.monotonic()
    progress = ShownProgress()
    try:
        with progress:
            imported = import_catalog(order, tell=progress.tell, note=progress.note)
    except KeyboardInterrupt:
        _tell_how_to_go_on(progress)
        return 130
    _show(imported, slug, time.monotonic() - began_s, as_json)
    return 0


def _selection(
    mag_limit: float | None, cone: tuple[float, float, float] | None, dec_range: tuple[float, float] | None
) -> Selection:
    if cone is None:
        return Selection(mag_limit=mag_limit, dec_range_deg=dec_range)
    ra_deg, dec_deg, radius_deg = cone
    if not (0.0 <= ra_deg <= 360.0 and -90.0 <= dec_deg <= 90.0):
        raise BadRequest(
            f"no place: RA {ra_deg}°, Dec {dec_deg}°", advice="--cone RA DEC RADIUS, all in degrees (ICRS)"
        )
    return Selection(mag_limit, Icrs(ra_deg % 360.0, dec_deg), radius_deg, dec_range)


def _tell_how_to_go_on(progress: ShownProgress) -> None:
    last = progress.last
    if last is None or last.parts_done == 0:
        sys.stderr.write("interrupted before a part was in: nothing is kept\n")
        return
    sys.stderr.write(
        f"interrupted: {last.parts_done} of {last.parts} parts are in and kept. The same command goes on:\n"
        f"  {shlex.join(['mountnav', *sys.argv[1:]])}\n"
    )


def _show(imported: Imported, slug: str, took_s: float, as_json: bool) -> None:
    header, size = imported.header, imported.path.stat().st_size
    if as_json:
        facts: dict[str, object] = {
            "slug": slug,
            "name": header.name,
            "file": shown(imported.path),
            "size_mb": round(size / 1e6, 3),
            "stars": header.count,
            "band": header.band,
            "epoch_yr": header.epoch_yr,
            "parts": imported.parts,
            "resumed": imported.resumed,
            "compared": imported.compared,
            "took_s": round(took_s, 1),
        }
        sys.stdout.write(json.dumps(facts) + "\n")
        return
    sys.stdout.write(
        f"{slug}: {header.count:,} stars of {header.name}, {size / 1e6:.1f} MB, in {took_s:.0f} s\n"
        f"{shown(imported.path)}\n"
        f"{imported.compared} stars of the source were looked for in it and found\n"
    )
    if (credit := credit_of(header.made_from)) is not None:
        sys.stdout.write(f"terms: {credit.terms}\n")
