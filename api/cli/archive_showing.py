"""What `mountnav archive` shows: a bar, how far a run is, what an audit found."""

from __future__ import annotations

import sys
import time
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, Self

from api.archive.solving import Progress
from api.cli.output import print_json
from mountnav.archive.accounting import Audit, Status, status_of
from mountnav.archive.folder import Folder, RunFolder
from mountnav.archive.learning import Learned

if TYPE_CHECKING:
    from rich.table import Table

TOLD_EACH_S = 0.2
"""Between two steps of the bar."""
LOOKED_EACH_S = 2.0
"""Between two looks of ``status --watch``: it reads a folder and the chunks that are new."""
TROUBLES_SHOWN = 50
"""Of an audit, one by one."""


class Bar(AbstractContextManager["Bar"]):
    """A bar for people; nothing for a pipe."""

    def __init__(self, *, shown: bool) -> None:
        self._progress: Any = None
        self._task: Any = None
        self._told_s = 0.0
        if not shown or not sys.stderr.isatty():
            return
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )
        from rich.progress import Progress as Shown

        self._progress = Shown(
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.description}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self._task = self._progress.add_task("", total=None)

    def __enter__(self) -> Self:
        if self._progress is not None:
            self._progress.start()
        return self

    def __exit__(self, *fault: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    def tell(self, progress: Progress) -> None:
        """Show how far it is, now and then."""
        if self._progress is None or time.monotonic() - self._told_s < TOLD_EACH_S:
            return
        self._told_s = time.monotonic()
        counts = progress.counts
        aside = f", [red]{counts.set_aside} set aside[/red]" if counts.set_aside else ""
        self._progress.update(
            self._task,
            total=progress.frames_wanted,
            completed=counts.frames,
            description=f"{counts.solved} solved, {counts.refused} refused{aside}; {progress.chunks} chunks",
        )


def learned_words(one: Learned) -> str:
    """What is known of a camera, in a line."""
    names = " on ".join(filter(None, (one.instrument, one.telescope))) or "camera without a name"
    parity = "/".join(f"{parity:+d}" for parity in one.parities)
    prior = one.prior
    scale = (
        f"not learned, {one.why}"
        if prior is None
        else f"{prior.scale_low_arcsec_px:g} to {prior.scale_high_arcsec_px:g} ″/px"
    )
    return (
        f"{names}, {one.width_px} × {one.height_px}: {scale}; {one.frames} frames, parity {parity}, rotation "
        f"{one.rotation_low_deg:.1f}° to {one.rotation_high_deg:.1f}°"
    )


def said_at_end(progress: Progress) -> str:
    """What came of it, in a line or two."""
    counts, wall_s = progress.counts, time.monotonic() - progress.began_s
    if not progress.chunks_wanted:
        return "nothing is left to do"
    rate = f" ({counts.frames / wall_s:.1f} a second)" if wall_s > 1.0 else ""
    text = (
        f"{progress.chunks} of {progress.chunks_wanted} chunks done in {wall_s:.1f} s: {counts.frames} frames"
        f"{rate}, {counts.solved} solved, {counts.refused} refused, {counts.set_aside} set aside"
    )
    return f"{text}\n{progress.left} chunks are worked on by others" if progress.left else text


def show_status(folder: Folder, run: RunFolder, *, watch: bool, as_json: bool) -> bool:
    """Show how far a run is; whether all is done."""
    known: dict[int, dict[str, int]] = {}
    status = status_of(folder, run, known)
    if as_json:
        print_json(_plain(status))
        return status.complete
    from rich.console import Console
    from rich.live import Live

    console = Console()
    if not watch:
        console.print(_table(status, None))
        return status.complete
    began_s, began = time.monotonic(), status.counts.frames
    with Live(_table(status, None), console=console, auto_refresh=False) as live:
        while not status.complete:
            time.sleep(LOOKED_EACH_S)
            status = status_of(folder, run, known)
            rate = (status.counts.frames - began) / (time.monotonic() - began_s)
            live.update(_table(status, rate), refresh=True)
    return True


def _plain(status: Status) -> dict[str, Any]:
    counts = status.counts
    return {
        "run": status.run,
        "chunks": status.chunks,
        "chunks_done": status.done_chunks,
        "chunks_being_made": list(status.making),
        "frames": status.frames,
        "frames_done": counts.frames,
        "solved": counts.solved,
        "refused": counts.refused,
        "set_aside": counts.set_aside,
    }


def _table(status: Status, rate: float | None) -> Table:
    from rich.table import Table

    counts = status.counts
    table = Table(show_header=False, box=None)
    left = status.frames - counts.frames
    share = 100.0 * counts.frames / max(status.frames, 1)
    table.add_row("run", status.run)
    table.add_row("chunks", f"{status.done_chunks} of {status.chunks}")
    if status.making:
        shown = ", ".join(map(str, status.making[:8])) + (", ..." if len(status.making) > 8 else "")
        table.add_row("being made, or left by a killed worker", shown)
    table.add_row("frames", f"{counts.frames} of {status.frames} ({share:.1f} %)")
    table.add_row("solved", f"[green]{counts.solved}[/green]")
    table.add_row("refused", f"[yellow]{counts.refused}[/yellow]")
    table.add_row("set aside", f"[red]{counts.set_aside}[/red]" if counts.set_aside else "0")
    if rate:
        table.add_row("frames a second", f"{rate:.1f}")
        table.add_row("left", f"{left / rate / 60.0:.0f} min" if left else "nothing")
    return table


def show_audit(audit: Audit, *, as_json: bool) -> None:
    """Show what an audit found."""
    counts = audit.counts
    if as_json:
        print_json(
            {
                "frames": counts.frames,
                "solved": counts.solved,
                "refused": counts.refused,
                "set_aside": counts.set_aside,
                "copies": audit.copies,
                "chunks_missing": audit.missing_chunks,
                "chunks_without_costs": audit.without_costs,
                "machines": dict(audit.machines),
                "troubles": audit.trouble_count,
                "first_troubles": audit.troubles,
            },
            ascii_only=False,
        )
        return
    write = sys.stdout.write
    write(
        f"{counts.frames} frames accounted for: {counts.solved} solved, {counts.refused} refused, "
        f"{counts.set_aside} set aside\n"
    )
    if audit.copies:
        write(f"{audit.copies} frames have the content of an earlier one of their chunk\n")
    if audit.missing_chunks:
        write(f"{audit.missing_chunks} chunks are not done yet\n")
    if audit.without_costs:
        write(f"{audit.without_costs} chunks have no account of what they took\n")
    for machine, chunks in audit.machines.most_common():
        write(f"{chunks} chunks by {machine}\n")
    for trouble in audit.troubles[:TROUBLES_SHOWN]:
        write(f"trouble: {trouble}\n")
    if audit.trouble_count > TROUBLES_SHOWN:
        write(f"and {audit.trouble_count - TROUBLES_SHOWN} more\n")
    if not audit.trouble_count:
        write("all hashes are right\n")
