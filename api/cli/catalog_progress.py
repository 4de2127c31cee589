"""How far an import is: a bar on a terminal, a plain line now and then elsewhere. All of it on stderr."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from mountnav.catalog.importing.order import ImportProgress

if TYPE_CHECKING:
    from rich.progress import TaskID

_LINE_EACH_S = 10.0
_WIDE = 120
"""Columns of a terminal that shows all there is to tell."""
_STAGES = {"reading": "reading", "packing": "sorting and writing", "checking": "checking"}


class ShownProgress:
    """Shows the progress of an import; a context, so that the terminal is left in order."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(stderr=True)
        self._terminal = console.is_terminal
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            TextColumn("{task.percentage:3.0f} %  {task.fields[told]}"),
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

    def tell(self, progress: ImportProgress) -> None:
        """Show how far it is."""
        self.last = progress
        if progress.stage != self._stage:
            self._begin(progress)
        assert self._first is not None
        elapsed_s = time.monotonic() - self._began_s
        told = self._told(progress, elapsed_s)
        if self._terminal:
            assert self._task is not None
            self._bar.update(self._task, completed=progress.share, told=told)
        elif time.monotonic() >= self._line_due_s:
            self._line_due_s = time.monotonic() + _LINE_EACH_S
            self._line(progress, told, elapsed_s)

    def _begin(self, progress: ImportProgress) -> None:
        """A stage begins: with a bar of its own, and a clock of its own."""
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._stage, self._first = progress.stage, progress
        self._began_s, self._line_due_s = time.monotonic(), 0.0
        self._task = self._bar.add_task(_STAGES[progress.stage], total=1.0, told="")

    def _told(self, progress: ImportProgress, elapsed_s: float) -> str:
        assert self._first is not None
        if progress.stage != "reading":
            return f"{progress.stars:,} stars"
        new = progress.stars - self._first.stars
        rate = f"  {new / elapsed_s:,.0f} stars/s" if new and elapsed_s >= 1.0 else ""
        if self._terminal and self._bar.console.width < _WIDE:
            return f"{_size(progress.bytes_done)}/{_size(progress.size_bytes)}  {progress.stars:,} stars"
        size = f"{_size(progress.bytes_done)} of {_size(progress.size_bytes)}"
        return f"{progress.parts_done} of {progress.parts} parts  {size}  {progress.stars:,} stars{rate}"

    def _line(self, progress: ImportProgress, told: str, elapsed_s: float) -> None:
        assert self._first is not None
        done = progress.share - self._first.share
        left = ""
        if done > 0 and elapsed_s >= 1.0:
            left = f"  {_time(elapsed_s * (1.0 - progress.share) / done)} left"
        stage = _STAGES[progress.stage]
        sys.stderr.write(f"{stage}: {100.0 * progress.share:.0f} %  {told}{left}\n")
        sys.stderr.flush()


def _size(size_bytes: float) -> str:
    for unit, factor in (("GB", 1e9), ("MB", 1e6)):
        if size_bytes >= factor:
            return f"{size_bytes / factor:.1f} {unit}"
    return f"{size_bytes / 1e3:.0f} kB"


def _time(seconds: float) -> str:
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
