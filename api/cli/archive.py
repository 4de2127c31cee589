"""`mountnav archive`: a work list of up to millions of frames, and a store of results that only grows.

What is done with frames is in `api.archive`; lists, store and accounts are in `mountnav.archive`.
"""

from __future__ import annotations

import itertools
import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from api.cli.options import (
    Budget,
    Calibration,
    Catalog,
    Config,
    Dec,
    Json,
    Ra,
    Radius,
    Scale,
    takes_options,
)
from api.cli.output import print_json
from mountnav.errors import BadRequest, StoreFailed

if TYPE_CHECKING:
    from api.archive.chosen import RunOptions
    from mountnav.archive.folder import Folder, RunFolder
    from mountnav.archive.work_list import Chunk

MOST_JOBS = 256
"""Processes that may be asked for. Each takes some 200 MB: more is a typing error."""

CHUNK_FRAMES, MOST_CHUNK_FRAMES = 1000, 100_000
"""Frames of a chunk: minutes of one core at 5 frames a second; more than the most is a typing error. Doubled,
a killed worker loses twice as much; halved, there are twice as many files."""

CAMERAS_SHOWN = 50
"""Cameras that `learn` tells of though it learned nothing of them."""

archive_app = typer.Typer(
    name="archive",
    help="Solves archives of many frames on one or many computers, and keeps account of each frame.",
    no_args_is_help=True,
)

Where = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the archive.")]
Run = Annotated[
    str | None, typer.Option("--run", help="Which run, by the beginning of its name; else the newest.")
]
Frames = Annotated[
    list[str],
    typer.Option(
        "--frames",
        help="Files, folders, patterns or URLs; a .txt list of these; a table (.csv, .ecsv, .parquet) with a "
        "column file, and hints. May be repeated.",
    ),
]
Extension = Annotated[
    str | None, typer.Option("--hdu", "--extension", help="FITS extension, by number or name, or all.")
]
Priority = Annotated[int, typer.Option(help="Of these frames: the higher goes first.")]
ScaleLow = Annotated[float | None, typer.Option(help="Lower bound, arcseconds per pixel.")]
ScaleHigh = Annotated[float | None, typer.Option(help="Upper bound, arcseconds per pixel.")]
Profile = Annotated[
    str | None,
    typer.Option(
        help="Parameters: measured or paper; or plate: photographic plates, negative or not, all exposures."
    ),
]
Blind = Annotated[
    bool | None,
    typer.Option(
        "--blind/--no-blind",
        help="Search the whole sky and ask no hint but --scale, or never search it; else it is searched "
        "after the hint failed.",
        show_default=False,
    ),
]
Deadline = Annotated[
    float | None,
    typer.Option(
        help="Wall seconds that a frame may take before its process is killed; else what the budget allows "
        "at most, and a minute."
    ),
]
Undated = Annotated[
    str | None,
    typer.Option(help="Date (ISO) that frames without one are taken for; today, written down, if not given."),
]
Pairs = Annotated[bool, typer.Option("--pairs", help="Keep the identified stars, too.")]
Jobs = Annotated[
    int, typer.Option(min=0, max=MOST_JOBS, help="Processes that solve side by side; 0: one a core.")
]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solving:
    """What a run solves with."""

    archive: Where
    ra: Ra = None
    dec: Dec = None
    radius: Radius = None
    scale: Scale = None
    scale_low: ScaleLow = None
    scale_high: ScaleHigh = None
    blind: Blind = None
    calibration: Calibration = None
    profile: Profile = None
    budget: Budget = None
    config: Config = None
    catalog: Catalog = None
    deadline: Deadline = None
    undated: Undated = None
    pairs: Pairs = False

    def options(self) -> RunOptions:
        """As a worker on another computer understands it."""
        from api.archive.chosen import RunOptions
        from mountnav.clock import utc_now

        return RunOptions(
            config=None if self.config is None else os.path.abspath(self.config),
            catalog=self.catalog,
            profile=self.profile,
            budget_s=self.budget,
            calibration=None if self.calibration is None else os.path.abspath(self.calibration),
            blind=None if self.blind is None else "only" if self.blind else "never",
            ra_deg=self.ra,
            dec_deg=self.dec,
            radius_deg=self.radius,
            scale_arcsec_px=self.scale,
            scale_low_arcsec_px=self.scale_low,
            scale_high_arcsec_px=self.scale_high,
            deadline_s=self.deadline,
            undated_utc=self.undated if self.undated is not None else f"{utc_now():%Y-%m-%d}",
            pairs=self.pairs,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Init(_Solving):
    """A new archive."""

    frames: Frames
    hdu: Extension = None
    priority: Priority = 0
    chunk_frames: Annotated[
        int, typer.Option(min=1, max=MOST_CHUNK_FRAMES, help="Frames of a chunk: minutes of work.")
    ] = CHUNK_FRAMES


@archive_app.command()
@takes_options(_Init)
def init(asked: _Init) -> int:
    """Make an archive: a work list, and a first run with these settings. Frames are never written to."""
    from api.archive.chosen import prepared
    from api.archive.listing import listed_frames
    from mountnav.archive.folder import Folder
    from mountnav.archive.recipe import begin_run
    from mountnav.archive.work_list import add_batch

    ready = prepared(asked.options())
    waiting = listed_frames(asked.frames, asked.hdu)
    # what is wrong with the words is said before a folder is made
    first = next(waiting, None)
    if first is None:
        raise BadRequest("nothing that was named holds a frame", advice="name others")
    folder = Folder.make(asked.archive, asked.chunk_frames)
    try:
        count = add_batch(folder, itertools.chain([first], waiting), asked.priority)
        run, _ = begin_run(folder, ready.recipe)
    except BaseException:
        shutil.rmtree(asked.archive, ignore_errors=True)  # so that the same command can be given again
        raise
    _say(f"{count} frames in {_chunks(folder)} chunks; run {run.name}")
    return 0


@archive_app.command()
def add(archive: Where, frames: Frames, hdu: Extension = None, priority: Priority = 0) -> None:
    """Add frames to the work list: all of them or none."""
    from api.archive.listing import listed_frames
    from mountnav.archive.folder import Folder
    from mountnav.archive.work_list import add_batch

    folder = Folder.open(archive)
    count = add_batch(folder, listed_frames(frames, hdu), priority)
    _say(f"{count} frames added; {_chunks(folder)} chunks now")


@archive_app.command()
@takes_options(_Solving)
def again(asked: _Solving) -> int:
    """Begin another run over the same frames: other settings, catalogs, or another version of mountnav."""
    from api.archive.chosen import prepared
    from mountnav.archive.folder import Folder
    from mountnav.archive.recipe import begin_run

    folder = Folder.open(asked.archive)
    run, new = begin_run(folder, prepared(asked.options()).recipe)
    _say(f"run {run.name}" if new else f"run {run.name} has these settings already: nothing to begin")
    return 0


@archive_app.command()
def learn(archive: Where, run: Run = None) -> None:
    """Begin another run that knows the scales of cameras, as the finished chunks of this one have them.

    What was learned is a part of the new run's recipe. A frame that isn't found at the scale of its camera is
    solved as without it. Exit code 0 if something was learned, 1 if not: then no run is begun.
    """
    from api.archive.chosen import taught
    from api.cli.archive_showing import learned_words

    folder, run_folder = _opened(archive, run)
    new, found = taught(folder, run_folder)
    shown = [one for at, one in enumerate(found) if one.prior is not None or at < CAMERAS_SHOWN]
    sys.stdout.write("".join(f"{learned_words(one)}\n" for one in shown))
    if len(shown) < len(found):
        sys.stdout.write(
            f"and {len(found) - len(shown)} cameras of fewer frames, of which nothing was learned\n"
        )
    if new is None:
        _say("nothing was learned, so no run was begun: solve some chunks of each camera first")
        raise typer.Exit(1)
    _say(f"run {new.name}")


@archive_app.command()
def work(
    archive: Where,
    chunk: Annotated[
        str,
        typer.Option("--chunk", metavar="K/N", help="The part of worker K of N, counted from 0 or from 1."),
    ] = "1/1",
    jobs: Jobs = 1,
    run: Run = None,
) -> None:
    """Solve a part of the chunks: for Slurm arrays, HTCondor, GNU parallel. Shows no bar.

    Exit code 0 if this part is done, 1 if something stopped it (give the command again), 2 on bad usage.
    """
    from api.archive.solving import lanes_here
    from mountnav.archive.work_list import WorkList

    which, of = _part(chunk)
    folder, run_folder = _opened(archive, run)
    chunks = WorkList.open(folder).part(which, of)
    raise typer.Exit(_solved(folder, run_folder, chunks, lanes_here(jobs), bar=False))


@archive_app.command("run")
def run_all(
    archive: Where,
    jobs: Jobs = 0,
    run: Run = None,
    engine: Annotated[
        Literal["local", "dask"], typer.Option(help="Processes of this command, or Dask's workers.")
    ] = "local",
    scheduler: Annotated[
        str | None, typer.Option(help="A Dask scheduler that is there, as tcp://host:8786; implies dask.")
    ] = None,
) -> None:
    """Solve all that is not done yet. Interrupted or killed, it goes on where it was when given again.

    Exit code 0 if all is done, 1 if something stopped it or somebody else works on the rest, 2 on bad usage,
    130 when interrupted.
    """
    from api.archive.solving import lanes_here
    from mountnav.archive.work_list import WorkList

    folder, run_folder = _opened(archive, run)
    chunks = WorkList.open(folder).in_order()
    dask = engine == "dask" or scheduler is not None
    lanes = lanes_here(jobs)
    raise typer.Exit(_solved(folder, run_folder, chunks, lanes, bar=True, dask=dask, scheduler=scheduler))


@archive_app.command()
def status(
    archive: Where,
    run: Run = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Again each two seconds, until all is done.")
    ] = False,
    as_json: Json = False,
) -> None:
    """How far a run is. Exit code 0 if all is done, 1 if not."""
    from api.cli.archive_showing import show_status

    folder, run_folder = _opened(archive, run)
    raise typer.Exit(0 if show_status(folder, run_folder, watch=watch, as_json=as_json) else 1)


@archive_app.command()
def report(
    archive: Where,
    out: Annotated[Path, typer.Option("--out", "-o", help="HTML file to write.")] = Path("report.html"),
    run: Run = None,
) -> None:
    """Write one HTML file: success by instrument, field and year, wrong headers, odds, refusals, cost."""
    from mountnav.archive.report import as_html, reported
    from mountnav.files import replace_bytes

    folder, run_folder = _opened(archive, run)
    found = reported(folder, run_folder)
    replace_bytes(out, as_html(found).encode())
    _say(f"{out}: {found.counts.frames} frames, {found.counts.solved} solved")


@archive_app.command()
def diff(
    archive: Where,
    one: Annotated[str, typer.Argument(metavar="RUN", help="The older run, by the beginning of its name.")],
    other: Annotated[str, typer.Argument(metavar="RUN", help="The newer one.")],
    most: Annotated[int, typer.Option(min=0, help="Frames that are listed of each kind.")] = 20,
    as_json: Json = False,
) -> None:
    """What another run made of the same frames. Exit code 0 if it is the same, 1 if not."""
    from mountnav.archive.differences import differences
    from mountnav.archive.folder import Folder

    folder = Folder.open(archive)
    found = differences(folder, folder.run(one), folder.run(other), most=most)
    if as_json:
        print_json(found.plain(), ascii_only=False)
    else:
        sys.stdout.write(found.words())
    raise typer.Exit(0 if found.same else 1)


@archive_app.command()
def verify(
    archive: Where,
    run: Run = None,
    frames: Annotated[
        bool, typer.Option("--frames", help="Read and hash the frames themselves again, too.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Check that each frame is accounted for exactly once, and all hashes are right.

    Exit code 0 if all is well and done, 1 if something is damaged, 3 if all is well but not all is done.
    """
    from api.cli.archive_showing import show_audit
    from mountnav.archive.accounting import verify as audited

    folder, run_folder = _opened(archive, run)
    audit = audited(folder, run_folder, frames=frames)
    show_audit(audit, as_json=as_json)
    raise typer.Exit(1 if audit.trouble_count else 3 if audit.missing_chunks else 0)


@archive_app.command()
def redo(
    archive: Where,
    reason: Annotated[
        list[str],
        typer.Option("--reason", help="A code: UNREAD, HUNG, DIED, FAULT, TIMED_OUT, ... May be repeated."),
    ],
    run: Run = None,
) -> None:
    """Remove chunks from the store that hold frames not solved for these reasons; `run` does them again.

    For frames whose disk was gone, or that a loaded computer had no time for.
    """
    from mountnav.archive.accounting import chunks_with, taken_out

    folder, run_folder = _opened(archive, run)
    found = chunks_with(folder, run_folder, {code.upper() for code in reason})
    taken_out(run_folder, found.chunks)
    _say(f"{len(found.chunks)} chunks are to be done again, for {found.frames} of their frames")


@archive_app.command("wcs")
def write_wcs(
    archive: Where,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write to.")],
    kind: Annotated[
        Literal["sip", "tpv", "gwcs"],
        typer.Option(help="FITS headers with SIP (ZPN of a wide lens) or TPV as SCAMP does, or ASDF files."),
    ] = "sip",
    run: Run = None,
) -> None:
    """Write a .wcs file, a FITS header without data, for each solved frame; named by number and name.

    With --kind gwcs it is an .asdf file with a GWCS, also of a wide lens. Frames whose lens a kind has
    no words for are left out: then the exit code is 1.
    """
    from api.archive.deliverables import write_headers

    _, run_folder = _opened(archive, run)
    written = write_headers(run_folder, out, kind)
    _say(f"{written.count} headers in {out}")
    if written.left:
        _say(f"{written.left} frames were left out; the first one is {written.why}")
        raise typer.Exit(1)


@archive_app.command("stars")
def write_stars_of(
    archive: Where,
    out: Annotated[Path, typer.Option("--out", "-o", help="New file to write, .parquet or .fits.")],
    names: Annotated[
        list[Path] | None,
        typer.Option(
            "--names",
            help="File of Gaia's or Tycho-2's stars, whose names are joined by place; the first that knows a "
            "star names it. May be repeated.",
        ),
    ] = None,
    within: Annotated[
        float, typer.Option(min=0.01, max=60.0, help="Arcseconds that a star may be off its place there.")
    ] = 1.0,
    run: Run = None,
) -> None:
    """Write a light table of all identified stars, with units and UCDs, for VO tools; of a run of --pairs."""
    from api.archive.star_table import checked_names, write_stars
    from mountnav.archive.identifiers import named_stars

    _, run_folder = _opened(archive, run)
    checked_names(names or [])
    stars, known = write_stars(run_folder, out, [named_stars(path) for path in names or []], within)
    _say(f"{out}: {stars} stars, {known} with a name")


def _opened(archive: Path, run: str | None) -> tuple[Folder, RunFolder]:
    from mountnav.archive.folder import Folder

    folder = Folder.open(archive)
    return folder, folder.run(run)


def _part(text: str) -> tuple[int, int]:
    which, slash, of = text.partition("/")
    if not (slash and which.isdecimal() and of.isdecimal() and int(of) >= 1 and int(which) <= int(of)):
        raise BadRequest(
            f"--chunk {text!r} is not a part", advice="write K/N: 1/100 to 100/100, or 0/100 to 99/100"
        )
    return int(which), int(of)


def _solved(
    folder: Folder,
    run: RunFolder,
    chunks: list[Chunk],
    lanes: int,
    *,
    bar: bool,
    dask: bool = False,
    scheduler: str | None = None,
) -> int:
    """Solve the chunks; the exit code."""
    import asyncio

    from api.archive.chosen import prepared_for
    from api.archive.solving import solve_chunks
    from api.cli.archive_showing import Bar, said_at_end
    from api.cli.catalog_import import built_with_progress

    ready = prepared_for(run)
    index = None
    if ready.settings.blind != "never":
        index = built_with_progress(ready.catalog.indexed).path
    with Bar(shown=bar) as shown:
        try:
            if dask:
                from api.archive.on_dask import solve_on_dask

                progress = solve_on_dask(
                    folder, run, chunks, jobs=lanes, scheduler=scheduler, tell=shown.tell, say=_say
                )
            else:
                progress = asyncio.run(
                    solve_chunks(run, chunks, ready, lanes=lanes, index=index, tell=shown.tell)
                )
        except OSError as fault:
            raise StoreFailed(
                f"the store can't be written: {fault.strerror or fault}",
                device=str(run.path),
                advice="free some space, and give the same command again: nothing is lost",
            ) from fault
    _say(said_at_end(progress))
    return 1 if progress.left else 0


def _chunks(folder: Folder) -> int:
    from mountnav.archive.work_list import WorkList

    return len(WorkList.open(folder).chunks)


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")
